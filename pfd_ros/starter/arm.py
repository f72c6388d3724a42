# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm of a controller package: its URDF, and its numbers with the source of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.description import DescribedRobot, described_robot, parsed_urdf
from pfd_ros.arm.plant_settings import PlantSettings
from pfd_ros.arm.settings import (
    PER_JOINT,
    CommandSettings,
    SensorSettings,
    Settings,
    joint_order,
    joint_values,
)
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.types import JOINT_STATE, STRING
from pfd_ros.recording.arrays import COUNT, LogArrays, read_log, renamed
from pfd_ros.recording.log import Log
from pfd_ros.text import listed

NOTHING: Mapping[str, str] = {}
# Settings with one number a joint, and their units.
NUMBERS = {
    'armature': 'kg m^2 or kg, rotor inertia at the joint',
    'damping': 'N m s/rad or N s/m, viscous friction, which the law compensates',
    'friction': 'N m or N, Coulomb friction, which the law does not know',
}
GUESS = 'estimated: 0.035 s * effort limit / velocity limit'
# Settings of a recorded arm that its package takes over.
TAKEN: tuple[str, ...] = (
    'base_link',
    'tip_link',
    'locked',
    'locked_positions',
    'gravity',
    'step_size',
)
TAKEN += ('publish_rate', 'joint_limits')


@dataclass(frozen=True)
class Arm:
    """An arm, and the sources of its numbers.

    Attributes
    ----------
    robot, settings, urdf
        The robot, its settings with the locked joints and the start, and the text of its URDF.
    numbers
        Setting of NUMBERS -> numbers (n,), zero where there are none.
    sources
        Setting -> source, with one text for each joint for NUMBERS.
    notes
        Lines about choices that were made.
    """

    robot: pfd.Robot
    settings: Settings
    urdf: str
    numbers: Mapping[str, NDArray[Any]]
    sources: Mapping[str, Any]
    notes: tuple[str, ...]

    @property
    def period(self) -> float:
        """The control period, s."""
        return self.settings.publish_every * self.settings.step_size


def arm_of(
    source: str | None,
    log: Path | None,
    tip: str | None = None,
    rename: Mapping[str, str] = NOTHING,
) -> Arm:
    """Return the arm of a robot's name or file, or of a log, with a chosen tip or None.

    A recording of the node has the arm and its settings. In any other log the arm is the URDF on a
    topic robot_description. With a source, a log gives the rate and the start alone; `rename` has
    other beginnings of its joints' names. ValueError if there is no arm, or it cannot be loaded.
    """
    arrays = None if log is None else read_log(log, unreadable=COUNT, types=[JOINT_STATE, STRING])
    if arrays is not None and source is not None:
        arrays = renamed(arrays, rename)
    settings, recorded = Settings(tip_link=tip or ''), None
    if source is not None:
        text, label = pfd.urdf_of(source), Path(source).name
        if tip is None and pfd.read_urdf(source) is None:
            # A robot in YAML has one end, of which its URDF has a frame.
            settings = replace(settings, tip_link=pfd.load_robot(source).tip)
    else:
        assert arrays is not None
        label = arrays.path.name
        if arrays.settings is not None:  # a recording of the node
            recorded = Log(arrays.path)
            text = recorded.description or pfd.robot_to_urdf(recorded.robot)
            values = {key: getattr(recorded.settings, key) for key in TAKEN}
            if tip or not recorded.description:
                end = tip or recorded.robot.tip
                values |= {'tip_link': end, 'locked': (), 'locked_positions': ()}
            settings = replace(settings, **values)
        else:
            text = _described(arrays)
    found, notes = _chain(settings, parsed_urdf(text, f'the model of {label}'))
    robot, settings = found.robot, found.settings
    at = next((line for line in found.taken if line.startswith('initial_positions')), '')
    stated = f'<ros2_control> of {label}' if '<ros2' in at else 'the middle of limits without 0'
    sources: dict[str, Any] = {
        'tip_link': '--tip' if tip else f'the end of the chain in {label}',
        'locked': 'the other joints that move',
        'locked_positions': 'rad or m, <ros2_control>, or next to 0 within the limits',
        'initial_positions': stated if at else 'default',
        'step_size': 's, default of pfd sim',
        'joint_limits': f'stops at the limits in {label}',
    }
    numbers = {
        'armature': np.array([float(f'{x:.6g}') for x in pfd.estimated_armature(robot)]),
        'damping': robot.damping,
        'friction': robot.friction,
    }
    changed: dict[str, Any] = {'tip_link': robot.tip}
    start: Mapping[str, float] = {}
    if recorded is None:
        limits = np.isfinite([robot.position_lower, robot.position_upper])
        changed['joint_limits'] = bool(limits.any())
    else:
        numbers, start, line = _recorded(recorded, robot)
        sources |= {key: label for key in TAKEN if not (tip and key in ('tip_link', 'locked'))}
        notes += line
    for key in numbers:
        guessed = key == 'armature' and recorded is None
        sources[key] = [GUESS if guessed and not x else label for x in robot.armature]
    if arrays is not None and recorded is None:
        rate, start = _motion(arrays, robot, settings.step_size)
        changed['publish_rate'] = rate
        sources['publish_rate'] = f'the median rate in {arrays.path.name}'
    if start:
        changed['initial_positions'] = tuple(start[name] for name in robot.joint_names)
        sources['initial_positions'] = f'the first state in {arrays.path.name}' if arrays else ''
    settings = replace(settings, **changed)
    return Arm(robot, settings, text, numbers, sources, notes)


