# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm of a controller package: its URDF, and its settings with the source of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
import re
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.description import DescribedRobot, described_robot, parsed_urdf
from pfd_ros.arm.plant import scene_of
from pfd_ros.arm.settings import FIELDS, Settings, joint_order
from pfd_ros.messages.types import JOINT_STATE, STRING
from pfd_ros.recording.arrays import COUNT, LogArrays, read_log
from pfd_ros.recording.log import Log
from pfd_ros.text import cut, listed

# Settings with one number a joint, and their units.
NUMBERS = {
    'armature': 'kg m^2 or kg, rotor inertia at the joint',
    'damping': 'N m s/rad or N s/m, viscous friction, which the law compensates',
    'friction': 'N m or N, Coulomb friction, which the law does not know',
}
# In names of joints and links that are no joints of an arm.
GRIPPER = 'grip|jaw|finger|claw'
GUESS = 'estimated: 0.035 s * effort limit / velocity limit'
# Other settings of an arm.
PLAIN = ['base_link', 'tip_link', 'locked', 'locked_positions', 'gravity', 'step_size']
PLAIN += ['publish_rate', 'joint_limits', 'initial_positions']
# Of a recording, whose robot is the model in the package.
TAKEN = ['robot', *PLAIN, *NUMBERS]


class Arm(NamedTuple):
    """A robot, the text of its URDF, and its settings.

    `numbers` has (n,) for each of NUMBERS, `sources` the source of each setting, and one for each
    joint of NUMBERS; `notes` are lines about choices.
    """

    robot: pfd.Robot
    urdf: str
    settings: Settings
    numbers: Mapping[str, NDArray[Any]]
    sources: Mapping[str, Any]
    notes: list[str]


def arm_of(source: str | None, log: Path | None, tip: str) -> Arm:
    """Return the arm of a robot's name or file, or of a log, with a chosen tip or ''.

    A recording of the node has the arm with its settings; in any other log the arm is the URDF on
    a topic robot_description. With a source, a log gives rate and start alone. ValueError if there
    is no arm, or it cannot be loaded.
    """
    arrays = None if log is None else read_log(log, unreadable=COUNT, types=[JOINT_STATE, STRING])
    recorded, settings, name = None, Settings(tip_link=tip), '' if log is None else log.name
    urdf: pfd.Urdf | None = None
    if source is not None:
        urdf, label = pfd.read_urdf(source), Path(source).name
        text = pfd.urdf_of(source) if urdf is None else urdf.text
        if not tip and (not Path(source).is_file() or urdf is None):
            # A robot by name or in YAML has one end, of which its URDF has a frame.
            settings = replace(settings, tip_link=pfd.load_robot(source).tip)
    elif arrays is not None and arrays.settings is not None:
        recorded, label = Log(arrays.path), name
        text = recorded.description or pfd.robot_to_urdf(recorded.robot)
        urdf = parsed_urdf(text, f'the model of {label}')
        given = {key: getattr(recorded.settings, key) for key in PLAIN}
        given['tip_link'] = recorded.robot.tip
        if urdf.joints.keys().isdisjoint(given['locked']):
            # A URDF that is written of a robot in YAML has no locked joints.
            given |= {'locked': (), 'locked_positions': ()}
        if tip not in ('', recorded.robot.tip):
            raise ValueError(f'--tip must be that of {name}, {recorded.robot.tip!r}, got {tip!r}')
        settings = replace(settings, **given | {'initial_positions': ()})
    else:
        assert arrays is not None
        text, label = _described(arrays), name
    found, notes = _chain(settings, urdf or parsed_urdf(text, f'the model of {label}'))
    if not tip and found.urdf is not None:
        notes += _gripper(found.urdf.joints[found.robot.joint_names[-1]])
    robot, settings = found.robot, found.settings
    guess = [float(f'{x:.6g}') for x in pfd.estimated_armature(robot)]
    numbers = {
        'armature': np.where(robot.armature > 0, robot.armature, guess),
        'damping': robot.damping,
        'friction': robot.friction,
    }
    changed: dict[str, Any] = {'tip_link': robot.tip}
    start: Mapping[str, float] = {}
    sources: dict[str, Any] = dict.fromkeys(NUMBERS, [label] * robot.n)
    sources |= dict.fromkeys(PLAIN, label)
    if recorded is not None:
        numbers, start, effects, left = _recorded(recorded.settings, robot)
        changed |= effects
        if not numbers['armature'].any():
            notes.append(
                f'the arm of {name} has no rotor inertia, without which light joints may be too '
                'hard to control: record with armature:=estimated, or add --urdf FILE'
            )
        notes.append(
            f'of the settings of {name}, which pfd info prints, these are taken: '
            f'{", ".join(TAKEN)}; these are not the default and not taken: {", ".join(left)}'
        )
    else:
        stated = any(line.startswith('initial_positions') for line in found.taken)
        sources |= {
            'tip_link': f'the end of the chain in {label}',
            'locked': 'the other joints that move',
            'locked_positions': '<ros2_control>, or nearest to 0 within the limits',
            'step_size': 's, default of pfd sim',
            'initial_positions': f'<ros2_control> or limits of {label}' if stated else 'default',
            'armature': [label if x else GUESS for x in robot.armature],
        }
        limits = np.isfinite([robot.position_lower, robot.position_upper])
        changed['joint_limits'] = bool(limits.any())
        if arrays is not None:
            changed['publish_rate'], start, topic = _motion(arrays, robot, settings)
            sources['publish_rate'] = f'Hz, the median of {cut(topic)} in {name}'
    if tip:
        sources['tip_link'] = '--tip'
    if start:
        changed['initial_positions'] = tuple(start[joint] for joint in robot.joint_names)
        sources['initial_positions'] = f'the first state in {name}'
    return Arm(robot, text, replace(settings, **changed), numbers, sources, notes)


