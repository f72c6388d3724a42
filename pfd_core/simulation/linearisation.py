# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Linearisation of a simulation's step: x' = A x + B tau, exact to rounding.

    x = (q, qd), and tau_motor where motors lag;  x' is the state after one step of the simulation

Every integrator is differentiated exactly: A and B are the derivatives of the numbers that a
step computes, not of the motion that it approximates (pfd_core.kernels.linear_steps).

Dry friction and stops. As long as no joint comes to rest, breaks loose or reaches its stop, a step
is a step of a smooth arm: joints at rest are braked, and the friction of the others depends
on their velocities alone. Both arms take the step; if their ends differ, an event has fallen into
it, and there is no derivative.

Velocities of held joints. A joint h that is held, and is given a small velocity d, comes to rest
again after a time that is proportional to d. The momentum of the joints M in motion does not
change in this time but by the forces that act anyway, H_MM dqd_M + H_Mh dqd_h = 0, so that

    dqd_M = H_MM^-1 H_Mh d

wherever the force comes from that stops the joint. The column of A by qd_h is the column by qd_M
of the arm in motion, times H_MM^-1 H_Mh. Friction and stops bring all held joints back to rest if
each of their torques lies within the bounds of sliding friction; a joint at a bound may break
loose.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.forking import cached_property
from pfd_core.kernels.compile import compile_kernel, compile_spec
from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.linear_steps import compile_linear_step
from pfd_core.kernels.spec import STEP_IN_MOTION, KernelSpec
from pfd_core.model import Plant, Robot, Scene, resolve, scene_inputs
from pfd_core.model.values import Array, quote, real_array
from pfd_core.simulation.dry import has_contact
from pfd_core.simulation.integrators import TABLE, record_step

# Values of Linearization.status.
MOVING, HELD, ONE_SIDED = 'moving', 'held', 'one_sided'
# Two ways to the same state, of a step: roundings of a few hundred operations, relative to it.
SAME = {'float64': 1e-9, 'float32': 1e-3}


class Simulation(Protocol):
    """The part of a Simulator or an Ensemble that its linearised step needs."""

    @property
    def robot(self) -> Robot:
        """Chain."""

    @property
    def scene(self) -> Scene:
        """Effects."""

    @property
    def dtype(self) -> str:
        """Number format."""

    @property
    def spec(self) -> KernelSpec:
        """Spec of the dynamics."""

    @property
    def integrator(self) -> str:
        """Name of the integrator."""

    @property
    def step_size(self) -> float:
        """Seconds per step."""

    @property
    def substeps(self) -> int:
        """Steps of the integrator in a step."""

    @property
    def batch(self) -> tuple[int, ...]:
        """Leading dimensions of states."""

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


class Linearization(tuple[Array, Array]):
    """
    A and B of a step, x' = A x + B tau, and the joints with one-sided derivatives.

    It is the pair of both: `A, B = simulator.linearize(q, qd, tau)`.

    Attributes
    ----------
    A, B : numpy.ndarray
        As Simulator.linearize returns them.
    status : numpy.ndarray of str
        One of each joint, (n,) or (B, n)::

          'moving'       A and B are derivatives by its position, velocity and torque
          'held'         they are, too; friction or a brake holds the joint in place for the step
          'one_sided'    the joint is held, and they are derivatives only for changes that leave it
                         held, not for one that moves it off its stop or breaks it loose

    """

    status: Array

    def __new__(cls, A: Array, B: Array, status: Array) -> Linearization:
        """Return the pair of A and B with the status of each joint."""
        own = super().__new__(cls, (A, B))
        own.status = status
        return own

    def __getnewargs__(self) -> tuple[Array, Array, Array]:
        return self.A, self.B, self.status

    @property
    def A(self) -> Array:
        """The derivative d x' / d x, (2n, 2n) or (B, 2n, 2n); 3n where motors lag."""
        return self[0]

    @property
    def B(self) -> Array:
        """The derivative d x' / d tau, (2n, n) or (B, 2n, n); 3n rows where motors lag."""
        return self[1]