def _chain(settings: Settings, urdf: pfd.Urdf) -> tuple[DescribedRobot, tuple[str, ...]]:
    """Return the chain of a URDF; of a tree without a chosen tip, the chain its error names."""
    try:
        return described_robot(settings, urdf), ()
    except ValueError as error:
        tree = error.__cause__
        if not isinstance(tree, pfd.TreeError):
            raise
        line = f'the model is a tree; its tip is {tree.tip!r} here, --tip LINK chooses another'
        return described_robot(replace(settings, tip_link=tree.tip), urdf), (line,)


def _recorded(
    log: Log, robot: pfd.Robot
) -> tuple[dict[str, NDArray[Any]], dict[str, float], tuple[str, ...]]:
    """Return the numbers of a recorded arm, its start, and a line about what is not taken."""
    settings, default = log.settings, Settings()
    order = joint_order(settings.joints, log.robot)
    names = [log.robot.joint_names[i] for i in order]
    numbers = {}
    for row in PER_JOINT:
        if row.name in NUMBERS:
            given = joint_values(row, settings, log.robot, order)
            at = dict(zip(names, given, strict=True))
            numbers[row.name] = np.array([at.get(joint, 0.0) for joint in robot.joint_names])
    start = dict(zip(names, settings.initial_positions, strict=False))
    if not start.keys() >= set(robot.joint_names):
        start = {}
    known = {*TAKEN, *NUMBERS, *(f'joint_{name}' for name in NUMBERS)}
    left = [
        field.name
        for kind in (PlantSettings, CommandSettings, SensorSettings)
        for field in fields(kind)
        if field.name not in known
        and getattr(settings, field.name) != getattr(default, field.name)
    ]
    line = f'not taken from the recording: {listed(left)}; add them to arm.yaml as you need them'
    return numbers, start, (line,) if left else ()


def _described(log: LogArrays) -> str:
    """Return the URDF in a log of any kind; ValueError if there is none."""
    for topic, kind in log.topics.items():
        if kind == STRING and topic.endswith('robot_description') and len(log[topic]):
            return str(log[topic].data[0])
    raise ValueError(
        f'{log.path} has no arm: no message on a topic robot_description (std_msgs/String); name '
        'the arm as well, --urdf FILE or --robot NAME, and the log gives rate and start'
    )


def _motion(log: LogArrays, robot: pfd.Robot, step: float) -> tuple[float, dict[str, float]]:
    """Return the rate of the states of a robot in a log, Hz, and its first positions by joint."""
    for topic, kind in log.topics.items():
        if kind == JOINT_STATE and topic in log and set(log[topic].names) >= {*robot.joint_names}:
            states = log[topic]
            rows = states.rows(robot.joint_names[0])
            times = states.log_ns[rows] / NANOSECONDS
            if len(times) < 2:
                continue
            period = step * max(1, round(float(np.median(np.diff(times))) / step))
            column = [states.names.index(name) for name in robot.joint_names]
            first = states.position[rows][0][column].tolist()
            return 1.0 / period, dict(zip(robot.joint_names, first, strict=True))
    names = [
        name
        for topic, kind in log.topics.items()
        if kind == JOINT_STATE
        for name in log[topic].names
    ]
    raise ValueError(
        f'{log.path} has no states of {listed(robot.joint_names)}, but of {listed(names)}; '
        '--rename OLD=NEW replaces the beginning of their names'
    )
