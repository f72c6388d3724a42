# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
read_log: the messages of a recording, or of any bag, as NumPy arrays by topic and field.

Only the messages of the chosen topics and of the chosen window of time are kept in memory.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.settings import SIMULATED, WALL
from pfd_ros.messages.old_columns import MOST_PADDING, PADDED, read_columns
from pfd_ros.messages.convert import JOINT_FIELDS, JOINT_STATE, NANOSECONDS
from pfd_ros.messages.definitions import parse_definition
from pfd_ros.recording.bags import Bag, BagMessage, BagTopic, bag_of, definition_of
from pfd_ros.recording.head import head_roles, read_robot
from pfd_ros.recording.reader import LogError, damage_named
from pfd_ros.text import listed

# Of a part of a log: bytes of its messages, and what Python adds to each.
PART_BYTES = 1 << 25
MESSAGE_MEMORY = 128


@dataclass(frozen=True)
class Fields:
    """
    The fields of N messages as arrays: `fields.position`, `fields['header.frame_id']`.

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
    """
    The N messages of one topic. Messages that cannot be decoded are left out.

    Attributes
    ----------
    type : str
        ROS type, such as 'sensor_msgs/msg/JointState'.
    places : ndarray of int64, (N,)
        Places of the messages among all `recorded` of the topic in the window.
    recorded : int
        N, and the number of those left out.
    log_ns, published_ns : ndarray of int64, (N,)
        Times of the log [ns].
    simulated_ns : ndarray of int64, (N,), or None
        Simulated time of the state before or with the message [ns]; None if the log does not
        hold it: bags of other programs, and recordings from before `recording_time`.
    names : tuple of str
        Joints of a JointState, in the order of position, velocity and effort, which are
        (N, len(names)) and NaN where a message has no value of a joint; () for other types.

    """

    type: str
    places: NDArray[np.int64] = field(repr=False)
    recorded: int
    log_ns: NDArray[np.int64] = field(repr=False)
    published_ns: NDArray[np.int64] = field(repr=False)
    simulated_ns: NDArray[np.int64] | None = field(default=None, repr=False)
    names: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.log_ns)

    @cached_property
    def stamp_ns(self) -> NDArray[np.int64] | None:
        """The time in the header, or of a Clock, (N,), in ns; None for types without one."""
        for path in ('header.stamp', 'clock'):
            found = [self.arrays.get(f'{path}.{x}') for x in ('sec', 'nanosec')]
            # A definition in a bag may have other fields of these names.
            whole = [x for x in found if x is not None and x.dtype.kind in 'iu' and x.ndim == 1]
            if len(whole) == len(found):
                sec, nanosec = (x.astype(np.int64) for x in whole)
                stamps: NDArray[np.int64] = sec * 10**9 + nanosec
                return stamps
        return None

    @property
    def time(self) -> NDArray[np.float64]:
        """The stamp [s], (N,); for types without one `simulated_ns`, or else the log time."""
        if self.stamp_ns is not None:
            return _seconds(self.stamp_ns)
        return _seconds(self.log_ns if self.simulated_ns is None else self.simulated_ns)

    @property
    def log_time(self) -> NDArray[np.float64]:
        """The log time [s], (N,): time of day or simulated time, see `recording_time`."""
        return _seconds(self.log_ns)


def _seconds(ns: NDArray[np.int64]) -> NDArray[np.float64]:
    return np.asarray(ns / NANOSECONDS, np.float64)


@dataclass(frozen=True)
class LogArrays:
    """
    The messages of a log: `log['/joint_states'].position`.

    Attributes
    ----------
    path : Path
        The file or folder; of several files the first that was given.
    topics : mapping of str to str
        Type of each topic of the whole file.
    settings : mapping or None
        Settings of the node by parameter, for a recording of ours.
    robot : Robot or None
        Its robot.
    complete : bool
        Whether the file was closed properly, rather than cut off; of a run each file, and none
        is missing.
    head : mapping of str to str
        Record HEAD of a recording of ours, empty for other bags.

    """

    path: Path
    topics: Mapping[str, str]
    settings: Mapping[str, Any] | None
    robot: pfd.Robot | None = field(repr=False)
    complete: bool
    head: Mapping[str, str] = field(repr=False)
    _raw: Mapping[str, _Raw] = field(repr=False)
    _read: dict[str, TopicArrays] = field(default_factory=dict, repr=False)

    def __iter__(self) -> Iterator[str]:
        return iter(self._raw)

    def __len__(self) -> int:
        return len(self._raw)

    def __contains__(self, topic: object) -> bool:
        return topic in self._raw

    def __getitem__(self, topic: str) -> TopicArrays:
        """
        Return the messages of a topic, decoded at the first access.

        Raises
        ------
        KeyError
            If the topic was not read.
        LogError
            If its type is unknown.

        """
        if topic not in self._raw:
            raise KeyError(f'no topic {topic!r}; topics are {listed(list(self._raw))}')
        if topic not in self._read:
            with damage_named(self.path, lambda: f', topic {topic!r}'):
                self._read[topic] = _decoded(self._raw[topic], self._log_time)
        return self._read[topic]

    @property
    def roles(self) -> Mapping[str, str]:
        """Role of each topic, by name; {} for other bags. LogError if damaged."""
        with damage_named(self.path):
            return head_roles(self.head)

    def messages(self, topic: str) -> Sequence[bytes]:
        """Return the bytes of all messages of a topic, malformed ones included."""
        return self._raw[topic].data

    @property
    def _log_time(self) -> str:
        """The time base of a recording of ours, '' where it is unknown."""
        return str((self.settings or {}).get('recording_time', ''))

    def to_pandas(self, topic: str) -> Any:
        """
        Return a pandas.DataFrame of a topic: a row a message, indexed by `time` [s].

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
            if found.names and path == 'name':
                continue
            flat = values.reshape(len(values), -1) if len(values) else values.reshape(0, 0)
            if values.ndim == 1:
                columns[path] = values
            elif found.names and path in JOINT_FIELDS:
                columns |= {f'{path}.{n}': flat[:, k] for k, n in enumerate(found.names)}
            else:
                columns |= {f'{path}.{k}': flat[:, k] for k in range(flat.shape[1])}
        return pandas.DataFrame(columns, index=pandas.Index(found.time, name='time'))


