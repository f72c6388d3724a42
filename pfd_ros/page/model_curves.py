# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Energy, and the error estimate of the forward dynamics, from recorded states and the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

import pfd_core as pfd
from pfd_ros.arm.arm import joint_order
from pfd_ros.arm.model_kernels import acceleration_kernel
from pfd_ros.arm.plant_settings import INPUT, payload_from, payload_numbers
from pfd_ros.arm.scene import payload_of, scene_of
from pfd_ros.arm.settings import Settings
from pfd_ros.page.curves import Array

# States of a part that get an error estimate, which costs a hundred times the other curves.
ESTIMATES = 2000


class Kernels(NamedTuple):
    """The kernels of the energy and of the error estimate, None for an estimate without one."""

    energy: Any
    error: Any


@dataclass(frozen=True)
class ModelCurves:
    """The kernels of one robot in the scene of the settings; states are in published order.

    A payload is mass, centre of mass and inertia, 10 numbers as in geometry_msgs/Inertia; () is
    none.

    Attributes
    ----------
    first
        The payload of the settings.
    kernels
        With that payload; kernels with a payload as an input are compiled for the first other one.
    """

    robot: pfd.Robot
    scene: pfd.Scene
    method: str
    order: Array
    first: tuple[float, ...]
    kernels: Kernels

    def energy(self, q: Array, qd: Array, payload: tuple[float, ...]) -> Array:
        """Return kinetic, potential and total energy [J] of states (N, n), (N, 3)."""
        kernels, given = self._chosen(payload)
        kinetic, potential = kernels.energy(*self._model_order(q, qd), **given).T
        return np.stack([kinetic, potential, kinetic + potential], axis=1)

    def error(
        self, time: Array, q: Array, qd: Array, tau: Array, payload: tuple[float, ...]
    ) -> tuple[Array, Array]:
        """Return relative errors of accelerations without refinement, (M, 1), at some times.

        There are none where the method takes no payload as an input, and it is not the first one.
        """
        kernels, given = self._chosen(payload)
        if kernels.error is None:
            return time[:0], np.empty((0, 1))
        every = slice(None, None, max(1, len(time) // ESTIMATES))
        states = self._model_order(q[every], qd[every], tau[every])
        _, errors = kernels.error.error_estimate(*states, **given)
        return time[every], errors[:, np.newaxis]

    def _chosen(self, payload: tuple[float, ...]) -> tuple[Kernels, dict[str, Any]]:
        """Return kernels, and the payload as an argument of them."""
        if payload == self.first:
            return self.kernels, {}
        return self._with_input, {'payload': payload_from(payload) if payload else None}

    @cached_property
    def _with_input(self) -> Kernels:
        return _compiled(self.robot, replace(self.scene, payload=INPUT), self.method)

    def _model_order(self, *arrays: Array) -> list[Array]:
        found = []
        for values in arrays:
            sorted_values = np.empty_like(values)
            sorted_values[:, self.order] = values
            found.append(sorted_values)
        return found


def model_curves(robot: pfd.Robot, settings: Settings) -> ModelCurves:
    """Compile the kernels of a robot.

    Raises
    ------
    ValueError
        If the settings do not go with the robot.
    """
    order = joint_order(settings.joints, robot)
    scene = replace(scene_of(settings, order), external_wrench=False, gravity_compensation=False)
    kernels = _compiled(robot, scene, settings.method)
    payload = payload_of(scene)
    first = () if payload is None else payload_numbers(payload)
    return ModelCurves(robot, scene, settings.method, np.array(order), first, kernels)


def _compiled(robot: pfd.Robot, scene: pfd.Scene, method: str) -> Kernels:
    energy = pfd.compile_kernel(robot, scene=scene, quantity='energy')
    if scene.payload == INPUT and method not in pfd.PAYLOAD_METHODS:
        return Kernels(energy, None)
    return Kernels(energy, acceleration_kernel(robot, scene, method, refine=1))


def checked_payload(numbers: Sequence[float]) -> tuple[float, ...]:
    """Return a payload as `ModelCurves.payload` has it; ValueError if no body is like that."""
    found = tuple(numbers) if numbers and numbers[0] else ()
    if found:
        payload_from(found)
    return found
