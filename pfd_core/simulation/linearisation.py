# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Linearisation of a simulation's step: x' = A x + B tau, exact to rounding.

    x = (q, qd), and tau_motor where motors lag;  x' is the state after one step of the simulation

Every integrator is differentiated as it stands: A and B are the derivatives of the numbers that a
step computes, not of the motion that it approximates (pfd_core.kernels.linear_steps).

Dry friction and stops. As long as no joint comes to rest, breaks loose or reaches its stop, a step
is that of a smooth arm: joints at rest are held by brakes, and the friction of the others depends
on their velocities alone. Both arms take the step; if their ends differ, an event has fallen into
it, and there is no derivative.
"""

from __future__ import annotations

from copy import copy
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.linear_steps import compile_linear_step
from pfd_core.model import Plant, Robot, Scene, resolve, scene_inputs
from pfd_core.model.checked_numbers import Array, real_array
from pfd_core.model.error_text import quote
from pfd_core.simulation.contact.texts import has_contact
from pfd_core.simulation.integrators import TABLE, record_step

# Two ways to the same state, of a step: roundings of a few hundred operations, relative to it.
SAME = {'float64': 1e-9, 'float32': 1e-3}


class Simulation(Protocol):
    """The part of a Simulator or an Ensemble that its linearised step needs."""

    robot: Robot
    scene: Scene
    dtype: str
    batch: tuple[int, ...]

    @property
    def settings(self) -> dict[str, Any]:
        """Arguments with which the simulation was made, robot and scene apart."""

    @property
    def q(self) -> Array:
        """Positions."""

    @property
    def qd(self) -> Array:
        """Velocities."""

    def reset(
        self,
        q: ArrayLike | None = None,
        qd: ArrayLike | None = None,
        time: float = 0.0,
        *,
        tau_motor: ArrayLike | None = None,
    ) -> None:
        """Set the state."""

    def take_step(self, tau: Array, wrench: ArrayLike | None, brakes: ArrayLike | None) -> None:
        """Advance the state by one step."""


class LinearStep:
    """The linearised step of a simulation, with its settings; it keeps none of its state."""

    def __init__(self, simulation: Simulation) -> None:
        robot, scene = simulation.robot, simulation.scene
        self._dry = has_contact(resolve(robot, scene))
        self.kernel = _kernel(robot, scene, self._dry, **simulation.settings)

    def matrices(
        self,
        simulation: Simulation,
        state: dict[str, ArrayLike],
        wrench: ArrayLike | None,
        brakes: ArrayLike | None,
    ) -> tuple[Array, Array]:
        """Return A and B; `state` are q, qd and tau; all as for Simulation.linearize."""
        if self._dry:
            return self._without_events(simulation, state, wrench, brakes)
        q, qd, tau = state.values()
        S = self.kernel(q, qd, tau, wrench, brakes=brakes)
        rows = S.shape[-2]
        return S[..., :rows], S[..., rows:-1]

    def _without_events(
        self,
        simulation: Simulation,
        state: dict[str, ArrayLike],
        wrench: ArrayLike | None,
        brakes: ArrayLike | None,
    ) -> tuple[Array, Array]:
        """Return A and B in a scene with dry friction or stops; ValueError for events."""
        q, qd, tau = (_checked(simulation, *item) for item in state.items())
        own = (simulation.scene, q.shape[-1], simulation.dtype)
        inputs = scene_inputs(*own, wrench, brakes, simulation.batch)
        braked = inputs.get('free', np.ones_like(q)) == 0
        begin = q, np.where(braked, 0.0, qd)
        end = _end_of_step(simulation, *begin, tau, wrench, brakes)
        held = braked | _resting(simulation, begin, end)
        S = self.kernel(q, qd, tau, wrench, brakes=held)
        rows, n = S.shape[-2], q.shape[-1]
        smooth = S[..., :n, -1], S[..., n : 2 * n, -1]
        _check_no_event(simulation, held, begin, end, smooth)
        return S[..., :rows], S[..., rows:-1]


def _kernel(
    robot: Robot,
    scene: Scene,
    dry: bool,
    *,
    step_size: float,
    substeps: int,
    integrator: str,
    compensated: bool,
    **options: Any,
) -> Kernel:
    """Return the kernel of a linearised step, with the settings of a simulation."""
    h, row, plant = step_size / substeps, TABLE[integrator], resolve(robot, scene)
    # The digits that sums keep, with `compensated`, have no derivative.
    step = record_step(row, robot.n, h, plant.damping, motor_lag=plant.motor_lag)
    implicit = row.implicit * h
    return compile_linear_step(
        robot, step, substeps, scene=scene, implicit=implicit, dry=dry, **options
    )


def _checked(simulation: Simulation, name: str, value: ArrayLike) -> Array:
    """Return an argument as an array, (n,) or (B, n), of the simulation's number format."""
    names, batch = simulation.robot.joint_names, simulation.batch
    shape = (*batch, len(names))
    return real_array(name, value, simulation.dtype, shape, broadcast=bool(batch), joints=names)


