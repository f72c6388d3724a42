# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The settings of the simulated plant: the effects that act on the robot, and its payload."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar
import warnings

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.setting_fields import setting
from pfd_ros.text import listed

# Far beyond any arm's, in kg, m and kg m^2.
LARGEST_MASS, LARGEST_CENTER, LARGEST_INERTIA = 1e5, 1e3, 1e6
# A flat body reaches the bound of the triangle rule; this is far above its rounding.
TRIANGLE_TOLERANCE = 1e-9
# Words for the numbers of a robot, as of Scene.
MODEL, ESTIMATED = 'model', 'estimated'
# Kind of a field with one number, or one row of numbers, a joint.
PER_JOINT = 'per joint'
T = TypeVar('T')
# Setting -> the setting whose numbers it has where it has none of its own.
DEFAULTS = {'static_friction': 'joint_friction'}
# Fields that other values need other native code for.
PAYLOAD = ('payload_mass', 'payload_center', 'payload_inertia')
COMPILED = frozenset({'gravity_compensation', *PAYLOAD})


def payload_numbers(payload: pfd.Payload) -> tuple[float, ...]:
    """Return mass, centre of mass and inertia (xx, xy, xz, yy, yz, zz) of a payload, (10,)."""
    upper = np.asarray(payload.inertia)[np.triu_indices(3)]
    return payload.mass, *np.asarray(payload.center).tolist(), *upper.tolist()


def payload_from(numbers: Sequence[float]) -> pfd.Payload:
    """Return the payload of `payload_numbers`; ValueError if no body is like that."""
    mass, x, y, z, xx, xy, xz, yy, yz, zz = numbers
    return pfd.Payload(mass, (x, y, z), ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))


def effect_fields() -> Iterator[Any]:
    """Yield the fields of the effects of the joints, `pfd_core.model.effects.Field`."""
    for effect in pfd.EFFECTS:
        if effect.of_joints:
            yield from effect.fields


def joint_settings(field: Any) -> dict[str, str]:
    """Return the settings with a number for each joint of a field: name -> name of parameters.

    A field with columns has one setting for each; limits, which may be infinite, have none.
    """
    if field.kind != PER_JOINT or field.infinite:
        return {}
    name = f'joint_{field.name}' if field.model else field.name
    if not field.columns:
        return {name: field.name}
    return {f'{name}_{column}': f'{field.name}.{column}' for column in field.columns}


def _effect_settings() -> Iterator[tuple[str, str, Any]]:
    """Yield name, annotation and field of each setting of the effects of the joints."""
    for field in effect_fields():
        if field.kind != PER_JOINT:
            yield field.name, 'float', setting(field.off, field.text, 0.0, field.most)
            continue
        if field.model:
            text = f'{field.text}, as the model states it'
            values: tuple[bool | str, ...] = ()
            if field.estimated:
                text += '; estimated: from effort and velocity limits where it states none'
                values = (False, True, ESTIMATED)
            kind = 'bool | str' if values else 'bool'
            yield field.name, kind, setting(False, text, values=values)
        least = max(field.least, -field.most)
        for k, (name, parameter) in enumerate(joint_settings(field).items()):
            column = parameter.removeprefix(f'{field.name}.')
            text = field.text if column == parameter else f'{field.text}: {column}'
            yield (
                name,
                'tuple[float, ...]',
                setting(
                    (),
                    f'{text}, {field.units(k)}',
                    least,
                    field.most,
                    name=parameter,
                    per_joint=True,
                    joint_default=_of_model(field) if field.model else DEFAULTS.get(name),
                ),
            )


def _of_model(field: Any) -> Callable[[Any, pfd.Robot], NDArray[Any]]:
    """Return the numbers of a field for each joint: the model's if the switch is on."""

    def default(settings: Any, robot: pfd.Robot) -> NDArray[Any]:
        switch = getattr(settings, field.name)
        if switch == ESTIMATED:
            found: NDArray[Any] = field.resolved(robot, ESTIMATED)
            return found
        numbers: NDArray[Any] = field.of_model(robot) * float(bool(switch))
        return numbers

    return default


def _with_effects(cls: type[T]) -> type[T]:
    """Add the settings of the effects of the joints to a class of settings."""
    for name, annotation, value in _effect_settings():
        cls.__annotations__[name] = annotation
        setattr(cls, name, value)
    return cls


def check_joints_without_values(settings: Any, robot: pfd.Robot, joints: Sequence[str]) -> None:
    """Check effects that have numbers for some joints and none for others.

    ValueError for an effect that needs a number for each joint, a warning for one of the model.
    `joints` are in published order. Where no number is given, the scene warns.
    """
    for field in effect_fields():
        for name, parameter in joint_settings(field).items():
            numbers = getattr(settings, name)
            if not numbers:
                continue
            given = {joint for joint, number in zip(joints, numbers, strict=True) if number}
            if field.above and len(given) < robot.n:
                silent = [joint for joint in joints if joint not in given]
                raise ValueError(
                    f'{parameter} must be above 0 for each joint, but is 0 for {listed(silent)}: '
                    f'give {parameter}.{silent[0]} and so on'
                )
            if not field.from_model or getattr(settings, field.name) is not True:
                continue
            silent = [joint for joint in field.unstated(robot) if joint not in given]
            if silent:
                warnings.warn(
                    f'{field.name} is true, but the model of {robot.name!r} states none for '
                    f'{listed(silent)}, which have none: give {parameter}.{silent[0]} and so on',
                    pfd.PhysicsWarning,
                    stacklevel=2,
                )


def given_effects(settings: Any, order: Sequence[int]) -> dict[str, Any]:
    """Return the fields of Scene that settings give, in model order.

    Parameters
    ----------
    settings
        Of the arm.
    order
        Index in the model of each joint, in published order.
    """
    effects: dict[str, Any] = {}
    for field in effect_fields():
        if field.kind != PER_JOINT or field.model:
            value = getattr(settings, field.name)
            effects[field.name] = (value or None) if value is not True else MODEL
        columns = [getattr(settings, name) for name in joint_settings(field)]
        if any(columns):
            values = np.zeros((len(order), len(columns)))
            for column, numbers in enumerate(columns):
                values[list(order), column] = numbers or 0.0
            given = values if field.columns else values[:, 0]
            effects[field.name] = given if given.any() else None
    return {name: value for name, value in effects.items() if value is not None}


@dataclass(frozen=True)
@_with_effects
class PlantSettings:
    """The settings of the plant; settings of the joints come from the table of effects."""

    gravity: tuple[float, ...] = setting(
        (0.0, 0.0, -9.81), 'Gravity in the base frame, m/s^2; zeros switch it off'
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
        for name, count in (('gravity', 3), ('payload_center', 3), ('payload_inertia', 6)):
            given = getattr(self, name)
            if len(given) != count:
                label = name.replace('_', '.')
                raise ValueError(f'{label} needs {count} numbers, got {len(given)}')
        default = PlantSettings()
        effects = ['gravity', *(name for name, *_ in _effect_settings())]
        given = [name for name in effects if getattr(self, name) != getattr(default, name)]
        if self.scene and given:
            raise ValueError(f'scene conflicts with {" and ".join(given)}: set one of them only')
        _ = self.payload
