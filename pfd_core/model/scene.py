# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Scene: the effects that act on a robot, each checked by itself.

A scene fits any robot with as many joints as its arrays have; `pfd_core.model.plant.resolve`
combines both into a Plant. The default is rigid links and gravity, nothing else.

The fields belong to the records in `pfd_core.model.effects`, which check them. They are
declared here as well, so that editors and type checkers know the arguments of Scene.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace
import hashlib
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.model.effects import EFFECTS, ESTIMATED, FIELDS, INPUT, MODEL, NAMED, NEEDS
from pfd_core.model.robot import Payload
from pfd_core.model.values import choice, number_from_text, quote
from pfd_core.model.yaml_files import read_yaml, table, yaml_text

WORDS: dict[str, Any] = {
    'null': None,
    'true': True,
    'True': True,
    'false': False,
    'False': False,
    **{word: word for word in (MODEL, ESTIMATED, INPUT)},
}


@dataclass(frozen=True)
class Scene:
    """
    The effects that act on a robot; an effect that is off costs nothing.

    Units are for revolute joints; for prismatic joints read m, N, kg for rad, N m, kg m^2.

    Attributes
    ----------
    gravity : array_like or None
        Acceleration of free fall, (3,) [m/s^2], in the frame of the base link.
    damping : None, "model" or array_like
        Viscous friction of the joints, (n,) [N m s/rad]; "model" for the robot's own.
    armature : None, "model", "estimated" or array_like
        Rotor inertia at the joints, (n,) [kg m^2]: inertia of the rotor times the square of
        the gear ratio; "model" for the robot's own; "estimated" for an estimate by
        `estimated_armature` at joints whose model states none.
    payload : Payload, "input" or None
        A body fixed to the last link; "input" makes its numbers inputs at run time, so that a
        change of payload needs no compilation.
    external_wrench : bool
        Whether a force and a moment on the last link are inputs.
    brakes : bool
        Whether joints can be braked at run time; a braked joint does not accelerate.
    friction : None, "model" or array_like
        Coulomb friction of a joint in motion, (n,) [N m]; "model" for the robot's own.
    static_friction : None or array_like
        Friction that a resting joint can hold, (n,) [N m], at least `friction`, its default.
    stribeck_velocity : None or array_like
        Velocity v_s at which static friction F_s has fallen half-way to Coulomb friction F_c,
        (n,) [rad/s]: F_c + (F_s - F_c)/(1 + (v/v_s)^2). None: it drops at once.
    joint_limits : None, "model" or array_like
        Stops, lower and upper, (n, 2) [rad]; infinite for none; "model" for the robot's own.
    restitution : float or array_like
        Coefficient of restitution of the stops, from 0 to 1, one for all joints or (n,).
    stiffness : None or array_like
        Springs between the joints and `rest_position`, (n,) [N m/rad]. With w^2 the largest
        eigenvalue of H^-1 diag(stiffness), steps below 0.2 / w resolve the oscillation.
    rest_position : None or array_like
        Positions at which the springs have no torque, (n,) [rad]; None is zero everywhere.
    cogging : None or array_like
        Amplitude a [N m], periods k per turn and phase p [rad], (n, 3): a resisting
        torque a sin(k q + p), with stable equilibria where k q + p is a multiple of 2 pi; for
        prismatic joints k is per 2 pi m. Steps are bounded as for springs of stiffness a k.
    effort_limits : None, "model" or array_like
        Largest torque of the motors, including gravity compensation, (n,) [N m]; infinite
        for none; "model" for the robot's own.
    torque_speed : None, "model" or sequence
        Per joint None or a table of rows (speed, torque), (k, 2) [rad/s, N m]: the largest
        driving torque, linear between the rows and constant beyond them; speeds increase,
        torques do not. The braking torque is limited by the first row at any speed. "model": the
        robot's effort limit up to its velocity limit, then linear to zero at twice that speed.
    gravity_compensation : bool or Scene
        Whether the motors add gravity torques to the commanded torques: True for the
        robot without its payload, in the gravity of this scene; a scene for its own gravity and
        payload.
    motor_lag : None or array_like
        Time constants of first-order lags of the motor torques, (n,) [s]; gravity compensation
        and limits act after the lag.

    Raises
    ------
    ValueError
        If a value has a wrong type, a number is out of its range, or an effect lacks the effect
        that it refines.

    """

    gravity: ArrayLike | None = (0.0, 0.0, -9.81)
    damping: ArrayLike | str | None = None
    armature: ArrayLike | str | None = None
    payload: Payload | str | None = None
    external_wrench: bool = False
    brakes: bool = False
    friction: ArrayLike | str | None = None
    joint_limits: ArrayLike | str | None = None
    static_friction: ArrayLike | None = None
    stribeck_velocity: ArrayLike | None = None
    restitution: ArrayLike = 0.0
    stiffness: ArrayLike | None = None
    rest_position: ArrayLike | None = None
    cogging: ArrayLike | None = None
    effort_limits: ArrayLike | str | None = None
    torque_speed: Any = None
    gravity_compensation: bool | Scene = False
    motor_lag: ArrayLike | None = None

    def __post_init__(self) -> None:
        for key, field in FIELDS.items():
            object.__setattr__(self, key, field.checked(getattr(self, key)))
        compensation = _compensation(self.gravity_compensation)
        object.__setattr__(self, 'gravity_compensation', compensation)
        for key, needed in NEEDS.items():
            if getattr(self, key) != FIELDS[key].off and getattr(self, needed) is None:
                raise ValueError(f'{key} was given without {needed}: give the scene both')

    @property
    def digest(self) -> str:
        """SHA-256 of all fields, as 64 hexadecimal digits."""
        # The fields are None, bool, str, tuples of floats and a scene, whose repr is exact.
        return hashlib.sha256(repr(self).encode()).hexdigest()

    def without(self, names: Collection[str]) -> Scene:
        """
        Return the scene without the named effects, and without effects that need them.

        Raises
        ------
        ValueError
            If a name is not an effect.

        """
        if not isinstance(names, (set, frozenset, tuple, list)):
            raise ValueError(f'names must be a set of names of effects, got {quote(names)}')
        for name in names:
            choice('names', name, NAMED)
        changes: dict[str, Any] = {
            field.name: field.off
            for effect in EFFECTS
            if not _with_needed(effect.name).isdisjoint(names)
            for field in effect.fields
        }
        return replace(self, **changes)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the scene to a YAML file, which `load_scene` reads as an equal scene."""
        if not isinstance(path, (str, PathLike)):
            raise TypeError(f'path must be a str or a PathLike, got {quote(path)}')
        Path(path).write_text(scene_to_yaml(self), encoding='utf-8')


def scene_to_yaml(scene: Scene) -> str:
    """Return a scene as YAML: its gravity, and the fields that differ from their defaults."""
    if not isinstance(scene, Scene):
        raise ValueError(f'scene must be a Scene, got {quote(scene)}')
    return yaml_text(_document(scene))


def _with_needed(name: str) -> set[str]:
    """Return the names of an effect and of the effects that it needs."""
    needed = NAMED[name].needs
    return {name} | (_with_needed(needed) if needed else set())


def _compensation(value: Any) -> bool | Scene:
    """Return True, False, or the scene of a model, which has gravity and a payload only."""
    if not isinstance(value, Scene):
        if not isinstance(value, (bool, np.bool_)):
            raise ValueError(
                f'gravity_compensation must be True, False or a Scene, got {quote(value)}'
            )
        return bool(value)
    others = [
        item.name
        for item in fields(value)
        if item.name not in ('gravity', 'payload') and getattr(value, item.name) != item.default
    ]
    if others:
        raise ValueError(
            'the scene of gravity_compensation may have gravity and a payload, nothing else: '
            f'it has {others[0]}'
        )
    if value.payload == INPUT:
        raise ValueError(
            'the scene of gravity_compensation must have a Payload or None as payload, '
            f'got {INPUT!r}'
        )
    return value


def _document(part: Any) -> dict[str, Any]:
    """Return the fields of a scene or a payload as dict, list, float, bool, str and None."""
    found = {item.name: (getattr(part, item.name), item.default) for item in fields(part)}
    return {
        key: _plain(value)
        for key, (value, default) in found.items()
        if value != default or key == 'gravity'
    }


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return _document(value) if isinstance(value, (Scene, Payload)) else value


def scene_from_yaml(text: str, source: str) -> Scene:
    """
    Return the scene of a YAML string.

    Parameters
    ----------
    text : str
        A table of the fields of Scene. `null` is None, `true` and `false` are truth values,
        `model` is the robot's own, all else numbers and lists of numbers; `payload` is `input` or
        a table of the fields of Payload, and `gravity_compensation` may be a table of a scene.
    source : str
        Origin of the YAML, for errors.

    Raises
    ------
    ValueError
        If it is not YAML, a key is unknown or duplicate, or Scene rejects a value.

    """
    document = read_yaml(text, source)
    try:
        return _scene_of('the scene', document)
    except ValueError as error:
        raise ValueError(f'{quote(source)}: {error}') from error


def _scene_of(label: str, value: Any) -> Scene:
    given: dict[str, Any] = {}
    for key, item in table(label, value, (), tuple(item.name for item in fields(Scene))).items():
        if key == 'payload' and isinstance(item, Mapping):
            body = table(key, item, ('mass',), ('center', 'inertia'))
            given[key] = Payload(**{k: _value(f'payload {k}', x) for k, x in body.items()})
        elif key == 'gravity_compensation' and isinstance(item, Mapping):
            given[key] = _scene_of(key, item)
        else:
            given[key] = _value(key, item)
    return Scene(**given)


def _value(key: str, item: Any) -> Any:
    """Return a string as a number or a keyword's value; also each element of a list."""
    if isinstance(item, list):
        return [_value(key, entry) for entry in item]
    if not isinstance(item, str):
        raise ValueError(f'{key} must be a number, a list or a word, got a table')
    return WORDS[item] if item in WORDS else number_from_text(key, item, infinite=True)
