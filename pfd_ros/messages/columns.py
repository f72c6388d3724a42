# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Definitions and hashes of message types, and the fields of messages of any type as arrays.

A bag holds the definitions of its types; rosbags reads and writes them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, lru_cache
import math
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.base import normalize_fieldname
from rosbags.typesys.store import Typestore

from pfd_ros.messages.cdr import HEADER, NANOSECONDS, STAMP, TIME, Reader
from pfd_ros.messages.joints import JOINT_FIELDS, decode_joints
from pfd_ros.messages.types import JOINT_STATE
from pfd_ros.text import listed

# Bounds of hostile definitions: bytes, nested types, and fields of a type with all it uses.
TEXT_BYTES, DEPTH, FIELDS = 1 << 18, 16, 4096
# Bounds of padded rows of different lengths: elements, and their multiple of the filled ones.
PADDED, MOST_PADDING = 1 << 20, 16
# What rosbags has in a type without fields.
NOTHING = 'structure_needs_at_least_one_member'
Value = Callable[[Any], Any]
_NUMPY_TYPES = {'byte': 'u1', 'char': 'u1', 'octet': 'u1', 'string': 'O'}


@lru_cache(1)
def known_types() -> Typestore:
    """Return the types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


@cache
def definition_of(kind: str) -> str:
    """Return the definition of a type with all it uses (`ros2msg`); ValueError if unknown."""
    return _known(kind).generate_msgdef(kind, ros_version=2)[0]


@cache
def type_hash(kind: str) -> str:
    """Return the hash by which peers recognise a type, 'RIHS01_...'; ValueError if unknown."""
    return _known(kind).hash_rihs01(kind)


def _known(kind: str) -> Typestore:
    if kind not in known_types().fielddefs:
        raise ValueError(f'message type {kind!r} is unknown, expected a type of ROS 2 Jazzy')
    return known_types()


@lru_cache(64)  # the code that decodes a type is generated for each store
def store_of(kind: str, definition: str) -> Typestore:
    """Return the types of a definition (`ros2msg`); ValueError if it cannot be used.

    It may be unreadable, lack a type, have a type that uses itself, or have too many fields.
    """
    if len(definition) > TEXT_BYTES:
        raise ValueError(
            f'definition of {kind} has {len(definition)} bytes, expected at most {TEXT_BYTES}'
        )
    try:
        types = get_types_from_msg(definition.replace('\r\n', '\n'), kind)
        if sum(len(constants) + len(fields) for constants, fields in types.values()) > FIELDS:
            raise ValueError(f'definition of {kind} has more than {FIELDS} lines')
        _count_fields(kind, types, 0)
        store = Typestore()
        store.register(types)
        store.get_msgdef(kind)
    # The parser and the generator of rosbags name what they lack: a base type, for example.
    except (TypesysError, KeyError, AssertionError, RecursionError) as error:
        raise ValueError(f'definition of {kind} cannot be read: {str(error)[:200]}') from error
    return store


def _count_fields(kind: str, types: Mapping[str, Any], depth: int) -> int:
    """Return the fields of a type with all it uses; ValueError above the bounds."""
    if kind not in types:
        raise ValueError(f'definition of type {kind} is missing')
    if depth > DEPTH:
        raise ValueError(f'type {kind} is nested deeper than {DEPTH} types')
    total = 1
    for _, (node, inner) in types[kind][1]:
        count = 1
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            # The decoder has a line for each element of an array of strings or messages.
            (node, inner), length = inner
            numbers = node == Nodetype.BASE and inner[0] != 'string'
            count = length if length and not numbers else 1
        nested = _count_fields(inner, types, depth + 1) if node == Nodetype.NAME else 1
        total += count * nested
        if total > FIELDS:
            raise ValueError(f'type {kind} has more than {FIELDS} fields')
    return total


class Decoder:
    """Decodes messages of one type by its definition.

    Parameters
    ----------
    kind
        Such as 'sensor_msgs/msg/JointState'.
    definition
        With all it uses (`ros2msg`), as a bag holds it; '' for a type of ROS 2 Jazzy.

    Attributes
    ----------
    paths
        Path of each primitive field -> its type, and the number of sequences it lies in.
    error
        Why the first message that `read` left out cannot be decoded, '' without one.

    Raises
    ------
    ValueError
        If there is no such type, or its definition cannot be used.
    """

    def __init__(self, kind: str, definition: str = '') -> None:
        self.error = ''
        self.kind = full_type(kind)
        self._store = store_of(self.kind, definition or definition_of(self.kind))
        fields = list(self._fields(self.kind))
        self.paths = {path: (primitive, rank) for path, primitive, rank, _ in fields}
        self._values = {path: value_of for path, *_, value_of in fields}
        # The commonest type has a decoder of its own; a bag may have another type of its name.
        self._of_joints = self.kind == JOINT_STATE and (
            self._store.hash_rihs01(self.kind) == type_hash(self.kind)
        )

    def _fields(self, kind: str, outer: str = '') -> Iterator[tuple[str, str, int, Value]]:
        """Yield path, type and rank of each primitive field, and a function with its value.

        `outer` are the attributes of a message before those of the field.
        """
        described: Any = self._store.fielddefs[kind][1]
        for name, (node, inner) in described:
            attribute = outer + normalize_fieldname(name)
            many = node in (Nodetype.ARRAY, Nodetype.SEQUENCE)
            if many:
                node, inner = inner[0]
            if node == Nodetype.NAME:
                nested = self._fields(inner, '' if many else f'{attribute}.')
                for path, primitive, rank, value in nested:
                    value_of = _of_each(attrgetter(attribute), value) if many else value
                    yield f'{name}.{path}', primitive, rank + many, value_of
            elif name != NOTHING:
                yield name, inner[0], int(many), attrgetter(attribute)

    def decode(self, data: bytes) -> dict[str, Any]:
        """Return the fields of a message by path; ValueError if the bytes are not such a message.

        A field of several nested messages is a list with one value for each.
        """
        if self._of_joints:
            joints = decode_joints(data)
            check_names(joints.names)
            stamp, names = divmod(joints.stamp_ns, NANOSECONDS), list(joints.names)
            arrays = joints.position, joints.velocity, joints.effort
            return dict(zip(self.paths, (*stamp, joints.frame_id, names, *arrays), strict=True))
        try:
            message = self._store.deserialize_cdr(data, self.kind)
        except SerdeError as error:
            raise ValueError(str(error)) from error
        return {path: value_of(message) for path, value_of in self._values.items()}

    def read(self, messages: Sequence[bytes]) -> tuple[dict[str, NDArray[Any]], NDArray[np.int64]]:
        """Return the fields of N messages as arrays by path, such as 'header.stamp.sec'.

        Messages that cannot be decoded are left out. The second result has the index of each
        returned message in `messages`, (N,).

        A number is (N,), a sequence of k numbers (N, k), a number within k nested messages
        (N, k). Strings are str in arrays of objects. Where lengths differ between messages,
        shorter rows end with NaN (numbers, which are float64 then), or with '' (strings).

        Raises
        ------
        ValueError
            If padded rows would take far more than the filled ones.
        """
        if self._of_joints:
            arrays = _joint_columns(messages)
            if arrays is not None:
                return arrays, np.arange(len(messages))
        columns: dict[str, list[Any]] = {path: [] for path in self.paths}
        good = []
        for k, data in enumerate(messages):
            try:
                fields = self.decode(data)
            except ValueError as error:
                self.error = self.error or str(error)
                continue
            good.append(k)
            for path, value in fields.items():
                columns[path].append(value)
        arrays = {path: _stacked(values, *self.paths[path]) for path, values in columns.items()}
        return arrays, np.array(good, np.int64)


def full_type(kind: str) -> str:
    """Return the full name of a message type, which ROS also writes without /msg."""
    package, slash, name = kind.rpartition('/')
    return f'{package.removesuffix("/msg")}/msg/{name}' if slash else kind


def check_names(names: Sequence[str]) -> None:
    """Raise ValueError if joints of a message have one name; those without a name are none."""
    twice = [name for name, count in Counter(names).items() if name and count > 1]
    if twice:
        raise ValueError(f'it names joints twice: {listed(twice)}')


def _of_each(outer: Value, inner: Value) -> Value:
    return lambda message: [inner(one) for one in outer(message)]


class _Places(Reader):
    """A reader that keeps the place of each value; the other bytes are padding, of any value."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self.places = [range(len(HEADER))]

    def take(self, size: int, align: int) -> int:
        start = super().take(size, align)
        self.places.append(range(start, start + size))
        return start


