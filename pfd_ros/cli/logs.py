# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd replay`, `pfd info`, `pfd compare` and `pfd recover`.

Exit statuses: 0 if it did what was asked, also for a log whose end was cut and for a new run of
--what-if whose simulation failed (a line says so); 1 if something could not be read, or differs;
INCOMPLETE if --verify found everything equal in a log that is incomplete.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import asdict
from datetime import datetime, timezone
from pathlib import Path
import sys
from typing import TYPE_CHECKING, Any

from pfd_ros.cli import publish
from pfd_ros.cli.terminal import (
    Command,
    add_rename,
    print_json,
    print_lines,
    progress_on,
    reads_logs,
)
from pfd_ros.text import one_line

if TYPE_CHECKING:
    from pfd_ros.recording.facts import Facts

INCOMPLETE = 3
ANY_LOG = 'MCAP file, .db3 file or folder of rosbag2'
NANOSECONDS = 1_000_000_000
# Of the settings of a recording, on one line.
LONGEST_LINE = 10_000
# Options of --what-if, and their values without it.
WHAT_IF: dict[str, Any] = {
    'commands': '',
    'states': '',
    'rename': [],
    'out': None,
    'thresholds': None,
    'rounding': False,
    'plot': None,
    'json': False,
}


def _replay_arguments(parser: argparse.ArgumentParser) -> None:
    logs = f'a recording; with --publish or --commands any {ANY_LOG}'
    parser.add_argument('log', type=Path, metavar='LOG', help=logs)
    add = parser.add_mutually_exclusive_group().add_argument
    add('--verify', action='store_true', help='simulate it again; fail at the first differing bit')
    what_if = 'simulate its inputs with other parameters of the node, and compare'
    add('--what-if', nargs='*', metavar='KEY=VALUE', help=what_if)
    allow = f'with --verify: status 0, not {INCOMPLETE}, for a log that is equal but incomplete'
    parser.add_argument('--allow-incomplete', action='store_true', help=allow)
    group = parser.add_argument_group(
        'with --what-if', 'example: pfd replay run.mcap --what-if payload.mass=2 friction.elbow=3'
    )
    add = group.add_argument
    commands = 'topic with efforts of any bag (JointState or Float64MultiArray); requires robot='
    add('--commands', metavar='TOPIC', help=commands)
    add('--states', metavar='TOPIC', help="with --commands: the bag's JointStates")
    add_rename(group)
    add('--out', type=Path, metavar='FILE', help='the new log (default: ./LOG_what_if.mcap)')
    units = ('Q', 'QD', 'TAU')
    beyond = 'differences beyond which runs have diverged'
    add('--thresholds', nargs=3, type=float, metavar=units, help=beyond)
    rounding = (
        'simulate a third time, with 2.2e-16 added to each position that the arm is set to: how '
        'far rounding alone leads'
    )
    add('--rounding', action='store_true', help=rounding)
    add('--plot', type=Path, metavar='FILE', help='plot both runs (.png, .svg)')
    add('--json', action='store_true', help='print JSON')
    publish.add_arguments(parser)
    parser.set_defaults(**WHAT_IF)


@reads_logs
def _replay(given: argparse.Namespace, unread: list[str]) -> int:
    wrong = _conflict(given)
    if wrong:
        print(one_line(f'pfd replay: {wrong}'), file=sys.stderr)
        return 2
    if given.publish:
        return publish.run(given)
    if given.what_if is not None:
        return _what_if(given, unread)
    if given.verify:
        return _verify(given)
    from pfd_ros.replay.summary import lines, summarize

    print_lines(lines(summarize(given.log)))
    return 0


