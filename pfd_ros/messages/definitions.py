# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Message types by their definitions: all that rosbags does for this package."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from operator import attrgetter
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.base import normalize_fieldname
from rosbags.typesys.store import Typestore

# Bounds of hostile definitions: bytes, nested types, and fields of a type with all it uses.
TEXT_BYTES, DEPTH, FIELDS = 1 << 18, 16, 4096
# What rosbags has in a type without fields.
_NOTHING = 'structure_needs_at_least_one_member'


@lru_cache(1)
def known_types() -> Typestore:
    """Return the types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def definition_of(kind: str) -> str:
    """Return the definition of a type with all it uses (`ros2msg`); ValueError if unknown."""
    return _known(kind).generate_msgdef(kind, ros_version=2)[0]


def type_hash(kind: str) -> str:
    """Return the hash by which peers recognise a type, 'RIHS01_...'; ValueError if unknown."""
    return _known(kind).hash_rihs01(kind)


def _known(kind: str) -> Typestore:
    if kind not in known_types().fielddefs:
        raise ValueError(f'message type {kind!r} is unknown, expected a type of ROS 2 Jazzy')
    return known_types()


class MessageType:
    """A type of messages, and its decoder by rosbags.

    Parameters
    ----------
    kind
        Such as 'sensor_msgs/msg/JointState'.
    definition
        With all it uses (`ros2msg`), as a bag holds it; '' for a type of ROS 2 Jazzy.

    Raises
    ------
    ValueError
        If it is no definition, a type is missing or uses itself, or there are too many fields.
    """

    def __init__(self, kind: str, definition: str = '') -> None:
        if len(definition) > TEXT_BYTES:
            raise ValueError(
                f'definition of {kind} has {len(definition)} bytes, expected at most {TEXT_BYTES}'
            )
        package, _, name = kind.rpartition('/')
        self.kind = f'{package.removesuffix("/msg")}/msg/{name}'
        self._store = Typestore()
        try:
            text = definition.replace('\r\n', '\n') or definition_of(self.kind)
            types = get_types_from_msg(text, self.kind)
            if sum(len(constants) + len(fields) for constants, fields in types.values()) > FIELDS:
                raise ValueError(f'definition of {kind} has more than {FIELDS} lines')
            _count_fields(self.kind, types, 0)
            self._store.register(types)
            self._store.get_msgdef(self.kind)
        # The parser and the generator of rosbags name what they lack: a base type, for example.
        except (TypesysError, KeyError, AssertionError, RecursionError) as error:
            raise ValueError(f'definition of {kind} cannot be read: {str(error)[:200]}') from error
        # Path of each primitive field -> its type, and the sequences it lies in.
        self.paths = dict(self._paths(self.kind))
        self._access: dict[str, tuple[list[str], Callable[[Any], Any], list[Any]]] = {}

    def _paths(self, kind: str, prefix: str = '', rank: int = 0) -> Iterator[tuple[str, Any]]:
        for name, inner, many in self._fields(kind):
            if inner[0] == Nodetype.NAME:
                yield from self._paths(inner[1], f'{prefix}{name}.', rank + many)
            elif name != _NOTHING:
                yield prefix + name, (inner[1][0], rank + many)

    def _fields(self, kind: str) -> Iterator[tuple[str, Any, bool]]:
        """Yield name and type of each field, and whether there are several."""
        for name, description in self._store.fielddefs[kind][1]:
            many = description[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE)
            yield name, description[1][0] if many else description, many

    def decode(self, data: bytes) -> dict[str, Any]:
        """Return the fields of a message by path; ValueError if the bytes are not such a message.

        A field of several nested messages is a list with one value for each.
        """
        try:
            message = self._store.deserialize_cdr(data, self.kind)
        except SerdeError as error:
            raise ValueError(str(error)) from error
        return self._values(self.kind, message)

    def _values(self, kind: str, message: Any) -> dict[str, Any]:
        if kind not in self._access:
            self._access[kind] = self._accessors(kind)
        paths, values_of, lists = self._access[kind]
        found = dict(zip(paths, values_of(message), strict=True))
        for path, list_of, inner, names in lists:
            rows = [self._values(inner, one) for one in list_of(message)]
            for name in names:
                found[f'{path}.{name}'] = [row[name] for row in rows]
        return found

    def _accessors(self, kind: str) -> tuple[list[str], Callable[[Any], Any], list[Any]]:
        """Return the paths outside of lists, a function with their values, and the lists."""
        paths: list[str] = []
        lists = []

        def visit(kind: str, prefix: str) -> None:
            for name, inner, many in self._fields(kind):
                path = prefix + name
                if inner[0] == Nodetype.BASE:
                    paths.extend([path] if name != _NOTHING else [])
                elif many:
                    names = [name for name, _ in self._paths(inner[1])]
                    lists.append((path, _attribute(path), inner[1], names))
                else:
                    visit(inner[1], f'{path}.')

        visit(kind, '')
        if len(paths) > 1:
            return paths, _attribute(*paths), lists
        return paths, lambda message: [_attribute(path)(message) for path in paths], lists


def _attribute(*paths: str) -> Callable[[Any], Any]:
    """Return a function with the values of some paths of a message of rosbags."""
    return attrgetter(*('.'.join(map(normalize_fieldname, path.split('.'))) for path in paths))


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
