# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd init`: a controller package for an arm, with tests that pass."""

from __future__ import annotations

import argparse
from pathlib import Path
import warnings

from pfd_ros.cli.terminal import ANY_LOG, Command, print_lines
from pfd_ros.text import listed


def _arguments(parser: argparse.ArgumentParser) -> None:
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


def _run(given: argparse.Namespace) -> int:
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
    'init': Command(
        'write a controller package for an arm, with tests that pass',
        'pfd init my_arm --urdf arm.urdf',
        _arguments,
        _run,
    )
}
