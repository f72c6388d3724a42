# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd_ros.read_log`: the messages of any log as arrays by topic and field, without ROS.

Messages are decoded in blocks while the file is read, and their bytes are dropped. All arrays are
in the order of the log times.
"""

from __future__ import annotations

from array import array
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.messages.columns import MOST_PADDING, PADDED, Decoder, joined
from pfd_ros.messages.joints import JOINT_FIELDS
from pfd_ros.messages.types import JOINT_STATE
from pfd_ros.recording.bags import Bag, BagMessage, BagTopic
from pfd_ros.recording.format import (
    FORMAT,
    MESSAGE_ENCODING,
    SEQUENCE_MASK,
    HeadKey,
    LogError,
    damage_named,
)
from pfd_ros.recording.mcap_records import EXPANSION
from pfd_ros.text import cut, listed

# Messages of a topic that are decoded at once: their number and bytes.
BLOCK_MESSAGES, BLOCK_BYTES = 4096, 1 << 22
# Characters of a robot; more joints than an arm has need less.
ROBOT_CHARACTERS = 1 << 20
# Times are int64; later ones are damage.
LAST_NS = (1 << 63) - 1
_NANOSECONDS = 10**9
RAISE, COUNT = 'raise', 'count'


@dataclass(frozen=True)
class Fields:
    """The fields of N messages as arrays: `fields.position`, `fields['header.frame_id']`.

    A number is (N,), a sequence (N, k); a nested message is again Fields. Where lengths differ
    between messages, shorter rows end with NaN or ''. Strings are str in arrays of objects.
    """

    arrays: Mapping[str, NDArray[Any]] = field(repr=False)

    def __getitem__(self, path: str) -> Any:
        if path in self.arrays:
            return self.arrays[path]
        nested = {
            name.removeprefix(f'{path}.'): values
            for name, values in self.arrays.items()
            if name.startswith(f'{path}.')
        }
        if not nested:
            raise KeyError(f'no field {path!r}; fields are {listed(list(self.arrays))}')
        return Fields(nested)

    def __getattr__(self, name: str) -> Any:
        if name.startswith('__'):
            raise AttributeError(name)
        try:
            return self[name]
        except KeyError as error:
            raise AttributeError(*error.args) from None


@dataclass(frozen=True)
class TopicArrays(Fields):
    """The N messages of one topic.

    Attributes
    ----------
    type : str
        ROS type, such as 'sensor_msgs/msg/JointState'.
    log_ns, publish_ns : ndarray of int64, (N,)
        Times of the log [ns]; log_ns does not decrease.
    cycle : ndarray of int64, (N,), or None
        In a recording of the node the cycle that took or computed the message.
    simulated_ns : ndarray of int64, (N,), or None
        In a recording of the node the simulated time of that cycle [ns].
    unreadable : int
        Number of messages that cannot be decoded and are left out, with `unreadable='count'`.
    names : tuple of str
        Joints of a JointState, in the order of position, velocity and effort, which are
        (N, len(names)) and NaN where a message has no value of a joint; () for other types.
    groups : ndarray of int32, (N,)
        Of a JointState: number of the list of names of each message in `lists`.
    lists : tuple of tuples of str
        Each list of names once: several publishers of one topic may name different joints.
    """

    type: str
    log_ns: NDArray[np.int64] = field(repr=False)
    publish_ns: NDArray[np.int64] = field(repr=False)
    cycle: NDArray[np.int64] | None = field(default=None, repr=False)
    simulated_ns: NDArray[np.int64] | None = field(default=None, repr=False)
    unreadable: int = 0
    names: tuple[str, ...] = ()
    groups: NDArray[np.int32] = field(default_factory=lambda: np.zeros(0, np.int32), repr=False)
    lists: tuple[tuple[str, ...], ...] = field(default=(), repr=False)

    def __len__(self) -> int:
        return len(self.log_ns)

    def rows(self, joint: str) -> NDArray[np.intp]:
        """Return the indices of the messages that name a joint, (k,)."""
        return np.flatnonzero(
            np.isin(self.groups, [k for k, x in enumerate(self.lists) if joint in x])
        )

    @cached_property
    def stamp_ns(self) -> NDArray[np.int64] | None:
        """The time in the header, or of a Clock, (N,), in ns; None for types without one."""
        for path in ('header.stamp', 'clock'):
            found = [self.arrays.get(f'{path}.{x}') for x in ('sec', 'nanosec')]
            # A definition in a bag may have other fields of these names.
            whole = [x for x in found if x is not None and x.dtype.kind in 'iu' and x.ndim == 1]
            if len(whole) == len(found):
                sec, nanosec = (x.astype(np.int64) for x in whole)
                stamps: NDArray[np.int64] = sec * _NANOSECONDS + nanosec
                return stamps
        return None

    @property
    def stamped(self) -> bool:
        """Whether `time` is the stamp: there is one, and it is not 0 in all messages."""
        return self.stamp_ns is not None and bool(self.stamp_ns.any())

    @property
    def time(self) -> NDArray[np.float64]:
        """The stamp [s], (N,); where there is none, the simulated time, or else the log time."""
        if self.stamped:
            assert self.stamp_ns is not None
            return self.stamp_ns / _NANOSECONDS
        return self.simulated_time

    @property
    def simulated_time(self) -> NDArray[np.float64]:
        """The simulated time [s], (N,), or else the log time, whatever the stamp."""
        return (self.log_ns if self.simulated_ns is None else self.simulated_ns) / _NANOSECONDS

    @property
    def log_time(self) -> NDArray[np.float64]:
        """The log time [s], (N,): time of day or simulated time, see `recording_time`."""
        return self.log_ns / _NANOSECONDS


@dataclass(frozen=True)
class LogArrays:
    """The messages of a log: `log['/joint_states'].position`.

    Attributes
    ----------
    path : Path
        The file or folder.
    topics : mapping of str to str
        Type of each topic of the whole log.
    received_ns : mapping of str to ndarray of int64
        Log times of the messages of each topic in the window, also of topics not decoded, in
        their order [ns].
    sizes : mapping of str to int
        Bytes of these messages.
    settings : mapping or None
        Settings of the node by parameter, for a recording of ours.
    robot : Robot or None
        Its robot.
    roles : mapping of str to str
        Role of each topic, for a recording of ours, else {}.
    complete : bool
        Whether the file was closed properly, rather than cut off.
    head, end : mapping
        Metadata of a recording of ours: its texts, and the values of its end; {} for other logs.
    bag : Bag
        The files and the topics with their definitions.
    """

    path: Path
    topics: Mapping[str, str]
    received_ns: Mapping[str, NDArray[np.int64]] = field(repr=False)
    sizes: Mapping[str, int] = field(repr=False)
    settings: Mapping[str, Any] | None = field(repr=False)
    robot: pfd.Robot | None = field(repr=False)
    roles: Mapping[str, str] = field(repr=False)
    complete: bool
    head: Mapping[str, str] = field(repr=False)
    end: Mapping[str, Any] = field(repr=False)
    bag: Bag = field(repr=False)
    _span_ns: tuple[float, float] = field(repr=False)
    read: Mapping[str, TopicArrays | LogError] = field(repr=False)

    def __iter__(self) -> Iterator[str]:
        return iter(self.read)

    def __len__(self) -> int:
        return len(self.read)

    def __contains__(self, topic: object) -> bool:
        return topic in self.read

    def __getitem__(self, topic: str) -> TopicArrays:
        """Return the messages of a topic.

        Raises
        ------
        KeyError
            If the topic was not read.
        LogError
            If its type is unknown, or a message cannot be decoded and none was to be counted.
        """
        if topic not in self.read:
            raise KeyError(f'no topic {topic!r}; topics are {listed(list(self.read))}')
        found = self.read[topic]
        if isinstance(found, LogError):
            raise found
        return found

    def obstacle(self, topic: str) -> str:
        """Return why a topic cannot be read, '' if it can."""
        found = self.read.get(topic)
        return str(found) if isinstance(found, LogError) else ''

    def messages(self, topic: str) -> list[bytes]:
        """Return the bytes of all messages of a topic, read again, malformed ones included."""
        first, last = self._span_ns
        found = [m for m in self.bag.messages([topic]) if first <= m.log_ns < last]
        return [message.data for message in sorted(found, key=lambda m: m.log_ns)]

    def to_pandas(self, topic: str) -> Any:
        """Return a pandas.DataFrame of a topic: a row a message, indexed by `time` [s].

        Columns are paths of fields; `position.shoulder` for a joint, `data.0` for an element.

        Raises
        ------
        ImportError
            If pandas is not installed.
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
        left out and counted.
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
    first, last = (-math.inf if start is None else start), (math.inf if end is None else end)
    if not first < last:
        raise ValueError(f'start must be before end, got {start} and {end}')
    bag = Bag(Path(path), expansion)
    span = -math.inf, math.inf
    if (start, end) != (None, None):
        # The first message of the log is not always the first one of the file.
        begin = min((message.log_ns for message in bag.messages()), default=0)
        span = begin + first * _NANOSECONDS, begin + last * _NANOSECONDS
    found: dict[str, _Topic] = {}
    for message in bag.messages():
        topic = found.get(message.topic)
        if topic is None:
            about = bag.topics[message.topic]
            wanted = topics is None or about.name in topics
            topic = _Topic(about, wanted and (types is None or about.type in types))
            found[message.topic] = topic
        if span[0] <= message.log_ns < span[1]:
            topic.add(message)
    missing = sorted(set(topics or ()) - set(bag.topics))
    if missing:
        raise ValueError(
            f'{bag.path} has no topic {listed(missing)}; topics are {listed(sorted(bag.topics))}'
        )
    for name, about in bag.topics.items():
        wanted = (topics is None or name in topics) and (types is None or about.type in types)
        found.setdefault(name, _Topic(about, wanted))
    with damage_named(bag.path):
        return _arrays(bag, found, span, unreadable)


