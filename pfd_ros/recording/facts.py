# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The facts of any log that `pfd info` prints: its size, times, topics and their intervals."""

from __future__ import annotations

from collections.abc import Mapping
import os
from pathlib import Path
from typing import Any

import numpy as np

from pfd_ros.arm.settings import FIELDS, PER_JOINT
from pfd_ros.messages.types import JOINT_STATE
from pfd_ros.recording.arrays import COUNT, LogArrays, read_log
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

    `simulated` says whether log times are simulated time; `settings` and `end` are of a recording
    of ours, else None and {}. Intervals of JointStates are those of a joint, the longest of all
    joints: several publishers may share a topic. `obstacle` says why a topic, or which inputs of
    ours, cannot be decoded, and `unreadable` how many other JointStates cannot, else ''.
    """
    log = read_log(path, types=[JOINT_STATE], unreadable=COUNT)
    times = [received for received in log.received_ns.values() if len(received)]
    files = log.bag.files()
    # The description of a folder is a part of it.
    parts = list(Path(path).iterdir()) if Path(path).is_dir() else files
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
        'end': log.end,
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
