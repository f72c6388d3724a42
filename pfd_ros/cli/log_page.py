# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd report log`: the HTML page of a log."""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

import pfd_core as pfd
from pfd_ros.cli.terminal import add_logs, progress_on
from pfd_ros.page.html import write_page
from pfd_ros.page.reading import read_contents
from pfd_ros.text import one_line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the log and the page."""
    add_logs(parser, 'MCAP or .db3 file, rosbag2 folder; or all files of one run, or their folder')
    parser.add_argument(
        '--out',
        type=Path,
        # A default would replace a file named before `log`.
        default=argparse.SUPPRESS,
        metavar='FILE',
        help='the page, never over an existing file; default ./NAME.html for NAME.mcap',
    )
    parser.add_argument(
        '--robot',
        help='the robot of a log that holds none, for its limits: a name that `pfd robots` lists, '
        'or a file',
    )


def run(given: argparse.Namespace) -> int:
    """Write the page, and print what went wrong first and the path.

    Raises
    ------
    LogError
        If the file is not a log, or has nothing to show.
    OSError
        If the page exists, or a file cannot be read or written.
    """
    name = given.logs[0].absolute().name.removesuffix('.mcap')
    path = getattr(given, 'out', Path(f'{name}.html'))
    if path.exists():
        raise FileExistsError(f'{path} exists and is not overwritten; choose another --out')
    robot = None if given.robot is None else pfd.load_robot(given.robot)
    contents = read_contents(given.logs, robot=robot, progress=progress_on(sys.stderr))
    write_page(contents, path)
    first = contents.first
    if first is None:
        print('nothing went wrong')
    else:
        joint = f'{first.joint}: ' if first.joint else ''
        print(one_line(f'first: t = {first.time:.3f} s, {first.kind}: {joint}{first.text}'))
    for note in contents.notes:
        print(one_line(f'note: {note}'))
    print(path)
    return 0
