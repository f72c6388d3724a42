# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Definitions and hashes of message types; rosbags reads and writes them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, lru_cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

# Bounds of hostile definitions: bytes, nested types, and fields of a type with all it uses.
TEXT_BYTES, DEPTH, FIELDS = 1 << 18, 16, 4096


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
    """Return the types of a definition (`ros2msg`); ValueError for one that cannot be used.

    Such a one cannot be read, lacks a type, has one that uses itself, or has too many fields.
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
