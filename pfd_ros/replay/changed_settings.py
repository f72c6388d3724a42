# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings of a run with something changed: KEY=VALUE, keys by the parameters of the node.

Settings that are not named stay as they were recorded. Settings about parts of the model (`MODEL`)
begin anew with `robot=`; numbers of each joint are carried over by name, but for defaults, which
are those of the new model, convention and switches. A scene file takes the place of all effects of
the recording.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
import json
import math
from typing import Any, NamedTuple, TypeAlias

import pfd_core as pfd
from pfd_ros.arm.description import described_robot
from pfd_ros.arm.plant import with_scene_text
from pfd_ros.arm.plant_settings import JOINT_EFFECTS, joint_settings
from pfd_ros.arm.setting_fields import typed
from pfd_ros.arm.settings import (
    FIELDS,
    PER_JOINT,
    Settings,
    joint_order,
    joint_values,
    split_joints,
    with_convention,
    with_joint_numbers,
)
from pfd_ros.recording.log import Log
from pfd_ros.replay.inputs import published_names
from pfd_ros.text import cut, did_you_mean, listed

# Settings and robot after changes, and its URDF if it is another robot, else ''.
ChangedArm: TypeAlias = tuple[Settings, pfd.Robot, str]
# Settings that only a robot read from a file or a name has.
MODEL = ('base_link', 'tip_link', 'locked', 'locked_positions', 'ros2_control', 'xacro_args')
# Settings whose values need no quotes.
TEXTS = {row.name for row in FIELDS if row.type in ('str', 'tuple[str, ...]')}
# Settings of a new run that follow from its purpose.
_KNOWN = 'the inputs of the log are known, and the new run waits for none'
GIVEN = {
    'recording': '--out names the log of the new run',
    'recording_time': 'the log of the new run is in simulated time',
    'lockstep': _KNOWN,
    'wait_for_controller': _KNOWN,
    'time_source': 'the log says when its arm made steps',
}


class Changes(NamedTuple):
    """New values by field of Settings, and numbers of single joints by field and joint."""

    values: dict[str, Any]
    of_joints: dict[str, dict[str, float]]


def read_changes(words: Sequence[str]) -> Changes:
    """Return the changes of words such as 'payload.mass=2' or 'friction=[1, 2]'.

    Values are JSON; texts need no quotes. Numbers of single joints are 'friction.elbow=2' or
    'friction={"elbow": 2}'. ValueError for a setting that is unknown or given twice, or a value of
    another type.
    """
    texts: dict[str, str] = {}
    for word in words:
        key, equals, text = word.partition('=')
        if not equals or not key:
            raise ValueError(f'--what-if takes KEY=VALUE, got {cut(word)!r}')
        if key in texts:
            raise ValueError(f'{cut(key)} is given twice')
        texts[key] = text
    plain, of_joints = split_joints({key: _json_or_text(key, text) for key, text in texts.items()})
    values: dict[str, Any] = {}
    for key, value in plain.items():
        rows = [row for row in FIELDS if row.name == key]
        if not rows:
            known = sorted({row.name for row in FIELDS})
            hint = did_you_mean(key, known, '`pfd info LOG` lists all')
            raise ValueError(f'unknown setting {cut(key)!r}: {hint}')
        if key in GIVEN:
            raise ValueError(f'{cut(key)} cannot be changed: {GIVEN[key]}')
        # A switch and a group of numbers of each joint may have one name.
        listing = texts[key].lstrip().startswith('[')
        row = next((row for row in rows if row.per_joint == listing), rows[0])
        if row.type == 'str':
            value = texts[key]
        elif row.type == 'tuple[str, ...]':
            inner = texts[key].strip().removeprefix('[').removesuffix(']')
            value = [name.strip(' \'"') for name in inner.split(',')] if inner.strip() else []
        values[row.field] = typed(key, value, row.type)
    both = sorted({row.name for row in FIELDS if row.field in values.keys() & of_joints.keys()})
    if both:
        raise ValueError(f'{both[0]} is given for all joints and for one: use one of them')
    return Changes(values, of_joints)


def _json_or_text(key: str, text: str) -> Any:
    with suppress(ValueError, RecursionError):
        return json.loads(text)
    known = any(f'{key}.'.startswith(f'{row.name}.') for row in FIELDS)
    if known and key not in TEXTS and text[:1] in tuple('[{+-.0123456789'):
        raise ValueError(
            f'{cut(key)} is {cut(repr(text))}, expected JSON such as 0.5, [0.5, 1.0] or '
            '{"elbow": 0.5}'
        )
    return text


