# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The simulator: an arm in time, advanced by native code.

    sim = Simulator(robot)
    sim.step(tau)               one step, the torque held
    sim.rollout(taus)           many, without returning to Python

A step of `step_size` seconds holds the torque as a real arm's controller does between two
samples, and integrates in `substeps` equal parts. The same robot, scene, settings and torques
give the same bits, step by step or in one rollout.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.kernels.rollout import compile_rollout
from pfd_core.model import Robot, Scene
from pfd_core.simulation.inputs import (
    Array,
    check_held,
    free,
    instant,
    numbers,
    positive_integer,
    seconds,
)
from pfd_core.simulation.integrators import record_step


@dataclass(frozen=True)
class Trajectory:
    """
    States after each of a number of steps.

    Attributes
    ----------
    time : numpy.ndarray
        (steps,) [s].
    q, qd : numpy.ndarray
        (steps, n), positions and velocities [rad or m, s].
    status : str
        'ok', or 'not_finite' if a state overflowed.
    sound : int
        Steps from the first on after which the state was finite.

    """

    time: Array
    q: Array
    qd: Array
    status: str
    sound: int
    _accelerations: Callable[[], Array] = field(repr=False, compare=False)

    @cached_property
    def qdd(self) -> Array:
        """
        Accelerations at the end of each step, under its torque, (steps, n) [rad or m, s].

        No step needs them, so that they are computed from the states when they are first read.
        """
        return self._accelerations()


