# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The facts of any log that `pfd info` prints: size, times, topics; of a recording its run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from datetime import datetime, timezone
import os
from pathlib import Path
from typing import Any

import numpy as np

from pfd_ros.arm.events import REJECTED, REJECTED_COUNTS
from pfd_ros.arm.settings import FIELDS, PER_JOINT
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.types import JOINT_STATE, STRING
from pfd_ros.recording.arrays import COUNT, LogArrays, read_log
from pfd_ros.recording.format import EndKey, HeadKey, damage_named
from pfd_ros.recording.log import table
from pfd_ros.recording.provenance import DECISIVE, versions
from pfd_ros.recording.topic_arrays import decoder_of


def by_parameter(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a recording by the names of parameters, as --what-if takes them.

    A switch for the values of the model and the numbers of each joint have one name, such as
    `friction`: numbers that are given take the place of the switch.
    """
    numbers = {row.field: row.name for row in PER_JOINT}
    names = {row.field: row.name for row in FIELDS}
    found = {names.get(k, k): value for k, value in settings.items() if k not in numbers}
    for field, name in numbers.items():
        if settings.get(field) or (field in settings and name not in found):
            found[name] = settings[field]
    return dict(sorted(found.items()))


def facts(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what a log contains, ready for JSON; LogError and OSError as `read_log`.

    `simulated` says whether log times are simulated time. Of a recording of ours are `settings`,
    `run` (robot, last cycle, simulated time [s], refused inputs by role and rule, with those of a
    flood that were only counted, and versions) and `end`; else None, None and {}. Intervals of
    JointStates are those of a joint, the longest of all joints: several publishers may share a
    topic. `obstacle` says why a topic, or which inputs of ours, cannot be decoded, and
    `unreadable` how many other JointStates and Strings cannot, else ''.
    """
    log = read_log(path, types=[JOINT_STATE, STRING], unreadable=COUNT)
    times = [received for received in log.received_ns.values() if len(received)]
    files = log.bag.files()
    # The description of a folder is a part of it.
    parts = list(Path(path).iterdir()) if Path(path).is_dir() else files
    with damage_named(log.path):
        run = None if log.settings is None else _run(log, log.settings)
    return {
        'path': str(path),
        'files': [str(file) for file in files],
        'bytes': sum(file.stat().st_size for file in parts),
        'complete': log.complete,
        'simulated': log.simulated,
        'begin_ns': min((int(received[0]) for received in times), default=None),
        'end_ns': max((int(received[-1]) for received in times), default=None),
        'messages': sum(map(len, times)),
        'topics': {name: _topic(log, name) for name in sorted(log.topics)},
        'settings': None if log.settings is None else by_parameter(log.settings),
        'run': run,
        'end': log.end,
    }


def _run(log: LogArrays, settings: Mapping[str, Any]) -> dict[str, Any]:
    rejected = Counter[str]()
    read = [topic for topic in log if not log.obstacle(topic)]
    for topic in read:
        role = log.roles.get(topic)
        for text in log[topic].data if role in (REJECTED, REJECTED_COUNTS) else ():
            kind, _, rest = text.partition('\n')
            rejected[kind] += int(rest.split()[0]) if role == REJECTED_COUNTS else 1
    cycles = log.end.get(EndKey.TOTALS, {}).get('cycles')
    if cycles is None:
        of_topics = [log[topic].cycle for topic in read]
        cycles = max((int(x[-1]) for x in of_topics if x is not None and len(x)), default=0)
    return {
        'robot': settings['robot'],
        'cycles': cycles,
        'seconds': cycles * settings['step_size'],
        'rejected': rejected,
        'versions': table(log.head, HeadKey.VERSIONS),
    }


def _topic(log: LogArrays, name: str) -> dict[str, Any]:
    topic, received, obstacle = log.bag.topics[name], log.received_ns[name], log.obstacle(name)
    trains, unreadable = [received], log.unread(name)
    if name in log and not obstacle:
        states = log[name]
        trains = [states.log_ns[states.rows(joint)] for joint in states.names] or trains
        if states.unreadable and not unreadable:
            lost = f'{states.unreadable} of {len(received)} messages'
            obstacle = f'{lost}, which the node refused'
    elif name not in log and len(received):
        try:
            decoder_of(topic)
        except ValueError as error:
            obstacle = str(error)
    intervals = [np.diff(train) for train in trains if len(train) > 1]
    return {
        'type': topic.type,
        'encoding': topic.encoding,
        'qos': topic.qos,
        'messages': len(received),
        'median_interval_ns': max((float(np.median(x)) for x in intervals), default=None),
        'longest_gap_ns': max((int(x.max()) for x in intervals), default=None),
        'unreadable': unreadable,
        'obstacle': obstacle,
    }


def lines(found: Mapping[str, Any]) -> Iterator[str]:
    """Yield the facts of a log as lines, as `ros2 bag info` has them."""
    begin, end, run = found['begin_ns'], found['end_ns'], found['run']
    totals = found['end'].get(EndKey.TOTALS, {})
    yield f'log        {found["path"]}'
    yield f'size       {found["bytes"] / 1e6:.3f} MB{"" if found["complete"] else ", cut off"}'
    yield f'messages   {found["messages"]}'
    if begin is not None and end is not None:
        yield f'begin      {_moment(begin, simulated=found["simulated"])}'
        yield f'end        {_moment(end, simulated=found["simulated"])}'
        yield f'length     {(end - begin) / NANOSECONDS:.6f} s'
    if run is not None:
        cycles = f'{run["cycles"]} cycles, {run["seconds"]:.3f} s simulated'
        yield f'run        {run["robot"]}, {cycles}'
        for kind, count in sorted(run['rejected'].items()):
            yield f'rejected   {count} {kind}'
        if why := totals.get('failure'):
            yield f'FAILED     the simulation stopped: {why}'
        elif count := totals.get('failures'):
            yield f'failed     the simulation stopped {count} times, and a reset cleared it'
        here, there = versions(), run['versions']
        for name in DECISIVE:
            if there.get(name, here[name]) != here[name]:
                yield f'note       recorded with {name} {there[name]}, this is {here[name]}'
    names = max(map(len, found['topics']), default=0)
    kinds = max((len(topic['type']) for topic in found['topics'].values()), default=0)
    for name, topic in found['topics'].items():
        line = f'topic      {name:{names}}  {topic["type"]:{kinds}}  {topic["messages"]:8}'
        if topic['median_interval_ns'] is not None and topic['longest_gap_ns'] is not None:
            median, gap = topic['median_interval_ns'] * 1e-6, topic['longest_gap_ns'] * 1e-6
            line += f'  every {median:.3f} ms, longest gap {gap:.3f} ms'
        yield line + (f'  not decoded: {topic["obstacle"]}' if topic['obstacle'] else '')
    for name, values in (('totals', totals), ('settings', found['settings'])):
        if values:
            yield f'{name:10} {", ".join(f"{key}={value}" for key, value in values.items())}'


def _moment(ns: int, *, simulated: bool) -> str:
    return f'{ns / NANOSECONDS:.6f} s of simulated time' if simulated else date_of(ns)


def date_of(ns: int) -> str:
    """Return a time of day in UTC, or the number of ns where no calendar has it."""
    try:
        return datetime.fromtimestamp(ns / NANOSECONDS, timezone.utc).isoformat(sep=' ')
    except (ValueError, OverflowError, OSError):
        return f'{ns} ns'  # later than the year 9999
