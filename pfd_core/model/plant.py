# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Plant: a scene and a robot as numbers, which an algorithm records as a program.

    check_instant          refuses effects that a program of one instant cannot have
    without_step_effects   a plant without those
    in_motion              the same, with the friction of joints that stay in motion

Most effects are torques at an instant, in pfd_core.algorithms.chain (drives, joint_torques). Dry
friction, stops and the lag of motors act over a step of time, in pfd_core.simulation.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
import hashlib
from typing import Any

import numpy as np

from pfd_core.model.error_text import quote_all
from pfd_core.model.frozen_arrays import FrozenArrays, frozen
from pfd_core.model.geometry import Array
from pfd_core.model.robot import Robot

# Fields of Plant whose effects act over a step of time.
STEP_EFFECTS = (
    'friction',
    'static_friction',
    'stribeck_velocity',
    'joint_limits',
    'restitution',
    'motor_lag',
)


@dataclass(frozen=True, eq=False)
class Plant(FrozenArrays):
    """
    A scene as numbers for one robot; an effect that is off is None.

    Attributes
    ----------
    robot : Robot
        The chain, with the payload welded on; without one that is an input.
    gravity : ndarray
        (3,) [m/s^2], in the axes of frame 0; zeros without gravity.
    damping, armature : ndarray or None
        (n,) [N m s/rad, N s/m] and [kg m^2, kg].
    external_wrench, brakes, payload_input : bool
        Whether a wrench on the last link, joints held at run time, and a payload are inputs.
    friction, static_friction : ndarray or None
        (n,) [N m, N]: Coulomb friction, and the larger or equal friction at rest; both or none.
    stribeck_velocity : ndarray or None
        (n,) [rad/s, m/s]; only if static friction is larger somewhere.
    joint_limits : ndarray or None
        (n, 2) [rad, m], lower below upper, infinite where there is no stop.
    restitution : ndarray or None
        (n,), from 0 to 1; exactly if there are joint limits.
    stiffness, rest_position : ndarray or None
        (n,) [N m/rad, N/m] and [rad, m]; both or none.
    effort_limits : ndarray or None
        (n,) [N m, N], infinite where there is none.
    torque_speed : ndarray or None
        (n, k, 2), rows (speed, torque) [rad/s, N m; m/s, N]; rows beyond a joint's own have
        infinite speeds, and those of a joint without a table infinite torques.
    gravity_compensation : Plant or None
        The robot and gravity whose gravity torques the drives add.
    motor_lag : ndarray or None
        (n,) [s].
    sliding_friction : ndarray or None
        (n, 3) [N m, N m, rad/s; N, N, m/s]: Coulomb friction, the friction at rest towards which
        it rises, and the velocity at which it has risen half-way, of joints that stay in motion.
        It belongs to no scene: an instant knows no joint that its friction holds.

    """

    robot: Robot
    gravity: Array
    damping: Array | None = None
    armature: Array | None = None
    external_wrench: bool = False
    brakes: bool = False
    payload_input: bool = False
    friction: Array | None = None
    static_friction: Array | None = None
    stribeck_velocity: Array | None = None
    joint_limits: Array | None = None
    restitution: Array | None = None
    stiffness: Array | None = None
    rest_position: Array | None = None
    effort_limits: Array | None = None
    torque_speed: Array | None = None
    gravity_compensation: Plant | None = None
    motor_lag: Array | None = None
    sliding_friction: Array | None = None

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            if isinstance(value, np.ndarray):
                object.__setattr__(self, key, frozen(value))

    @property
    def digest(self) -> str:
        """SHA-256 of all numbers and switches, on which the recorded programs depend."""
        state = hashlib.sha256()
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, (Robot, Plant)):
                value = value.digest
            exact = isinstance(value, np.ndarray)
            text = value.astype('<f8').tobytes() if exact else repr(value).encode()
            state.update(f'{item.name}='.encode() + text)
        return state.hexdigest()


def without_step_effects(plant: Plant) -> Plant:
    """Return a plant without dry friction, stops and lag: the accelerations at an instant."""
    off: dict[str, Any] = dict.fromkeys(STEP_EFFECTS)
    return replace(plant, **off)


def in_motion(plant: Plant) -> Plant:
    """
    Return the plant of joints that stay in motion, or are held by brakes.

    Dry friction is a torque that depends on the velocity then, and stops are out of reach.
    """
    smooth = without_step_effects(plant)
    if plant.friction is None or plant.static_friction is None:
        return replace(smooth, brakes=True)
    # Without a velocity for it, friction falls to that of the sliding joint at once.
    static, velocity = plant.friction, np.ones_like(plant.friction)
    if plant.stribeck_velocity is not None:
        static, velocity = plant.static_friction, plant.stribeck_velocity
    friction = np.stack([plant.friction, static, velocity], axis=1)
    return replace(smooth, brakes=True, sliding_friction=friction)


def check_instant(plant: Plant) -> None:
    """Raise ValueError for effects that act over a step of time, not at an instant."""
    over = [key for key in STEP_EFFECTS if getattr(plant, key) is not None]
    if over:
        raise ValueError(
            f'{quote_all(over)} of the scene act over a step of time, not at an instant: '
            'simulate with Simulator or Ensemble, or leave them out of the scene'
        )
