# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd sim`: the node."""

from __future__ import annotations

import argparse

from pfd_ros.cli.terminal import add_view
from pfd_ros.view.ports import PORT, check_page

HELP = 'run the simulated arm; accepts --ros-args like every ROS 2 node'
EXAMPLE = 'pfd sim --robot ur5 --view --ros-args -p recording:=run.mcap'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the robot; other arguments are for ROS."""
    parser.add_argument('--robot', help='robot to simulate, the same as -p robot:=...')
    add_view(parser, PORT)
    # The node reports errors in these.
    parser.add_argument('words', nargs='*', help=argparse.SUPPRESS)


def run(given: argparse.Namespace) -> int:
    """Run the node until it is stopped; return its exit status."""
    from pfd_ros.node import main as node

    view = None
    if given.view:
        from pfd_ros.view.process import ViewProcess

        check_page(given.port)
        view = ViewProcess(given.port)
    robot = [] if given.robot is None else ['--ros-args', '-p', f'robot:={given.robot}', '--']
    return node.main([*given.words, *robot, *given.ros_args], given.stop, view)
