# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The numbers of a scene for one robot: `resolve` makes a plant of both.

An effect that is off, or whose numbers are all zero, or infinite for a limit, becomes None.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pfd_core.model.error_text import quote, quote_all
from pfd_core.model.geometry import Array, product
from pfd_core.model.plant import Plant
from pfd_core.model.robot import Robot, check_robot
from pfd_core.model.robot_changes import Payload, with_payload
from pfd_core.model.rotors import estimated_armature
from pfd_core.model.scene import PER_JOINT, Scene
from pfd_core.model.scene_checks import ESTIMATED, INPUT, MODEL

# The share of its velocity limit up to which a motor of the model gives its full effort: the limit
# of a drive is no step, across which its controller would jump back and forth.
FULL_EFFORT = 0.9


def given_scene(scene: Scene | None) -> Scene:
    """Return a scene, for None that of gravity alone; ValueError for anything else."""
    if scene is None:
        return Scene()
    if not isinstance(scene, Scene):
        raise ValueError(f'scene must be a Scene or None, got {quote(scene)}')
    return scene


def resolve(robot: Robot, scene: Scene | None = None) -> Plant:
    """
    Return a scene as numbers for a robot.

    Parameters
    ----------
    robot : Robot
        The chain.
    scene : Scene, optional
        Which effects are on; gravity alone if not given.

    Raises
    ------
    ValueError
        If the scene has numbers for another number of joints, a static friction below the Coulomb
        friction, or stops between which a joint cannot move.

    """
    check_robot(robot)
    scene = given_scene(scene)
    values = {key: _values(robot, scene, key) for key in PER_JOINT}
    gravity = np.zeros(3) if scene.gravity is None else np.asarray(scene.gravity)
    limits = _joint_limits(robot, scene)
    plant = Plant(
        robot=with_payload(robot, scene.payload) if isinstance(scene.payload, Payload) else robot,
        gravity=product(robot.base_rotation.T, gravity),
        damping=_unless_zero(values['damping']),
        armature=_unless_zero(values['armature']),
        external_wrench=scene.external_wrench,
        brakes=scene.brakes,
        payload_input=scene.payload == INPUT,
        **_friction(robot, values),
        joint_limits=limits,
        restitution=None if limits is None else _restitution(robot, scene),
        **_springs(robot, values),
        effort_limits=_unless_infinite(values['effort_limits']),
        torque_speed=_torque_speed(robot, scene),
        gravity_compensation=_compensation(robot, scene),
        motor_lag=_unless_zero(values['motor_lag']),
    )
    return _without_compensated_gravity(plant)


def _values(robot: Robot, scene: Scene, key: str) -> Array | None:
    """Return a field with one number a joint, or None if the scene has none."""
    value = getattr(scene, key)
    if value is None:
        return None
    if value == MODEL:
        numbers: Array = getattr(robot, PER_JOINT[key].model or key)
        return numbers
    if value == ESTIMATED:
        return estimated_armature(robot)
    _check_count(robot, key, value)
    return np.asarray(value, dtype=np.float64)


def _check_count(robot: Robot, key: str, rows: Any, noun: str = 'numbers') -> None:
    if len(rows) != robot.n:
        raise ValueError(
            f'{key} of the scene has {len(rows)} {noun}, but {quote(robot.name)} has '
            f'{robot.n} joints: {quote_all(robot.joint_names)}'
        )


def _unless_zero(values: Array | None) -> Array | None:
    return values if values is not None and values.any() else None


def _unless_infinite(values: Array | None) -> Array | None:
    return values if values is not None and np.isfinite(values).any() else None


def _friction(robot: Robot, values: dict[str, Array | None]) -> dict[str, Array | None]:
    """Return Coulomb friction, static friction and Stribeck velocity."""
    sliding, resting = values['friction'], values['static_friction']
    resting = sliding if resting is None else resting
    if sliding is None or resting is None or not (sliding.any() or resting.any()):
        return {}
    for name, low, high in zip(robot.joint_names, sliding.tolist(), resting.tolist(), strict=True):
        if high < low:
            raise ValueError(
                f'static_friction of joint {quote(name)} must be at least its friction {low}, '
                f'got {high}'
            )
    falling = (resting > sliding).any()
    return {
        'friction': sliding,
        'static_friction': resting,
        'stribeck_velocity': values['stribeck_velocity'] if falling else None,
    }


