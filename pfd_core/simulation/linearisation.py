# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Linearisation of a simulation's step: x' = A x + B tau, exact to rounding.

    x = (q, qd), and tau_motor where motors lag;  x' is the state after one step of the simulation

Every integrator is differentiated as it stands: A and B are the derivatives of the numbers that a
step computes, not of the motion that it approximates (pfd_core.kernels.linear_steps).

Dry friction and stops. As long as no joint comes to rest, breaks loose or reaches its stop, a step
is that of a smooth arm: joints at rest are held by brakes, and the friction of the others is a
constant torque. Both arms take the step; if their ends differ, an event has fallen into it, and
there is no derivative.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.linear_steps import compile_linear_step
from pfd_core.model import Robot, Scene, resolve
from pfd_core.model.checked_numbers import Array, real_array
from pfd_core.model.error_text import quote
from pfd_core.simulation.contact.texts import has_contact
from pfd_core.simulation.integrators import TABLE, record_step

Self = TypeVar('Self')

# Fields of Scene that a smooth arm does not have.
ROUGH: dict[str, Any] = {
    'friction': None,
    'static_friction': None,
    'stribeck_velocity': None,
    'joint_limits': None,
    'restitution': 0.0,
}
# Effects with which the friction of a sliding joint is no constant torque at its motor.
VARYING = ('stribeck_velocity', 'effort_limits', 'torque_speed')
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

    def in_scene(self: Self, scene: Scene) -> Self:
        """Return a simulation with these settings in another scene."""

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
    """
    The linearised step of a simulation, with its settings; it keeps none of its state.

    Attributes
    ----------
    kernel : Kernel
        A and B, side by side, of the smooth arm.
    smooth : Simulation or None
        The simulation without dry friction and stops; None if its scene has neither.

    """

    def __init__(self, simulation: Simulation) -> None:
        scene = simulation.scene
        self.smooth = None
        if has_contact(resolve(simulation.robot, scene)):
            scene = smooth_scene(scene)
            self.smooth = simulation.in_scene(scene)
        self.kernel = _kernel(simulation.robot, scene, **simulation.settings)

    def matrices(
        self,
        simulation: Simulation,
        state: dict[str, ArrayLike],
        wrench: ArrayLike | None,
        brakes: ArrayLike | None,
    ) -> tuple[Array, Array]:
        """Return A and B; `state` are q, qd and tau; all as for Simulation.linearize."""
        if self.smooth is not None:
            state, brakes = self._smooth_inputs(simulation, self.smooth, state, wrench, brakes)
        q, qd, tau = state.values()
        S = self.kernel(q, qd, tau, wrench, brakes=brakes)
        rows = S.shape[-2]
        return S[..., :rows], S[..., rows:]

    def _smooth_inputs(
        self,
        rough: Simulation,
        smooth: Simulation,
        state: dict[str, ArrayLike],
        wrench: ArrayLike | None,
        brakes: ArrayLike | None,
    ) -> tuple[dict[str, ArrayLike], Array]:
        """Return the state and the held joints of the step of the smooth arm."""
        q, qd, tau = (_checked(rough, *item) for item in state.items())
        held = False if brakes is None else np.asarray(brakes)
        begin = q, np.where(held, 0.0, qd)
        end = _end_of_step(rough, *begin, tau, wrench, brakes)
        resting, friction = modes(rough.robot, rough.scene, begin, end)
        tau, joints = (tau - friction).astype(tau.dtype), resting | held
        smooth_end = _end_of_step(smooth, *begin, tau, wrench, joints)
        check_no_event(rough.robot, rough.scene, rough.dtype, end, smooth_end)
        return {'q': q, 'qd': qd, 'tau': tau}, joints


def _checked(simulation: Simulation, name: str, value: ArrayLike) -> Array:
    """Return an argument as an array, (n,) or (B, n), of the simulation's number format."""
    names, batch = simulation.robot.joint_names, simulation.batch
    shape = (*batch, len(names))
    return real_array(name, value, simulation.dtype, shape, broadcast=bool(batch), joints=names)


def _kernel(
    robot: Robot,
    scene: Scene,
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
    return compile_linear_step(robot, step, substeps, scene=scene, implicit=implicit, **options)


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


def smooth_scene(scene: Scene) -> Scene:
    """Return a scene without dry friction and stops, with brakes; ValueError if that is wrong."""
    varying = [key for key in VARYING if getattr(scene, key) is not None]
    if scene.friction is not None and varying:
        raise ValueError(
            f'the scene has friction and {quote(varying[0])}: friction is then no constant torque '
            'at the motor, and a step with it is not linearised'
        )
    return replace(scene, **ROUGH, brakes=True)


def modes(
    robot: Robot, scene: Scene, begin: tuple[Array, Array], end: tuple[Array, Array]
) -> tuple[Array, Array]:
    """
    Return the held joints, (..., n) bool, and the friction of the others, (..., n) [N m or N].

    `begin` and `end` are positions and velocities, (..., n), before and after a step: a joint at
    rest before and after it is held, if there is anything to hold it.
    """
    plant = resolve(robot, scene)
    friction = np.zeros(robot.n) if plant.friction is None else plant.friction
    bound = friction > 0 if plant.static_friction is None else plant.static_friction > 0
    at_stop = np.zeros_like(begin[0], bool)
    if plant.joint_limits is not None:
        lower, upper = plant.joint_limits.T
        at_stop = (begin[0] <= lower) | (begin[0] >= upper)
    held = (begin[1] == 0) & (end[1] == 0) & (bound | at_stop)
    direction = np.sign(np.where(begin[1] == 0, end[1], begin[1]))
    return held, np.where(held, 0.0, friction * direction)


def check_no_event(
    robot: Robot, scene: Scene, dtype: str, rough: tuple[Array, Array], smooth: tuple[Array, Array]
) -> None:
    """Raise ValueError where two ends of a step, positions and velocities (..., n), differ."""
    rough = (np.atleast_2d(rough[0]), np.atleast_2d(rough[1]))
    smooth = (np.atleast_2d(smooth[0]), np.atleast_2d(smooth[1]))
    apart = np.zeros(rough[0].shape, bool)
    for one, other in zip(rough, smooth, strict=True):
        scale = SAME[dtype] * (1 + np.abs(other).max(axis=-1, keepdims=True))
        apart |= ~(np.abs(one - other) <= scale)
    reversed_ = np.sign(rough[1]) * np.sign(smooth[1]) < 0
    if not (apart | reversed_).any():
        return
    limits = resolve(robot, scene).joint_limits
    beyond = np.zeros_like(apart)
    if limits is not None:
        beyond = (smooth[0] <= limits[:, 0]) | (smooth[0] >= limits[:, 1])
    # A joint at its stop first: the impact changes the velocities of others.
    wrong, event = beyond & apart, 'reaches its stop'
    if not wrong.any():
        wrong, event = apart | reversed_, 'comes to rest, reverses or breaks loose'
    change = np.where(wrong, np.abs(rough[1] - smooth[1]), -1.0)
    state, joint = np.unravel_index(int(np.argmax(change)), change.shape)
    raise ValueError(
        f'joint {quote(robot.joint_names[joint])} of state {state} {event} within the step: a '
        'step with an event has no derivative'
    )
