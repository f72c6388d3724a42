# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings with a number for each joint, given for some joints by name."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from typing import Any

import pfd_core as pfd
from pfd_ros.arm.arm import joint_order
from pfd_ros.arm.setting_fields import joint_values, parameter_name, typed
from pfd_ros.arm.settings import Settings
from pfd_ros.text import cut, listed

# Name of a group of parameters, one for each joint -> its field.
GROUPS = {parameter_name(f): f for f in dataclasses.fields(Settings) if f.metadata['per_joint']}
# By field, the numbers of some joints by name.
JointNumbers = Mapping[str, Mapping[str, float]]


def group_of(name: str) -> tuple[dataclasses.Field[Any] | None, str]:
    """Return field and joint of a name such as `friction.elbow_joint`; None without a joint."""
    group = max((g for g in GROUPS if name.startswith(f'{g}.')), key=len, default='')
    if name in GROUPS or not group:
        return None, ''
    return GROUPS[group], name.removeprefix(f'{group}.')


def split_joints(values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, dict[str, float]]]:
    """Return settings of all joints, and numbers of single joints by field.

    Parameters
    ----------
    values
        By name; of some joints are `friction.elbow_joint`, and a mapping of joints as `friction`.

    Raises
    ------
    ValueError
        If a joint's number is none, or is given twice.
    """
    fields = {**{field.name: field for field in GROUPS.values()}, **GROUPS}
    plain: dict[str, Any] = {}
    found: dict[str, dict[str, float]] = {}
    for name, value in values.items():
        field, joint = group_of(name)
        joints = {joint: value}
        if isinstance(value, Mapping) and name in fields:
            field, joints = fields[name], dict(value)
        if field is None:
            plain[name] = value
            continue
        table = found.setdefault(field.name, {})
        for joint, number in joints.items():
            label = f'{parameter_name(field)}.{cut(str(joint))}'
            if joint in table:
                raise ValueError(f'{label} is given twice')
            table[joint] = typed(label, number, 'float')
    return plain, found


def with_joint_numbers(settings: Settings, robot: pfd.Robot, numbers: JointNumbers) -> Settings:
    """Return settings with the numbers of single joints; the other joints keep theirs.

    Raises
    ------
    ValueError
        If the robot has no such joint.
    """
    order = joint_order(settings.joints, robot)
    names = [robot.joint_names[i] for i in order]
    for field in GROUPS.values():
        if field.name not in numbers:
            continue
        before = joint_values(field, settings, robot, order)
        values = list(before)
        for joint, number in numbers[field.name].items():
            if joint not in names:
                raise ValueError(
                    f'{parameter_name(field)}.{cut(str(joint))}: no such joint; joints are '
                    f'{listed(names)}'
                )
            values[names.index(joint)] = number
        changed: dict[str, Any] = {field.name: tuple(values)}
        # Numbers that are the default of another setting, after it, change there as well.
        for other in GROUPS.values():
            own_numbers = getattr(settings, other.name)
            if own_numbers and other.metadata['joint_default'] == field.name:
                pairs = zip(own_numbers, before, values, strict=True)
                changed[other.name] = tuple(new if own == old else own for own, old, new in pairs)
        settings = dataclasses.replace(settings, **changed)
    return settings
