# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the metadata records of a recording say, read strictly: settings and totals.

Everything here raises ValueError with a text that names the value, and nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import re
from typing import Any, get_args, get_origin, get_type_hints

from pfd_ros.arm import settings as settings_file
from pfd_ros.arm.settings import Settings
from pfd_ros.recording.format import CHANNELS
from pfd_ros.recording.reader import Log, strict_json
from pfd_ros.text import one_line

# More than any recording counts; a larger number is damage, and no loop should run to it.
COUNT_LIMIT = 1 << 53
_DIGEST = re.compile('[0-9a-f]{64}')


@dataclass(frozen=True)
class Ending:
    """What a node said about its run when it closed the file; counts by role."""

    steps: int
    states: int
    accepted: int
    failure: str
    recorded: Mapping[str, int]
    dropped: Mapping[str, int]
    # SHA-256 of the messages; empty in recordings of the first versions.
    digests: Mapping[str, str]


def _quoted(value: object) -> str:
    return one_line(repr(value), 80)


def table(value: Any, label: str) -> dict[str, Any]:
    """Return a value that should be a JSON object."""
    if not isinstance(value, dict):
        raise ValueError(f'{label} is {_quoted(value)}, expected a table')
    return value


def count(values: Mapping[str, Any], name: str, label: str) -> int:
    """Return a number of things that a table should hold."""
    value = values.get(name)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < COUNT_LIMIT:
        raise ValueError(f'{name} of {label} is {_quoted(value)}, expected a count')
    return value


def settings_of(log: Log) -> Settings:
    """Return the settings of a recording."""
    kinds = get_type_hints(Settings)
    given = table(log.json('settings'), 'settings')
    typed = {
        name: _typed(f'setting {name}', value, kinds[name]) if name in kinds else value
        for name, value in given.items()
    }
    settings = settings_file.from_values(typed)
    needed = {role for role, channel in CHANNELS.items() if channel.always}
    if not set(log.roles.values()) >= needed:
        raise ValueError(f'its topics are {sorted(log.roles.values())}, expected {sorted(needed)}')
    if ('clock' in log.roles.values()) != settings.publish_clock:
        raise ValueError(
            f'publish_clock is {settings.publish_clock}, its topics are {list(log.roles)}'
        )
    return settings


def _typed(label: str, value: Any, kind: Any) -> Any:
    """Return a JSON value as the type of a field; whole numbers will do for others."""
    if get_origin(kind) is tuple and isinstance(value, list):
        return tuple(_typed(label, item, get_args(kind)[0]) for item in value)
    if kind is float and type(value) is int and abs(value) < COUNT_LIMIT:
        return float(value)
    if (get_origin(kind) or kind) in (bool, int, float, str, tuple) and type(value) is not kind:
        wanted = getattr(kind, '__name__', str(kind)) if get_origin(kind) is None else kind
        raise ValueError(f'{label} is {_quoted(value)}, expected {wanted}')
    return value


def versions_of(log: Log) -> dict[str, str]:
    """Return the versions a recording was made with."""
    found = table(log.json('versions'), 'versions')
    for name, version in found.items():
        if not isinstance(version, str):
            raise ValueError(f'version of {_quoted(name)} is no text')
    return {name: version[:200] for name, version in found.items()}


def started_ns(log: Log) -> int:
    """Return the time of day when the recording was opened, ns."""
    value = table(log.json('clock'), 'clock').get('wall_ns')
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 64:
        raise ValueError(f'wall_ns of clock is {_quoted(value)}, expected nanoseconds')
    return value


def ending_of(log: Log) -> Ending | None:
    """Return what the node said when it closed the file, or None if it never did."""
    if not log.ending:
        return None
    told = {
        name: table(strict_json(log.ending.get(name, 'null')), f'{name} of its end record')
        for name in ('totals', 'recorded', 'dropped')
    }
    totals = told['totals']
    failure = totals.get('failure')
    if not isinstance(failure, str):
        raise ValueError(f'failure of its end record is {_quoted(failure)}, expected a text')
    return Ending(
        steps=count(totals, 'steps', 'its end record'),
        states=count(totals, 'states', 'its end record'),
        accepted=count(totals, 'commands_accepted', 'its end record'),
        failure=failure,
        recorded=_by_role(log, told['recorded'], 'messages recorded'),
        dropped=_by_role(log, told['dropped'], 'messages dropped'),
        digests=_digests(log),
    )


def _by_role(log: Log, values: dict[str, Any], label: str) -> dict[str, int]:
    if set(values) != set(log.roles):
        raise ValueError(f'{label} are of {_quoted(list(values))}, expected {list(log.roles)}')
    return {role: count(values, topic, label) for topic, role in log.roles.items()}


def _digests(log: Log) -> dict[str, str]:
    if 'digests' not in log.ending:
        return {}
    found = table(strict_json(log.ending['digests']), 'digests of its end record')
    if set(found) != set(log.roles):
        raise ValueError(f'digests are of {_quoted(list(found))}, expected {list(log.roles)}')
    for topic, digest in found.items():
        if not isinstance(digest, str) or not _DIGEST.fullmatch(digest):
            raise ValueError(f'digest of {topic} is {_quoted(digest)}, expected SHA-256 in hex')
    return {role: found[topic] for topic, role in log.roles.items()}