def _joint_columns(messages: Sequence[bytes]) -> dict[str, NDArray[Any]] | None:
    """Return the fields of JointStates that differ in stamps and numbers alone, else None."""
    try:
        first, size = _Places(messages[0]), len(messages[0])
        first.time()
        frame_id, names = first.string(), first.strings()
        check_names(names)
        columns = []
        for _ in JOINT_FIELDS:
            count = first.length(8)
            if count:
                first.take(8 * count, 8)
            columns.append(first.places.pop() if count else range(0))
    except (ValueError, IndexError):
        return None
    if first.order != '<' or any(len(data) != size for data in messages):
        return None
    rows = np.frombuffer(b''.join(messages), np.uint8).reshape(len(messages), size)
    # All but the two integers of the stamp.
    equal = np.concatenate([first.places[0], *first.places[3:]]).astype(np.intp)
    times = np.ascontiguousarray(rows[:, STAMP : STAMP + TIME.size]).view('<i4,<u4')[:, 0]
    if (rows[:, equal] != rows[0, equal]).any() or (times['f1'] >= NANOSECONDS).any():
        return None
    return {
        'header.stamp.sec': times['f0'].astype(np.int32),
        'header.stamp.nanosec': times['f1'].astype(np.uint32),
        'header.frame_id': np.full(len(rows), frame_id, object),
        'name': np.tile(np.array(names, object), (len(rows), 1)),
        **{
            name: np.ascontiguousarray(rows[:, place.start : place.stop]).view('<f8')
            for name, place in zip(JOINT_FIELDS, columns, strict=True)
        },
    }


