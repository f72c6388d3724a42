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

from copy import copy, deepcopy
from functools import partial
import time
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.kernels.simulations import Rollout, compile_rollout
from pfd_core.model import Robot, Scene
from pfd_core.model.arguments import held_mask, integer
from pfd_core.simulation.inputs import Array, check_held, instant, numbers, seconds
from pfd_core.simulation.integrators import record_step
from pfd_core.simulation.moment import Moment
from pfd_core.simulation.trajectory import Trajectory

# A rollout runs in pieces, between which Python looks for signals: seconds that one may take,
# by the time that the one before took, and operations of the first, a loop's counted once. A
# step is never cut.
PIECE = 0.05
FIRST = 1_000_000


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

    Copies and pickles carry the state on with the same bits; the native code is compiled again,
    or found on disk, where a pickle is opened.

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
        self.substeps = integer('substeps', substeps, 1)
        self.dtype = dtype
        self._settings: dict[str, Any] = {
            'integrator': integrator,
            'method': method,
            'refine': refine,
        }
        self._native = self._compile()
        # The valid moment, which `_turn` points to, and one to work on.
        self._moments = Moment(robot.n, dtype), Moment(robot.n, dtype)
        self._turn = 0
        self._out = Moment(robot.n, dtype)

    def _compile(self) -> Rollout:
        """Return the native code of these settings."""
        integrator, method, refine = self._settings.values()
        step = record_step(integrator, self.robot.n, self.step_size / self.substeps)
        return compile_rollout(
            self.robot, step, scene=self.scene, method=method, dtype=self.dtype, refine=refine
        )

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != '_native'}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__ |= state
        self._native = self._compile()

    def __copy__(self) -> Simulator:
        # Robot, scene and code never change.
        twin = object.__new__(type(self))
        twin.__dict__ |= self.__dict__
        twin._moments = deepcopy(self._moments)
        twin._out = deepcopy(self._out)
        return twin

    def __deepcopy__(self, memo: dict[int, Any]) -> Simulator:
        return copy(self)

    @property
    def method(self) -> str:
        """The method that 'auto' stood for."""
        return self._native.method

    @property
    def q(self) -> Array:
        """Joint positions, (n,) [rad or m]; a copy."""
        return np.array(self._now.q)

    @property
    def qd(self) -> Array:
        """Joint velocities, (n,) [rad/s or m/s]; a copy."""
        return np.array(self._now.qd)

    @property
    def qdd(self) -> Array:
        """
        Accelerations at the end of the last step, under its torque, (n,) [rad/s^2 or m/s^2].

        Zero before the first step.
        """
        now = self._now
        if not now.steps:
            return np.zeros(self.robot.n, self.dtype)
        held = [now.wrench] * self.scene.external_wrench + [now.free] * self.scene.brakes
        q, qd, tau = (x[np.newaxis] for x in (now.q, now.qd, now.tau))
        qdd: Array = self._accelerations(q, qd, tau, held)[0]
        return qdd

    @property
    def time(self) -> float:
        """Time of the state [s]: the start plus whole steps, so that it does not drift."""
        now = self._now
        return now.start + now.steps * self.step_size

    @property
    def status(self) -> str:
        """'ok', or 'not_finite' once a state has overflowed; `reset` clears it."""
        return self._now.status

    def reset(
        self, q: ArrayLike | None = None, qd: ArrayLike | None = None, time: float = 0.0
    ) -> None:
        """Set positions and velocities, (n,), default zero, and the time [s]."""
        following = self._following()
        for target, name, value in ((following.q, 'q', q), (following.qd, 'qd', qd)):
            target[:] = 0.0 if value is None else self._vector(name, value)
        following.start, following.steps, following.status = instant(time), 0, 'ok'
        self._turn ^= 1

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
        row, held = self._vector('tau', tau), self._held(wrench, brakes)
        following = self._following(row, held)
        self._advance(following, 1, following.at['tau'], self._out.at['q'], self._out.at['qd'])

    def rollout(
        self, taus: ArrayLike, wrench: ArrayLike | None = None, *, brakes: ArrayLike | None = None
    ) -> Trajectory:
        """
        Advance the state by one step for each row of torques.

        A KeyboardInterrupt ends it within a fraction of a second; the state and the time are then
        those after some of the steps, from which another call goes on.

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
        # The caller may change what was given, before the accelerations are read.
        rows = np.array(numbers('taus', taus, self.dtype), order='C')
        if rows.ndim != 2 or rows.shape[1] != self.robot.n:
            raise ValueError(f'taus must have shape (steps, {self.robot.n}), got {rows.shape}')
        held = self._held(wrench, brakes)
        before = self._now.steps
        q, qd = np.empty_like(rows), np.empty_like(rows)
        sound = self._pieces(rows, held, q, qd)
        steps = np.arange(before + 1, before + len(rows) + 1)
        return Trajectory(
            time=self._now.start + self.step_size * steps,
            q=q,
            qd=qd,
            status='ok' if sound == len(rows) else 'not_finite',
            sound=sound,
            _accelerations=partial(self._accelerations, q, qd, rows, list(held.values())),
        )

    def _pieces(self, rows: Array, held: dict[str, Array], q: Array, qd: Array) -> int:
        """Take a step for each row, piece by piece; return after how many it was all finite."""
        places = [array.ctypes.data for array in (rows, q, qd)]
        done, sound, count = 0, 0, max(1, FIRST // (self._native.work * self.substeps))
        while done < len(rows):
            count = min(count, len(rows) - done)
            begin = time.perf_counter()
            following = self._following(rows[done + count - 1], held)
            here = (place + done * rows.strides[0] for place in places)
            finite = self._advance(following, count, *here)
            sound += finite if sound == done else 0
            done += count
            spent = max(time.perf_counter() - begin, 1e-9)
            count = max(1, min(2 * count, int(count * PIECE / spent)))
        return sound

    def _advance(self, following: Moment, steps: int, taus: int, q: int, qd: int) -> int:
        """
        Run the native code on a moment, which becomes the valid one.

        Returns after how many steps the state was finite; arrays are given by their addresses.
        """
        at, scene = following.at, self.scene
        held = [at['wrench']] * scene.external_wrench + [at['free']] * scene.brakes
        sound = self._native.run(steps, self.substeps, at['q'], at['qd'], taus, *held, q, qd)
        following.steps += steps
        if sound < steps:
            following.status = 'not_finite'
        self._turn ^= 1
        return sound

    def _accelerations(self, q: Array, qd: Array, taus: Array, held: list[Array]) -> Array:
        """Return the accelerations of states in rows, all (steps, n)."""
        qdd = np.empty_like(q)
        rows = [np.ascontiguousarray(x) for x in (q, qd, taus)]
        if len(q):
            self._native.accelerations(len(q), *(x.ctypes.data for x in (*rows, *held, qdd)))
        return qdd

    @property
    def _now(self) -> Moment:
        """The valid moment."""
        return self._moments[self._turn]

    def _following(self, tau: Array | None = None, held: dict[str, Array] | None = None) -> Moment:
        """Return the other moment: the valid one with another torque, wrench and brakes."""
        following = self._moments[1 - self._turn]
        following.take(self._now)
        if tau is not None:
            following.tau[:] = tau
        if held:
            for name, value in held.items():
                getattr(following, name)[:] = value
        return following

    def _held(self, wrench: ArrayLike | None, brakes: ArrayLike | None) -> dict[str, Array]:
        """Return copies of what stays the same for all steps, in the order of the kernel."""
        check_held(self.scene, wrench, brakes)
        held = {}
        if wrench is not None:
            held['wrench'] = np.array(self._vector('wrench', wrench, 6))
        if self.scene.brakes:
            held['free'] = held_mask(brakes, self.robot.n, self.dtype)
            if held['free'].ndim != 1:
                raise ValueError(
                    f'brakes must have shape ({self.robot.n},), got {held["free"].shape}'
                )
        return held

    def _vector(self, name: str, value: ArrayLike, size: int | None = None) -> Array:
        """Return a finite vector of the right length; ValueError if it is not one."""
        size = self.robot.n if size is None else size
        array = numbers(name, value, self.dtype)
        if array.shape != (size,):
            raise ValueError(f'{name} must have shape ({size},), got {array.shape}')
        return array
