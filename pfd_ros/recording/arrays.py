# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd_ros.read_log`: the messages of any log as arrays by topic and field, without ROS.

Messages are decoded in blocks while the file is read, and their bytes are dropped. All arrays are
in the order of the log times.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.events import DESCRIPTION, INPUTS
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.columns import full_type
from pfd_ros.messages.joints import JOINT_FIELDS
from pfd_ros.messages.types import STRING
from pfd_ros.recording.bags import Bag, BagTopic
from pfd_ros.recording.format import FORMAT, HeadKey, LogError, damage_named
from pfd_ros.recording.log import robot_of, table
from pfd_ros.recording.mcap_records import EXPANSION
from pfd_ros.recording.topic_arrays import TopicArrays, TopicReader
from pfd_ros.text import cut, listed, one_line

RAISE, COUNT = 'raise', 'count'


@dataclass(frozen=True)
class LogArrays:
    """The messages of a log: `log['/joint_states'].position`.

    Attributes
    ----------
    received_ns : mapping of str to ndarray of int64
        Log times of the messages of each topic in the window, also of topics not decoded, in
        their order [ns].
    settings : mapping or None
        Settings of the node by parameter, for a recording of ours.
    robot : Robot or None
        Its robot.
    roles : mapping of str to str
        Role of each topic, for a recording of ours, else {}.
    simulated : bool
        Whether its log times are simulated time, of a recording of ours.
    head, end : mapping
        Metadata of a recording of ours: its texts, and the values of its end; {} for other logs.
    bag : Bag
        The files and the topics with their definitions.
    read : mapping
        The messages of each topic that was read, or why they cannot be read.
    """

    bag: Bag = field(repr=False)
    received_ns: Mapping[str, NDArray[np.int64]] = field(repr=False)
    read: Mapping[str, TopicArrays | LogError] = field(repr=False)
    _span_ns: tuple[float, float] = field(repr=False)
    settings: Mapping[str, Any] | None = field(default=None, repr=False)
    robot: pfd.Robot | None = field(default=None, repr=False)
    roles: Mapping[str, str] = field(default_factory=dict, repr=False)
    simulated: bool = False
    head: Mapping[str, str] = field(default_factory=dict, repr=False)
    end: Mapping[str, Any] = field(default_factory=dict, repr=False)

    @property
    def path(self) -> Path:
        """The file or folder."""
        return self.bag.path

    @property
    def topics(self) -> dict[str, str]:
        """Type of each topic of the whole log."""
        return {name: topic.type for name, topic in self.bag.topics.items()}

    @property
    def complete(self) -> bool:
        """Whether the file was closed properly, rather than cut off."""
        return self.bag.complete

    def __iter__(self) -> Iterator[str]:
        return iter(self.read)

    def __len__(self) -> int:
        return len(self.read)

    def __contains__(self, topic: object) -> bool:
        return topic in self.read

    def __getitem__(self, topic: str) -> TopicArrays:
        """Return the messages of a topic.

        KeyError if it was not read; LogError if its type is unknown, or a message cannot be
        decoded and none was to be counted.
        """
        if topic not in self.read:
            raise KeyError(f'no topic {topic!r}; topics are {listed(list(self.read))}')
        found = self.read[topic]
        if isinstance(found, LogError):
            raise found
        return found

    def of_type(self, *kinds: str) -> dict[str, TopicArrays]:
        """Return the topics of some types, default all, that can be read and have messages."""
        types = self.topics
        there = (t for t in self if types[t] in (kinds or types.values()) and not self.obstacle(t))
        return {topic: self[topic] for topic in there if len(self[topic])}

    def topic_of(self, role: str) -> str:
        """Return the topic of a role in a recording of ours, '' without one."""
        return next((topic for topic, found in self.roles.items() if found == role), '')

    def of_role(self, role: str) -> TopicArrays | None:
        """Return the messages of a role in a recording of ours, None if none can be read."""
        topic = self.topic_of(role)
        return self.of_type().get(topic) if topic else None

    def descriptions(self) -> dict[str, str]:
        """Return each URDF on topics named robot_description, in their order, with its topic."""
        topics = self.of_type(STRING).items()
        named = [(topic, found) for topic, found in topics if topic.split('/')[-1] == DESCRIPTION]
        return {str(text): topic for topic, found in named for text in found.data}

    def required(self, topic: str, *kinds: str) -> TopicArrays:
        """Return a topic of some types; LogError that says what it is, and names those topics."""
        found = self.of_type(*kinds)
        if topic not in found:
            kind = self.topics.get(topic, '')
            why = f'is {cut(kind)}' if kind and kind not in kinds else 'has no such messages'
            why = self.obstacle(topic) or self.unread(topic) or why
            why = why if kind else 'is not in the log'
            raise LogError(
                f'{self.path}: topic {cut(topic)!r} {why}, expected {" or ".join(kinds)}; topics '
                f'of such messages are {listed(sorted(found))}'
            )
        return found[topic]

    def obstacle(self, topic: str) -> str:
        """Return why a topic cannot be read, '' if it can."""
        found = self.read.get(topic)
        return str(found) if isinstance(found, LogError) else ''

    def unread(self, topic: str) -> str:
        """Return how many messages of a topic cannot be read, but as inputs refused; or ''."""
        lost = 0 if topic not in self or self.obstacle(topic) else self[topic].unreadable
        if not lost or self.roles.get(topic) in INPUTS:
            return ''
        count, reason = len(self.received_ns[topic]), self[topic].reason
        return f'{lost} of {count} messages cannot be read (the first: {reason})'

    def lost(self, topics: Iterable[str]) -> list[str]:
        """Return a line for each of some topics of which something cannot be read."""
        found = []
        for topic in topics:
            unread = self.unread(topic)
            unread = unread and f'{self.path}, topic {cut(topic)!r}: {unread}'
            found.append(one_line(self.obstacle(topic) or unread))
        return [line for line in found if line]

    def messages(self, topic: str) -> list[bytes]:
        """Return the bytes of all messages of a topic, read again, malformed ones included."""
        first, last = self._span_ns
        found = [m for m in self.bag.messages([topic]) if first <= m.log_ns < last]
        return [message.data for message in sorted(found, key=lambda m: m.log_ns)]

    def to_pandas(self, topic: str) -> Any:
        """Return a pandas.DataFrame of a topic: a row a message, indexed by `time` [s].

        Columns are paths of fields; `position.shoulder` for a joint, `data.0` for an element.
        """
        import pandas  # an optional package

        found = self[topic]
        columns: dict[str, NDArray[Any]] = {}
        for path, values in found.arrays.items():
            flat = values.reshape(len(values), math.prod(values.shape[1:]))
            if values.ndim == 1:
                columns[path] = values
            elif found.names and path in JOINT_FIELDS:
                columns |= {f'{path}.{n}': flat[:, k] for k, n in enumerate(found.names)}
            else:
                columns |= {f'{path}.{k}': flat[:, k] for k in range(flat.shape[1])}
        return pandas.DataFrame(columns, index=pandas.Index(found.time, name='time'))


