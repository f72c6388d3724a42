# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Parameters of arms: what differs among the arms of an ensemble, and what all programs share.

    arms = Arms(robot, scene, 256, {'friction': (256, n), 'links.mass': (256, n)})
    plant, p = arms.with_inputs()      a plant with NaN for each number that differs; (256, len(p))

An arm is the robot in the scene with its own values in place of theirs, by the same checks. A
number that differs among the arms is an input of the programs, and a number that all arms have in
common is a constant, whatever is given. So one compilation serves all arms, and its key in the
cache on disk has no values of the numbers that differ.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.dynamics.bodies import links_of
from pfd_core.dynamics.numbers import parameters, with_inputs
from pfd_core.model.effects import FIELDS, INPUT
from pfd_core.model.plant import Plant, resolve
from pfd_core.model.robot import Payload, Robot, check_robot, with_payload
from pfd_core.model.scene import Scene
from pfd_core.model.values import LARGEST, Array, quote, real_array

# Fields of a scene that may differ among arms: those whose number no program depends on otherwise.
SCENE = (
    *('gravity', 'damping', 'armature', 'friction', 'static_friction', 'stribeck_velocity'),
    *('restitution', 'stiffness', 'rest_position'),
)
# Shapes of the numbers of bodies, and the fields of Robot and of Payload that hold them.
Bodies = Mapping[str, tuple[tuple[int, ...], str]]
LINKS: Bodies = {
    'links.mass': ((), 'masses'),
    'links.center': ((3,), 'centers'),
    'links.inertia': ((3, 3), 'inertias'),
}
PAYLOAD: Bodies = {
    'payload.mass': ((), 'mass'),
    'payload.center': ((3,), 'center'),
    'payload.inertia': ((3, 3), 'inertia'),
}
NAMES = (*SCENE, *PAYLOAD, *LINKS)


class Arms:
    """
    Arms of one robot, whose frames all have, in one scene, that differ in some numbers.

    `given` maps names, as in NAMES, to numbers of the arms, (size, ...), or of all arms, (...).
    ValueError for a name that is unknown or cannot differ among arms, and for a value that a
    scene, a payload or a robot does not take; it names the arm and the joint.
    """

    def __init__(self, robot: Robot, scene: Scene, size: int, given: Mapping[str, Any]) -> None:
        check_robot(robot)
        self.size = size
        numbers = _checked(robot, scene, size, given)
        fields = {name: x for name, x in numbers.items() if name in SCENE}
        self._robots = [robot] * size
        self._payloads: list[Payload | None] = [None] * size
        links: dict[str, Array] = {}
        if numbers.keys() - fields.keys():
            nominal = scene.payload if isinstance(scene.payload, Payload) else None
            if nominal is None and numbers.keys() & PAYLOAD.keys():
                nominal = Payload(0.0)
            self._robots = _replaced(robot, LINKS, numbers, size)
            self._payloads = _replaced(nominal, PAYLOAD, numbers, size)
            links = links_of(robot, self._robots, self._payloads)
            scene = replace(scene, payload=INPUT)
        self._stacked = replace(resolve(robot, scene, fields), links=links)
        # The inertia of the last joint, and the stiffness of springs and damping.
        loads = {'gravity', 'friction', 'static_friction', 'stribeck_velocity', 'restitution'}
        self._decisive = bool(numbers.keys() - loads)

    def with_inputs(self, implicit: float) -> tuple[Plant, Array]:
        """
        Return a plant whose numbers that differ are inputs, and the inputs, (B, len(p)).

        `implicit` is the time [s] by which the integrator multiplies the viscosity, or 0.
        """
        stacked = replace(self._stacked, implicit=implicit)
        links = {kind: _common(x) for kind, x in stacked.links.items()}
        plant = with_inputs(replace(_with_values(stacked, _common), links=links))
        return plant, parameters(plant, stacked, self.size)

    def plants(self) -> dict[str, Plant]:
        """
        Return the plants of the arms, without inputs, by the beginnings of their errors.

        One plant stands for all where no check depends on what differs.
        """
        if not self._decisive:
            return {'': self._plant(0)}
        return {label(arm): self._plant(arm) for arm in range(self.size)}

    def _plant(self, arm: int) -> Plant:
        robot, payload = self._robots[arm], self._payloads[arm]
        loaded = robot if payload is None else with_payload(robot, payload)
        plant = _with_values(self._stacked, lambda values: values[arm])
        return replace(plant, robot=loaded, links={})


