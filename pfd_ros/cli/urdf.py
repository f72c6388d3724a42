# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd urdf`: the URDF of a robot, for programs that read no other format."""

from __future__ import annotations

import argparse
import io
from pathlib import Path
import sys

import pfd_core as pfd

HELP = 'write the URDF of a robot'
EXAMPLE = 'pfd urdf puma560 --out puma560.urdf'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the robot and the file."""
    parser.add_argument(
        'robot', help='a robot that `pfd robots` lists, or a .urdf, .xacro or .yaml file'
    )
    parser.add_argument('--out', type=Path, metavar='FILE', help='file to write instead of stdout')


def run(given: argparse.Namespace) -> int:
    """Print the URDF, or write it to a file."""
    text = pfd.urdf_of(given.robot)
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
