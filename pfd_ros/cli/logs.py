# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd replay`, `pfd info`, `pfd compare` and `pfd recover`.

Exit statuses: 0 if it did what was asked, also for a log whose end was cut and for a new run of
--what-if whose simulation failed (a line says so); 1 if something could not be read, or differs,
or a controller in the loop failed;
INCOMPLETE if --verify found everything equal in a log that is incomplete.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import sys
import traceback
from typing import TYPE_CHECKING, Any

from pfd_ros.cli.terminal import (
    ANY_LOG,
    Command,
    add_rename,
    ended_by_signals,
    number,
    pair,
    print_lines,
    progress_on,
    status_of,
)
from pfd_ros.files import free_path
from pfd_ros.node.main import ignore_signals, stop_on_signals
from pfd_ros.text import one_line

if TYPE_CHECKING:
    from pfd_ros.replay.compare import Curves

INCOMPLETE = 3
# A shell adds the number of a signal to this status.
SIGNALLED = 128
# Of the settings of a recording, on one line.
LONGEST_LINE = 10_000
# Of the clock without a number, as `ros2 bag play --clock` [Hz].
CLOCK_HZ = 40.0
# Longest offset and duration, s: a century.
LONGEST = 3.2e9


def _replay_arguments(parser: argparse.ArgumentParser) -> None:
    logs = f'a recording; with --publish or --commands any {ANY_LOG}'
    parser.add_argument('log', type=Path, metavar='LOG', help=logs)
    modes = parser.add_mutually_exclusive_group()
    simulate = 'simulate it again; fail at the first differing bit'
    modes.add_argument('--verify', action='store_true', help=simulate)
    what_if = 'simulate its inputs with other parameters of the node, and compare'
    modes.add_argument('--what-if', nargs='*', metavar='KEY=VALUE', help=what_if)
    publish = 'publish the messages of the log'
    modes.add_argument('--publish', action='store_true', help=publish)
    # Options of a mode that are not given are not in the namespace: the defaults are elsewhere.
    silent = argparse.SUPPRESS
    verify = parser.add_argument_group('with --verify', argument_default=silent)
    allow = f'status 0, not {INCOMPLETE}, for a log that is equal but incomplete'
    verify.add_argument('--allow-incomplete', action='store_true', default=silent, help=allow)
    changed = parser.add_argument_group(
        'with --what-if',
        'example: pfd replay run.mcap --what-if payload.mass=2 friction.elbow=3',
        argument_default=silent,
    )
    add = changed.add_argument
    commands = 'topic with efforts of any bag (JointState or Float64MultiArray); requires robot='
    callback = 'compute the commands in place of the recorded ones: a function (t, q, qd) -> tau'
    add('--controller', metavar='MODULE:FUNCTION', help=callback)
    command = 'the same by a node: its command line, as one word; it runs in lockstep; needs ROS'
    add('--process', metavar='CMD', help=command)
    add('--commands', metavar='TOPIC', help=commands)
    add('--states', metavar='TOPIC', help="with --commands: the bag's JointStates")
    add_rename(changed, silent)
    add('--out', type=Path, metavar='FILE', help='the new log (default: ./LOG_what_if.mcap)')
    units = ('Q', 'QD', 'TAU')
    beyond = 'differences beyond which runs have diverged'
    add('--thresholds', nargs=3, type=float, metavar=units, help=beyond)
    rounding = (
        'simulate a third time, with 2.2e-16 added to each position that the arm is set to: how '
        'far rounding alone leads'
    )
    add('--rounding', action='store_true', default=silent, help=rounding)
    add('--plot', type=Path, metavar='FILE', help='plot both runs (.png, .svg)')
    add('--json', action='store_true', default=silent, help='print JSON')
    played = parser.add_argument_group(
        'with --publish',
        'The node `log_player` publishes the messages of a recording or of any bag (MCAP, .db3, '
        'folder of rosbag2) at their log times, but no commands unless --topics names them. It '
        'has the services ~/pause and ~/step and the parameters rate and seek_to.',
        argument_default=silent,
    )
    add = played.add_argument
    offset, duration = number('start offset', 0.0, LONGEST), number('duration', 1e-9, LONGEST)
    clock = f'publish the log time on /clock (default {CLOCK_HZ:g} Hz), unless the log has it'
    early = 'start S seconds after the first message; latched messages from before are sent first'
    add('--rate', type=number('rate', 1e-3, 1e3), metavar='X', help='speed (default 1)')
    add('--loop', action='store_true', default=silent, help='begin again at the end')
    add('--start-offset', type=offset, metavar='S', help=early)
    add('--duration', type=duration, metavar='S', help='stop after S seconds of log time')
    add('--topics', nargs='+', metavar='TOPIC', help='only these topics; may name commands')
    remap = 'publish topic A of the log on B; may be repeated'
    add('--remap', dest='remaps', type=pair(':='), action='append', metavar='A:=B', help=remap)
    rate = number('clock', 1e-3, 1e4)
    add('--clock', dest='clock_hz', nargs='?', const=CLOCK_HZ, type=rate, metavar='HZ', help=clock)
    paused = 'wait for ~/pause with false'
    add('--start-paused', action='store_true', default=silent, help=paused)
    groups = {'verify': verify, 'what_if': changed, 'publish': played}
    parser.set_defaults(
        options={
            mode: {action.dest: action.option_strings[0] for action in group._group_actions}
            for mode, group in groups.items()
        }
    )


