# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd recover`: a whole MCAP file from one that was cut off or damaged."""

from __future__ import annotations

import argparse
from pathlib import Path

from pfd_ros.recording.recover import recover
from pfd_ros.text import one_line

HELP = 'write all readable messages of a truncated or damaged log to a new file'
EXAMPLE = 'pfd recover cut.mcap --out whole.mcap'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare both files."""
    parser.add_argument('log', type=Path, metavar='LOG.mcap')
    parser.add_argument(
        '--out', type=Path, metavar='FILE', help='default: LOG.recovered.mcap; it must not exist'
    )


def run(given: argparse.Namespace) -> int:
    """Recover a log; the status is 0 also if parts of it are lost, which are printed."""
    target = given.out or given.log.with_suffix('.recovered.mcap')
    found = recover(given.log, target)
    for part in found.lost:
        print(one_line(f'lost       {part}'))
    if found.lost_parts > len(found.lost):
        print(f'lost       {found.lost_parts - len(found.lost)} more parts')
    state = 'the log was incomplete' if found.lost_parts else 'the log was whole'
    print(one_line(f'{found.messages} messages in {target}; {state}'))
    return 0