def _end_of_step(
    simulation: Simulation,
    q: Array,
    qd: Array,
    tau: Array,
    wrench: ArrayLike | None,
    brakes: ArrayLike | None,
) -> tuple[Array, Array]:
    """Return positions and velocities after a step; motors with a lag have reached the torque."""
    twin = copy(simulation)
    lags = simulation.scene.motor_lag is not None
    twin.reset(q, qd, tau_motor=tau if lags else None)
    twin.take_step(tau, wrench, brakes)
    return twin.q, twin.qd


def _resting(
    simulation: Simulation, begin: tuple[Array, Array], end: tuple[Array, Array]
) -> Array:
    """Return the joints, (..., n), that friction or a stop holds, from both ends of a step."""
    plant = resolve(simulation.robot, simulation.scene)
    holds = np.zeros_like(begin[0], bool)
    if plant.static_friction is not None:
        holds |= plant.static_friction > 0
    if plant.joint_limits is not None:
        lower, upper = _stops(plant, simulation.dtype)
        holds |= (begin[0] <= lower) | (begin[0] >= upper)
    resting: Array = holds & (begin[1] == 0) & (end[1] == 0)
    return resting


def _stops(plant: Plant, dtype: str) -> Array:
    """Return the lowest and highest positions, (2, n), rounded as in a simulation's state."""
    assert plant.joint_limits is not None
    stops: Array = plant.joint_limits.T.astype(dtype)
    return stops


def _check_no_event(
    simulation: Simulation,
    held: Array,
    begin: tuple[Array, Array],
    rough: tuple[Array, Array],
    smooth: tuple[Array, Array],
) -> None:
    """
    Raise ValueError where a joint changes between rest and motion, or reaches its stop.

    All are positions and velocities, (..., n): at the beginning, and at the end of a step with dry
    friction and stops (`rough`) and of one without (`smooth`).
    """
    robot = simulation.robot
    plant = resolve(robot, simulation.scene)
    apart = np.zeros(held.shape, bool)
    # Positions round each for itself, velocities with those of other joints.
    sizes = np.abs(smooth[0]), np.abs(smooth[1]).max(axis=-1, keepdims=True)
    for one, other, size in zip(rough, smooth, sizes, strict=True):
        apart |= ~(np.abs(one - other) <= SAME[simulation.dtype] * (1 + size))
    beyond = np.zeros_like(apart)
    if plant.joint_limits is not None:
        lower, upper = _stops(plant, simulation.dtype)
        q, end = begin[0], smooth[0]
        # A joint that begins beyond its stop may come back freely.
        beyond = ~held & (((end <= lower) & (end <= q)) | ((end >= upper) & (end >= q)))
    turned = np.zeros_like(apart)
    if plant.friction is not None:
        turned = ~held & (plant.friction > 0) & (np.sign(begin[1]) != np.sign(smooth[1]))
    # The impact of a joint at its stop changes the velocities of others.
    for wrong, event in (
        (beyond, 'reaches its stop'),
        (turned, 'comes to rest, reverses or breaks loose'),
        (apart, 'comes to rest, reverses or breaks loose'),
    ):
        if wrong.any():
            *state, joint = np.argwhere(wrong)[0].tolist()
            place = f' of state {state[0]}' if state else ''
            raise ValueError(
                f'joint {quote(robot.joint_names[joint])}{place} {event} within the step: a step '
                'with an event has no derivative'
            )
