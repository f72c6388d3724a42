# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Arrays of the fields of many messages, by the definition of their type.

CDR places a number by the lengths of the strings and sequences before it. In messages with the
same lengths each field lies at the same place, so these messages are read as one table of bytes;
a recording of an arm has one such table a topic.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.messages.old_cdr import CdrReader
from pfd_ros.messages.definitions import NUMPY_TYPES, STRING, Field, Types, full_name

# Bound of hostile messages: numbers and strings that are not in one sequence of numbers.
LEAVES = 1 << 16
# Most tables of messages of one size; beyond this, messages are read one by one.
TABLES = 64
# Bounds of padded rows of different lengths: elements, and their multiple of the filled ones.
PADDED = 1 << 20
MOST_PADDING = 16


def read_columns(
    name: str, types: Types, messages: Sequence[bytes]
) -> tuple[dict[str, NDArray[Any]], NDArray[np.int64]]:
    """
    Return the fields of N messages as arrays by path, such as 'header.stamp.sec'.

    Messages that cannot be decoded are left out. The second result has the index of each
    returned message in `messages`, (N,).

    A number is (N,), a sequence of k numbers (N, k), a number within k nested messages (N, k).
    Strings are str in arrays of objects. Where lengths differ between messages, shorter rows end
    with NaN (numbers, which are float64 then), or with '' (strings).
    """
    root = full_name(name)
    pieces: dict[str, list[tuple[NDArray[Any], NDArray[Any]]]] = {
        path: [] for path in _paths(root, types)
    }
    kinds = _paths(root, types)
    good = np.zeros(len(messages), bool)
    for rows, table, places in _tables(root, types, messages):
        good[rows] = True
        for path, place in places.items():
            pieces[path].append((rows, _column(table, place, kinds[path])))
    place_of = np.cumsum(good) - 1
    arrays = {
        path: _joined(int(good.sum()), kinds[path], [(place_of[rows], x) for rows, x in found])
        for path, found in pieces.items()
    }
    return arrays, np.flatnonzero(good)


def _paths(kind: str, types: Types, prefix: str = '') -> dict[str, str]:
    """Return the type of each primitive field by its path."""
    found: dict[str, str] = {}
    for item in types[kind]:
        if item.type in types:
            found |= _paths(item.type, types, f'{prefix}{item.name}.')
        else:
            found[prefix + item.name] = item.type
    return found


@dataclass(frozen=True)
class _Leaf:
    """Numbers, or one string, at a place in all messages of a table."""

    start: int
    count: int | None  # of a sequence of numbers; bytes of a string
    order: str


@dataclass
class _Walk:
    """One message read field by field: the place of each leaf, and the lengths that decide it."""

    reader: CdrReader
    types: Types
    lengths: list[int] = field(default_factory=list)
    leaves: int = 0

    def message(self, kind: str) -> dict[str, Any]:
        """Return the leaves of one message by path; nested messages in a list are lists."""
        found: dict[str, Any] = {}
        if not self.types[kind]:
            self.reader.take(1, 1)  # a type without fields has one octet
        for item in self.types[kind]:
            for path, value in self._field(item).items():
                found[path] = value
        return found

    def _field(self, item: Field) -> dict[str, Any]:
        if item.type in NUMPY_TYPES:
            return {item.name: self._numbers(item)}
        read: Callable[[], dict[str, Any]]
        if item.type == STRING:
            read = lambda: {'': self._string()}  # noqa: E731
        else:
            read = lambda: self.message(item.type)  # noqa: E731
        if item.count is None:
            values = [read()]
        else:
            count = self._length(4 if item.type == STRING else 1) if item.count < 0 else item.count
            if count > LEAVES:
                raise ValueError(f'{count} elements of {item.name}, expected at most {LEAVES}')
            values = []
            for _ in range(count):
                self._note_leaf()  # lists of lists of nothing take time, too
                values.append(read())
        # Of nested lists, some elements may have empty ones.
        paths = dict.fromkeys(path for value in values for path in value)
        named = {path: f'{item.name}.{path}' if path else item.name for path in paths}
        if item.count is None:
            return {named[path]: value for path, value in values[0].items()}
        return {named[path]: [value.get(path, []) for value in values] for path in paths}

    def _numbers(self, item: Field) -> _Leaf:
        size = np.dtype(NUMPY_TYPES[item.type]).itemsize
        count = 1 if item.count is None else item.count
        if count < 0:
            count = self._length(size)
        self._note_leaf()
        # An empty sequence is not followed by the padding that its elements would need.
        start = self.reader.take(size * count, size if count else 1)
        return _Leaf(start, None if item.count is None else count, self.reader.order)

    def _string(self) -> _Leaf:
        size = self._length(1)
        self._note_leaf()
        return _Leaf(self.reader.take(size, 1), max(0, size - 1), self.reader.order)

    def _length(self, least: int) -> int:
        count = self.reader.length(least)
        self.lengths.append(self.reader.position - 4)
        return count

    def _note_leaf(self) -> None:
        self.leaves += 1
        if self.leaves > LEAVES:
            raise ValueError(f'a message with more than {LEAVES} fields')


