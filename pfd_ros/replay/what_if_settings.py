# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Settings of a run with something changed: `KEY=VALUE`, keys by the parameters of the node.

Settings that are not named stay as they were recorded, those recorded of 'auto' as resolved.
Settings about parts of the model (`MODEL`) begin anew with `robot=`; numbers for each joint are
carried over by name. A scene file takes the place of all effects of the recording.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from typing import Any

import pfd_core as pfd
from pfd_ros.arm.arm import joint_order
from pfd_ros.arm.described_robot import DescribedRobot, described_robot
from pfd_ros.arm.joint_numbers import GROUPS, group_of, split_joints, with_joint_numbers
from pfd_ros.arm.plant_settings import PER_JOINT, effect_fields, joint_settings
from pfd_ros.arm.scene import with_scene_text
from pfd_ros.arm.setting_fields import parameter_name, typed
from pfd_ros.arm.settings import Settings
from pfd_ros.recording.head import strict_json
from pfd_ros.text import cut, did_you_mean, listed

# Settings that only a robot read from a file or a name has.
MODEL = ('base_link', 'tip_link', 'locked', 'locked_positions', 'ros2_control')


@dataclass(frozen=True)
class Changes:
    """
    Settings to change, from the words of a command line.

    Attributes
    ----------
    words : tuple of str
        As given.
    values : mapping
        New value by field of Settings.
    of_joints : mapping
        By field, the new number of some joints by name.

    """

    words: tuple[str, ...] = ()
    values: Mapping[str, Any] = field(default_factory=dict)
    of_joints: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def read_changes(words: Sequence[str]) -> Changes:
    """
    Return the changes of words such as 'payload.mass=2' or 'friction=[1, 2]'.

    Numbers, lists, true and false are JSON; names need no quotes. Numbers of some joints are
    'friction.elbow=2' or 'friction={"elbow": 2}'.

    Raises
    ------
    ValueError
        If a setting is unknown or given twice, or a value has another type.

    """
    values: dict[str, Any] = {}
    of_joints: dict[str, dict[str, float]] = {}
    for word in words:
        key, equals, text = word.partition('=')
        if not equals or not key:
            raise ValueError(f'--what-if takes KEY=VALUE, got {cut(word)!r}')
        if key in GROUPS and text.lstrip().startswith('{'):
            single = split_joints({key: _joints(key, text)})[1]
        elif group_of(key)[0] is not None:
            single = split_joints({key: _value(key, text, 'float')})[1]
        else:
            single = {}
            found = _field(key, text)
            if found.name == 'recording':
                raise ValueError('recording cannot be changed: --out names the log of the new run')
            if found.name in values:
                raise ValueError(f'{cut(key)} is given twice')
            values[found.name] = _value(key, text, str(found.type))
        for name, numbers in single.items():
            table = of_joints.setdefault(name, {})
            if not table.keys().isdisjoint(numbers):
                raise ValueError(f'{cut(key)} is given twice')
            table.update(numbers)
    both = sorted(values.keys() & of_joints.keys())
    if both:
        raise ValueError(f'{both[0]} is given for all joints and for one: use one of them')
    return Changes(tuple(words), values, of_joints)


def _joints(key: str, text: str) -> Mapping[str, Any]:
    try:
        found: Mapping[str, Any] = strict_json(text)
    except ValueError:
        raise ValueError(
            f'{cut(key)} is {cut(text)!r}, expected numbers by joint as {{"elbow": 0.1}}'
        ) from None
    return found


def _field(key: str, text: str) -> Any:
    """Return the field of a key."""
    named = [item for item in fields(Settings) if parameter_name(item) == key]
    if len(named) > 1:
        # A switch, and a group of numbers for each joint.
        listing = text.lstrip().startswith('[')
        named = [item for item in named if item.metadata['per_joint'] == listing]
    if named:
        return named[0]
    known = sorted({parameter_name(item) for item in fields(Settings)})
    hint = did_you_mean(key, known, '`pfd info LOG` lists all')
    raise ValueError(f'unknown setting {cut(key)!r}: {hint}')


def _value(key: str, text: str, kind: str) -> Any:
    value: Any = text
    if kind == 'tuple[str, ...]':
        inner = text.strip().removeprefix('[').removesuffix(']')
        value = [name.strip(' \'"') for name in inner.split(',')] if inner.strip() else []
    elif kind != 'str':
        try:
            value = strict_json(text)
        except ValueError:
            if kind.startswith('tuple'):
                raise ValueError(
                    f'{cut(key)} is {cut(text)!r}, expected numbers as [0.1, 0.2]'
                ) from None
            value = text
    return typed(key, value, kind)