def read_log(
    path: str | os.PathLike[str],
    *,
    topics: Collection[str] | None = None,
    types: Collection[str] | None = None,
    start: float | None = None,
    end: float | None = None,
    unreadable: str = RAISE,
    expansion: float = EXPANSION,
) -> LogArrays:
    """Read a log as arrays, without ROS: a recording of this node or any bag.

    Parameters
    ----------
    path : str or path
        An MCAP or SQLite (.db3) file, or a folder of rosbag2, also one without metadata.yaml.
    topics : collection of str, optional
        Names of topics to read, default all.
    types : collection of str, optional
        Read only topics of these types, such as 'sensor_msgs/msg/JointState'.
    start, end : float, optional
        Window [s], in log time after the first message of the log: start <= t < end.
    unreadable : 'raise' or 'count'
        What a message does that cannot be decoded: access to its topic raises LogError, or it is
        left out and counted. Inputs in a recording of ours are always counted: the node has
        recorded and refused them.
    expansion : float
        Largest size of an MCAP file when it is unpacked, as a multiple of its own.

    Raises
    ------
    ValueError
        If a topic is not in the log, the window is empty or not finite, or the file is no log or
        damaged before its end (LogError, a subclass). A file that was cut off is read up to the
        cut.
    OSError
        If it cannot be read.
    """
    for label, names in (('topics', topics), ('types', types)):
        if isinstance(names, str):
            raise ValueError(f'{label} must be a list of names, got {names!r}: write [{names!r}]')
    if unreadable not in (RAISE, COUNT):
        raise ValueError(f"unreadable must be '{RAISE}' or '{COUNT}', got {unreadable!r}")
    kinds = None if types is None else {full_type(kind) for kind in types}
    first, last = (-math.inf if start is None else start), (math.inf if end is None else end)
    if not first < last:
        raise ValueError(f'start must be before end, got {start} and {end}')
    bag = Bag(Path(path), expansion)
    span = -math.inf, math.inf
    if (start, end) != (None, None):
        # The first message of the log is not always the first one of the file.
        begin = min((message.log_ns for message in bag.messages()), default=0)
        span = begin + first * NANOSECONDS, begin + last * NANOSECONDS
    found: dict[str, TopicReader] = {}

    def topic_of(about: BagTopic) -> TopicReader:
        wanted = topics is None or about.name in topics
        wanted = wanted and (kinds is None or about.type in kinds)
        return found.setdefault(about.name, TopicReader(about, wanted, _is_ours(bag)))

    with damage_named(bag.path):
        for place, message in enumerate(bag.messages()):
            topic = found.get(message.topic) or topic_of(bag.topics[message.topic])
            if span[0] <= message.log_ns < span[1]:
                topic.add(message, place)
    missing = sorted(set(topics or ()) - set(bag.topics))
    if missing:
        raise ValueError(
            f'{bag.path} has no topic {listed(missing)}; topics are {listed(sorted(bag.topics))}'
        )
    for about in bag.topics.values():
        topic_of(about)
    with damage_named(bag.path):
        ours = _recorded(bag)
    read: dict[str, TopicArrays | LogError] = {}
    for name, topic in found.items():
        try:
            counted = unreadable == COUNT or ours.get('roles', {}).get(name) in INPUTS
            about, simulated = bag.topics[name], ours.get('simulated', False)
            arrays = topic.arrays(about, simulated=simulated, counted=counted)
        except ValueError as error:
            read[name] = LogError(f'{bag.path}, topic {cut(name)!r}: {error}')
        else:
            if arrays is not None:
                read[name] = arrays
    received = {name: topic.received_ns() for name, topic in found.items()}
    return LogArrays(bag, received, read, span, **ours)


