# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""QoS profiles as text, in the form in which rosbag2 writes them into a bag.

Source: `offered_qos_profiles` of rosbag2's metadata, ROS 2 Jazzy.
"""

from __future__ import annotations

import yaml

# An infinite duration of DDS.
_INFINITE = {'sec': 9223372036, 'nsec': 854775807}


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
