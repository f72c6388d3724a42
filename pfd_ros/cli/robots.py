# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd robots`: the included robots, with their joints."""

from __future__ import annotations

import argparse

import pfd_core as pfd

HELP = 'list the included robots'
EXAMPLE = 'pfd robots'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare nothing."""


def run(given: argparse.Namespace) -> int:
    """Print one line for each robot."""
    for name in pfd.known_robots():
        robot = pfd.load_robot(name)
        print(f'{name:20s} {robot.n} joints: {", ".join(robot.joint_names)}')
    return 0
