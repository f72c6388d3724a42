# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The URDF of an arm with two joints and a gripper, with a block for ros2_control."""

from __future__ import annotations

_BODY = (
    '<inertial><origin xyz="0 0 0.1"/><mass value="1"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
)
_LIMIT = '<limit lower="-3" upper="3" velocity="9" effort="90"/>'
ARM, FINGERS = ('shoulder', 'elbow'), ('finger', 'thumb')
START = (0.5, -0.25)


def _joint(name: str, kind: str, parent: str, child: str, inside: str = '') -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>{_LIMIT}{inside}</joint>'
    )


def _controlled(name: str, initial: float) -> str:
    return (
        f'<joint name="{name}"><command_interface name="effort"/><state_interface name="position">'
        f'<param name="initial_value">{initial}</param></state_interface>'
        '<state_interface name="velocity"/><state_interface name="effort"/></joint>'
    )


def block(**params: str) -> str:
    """Return a block for ros2_control, with these parameters of its hardware."""
    told = ''.join(f'<param name="{name}">{value}</param>' for name, value in params.items())
    return (
        '<ros2_control name="arm" type="system"><hardware>'
        '<plugin>joint_state_topic_hardware_interface/JointStateTopicSystem</plugin>'
        f'{told}</hardware>'
        + ''.join(map(_controlled, (*ARM, 'finger'), (*START, 0.04)))
        + '</ros2_control>'
    )


def with_block(text: str) -> str:
    """Return the URDF with a block for ros2_control."""
    links = ''.join(
        f'<link name="{name}">{_BODY}</link>' for name in ('upper', 'lower', 'left', 'right')
    )
    return (
        f'<robot name="with_gripper"><link name="base"/>{links}'
        + _joint('shoulder', 'revolute', 'base', 'upper')
        + _joint('elbow', 'revolute', 'upper', 'lower')
        + _joint('finger', 'prismatic', 'lower', 'left')
        + _joint('thumb', 'prismatic', 'lower', 'right', '<mimic joint="finger" multiplier="-1"/>')
        + f'{text}</robot>'
    )


def urdf(**params: str) -> str:
    """Return the URDF with such a block."""
    return with_block(block(**params))
