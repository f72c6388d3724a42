# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The facts of any log that `pfd info` prints: its size, times, topics and their intervals."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from pfd_ros.messages.types import JOINT_STATE
from pfd_ros.recording.arrays import COUNT, LogArrays, decoder_of, read_log


def facts(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what a log contains, ready for JSON; times in ns.

    Intervals of JointStates are those of a joint, the longest of all joints: several publishers
    may share a topic. `obstacle` says why a topic cannot be read, and `unreadable`
    counts JointStates that cannot be decoded.

    Raises
    ------
    LogError, OSError
        As `read_log`.
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
        'begin_ns': min((int(t[0]) for t in times), default=None),
        'end_ns': max((int(t[-1]) for t in times), default=None),
        'messages': sum(map(len, times)),
        'topics': {name: _topic(log, name) for name in sorted(log.topics)},
        'settings': log.settings,
        'end': log.end,
    }


def _topic(log: LogArrays, name: str) -> dict[str, Any]:
    topic, received, obstacle, unreadable = log.bag.topics[name], log.received_ns[name], '', 0
    trains = [received]
    try:
        if name in log:
            states = log[name]
            unreadable = states.unreadable
            trains = [states.log_ns[states.rows(joint)] for joint in states.names] or trains
        elif len(received):
            decoder_of(topic)
    except ValueError as error:
        obstacle = str(error)
    intervals = [np.diff(train) for train in trains if len(train) > 1]
    return {
        'type': topic.type,
        'encoding': topic.encoding,
        'qos': topic.qos,
        'messages': len(received),
        'bytes': log.sizes[name],
        'median_interval_ns': max((float(np.median(x)) for x in intervals), default=None),
        'longest_gap_ns': max((int(x.max()) for x in intervals), default=None),
        'unreadable': unreadable,
        'obstacle': obstacle,
    }