def renamed(log: LogArrays, rename: Mapping[str, str]) -> LogArrays:
    """Return a log whose joints have other names: each beginning OLD of a name becomes NEW.

    Raises
    ------
    ValueError
        If two joints of a topic get one name.
    """

    def new(name: str) -> str:
        for old, begin in rename.items():
            if name.startswith(old):
                return begin + name[len(old) :]
        return name

    read = dict(log.read)
    for topic, found in log.read.items():
        if isinstance(found, TopicArrays) and found.names:
            names = tuple(map(new, found.names))
            if len(set(names)) < len(names):
                raise ValueError(f'two joints of {topic!r} would have one name: {listed(names)}')
            lists = tuple(tuple(map(new, one)) for one in found.lists)
            read[topic] = replace(found, names=names, lists=lists)
    return replace(log, read=read)


def _arrays(
    bag: Bag, found: Mapping[str, _Topic], span: tuple[float, float], unreadable: str
) -> LogArrays:
    settings = robot = None
    roles, end = dict[str, str](), dict[str, Any]()
    head = bag.head if bag.head.get(HeadKey.FORMAT) == FORMAT else {}
    simulated = ''
    if head:
        settings = _table(head, HeadKey.SETTINGS)
        roles = roles_of(bag)
        times = _table(head, HeadKey.TIMES)
        simulated = 'log_time' if times.get('simulated') else 'publish_time'
        end = {key: json.loads(text) for key, text in bag.end.items()}
        robot = _robot(bag)
    read: dict[str, TopicArrays | LogError] = {}
    for name, topic in found.items():
        if topic.wanted:
            try:
                read[name] = topic.arrays(simulated, ours=bool(head), unreadable=unreadable)
            except ValueError as error:
                read[name] = LogError(f'{bag.path}, topic {cut(name)!r}: {error}')
    return LogArrays(
        bag.path,
        {name: topic.type for name, topic in bag.topics.items()},
        {name: np.sort(topic.times()) for name, topic in found.items()},
        {name: topic.size for name, topic in found.items()},
        settings,
        robot,
        roles,
        bag.complete,
        head,
        end,
        bag,
        span,
        read,
    )


