# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""QoS profiles as text, in the form in which rosbag2 writes them into a bag.

Source: `offered_qos_profiles` of rosbag2's metadata, ROS 2 Jazzy. Up to version 8 the policies are
the numbers of rmw, later their names.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import yaml

# Bound of a text from outside; messages that a publisher keeps, at most and by default.
TEXT_BYTES, MOST_DEPTH, DEFAULT_DEPTH = 1 << 16, 10_000, 10
_INFINITE = {'sec': 9223372036, 'nsec': 854775807}


class Qos(NamedTuple):
    """What a publisher offers."""

    depth: int = DEFAULT_DEPTH
    keep_all: bool = False
    reliable: bool = True
    transient_local: bool = False


@lru_cache(64)
def qos_text(qos: Qos) -> str:
    """Return the text of a profile; deadline, lifespan and liveliness have their defaults."""
    profile = {
        'history': 'keep_all' if qos.keep_all else 'keep_last',
        'depth': qos.depth,
        'reliability': 'reliable' if qos.reliable else 'best_effort',
        'durability': 'transient_local' if qos.transient_local else 'volatile',
        **{name: dict(_INFINITE) for name in ('deadline', 'lifespan')},
        'liveliness': 'automatic',
        'liveliness_lease_duration': dict(_INFINITE),
        'avoid_ros_namespace_conventions': False,
    }
    return str(yaml.safe_dump([profile], sort_keys=False))


def offered_qos(text: str) -> Qos | None:
    """Return the strongest of the recorded offers, which each recorded subscription accepts.

    None if the text lists no offer. ValueError if it is not a list of QoS profiles.
    """
    if len(text) > TEXT_BYTES:
        raise ValueError(f'QoS profiles of {len(text)} characters, expected at most {TEXT_BYTES}')
    try:
        # All scalars are strings; the loader in C would overflow the stack of nested lists.
        rows = yaml.load(text, yaml.BaseLoader) or []
    except (yaml.YAMLError, RecursionError) as error:
        raise ValueError(f'QoS profiles are not YAML: {error}') from error
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ValueError('QoS profiles are not a list of tables')
    offers = []
    for row in rows:
        depth = row.get('depth', '0')
        if not (isinstance(depth, str) and depth.isascii() and depth.isdigit()) or len(depth) > 20:
            raise ValueError('depth of a QoS profile is not a number')
        offers.append(
            Qos(
                # 0 means the default of the middleware.
                min(int(depth), MOST_DEPTH) or DEFAULT_DEPTH,
                row.get('history') in ('keep_all', '2'),
                row.get('reliability') not in ('best_effort', '2'),
                row.get('durability') in ('transient_local', '1'),
            )
        )
    return Qos(*(max(values) for values in zip(*offers, strict=True))) if offers else None