class Simulator:
    """
    A robot in a scene, in time.

    Parameters
    ----------
    robot : Robot
        The chain.
    scene : Scene, optional
        Which effects are on; default: rigid links and gravity.
    step_size : float
        Seconds per step, for which the torque is held.
    substeps : int
        Steps of the integrator in one step.
    integrator : str
        'auto' or a name in pfd_core.INTEGRATORS.
    method, dtype, refine
        As for compile_kernel.

    Attributes
    ----------
    status : str
        'ok', or 'not_finite' once a state has overflowed; `reset` clears it.

    Raises
    ------
    ValueError
        If an argument is not one of these, or does not fit the robot.

    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene | None = None,
        *,
        step_size: float = 1e-3,
        substeps: int = 2,
        integrator: str = 'auto',
        method: str = 'auto',
        dtype: str = 'float64',
        refine: int = 0,
    ) -> None:
        self.robot = robot
        self.scene = Scene() if scene is None else scene
        self.step_size = seconds('step_size', step_size)
        self.substeps = positive_integer('substeps', substeps)
        self.dtype = dtype
        step = record_step(integrator, robot.n, step_size / substeps)
        self._native = compile_rollout(
            robot, step, scene=self.scene, method=method, dtype=dtype, refine=refine
        )
        n = robot.n
        self._state: list[Array] = [np.zeros(n, dtype) for _ in range(2)]
        self._row: list[Array] = [np.zeros((1, n), dtype) for _ in range(2)]
        self._tau = np.zeros((1, n), dtype)
        self._wrench, self._free = np.zeros(6, dtype), np.ones(n, dtype)
        # NumPy takes longer to tell an address than an arm takes to move.
        self._state_at = _addresses(self._state)
        self._step_at = _addresses([self._tau]), _addresses(self._row)
        self._wrench_at, self._free_at = _addresses([self._wrench]), _addresses([self._free])
        self.reset()

    @property
    def method(self) -> str:
        """The method that 'auto' stood for."""
        return self._native.method

    @property
    def q(self) -> Array:
        """Joint positions, (n,) [rad or m]; a copy."""
        return np.array(self._state[0])

    @property
    def qd(self) -> Array:
        """Joint velocities, (n,) [rad/s or m/s]; a copy."""
        return np.array(self._state[1])

    @property
    def qdd(self) -> Array:
        """
        Accelerations at the end of the last step, under its torque, (n,) [rad/s^2 or m/s^2].

        Zero before the first step.
        """
        if not self._steps:
            return np.zeros(self.robot.n, self.dtype)
        q, qd = (x[np.newaxis] for x in self._state)
        qdd: Array = self._accelerations(q, qd, self._tau, self._wrench, self._free)[0]
        return qdd

    @property
    def time(self) -> float:
        """Time of the state [s]: the start plus whole steps, so that it does not drift."""
        return self._start + self._steps * self.step_size

    def reset(
        self, q: ArrayLike | None = None, qd: ArrayLike | None = None, time: float = 0.0
    ) -> None:
        """Set positions and velocities, (n,), default zero, and the time [s]."""
        values = [
            np.zeros(self.robot.n) if value is None else self._vector(name, value)
            for name, value in (('q', q), ('qd', qd))
        ]
        self._start = instant(time)
        for target, value in zip(self._state, values, strict=True):
            target[:] = value
        self._steps = 0
        self.status = 'ok'

    def step(
        self, tau: ArrayLike, wrench: ArrayLike | None = None, *, brakes: ArrayLike | None = None
    ) -> None:
        """
        Advance the state by one step.

        Parameters
        ----------
        tau : array_like
            Torques [N m or N], (n,), held for the step.
        wrench : array_like
            Force and moment on the last link, (6,); exactly if the scene has one.
        brakes : array_like of bool
            Joints that stay where they are, (n,); only if the scene has brakes, default none.

        """
        self._tau[0] = self._vector('tau', tau)
        self._advance(1, *self._step_at, wrench, brakes)

    def rollout(
        self, taus: ArrayLike, wrench: ArrayLike | None = None, *, brakes: ArrayLike | None = None
    ) -> Trajectory:
        """
        Advance the state by one step for each row of torques.

        Parameters
        ----------
        taus : array_like
            (steps, n) [N m or N].
        wrench, brakes
            As for `step`, the same for all steps.

        Returns
        -------
        Trajectory
            Row k is the state after step k + 1.

        """
        rows = np.ascontiguousarray(numbers('taus', taus, self.dtype))
        if rows.ndim != 2 or rows.shape[1] != self.robot.n:
            raise ValueError(f'taus must have shape (steps, {self.robot.n}), got {rows.shape}')
        start = self._steps
        q, qd = out = [np.empty_like(rows) for _ in range(2)]
        sound = 0
        if len(rows):
            sound = self._advance(len(rows), _addresses([rows]), _addresses(out), wrench, brakes)
            self._tau[0] = rows[-1]
        time = self._start + self.step_size * np.arange(start + 1, start + len(rows) + 1)
        status = 'ok' if sound == len(rows) else 'not_finite'
        # The caller may change what he gave, and the next call what is held.
        held = rows.copy(), self._wrench.copy(), self._free.copy()
        return Trajectory(time, q, qd, status, sound, partial(self._accelerations, q, qd, *held))

    def _advance(
        self,
        steps: int,
        taus: list[int],
        out: list[int],
        wrench: ArrayLike | None,
        brakes: ArrayLike | None,
    ) -> int:
        """Run the native code; return after how many steps the state was finite."""
        held = self._held(wrench, brakes)
        sound = self._native.run(steps, self.substeps, *self._state_at, *taus, *held, *out)
        self._steps += steps
        if sound < steps:
            self.status = 'not_finite'
        return sound

    def _accelerations(
        self, q: Array, qd: Array, taus: Array, wrench: Array, free: Array
    ) -> Array:
        """Return the accelerations of states in rows, all (steps, n)."""
        qdd = np.empty_like(q)
        rows = [np.ascontiguousarray(x) for x in (q, qd, taus)]
        held = [wrench] * self.scene.external_wrench + [free] * self.scene.brakes
        if len(q):
            self._native.accelerations(len(q), *_addresses([*rows, *held, qdd]))
        return qdd

    def _held(self, wrench: ArrayLike | None, brakes: ArrayLike | None) -> list[int]:
        """Return the addresses that the native code takes after the torques."""
        check_held(self.scene, wrench, brakes)
        held: list[int] = []
        if wrench is not None:
            self._wrench[:] = self._vector('wrench', wrench, 6)
            held += self._wrench_at
        if self.scene.brakes:
            self._free[:] = free(brakes)
            held += self._free_at
        return held

    def _vector(self, name: str, value: ArrayLike, size: int | None = None) -> Array:
        """Return a finite vector of the right length; ValueError if it is not one."""
        size = self.robot.n if size is None else size
        array = numbers(name, value, self.dtype)
        if array.shape != (size,):
            raise ValueError(f'{name} must have shape ({size},), got {array.shape}')
        return array


def _addresses(arrays: list[Array]) -> list[int]:
    return [array.ctypes.data for array in arrays]
