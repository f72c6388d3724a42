# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Scene: the effects that act on a robot. Plant: a scene and a robot as numbers.

A scene fits any robot; `resolve` makes a plant of both, which an algorithm records as a program.
The default is rigid links and gravity, nothing else.

A new effect is a field of Scene, its numbers a field of Plant, and its force a term in
`pfd_core.algorithms.chain.equations`; an input at run time is read by `scene_inputs`.
"""

from __future__ import annotations

from dataclasses import dataclass
import hashlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.model.checked_numbers import LARGEST, fit_shape, real_array
from pfd_core.model.error_text import quote, quote_all
from pfd_core.model.frozen_arrays import FrozenArrays, frozen
from pfd_core.model.geometry import Array, product
from pfd_core.model.robot import Robot
from pfd_core.model.robot_changes import Payload, with_payload

MODEL = 'model'


@dataclass(frozen=True)
class Scene:
    """
    The effects that act on a robot; an effect that is off costs nothing.

    Attributes
    ----------
    gravity : array_like or None
        Acceleration of free fall, (3,) [m/s^2], in the frame of the base link.
    damping : None, "model" or array_like
        Viscous friction of the joints, (n,) [N m s/rad, N s/m]; "model" for the robot's own.
    armature : None, "model" or array_like
        Rotor inertia seen at the joints, (n,) [kg m^2, kg]; "model" for the robot's own.
    payload : Payload or None
        A body held by the last link.
    external_wrench : bool
        Whether a force and a moment on the last link are an input.
    brakes : bool
        Whether each joint can be held at run time; a held joint does not accelerate.
    friction, joint_limits : None
        Dry friction and end stops are not modelled; only None is accepted.

    Raises
    ------
    ValueError
        If a value has another type, or a number is negative or not finite.

    """

    gravity: ArrayLike | None = (0.0, 0.0, -9.81)
    damping: ArrayLike | str | None = None
    armature: ArrayLike | str | None = None
    payload: Payload | None = None
    external_wrench: bool = False
    brakes: bool = False
    friction: None = None
    joint_limits: None = None

    def __post_init__(self) -> None:
        if self.gravity is not None:
            gravity = real_array('gravity', self.gravity, shape=(3,), largest=LARGEST)
            object.__setattr__(self, 'gravity', tuple((gravity + 0.0).tolist()))
        for key in ('damping', 'armature'):
            object.__setattr__(self, key, _per_joint(key, getattr(self, key)))
        if self.payload is not None and not isinstance(self.payload, Payload):
            raise ValueError(f'payload must be a Payload or None, got {quote(self.payload)}')
        for key in ('external_wrench', 'brakes'):
            if not isinstance(getattr(self, key), (bool, np.bool_)):
                raise ValueError(f'{key} must be True or False, got {quote(getattr(self, key))}')
            object.__setattr__(self, key, bool(getattr(self, key)))
        for key in ('friction', 'joint_limits'):
            if getattr(self, key) is not None:
                raise ValueError(f'{key} is not modelled yet: leave it None')

    @property
    def digest(self) -> str:
        """SHA-256 of everything in the scene, as 64 hexadecimal digits."""
        # The fields are None, bool, str and tuples of floats, whose repr is exact.
        return hashlib.sha256(repr(self).encode()).hexdigest()


@dataclass(frozen=True, eq=False)
class Plant(FrozenArrays):
    """
    A scene as numbers for one robot.

    Attributes
    ----------
    robot : Robot
        The chain, with the payload welded on.
    gravity : ndarray
        (3,) [m/s^2], in the axes of frame 0; zeros without gravity.
    damping, armature : ndarray or None
        (n,) [N m s/rad, N s/m] and [kg m^2, kg]; None if the effect is off.
    external_wrench, brakes : bool
        Whether a wrench on the last link, and joints held at run time, are inputs.

    """

    robot: Robot
    gravity: Array
    damping: Array | None
    armature: Array | None
    external_wrench: bool
    brakes: bool

    def __post_init__(self) -> None:
        for key in ('gravity', 'damping', 'armature'):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, frozen(getattr(self, key)))

    @property
    def digest(self) -> str:
        """SHA-256 of all numbers and switches, on which the recorded programs depend."""
        state = hashlib.sha256(self.robot.digest.encode())
        for values in (self.gravity, self.damping, self.armature):
            state.update(b'none' if values is None else values.astype('<f8').tobytes())
        state.update(repr((self.external_wrench, self.brakes)).encode())
        return state.hexdigest()


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
        If the scene gives damping or armature for another number of joints.

    """
    if not isinstance(robot, Robot):
        raise ValueError(f'robot must be a Robot, got {quote(robot)}; load_robot() makes one')
    scene = Scene() if scene is None else scene
    if not isinstance(scene, Scene):
        raise ValueError(f'scene must be a Scene or None, got {quote(scene)}')
    carrying = robot if scene.payload is None else with_payload(robot, scene.payload)
    gravity = np.zeros(3) if scene.gravity is None else np.asarray(scene.gravity)
    return Plant(
        robot=carrying,
        gravity=product(robot.base_rotation.T, gravity),
        damping=_values(robot, 'damping', scene.damping),
        armature=_values(robot, 'armature', scene.armature),
        external_wrench=scene.external_wrench,
        brakes=scene.brakes,
    )


