# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd replay LOG --what-if`: the recorded inputs into an arm with something changed."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields
from pathlib import Path
import sys

from pfd_ros.cli.terminal import print_json, print_lines
from pfd_ros.messages.convert import JOINT_FIELDS
from pfd_ros.replay.plots import check_picture, plot_what_if
from pfd_ros.replay.what_if import THRESHOLDS, JointDivergence, WhatIf, what_if
from pfd_ros.text import listed, one_line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options that go with --what-if."""
    group = parser.add_argument_group(
        'with --what-if', 'example: pfd replay run.mcap --what-if payload.mass=2 friction.elbow=3'
    )
    group.add_argument(
        '--commands',
        default='',
        metavar='TOPIC',
        help='topic with efforts of any bag (JointState or Float64MultiArray); requires robot=',
    )
    group.add_argument(
        '--states', default='', metavar='TOPIC', help="with --commands: the bag's JointStates"
    )
    group.add_argument(
        '--rename',
        nargs='+',
        default=(),
        metavar='OLD=NEW',
        help='with --commands: replace the prefix OLD of joint names by NEW',
    )
    group.add_argument(
        '--out',
        type=Path,
        metavar='FILE',
        help='log of the new run (default: LOG_what_if.mcap)',
    )
    group.add_argument(
        '--plot',
        type=Path,
        metavar='FILE',
        help='picture of both runs (default: the name of the new log with .png)',
    )
    group.add_argument(
        '--thresholds',
        nargs=len(JOINT_FIELDS),
        type=float,
        metavar=('Q', 'QD', 'TAU'),
        help='differences beyond which runs have diverged; default '
        + ' '.join(map(str, THRESHOLDS)),
    )
    group.add_argument('--json', action='store_true', help='print JSON')


def conflict(given: argparse.Namespace) -> str:
    """Return which option requires --what-if and was given without, '' if none was."""
    options = ('commands', 'states', 'rename', 'out', 'plot', 'thresholds', 'json')
    alone = [f'--{name}' for name in options if getattr(given, name)]
    return f'{alone[0]} requires --what-if' if alone and given.what_if is None else ''


def run(given: argparse.Namespace, progress: Callable[[float], None] | None) -> int:
    """Run the inputs into the changed arm, and print how far it diverges.

    The status is 0, or 1 if a picture was requested and could not be written.

    Raises
    ------
    ValueError
        If a setting is refused, or the log is damaged.
    OSError
        If a file cannot be read or written.
    """
    rename = dict(_renaming(word) for word in given.rename)
    if given.plot is not None:
        check_picture(given.plot)
    found = what_if(
        given.logs,
        given.what_if,
        commands=given.commands,
        states=given.states,
        rename=rename,
        out=given.out,
        thresholds=given.thresholds or THRESHOLDS,
        progress=progress,
    )
    picture = given.plot or found.log.with_suffix('.png')
    drawn, note = _draw(found, picture)
    status = int(given.plot is not None and not drawn)
    if given.json:
        print_json({**as_json(found), 'plot': drawn})
        if note:
            print(one_line(note), file=sys.stderr)
        return status
    drawn_line = f'plot       {drawn}' if drawn else ''
    print_lines(filter(None, (*lines_of(found), drawn_line, note)))
    return status


def _renaming(word: str) -> tuple[str, str]:
    old, equals, new = word.partition('=')
    if not equals or not old:
        raise ValueError(f'--rename takes OLD=NEW, got {one_line(word, 80)!r}')
    return old, new


def _draw(found: WhatIf, path: Path) -> tuple[str, str]:
    """Return the path of the picture, '' without one, and a line that says why."""
    try:
        plot_what_if(found, path)
    except (ValueError, OSError) as error:
        return '', f'no plot    {error}'
    return str(path), ''


def as_json(found: WhatIf) -> dict[str, object]:
    """Return a result without settings, names of all joints and curves."""
    left_out = {'settings', 'joints', 'curves'}
    values = {f.name: getattr(found, f.name) for f in fields(found) if f.name not in left_out}
    return values | {
        'source': str(found.source),
        'log': str(found.log),
        'thresholds': dict(zip(JOINT_FIELDS, found.thresholds, strict=True)),
        'divergences': [asdict(item) for item in found.divergences],
    }


def lines_of(found: WhatIf) -> list[str]:
    """Return a result as lines."""
    position, velocity, effort = found.thresholds
    changes = ' '.join(found.changes) or 'nothing changed'
    lines = [
        f'{found.source}: {found.robot}, {changes}',
        f'new run    {found.log}, {found.seconds:.3f} s, {found.states} recorded states compared',
    ]
    if found.times:
        lines.append(f'times      {found.times} of the messages')
    if found.failed_at is not None:
        lines.append(
            f'FAILED     simulation stopped at {found.failed_at:.6f} s: {found.failure}; nothing '
            'is compared from there on'
        )
    if found.rounding_failed_at is not None:
        lines.append(f'FAILED     the rounding run stopped at {found.rounding_failed_at:.6f} s')
    if found.rejected:
        counts = ', '.join(f'{count} {name}' for name, count in sorted(found.rejected.items()))
        lines.append(
            f'inputs     accepted or rejected differently: {counts}; {found.first_rejected}'
        )
    lines += [
        f'skipped    {count} messages: {reason}' for reason, count in sorted(found.skipped.items())
    ]
    for text, joints in (('log', found.only_in_log), ('arm', found.only_in_arm)):
        if joints:
            lines.append(f'joints     only in the {text}: {listed(joints)}')
    if not found.complete:
        lines.append('cut off    the log was not closed; compared up to the cut')
    lines.append(
        f'diverged   beyond {position:g} rad or m, {velocity:g} rad/s or m/s, {effort:g} N m or '
        'N; times in s after the start'
    )
    lines.append(
        'rounding   the new run again, with 2.2e-16 added to each position that the arm is set to'
    )
    width = max((len(item.joint) for item in found.divergences), default=0)
    head = f'{"":9}  {"":{width}}  {"new run - recorded":49}  rounding alone'
    lines.append(head)
    lines += [_row(item, width) for item in found.divergences]
    return lines


def _row(item: JointDivergence, width: int) -> str:
    new = _cells(item.largest, item.rms, item.first_at)
    at = '' if item.largest_at is None else f' at {item.largest_at:.3f} s'
    rounding = _cells(item.rounding_largest, item.rounding_rms, item.rounding_first_at)
    largest, rms, first = new
    return (
        f'{item.field:9}  {item.joint:{width}}  max {largest}{at:13} rms {rms} {first:16}  max '
        f'{rounding[0]} rms {rounding[1]} {rounding[2]}'
    )


def _cells(largest: float | None, rms: float | None, first: float | None) -> Sequence[str]:
    if largest is None or rms is None:
        return '-       ', '-       ', ''
    where = 'equal' if largest == 0 else 'never' if first is None else f'from {first:.3f} s'
    return f'{largest:.2e}', f'{rms:.2e}', where