def roles_of(bag: Bag) -> dict[str, str]:
    """Return the role of each topic of a recording of ours that was read, {} for other logs."""
    if bag.head.get(HeadKey.FORMAT) != FORMAT:
        return {}
    with damage_named(bag.path):
        return {str(topic): role for role, topic in _table(bag.head, HeadKey.TOPICS).items()}


def _table(head: Mapping[str, str], key: str) -> dict[str, Any]:
    found = json.loads(head.get(key, '{}'))
    if not isinstance(found, dict):
        raise ValueError(f'{key} in its head is {cut(repr(found))}, expected a table')
    return found


def _robot(bag: Bag) -> pfd.Robot:
    text = bag.robot_text
    # A single line would be taken for the name of a robot or a file, and `<` for URDF.
    if '\n' not in text or text.lstrip().startswith('<') or len(text) > ROBOT_CHARACTERS:
        raise ValueError('it has no robot')
    return pfd.load_robot(text)


def decoder_of(topic: BagTopic) -> Decoder:
    """Return the decoder of a topic; ValueError that says why there is none."""
    if topic.encoding != MESSAGE_ENCODING:
        raise ValueError(
            f'its messages are encoded as {cut(topic.encoding)!r}, expected {MESSAGE_ENCODING!r}'
        )
    if '/srv/' in topic.type:
        raise ValueError(f'{cut(topic.type)} is an event of a service, and these are not read')
    return Decoder(topic.type, topic.definition)