def _conflict(given: argparse.Namespace) -> str:
    """Return why the options exclude each other, '' if they do not."""
    what_if = given.what_if is not None
    if given.publish and (given.verify or what_if):
        return f'--publish and {"--verify" if given.verify else "--what-if"} exclude each other'
    for needed, there, options in (
        ('--publish', given.publish, publish.DEFAULTS),
        ('--what-if', what_if, WHAT_IF),
        ('--verify', given.verify, {'allow_incomplete': False}),
    ):
        for name, value in options.items():
            if not there and getattr(given, name) != value:
                return f'--{name.replace("_", "-")} requires {needed}'
    return ''


def _verify(given: argparse.Namespace) -> int:
    from pfd_ros.arm.events import OUTPUTS
    from pfd_ros.replay.verify import verify

    found = verify(given.log)
    counts = ', '.join(f'{found.compared[r]} {r}' for r in OUTPUTS if found.compared[r])
    equal = f'every bit equal in {found.cycles} cycles ({counts})'
    if found.complete:
        print_lines([f'verified: {given.log}: {equal}'])
        return 0
    print_lines([f'incomplete: {given.log}: equal as far as it goes: {equal}'])
    return 0 if given.allow_incomplete else INCOMPLETE


def _what_if(given: argparse.Namespace, unread: list[str]) -> int:
    from pfd_ros.replay import what_if
    from pfd_ros.replay.plots import check_picture, plot_comparison

    if given.plot:
        check_picture(given.plot)
    options = {
        name: getattr(given, name)
        for name, unset in WHAT_IF.items()
        if name not in ('plot', 'json') and getattr(given, name) != unset
    }
    options['rename'] = dict(given.rename)
    found = what_if.what_if(given.log, given.what_if, **options, progress=progress_on(sys.stderr))
    if given.json:
        print_json(what_if.as_json(found))
    else:
        print_lines(what_if.lines(found))
    if given.plot:
        plot_comparison(found.comparison, (str(found.source), str(found.log)), given.plot)
    unread += found.problems
    return 0


def _info_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('log', type=Path, metavar='LOG', help=ANY_LOG)
    parser.add_argument('--json', action='store_true', help='print JSON')


@reads_logs
def _info(given: argparse.Namespace, unread: list[str]) -> int:
    from pfd_ros.recording.facts import facts

    found = facts(given.log)
    if given.json:
        print_json(asdict(found))
    else:
        print_lines(_info_lines(found), LONGEST_LINE)
    unread += [f'{name}: {t.unreadable}' for name, t in found.topics.items() if t.unreadable]
    return 0


def _info_lines(found: Facts) -> Iterator[str]:
    """Yield the lines about any log, as `ros2 bag info` has them."""
    yield f'log        {found.path}'
    yield f'size       {found.bytes / 1e6:.3f} MB{"" if found.complete else ", cut off"}'
    yield f'messages   {found.messages}'
    if found.begin_ns is not None and found.end_ns is not None:
        yield f'begin      {_date(found.begin_ns, simulated=found.simulated)}'
        yield f'end        {_date(found.end_ns, simulated=found.simulated)}'
        yield f'length     {(found.end_ns - found.begin_ns) / NANOSECONDS:.6f} s'
    names = max(map(len, found.topics), default=0)
    kinds = max((len(topic.type) for topic in found.topics.values()), default=0)
    for name, topic in found.topics.items():
        line = f'topic      {name:{names}}  {topic.type:{kinds}}  {topic.messages:8}'
        if topic.median_interval_ns is not None and topic.longest_gap_ns is not None:
            median, gap = topic.median_interval_ns * 1e-6, topic.longest_gap_ns * 1e-6
            line += f'  every {median:.3f} ms, longest gap {gap:.3f} ms'
        yield line + (f'  not decoded: {topic.obstacle}' if topic.obstacle else '')
    for name, values in (('totals', found.end.get('totals')), ('settings', found.settings)):
        if values:
            yield f'{name:10} {", ".join(f"{key}={value}" for key, value in values.items())}'


