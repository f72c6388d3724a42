# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The facts of any log that `pfd info` prints: its size, times, topics and their intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import os
from pathlib import Path
from typing import Any

import numpy as np

from pfd_ros.arm.events import INPUTS
from pfd_ros.arm.settings import FIELDS
from pfd_ros.messages.types import JOINT_STATE
from pfd_ros.recording.arrays import COUNT, LogArrays, read_log
from pfd_ros.recording.topic_arrays import decoder_of


@dataclass(frozen=True)
class TopicFacts:
    """A topic of a log: its messages, and the intervals between them by log time.

    Intervals of JointStates are those of a joint, the longest of all joints: several publishers
    may share a topic. `obstacle` says why the topic, or which inputs of ours, cannot be decoded,
    and `unreadable` how many other JointStates cannot; both are '' otherwise.
    """

    type: str
    encoding: str
    qos: str
    messages: int
    median_interval_ns: float | None
    longest_gap_ns: int | None
    unreadable: str
    obstacle: str


@dataclass(frozen=True)
class Facts:
    """What a log contains; `settings` and `end` are of a recording of ours, else None and {}.

    `simulated` says whether log times are simulated time.
    """

    path: str
    files: list[str]
    bytes: int
    complete: bool
    simulated: bool
    begin_ns: int | None
    end_ns: int | None
    messages: int
    topics: dict[str, TopicFacts]
    settings: Mapping[str, Any] | None
    end: Mapping[str, Any]


def by_parameter(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a recording by the names of parameters, as --what-if takes them."""
    names = {row.field: row.name for row in FIELDS}
    return {names.get(name, name): value for name, value in settings.items()}


def facts(path: str | os.PathLike[str]) -> Facts:
    """Return what a log contains; LogError and OSError as `read_log`."""
    log = read_log(path, types=[JOINT_STATE], unreadable=COUNT)
    times = [received for received in log.received_ns.values() if len(received)]
    files = log.bag.files()
    # The description of a folder is a part of it.
    parts = list(Path(path).iterdir()) if Path(path).is_dir() else files
    return Facts(
        str(path),
        [str(file) for file in files],
        sum(file.stat().st_size for file in parts),
        log.complete,
        log.simulated,
        min((int(received[0]) for received in times), default=None),
        max((int(received[-1]) for received in times), default=None),
        sum(map(len, times)),
        {name: _topic(log, name) for name in sorted(log.topics)},
        None if log.settings is None else by_parameter(log.settings),
        log.end,
    )


def _topic(log: LogArrays, name: str) -> TopicFacts:
    topic, received, obstacle, unreadable = log.bag.topics[name], log.received_ns[name], '', ''
    trains = [received]
    try:
        if name in log:
            states = log[name]
            trains = [states.log_ns[states.rows(joint)] for joint in states.names] or trains
            if states.unreadable and log.roles.get(name) in INPUTS:
                obstacle = (
                    f'{states.unreadable} of {len(received)} messages, which the node refused'
                )
            elif states.unreadable:
                unreadable = f'{states.unreadable} of {len(received)} messages cannot be read'
        elif len(received):
            decoder_of(topic)
    except ValueError as error:
        obstacle = str(error)
    intervals = [np.diff(train) for train in trains if len(train) > 1]
    return TopicFacts(
        topic.type,
        topic.encoding,
        topic.qos,
        len(received),
        max((float(np.median(x)) for x in intervals), default=None),
        max((int(x.max()) for x in intervals), default=None),
        unreadable,
        obstacle,
    )
