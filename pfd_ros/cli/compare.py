# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd compare`: how two logs differ, joint by joint."""

from __future__ import annotations

import argparse
from dataclasses import asdict, fields
from pathlib import Path

from pfd_ros.cli.terminal import print_json, print_lines
from pfd_ros.messages.convert import JOINT_FIELDS
from pfd_ros.recording.arrays import read_log
from pfd_ros.replay.compare import Comparison, compare

HELP = 'compare two logs, joint by joint'
EXAMPLE = 'pfd compare real.mcap simulated.mcap --tolerance 0.01'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the logs and what is compared."""
    parser.add_argument(
        'a',
        type=Path,
        metavar='A',
        help='MCAP file, .db3 file, rosbag2 folder, or folder with the files of one run',
    )
    parser.add_argument('b', type=Path, metavar='B')
    parser.add_argument(
        '--tolerance',
        type=float,
        default=0.0,
        metavar='X',
        help='differences up to X count as equal, in the unit of each field (default 0)',
    )
    parser.add_argument(
        '--fields',
        nargs='+',
        choices=JOINT_FIELDS,
        default=JOINT_FIELDS,
        help='fields to compare (default all)',
    )
    parser.add_argument(
        '--topics', nargs=2, metavar=('TOPIC_A', 'TOPIC_B'), help='one topic of each log'
    )
    parser.add_argument(
        '--lag', type=float, metavar='S', help='lag of B (default: estimated from the positions)'
    )
    parser.add_argument('--json', action='store_true', help='print JSON')
    parser.add_argument('--plot', type=Path, metavar='FILE', help='plot both logs (.png, .svg)')


def run(given: argparse.Namespace) -> int:
    """Compare two logs; the status is 0 if all differences are within the tolerance, else 1."""
    topics = tuple(given.topics) if given.topics else None
    logs = [
        read_log(path, topics=[topics[k]] if topics else None)
        for k, path in enumerate((given.a, given.b))
    ]
    found = compare(
        *logs, tolerance=given.tolerance, fields=given.fields, topics=topics, lag=given.lag
    )
    if given.json:
        print_json(as_json(found))
    else:
        print_lines(lines_of(found))
    if given.plot:
        from pfd_ros.replay.plots import plot_comparison

        plot_comparison(found, (str(given.a), str(given.b)), given.plot)
    return 0 if found.within else 1


def as_json(found: Comparison) -> dict[str, object]:
    """Return a comparison without its curves."""
    values = {f.name: getattr(found, f.name) for f in fields(found) if f.name != 'curves'}
    differences = [asdict(item) for item in found.differences]
    return {'within': found.within, **values, 'differences': differences}


def lines_of(found: Comparison) -> list[str]:
    """Return a comparison as lines."""
    shift = f', after a shift of {found.shift:.6f} s between their starts' if found.shift else ''
    lines = [f'lag of B {found.lag * 1e3:.3f} ms{shift}; {found.overlap:.3f} s compared']
    for name, joints in (('A', found.only_in_a), ('B', found.only_in_b)):
        lines += [f'only in {name}: {joint}' for joint in joints]
    lines += [f'different, without increasing stamps: {topic}' for topic in found.unordered]
    if found.uncovered:
        lines.append(f'not compared: {found.uncovered:.3f} s, which only one of the logs covers')
    width = max((len(item.joint) for item in found.differences), default=0)
    for topic in dict.fromkeys(item.topic for item in found.differences):
        lines.append(f'{topic}')
        for item in (item for item in found.differences if item.topic == topic):
            where = (
                f'first beyond {found.tolerance:g} at {item.first_at:.6f} s'
                if item.first_at is not None
                else 'equal'
                if item.largest == 0
                else f'within {found.tolerance:g}'
            )
            lines.append(
                f'  {item.field:9}{item.joint:{width}}  rms {item.rms:.3e}  largest '
                f'{item.largest:.3e} at {item.largest_at:.6f} s  {where}'
            )
    return lines