def _date(ns: int, *, simulated: bool) -> str:
    if simulated:
        return f'{ns / NANOSECONDS:.6f} s of simulated time'
    try:
        return datetime.fromtimestamp(ns / NANOSECONDS, timezone.utc).isoformat(sep=' ')
    except (ValueError, OverflowError, OSError):
        return f'{ns} ns'  # later than the year 9999


def _compare_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add('a', type=Path, metavar='A', help=ANY_LOG)
    add('b', type=Path, metavar='B')
    equal = 'differences up to X count as equal, in the unit of each field (default 0)'
    add('--tolerance', type=float, default=0.0, metavar='X', help=equal)
    add('--topics', nargs=2, metavar=('TOPIC_A', 'TOPIC_B'), help='one topic of each log')
    lag = 'lag of B (default: 0 on one clock, else estimated)'
    add('--lag', type=float, metavar='S', help=lag)
    add_rename(parser)
    add('--json', action='store_true', help='print JSON')
    add('--plot', type=Path, metavar='FILE', help='plot both logs (.png, .svg)')


@reads_logs
def _compare(given: argparse.Namespace, unread: list[str]) -> int:
    """Compare two logs; status 1 if a difference is beyond the tolerance."""
    from pfd_ros.arm.events import INPUTS
    from pfd_ros.messages.types import JOINT_STATE
    from pfd_ros.recording.arrays import read_log, renamed
    from pfd_ros.replay import compare
    from pfd_ros.replay.plots import check_picture, plot_comparison

    if given.plot:
        check_picture(given.plot)
    logs = [
        renamed(
            read_log(
                path,
                topics=given.topics and [given.topics[k]],
                types=[JOINT_STATE],
                unreadable='count',
            ),
            dict(given.rename),
        )
        for k, path in enumerate((given.a, given.b))
    ]
    topics = tuple(given.topics) if given.topics else None
    found = compare.compare(*logs, tolerance=given.tolerance, topics=topics, lag=given.lag)
    if given.json:
        print_json(compare.as_json(found))
    else:
        print_lines(compare.lines(found))
    if given.plot:
        plot_comparison(found, (str(given.a), str(given.b)), given.plot)
    for log in logs:
        unread += [
            f'{log.path}, {topic}: {log[topic].unreadable} of {len(log.received_ns[topic])} '
            'messages cannot be read'
            for topic in log
            # Those of a recording are inputs that the node refused.
            if not log.obstacle(topic) and log[topic].unreadable
            if log.roles.get(topic) not in INPUTS
        ]
    return 0 if found.within else 1


def _recover_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('log', type=Path, metavar='LOG.mcap')
    out = 'default: ./LOG.recovered.mcap; it must not exist'
    parser.add_argument('--out', type=Path, metavar='FILE', help=out)


def _recover(given: argparse.Namespace) -> int:
    """Recover a log; status 0 also if parts of it are lost, which are printed."""
    from pfd_ros.recording.recover import recover

    target = given.out or Path(given.log.with_suffix('.recovered.mcap').name)
    found = recover(given.log, target)
    print_lines(f'lost       {part}' for part in found.lost)
    state = 'the log was incomplete' if found.lost else 'the log was whole'
    print_lines([f'{found.messages} messages in {target}; {state}'])
    return 0


COMMANDS = {
    'replay': Command(
        'summarize, verify or re-simulate a recording with changes; or publish a log',
        'pfd replay run.mcap --verify',
        _replay_arguments,
        _replay,
        lambda given: bool(given.publish),
    ),
    'info': Command(
        'print topics, times and settings of a log', 'pfd info run.mcap', _info_arguments, _info
    ),
    'compare': Command(
        'compare two logs, joint by joint',
        'pfd compare real.mcap simulated.mcap --tolerance 0.01',
        _compare_arguments,
        _compare,
    ),
    'recover': Command(
        'write all readable messages of a truncated or damaged log to a new file',
        'pfd recover cut.mcap --out whole.mcap',
        _recover_arguments,
        _recover,
    ),
}
