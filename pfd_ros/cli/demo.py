# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd demo`: the arm and a controller as two ROS 2 processes for a few seconds."""

from __future__ import annotations

import argparse
from pathlib import Path

from pfd_ros.cli.terminal import add_view, ended_by_signals
from pfd_ros.view.ports import PORT

HELP = 'run the arm and a controller as two ROS 2 processes for a few seconds'
EXAMPLE = 'pfd demo --robot panda --seconds 20 --view'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the length, the robot and the folder."""
    parser.add_argument('--seconds', type=float, default=5.0, help='length of the motion, s')
    parser.add_argument('--robot', default='puma560', help='a robot that `pfd robots` lists')
    parser.add_argument(
        '--out', type=Path, default=Path('pfd_demo'), help='folder for the results'
    )
    add_view(parser, PORT)


def run(given: argparse.Namespace) -> int:
    """Run the demo; 0 only if all of it worked."""
    from pfd_ros.demo.processes import run_demo

    with ended_by_signals():
        return run_demo(given.robot, given.seconds, given.out, given.port if given.view else None)