def _replay(given: argparse.Namespace) -> int:
    chosen: dict[str, Any] = {}
    for mode, options in given.options.items():
        there = {name: getattr(given, name) for name in options if name in given}
        if getattr(given, mode) not in (None, False):
            chosen = there
        elif there:
            flag = f'--{mode.replace("_", "-")}'
            print(f'pfd replay: {options[next(iter(there))]} requires {flag}', file=sys.stderr)
            return 2
    if given.publish:
        return _publish(given, chosen)
    if given.what_if is not None:
        return _what_if(given, chosen)
    if given.verify:
        return _verify(given.log, **chosen)
    from pfd_ros.recording.log import Log

    Log(given.log)  # an error for any other log
    return _info(given)


def _verify(path: Path, allow_incomplete: bool = False) -> int:
    from pfd_ros.arm.events import OUTPUTS
    from pfd_ros.replay.verify import verify

    found = verify(path)
    counts = ', '.join(f'{found.compared[r]} {r}' for r in OUTPUTS if found.compared[r])
    equal = f'every bit equal in {found.cycles} cycles ({counts})'
    if found.complete:
        print_lines([f'verified: {path}: {equal}'])
        return 0
    print_lines([f'incomplete: {path}: equal as far as it goes: {equal}'])
    return 0 if allow_incomplete else INCOMPLETE


def _what_if(given: argparse.Namespace, options: dict[str, Any]) -> int:
    from pfd_ros.replay import what_if
    from pfd_ros.replay.plots import check_picture

    as_json, plot = options.pop('json', False), options.pop('plot', None)
    if plot:
        check_picture(plot)
    options['rename'] = dict(options.get('rename', ()))
    loop = {name: options.pop(name) for name in ('controller', 'process') if name in options}
    if len(loop) > 1:
        raise ValueError('--controller and --process are two controllers: give one of them')
    if loop:
        from pfd_ros.testing.again import closed_loop

        options['drive'] = closed_loop(**loop)
    with ended_by_signals():  # it removes the cut log of the new run
        found = what_if.what_if(
            given.log, given.what_if, **options, progress=progress_on(sys.stderr)
        )
    if as_json:
        _print_json(what_if.as_json(found))
    else:
        print_lines(what_if.lines(found))
    _plot(found.curves, (found.source, found.log), plot)
    if found.error is not None:
        # What the controller raised, by its own frames; of a process, the end of its output.
        cause = found.error.__cause__
        frames = cause.__traceback__.tb_next if cause and cause.__traceback__ else None
        lines = traceback.format_exception(cause.with_traceback(frames)) if cause else []
        for line in (''.join(lines) or str(found.error)).splitlines():
            print(one_line(line), file=sys.stderr)
    return status_of(given, found.problems) or int(found.error is not None)


