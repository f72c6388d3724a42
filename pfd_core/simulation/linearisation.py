# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Linearisation of a simulation's step: x' = A x + B tau, also through events.

    x = (q, qd), and tau_motor where motors lag;  x' is the state after one step of the simulation

A and B are the derivatives of the numbers that a step computes, not of the motion that it
approximates: the step itself runs on dual numbers (pfd_core.simulation.dual). A float32 simulation
takes its step in float64 here, from a state and with stops rounded to float32. Without events they
are exact to rounding. The search for an event ends nearer to it here (dry.Law.short) than in a
simulation, whose states are uneven by what that leaves; differences of its steps show this.

One-sided derivatives. A joint that begins at rest, held by friction or a stop, comes to rest again
if it is given a small velocity d, after a time that is proportional to d. The torque that stops it
depends on the sign of d, so the column of A by this velocity has two limits: the columns of two
steps that begin with velocities of almost zero. A has their mean, and 'one_sided' says that they
differ by more than KINK. Where a velocity breaks the joint loose, the state after the step jumps;
A has the other limit then. The column by the position of a joint at its stop is the limit from
beyond the stop, where the joint is at its stop as well.

A step of a simulation takes a hop off a stop for none if it is shorter than its search resolves,
and its impulse is lost. Limits here have the impulse, as all longer hops have it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.kernels.spec import KernelSpec
from pfd_core.kernels.tangents import compile_tangents
from pfd_core.model.plant import resolve
from pfd_core.model.scene import scene_inputs
from pfd_core.model.values import Array, real_array
from pfd_core.simulation.dry import Law, has_contact
from pfd_core.simulation.dual import CONSTANT, PLAIN, dual_step

# Values of Linearization.status.
MOVING, HELD, ONE_SIDED, EVENT = 'moving', 'held', 'one_sided', 'event'
WIDEST = np.dtype(f'U{len(ONE_SIDED)}')
# Velocity [rad/s or m/s] of a limit: the joint comes to rest so soon that the step is straight,
# but not within a rounding of the step's length, where the search for events makes several one.
# Positions and impulses are rounded, so an arm with a joint at its stop takes SLOW: there the
# joint leaves its stop by many roundings, and does not bounce (pfd_core.simulation.box). Such a
# limit has three digits.
INSTANT, SLOW = 2.0**-40, 2.0**-20
# Entries of a limit that are the time in which the joint comes to rest.
SOON = 1e-10
# Distance from a stop [rad or m] at which the step is compared with that from the stop.
NEAR = 2.0**-30
# Difference of the limits of a column, relative to 1 + its largest entry, from which it counts.
KINK = 1e-4
# The same of the change of a state from the limit, relative to the change; and roundings of both.
JUMP, ROUNDINGS = 0.1, 1e-12


