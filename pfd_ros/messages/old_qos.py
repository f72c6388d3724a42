# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""QoS profiles as text, in the form in which rosbag2 writes them into a bag.

Source: `offered_qos_profiles` of rosbag2's metadata, ROS 2 Jazzy. Up to version 8 the policies are
the numbers of rmw, later their names.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import yaml

# An infinite duration of DDS.
_INFINITE = {'sec': 9223372036, 'nsec': 854775807}
# Seconds from which a duration is infinite; older versions of rmw had 2147483647.
_INFINITE_SECONDS = 2147483647
# Names and numbers of the policies that are not the default.
_KEEP_ALL, _BEST_EFFORT = ('keep_all', '2'), ('best_effort', '2')
_TRANSIENT_LOCAL, _MANUAL = ('transient_local', '1'), ('manual_by_topic', '3')
# Bounds of a text from outside, and of the messages that a publisher keeps.
TEXT_BYTES = 1 << 16
PROFILES = 1024
MOST_DEPTH = 10_000
DEFAULT_DEPTH = 10


@dataclass(frozen=True)
class Qos:
    """The QoS that a publisher offers; durations in ns, None is infinite."""

    depth: int = DEFAULT_DEPTH
    keep_all: bool = False
    reliable: bool = True
    transient_local: bool = False
    deadline_ns: int | None = None
    lifespan_ns: int | None = None
    manual_liveliness: bool = False
    lease_ns: int | None = None


def qos_text(
    depth: int,
    history: str = 'keep_last',
    reliability: str = 'reliable',
    durability: str = 'volatile',
) -> str:
    """Return the text of a QoS profile; the other policies have their defaults."""
    profile = {
        'history': history,
        'depth': depth,
        'reliability': reliability,
        'durability': durability,
        'deadline': dict(_INFINITE),
        'lifespan': dict(_INFINITE),
        'liveliness': 'automatic',
        'liveliness_lease_duration': dict(_INFINITE),
        'avoid_ros_namespace_conventions': False,
    }
    return str(yaml.safe_dump([profile], sort_keys=False))


def offered_qos(text: str) -> Qos | None:
    """Return the strongest of the recorded offers, which each recorded subscription accepts.

    None if the text lists no offer.

    Raises
    ------
    ValueError
        If the text is not a list of QoS profiles.
    """
    if len(text) > TEXT_BYTES:
        raise ValueError(f'QoS profiles of {len(text)} characters, expected at most {TEXT_BYTES}')
    try:
        # All scalars are strings; the loader in C would overflow the stack of nested lists.
        table = yaml.load(text, yaml.BaseLoader)
    except (yaml.YAMLError, RecursionError) as error:
        raise ValueError(f'QoS profiles are not YAML: {error}') from error
    if not table:
        return None
    if not isinstance(table, list) or not all(isinstance(row, dict) for row in table):
        raise ValueError('QoS profiles are not a list of tables')
    if len(table) > PROFILES:
        raise ValueError(f'{len(table)} QoS profiles, expected at most {PROFILES}')
    offers = [_qos(row) for row in table]
    return Qos(
        depth=max(offer.depth for offer in offers),
        keep_all=any(offer.keep_all for offer in offers),
        reliable=any(offer.reliable for offer in offers),
        transient_local=any(offer.transient_local for offer in offers),
        deadline_ns=_shortest(offer.deadline_ns for offer in offers),
        # No subscription asks for a lifespan; the longest loses no message.
        lifespan_ns=_longest([offer.lifespan_ns for offer in offers]),
        manual_liveliness=any(offer.manual_liveliness for offer in offers),
        lease_ns=_shortest(offer.lease_ns for offer in offers),
    )


def _qos(row: dict[str, Any]) -> Qos:
    depth = _whole(row.get('depth', '0'), 'depth')
    return Qos(
        # 0 means the default of the middleware.
        depth=min(depth, MOST_DEPTH) or DEFAULT_DEPTH,
        keep_all=row.get('history') in _KEEP_ALL,
        reliable=row.get('reliability') not in _BEST_EFFORT,
        transient_local=row.get('durability') in _TRANSIENT_LOCAL,
        deadline_ns=_nanoseconds(row, 'deadline'),
        lifespan_ns=_nanoseconds(row, 'lifespan'),
        manual_liveliness=row.get('liveliness') in _MANUAL,
        lease_ns=_nanoseconds(row, 'liveliness_lease_duration'),
    )


def _nanoseconds(row: dict[str, Any], name: str) -> int | None:
    """Return a duration in ns, None if it is infinite or the default, which is infinite."""
    value = row.get(name, {})
    if not isinstance(value, dict):
        raise ValueError(f'{name} of a QoS profile is {_shown(value)}, expected a table')
    seconds, rest = (_whole(value.get(key, '0'), name) for key in ('sec', 'nsec'))
    found = seconds * 10**9 + rest
    return None if found == 0 or seconds >= _INFINITE_SECONDS else found


def _whole(value: Any, name: str) -> int:
    if not isinstance(value, str) or not value.isascii() or not value.isdigit() or len(value) > 20:
        raise ValueError(f'{name} of a QoS profile is {_shown(value)}, expected a number')
    return int(value)


def _shown(value: Any) -> str:
    # Written out, a list of aliases to lists of aliases could have any length.
    return repr(value[:80]) if isinstance(value, str) else f'a {type(value).__name__}'


def _shortest(durations: Any) -> int | None:
    return min((value for value in durations if value is not None), default=None)


def _longest(durations: list[int | None]) -> int | None:
    found = [value for value in durations if value is not None]
    return max(found) if len(found) == len(durations) else None