def new_names(names: Iterable[str], rename: Mapping[str, str]) -> tuple[str, ...]:
    """Return names in which the first OLD that a name begins with is NEW."""

    def new(name: str) -> str:
        old = next(filter(name.startswith, rename), '')
        return rename.get(old, '') + name.removeprefix(old)

    return tuple(map(new, names))


def renamed(log: LogArrays, rename: Mapping[str, str]) -> LogArrays:
    """Return a log in which each beginning OLD of a joint's name is NEW.

    ValueError if two joints of a topic get one name.
    """
    read = dict(log.read)
    for topic, found in log.read.items():
        if isinstance(found, TopicArrays) and found.names:
            names = new_names(found.names, rename)
            if len(set(names)) < len(names):
                raise ValueError(f'two joints of {topic!r} would have one name: {listed(names)}')
            lists = tuple(new_names(one, rename) for one in found.lists)
            read[topic] = replace(found, names=names, lists=lists)
    return replace(log, read=read)


def _recorded(bag: Bag) -> dict[str, Any]:
    """Return what the head and the end of a recording of ours state; {} for other logs."""
    if not _is_ours(bag):
        return {}
    return {
        'settings': table(bag.head, HeadKey.SETTINGS),
        'robot': robot_of(bag.robot) if bag.robot else None,  # cut off before it
        'roles': roles_of(bag),
        'simulated': table(bag.head, HeadKey.TIMES).get('log_time') == 'simulated',
        'head': bag.head,
        'end': {key: json.loads(text) for key, text in bag.end.items()},
    }


def _is_ours(bag: Bag) -> bool:
    return bag.head.get(HeadKey.FORMAT) == FORMAT


def roles_of(bag: Bag) -> dict[str, str]:
    """Return the role of each topic of a recording of ours that was read, {} for other logs."""
    if not _is_ours(bag):
        return {}
    with damage_named(bag.path):
        return {str(topic): role for role, topic in table(bag.head, HeadKey.TOPICS).items()}