def _publish(given: argparse.Namespace, options: dict[str, Any]) -> int:
    from pfd_ros.replay.playlist import PlayOptions
    from pfd_ros.replay.publish import play

    stop = given.stop or stop_on_signals()
    try:
        whole = play(given.log, PlayOptions(**options), stop.is_set)
        return 0 if whole else SIGNALLED + stop.number
    finally:
        ignore_signals()


def _print_json(found: dict[str, Any]) -> None:
    """Print a result as JSON; ValueError if it has NaN or an infinity, which JSON lacks."""
    print(json.dumps(found, allow_nan=False))


def _plot(found: Curves, names: tuple[Path, Path], picture: Path | None) -> None:
    from pfd_ros.replay.plots import plot_curves

    if picture and found:  # of a controller without a command there are none
        plot_curves(found, (str(names[0]), str(names[1])), picture)


def _info_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('log', type=Path, metavar='LOG', help=ANY_LOG)
    parser.add_argument('--json', action='store_true', help='print JSON')


def _info(given: argparse.Namespace) -> int:
    from pfd_ros.recording.facts import facts, lines

    found = facts(given.log)
    if given.command == 'info' and given.json:
        _print_json(found)
    else:
        print_lines(lines(found), LONGEST_LINE)
    topics = found['topics'].items()
    unread = [f'{name}: {t["unreadable"]}' for name, t in topics if t['unreadable']]
    return status_of(given, unread)


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


def _compare(given: argparse.Namespace) -> int:
    """Compare two logs; status 1 if a difference is beyond the tolerance."""
    from pfd_ros.messages.types import JOINT_STATE
    from pfd_ros.recording.arrays import read_log, renamed
    from pfd_ros.replay import compare
    from pfd_ros.replay.plots import check_picture

    if given.plot:
        check_picture(given.plot)
    topics = tuple(given.topics) if given.topics else None
    logs = [
        read_log(path, topics=topics and [topics[k]], types=[JOINT_STATE], unreadable='count')
        for k, path in enumerate((given.a, given.b))
    ]
    a, b = (renamed(log, dict(given.rename)) for log in logs)
    found = compare.compare(a, b, tolerance=given.tolerance, topics=topics, lag=given.lag)
    if given.json:
        _print_json(compare.as_json(found))
    else:
        print_lines(compare.lines(found))
    _plot(found.curves, (given.a, given.b), given.plot)
    lost = [line for log in logs for line in log.lost(log)]
    return status_of(given, lost) or int(not found.within)


def _recover_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('log', type=Path, metavar='LOG.mcap')
    out = 'default: ./LOG.recovered.mcap; never over an existing file'
    parser.add_argument('--out', type=Path, metavar='FILE', help=out)


def _recover(given: argparse.Namespace) -> int:
    """Recover a log; status 0 also if parts of it are lost, which are printed."""
    from pfd_ros.recording.recover import recover

    target = given.out or free_path(Path(given.log.with_suffix('.recovered.mcap').name))
    found = recover(given.log, target)
    print_lines(f'lost       {part}' for part in found.lost)
    if found.losses > len(found.lost):
        print_lines([f'lost       {found.losses} parts in all'])
    state = 'the log was incomplete' if found.lost else 'the log was whole'
    print_lines([f'{found.messages} messages in {target}; {state}'])
    return 0


COMMANDS = {
    'replay': Command(
        'verify a recording, or simulate it again with changes; or publish a log',
        'pfd replay run.mcap --verify',
        _replay_arguments,
        _replay,
        lambda given: bool(given.publish or 'process' in given),
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
