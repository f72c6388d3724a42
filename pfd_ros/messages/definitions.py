# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Message definitions: the texts that ROS installs, their hashes, and the fields in a text.

Readers without ROS decode a file by the definitions inside it. A definition is the text of the
type, then each type it uses, once, after a line of 80 `=` and its name. ROS installs the texts
under `share/<package>/msg`, with a JSON file with the hash that peers use to recognise the type.
Source: MCAP registry, schema encoding `ros2msg`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import json
import os
from pathlib import Path
import re
import sys

# Kinds of NumPy of the primitive types; `char` is an octet in ROS 2.
NUMPY_TYPES = {
    'bool': '?',
    'byte': 'u1',
    'char': 'u1',
    'float32': 'f4',
    'float64': 'f8',
    **{f'int{bits}': f'i{bits // 8}' for bits in (8, 16, 32, 64)},
    **{f'uint{bits}': f'u{bits // 8}' for bits in (8, 16, 32, 64)},
}
STRING, WIDE_STRING = 'string', 'wstring'
PRIMITIVES = frozenset({*NUMPY_TYPES, STRING, WIDE_STRING})
# Bounds of hostile definitions: nested types, and fields of a type with all it uses.
DEPTH = 16
FIELDS = 4096
_SEPARATOR = re.compile('^={80}\n', re.MULTILINE)
_FIELD = re.compile(
    r'^(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?(?:\[(?P<most><=)?(?P<count>\d*)\])?'
    r'\s+(?P<name>[A-Za-z]\w*)(?P<rest>\s*=.*|\s.*)?$'
)
# Types that can be recorded where ROS has not installed them: text without comments, and hash. The
# wheels on PyPI lack tf2_msgs.
KNOWN = {
    'tf2_msgs/msg/TFMessage': (
        'geometry_msgs/TransformStamped[] transforms\n',
        'RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087',
    )
}


def shares() -> list[Path]:
    """Return the folders that may hold definitions, best first."""
    # The pip wheels of ROS install into the environment's share and set no variable.
    prefixes = [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
    return [Path(prefix) / 'share' for prefix in prefixes if prefix]


def _file(type_name: str, suffix: str) -> Path:
    package, _, name = type_name.split('/')
    for share in shares():
        path = share / package / 'msg' / f'{name}{suffix}'
        if path.is_file():
            return path
    raise ValueError(
        f'no definition of {type_name}: expected share/{package}/msg/{name}{suffix} in one of '
        f'{[str(share) for share in shares()]}; install ROS 2 or set AMENT_PREFIX_PATH'
    )


def full_text(type_name: str) -> str:
    """Return the definition of a type and of all it uses.

    Parameters
    ----------
    type_name
        Such as 'sensor_msgs/msg/JointState'.

    Raises
    ------
    ValueError
        If a definition is not installed.
    """
    texts: dict[str, str] = {}
    waiting = [type_name]
    while waiting:
        name = waiting.pop(0)
        if name not in texts:
            texts[name] = _text(name)
            used = (item.type for item in _fields(full_name(name), texts[name]))
            waiting += [x.replace('/', '/msg/') for x in used if x not in PRIMITIVES]
    head, *rest = texts.items()
    parts = [head[1]]
    for name, text in rest:
        parts.append('=' * 80 + f'\nMSG: {full_name(name)}\n' + text)
    return '\n'.join(parts)


def _text(type_name: str) -> str:
    """Return the text of one type: as ROS installed it, or else of KNOWN."""
    try:
        return _file(type_name, '.msg').read_text(encoding='utf-8')
    except ValueError:
        if type_name not in KNOWN:
            raise
        return KNOWN[type_name][0]


def type_hash(type_name: str) -> str:
    """Return the type's hash ('RIHS01_...'), or '' if it is unknown."""
    try:
        described = json.loads(_file(type_name, '.json').read_text(encoding='utf-8'))
        hashes = {entry['type_name']: entry['hash_string'] for entry in described['type_hashes']}
        return str(hashes.get(type_name, ''))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return KNOWN.get(type_name, ('', ''))[1]


@dataclass(frozen=True)
class Field:
    """A field of a type; a count of -1 means a sequence, None a single value."""

    name: str
    type: str
    count: int | None


Types = Mapping[str, tuple[Field, ...]]


def parse_definition(name: str, text: str) -> Types:
    """
    Return the fields of a type and of all types that it uses, by full name.

    Parameters
    ----------
    name : str
        Such as 'sensor_msgs/msg/JointState'.
    text : str
        Its definition, then the definitions of the types it uses, each after a line of 80 `=`
        and its name, as bags hold them (encoding `ros2msg`).

    Raises
    ------
    ValueError
        If a line declares no field, a type is missing or uses itself, or there are too many.

    """
    first, *others = _SEPARATOR.split(text.replace('\r\n', '\n'))
    texts = {full_name(name): first}
    for other in others:
        title, _, body = other.partition('\n')
        if not title.startswith('MSG: '):
            raise ValueError(f'definition of {name}: {title[:80]!r} in place of "MSG: <type>"')
        texts[full_name(title.removeprefix('MSG: ').strip())] = body
    types = {kind: tuple(_fields(kind, body)) for kind, body in texts.items()}
    _count_fields(full_name(name), types, 0)
    return types


def full_name(name: str) -> str:
    """Return a type's name as package/Name."""
    return name.replace('/msg/', '/')


def _fields(kind: str, text: str) -> Iterator[Field]:
    package = kind.partition('/')[0]
    for line in text.splitlines():
        stripped = line.partition('#')[0].strip()
        if not stripped:
            continue
        found = _FIELD.match(stripped)
        if not found:
            raise ValueError(f'definition of {kind}: {stripped[:80]!r} is not a field')
        if (found['rest'] or '').lstrip().startswith('='):
            continue  # a constant
        name = found['type']
        if name not in PRIMITIVES:
            name = full_name(name if '/' in name else f'{package}/{name}')
        count = None
        if found['count'] is not None:
            count = -1 if found['most'] or not found['count'] else int(found['count'])
        yield Field(found['name'], name, count)


def _count_fields(kind: str, types: Types, depth: int) -> int:
    """Return the fields of a type with all it uses; ValueError above the bounds."""
    if kind not in types:
        raise ValueError(f'definition of type {kind} is missing')
    if depth > DEPTH:
        raise ValueError(f'type {kind} is nested deeper than {DEPTH} types')
    total = 0
    for item in types[kind]:
        if item.type == WIDE_STRING:
            raise ValueError(f'type {kind} has a {WIDE_STRING}, which is not read')
        own = item.type in PRIMITIVES
        # A type without fields counts too, or their number would have no bound.
        total += 1 if own else max(1, _count_fields(item.type, types, depth + 1))
        if total > FIELDS:
            raise ValueError(f'type {kind} has more than {FIELDS} fields')
    return total