class Linearization(tuple[Array, Array]):
    """
    A and B of a step, x' = A x + B tau, and how far they are derivatives.

    It is the pair of both: `A, B = simulator.linearize(q, qd, tau)`.

    Attributes
    ----------
    A, B : numpy.ndarray
        As Simulator.linearize returns them.
    status : numpy.ndarray of str
        One of each joint, (n,) or (B, n)::

          'moving'       A and B are derivatives by its position, velocity and torque
          'held'         they are to 1e-4; friction, a stop or a brake holds the joint in the step
          'event'        they are derivatives; the joint comes to rest, breaks loose, reverses or
                         hits its stop in the step, so they hold for smaller changes
          'one_sided'    the joint begins at rest or at its stop, and its columns differ from the
                         derivatives for some changes: a velocity that breaks it loose, a position
                         away from its stop; by its velocity A has the mean of both limits, or
                         the limit without a jump

        No status states the kinks of motors. There A and B have the limit of one side: at a
        torque of exactly the effort limit that of smaller torques, at a corner of a torque-speed
        table or, with load friction, a torque of zero either.

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
    """The linearised step of a simulation, with its settings."""

    def __init__(
        self,
        spec: KernelSpec,
        integrator: str,
        step_size: float,
        substeps: int,
    ) -> None:
        robot, scene, self._dtype = spec.robot, spec.scene, spec.dtype
        if scene.joint_limits is not None:
            # As in the state of a simulation, whose joints are at rounded stops.
            limits = np.array(resolve(robot, scene).joint_limits, self._dtype)
            scene = replace(scene, joint_limits=limits.astype(float))
        plant = resolve(robot, scene)
        self._robot, self._scene, self._dry = robot, scene, has_contact(plant)
        self._moving = np.full(robot.n, MOVING, WIDEST)
        # The stops, and the joints that friction can hold.
        self._low, self._high = np.full((2, robot.n), [[-np.inf], [np.inf]])
        if plant.joint_limits is not None:
            self._low, self._high = plant.joint_limits.T
        self._rough = np.isin(np.arange(robot.n), Law(plant, 'float64').rough)
        spec = replace(spec, dtype='float64')
        step = dual_step(plant, integrator, step_size / substeps)
        self.kernel = compile_tangents(spec, step, substeps, CONSTANT, PLAIN)

    def matrices(
        self,
        state: Mapping[str, ArrayLike],
        wrench: ArrayLike | None,
        brakes: ArrayLike | None,
    ) -> Linearization:
        """Return A and B; `state` are q, qd and tau; all as for Simulation.linearize."""
        n = self._robot.n
        # The kernel checks shapes, and finds numbers that are not finite.
        x = {
            name: real_array(name, value, self._dtype, finite=False).astype(float, copy=False)
            for name, value in state.items()
        }
        S = self.kernel(x['q'], x['qd'], x['tau'], wrench, brakes=brakes)
        rows, shape = S.shape[-2], (*S.shape[:-2], n)
        status = np.empty(shape, WIDEST)
        status[...] = self._moving
        if brakes is not None:
            before = np.broadcast_to(np.where(x['qd'] == 0, HELD, EVENT), shape)
            np.copyto(status, before, where=brakes)
        if self._dry:
            x |= scene_inputs(self._scene, n, 'float64', wrench, brakes)
            # With one axis of arms, for one arm as well.
            for name, value in x.items():
                size = value.shape[-1]
                if value.shape[:-1] != shape[:-1]:
                    value = np.broadcast_to(value, (*shape[:-1], size))
                x[name] = value.reshape(-1, size)
            self._add_events(x, S.reshape(-1, *S.shape[-2:]), status.reshape(-1, n))
        A, B = S[..., :rows], S[..., rows : rows + n]
        if self._dtype == 'float32':
            A, B = A.astype('float32'), B.astype('float32')
        return Linearization(A, B, status)

    def _add_events(self, x: Mapping[str, Array], S: Array, status: NDArray[np.str_]) -> None:
        """
        Write which joints are held or had an event, and the columns of joints at rest.

        A step with too many events has no derivatives.
        """
        n = self._robot.n
        S[S[:, n, -1] > 0, :, :-2] = np.nan
        happened = S[:, :n, -1] > 0
        status[happened] = EVENT
        rests, lower, upper = resting = self._resting(x)
        if not (rests | lower | upper).any():
            return
        status[rests & ~happened & (S[:, n : 2 * n, -2] == 0)] = HELD
        status[(lower & (x['qd'] < 0)) | (upper & (x['qd'] > 0))] = EVENT
        self._add_limits(x, S[..., -2], S[..., : S.shape[-2]], status, resting)

    def _resting(self, x: Mapping[str, Array]) -> tuple[Array, Array, Array]:
        """Return flags of the joints at rest that may be held, and at their lower, upper stops."""
        still, lower, upper = x['qd'] == 0, x['q'] <= self._low, x['q'] >= self._high
        rests = still & (lower | upper | self._rough)
        if 'free' in x:
            free = x['free'] > 0
            rests, lower, upper = free & rests, free & lower, free & upper
            # A brake hands the momentum of its joint to the others.
            rests |= still & ~free & rests.any(axis=-1, keepdims=True)
        return rests, lower, upper

    def _add_limits(
        self,
        x: Mapping[str, Array],
        end: Array,
        A: Array,
        status: NDArray[np.str_],
        resting: tuple[Array, Array, Array],
    ) -> None:
        """
        Write the columns of joints at rest into A, and which joints have one-sided derivatives.

        Of a joint at its stop the step is also taken from inside, of a joint at rest with a
        velocity either way. `end` are the states after the step, (N, r n).
        """
        n, (rests, lower, upper) = self._robot.n, resting
        slow = np.where((lower | upper).any(axis=-1, keepdims=True), SLOW, INSTANT)
        slow = np.broadcast_to(slow, rests.shape)
        near = np.full(rests.shape, NEAR)
        parts = [(lower, near, 0), (upper, -near, 0), (rests, slow, n), (rests, -slow, n)]
        arm, joint = np.concatenate([np.nonzero(flags) for flags, *_ in parts], axis=1)
        change = np.concatenate([size[flags] for flags, size, _ in parts])
        column = joint + np.concatenate([np.full(flags.sum(), first) for flags, _, first in parts])
        S = self._changed(x, arm, column, change)
        each = np.arange(len(arm))
        by_velocity = column >= n
        slope = np.where(by_velocity[:, np.newaxis], S[each, :, column], A[arm, :, column])
        slope[np.abs(slope) < SOON] = 0

        size = 1 + np.abs(slope).max(axis=-1)
        apart = np.abs(S[..., -2] - end[arm] - change[:, np.newaxis] * slope).max(axis=-1)
        rough = ROUNDINGS * (1 + np.abs(end[arm]).max(axis=-1))
        jumps = ~(apart <= JUMP * np.abs(change) * size + rough)
        up, down = (np.flatnonzero(by_velocity & (s * change > 0)) for s in (1, -1))
        kinks = ~(np.abs(slope[up] - slope[down]).max(axis=-1) <= KINK * size[up])
        for which in (np.flatnonzero(jumps), up[kinks]):
            status[arm[which], joint[which]] = ONE_SIDED
        # Where the state jumps for one sign, the limit of the other one counts.
        share = np.where(jumps[up] == jumps[down], 0.5, jumps[down])[:, np.newaxis]
        A[arm[up], :, column[up]] = share * slope[up] + (1 - share) * slope[down]

    def _changed(self, x: Mapping[str, Array], arm: Array, column: Array, change: Array) -> Array:
        """Return the kernel's result for arms with a change of one number of q and qd."""
        n = self._robot.n
        state = np.concatenate([x['q'], x['qd']], axis=-1)[arm]
        state[np.arange(len(arm)), column] += change
        wrench = x['wrench'][arm] if 'wrench' in x else None
        brakes = x['free'][arm] == 0 if 'free' in x else None
        q, qd = state[:, :n], state[:, n:]
        S: Array = self.kernel(q, qd, x['tau'][arm], wrench, brakes=brakes)
        return S