@dataclass
class _Raw:
    """The messages of a topic as they are in the file."""

    topic: BagTopic
    log_ns: list[int] = field(default_factory=list)
    published_ns: list[int] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)


def read_log(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    topics: Collection[str] | None = None,
    types: Collection[str] | None = None,
    start: float | None = None,
    end: float | None = None,
) -> LogArrays:
    """
    Read a log as arrays, without ROS: a recording of this node or any bag.

    Parameters
    ----------
    path : str or path, or a sequence of them
        An MCAP or SQLite (.db3) file, or a folder of rosbag2; the files of one run of the node in
        any order, or the folder that they are in. A message that they repeat is read once.
    topics : collection of str, optional
        Names of topics to read, default all.
    types : collection of str, optional
        Read only topics of these types, such as 'sensor_msgs/msg/JointState'.
    start, end : float, optional
        Window [s], in log time after the first message of the log: start <= t < end.

    Raises
    ------
    ValueError
        If a topic is not in the log, the window is empty or not finite, the file is no bag or
        damaged before its end, or files are not of one run (LogError, a subclass). A file that
        was cut off is read up to the cut.
    OSError
        If it cannot be read.

    """
    for label, names in (('topics', topics), ('types', types)):
        if isinstance(names, str):
            raise ValueError(f'{label} must be a list of names, got {names!r}: write [{names!r}]')
    first, last = (-math.inf if start is None else start), (math.inf if end is None else end)
    if not first < last:
        raise ValueError(f'start must be before end, got {start} and {end}')
    bag = bag_of([Path(p) for p in ([path] if isinstance(path, str | os.PathLike) else path)])
    wanted = None if topics is None else set(topics)
    raw: dict[str, _Raw] = {}
    begin_ns: int | None = None
    for message in bag.messages():
        begin_ns = message.log_ns if begin_ns is None else begin_ns
        if not first <= (message.log_ns - begin_ns) / NANOSECONDS < last:
            continue
        if wanted is not None and message.topic not in wanted:
            continue
        if types is None or bag.topics[message.topic].type in types:
            _add(raw, bag, message)
    missing = sorted((wanted or set()) - set(bag.topics))
    if missing:
        raise ValueError(
            f'{bag.path} has no topic {listed(missing)}; topics are {listed(sorted(bag.topics))}'
        )
    for name, topic in bag.topics.items():
        if (wanted is None or name in wanted) and (types is None or topic.type in types):
            raw.setdefault(name, _Raw(topic))
    return _arrays(bag, raw, *_settings_and_robot(bag))