def changed_arm(log: Log, changes: Changes) -> ChangedArm:
    """Return the arm of a recording after changes; ValueError if they do not go with it."""
    values, of_joints = changes
    old = _with_scene(log.settings, changes)
    settings, robot, urdf = old, log.robot, ''
    if 'robot' in values:
        settings, robot, urdf = _other_robot(log, old, values)
    else:
        unbound = sorted(values.keys() & set(MODEL))
        if unbound:
            raise ValueError(
                f'{unbound[0]} needs robot=: a recording holds its robot as one chain of joints'
            )
    moving = robot.joint_names
    start = dict(zip(settings.joints or moving, settings.initial_positions, strict=False))
    order = values.get('joints', settings.joints) or moving
    at = tuple(start.get(joint, 0.0) for joint in order) if start else ()
    numbers = _given(old, log.robot, changes)
    new = with_convention(settings, values) | dict.fromkeys(numbers, ())
    new = {'initial_positions': at} | {k: v for k, v in new.items() if k not in MODEL}
    settings = replace(settings, **new)
    if values.get('scene'):
        settings = with_scene_text(settings)
    for field, given in numbers.items():
        kept = {joint: number for joint, number in given.items() if joint in moving}
        numbers[field] = kept | of_joints.get(field, {})
    return with_joint_numbers(settings, robot, {**of_joints, **numbers}), robot, urdf


def described_arm(changes: Changes) -> ChangedArm:
    """Return the arm of changes alone, as fast as possible; ValueError without a robot."""
    if 'robot' not in changes.values:
        raise ValueError('--commands needs robot=: a bag does not hold the robot of its commands')
    settings = Settings.from_values({'real_time_factor': 0.0, **changes.values})
    found = described_robot(settings, settings.robot)
    settings = with_scene_text(found.settings)
    settings = with_joint_numbers(settings, found.robot, changes.of_joints)
    return settings, found.robot, _text(lambda: found.text)


def _other_robot(log: Log, settings: Settings, values: Mapping[str, Any]) -> ChangedArm:
    """Return settings without numbers of each joint, another robot, and its URDF."""
    default, names = Settings(), published_names(log)
    anew = [*MODEL, *(row.field for row in PER_JOINT), 'joints', 'initial_positions']
    fresh = {name: getattr(default, name) for name in anew}
    given = {name: values[name] for name in ('robot', *MODEL) if name in values}
    bare = replace(settings, **(fresh | given))
    found = described_robot(bare, bare.robot)
    new, moving = found.robot, found.robot.joint_names
    if set(names).isdisjoint(moving):
        raise ValueError(
            f'{cut(new.name)!r} has none of the joints {listed(names)} of the log: its joints '
            f'are {listed(moving)}'
        )
    if settings.scene and 'scene' not in values and moving != log.robot.joint_names:
        raise ValueError(
            f'the scene of the log is for the joints {listed(log.robot.joint_names)}: add '
            f'scene=FILE for {listed(moving)}, or scene= for none'
        )
    keeps = sorted(names) == sorted(moving) and bool(settings.joints)
    its = dict(zip(moving, found.settings.initial_positions, strict=False))
    its |= dict(zip(names, settings.initial_positions or (0.0,) * len(names), strict=True))
    order = names if keeps else ()
    at = tuple(its.get(joint, 0.0) for joint in order or moving)
    settings = replace(found.settings, joints=order, initial_positions=at if any(at) else ())
    return settings, new, _text(lambda: found.text)


def _given(settings: Settings, robot: pfd.Robot, changes: Changes) -> dict[str, dict[str, float]]:
    """Return the numbers of single joints by field, as far as no change replaces them.

    Settings do not state which numbers were given. One that equals the default of the model or the
    convention is left out, since another model, convention or switch has another default.
    """
    order = joint_order(settings.joints, robot)
    found = {}
    for row in PER_JOINT:
        numbers: tuple[float, ...] = getattr(settings, row.field)
        if row.field in changes.values or not numbers:
            continue
        default: Sequence[float] = [math.nan] * len(order)
        # Static friction stays if friction alone changes by its numbers.
        if row.joint_default not in {*changes.values, *changes.of_joints}:
            with suppress(ValueError):  # the convention has none for so many joints
                bare: dict[str, Any] = {row.field: ()}
                default = joint_values(row, replace(settings, **bare), robot, order)
        rows = zip(order, numbers, default, strict=True)
        found[row.field] = {robot.joint_names[k]: x for k, x, usual in rows if x != usual}
    return found


def _text(urdf: Callable[[], str]) -> str:
    with suppress(ValueError):  # a robot that cannot be written as URDF has no frames
        return urdf()
    return ''


def _with_scene(settings: Settings, changes: Changes) -> Settings:
    """Return settings in which a scene and the effects that change do not conflict."""
    effects = {'gravity'}
    for item in JOINT_EFFECTS:
        effects.update({item.field} & {row.field for row in FIELDS}, joint_settings(item))
    if 'scene' in changes.values:
        default = Settings()
        return replace(settings, **{name: getattr(default, name) for name in effects}, scene='')
    given = {*changes.values, *changes.of_joints}
    changed = sorted({row.name for row in FIELDS if row.field in effects & given})
    if settings.scene and changed:
        raise ValueError(
            f'{changed[0]} cannot be changed by itself: the effects of the log come from a scene '
            'file; give scene=FILE'
        )
    return settings
