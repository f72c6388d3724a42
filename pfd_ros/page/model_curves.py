# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Energy, and the error estimate of the forward dynamics, from recorded states and the model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import pfd_core as pfd
from pfd_ros.arm.arm import joint_order
from pfd_ros.arm.scene import scene_of
from pfd_ros.arm.settings import Settings
from pfd_ros.page.curves import Array

# States of a part that get an error estimate, which costs a hundred times the other curves.
ESTIMATES = 2000


@dataclass(frozen=True)
class ModelCurves:
    """The kernels of one robot in the scene of the settings; states are in published order."""

    energy_kernel: Any
    error_kernel: Any
    order: Array

    def energy(self, q: Array, qd: Array) -> Array:
        """Return kinetic, potential and total energy [J] of states (N, n), (N, 3)."""
        kinetic, potential = self.energy_kernel(*self._model_order(q, qd)).T
        return np.stack([kinetic, potential, kinetic + potential], axis=1)

    def error(self, time: Array, q: Array, qd: Array, tau: Array) -> tuple[Array, Array]:
        """Return relative errors of accelerations without refinement, (M, 1), at some times."""
        every = slice(None, None, max(1, len(time) // ESTIMATES))
        states = self._model_order(q[every], qd[every], tau[every])
        _, errors = self.error_kernel.error_estimate(*states)
        return time[every], errors[:, np.newaxis]

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
    # Effects that act over a step have no accelerations.
    over_a_step = {effect.name for effect in pfd.EFFECTS if effect.acts == 'step'}
    smooth = scene.without(over_a_step | {'brakes'})
    return ModelCurves(
        pfd.compile_kernel(robot, scene=scene, quantity='energy'),
        pfd.compile_kernel(robot, method=settings.method, scene=smooth, refine=1),
        np.array(order),
    )
