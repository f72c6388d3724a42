# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The settings of the simulated plant: the effects that act on the robot, and its payload."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar
import warnings

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.setting_fields import setting
from pfd_ros.text import listed

# A flat body reaches the bound of the triangle rule; this is far above its rounding.
TRIANGLE_TOLERANCE = 1e-9
# Words for the numbers of a robot, as of Scene.
MODEL, ESTIMATED = 'model', 'estimated'
# Kind of a field with one number, or one row of numbers, a joint.
PER_JOINT = 'per joint'
T = TypeVar('T')
# The effects of the joints, `pfd_core.model.effects.Effect`.
JOINT_EFFECTS = tuple(effect for effect in pfd.EFFECTS if effect.of_joints)
# Setting -> the setting whose numbers it has where it has none of its own.
DEFAULTS = {'static_friction': 'joint_friction'}
# Fields that other values need other native code for.
PAYLOAD = ('payload_mass', 'payload_center', 'payload_inertia')
LOAD = ('load_mass', 'load_center')
SCALES = ('viscous_scale', 'coulomb_scale')
COMPILED = frozenset({'gravity_compensation', *PAYLOAD, *LOAD, *SCALES})


def payload_numbers(payload: pfd.Payload) -> tuple[float, ...]:
    """Return mass, centre of mass and inertia (xx, xy, xz, yy, yz, zz) of a payload, (10,)."""
    upper = np.asarray(payload.inertia)[np.triu_indices(3)]
    return payload.mass, *np.asarray(payload.center).tolist(), *upper.tolist()


def payload_from(numbers: Sequence[float]) -> pfd.Payload:
    """Return the payload of `payload_numbers`; ValueError if no body is like that."""
    mass, x, y, z, xx, xy, xz, yy, yz, zz = numbers
    return pfd.Payload(mass, (x, y, z), ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))


def joint_settings(effect: Any) -> dict[str, str]:
    """Return the settings with a number for each joint of an effect: name -> name of parameters.

    An effect with columns has one setting for each; limits, which may be infinite, have none.
    """
    if effect.kind != PER_JOINT or effect.infinite:
        return {}
    name = f'joint_{effect.field}' if effect.model else effect.field
    if not effect.columns:
        return {name: effect.field}
    return {f'{name}_{column}': f'{effect.field}.{column}' for column in effect.columns}


def _effect_settings() -> Iterator[tuple[str, str, Any]]:
    """Yield name, annotation and field of each setting of the effects of the joints."""
    for effect in JOINT_EFFECTS:
        if effect.kind != PER_JOINT:
            yield effect.field, 'float', setting(effect.off, effect.text, 0.0, effect.most)
            continue
        if effect.estimated:
            text = '; estimated: from effort and velocity limits where it states none'
            text, values = f'{effect.text}, as the model states it{text}', (False, True, ESTIMATED)
            yield effect.field, 'bool | str', setting(False, text, values=values)
        elif effect.model:
            yield effect.field, 'bool', setting(False, f'{effect.text}, as the model states it')
        default = partial(_of_model, effect) if effect.model else None
        for k, (name, parameter) in enumerate(joint_settings(effect).items()):
            column = parameter.removeprefix(f'{effect.field}.')
            text = effect.text if column == parameter else f'{effect.text}: {column}'
            numbers = setting(
                (),
                f'{text}, {effect.units(k)}',
                max(effect.least, -effect.most),
                effect.most,
                name=parameter,
                per_joint=True,
                joint_default=default or DEFAULTS.get(name),
            )
            yield name, 'tuple[float, ...]', numbers


def _of_model(effect: Any, settings: Any, robot: pfd.Robot) -> NDArray[Any]:
    """Return the numbers of an effect for each joint: the model's if its switch is on."""
    switch = getattr(settings, effect.field)
    estimated = switch == ESTIMATED
    found = effect.resolved(robot, ESTIMATED) if estimated else effect.of_model(robot)
    numbers: NDArray[Any] = found * float(bool(switch))
    return numbers


def _with_effects(cls: type[T]) -> type[T]:
    """Add the settings of the effects of the joints to a class of settings."""
    for name, annotation, value in _effect_settings():
        cls.__annotations__[name] = annotation
        setattr(cls, name, value)
    return cls


