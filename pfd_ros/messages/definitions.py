# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Message definitions for recordings: the texts and their hashes.

Readers without ROS decode a file by the definitions inside it. A definition is the text of the
type, then each type it uses, once, after a line of 80 `=` and its name. ROS installs the texts
under `share/<package>/msg`, with a JSON file with the hash that peers use to recognise the type.
Source: MCAP registry, schema encoding `ros2msg`.
"""

from __future__ import annotations

from collections.abc import Iterator
import json
import os
from pathlib import Path
import re
import sys

NUMBERS = frozenset(f'{kind}{bits}' for kind in ('int', 'uint') for bits in (8, 16, 32, 64))
PRIMITIVES = NUMBERS | {'bool', 'byte', 'char', 'float32', 'float64', 'string', 'wstring'}
_FIELD = re.compile(r'^\s*([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+\w+')
# Types that can be recorded where ROS has not installed them: text without comments, and hash. The
# wheels on PyPI lack tf2_msgs.
KNOWN = {
    'tf2_msgs/msg/TFMessage': (
        'geometry_msgs/TransformStamped[] transforms\n',
        'RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087',
    )
}
_CONSTANT = re.compile(r'^\s*\w+(?:<=\d+)?\s+\w+\s*=')


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


def _uses(type_name: str, text: str) -> Iterator[str]:
    """Yield the full name of each message type among the fields of a definition."""
    package = type_name.split('/')[0]
    for line in text.splitlines():
        found = _FIELD.match(line.split('#')[0])
        if not found or _CONSTANT.match(line.split('#')[0]):
            continue
        parts = found[1].split('/')
        if parts[0] not in PRIMITIVES:
            yield f'{parts[0] if len(parts) > 1 else package}/msg/{parts[-1]}'


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
            waiting += _uses(name, texts[name])
    head, *rest = texts.items()
    parts = [head[1]]
    for name, text in rest:
        parts.append('=' * 80 + f'\nMSG: {name.replace("/msg/", "/")}\n' + text)
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