def _joint_limits(robot: Robot, scene: Scene) -> Array | None:
    """Return lower and upper limits, (n, 2), or None without a stop."""
    if scene.joint_limits is None:
        return None
    if scene.joint_limits == MODEL:
        limits = np.stack([robot.position_lower, robot.position_upper], axis=1)
    else:
        _check_count(robot, 'joint_limits', scene.joint_limits, 'rows')
        limits = np.asarray(scene.joint_limits, dtype=np.float64)
    for name, (lower, upper) in zip(robot.joint_names, limits.tolist(), strict=True):
        if not lower < upper:
            raise ValueError(
                f'joint_limits of joint {quote(name)} must be a lower limit below an upper one, '
                f'got {lower} and {upper}; a joint that cannot move is to be locked'
            )
    return _unless_infinite(limits)


def _restitution(robot: Robot, scene: Scene) -> Array:
    if isinstance(scene.restitution, float):
        return np.full(robot.n, scene.restitution)
    _check_count(robot, 'restitution', scene.restitution)
    return np.asarray(scene.restitution, dtype=np.float64)


def _springs(robot: Robot, values: dict[str, Array | None]) -> dict[str, Array]:
    """Return stiffness and rest positions."""
    stiffness, rest = values['stiffness'], values['rest_position']
    if stiffness is None or not stiffness.any():
        return {}
    return {
        'stiffness': stiffness,
        'rest_position': np.zeros(robot.n) if rest is None else rest,
    }


def _torque_speed(robot: Robot, scene: Scene) -> Array | None:
    """Return the tables of all joints with the rows of the longest."""
    if scene.torque_speed is None:
        return None
    of_model = scene.torque_speed == MODEL
    tables: Any = _model_tables(robot) if of_model else scene.torque_speed
    _check_count(robot, 'torque_speed', tables, 'tables')
    longest = max(len(table or ()) for table in tables)
    if not longest:
        return None
    rows = np.full((robot.n, longest, 2), np.inf)
    for i, table in enumerate(tables):
        if table is not None:
            rows[i, : len(table)] = table
            rows[i, len(table) :, 1] = table[-1][1]
    return rows


def _model_tables(robot: Robot) -> list[list[tuple[float, float]] | None]:
    """Return tables that fall from effort limits to zero at velocity limits; None without one."""
    tables: list[list[tuple[float, float]] | None] = []
    for name, speed, torque in zip(
        robot.joint_names, robot.velocity_limit.tolist(), robot.effort_limit.tolist(), strict=True
    ):
        limited = np.isfinite([speed, torque]).all()
        if limited and not FULL_EFFORT * speed < speed:
            raise ValueError(
                f'torque_speed {MODEL!r} needs velocity limits above zero, joint {quote(name)} '
                f'has {speed}'
            )
        tables.append([(FULL_EFFORT * speed, torque), (speed, 0.0)] if limited else None)
    return tables


def _without_compensated_gravity(plant: Plant) -> Plant:
    """Return a plant without gravity if its drives take exactly that away, without limits."""
    model = plant.gravity_compensation
    if model is None or plant.effort_limits is not None or plant.torque_speed is not None:
        return plant
    if plant.payload_input or model.robot != plant.robot or (model.gravity != plant.gravity).any():
        return plant
    return replace(plant, gravity=np.zeros(3), gravity_compensation=None)


def _compensation(robot: Robot, scene: Scene) -> Plant | None:
    """Return the plant whose gravity torques the drives add; None for no torques."""
    model = scene.gravity_compensation
    if model is False:
        return None
    if not isinstance(model, Scene):
        model = Scene(gravity=scene.gravity)
    plant = resolve(robot, model)
    return plant if plant.gravity.any() else None