def _chain(settings: Settings, urdf: pfd.Urdf) -> tuple[DescribedRobot, list[str]]:
    """Return the chain of a URDF; of a tree without a chosen tip, the chain its error names."""
    try:
        return described_robot(settings, urdf), []
    except ValueError as error:
        tree = error.__cause__
        if not isinstance(tree, pfd.TreeError):
            raise
        line = f'the model is a tree; its tip is {tree.tip!r} here, --tip LINK chooses another'
        return described_robot(replace(settings, tip_link=tree.tip), urdf), [line]


def _gripper(last: Any) -> tuple[str, ...]:
    """Return a note about the last joint if it, or its link, has the name of a gripper."""
    if not re.search(GRIPPER, f'{last.name} {last.child}', re.IGNORECASE):
        return ()
    names = f'joint {cut(last.name)!r}, which moves {cut(last.child)!r}, is a joint of the arm'
    return (f'{names} here; if it opens a gripper, --tip {cut(last.parent)!r} locks it',)


def _recorded(
    settings: Settings, robot: pfd.Robot
) -> tuple[dict[str, NDArray[Any]], dict[str, float], dict[str, Any], list[str]]:
    """Return the numbers of a recorded arm, its start by joint, other settings, and what is left.

    Effects are those of its scene, also of one from a file. What is left are the names of settings
    and effects that are on, or not the default, and have no place in a package.
    """
    order = joint_order(settings.joints, robot)
    scene = scene_of(settings, np.array(order))
    fields = {effect.field: effect for effect in pfd.EFFECTS}
    numbers = {}
    for key in NUMBERS:
        found = fields[key].resolved(robot, getattr(scene, key))
        numbers[key] = np.zeros(robot.n) if found is None else found
    stops = scene.joint_limits == 'model'
    effects = {'gravity': scene.gravity or (0.0,) * 3, 'joint_limits': stops}
    given = (row.name for row in FIELDS if getattr(settings, row.field) != row.default)
    left = dict.fromkeys(name for name in given if name not in (*TAKEN, 'scene'))
    if settings.scene:
        # Its text alone: the arm adds brakes, and settings that are listed by themselves.
        alone = pfd.load_scene(settings.scene)
        held = {'gravity', 'brakes', *NUMBERS, *['joint_limits'] * stops}
        on = (key for key in fields if getattr(alone, key) != fields[key].off)
        left |= dict.fromkeys(f'{key} of the scene' for key in on if key not in held)
    names = (robot.joint_names[i] for i in order)
    start = dict(zip(names, settings.initial_positions, strict=False))
    return numbers, start, effects, list(left)


def _described(log: LogArrays) -> str:
    """Return the URDF in a log of any kind; ValueError if there is none, or more than one."""
    found = log.descriptions()
    if len(found) == 1:
        return found.popitem()[0]
    several = f'{len(found)} robots, on {listed([*found.values()])}' if found else ''
    raise ValueError(
        f'{log.path} has {several or "no arm: no message on a topic robot_description"}, expected '
        'one (std_msgs/String); name the arm as well, --urdf FILE or --robot NAME, and the log '
        'gives rate and start'
    )


def _motion(
    log: LogArrays, robot: pfd.Robot, settings: Settings
) -> tuple[float, dict[str, float], str]:
    """Return the rate of the states of a robot in a log, Hz, its first positions, and their topic.

    Each joint has its first position that is finite: drivers begin with NaN, and several nodes
    may publish on one topic.
    """
    joints, step, found = robot.joint_names, settings.step_size, list[str]()
    topics = [name for name, kind in log.topics.items() if kind == JOINT_STATE]
    # Commands are JointStates, too.
    for topic in sorted(topics, key=lambda x: (not x.endswith('joint_states'), -len(log[x]))):
        states = log[topic]
        there = np.isfinite(states.position)
        first = {
            name: float(states.position[there[:, j].argmax(), j])
            for j, name in enumerate(states.names)
            if there[:, j].any()
        }
        rows = states.rows(joints[0])
        if first.keys() >= set(joints) and len(rows) > 1:
            interval = float(np.median(np.diff(states.time[rows])))
            if not interval > 0.0:  # stamps that are no times
                interval = float(np.median(np.diff(states.log_time[rows])))
            return 1.0 / (step * max(1, round(interval / step))), first, topic
        found += first
    raise ValueError(
        f'{log.path} has no states of {listed(joints)} with positions, but of '
        f'{listed([*dict.fromkeys(found)])}: leave out --bag, and set rate and start in arm.yaml'
    )
