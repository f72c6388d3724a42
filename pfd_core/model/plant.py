# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Plant: a scene and a robot as numbers, which an algorithm records as a program.

Most effects are torques at an instant, in pfd_core.dynamics (drives, joint_torques); dry friction,
stops and the lag of motors act over a step of time, in pfd_core.simulation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.model.effects import (
    EFFECTS,
    FIELDS,
    INERTIA,
    INPUT,
    JOINTS,
    LINKS,
    MOTORS,
    STEP,
    VISCOSITY,
)
from pfd_core.model.geometry import product
from pfd_core.model.robot import (
    Payload,
    Robot,
    check_robot,
    coupled,
    link_label,
    own_inertia,
    turned,
    with_payload,
)
from pfd_core.model.scene import Scene, given_scene
from pfd_core.model.values import Array, FrozenArrays, digest_of, quote, quote_all

# The kinds of effects at an instant.
INSTANT = (LINKS, INERTIA, VISCOSITY, JOINTS, MOTORS)
# Share of a distance or an inertia that rounding leaves of one that is zero.
LEFT = 16 * 2.0**-53


@dataclass(frozen=True, eq=False)
class Plant(FrozenArrays):
    """
    A scene as numbers for one robot.

    Each field of Scene with numbers is an attribute as well, `plant.damping`: its numbers, (n,) or
    (n, columns), in the units of its record in `pfd_core.model.effects`, and None where its effect
    is off. Static friction is there with friction, and restitution with joint limits. The rows
    (speed, torque) of `torque_speed`, (n, k, 2), have infinite speeds beyond a joint's table, and
    infinite torques for a joint without a table.
    """

    robot: Robot  # with its payload fixed to it, unless the payload is an input
    gravity: Array  # (3,) [m/s^2], in the axes of frame 0; zeros without gravity
    # Whether a wrench on the last link, and joints held at run time, are inputs.
    external_wrench: bool = False
    brakes: bool = False
    # Time [s] by which a step multiplies the viscosity, see `implicit_inertia`; 0 for none.
    implicit: float = 0.0
    # The robot and gravity whose gravity torques the drives add.
    gravity_compensation: Plant | None = None
    effects: Mapping[str, Array] = field(default_factory=dict)  # by field of Scene, if on
    # Numbers of the links in place of the robot's (pfd_core.dynamics.bodies), where some vary.
    links: Mapping[str, Array] = field(default_factory=dict)
    # Field -> place in the input of parameters of each number that varies, -1 for a constant. The
    # plant has NaN for such a number (pfd_core.dynamics.numbers).
    varied: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.__setstate__(vars(self))

    def __getattr__(self, name: str) -> Array | None:
        """Return the numbers of a field of Scene, None where its effect is off."""
        if name in FIELDS and FIELDS[name].has_numbers:
            return self.effects.get(name)
        raise AttributeError(f'{type(self).__name__!r} object has no attribute {name!r}')

    @property
    def inertia(self) -> Array | None:
        """Inertia of the joints themselves, (n,) [kg m^2, kg], which H has on its diagonal."""
        return self._sum(INERTIA)

    @property
    def viscosity(self) -> Array | None:
        """Torque of the joints for each unit of velocity, (n,) [N m s/rad, N s/m]."""
        return self._sum(VISCOSITY)

    @property
    def implicit_inertia(self) -> Array | None:
        """Inertia of the joints plus `implicit` times their viscosity, (n,) [kg m^2, kg]."""
        if not self.implicit or self.viscosity is None:
            return None
        added: Array = self.implicit * self.viscosity
        return added if self.inertia is None else self.inertia + added

    @property
    def base_acceleration(self) -> Array:
        """Acceleration of the base that gravity is equal to, (3,) [m/s^2]."""
        return -self.gravity

    @property
    def friction_drop(self) -> Array | None:
        """Friction at rest less Coulomb friction, (n,) [N m, N]."""
        if self.friction is None or self.static_friction is None:
            return None
        drop: Array = self.static_friction - self.friction
        return drop

    @property
    def stribeck_rate(self) -> Array | None:
        """One over the Stribeck velocity, (n,) [s/rad, s/m]."""
        velocity = self.stribeck_velocity
        return None if velocity is None else 1.0 / velocity

    def _sum(self, kind: str) -> Array | None:
        found = [array for name, array in self.effects.items() if FIELDS[name].part == kind]
        return sum(found[1:], found[0]) if found else None

    def only(self, *kinds: str) -> Plant:
        """
        Return the plant with effects of these kinds alone.

        LINKS is gravity; MOTORS includes gravity compensation. The inputs stay: a wrench, brakes
        and parameters.
        """
        kept = {name: x for name, x in self.effects.items() if FIELDS[name].part in kinds}
        off: dict[str, Any] = {}
        if LINKS not in kinds:
            off['gravity'] = np.zeros(3)
        if MOTORS not in kinds:
            off['gravity_compensation'] = None
        return replace(self, **off, effects=kept)

    @property
    def digest(self) -> str:
        """SHA-256 of all numbers and switches, on which the recorded programs depend."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        for key in ('effects', 'links', 'varied'):
            values |= {f'{key}.{name}': array for name, array in values.pop(key).items()}
        return digest_of({key: getattr(x, 'digest', x) for key, x in sorted(values.items())})


def resolve(
    robot: Robot, scene: Scene | None = None, arms: Mapping[str, Array] = MappingProxyType({})
) -> Plant:
    """
    Return a scene as numbers for a robot; gravity alone without a scene.

    `arms` are fields of the scene whose numbers differ among some arms, with an axis of arms in
    front; the plant then has the numbers of all arms. With payload="input" the plant is that of
    the robot without payload, see pfd_core.dynamics.bodies.with_payload_input. ValueError if the
    numbers do not fit the robot or each other.
    """
    check_robot(robot)
    scene = given_scene(scene)
    values: dict[str, Array | None] = {
        key: arms[key] if key in arms else item.resolved(robot, getattr(scene, key))
        for key, item in FIELDS.items()
    }
    given = np.zeros(3) if scene.gravity is None else scene.gravity
    gravity = np.array(arms.get('gravity', given), dtype=float)
    to_frame_0 = robot.base_rotation.T
    if turned(robot):
        to_frame_0 = product(to_frame_0, robot.root_rotation.T)
    effects: dict[str, Array | None] = {}
    for effect in EFFECTS:
        effects |= effect.numbers(robot, values)
    rows = [product(to_frame_0, g) for g in gravity.reshape(-1, 3)]
    model, compensation = scene.gravity_compensation, None
    if model is not False:
        model = model if isinstance(model, Scene) else Scene(gravity=scene.gravity)
        compensation = resolve(robot, model)
    plant = Plant(
        robot=with_payload(robot, scene.payload) if isinstance(scene.payload, Payload) else robot,
        gravity=np.array(rows).reshape(gravity.shape),
        external_wrench=scene.external_wrench,
        brakes=scene.brakes,
        gravity_compensation=compensation if compensation and compensation.gravity.any() else None,
        effects={key: array for key, array in effects.items() if array is not None},
    )
    return plant if scene.payload == INPUT else _without_compensated_gravity(plant)


def _without_compensated_gravity(plant: Plant) -> Plant:
    """Return a plant without gravity if its drives take exactly that away, at any torque."""
    model = plant.gravity_compensation
    limited = plant.load_friction is not None or _limits_motors(plant)
    if model is None or limited or model.robot != plant.robot:
        return plant
    if (model.gravity != plant.gravity).any():
        return plant
    return replace(plant, gravity=np.zeros(3), gravity_compensation=None)


def has_drives(plant: Plant) -> bool:
    """Return whether motors give other torques than the commanded ones."""
    return plant.gravity_compensation is not None or _limits_motors(plant)


def _limits_motors(plant: Plant) -> bool:
    return any(FIELDS[name].acts == MOTORS for name in plant.effects)


def check_instant(plant: Plant, fields: Iterable[str] = FIELDS) -> None:
    """Raise ValueError for effects, of these, that act over a step of time, not at an instant."""
    over = [key for key in fields if key in plant.effects and FIELDS[key].acts == STEP]
    if over:
        s, them = ('s', 'it') if len(over) == 1 else ('', 'them')
        raise ValueError(
            f'{quote_all(over)} of the scene act{s} over a step of time, not at an instant: '
            f'simulate with Simulator or Ensemble, or leave {them} out of the scene'
        )


def check_joint_inertia(plant: Plant) -> None:
    """
    Raise ValueError if a joint and all that it moves have no inertia; names link and joint.

    Its element of the joint-space inertia, Izz + m (x^2 + y^2) + rotor of a joint that turns about
    z and m + rotor of one that slides, is then zero in all positions.
    """
    robot, rotors = plant.robot, plant.inertia
    for i in reversed(range(robot.links)):
        name = robot.movers[i].name
        # A joint with followers moves other links as well.
        alone = name not in coupled(robot)
        still = alone and (rotors is None or rotors[robot.joint_names.index(name)] == 0)
        if still and _without_own_inertia(robot, i):
            kind = 'mass' if robot.movers[i].kind == 'prismatic' else 'inertia about its joint'
            joint = quote(name)
            raise ValueError(
                f'{link_label(robot, i)} has no {kind} and {joint} no armature, so its '
                f'acceleration has no value: give one of them, a payload with {kind}, or '
                f'lock {joint}'
            )
        if robot.masses[i] or robot.inertias[i].any():
            return


def _without_own_inertia(robot: Robot, i: int) -> bool:
    """Return whether a link has no inertia about its joint, or no mass, apart from rounding."""
    own, m = own_inertia(robot, i), robot.masses[i]
    if robot.movers[i].kind == 'prismatic':
        return own == 0
    # Of a body on an axis that is not along x, y or z, what rotations and sums round is left.
    length = np.linalg.norm(robot.translations[i]) + np.linalg.norm(robot.centers[i])
    return bool(own <= LEFT * np.trace(robot.inertias[i]) + m * (LEFT * length) ** 2)
