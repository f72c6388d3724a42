# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Message types: their names, definitions and hashes, without ROS."""

from __future__ import annotations

from functools import lru_cache

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

JOINT_STATE = 'sensor_msgs/msg/JointState'
FLOAT_ARRAY = 'std_msgs/msg/Float64MultiArray'
STRING = 'std_msgs/msg/String'
CLOCK = 'rosgraph_msgs/msg/Clock'
POSE = 'geometry_msgs/msg/PoseStamped'
WRENCH = 'geometry_msgs/msg/WrenchStamped'
INERTIA = 'geometry_msgs/msg/InertiaStamped'
TWIST = 'geometry_msgs/msg/TwistStamped'
TRANSFORMS = 'tf2_msgs/msg/TFMessage'
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'


@lru_cache(1)
def known_types() -> Typestore:
    """Return the types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def definition(kind: str) -> str:
    """Return the definition of a type and of all it uses, as bags hold it (`ros2msg`).

    Parameters
    ----------
    kind
        Such as 'sensor_msgs/msg/JointState'.

    Raises
    ------
    ValueError
        If ROS 2 Jazzy has no such type.
    """
    _check(kind)
    return known_types().generate_msgdef(kind, ros_version=2)[0]


def type_hash(kind: str) -> str:
    """Return the hash by which peers recognise a type, 'RIHS01_...'; ValueError if unknown."""
    _check(kind)
    return known_types().hash_rihs01(kind)


def _check(kind: str) -> None:
    if kind not in known_types().fielddefs:
        raise ValueError(f'message type {kind!r} is unknown, expected a type of ROS 2 Jazzy')