def check_joints_without_values(settings: Any, robot: pfd.Robot, joints: Sequence[str]) -> None:
    """Warn of effects of the model that have numbers for some joints and none for others.

    `joints` are in published order. Where no number is given, the scene warns.
    """
    for effect in JOINT_EFFECTS:
        if not effect.from_model or getattr(settings, effect.field) is not True:
            continue
        for name, parameter in joint_settings(effect).items():
            numbers = getattr(settings, name)
            given = {joint for joint, number in zip(joints, numbers, strict=False) if number}
            silent = [joint for joint in effect.unstated(robot) if joint not in given]
            if numbers and silent:
                warnings.warn(
                    f'{effect.field} is true, but the model of {robot.name!r} states none for '
                    f'{listed(silent)}, which have none: give {parameter}.{silent[0]} and so on',
                    pfd.PhysicsWarning,
                    stacklevel=2,
                )


def given_effects(settings: Any, order: NDArray[Any]) -> dict[str, Any]:
    """Return the fields of Scene that settings give, in model order."""
    effects: dict[str, Any] = {}
    for effect in JOINT_EFFECTS:
        if effect.kind != PER_JOINT or effect.model:
            value = getattr(settings, effect.field)
            effects[effect.field] = (value or None) if value is not True else MODEL
        columns = [getattr(settings, name) for name in joint_settings(effect)]
        if any(columns):
            values = np.transpose([in_model_order(numbers, order) for numbers in columns])
            given = values if effect.columns else values[:, 0]
            effects[effect.field] = given if given.any() else None
    return {name: value for name, value in effects.items() if value is not None}


def in_model_order(values: Sequence[float], order: NDArray[Any]) -> NDArray[Any]:
    """Return a setting with a number for each joint in model order, (n,); zeros if it is empty."""
    numbers = np.zeros(len(order))
    if len(values):
        numbers[order] = values
    return numbers


_payload = partial(setting, dynamic=True)


@dataclass(frozen=True)
@_with_effects
class PlantSettings:
    """The settings of the plant; settings of the joints come from the table of effects."""

    gravity: tuple[float, ...] = setting(
        (0.0, 0.0, -9.81), 'Gravity in the frame of the root link, m/s^2'
    )
    scene: str = setting('', "Scene file (YAML) in the place of all effects above; '' takes those")
    gravity_compensation: bool = setting(
        False, 'Add the gravity torques of the robot without payload', dynamic=True
    )
    payload_mass: float = _payload(
        0.0, 'Mass, kg; 0: none, or of the scene', 0.0, 1e5, name='payload.mass'
    )
    payload_center: tuple[float, ...] = _payload(
        (0.0,) * 3, 'Centre (x, y, z) in the tip link, m', -1e3, 1e3, name='payload.center'
    )
    payload_inertia: tuple[float, ...] = _payload(
        (0.0,) * 6,
        'Inertia (xx, xy, xz, yy, yz, zz) about its centre, kg m^2',
        -1e6,
        1e6,
        name='payload.inertia',
    )
    load_mass: float = _payload(
        0.0, 'Mass at the tip that gravity compensation knows of, kg', 0.0, 1e5, name='load.mass'
    )
    load_center: tuple[float, ...] = _payload(
        (0.0,) * 3, 'Centre (x, y, z) in the tip link, m', -1e3, 1e3, name='load.center'
    )
    external_wrench: bool = setting(False, 'Take forces on the last link from ~/external_wrench')
    external_wrench_timeout: float = setting(
        0.0, 'Time for which a wrench acts, s; 0: until it is replaced', 0.0, 1e6, dynamic=True
    )

    @property
    def payload(self) -> pfd.Payload | None:
        """The payload, None without one; ValueError if no body is like that."""
        if not self.payload_mass:
            return None
        body = payload_from((self.payload_mass, *self.payload_center, *self.payload_inertia))
        moments = np.linalg.eigvalsh(np.asarray(body.inertia)).tolist()
        if moments[2] > (moments[0] + moments[1]) * (1 + TRIANGLE_TOLERANCE):
            raise ValueError(
                'payload.inertia is not physically consistent: of its principal moments '
                f'{moments} kg m^2 the largest exceeds the sum of the others'
            )
        return body

    def check_plant(self) -> None:
        """Raise ValueError if the settings of the plant do not go together."""
        default = PlantSettings()
        effects = ['gravity', *(name for name, *_ in _effect_settings())]
        given = [name for name in effects if getattr(self, name) != getattr(default, name)]
        if self.scene and given:
            raise ValueError(f'scene conflicts with {" and ".join(given)}: set one of them only')
        _ = self.payload
