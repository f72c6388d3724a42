# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd replay`: a recording summarized, verified or changed, or any log published."""

from __future__ import annotations

import argparse
import sys

from pfd_ros.arm.events import CLOCK, STATES, TAKEN, TF, Verdict
from pfd_ros.cli import replay_publish, what_if
from pfd_ros.cli.terminal import add_logs, progress_on
from pfd_ros.recording.provenance import versions
from pfd_ros.recording.run_parts import files_of
from pfd_ros.replay.summary import Summary
from pfd_ros.replay.verify import read_run
from pfd_ros.text import one_line

HELP = 'summarize, verify or re-simulate a recording with changes; or publish a log'
EXAMPLE = 'pfd replay run.mcap --verify'
# Exit status of --verify for an incomplete recording whose recorded part is equal.
INCOMPLETE = 3
# Software whose versions may change the bits.
DECISIVE = ('pfd', 'numpy', 'llvmlite')
# Nouns for the messages of some roles.
NOUNS = {STATES: 'states', CLOCK: 'clock ticks', TAKEN: 'rows of applied commands', TF: 'frames'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the recording and the options."""
    add_logs(
        parser,
        'a recording, or all files of one run or their folder; with --publish and --commands any '
        'bag, also a folder of rosbag2',
    )
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument(
        '--verify', action='store_true', help='simulate it again; fail at the first differing bit'
    )
    mode.add_argument(
        '--what-if',
        nargs='*',
        metavar='KEY=VALUE',
        help='simulate its inputs with other parameters of the node, and compare',
    )
    parser.add_argument(
        '--allow-incomplete',
        action='store_true',
        help=f'with --verify: status 0, not {INCOMPLETE}, for a log that is equal but incomplete',
    )
    what_if.add_arguments(parser)
    replay_publish.add_arguments(parser)


def run(given: argparse.Namespace) -> int:
    """Read a recording, replay it with --verify, and print the result; --publish publishes it.

    With --verify the status is 0 if the recording is complete and equal, INCOMPLETE if its
    recorded part is equal.

    Raises
    ------
    LogError
        If it is damaged or differs, with the place.
    OSError
        If it cannot be read.
    """
    given.log = given.logs[0]
    wrong = replay_publish.conflict(given) or what_if.conflict(given)
    if given.allow_incomplete and not given.verify:
        wrong = '--allow-incomplete requires --verify'
    if len(given.logs) > 1 and given.commands:
        wrong = f'got {len(given.logs)} logs, expected one with --commands'
    if wrong:
        print(f'pfd replay: {wrong}', file=sys.stderr)
        return 2
    if given.what_if is not None:
        return what_if.run(given, progress_on(sys.stderr))
    if given.publish:
        return replay_publish.run(given)
    files = files_of(given.logs)
    found = read_run(files, verify=given.verify, progress=progress_on(sys.stderr))
    for part in found.parts:
        for line in describe(part):
            print(line)
    if not given.verify:
        return 0
    several = f' in {len(files)} files' if len(files) > 1 else ''
    equal = f'{found.compared} states{several}, every bit equal{_end(found.parts[-1])}'
    if found.absent:
        print(f'equal as far as it goes: {equal}; missing: {", ".join(found.absent)}')
        return 0 if given.allow_incomplete else INCOMPLETE
    print(f'verified: {equal}')
    return 0


def _end(summary: Summary) -> str:
    """Return the end of the last line, for a simulation that stopped."""
    if summary.stopped_at is None:
        return ''
    return f', and the simulation stopped after step {summary.stopped_at} as recorded'


def _place(summary: Summary) -> str:
    """Return the place of a file in its run, '' for a run of one file."""
    if summary.part == 1 and not summary.continues:
        return ''
    begins = f' that begins after step {summary.start}' if summary.part > 1 else ''
    return f', in part {summary.part} of a run{begins}'


def describe(summary: Summary) -> list[str]:
    """Return the lines that describe a recording."""
    settings = summary.settings
    simulated = summary.simulated * settings.step_size
    accepted = summary.verdicts[Verdict.ACCEPTED]
    unpublished = f', {summary.unpublished} more not published' if summary.unpublished else ''
    lines = [
        one_line(f'{summary.path}: {settings.robot}'),
        f'duration   {simulated:.3f} s simulated, {summary.seconds:.3f} s on the clock',
        f'steps      {summary.simulated} of {settings.step_size:g} s{_place(summary)}',
        f'states     {summary.states}, {summary.rate:.2f} Hz{unpublished}',
        f'inputs     {accepted} accepted, {summary.verdicts.total() - accepted} rejected',
    ]
    lines += [
        f'           {count} {verdict.label}'
        for verdict, count in sorted(summary.verdicts.items())
        if verdict is not Verdict.ACCEPTED
    ]
    if summary.stopped_at is not None:
        reason = summary.failure or 'its states are constant from there on'
        lines.append(
            one_line(f'FAILED     simulation stopped after step {summary.stopped_at}: {reason}')
        )
    lines += [
        f'missing    {count} {NOUNS.get(role, role)} were not recorded'
        for role, count in sorted(summary.lost.items())
    ]
    if summary.obstacle:
        lines.append(f'note       {summary.obstacle}')
    if not summary.complete:
        lines.append('cut off    the file was not closed; the summary is up to the cut')
    elif not summary.ended:
        lines.append('missing    the end record of the node')
    here = versions()
    lines += [
        one_line(f'note       recorded with {name} {summary.versions[name]}, this is {here[name]}')
        for name in DECISIVE
        if name in summary.versions and summary.versions[name] != here[name]
    ]
    return lines
