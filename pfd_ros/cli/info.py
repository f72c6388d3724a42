# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd info`: the topics of a log, and the run of a recording of the node."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timezone
import statistics
from typing import Any

from pfd_ros.arm.events import Verdict
from pfd_ros.arm.settings import SIMULATED
from pfd_ros.cli.replay import describe
from pfd_ros.cli.terminal import add_logs, print_json, print_lines
from pfd_ros.messages.convert import NANOSECONDS
from pfd_ros.recording.bags import Bag, bag_of
from pfd_ros.replay.summary import Summary
from pfd_ros.replay.verify import read_run
from pfd_ros.text import one_line

HELP = 'list the topics, times and settings of a log'
EXAMPLE = 'pfd info run.mcap'
# Intervals between messages kept for the median of a topic; later ones are not in it.
INTERVALS = 100_000


@dataclass
class TopicCount:
    """Messages of a topic: count, bytes, and the intervals between them [ns], by log time."""

    count: int = 0
    size: int = 0
    last_ns: int = 0
    longest_ns: int = 0
    intervals_ns: list[int] = field(default_factory=list)

    def add(self, log_ns: int, size: int) -> None:
        """Count one message."""
        if self.count:
            interval = log_ns - self.last_ns
            self.longest_ns = max(self.longest_ns, interval)
            if len(self.intervals_ns) < INTERVALS:
                self.intervals_ns.append(interval)
        self.count += 1
        self.size += size
        self.last_ns = log_ns


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the log."""
    add_logs(parser, 'MCAP or .db3 file, rosbag2 folder; or all files of one run, or their folder')
    parser.add_argument('--json', action='store_true', help='print JSON')


def run(given: argparse.Namespace) -> int:
    """Print the contents of a log.

    Raises
    ------
    LogError
        If the file is not a log, or is damaged before its end.
    OSError
        If it cannot be read.
    """
    bag = bag_of(given.logs)
    counts: dict[str, TopicCount] = {}
    first, last = None, 0
    for message in bag.messages():
        counts.setdefault(message.topic, TopicCount()).add(message.log_ns, len(message.data))
        first = message.log_ns if first is None else min(first, message.log_ns)
        last = max(last, message.log_ns)
    for topic in bag.topics:
        counts.setdefault(topic, TopicCount())
    span = (first or 0, last)
    run_of_node = None
    # A folder of rosbag2 with several files is none.
    if bag.head and (bag.of_one_run or len(bag.files()) == 1):
        run_of_node = read_run(bag.files()).merged
    settings = (bag.settings if run_of_node else None) or {}
    if given.json:
        print_json(as_json(bag, counts, span, run_of_node, settings))
        return 0
    simulated = run_of_node is not None and run_of_node.settings.log_time == SIMULATED
    print_lines(lines_of(bag, counts, span, simulated=simulated))
    if run_of_node is not None:
        print()
        for line in describe(run_of_node)[1:]:
            print(line)
        print(f'replay     {_replay(run_of_node, bag)}')
        values = ', '.join(f'{name}={value}' for name, value in settings.items())
        print(one_line(f'settings   {values}', 4000))
    return 0


def _size(bag: Bag) -> int:
    # The description of a folder of rosbag2 is a part of it.
    alone = bag.path.is_dir() and not bag.of_one_run
    return sum(file.stat().st_size for file in (bag.path.iterdir() if alone else bag.files()))


def _date(ns: int) -> str:
    try:
        return datetime.fromtimestamp(ns / NANOSECONDS, timezone.utc).isoformat(sep=' ')
    except (ValueError, OverflowError, OSError):
        return f'{ns} ns'  # later than the year 9999


def _simulated(ns: int) -> str:
    return f'{ns / NANOSECONDS:.6f} s of simulated time'


def _replay(run_of_node: Summary, bag: Bag) -> str:
    """Return whether a recording can be replayed."""
    if not run_of_node.states:
        return 'not possible: the recording has no states'
    if run_of_node.obstacle:
        return f'up to a gap: it {run_of_node.obstacle}'
    if run_of_node.dropped:
        return f'of what is there; {run_of_node.dropped} messages were not recorded'
    if bag.absent:
        return f'of what is there; missing: {", ".join(bag.absent)}'
    if bag.of_one_run:
        return 'can be verified with `pfd replay LOG ... --verify`, with all files or their folder'
    if run_of_node.part > 1 or run_of_node.continues:
        return (
            f'as part {run_of_node.part} of a run: `pfd replay LOG ... --verify` with all its '
            'files'
        )
    return 'can be verified with `pfd replay LOG --verify`'


def lines_of(
    bag: Bag, counts: Mapping[str, TopicCount], span: tuple[int, int], *, simulated: bool = False
) -> list[str]:
    """Return the lines about any log, as `ros2 bag info` has them."""
    shown = _simulated if simulated else _date
    total = sum(found.count for found in counts.values())
    lines = [
        f'log        {bag.path}',
        f'size       {_size(bag) / 1e6:.3f} MB{"" if bag.complete else ", cut off"}',
    ]
    if bag.of_one_run:
        lines.append(f'files      {len(bag.files())} of one run')
        lines += [f'missing    {absent}' for absent in bag.absent]
    lines.append(f'messages   {total}')
    if total:
        lines += [
            f'begin      {shown(span[0])}',
            f'end        {shown(span[1])}',
            f'length     {(span[1] - span[0]) / NANOSECONDS:.6f} s',
        ]
    if not counts:
        return lines
    names = max(len(name) for name in counts)
    kinds = max(len(topic.type) for topic in bag.topics.values())
    for name, found in sorted(counts.items()):
        line = f'topic      {name:{names}}  {bag.topics[name].type:{kinds}}  {found.count:8}'
        if found.intervals_ns:
            median = statistics.median(found.intervals_ns) * 1e-6
            line += f'  every {median:.3f} ms, longest gap {found.longest_ns * 1e-6:.3f} ms'
        lines.append(line)
    return lines


def as_json(
    bag: Bag,
    counts: Mapping[str, TopicCount],
    span: tuple[int, int],
    run_of_node: Summary | None,
    settings: Mapping[str, Any],
) -> dict[str, Any]:
    """Return what a log contains, with times in ns."""
    total = sum(item.count for item in counts.values())
    found: dict[str, Any] = {
        'path': str(bag.path),
        'files': [str(path) for path in bag.files()],
        'absent': bag.absent,
        'bytes': _size(bag),
        'complete': bag.complete,
        'begin_ns': span[0] if total else None,
        'end_ns': span[1] if total else None,
        'messages': total,
        'topics': {
            name: {
                'type': bag.topics[name].type,
                'encoding': bag.topics[name].encoding,
                'qos': bag.topics[name].qos,
                'messages': item.count,
                'bytes': item.size,
                'median_interval_ns': (
                    statistics.median(item.intervals_ns) if item.intervals_ns else None
                ),
                'longest_gap_ns': item.longest_ns if item.intervals_ns else None,
            }
            for name, item in sorted(counts.items())
        },
    }
    if run_of_node is not None:
        inputs = {verdict.label: count for verdict, count in run_of_node.verdicts.items()}
        accepted = inputs.pop(Verdict.ACCEPTED.label, 0)
        found['run'] = {
            'robot': run_of_node.settings.robot,
            'settings': dict(settings),
            'log_time': run_of_node.settings.log_time,
            'versions': run_of_node.versions,
            'part': run_of_node.part,
            'continues': run_of_node.continues,
            'first_step': run_of_node.start + 1,
            'steps': run_of_node.simulated,
            'simulated_seconds': run_of_node.simulated * run_of_node.settings.step_size,
            'wall_seconds': run_of_node.seconds,
            'states': run_of_node.states,
            'rate': run_of_node.rate,
            'accepted': accepted,
            'rejected': inputs,
            'missing': run_of_node.lost,
            'failure': run_of_node.failure,
            'can_be_replayed': bool(run_of_node.states) and not run_of_node.obstacle,
            'complete': run_of_node.complete,
        }
    return found