def label(arm: int) -> str:
    """Return the beginning of an error of an arm."""
    return f'parameters, arm {arm}: '


def _with_values(stacked: Plant, change: Callable[[Array], Array]) -> Plant:
    """Return a plant with other numbers in place of those that have an axis of arms."""
    effects = {
        name: change(x) if name in SCENE and x.ndim == 2 else x
        for name, x in stacked.effects.items()
    }
    gravity = change(stacked.gravity) if stacked.gravity.ndim == 2 else stacked.gravity
    return replace(stacked, gravity=gravity, effects=effects)


def _common(values: Array) -> Array:
    """Return the numbers that all arms have in common, NaN for those that differ."""
    return np.where((values == values[0]).all(axis=0), values[0], np.nan)


def _checked(
    robot: Robot, scene: Scene, size: int, given: Mapping[str, Any]
) -> dict[str, NDArray[Any]]:
    """Return the numbers of the arms by name, (B, ...)."""
    if not isinstance(given, Mapping):
        raise ValueError(f'parameters must map names to numbers of arms, got {quote(given)}')
    found = {}
    for name, value in given.items():
        if name not in NAMES:
            known = isinstance(name, str) and name.partition('.')[0] in (*FIELDS, 'links')
            what = 'cannot differ among arms' if known else 'is unknown'
            raise ValueError(f'parameters: {quote(name)} {what}, only {", ".join(NAMES)} can')
        label, shape = f'parameters[{name!r}]', _shape(robot, name)
        of_joints = name in SCENE and name != 'gravity'
        joints = robot.joint_names if of_joints else ()
        array = real_array(label, value, largest=LARGEST, joints=joints) + 0.0
        # NumPy would make three components of gravity of one number.
        if array.shape not in ((size, *shape), shape):
            raise ValueError(
                f'{label} must have shape {(size, *shape)} or {shape}, got {array.shape}'
            )
        found[name] = array = np.broadcast_to(array, (size, *shape))
        if of_joints:
            _check_field(robot, name, array)
    for name in found:
        rest = 'payload.mass' if name in PAYLOAD and name != 'payload.mass' else ''
        needed = FIELDS[name].needs if name in FIELDS else rest
        if needed and needed not in found and getattr(scene, needed.partition('.')[0]) is None:
            raise ValueError(
                f'parameters: {name} was given without {needed}, which the scene lacks as well'
            )
    return found


def _shape(robot: Robot, name: str) -> tuple[int, ...]:
    """Return the shape of the numbers of one arm."""
    if name in PAYLOAD:
        return PAYLOAD[name][0]
    if name in LINKS:
        return (robot.links, *LINKS[name][0])
    return (3,) if name == 'gravity' else (robot.n,)


def _check_field(robot: Robot, name: str, array: Array) -> None:
    """Raise ValueError for a number that the field of a scene does not take."""
    field = FIELDS[name]
    try:
        field.checked(array.ravel())
    except ValueError:
        for arm, row in enumerate(array.tolist()):
            for joint, value in zip(robot.joint_names, row, strict=True):
                try:
                    field.checked({joint: value})
                except ValueError as error:
                    raise ValueError(f'{label(arm)}{error}') from None
        raise


def _replaced(nominal: Any, table: Bodies, numbers: Mapping[str, Array], size: int) -> list[Any]:
    """Return for each arm the robot, or the payload, with its own numbers."""
    given = {key: numbers[name] for name, (_, key) in table.items() if name in numbers}
    if not given:
        return [nominal] * size
    found = []
    for arm in range(size):
        try:
            found.append(replace(nominal, **{key: x[arm] for key, x in given.items()}))
        except ValueError as error:
            raise ValueError(f'{label(arm)}{error}') from None
    return found