def _tables(
    root: str, types: Types, messages: Sequence[bytes]
) -> Iterator[tuple[NDArray[Any], NDArray[Any], dict[str, Any]]]:
    """Yield messages with equal lengths: their numbers, their bytes in rows, and the places."""
    by_size: dict[int, list[int]] = {}
    for k, data in enumerate(messages):
        by_size.setdefault(len(data), []).append(k)
    for size, numbers in by_size.items():
        joined = b''.join([messages[k] for k in numbers])
        table = np.frombuffer(joined, np.uint8).reshape(len(numbers), size)
        rows = np.array(numbers)
        left = np.ones(len(rows), bool)
        found = 0
        for k in range(len(rows)):
            if not left[k]:
                continue
            left[k] = False
            try:
                walk = _Walk(CdrReader(messages[rows[k]]), types)
                places = walk.message(root)
            except ValueError:
                continue
            # Some writers pad a message to a multiple of four bytes.
            if walk.reader.position + 3 < size:
                continue
            found += 1
            if found > TABLES:
                yield rows[k : k + 1], table[k : k + 1], places
                continue
            # The byte order, and all lengths.
            decisive = [0, 1, *(at + j for at in walk.lengths for j in range(4))]
            equal = left & (table[:, decisive] == table[k, decisive]).all(axis=1)
            left &= ~equal
            equal[k] = True
            yield rows[equal], table[equal], places


def _column(table: NDArray[Any], place: Any, kind: str) -> NDArray[Any]:
    """Return the values of a leaf, (N,) or (N, k), or of nested lists of them, (N, k, ...)."""
    if isinstance(place, _Leaf):
        return _strings(table, place) if kind == STRING else _numbers(table, place, kind)
    if not place:
        return np.empty((len(table), 0), _array_type(kind))
    parts = _with_one_rank([_column(table, one, kind) for one in place])
    shape = _widest([part.shape[1:] for part in parts], [part.size for part in parts])
    return np.stack([_padded(part, shape, kind) for part in parts], axis=1)


def _numbers(table: NDArray[Any], leaf: _Leaf, kind: str) -> NDArray[Any]:
    number = np.dtype(f'{leaf.order}{NUMPY_TYPES[kind]}')
    count = 1 if leaf.count is None else leaf.count
    span = np.ascontiguousarray(table[:, leaf.start : leaf.start + number.itemsize * count])
    values: NDArray[Any] = span.view(np.uint8 if kind == 'bool' else number)
    if kind == 'bool':
        values = values != 0
    values = values.astype(NUMPY_TYPES[kind], copy=False).reshape(len(table), count)
    return values[:, 0] if leaf.count is None else values


def _strings(table: NDArray[Any], leaf: _Leaf) -> NDArray[Any]:
    count = leaf.count or 0
    found = np.empty(len(table), object)
    if not count:
        found[:] = ''
        return found
    span = np.ascontiguousarray(table[:, leaf.start : leaf.start + count])
    known: dict[bytes, str] = {}
    for k, row in enumerate(span):
        data = row.tobytes()
        if data not in known:
            known[data] = data.decode('utf-8', 'backslashreplace')
        found[k] = known[data]
    return found


def _array_type(kind: str) -> Any:
    return object if kind == STRING else np.dtype(NUMPY_TYPES[kind])


def _widest(shapes: Sequence[tuple[int, ...]], sizes: Sequence[int]) -> tuple[int, ...]:
    """Return the shape that holds all rows; ValueError if it is nearly empty."""
    shape = tuple(int(k) for k in np.max(shapes, axis=0)) if shapes[0] else ()
    padded, filled = len(shapes) * math.prod(shape), sum(sizes)
    if padded > PADDED + MOST_PADDING * filled:
        raise ValueError(
            f'an array of rows of up to {math.prod(shape)} elements would have {padded} elements, '
            f'{filled} of them filled: read a shorter window'
        )
    return shape


def _padded(values: NDArray[Any], shape: tuple[int, ...], kind: str) -> NDArray[Any]:
    """Return rows (N, ...) with the longest shape, filled up."""
    if values.shape[1:] == shape:
        return values
    padded = _empty((len(values), *shape), kind)
    padded[tuple(slice(0, k) for k in values.shape)] = values
    return padded


def _empty(shape: tuple[int, ...], kind: str) -> NDArray[Any]:
    return np.full(shape, '', object) if kind == STRING else np.full(shape, np.nan)


def _joined(
    count: int, kind: str, pieces: list[tuple[NDArray[Any], NDArray[Any]]]
) -> NDArray[Any]:
    """Return the rows of all tables in the order of the messages."""
    if not pieces:
        # The field lies in a sequence that is empty in every message.
        return np.empty((count, 0), _array_type(kind))
    if len(pieces) == 1 and len(pieces[0][0]) == count:
        return pieces[0][1]
    parts = _with_one_rank([part for _, part in pieces])
    every = [part.shape[1:] for part in parts for _ in range(len(part))]
    shape = _widest(every, [part.size for part in parts])
    same = all(part.shape[1:] == shape for part in parts)
    # Parts with rows that were filled up are float64.
    number = np.result_type(*parts)
    joined = np.empty((count, *shape), number) if same else _empty((count, *shape), kind)
    for (rows, _), part in zip(pieces, parts, strict=True):
        joined[rows] = _padded(part, shape, kind)
    return joined


def _with_one_rank(parts: list[NDArray[Any]]) -> list[NDArray[Any]]:
    """Return arrays (N, ...) of equal rank: an empty list has no elements with a rank."""
    rank = max(part.ndim for part in parts)
    return [part.reshape(part.shape + (0,) * (rank - part.ndim)) for part in parts]
