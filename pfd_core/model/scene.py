# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Scene: the effects that act on a robot, each checked by itself; scenes as YAML.

The fields belong to the records in `pfd_core.model.effects`, which check them, and are declared
here for editors and type checkers. `pfd_core.model.plant.resolve` makes a Plant of a scene and a
robot with as many joints as its arrays have.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import wraps
import hashlib
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.model.effects import EFFECTS, ESTIMATED, FIELDS, INPUT, MODEL, ByJoint
from pfd_core.model.robot import Payload
from pfd_core.model.values import (
    Array,
    choice,
    fit_shape,
    is_masked,
    number_from_text,
    quote,
    real_array,
)
from pfd_core.model.yaml_files import YAML_WORDS, numbers, read_yaml, table, yaml_text

# Values of all joints, or of some by their names.
JointValues: TypeAlias = ArrayLike | Mapping[str, Any]
# Words of a scene file that are no numbers; errors say None.
WORDS = YAML_WORDS | {'None': None} | {word: word for word in (MODEL, ESTIMATED, INPUT)}


@dataclass(frozen=True)
class Scene:
    """
    The effects that act on a robot; an effect that is off costs nothing.

    A field with one value a joint, (n, ...), may also be a mapping of some joints to their values,
    ``friction={'elbow_joint': 3.0}``, or be given joint by joint,
    ``**{'friction.elbow_joint': 3.0}``; the others have none, or what the field says.
    "model" takes the values of the robot; it is refused for a robot that states none, and warns of
    single joints without one.

    Units are for revolute joints; for prismatic joints read m, N, kg for rad, N m, kg m^2.
    ValueError if a value has a wrong type, a number is out of its range, or an effect lacks the
    effect that it refines.

    Attributes
    ----------
    gravity : array_like or None
        Acceleration of free fall, (3,) [m/s^2], in axes of the root of the model.
    damping : None, "model" or array_like
        Viscous friction of the joints, (n,) [N m s/rad].
    armature : None, "model", "estimated" or array_like
        Rotor inertia times the square of the gear ratio, (n,) [kg m^2]; "estimated" for an
        estimate by `estimated_armature` at joints whose model states none.
    payload : Payload, "input" or None
        A body fixed to the last link; "input": given at run time, without a new compilation.
    external_wrench : bool
        Whether a force and a moment on the last link are inputs.
    brakes : bool
        Whether joints can be braked at run time; a braked joint does not accelerate.
    friction : None, "model" or array_like
        Coulomb friction of a joint in motion, (n,) [N m].
    static_friction : None or array_like
        Friction that a resting joint can hold, (n,) [N m], at least `friction`, its default, also
        of joints that values by joint leave out.
    stribeck_velocity : None or array_like
        Velocity v_s at which static friction F_s has fallen half-way to Coulomb friction F_c,
        (n,) [rad/s]: F_c + (F_s - F_c)/(1 + (v/v_s)^2). None: it drops at once.
    load_friction : None or array_like
        Friction that depends on load, (n,), from 0 to 1: the share mu of the torque of the motor
        that friction takes, ``mu * |tau|``, moving or at rest, besides `friction`.
    joint_limits : None, "model" or array_like
        Stops, lower and upper, (n, 2) [rad]; infinite for none.
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
        Largest torque of the motors with gravity compensation, (n,) [N m]; infinite for none.
    torque_speed : None, "model" or sequence
        Per joint None or a table of rows (speed, torque), (k, 2) [rad/s, N m]: the largest
        driving torque, linear between the rows and constant beyond them; speeds increase,
        torques do not. The braking torque is limited by the first row at any speed. "model": the
        robot's effort limit up to its velocity limit, then linear to zero at twice that speed.
    gravity_compensation : bool or Scene
        Whether the motors add gravity torques to the commanded ones: True for the robot without
        its payload, in the gravity of this scene; a scene for its own gravity and payload.
    motor_lag : None or array_like
        Time constants of first-order lags of the motor torques, (n,) [s]; gravity compensation
        and limits act after the lag. One far below a substep is as good as none: 'rk4' takes
        none for less than a twelfth.

    """

    gravity: ArrayLike | None = (0.0, 0.0, -9.81)
    damping: JointValues | str | None = None
    armature: JointValues | str | None = None
    payload: Payload | str | None = None
    external_wrench: bool = False
    brakes: bool = False
    friction: JointValues | str | None = None
    joint_limits: JointValues | str | None = None
    static_friction: JointValues | None = None
    stribeck_velocity: JointValues | None = None
    load_friction: JointValues | None = None
    restitution: JointValues = 0.0
    stiffness: JointValues | None = None
    rest_position: JointValues | None = None
    cogging: JointValues | None = None
    effort_limits: JointValues | str | None = None
    torque_speed: Any = None
    gravity_compensation: bool | Scene = False
    motor_lag: JointValues | None = None

    def __post_init__(self) -> None:
        for key, field in FIELDS.items():
            object.__setattr__(self, key, field.checked(getattr(self, key)))
        object.__setattr__(self, 'gravity_compensation', _compensation(self.gravity_compensation))
        for key, field in FIELDS.items():
            given = getattr(self, key) != field.off
            if given and field.needs and getattr(self, field.needs) is None:
                raise ValueError(f'{key} was given without {field.needs}: give the scene both')

    @property
    def digest(self) -> str:
        """SHA-256 of all fields, as 64 hexadecimal digits."""
        # The fields are None, bool, str, tuples of floats and a scene, whose repr is exact.
        return hashlib.sha256(repr(self).encode()).hexdigest()

    def without(self, names: Collection[str]) -> Scene:
        """
        Return the scene without the named effects, and without effects that need them.

        Names are those in EFFECTS, such as 'joint stops'; ValueError for others.
        """
        if not isinstance(names, (set, frozenset, tuple, list)):
            raise ValueError(f'names must be a set of names of effects, got {quote(names)}')
        known = [effect.name for effect in EFFECTS]
        for name in names:
            choice('names', name, known)
        off: dict[str, Any] = {}
        # A field comes after the field that it needs.
        for effect in EFFECTS:
            if effect.name in names or effect.needs in off:
                off[effect.field] = effect.off
        return replace(self, **off)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the scene to a YAML file, which `load_scene` reads as an equal scene."""
        if not isinstance(path, (str, PathLike)):
            raise ValueError(f'path must be a str or a PathLike, got {quote(path)}')
        Path(path).write_text(scene_to_yaml(self), encoding='utf-8')


_init = Scene.__init__


@wraps(_init)
def _init_by_joint(self: Scene, *fields: Any, **named: Any) -> None:
    _init(self, *fields, **by_joint(named))


Scene.__init__ = _init_by_joint  # type: ignore[method-assign]


def by_joint(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values by field, with `friction.elbow_joint` as friction of that joint, once."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        name, dot, joint = key.partition('.')
        if dot and name in FIELDS and FIELDS[name].has_numbers:
            value = {joint: value}
        else:
            name = key
        if name in found:
            if not (isinstance(found[name], Mapping) and isinstance(value, Mapping)):
                raise ValueError(f'{name} is given for all joints and for one: use one of them')
            if twice := found[name].keys() & value.keys():
                raise ValueError(f'{name} of joint {quote(min(twice))} is given twice')
            value = {**found[name], **value}
        found[name] = value
    return found


def _compensation(value: Any) -> bool | Scene:
    """Return True, False, or the scene of a model, which has gravity and a payload only."""
    name = 'gravity_compensation'
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if not isinstance(value, Scene):
        raise ValueError(f'{name} must be True, False or a Scene, got {quote(value)}')
    for item in fields(value):
        if item.name not in ('gravity', 'payload') and getattr(value, item.name) != item.default:
            raise ValueError(
                f'the scene of {name} may have gravity and a payload, nothing else: it has '
                f'{item.name}'
            )
    if value.payload == INPUT:
        raise ValueError(
            f'the scene of {name} must have a Payload or None as payload, got {INPUT!r}'
        )
    return value


# To check all fields takes as long as two hundred evaluations of a kernel.
DEFAULT = Scene()


def given_scene(scene: Scene | None, wrench: object = None) -> Scene:
    """Return a scene, the default one for None, with an external wrench if one is given."""
    if scene is None:
        scene = DEFAULT
    if not isinstance(scene, Scene):
        raise ValueError(f'scene must be a Scene or None, got {quote(scene)}')
    return scene if wrench is None else replace(scene, external_wrench=True)


def scene_to_yaml(scene: Scene) -> str:
    """Return a scene as YAML: its gravity, and the fields that differ from their defaults."""
    if not isinstance(scene, Scene):
        raise ValueError(f'scene must be a Scene, got {quote(scene)}')
    return yaml_text(_plain(scene))


def _plain(value: Any) -> Any:
    """Return a value of a scene as dict, list, float, bool, str and None."""
    if isinstance(value, ByJoint):
        return {joint: _plain(item) for joint, item in value}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if not isinstance(value, (Scene, Payload)):
        return value
    given = {item.name: (getattr(value, item.name), item.default) for item in fields(value)}
    return {k: _plain(x) for k, (x, default) in given.items() if x != default or k == 'gravity'}


def scene_from_yaml(text: str, source: str) -> Scene:
    """
    Return the scene of a YAML string; ValueError, which names the `source`, if it has none.

    It is a table of the fields of Scene, with WORDS, numbers and lists of numbers.
    """
    document = read_yaml(text, source)
    try:
        return _scene_of('the scene', document)
    except ValueError as error:
        raise ValueError(f'{quote(source)}: {error}') from error


def _scene_of(label: str, value: Any) -> Scene:
    value = by_joint(value) if isinstance(value, Mapping) else value
    given = dict(table(label, value, (), tuple(item.name for item in fields(Scene))))
    for key, item in given.items():
        if key == 'payload' and isinstance(item, Mapping):
            body = table(key, item, ('mass',), ('center', 'inertia'))
            given[key] = Payload(**{k: numbers(f'payload {k}', x, _word) for k, x in body.items()})
        elif key == 'gravity_compensation' and isinstance(item, Mapping):
            given[key] = _scene_of(key, item)
        elif isinstance(item, Mapping) and FIELDS[key].has_numbers:
            given[key] = {joint: numbers(f'{key}.{joint}', x, _word) for joint, x in item.items()}
        elif isinstance(item, str):
            # The scene refuses any other text, and says what the field may have.
            with suppress(ValueError):
                given[key] = _word(key, item)
        else:
            given[key] = numbers(key, item, _word)
    return Scene(**given)


def _word(label: str, text: str) -> Any:
    return WORDS[text] if text in WORDS else number_from_text(label, text, infinite=True)


def scene_inputs(
    scene: Scene,
    n: int,
    dtype: str,
    wrench: ArrayLike | None,
    brakes: ArrayLike | None,
    batch: tuple[int, ...] | None = None,
) -> dict[str, Array]:
    """
    Return the inputs that a scene adds to positions, velocities and torques, checked.

    They are `wrench`, (..., 6), a force [N] and a moment [N m] on the last link, which must be
    given if the scene has one, and `free`, (..., n), 1 for joints that move and 0 for braked ones;
    each only if the scene has it. ValueError for one that the scene lacks or of another type or
    shape. A `batch` has the leading dimensions to which they are broadcast.
    """
    if wrench is not None and not scene.external_wrench:
        raise ValueError(
            'wrench was given, but the scene has external_wrench=False: '
            'use Scene(external_wrench=True)'
        )
    if brakes is not None and not scene.brakes:
        raise ValueError('brakes were given, but the scene has none: use Scene(brakes=True)')
    inputs = {}
    if scene.external_wrench:
        if wrench is None:
            raise ValueError('the scene has external_wrench=True, so the call needs wrench=')
        inputs['wrench'] = _in_batch('wrench', real_array('wrench', wrench, dtype), 6, batch)
    if brakes is not None:
        inputs['free'] = (~_in_batch('brakes', _braked(brakes), n, batch)).astype(dtype)
    elif scene.brakes:
        inputs['free'] = np.ones((*(batch or ()), n), dtype)
    return inputs


def _in_batch(name: str, array: Array, size: int, batch: tuple[int, ...] | None) -> Array:
    """Return an array with the leading dimensions `batch`, or as given without any."""
    if batch is None or array.shape[-1:] != (size,):
        return fit_shape(name, array, (..., size))
    return fit_shape(name, array, (*batch, size), broadcast=True)


def _braked(value: ArrayLike) -> Array:
    """Return an array of bool; ValueError for numbers, as 1 could mean a joint that moves."""
    try:
        array = np.asarray(None if is_masked(value) else value)
    except (TypeError, ValueError, RuntimeError):
        array = np.asarray(None)
    if array.dtype != bool:
        raise ValueError(f'brakes must be an array of bool, True for braked, got {quote(value)}')
    return array