class LinearStep:
    """The linearised step of a simulation, with its settings; it keeps none of its state."""

    def __init__(self, simulation: Simulation) -> None:
        self._robot, self._scene = robot, scene = simulation.robot, simulation.scene
        self._names = robot.joint_names
        self._dry = has_contact(resolve(robot, scene))
        spec = simulation.spec
        if self._dry:
            spec = replace(spec, scene=replace(spec.scene, brakes=True), quantity=STEP_IN_MOTION)
        row, h = TABLE[simulation.integrator], simulation.step_size / simulation.substeps
        plant = resolve(robot, spec.scene)
        # The digits that sums keep, with `compensated`, have no derivative.
        step = record_step(
            row, robot.n, h, plant.viscosity, motor_lag=plant.motor_lag, carries=not self._dry
        )
        self.kernel = compile_linear_step(spec, step, simulation.substeps, row.implicit * h)

    def matrices(
        self,
        simulation: Simulation,
        state: dict[str, ArrayLike],
        wrench: ArrayLike | None,
        brakes: ArrayLike | None,
    ) -> Linearization:
        """Return A and B; `state` are q, qd and tau; all as for Simulation.linearize."""
        if self._dry:
            return self._without_events(simulation, state, wrench, brakes)
        q, qd, tau = state.values()
        S = self.kernel(q, qd, tau, wrench, brakes=brakes)
        rows = S.shape[-2]
        shape = (*S.shape[:-2], simulation.robot.n)
        held = np.zeros(shape, bool) if brakes is None else np.broadcast_to(brakes, shape)
        return Linearization(S[..., :rows], S[..., rows:-1], _status(held))

    def _without_events(
        self,
        simulation: Simulation,
        state: dict[str, ArrayLike],
        wrench: ArrayLike | None,
        brakes: ArrayLike | None,
    ) -> Linearization:
        """Return A and B in a scene with dry friction or stops; ValueError for events."""
        q, qd, tau = (_checked(simulation, *item) for item in state.items())
        own = (simulation.scene, q.shape[-1], simulation.dtype)
        inputs = scene_inputs(*own, wrench, brakes, simulation.batch)
        braked = inputs.get('free', np.ones_like(q)) == 0
        begin = q, np.where(braked, 0.0, qd)
        end = _end_of_step(simulation, *begin, tau, wrench, brakes)
        resting = _resting(simulation, begin, end)
        held = braked | resting
        S = self.kernel(q, qd, tau, wrench, brakes=held)
        rows, n = S.shape[-2], q.shape[-1]
        smooth = S[..., :n, -1], S[..., n : 2 * n, -1]
        _check_no_event(simulation, held, begin, end, smooth)
        A, status = S[..., :rows].copy(), _status(held)
        if resting.any():
            H = self._inertia(q)
            for k in np.ndindex(simulation.batch):
                _add_velocity_columns(A[k], H[k], resting[k], ~held[k])
            at = q, begin[1], tau, inputs.get('wrench')
            released, still = (self._in_motion(*at, brakes=b) for b in (braked, held))
            reaction = np.einsum('...ij,...j', H, still - released)
            status[_one_sided(simulation, q, resting, reaction)] = ONE_SIDED
        return Linearization(A, S[..., rows:-1], status)

    @cached_property
    def _inertia(self) -> Kernel:
        return compile_kernel(self._robot, scene=self._scene, quantity='inertia_matrix')

    @cached_property
    def _in_motion(self) -> Kernel:
        scene = replace(self._scene, brakes=True)
        return compile_spec(KernelSpec(self._robot, scene, quantity=STEP_IN_MOTION))

    def add_brakes(self, A: Array, q: ArrayLike, qd: ArrayLike, brakes: ArrayLike) -> None:
        """
        Write the columns of A by the velocities of braked joints, which move others by an impulse.

        The brakes stop a velocity d of joints b; the others change by dqd_f = H_ff^-1 H_fb d.
        """
        if not np.any(brakes):
            return
        H = self._inertia(q)
        braked = np.broadcast_to(brakes, H.shape[:-1])
        if (braked & (np.asarray(qd) != 0)).any():
            *_, joint = np.argwhere(braked & (np.asarray(qd) != 0))[0].tolist()
            raise ValueError(
                f'a brake closes on joint {quote(self._names[joint])} in motion: an impact, whose '
                'step has no derivative here; qd of a braked joint must be 0'
            )
        for k in np.ndindex(braked.shape[:-1]):
            _add_velocity_columns(A[k], H[k], braked[k], ~braked[k])


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


def _status(held: Array) -> Array:
    """Return the status of joints without one-sided derivatives."""
    status: Array = np.where(held, HELD, MOVING).astype(f'U{len(ONE_SIDED)}')
    return status


def _add_velocity_columns(A: Array, H: Array, resting: Array, moves: Array) -> None:
    """Write the columns of A by the velocities of joints at rest, from moving joints."""
    n = len(H)
    velocities, held = n + np.flatnonzero(moves), np.flatnonzero(resting)
    impulse = np.linalg.solve(H[np.ix_(moves, moves)], H[np.ix_(moves, resting)])
    A[:, n + held] = A[:, velocities] @ impulse


def _one_sided(simulation: Simulation, q: Array, resting: Array, reaction: Array) -> Array:
    """
    Return the resting joints, (..., n), that some change releases.

    `reaction` are the torques, (..., n), of friction and stops that hold them.
    """
    plant = resolve(simulation.robot, simulation.scene)
    zeros = np.zeros(simulation.robot.n)
    friction = zeros if plant.friction is None else plant.friction
    if plant.stribeck_velocity is not None and plant.static_friction is not None:
        friction = plant.static_friction
    at_lower = at_upper = np.zeros_like(resting)
    if plant.joint_limits is not None:
        lower, upper = _stops(plant, simulation.dtype)
        at_lower, at_upper = resting & (q <= lower), resting & (q >= upper)
    bound = friction - SAME['float64'] * (1 + np.abs(reaction))
    above, below = resting & (reaction >= bound), resting & (reaction <= -bound)
    loose = (above & ~at_lower) | (below & ~at_upper)
    # A joint that breaks loose may take others along.
    result: Array = above | below | (resting & loose.any(axis=-1, keepdims=True))
    return result


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
    # Positions round separately, velocities with the velocities of other joints.
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
