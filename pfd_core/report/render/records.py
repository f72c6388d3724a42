# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records from the JSON of a page: the inverse of `markdown.json_text`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
import json
import math
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

Record = TypeVar('Record')


def read(kind: type[Record], path: Path) -> Record:
    """Return the record that the JSON of a page holds."""
    found: Record = record_of(kind, json.loads(path.read_text(encoding='utf-8')))
    return found


def record_of(kind: Any, data: Any, null: float = math.nan) -> Any:
    """
    Return data of JSON as a record, or as a list, tuple, mapping or number.

    The fields of a record are read by their types; `null` replaces a null where a number is
    required. Keys that the record lacks, such as the mark of a quick run, are left out.
    """

    def inside(kind: Any, data: Any) -> Any:
        return record_of(kind, data, null)

    origin, inner = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and is_dataclass(kind):
        types = get_type_hints(kind)
        known = {one.name: data[one.name] for one in fields(kind) if one.name in data}
        given = {name: inside(types[name], value) for name, value in known.items()}
        return kind(**given)
    if origin in (Union, UnionType):
        (some,) = (one for one in inner if one is not type(None))
        return None if data is None else inside(some, data)
    if origin in (list, Sequence):
        return [inside(inner[0], value) for value in data]
    if origin is tuple:
        kinds = inner[:1] * len(data) if inner[1:] == (...,) else inner
        return tuple(inside(one, value) for one, value in zip(kinds, data, strict=True))
    if origin in (dict, Mapping):
        return {inner[0](key): inside(inner[1], value) for key, value in data.items()}
    return null if kind is float and data is None else data