def read_parts(bag: Bag) -> Iterator[LogArrays]:
    """
    Read all topics of a log in one pass, in parts of bounded memory, in the order of the log.

    A message is in one part. `topics` and `complete` of a part are known up to its end. Before an
    error is raised, the messages before the damage are yielded.

    Parameters
    ----------
    bag : Bag
        The log, before any message was read.

    Raises
    ------
    ValueError, OSError
        As for `read_log`.

    """
    raw: dict[str, _Raw] = {}
    held, failure = 0, None
    model: tuple[Any, Any] | None = None
    try:
        for message in bag.messages():
            _add(raw, bag, message)
            held += len(message.data) + MESSAGE_MEMORY
            if held >= PART_BYTES:
                model = model or _settings_and_robot(bag)
                yield _arrays(bag, raw, *model)
                raw, held = {}, 0
    except (LogError, OSError) as error:
        failure = error
    yield _arrays(bag, raw, *(model or _settings_and_robot(bag)))
    if failure is not None:
        raise failure


def _add(raw: dict[str, _Raw], bag: Bag, message: BagMessage) -> None:
    if message.topic not in raw:
        raw[message.topic] = _Raw(bag.topics[message.topic])
    found = raw[message.topic]
    found.log_ns.append(message.log_ns)
    found.published_ns.append(message.published_ns)
    found.data.append(message.data)


def _settings_and_robot(bag: Bag) -> tuple[Mapping[str, Any] | None, pfd.Robot | None]:
    with damage_named(bag.path):
        settings = bag.settings
        robot = read_robot(bag.robot_text) if bag.robot_text else None
    return settings, robot


def _arrays(
    bag: Bag,
    raw: Mapping[str, _Raw],
    settings: Mapping[str, Any] | None,
    robot: pfd.Robot | None,
) -> LogArrays:
    kinds = {name: topic.type for name, topic in bag.topics.items()}
    complete = bag.complete and not bag.absent
    return LogArrays(bag.path, kinds, settings, robot, complete, bag.head, raw)


def _decoded(raw: _Raw, log_time: str) -> TopicArrays:
    types = parse_definition(raw.topic.type, definition_of(raw.topic))
    arrays, places = read_columns(raw.topic.type, types, raw.data)
    names: tuple[str, ...] = ()
    if raw.topic.type == JOINT_STATE:
        names, arrays = _by_joint(arrays)
    log_ns, published_ns = (
        np.array(times, np.int64)[places] for times in (raw.log_ns, raw.published_ns)
    )
    simulated_ns = {SIMULATED: log_ns, WALL: published_ns}.get(log_time)
    counts = raw.topic.type, places, len(raw.data)
    return TopicArrays(arrays, *counts, log_ns, published_ns, simulated_ns, names)


def _by_joint(
    arrays: dict[str, NDArray[Any]],
) -> tuple[tuple[str, ...], dict[str, NDArray[Any]]]:
    """Return the joints of JointStates, and the arrays with a column for each of them."""
    rows = [tuple(row) for row in arrays['name']]
    names = tuple(dict.fromkeys(name for row in dict.fromkeys(rows) for name in row if name))
    if len(names) == arrays['name'].shape[1] and len(set(rows)) == 1:
        widths = {path: arrays[path].shape[1] for path in JOINT_FIELDS}
        if all(width == len(names) for width in widths.values()):
            return names, arrays
    filled = sum(arrays[path].size for path in JOINT_FIELDS)
    if len(rows) * len(names) > PADDED + MOST_PADDING * filled:
        raise ValueError(
            f'{len(rows)} messages name {len(names)} joints, most of them in few messages: read a '
            'shorter window'
        )
    place = {name: k for k, name in enumerate(names)}
    groups: dict[tuple[str, ...], list[int]] = {}
    for k, row in enumerate(rows):
        groups.setdefault(row, []).append(k)
    sorted_arrays = dict(arrays)
    for path in JOINT_FIELDS:
        values = np.full((len(rows), len(names)), np.nan)
        for row, messages in groups.items():
            width = min(len(row), arrays[path].shape[1])
            columns = [place[name] for name in row[:width] if name]
            source = [k for k, name in enumerate(row[:width]) if name]
            values[np.ix_(messages, columns)] = arrays[path][np.ix_(messages, source)]
        sorted_arrays[path] = values
    return names, sorted_arrays
