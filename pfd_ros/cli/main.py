# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The command `pfd`; nothing here needs ROS before a command is chosen that does."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import importlib.util
import os
from pathlib import Path
import sys

from pfd_ros.text import one_line

REPORTS = {
    'counts': 'counts: steps of every method beside what the paper claims',
    'speed': 'speed: times beside those of other libraries, some ten minutes',
}
# Exit status of a program that Ctrl-C ended, as shells have it.
INTERRUPTED = 130
NO_ROS = (
    'this needs ROS 2 (rclpy), which this Python does not have; '
    "install it with: pip install 'pfd_ros[ros]'"
)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='pfd', description='A stand-in robot arm: torques in, simulated joint states out.'
    )
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')
    demo = commands.add_parser(
        'demo', help='the arm and a controller as two ROS 2 processes for a few seconds'
    )
    demo.add_argument('--seconds', type=float, default=5.0, help='length of the motion, s')
    demo.add_argument('--robot', default='puma560', help='a robot that `pfd robots` lists')
    demo.add_argument('--out', type=Path, default=Path('pfd_demo'), help='folder for the results')
    demo.set_defaults(run=_demo)
    sim = commands.add_parser('sim', help='the node; takes --ros-args as every ROS 2 node does')
    sim.add_argument('--robot', help='robot to simulate, the same as -p robot:=...')
    sim.set_defaults(run=_sim)
    replay = commands.add_parser('replay', help='look at a recording, or check it bit for bit')
    replay.add_argument('log', type=Path, metavar='LOG.mcap')
    replay.add_argument(
        '--verify', action='store_true', help='simulate it again; fail at the first differing bit'
    )
    replay.set_defaults(run=_replay)
    report = commands.add_parser('report', help='tables and plots, measured here and now')
    report.add_argument('what', choices=REPORTS, help='; '.join(REPORTS.values()))
    report.add_argument(
        '--out', type=Path, help='folder for the pages; default ./pfd_report', metavar='DIR'
    )
    report.set_defaults(run=_report)
    robots = commands.add_parser('robots', help='the robots it knows')
    robots.set_defaults(run=_robots)
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status: 0 only if it did what was asked."""
    given = list(sys.argv[1:] if args is None else args)
    # What follows belongs to ROS, and is not for argparse to understand.
    cut = given.index('--ros-args') if '--ros-args' in given else len(given)
    chosen = _parser().parse_args(given[:cut])
    chosen.ros_args = given[cut:]
    if chosen.ros_args and chosen.command != 'sim':
        print(f'pfd: {chosen.command} takes no --ros-args', file=sys.stderr)
        return 2
    try:
        status: int = chosen.run(chosen)
        # Here, while a full disk or a closed pipe can still be told.
        if sys.stdout is not None:
            sys.stdout.flush()
    except (ValueError, OSError) as error:
        _give_up_output()
        if sys.stderr is not None:
            print(one_line(f'pfd {chosen.command}: {error}'), file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        _give_up_output()
        return INTERRUPTED
    return status


def _give_up_output() -> None:
    """Flush what can be flushed; where nobody reads it, Python would say so once more at exit."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except (ValueError, OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _has_ros() -> bool:
    if importlib.util.find_spec('rclpy') is None:
        print(f'pfd: {NO_ROS}', file=sys.stderr)
        return False
    return True


def _demo(chosen: argparse.Namespace) -> int:
    if not _has_ros():
        return 1
    from pfd_ros.demo.processes import run_demo

    return run_demo(chosen.robot, chosen.seconds, chosen.out)


def _sim(chosen: argparse.Namespace) -> int:
    if not _has_ros():
        return 1
    from pfd_ros.node import main as node

    robot = [] if chosen.robot is None else ['--ros-args', '-p', f'robot:={chosen.robot}', '--']
    return node.main([*robot, *chosen.ros_args])


def _replay(chosen: argparse.Namespace) -> int:
    from pfd_ros.cli import replay as replay_text

    return replay_text.run(chosen.log, verify=chosen.verify)


def _report(chosen: argparse.Namespace) -> int:
    from pfd_core.report import counts_pages, speed_pages

    folder = chosen.out or Path('pfd_report')
    if chosen.what == 'speed':
        return speed_pages.run(folder)
    pages = counts_pages.run(folder)
    print('\n'.join(str(page) for page in pages))
    return 0


def _robots(chosen: argparse.Namespace) -> int:
    import pfd_core as pfd

    for name in pfd.known_robots():
        robot = pfd.load_robot(name)
        print(f'{name:20s} {robot.n} joints: {", ".join(robot.joint_names)}')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
