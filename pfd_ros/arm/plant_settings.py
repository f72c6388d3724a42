# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The settings of the simulated plant: the effects that act on the robot, and its payload."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import pfd_core as pfd
from pfd_ros.arm.setting_fields import setting

# Far beyond any arm's, in kg, m and kg m^2.
LARGEST_MASS, LARGEST_CENTER, LARGEST_INERTIA = 1e5, 1e3, 1e6
# A flat body reaches the bound of the triangle rule; this is far above its rounding.
TRIANGLE_TOLERANCE = 1e-9
# A value of `armature`, as of Scene.
ESTIMATED = 'estimated'
# Fields that a scene file stands for.
EFFECTS = (
    *('gravity', 'damping', 'friction', 'armature', 'joint_limits', 'restitution'),
    *('joint_damping', 'joint_friction', 'joint_armature', 'motor_lag'),
)
# Fields that other values need other native code for.
PAYLOAD = ('payload_mass', 'payload_center', 'payload_inertia')
COMPILED = frozenset({'gravity_compensation', *PAYLOAD})
# Values of `payload_changes`.
INPUT, CONSTANT = 'input', 'constant'
PAYLOAD_CHANGES = ('auto', INPUT, CONSTANT)


def payload_changes(wanted: str, method: str) -> str:
    """Return what `payload_changes` stands for with a method of forward dynamics.

    Raises
    ------
    ValueError
        If the method takes no payload as an input.
    """
    if wanted == 'auto':
        return INPUT if method in pfd.PAYLOAD_METHODS else CONSTANT
    if wanted == INPUT and method not in pfd.PAYLOAD_METHODS:
        raise ValueError(
            f'payload_changes is {INPUT!r}, but {method} takes no payload as an input: '
            f'use {CONSTANT!r}, or one of the methods {list(pfd.PAYLOAD_METHODS)}'
        )
    return wanted


def _of_joints(name: str, text: str) -> Any:
    """Return a field of numbers for each joint: by default the model's if the switch is on.

    `name` is that of the group of parameters, of the switch, and of the numbers of the model.
    """

    def default(settings: Any, robot: pfd.Robot) -> np.ndarray:
        switch = getattr(settings, name)
        if switch == ESTIMATED:
            return pfd.estimated_armature(robot)
        numbers: np.ndarray = getattr(robot, name) * float(switch)
        return numbers

    return setting((), text, 0.0, 1e6, name=name, per_joint=True, joint_default=default)


@dataclass(frozen=True)
class PlantSettings:
    """The part of the settings that is about the plant."""

    gravity: tuple[float, ...] = setting(
        (0.0, 0.0, -9.81), 'Gravity in the base frame, m/s^2; zeros switch it off'
    )
    damping: bool = setting(False, 'Viscous damping of the joints as the model states it')
    friction: bool = setting(False, 'Coulomb friction of the joints as the model states it')
    armature: bool | str = setting(
        False,
        'Rotor inertia of the joints: true as the model states it; estimated as the model states '
        'it, and from effort and velocity limits where it states none',
        values=(False, True, ESTIMATED),
    )
    joint_limits: bool = setting(False, 'Stops at the position limits of the model')
    restitution: float = setting(
        0.0, 'Share of its velocity that a joint keeps when it bounces off its stop', 0.0, 1.0
    )
    joint_damping: tuple[float, ...] = _of_joints(
        'damping', 'Viscous damping of the joint, N m s/rad or N s/m'
    )
    joint_friction: tuple[float, ...] = _of_joints(
        'friction', 'Coulomb friction of the joint, N m or N'
    )
    joint_armature: tuple[float, ...] = _of_joints(
        'armature', 'Rotor inertia of the joint times the square of its gear ratio, kg m^2 or kg'
    )
    motor_lag: tuple[float, ...] = setting(
        (),
        'Time constant with which the motor of the joint follows its effort, s',
        0.0,
        10.0,
        per_joint=True,
    )
    scene: str = setting('', "Scene file (YAML) in the place of all effects above; '' takes those")
    gravity_compensation: bool = setting(
        False,
        'Add the gravity torques of the robot without payload to the commanded efforts',
        dynamic=True,
    )
    payload_mass: float = setting(
        0.0,
        "Mass of a payload, kg; 0 takes the scene file's, if any",
        0.0,
        LARGEST_MASS,
        name='payload.mass',
        dynamic=True,
    )
    payload_center: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0),
        'Centre of mass of the payload (x, y, z) in the frame of the tip link, m',
        -LARGEST_CENTER,
        LARGEST_CENTER,
        name='payload.center',
        dynamic=True,
    )
    payload_inertia: tuple[float, ...] = setting(
        (0.0,) * 6,
        'Inertia of the payload (xx, xy, xz, yy, yz, zz) about its centre of mass, in the axes of '
        'the tip link, kg m^2',
        -LARGEST_INERTIA,
        LARGEST_INERTIA,
        name='payload.inertia',
        dynamic=True,
    )
    payload_changes: str = setting(
        'auto',
        'A payload that changes while the arm runs: input of the compiled step, constant of a new '
        'one, or auto, which is input where the method permits it',
        values=PAYLOAD_CHANGES,
    )
    external_wrench: bool = setting(
        False, 'Take forces and moments on the last link from ~/external_wrench'
    )
    external_wrench_timeout: float = setting(
        0.0,
        'Simulated time for which an external wrench acts, s; 0 is until it is replaced',
        0.0,
        1e6,
        dynamic=True,
    )

    @property
    def payload(self) -> pfd.Payload | None:
        """The payload, None without one; ValueError if no body is like that."""
        if not self.payload_mass:
            return None
        xx, xy, xz, yy, yz, zz = self.payload_inertia
        inertia = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
        body = pfd.Payload(self.payload_mass, self.payload_center, inertia)
        moments = np.linalg.eigvalsh(np.array(inertia)).tolist()
        if moments[2] > (moments[0] + moments[1]) * (1 + TRIANGLE_TOLERANCE):
            raise ValueError(
                'payload.inertia is not physically consistent: of its principal moments '
                f'{moments} kg m^2 the largest exceeds the sum of the others'
            )
        return body

    def check_plant(self) -> None:
        """Raise ValueError if the settings of the plant do not go together."""
        for name, count in (('gravity', 3), ('payload_center', 3), ('payload_inertia', 6)):
            given = getattr(self, name)
            if len(given) != count:
                label = name.replace('_', '.')
                raise ValueError(f'{label} needs {count} numbers, got {len(given)}')
        default = PlantSettings()
        given = [name for name in EFFECTS if getattr(self, name) != getattr(default, name)]
        if self.scene and given:
            raise ValueError(f'scene conflicts with {" and ".join(given)}: set one of them only')
        _ = self.payload