def changed_arm(
    settings: Settings, robot: pfd.Robot, changes: Changes
) -> tuple[Settings, pfd.Robot, str]:
    """
    Return settings and robot of a recording after changes, and the URDF of another robot, or ''.

    Raises
    ------
    ValueError
        If a value is refused, or the changes do not go with the recording.

    """
    values, urdf = dict(changes.values), ''
    if 'robot' in values:
        settings, robot, urdf = _other_robot(settings, robot, values)
    else:
        unbound = sorted(values.keys() & set(MODEL))
        if unbound:
            raise ValueError(
                f'{unbound[0]} needs robot=: a recording holds its robot as one chain of joints'
            )
    settings = _with_scene(settings, changes)
    values = {name: value for name, value in values.items() if name not in MODEL}
    if 'method' in values:
        values.setdefault('payload_changes', 'auto')
    settings = replace(settings, **values)
    if changes.values.get('scene'):
        settings = with_scene_text(settings)
    return with_joint_numbers(settings, robot, changes.of_joints), robot, urdf


def described_arm(changes: Changes) -> tuple[Settings, pfd.Robot, str]:
    """
    Return settings, robot and URDF of changes alone, as fast as possible.

    Raises
    ------
    ValueError
        If they name no robot, or a value is refused.

    """
    if 'robot' not in changes.values:
        raise ValueError('--commands needs robot=: a bag does not hold the robot of its commands')
    settings = Settings(**{'real_time_factor': 0.0, **changes.values})
    found = described_robot(settings, settings.robot)
    settings = with_scene_text(found.settings)
    settings = with_joint_numbers(settings, found.robot, changes.of_joints)
    return settings, found.robot, _urdf_of(found)


def published_names(settings: Settings, robot: pfd.Robot) -> tuple[str, ...]:
    """Return the joints in published order."""
    return tuple(robot.joint_names[i] for i in joint_order(settings.joints, robot))


def _other_robot(
    settings: Settings, robot: pfd.Robot, values: Mapping[str, Any]
) -> tuple[Settings, pfd.Robot, str]:
    """Return settings with the numbers for each joint by name, another robot, and its URDF."""
    default = Settings()
    names = published_names(settings, robot)
    per_joint = [f.name for f in fields(Settings) if f.metadata['per_joint']]
    anew = [*MODEL, *per_joint, 'joints', 'initial_positions']
    fresh: dict[str, Any] = {name: getattr(default, name) for name in anew}
    given = {name: values[name] for name in ('robot', *MODEL) if name in values}
    bare = replace(settings, **(fresh | given))
    found = described_robot(bare, bare.robot)
    new, moving = found.robot, found.robot.joint_names
    if set(names).isdisjoint(moving):
        raise ValueError(
            f'{cut(new.name)!r} has none of the joints {listed(names)} of the log: its joints '
            f'are {listed(moving)}'
        )
    if settings.scene and 'scene' not in values and moving != robot.joint_names:
        raise ValueError(
            f'the scene of the log is for the joints {listed(robot.joint_names)}: add scene=FILE '
            f'for {listed(moving)}, or scene= for none'
        )
    same = sorted(names) == sorted(moving)
    order = names if same and settings.joints else moving
    carried: dict[str, Any] = {'joints': names if same and settings.joints else ()}
    for name in per_joint:
        old = dict(zip(names, getattr(settings, name), strict=False))
        carried[name] = tuple(old.get(joint, 0.0) for joint in order) if old else ()
    start = dict(zip(names, settings.initial_positions or (0.0,) * len(names), strict=True))
    its = dict(zip(moving, found.settings.initial_positions, strict=False))
    at = tuple(start.get(joint, its.get(joint, 0.0)) for joint in order)
    carried['initial_positions'] = at if any(at) or settings.initial_positions else ()
    return replace(found.settings, **carried), new, _urdf_of(found)


def _urdf_of(found: DescribedRobot) -> str:
    """Return the URDF of a robot, '' if it cannot be written as URDF."""
    with suppress(ValueError):
        return found.text
    return ''


def _with_scene(settings: Settings, changes: Changes) -> Settings:
    """Return settings in which a scene and the effects that change do not conflict."""
    # The settings that a scene file replaces.
    switches = (f.name for f in effect_fields() if f.kind != PER_JOINT or f.model)
    effects = {'gravity', *switches}.union(*(joint_settings(f) for f in effect_fields()))
    given = {name: v for name, v in changes.values.items() if name in effects}
    if 'scene' in changes.values:
        default = Settings()
        return replace(settings, **{name: getattr(default, name) for name in effects}, scene='')
    single = sorted(effects & changes.of_joints.keys())
    if not settings.scene or not (given or single):
        return settings
    raise ValueError(
        f'{[*given, *single][0]} cannot be changed by itself: the effects of the log come from a '
        'scene file; give scene=FILE'
    )
