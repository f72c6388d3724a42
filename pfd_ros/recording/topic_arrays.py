# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The messages of one topic as arrays by field; decoded in blocks, in the order of log times."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.columns import MOST_PADDING, PADDED, Decoder, joined
from pfd_ros.messages.joints import JOINT_FIELDS
from pfd_ros.messages.types import JOINT_STATE
from pfd_ros.recording.bags import BagMessage, BagTopic
from pfd_ros.recording.format import MESSAGE_ENCODING, SEQUENCE_MASK
from pfd_ros.text import cut, listed

# Messages that are decoded at once: their number and bytes.
BLOCK_MESSAGES, BLOCK_BYTES = 4096, 1 << 22
# Lists of joint names.
MOST_LISTS = 1 << 14


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
    log_ns : ndarray of int64, (N,)
        Times of the log [ns], which do not decrease.
    cycle : ndarray of int64, (N,), or None
        In a recording of the node the cycle that took or computed the message.
    place : ndarray of int64, (N,), or None
        In a recording of the node the place of the message in the file, among all messages.
    simulated_ns : ndarray of int64, (N,), or None
        In a recording of the node the simulated time of that cycle [ns].
    unreadable : int
        Number of messages that cannot be decoded and are left out; `reason` is that of the first.
    names : tuple of str
        Joints of a JointState, in the order of position, velocity and effort, which are
        (N, len(names)) and NaN where a message has no value of a joint; () for other types.
    groups : ndarray of int16, (N,)
        Of a JointState: number of the list of names of each message in `lists`.
    lists : tuple of tuples of str
        Each list of names once: several publishers of one topic may name different joints.
    """

    type: str
    log_ns: NDArray[np.int64] = field(repr=False)
    cycle: NDArray[np.int64] | None = field(default=None, repr=False)
    simulated_ns: NDArray[np.int64] | None = field(default=None, repr=False)
    unreadable: int = 0
    names: tuple[str, ...] = ()
    groups: NDArray[np.int16] = field(default_factory=lambda: np.zeros(0, np.int16), repr=False)
    lists: tuple[tuple[str, ...], ...] = field(default=(), repr=False)
    reason: str = field(default='', repr=False)
    place: NDArray[np.int64] | None = field(default=None, repr=False)

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
                stamps: NDArray[np.int64] = sec * NANOSECONDS + nanosec
                return stamps
        return None

    @property
    def stamped(self) -> bool:
        """Whether `time` is the stamp: there is one, and it is not 0 in all messages."""
        return self.stamp_ns is not None and bool(self.stamp_ns.any())

    @property
    def time(self) -> NDArray[np.float64]:
        """The stamp [s], (N,); where there is none, the simulated time, or else the log time."""
        stamp_ns = self.stamp_ns if self.stamped else None
        return self.simulated_time if stamp_ns is None else stamp_ns / NANOSECONDS

    @property
    def simulated_time(self) -> NDArray[np.float64]:
        """The simulated time [s], (N,), or else the log time, whatever the stamp."""
        return (self.log_ns if self.simulated_ns is None else self.simulated_ns) / NANOSECONDS

    @property
    def log_time(self) -> NDArray[np.float64]:
        """The log time [s], (N,): time of day or simulated time, see `recording_time`."""
        return self.log_ns / NANOSECONDS


def decoder_of(topic: BagTopic) -> Decoder:
    """Return the decoder of a topic; ValueError that says why there is none."""
    if topic.other:
        raise ValueError(f'it has messages of {cut(topic.type)!r} and of {cut(topic.other)!r}')
    if topic.encoding != MESSAGE_ENCODING:
        raise ValueError(
            f'its messages are encoded as {cut(topic.encoding)!r}, expected {MESSAGE_ENCODING!r}'
        )
    if '/srv/' in topic.type:
        raise ValueError(f'{cut(topic.type)} is an event of a service, and these are not read')
    return Decoder(topic.type, topic.definition)


class TopicReader:
    """Reads the messages of a topic and decodes them in blocks."""

    def __init__(self, topic: BagTopic, wanted: bool, ours: bool) -> None:
        self._topic, self._wanted, self._ours = topic, wanted, ours
        self._times, self._publish_ns, self._numbers = array('q'), array('q'), array('q')
        self._in_file = array('q')
        self._block: list[BagMessage] = []
        self._block_bytes = 0
        self._decoder: Decoder | None = None
        self._error: ValueError | None = None
        # Of each block: arrays, places of its readable messages, and their list of names.
        self._pieces: list[dict[str, NDArray[Any]]] = []
        self._places: list[NDArray[np.int64]] = []
        self._groups: list[NDArray[np.int16]] = []
        self._lists: dict[tuple[str, ...], int] = {}

    def received_ns(self) -> NDArray[np.int64]:
        """Return the log times of all messages in order, known after `arrays` [ns]."""
        times = np.frombuffer(self._times, np.int64)
        return np.sort(times) if (np.diff(times) < 0).any() else times  # which takes no memory

    def add(self, message: BagMessage, place: int) -> None:
        """Take a message of the window, at a place in the file."""
        if self._ours:
            self._in_file.append(place)
        self._block.append(message)
        self._block_bytes += len(message.data)
        if len(self._block) >= BLOCK_MESSAGES or self._block_bytes >= BLOCK_BYTES:
            self._decode()

    def _decode(self) -> None:
        block, self._block, self._block_bytes = self._block, [], 0
        before = len(self._times)
        try:
            self._times.extend(message.log_ns for message in block)
            if not self._wanted or self._error:
                return
            if self._ours:
                self._publish_ns.extend(message.publish_ns for message in block)
                self._numbers.extend(message.number for message in block)
            self._decoder = self._decoder or decoder_of(self._topic)
            piece, places = self._decoder.read([message.data for message in block])
            if self._topic.type == JOINT_STATE and {'name', *JOINT_FIELDS} <= piece.keys():
                self._groups.append(self._groups_of(piece.pop('name')))
        except OverflowError:
            self._error = ValueError('a time is beyond 2^63 ns')
        except ValueError as error:
            self._error, self._pieces = error, []
        else:
            self._pieces.append(piece)
            self._places.append(places + before)

    def _groups_of(self, names: NDArray[Any]) -> NDArray[np.int16]:
        """Return the number of each row of names in `_lists`."""
        rows = names[:1] if (names == names[:1]).all() else names
        known = [self._lists.setdefault(tuple(row), len(self._lists)) for row in rows]
        if len(self._lists) > MOST_LISTS:
            raise ValueError(f'more than {MOST_LISTS} lists of joints: read a shorter window')
        return np.full(len(names), known or 0, np.int16)

    def arrays(self, topic: BagTopic, *, simulated: bool, counted: bool) -> TopicArrays | None:
        """Return all messages in the order of their log times, None if they were not wanted.

        `topic` is what the whole log has of it. `simulated` says whether the log time is simulated
        time, in a recording of ours. ValueError if they cannot be read.
        """
        if self._block or not self._times:
            self._decode()
        if self._error is not None:
            raise self._error
        if not self._wanted:
            return None
        if topic.other:
            decoder_of(topic)
        places, total = np.concatenate(self._places), len(self._times)
        reason = '' if self._decoder is None else self._decoder.error
        if len(places) < total and not counted:
            raise ValueError(
                f'{total - len(places)} of {total} messages cannot be read as {self._topic.type} '
                f"(the first: {reason}); read_log(..., unreadable='count') leaves them out"
            )
        log_ns = np.frombuffer(self._times, np.int64)
        names, found = self._joined()
        groups = np.concatenate(self._groups) if self._groups else np.zeros(0, np.int16)
        # From the readable messages in the order of the file to those in the order of log times.
        order: Any = np.argsort(log_ns[places], kind='stable')
        if (np.diff(order) < 0).any():
            found = {path: values[order] for path, values in found.items()}
            groups = groups[order] if len(groups) else groups
            places = places[order]
        cycle = simulated_ns = in_file = None
        # Most often all messages, whose times then take no further memory.
        chosen = slice(None) if len(places) == total and (np.diff(places) > 0).all() else places
        if self._ours:
            publish_ns, numbers, in_file = (
                np.frombuffer(x, np.int64)
                for x in (self._publish_ns, self._numbers, self._in_file)
            )
            steps = np.diff(numbers, prepend=numbers[:1]) & SEQUENCE_MASK
            cycle = (numbers[:1] + np.cumsum(steps))[chosen] if total else numbers
            simulated_ns = (log_ns if simulated else publish_ns)[chosen]
            in_file = in_file[chosen]
        return TopicArrays(
            found,
            self._topic.type,
            log_ns[chosen],
            cycle,
            simulated_ns,
            total - len(places),
            names,
            groups,
            tuple(self._lists),
            reason,
            in_file,
        )

    def _joined(self) -> tuple[tuple[str, ...], dict[str, NDArray[Any]]]:
        """Return the joints, and the arrays of all blocks, with a column for each joint."""
        pieces, self._pieces = self._pieces, []
        names = tuple(dict.fromkeys(name for row in self._lists for name in row if name))
        count = sum(map(len, self._groups))
        found: dict[str, NDArray[Any]] = {}
        for path in list(pieces[0]):
            parts = [piece.pop(path) for piece in pieces]
            if not self._groups or path not in JOINT_FIELDS:
                found[path] = joined(parts)
                continue
            filled = max(count, sum(part.size for part in parts))
            if count * len(names) > PADDED + MOST_PADDING * filled:
                raise ValueError(
                    f'{count} messages name {len(names)} joints, most of them in few messages: '
                    'read a shorter window'
                )
            found[path] = self._by_joint(parts, names)
        return names, found

    def _by_joint(self, parts: list[NDArray[Any]], names: tuple[str, ...]) -> NDArray[Any]:
        """Return the values of all blocks in the columns of their joints, NaN elsewhere."""
        values = np.full((sum(map(len, parts)), len(names)), np.nan)
        place, at = {name: k for k, name in enumerate(names)}, 0
        lists = list(self._lists)
        for part, groups in zip(parts, self._groups, strict=True):
            rows = values[at : at + len(part)]
            for group in np.unique(groups):
                source = [k for k, name in enumerate(lists[group][: part.shape[1]]) if name]
                columns = [place[lists[group][k]] for k in source]
                chosen = np.flatnonzero(groups == group)[:, None]
                rows[chosen, columns] = part[chosen, source]
            at += len(part)
        return values
