# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Plant: a scene and a robot as numbers, which an algorithm records as a program.

    resolve                the plant of a robot and a scene
    check_joint_inertia    refuses a last joint that nothing resists
    check_instant          refuses effects that a program of one instant cannot have
    without_step_effects   a plant without those
    in_motion              the same, with the friction of joints that stay in motion
    without_drives         a plant whose input tau is the torque of its motors
    without_torques        a plant whose only torques are inertia's and the wrench's
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

from pfd_core.model.effects import EFFECTS, FIELDS, INPUT, JOINTS, MOTORS, STEP
from pfd_core.model.geometry import product
from pfd_core.model.robot import Payload, Robot, check_robot, link_label, own_inertia, with_payload
from pfd_core.model.scene import Scene, given_scene
from pfd_core.model.values import Array, FrozenArrays, frozen, quote, quote_all

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
        Scene has no such field: at an instant no joint sticks.
    effects : mapping
        Field of Scene -> numbers of an effect that is on, (n,) or (n, columns), in the units of
        its record in `pfd_core.model.effects`. Static friction is there with friction, and
        restitution with joint limits. Each field is an attribute as well,
        `plant.damping`, and None where the effect is off. `torque_speed`, (n, k, 2), has rows
        (speed, torque). Rows beyond a joint's table have infinite speeds; a joint without a
        table has infinite torques.

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


def resolve(robot: Robot, scene: Scene | None = None) -> Plant:
    """
    Return a scene as numbers for a robot.

    An effect that is off, or whose numbers are all zero, or infinite for a limit, has no numbers.

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
    values = {key: field.resolved(robot, getattr(scene, key)) for key, field in FIELDS.items()}
    effects: dict[str, Array] = {}
    for effect in EFFECTS:
        if not effect.needs and effect.fields[0].has_numbers:
            found = effect.plant_numbers(robot, values)
            effects |= {key: array for key, array in found.items() if array is not None}
    gravity = np.zeros(3) if scene.gravity is None else np.asarray(scene.gravity)
    plant = Plant(
        robot=with_payload(robot, scene.payload) if isinstance(scene.payload, Payload) else robot,
        gravity=product(robot.base_rotation.T, gravity),
        external_wrench=scene.external_wrench,
        brakes=scene.brakes,
        payload_input=scene.payload == INPUT,
        gravity_compensation=_compensation(robot, scene),
        effects=effects,
    )
    return _without_compensated_gravity(plant)


def _without_compensated_gravity(plant: Plant) -> Plant:
    """Return a plant without gravity if its drives take exactly that away, without limits."""
    model = plant.gravity_compensation
    if model is None or any(e.acts == MOTORS and e.field in plant.effects for e in EFFECTS):
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


def without_step_effects(plant: Plant) -> Plant:
    """Return a plant without dry friction, stops and lag: the accelerations at an instant."""
    return _without(plant, STEP_EFFECTS)


def has_drives(plant: Plant) -> bool:
    """Return whether motors give other torques than the commanded ones."""
    return any(getattr(plant, key) is not None for key in DRIVES)


def without_drives(plant: Plant) -> Plant:
    """Return a plant whose input tau is the torque of its motors."""
    return _without(plant, DRIVES)


def without_torques(plant: Plant) -> Plant:
    """Return a plant whose only torques are inertia's and the wrench's: H qdd = tau at rest."""
    torques = [
        item.name
        for effect in EFFECTS
        if effect.acts == JOINTS and not effect.inertia
        for item in effect.fields
    ]
    return replace(_without(plant, (*torques, *DRIVES)), gravity=np.zeros(3))


def without_viscosity(plant: Plant) -> Plant:
    """Return a plant whose joints take no torque in proportion to their velocity."""
    return _without(plant, VISCOSITIES)


def with_inertia(plant: Plant, inertia: Array) -> Plant:
    """Return a plant with another inertia of the joints, (n,) [kg m^2, kg]."""
    return replace(plant, effects={**_without(plant, INERTIAS).effects, INERTIAS[0]: inertia})


def _without(plant: Plant, names: Collection[str]) -> Plant:
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
    # Without a Stribeck velocity, friction falls to the sliding value at once.
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


def check_joint_inertia(plant: Plant) -> None:
    """
    Raise ValueError if the last link has no inertia about its joint; names link and joint.

    The last joint's diagonal element of the joint-space inertia is the same in every position:
    Izz + m (x^2 + y^2) + rotor of a joint that turns about z, m + rotor of one that slides. An
    element of zero makes the matrix singular in every position.
    """
    robot, last = plant.robot, plant.robot.n - 1
    rotor = 0.0 if plant.inertia is None else float(plant.inertia[last])
    if own_inertia(robot, last) + rotor == 0:
        slides = robot.joint_types[last] == 'prismatic'
        raise ValueError(
            f'{link_label(robot, last)} has no {"mass" if slides else "inertia about its joint"}, '
            'so the acceleration of '
            f'{quote(robot.joint_names[last])} has no value: give it a mass, an inertia, a '
            'payload or an armature'
        )