def _stacked(values: list[Any], kind: str, rank: int) -> NDArray[Any]:
    """Return the values of a field in N messages, (N, ...), shorter ones filled up."""
    number: Any = _NUMPY_TYPES.get(kind, kind)
    if not rank:
        return np.array(values, number)
    rows = [np.array(x, number) if rank == 1 else _stacked(x, kind, rank - 1) for x in values]
    return joined([row[None] for row in rows] or [np.empty((0,) * (rank + 1), number)])


def joined(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return arrays of a field in blocks of messages as one, filled up as `Decoder.read` does."""
    shapes = {part.shape[1:] for part in parts}
    if len(shapes) == 1:
        return np.concatenate(parts)
    shape = sum(map(len, parts)), *(max(lengths) for lengths in zip(*shapes, strict=True))
    padded, filled = math.prod(shape), sum(part.size for part in parts)
    if padded > PADDED + MOST_PADDING * filled:
        raise ValueError(
            f'an array of rows of up to {math.prod(shape[1:])} elements would have {padded} '
            f'elements, {filled} of them filled: read a shorter window'
        )
    found = np.full(shape, '', 'O') if parts[0].dtype == 'O' else np.full(shape, np.nan)
    start = 0
    for part in parts:
        place = slice(start, start + len(part)), *map(slice, part.shape[1:])
        found[place] = part
        start += len(part)
    return found
