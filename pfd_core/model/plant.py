# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Plant: a scene and a robot as numbers, which an algorithm records as a program.

    check_instant          refuses effects that a program of one instant cannot have
    without_step_effects   a plant without those
    in_motion              the same, with the friction of joints that stay in motion
    without_drives         a plant whose input tau is the torque of its motors
    without_joint_torques  a plant whose joints take no torque but their inertia's
    without_viscosity      a plant whose joints take no torque in proportion to their velocity
    with_inertia           a plant with another inertia of its joints

Most effects are torques at an instant, in pfd_core.algorithms.chain (drives, joint_torques). Dry
friction, stops and the lag of motors act over a step of time, in pfd_core.simulation.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
import hashlib
from types import MappingProxyType
from typing import Any

import numpy as np

from pfd_core.model.effects import EFFECTS, FIELDS, JOINTS, MOTORS, STEP
from pfd_core.model.error_text import quote_all
from pfd_core.model.frozen_arrays import FrozenArrays, frozen
from pfd_core.model.geometry import Array
from pfd_core.model.robot import Robot

# Fields of Scene whose effects act over a step of time.
STEP_EFFECTS = tuple(
    item.name for effect in EFFECTS if effect.acts == STEP for item in effect.fields
)
# Fields of Plant by which a motor gives another torque than the commanded one.
DRIVES = (
    *(item.name for effect in EFFECTS if effect.acts == MOTORS for item in effect.fields),
    'sliding_friction',
)
# Fields of Scene that are an inertia of the joints, and a torque for each unit of velocity.
INERTIAS = tuple(effect.field for effect in EFFECTS if effect.acts == JOINTS and effect.inertia)
VISCOSITIES = tuple(effect.field for effect in EFFECTS if effect.viscosity)


@dataclass(frozen=True, eq=False)
class Plant(FrozenArrays):
    """
    A scene as numbers for one robot; an effect that is off is None.

    Attributes
    ----------
    robot : Robot
        The chain with its payload fixed to it, unless the payload is an input.
    gravity : ndarray
        (3,) [m/s^2], in the axes of frame 0; zeros without gravity.
    external_wrench, brakes, payload_input : bool
        Whether a wrench on the last link, joints held at run time, and a payload are inputs.
    gravity_compensation : Plant or None
        The robot and gravity whose gravity torques the drives add.
    sliding_friction : ndarray or None
        (n, 3) [N m, N m, rad/s; N, N, m/s]: Coulomb friction, the friction at rest towards which
        it rises, and the velocity at which it has risen half-way, of joints that stay in motion.
        It is no field of Scene: at an instant no joint sticks.
    effects : mapping
        Field of Scene -> numbers of an effect that is on, (n,) or (n, columns), in the units of
        its record in `pfd_core.model.effects`. Static friction is there with friction, and
        restitution with joint limits. Each field is an attribute as well,
        `plant.damping`, and None where the effect is off. `torque_speed`, (n, k, 2), has rows
        (speed, torque); rows beyond a joint's own have infinite speeds, and those of a joint
        without a table infinite torques.

    """

    robot: Robot
    gravity: Array
    external_wrench: bool = False
    brakes: bool = False
    payload_input: bool = False
    gravity_compensation: Plant | None = None
    sliding_friction: Array | None = None
    effects: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            if isinstance(value, np.ndarray):
                object.__setattr__(self, key, frozen(value))
        kept = {key: frozen(array) for key, array in self.effects.items()}
        object.__setattr__(self, 'effects', MappingProxyType(kept))

    def __getattr__(self, name: str) -> Array | None:
        """Return the numbers of a field of Scene, None where its effect is off."""
        if name in FIELDS and FIELDS[name].has_numbers:
            return self.effects.get(name)
        raise AttributeError(f'{type(self).__name__!r} object has no attribute {name!r}')

    @property
    def inertia(self) -> Array | None:
        """Inertia of the joints themselves, (n,) [kg m^2, kg], which H has on its diagonal."""
        return self._sum(INERTIAS)

    @property
    def viscosity(self) -> Array | None:
        """Torque of the joints for each unit of velocity, (n,) [N m s/rad, N s/m]."""
        return self._sum(VISCOSITIES)

    def _sum(self, fields: Iterable[str]) -> Array | None:
        found = [self.effects[name] for name in fields if name in self.effects]
        return sum(found[1:], found[0]) if found else None

    @property
    def digest(self) -> str:
        """SHA-256 of all numbers and switches, on which the recorded programs depend."""
        state = hashlib.sha256()
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        effects = values.pop('effects')
        for name, value in sorted((values | dict(effects)).items()):
            if isinstance(value, (Robot, Plant)):
                value = value.digest
            exact = isinstance(value, np.ndarray)
            text = value.astype('<f8').tobytes() if exact else repr(value).encode()
            state.update(f'{name}='.encode() + text)
        return state.hexdigest()


def without_step_effects(plant: Plant) -> Plant:
    """Return a plant without dry friction, stops and lag: the accelerations at an instant."""
    return _without(plant, STEP_EFFECTS)


def has_drives(plant: Plant) -> bool:
    """Return whether motors give other torques than the commanded ones."""
    return any(getattr(plant, key) is not None for key in DRIVES)


def without_drives(plant: Plant) -> Plant:
    """Return a plant whose input tau is the torque of its motors."""
    return _without(plant, DRIVES)


def without_joint_torques(plant: Plant) -> Plant:
    """Return a plant whose joints take no torque but inertia's: H qdd = tau at rest."""
    torques = [
        item.name
        for effect in EFFECTS
        if effect.acts == JOINTS and not effect.inertia
        for item in effect.fields
    ]
    return _without(plant, (*torques, *DRIVES))


def without_viscosity(plant: Plant) -> Plant:
    """Return a plant whose joints take no torque in proportion to their velocity."""
    return _without(plant, VISCOSITIES)


def with_inertia(plant: Plant, inertia: Array) -> Plant:
    """Return a plant with another inertia of the joints, (n,) [kg m^2, kg]."""
    return replace(plant, effects={**_without(plant, INERTIAS).effects, INERTIAS[0]: inertia})


def _without(plant: Plant, names: Collection[str]) -> Plant:
    """Return a plant without the numbers of some fields."""
    own = {item.name for item in fields(plant)}
    off: dict[str, Any] = {name: None for name in names if name in own}
    kept = {key: values for key, values in plant.effects.items() if key not in names}
    return replace(plant, **off, effects=kept)


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
