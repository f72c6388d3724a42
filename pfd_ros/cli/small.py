# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd sim`, `pfd demo`, `pfd robots`, `pfd urdf` and `pfd init`.

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

from pfd_ros.cli.terminal import ANY_LOG, ROBOT, Command, add_view, ended_by_signals, print_lines
from pfd_ros.files import new_file
from pfd_ros.text import listed
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
    parser.add_argument('robot', help=ROBOT)
    parser.add_argument('words', nargs='*', metavar='NAME:=VALUE', help='arguments of a .xacro')
    parser.add_argument(
        '--out', type=Path, metavar='FILE', help='new file to write instead of stdout'
    )


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
        with new_file(given.out, 'x', encoding='utf-8') as stream:
            stream.write(text)
    return 0


def _init_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('name', metavar='NAME', help='the package, a new folder of this name')
    arm = parser.add_mutually_exclusive_group()
    arm.add_argument('--urdf', metavar='FILE', help='the arm: a URDF, xacro, MJCF or YAML file')
    arm.add_argument('--robot', metavar='R', help='the arm: a robot that `pfd robots` lists')
    log = f'the arm of a log; with --urdf or --robot only its rate and start: {ANY_LOG}'
    parser.add_argument('--bag', type=Path, metavar='LOG', help=log)
    tip = 'last link of the arm, in a model with a gripper or two arms; joints beyond are locked'
    parser.add_argument('--tip', default='', metavar='LINK', help=tip)
    control = 'connect arm and controller through ros2_control, over topics'
    parser.add_argument('--ros2-control', action='store_true', help=control)


def _init(given: argparse.Namespace) -> int:
    """Write the package and print what was chosen."""
    from pfd_ros.starter.arm import arm_of
    from pfd_ros.starter.plan import plan_of
    from pfd_ros.starter.write import check_name, write_package

    check_name(given.name)
    source = given.robot if given.urdf is None else given.urdf
    if source is None and given.bag is None:
        raise ValueError('no arm; name one with --urdf FILE, --robot NAME or --bag LOG')
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter('default')
        arm = arm_of(source, given.bag, given.tip)
        try:
            plan = plan_of(arm)
        except ValueError as error:
            # A note may name the cure, such as the tip before a gripper.
            raise ValueError('; '.join([str(error), *arm.notes])) from error
    write_package(given.name, arm, plan, given.ros2_control)
    locked = f', locked {listed(arm.settings.locked)}' if arm.settings.locked else ''
    joints = listed(arm.robot.joint_names)
    print_lines([f'{arm.robot.name}: joints {joints}, tip {arm.robot.tip!r}{locked}'])
    notes = dict.fromkeys([*arm.notes, *(str(warning.message) for warning in found)])
    print_lines(f'note: {note}' for note in notes)
    print_lines([f'next: cd {given.name} && pytest && ./run.sh'])
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
    'init': Command(
        'write a controller package for an arm, with tests that pass',
        'pfd init my_arm --urdf arm.urdf',
        _init_arguments,
        _init,
    ),
}
