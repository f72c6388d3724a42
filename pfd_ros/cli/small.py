# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd sim`, `pfd demo`, `pfd robots` and `pfd urdf`.

Imports nothing that takes long: the node starts with its handlers of signals.
"""

from __future__ import annotations

import argparse
from functools import partial
import io
import json
from pathlib import Path
import sys
import warnings

from pfd_ros.cli.terminal import Command, add_view, ended_by_signals
from pfd_ros.view.ports import check_page, view_process


def _sim_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--robot', help='robot to simulate, the same as -p robot:=...')
    add_view(parser)
    # The node reports errors in others.
    parser.add_argument(
        'words', nargs='*', metavar='NAME:=VALUE', help='arguments of the .xacro file of --robot'
    )


def _sim(given: argparse.Namespace) -> int:
    """Run the node until it is stopped; return its exit status."""
    from pfd_ros.node import main as node

    view = None
    if given.view:
        check_page(given.port)
        view = partial(view_process, port=given.port)
    words, ros = given.words, []
    if given.robot is not None:
        xacro = [word for word in words if ':=' in word]
        words = [word for word in words if ':=' not in word]
        ros = ['--ros-args', '-p', f'robot:={given.robot}']
        ros += ['-p', f'xacro_args:={json.dumps(xacro)}', '--'] if xacro else ['--']
    return node.main([*words, *ros, *given.ros_args], given.stop, view)


def _demo_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--seconds', type=float, default=5.0, help='length of the motion, s')
    parser.add_argument('--robot', default='puma560', help='a robot that `pfd robots` lists')
    parser.add_argument(
        '--out', type=Path, default=Path('pfd_demo'), help='folder for the results'
    )
    add_view(parser)


def _demo(given: argparse.Namespace) -> int:
    """Run the demo; 0 only if all of it worked."""
    from pfd_ros.demo.run import run_demo

    with ended_by_signals():
        return run_demo(given.robot, given.seconds, given.out, given.port if given.view else None)


def _robots(_: argparse.Namespace) -> int:
    """Print each robot, where its description is, and the effects that it has values for."""
    import pfd_core as pfd
    from pfd_ros.arm.advice import stated

    absent = ''
    for name in (*pfd.known_robots(), *pfd.known_robots(described=True)):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter('ignore', pfd.PhysicsWarning)
                robot = pfd.load_robot(name)
        except ValueError as error:
            print(f'{name:10s} {str(error).partition(". Get one")[0]}')
            absent = name
            continue
        print(f'{name:10s} {robot.n} joints: {", ".join(robot.joint_names)}')
        has = stated(robot)
        lacks = ', '.join(key for key in has if not has[key])
        found = ', '.join(filter(has.get, has)) + (lacks and f'; none for {lacks}')
        file = pfd.find_description(name)
        print(f'{"":10s} values for {found}' + (f'\n{"":10s} {file}' if file else ''))
    if absent:
        print(f'\n`pfd urdf {absent}` says how to get it, and so for each')
    return 0


def _urdf_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        'robot', help='a robot that `pfd robots` lists, or a URDF, xacro or YAML file'
    )
    parser.add_argument('words', nargs='*', metavar='NAME:=VALUE', help='arguments of a .xacro')
    parser.add_argument('--out', type=Path, metavar='FILE', help='file to write instead of stdout')


def _urdf(given: argparse.Namespace) -> int:
    import pfd_core as pfd
    from pfd_ros.arm.description import xacro_arguments

    text = pfd.urdf_of(given.robot, xacro_arguments(given.words))
    if given.out is None:
        if sys.stdout is None:
            raise OSError('no standard output; use --out')
        if isinstance(sys.stdout, io.TextIOWrapper):
            # In any locale, as a file.
            sys.stdout.reconfigure(encoding='utf-8')
        print(text, end='')
    else:
        given.out.write_text(text, encoding='utf-8')
    return 0


COMMANDS = {
    'sim': Command(
        'run the simulated arm; accepts --ros-args like every ROS 2 node',
        'pfd sim --robot ur5 --view --ros-args -p recording:=run.mcap',
        _sim_arguments,
        _sim,
        lambda _: True,
    ),
    'demo': Command(
        'run the arm and a controller as two ROS 2 processes for a few seconds',
        'pfd demo --robot panda --seconds 20 --view',
        _demo_arguments,
        _demo,
        lambda _: True,
    ),
    'robots': Command(
        'list the robots by name: joints, effects with values, descriptions on disk',
        'pfd robots',
        lambda _: None,
        _robots,
    ),
    'urdf': Command(
        'write the URDF of a robot',
        'pfd urdf puma560 --out puma560.urdf',
        _urdf_arguments,
        _urdf,
    ),
}