def scene_inputs(
    scene: Scene,
    n: int,
    dtype: str,
    wrench: ArrayLike | None,
    brakes: ArrayLike | None,
    batch: tuple[int, ...] | None = None,
) -> dict[str, NDArray[Any]]:
    """
    Return the inputs that a scene adds to positions, velocities and torques, checked.

    Parameters
    ----------
    scene : Scene
        Which effects are on.
    n : int
        Number of joints.
    dtype : {'float64', 'float32'}
        Number format of the result.
    wrench : array_like or None
        Force [N] and moment [N m] on the last link, (..., 6); exactly if the scene has one.
    brakes : array_like of bool or None
        True for joints that are held, (..., n); only if the scene has brakes. None holds none.
    batch : tuple of int, optional
        Leading dimensions to which the inputs are broadcast; default: as given.

    Returns
    -------
    dict
        `wrench`, (..., 6), and `free`, (..., n), 1 for joints that move and 0 for held ones; each
        only if the scene has it.

    Raises
    ------
    ValueError
        If an input is given that the scene lacks, the wrench is missing, or one has another shape
        or type.

    """

    def in_batch(name: str, array: NDArray[Any], size: int) -> NDArray[Any]:
        if batch is None or array.shape[-1:] != (size,):
            return fit_shape(name, array, (..., size))
        return fit_shape(name, array, (*batch, size), broadcast=True)

    inputs = {}
    if scene.external_wrench:
        if wrench is None:
            raise ValueError('the scene has external_wrench=True, so the call needs wrench=')
        inputs['wrench'] = in_batch('wrench', real_array('wrench', wrench, dtype), 6)
    elif wrench is not None:
        raise ValueError(
            'wrench was given, but the scene has external_wrench=False: '
            'use Scene(external_wrench=True)'
        )
    if scene.brakes:
        held = np.zeros(n, bool) if brakes is None else _bools('brakes', brakes)
        inputs['free'] = (~in_batch('brakes', held, n)).astype(dtype)
    elif brakes is not None:
        raise ValueError('brakes were given, but the scene has none: use Scene(brakes=True)')
    return inputs


def _bools(name: str, value: ArrayLike) -> NDArray[np.bool_]:
    """Return an array of bool; ValueError for numbers, as 1 could mean a joint that moves."""
    try:
        array = np.asarray(None if isinstance(value, np.ma.MaskedArray) else value)
    except (TypeError, ValueError, RuntimeError):
        array = np.asarray(None)
    if array.dtype != bool:
        raise ValueError(f'{name} must be an array of bool, True for held, got {quote(value)}')
    return array


def _per_joint(key: str, value: Any) -> tuple[float, ...] | str | None:
    """Return damping or armature of a scene as None, "model" or a tuple of numbers."""
    if value is None:
        return None
    if isinstance(value, str) and value == MODEL:
        return MODEL
    try:
        length = None if isinstance(value, str) else len(value)
    except TypeError:
        length = None
    if length is None:
        raise ValueError(
            f'{key} must be None, {MODEL!r} or one number a joint, got {quote(value)}'
        )
    array = real_array(key, value, shape=(length,), largest=LARGEST) + 0.0
    if (array < 0).any():
        raise ValueError(f'{key} must not be negative, got {quote(array.tolist())}')
    return tuple(array.tolist())


def _values(robot: Robot, key: str, switch: Any) -> Array | None:
    """Return one number a joint, or None if the effect is off."""
    if switch is None:
        return None
    values = getattr(robot, key) if switch == MODEL else np.asarray(switch, dtype=np.float64)
    if values.shape != (robot.n,):
        raise ValueError(
            f'{key} of the scene has {len(values)} numbers, but {quote(robot.name)} has '
            f'{robot.n} joints: {quote_all(robot.joint_names)}'
        )
    # Zeros switch the effect off, so that it costs nothing.
    return values if values.any() else None