class _Topic:
    """The messages of a topic, decoded in blocks."""

    def __init__(self, topic: BagTopic, wanted: bool) -> None:
        self.wanted, self.size = wanted, 0
        self._topic = topic
        self._log_ns, self._publish_ns, self._numbers = array('q'), array('q'), array('q')
        self._block: list[bytes] = []
        self._block_bytes = self._decoded = 0
        self._pieces: list[dict[str, NDArray[Any]]] = []
        self._places: list[NDArray[np.int64]] = []
        self._groups: list[NDArray[np.int32]] = []
        self._lists: dict[tuple[str, ...], int] = {}
        self._decoder: Decoder | None = None
        self._error: ValueError | None = None

    def add(self, message: BagMessage) -> None:
        """Take a message of the window."""
        self._log_ns.append(min(message.log_ns, LAST_NS))
        self.size += len(message.data)
        if not self.wanted:
            return
        self._publish_ns.append(min(message.publish_ns, LAST_NS))
        self._numbers.append(message.number)
        if self._error is None:
            self._block.append(message.data)
            self._block_bytes += len(message.data)
            if len(self._block) >= BLOCK_MESSAGES or self._block_bytes >= BLOCK_BYTES:
                self._decode()

    def times(self) -> NDArray[np.int64]:
        """Return the log times of all messages in the order of the file [ns]."""
        return np.array(self._log_ns, np.int64)

    def _decode(self) -> None:
        """Decode the block and drop its bytes."""
        try:
            self._decoder = self._decoder or decoder_of(self._topic)
            piece, places = self._decoder.read(self._block)
        except ValueError as error:
            self._error, self._pieces = error, []
            return
        finally:
            decoded, self._decoded = self._decoded, self._decoded + len(self._block)
            self._block, self._block_bytes = [], 0
        if self._topic.type == JOINT_STATE and {'name', *JOINT_FIELDS} <= piece.keys():
            rows = [tuple(row) for row in piece.pop('name')]
            groups = [self._lists.setdefault(row, len(self._lists)) for row in rows]
            self._groups.append(np.array(groups, np.int32))
        self._pieces.append(piece)
        self._places.append(places + decoded)

    def arrays(self, simulated: str, *, ours: bool, unreadable: str) -> TopicArrays:
        """Return all messages in the order of their log times; ValueError if they cannot be read.

        `simulated` is the name of the time of a message that is simulated time, '' for none.
        """
        if self._block or not self._decoded:
            self._decode()
        if self._error is not None:
            raise self._error
        total, places = self._decoded, np.concatenate(self._places)
        if len(places) < total and unreadable == RAISE:
            raise ValueError(
                f'{total - len(places)} of {total} messages cannot be read as {self._topic.type}; '
                "read_log(..., unreadable='count') leaves them out"
            )
        names, found = self._joined()
        log_ns, publish_ns, numbers = (
            np.array(values, np.int64)[places]
            for values in (self._log_ns, self._publish_ns, self._numbers)
        )
        cycle = None
        if ours and len(numbers):
            steps = np.diff(numbers) & SEQUENCE_MASK
            cycle = np.concatenate([numbers[:1], numbers[0] + np.cumsum(steps)])
        groups = np.concatenate(self._groups) if self._groups else np.zeros(0, np.int32)
        order = np.argsort(log_ns, kind='stable')
        if (order[1:] < order[:-1]).any():
            found = {path: values[order] for path, values in found.items()}
            log_ns, publish_ns = log_ns[order], publish_ns[order]
            groups = groups[order] if len(groups) else groups
            cycle = None if cycle is None else cycle[order]
        return TopicArrays(
            found,
            self._topic.type,
            log_ns,
            publish_ns,
            cycle,
            {'log_time': log_ns, 'publish_time': publish_ns}.get(simulated),
            total - len(places),
            names,
            groups,
            tuple(self._lists),
        )

    def _joined(self) -> tuple[tuple[str, ...], dict[str, NDArray[Any]]]:
        """Return the joints, and the arrays of all blocks, with a column for each joint."""
        pieces, self._pieces = self._pieces, []
        found: dict[str, NDArray[Any]] = {}
        if not self._groups:
            return (), joined(pieces)
        names = tuple(dict.fromkeys(name for row in self._lists for name in row if name))
        count = sum(map(len, self._groups))
        for path in list(pieces[0]):
            parts = [piece.pop(path) for piece in pieces]
            if path not in JOINT_FIELDS:
                found |= joined([{path: part} for part in parts])
                continue
            filled = sum(part.size for part in parts)
            if count * len(names) > PADDED + MOST_PADDING * max(filled, count):
                raise ValueError(
                    f'{count} messages name {len(names)} joints, most of them in few messages: '
                    'read a shorter window'
                )
            found[path] = np.full((count, len(names)), np.nan)
            self._fill(found[path], parts, names)
        return names, found

    def _fill(
        self, values: NDArray[Any], parts: list[NDArray[Any]], names: tuple[str, ...]
    ) -> None:
        """Put the values of blocks into the columns of their joints."""
        place = {name: k for k, name in enumerate(names)}
        lists, at = list(self._lists), 0
        for part, groups in zip(parts, self._groups, strict=True):
            rows = values[at : at + len(part)]
            for group in np.unique(groups):
                source = [k for k, name in enumerate(lists[group][: part.shape[1]]) if name]
                columns = [place[lists[group][k]] for k in source]
                chosen = np.flatnonzero(groups == group)[:, None]
                rows[chosen, columns] = part[chosen, source]
            at += len(part)
