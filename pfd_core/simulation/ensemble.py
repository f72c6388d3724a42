# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
An ensemble: many simulations of one robot at once, one arm per SIMD lane.

    many = Ensemble(robot, 4096)
    many.reset(q, qd)                                 (4096, n)
    runs = many.rollout(taus)                         torques, (steps, n) or (4096, steps, n)
    runs = many.rollout(steps=1000, feedback=Feedback(kp, kd, q_ref))
    runs = many.rollout(taus, feedback=StateFeedback(gain, q_ref, qd_ref))

The whole loop over the steps is in native code, also where the torque depends on the state. Each
arm moves by the same bits as a Simulator alone would move it, whatever the size of the ensemble
and the number of threads.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy, deepcopy
from dataclasses import dataclass
from functools import partial
import os
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.kernels.codegen.arms import SLOTS
from pfd_core.kernels.codegen.step import REPORT
from pfd_core.kernels.runtime.threads import MAX_BLOCK_WORK, block_size, run, thread_count
from pfd_core.kernels.simulations import NativeEnsemble, compile_ensemble
from pfd_core.model import Robot, Scene
from pfd_core.model.arguments import held_mask, integer
from pfd_core.simulation.feedback import Law, law_arrays
from pfd_core.simulation.inputs import Array, check_held, instant, numbers, seconds, spread
from pfd_core.simulation.integrators import record_step


@dataclass(frozen=True)
class Trajectories:
    """
    States of B arms after each, or every so many, of a number of steps.

    Attributes
    ----------
    time : numpy.ndarray
        (K,) [s].
    q, qd, qdd : numpy.ndarray
        (B, K, n), positions, velocities and accelerations [rad or m, s].
    status : str
        'ok', or 'not_finite' if the state of some arm overflowed.
    sound : numpy.ndarray
        (B,), steps from the first on after which the arm's state was finite.

    """

    time: Array
    q: Array
    qd: Array
    qdd: Array
    status: str
    sound: Array


class Ensemble:
    """
    Many arms of one kind in equal scenes, in time.

    Parameters
    ----------
    robot : Robot
        The chain.
    size : int
        Number of arms B, at least 1.
    scene : Scene, optional
        Which effects are on; default: rigid links and gravity.
    step_size, substeps, integrator, method, dtype, refine
        As for Simulator.

    Raises
    ------
    ValueError
        If an argument is not one of these, or does not fit the robot.

    """

    def __init__(
        self,
        robot: Robot,
        size: int,
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
        self.size = integer('size', size, 1)
        self.scene = Scene() if scene is None else scene
        self.step_size = seconds('step_size', step_size)
        self.substeps = integer('substeps', substeps, 1)
        self.dtype = dtype
        self._settings: dict[str, Any] = {
            'integrator': integrator,
            'method': method,
            'refine': refine,
        }
        self._native, self._evaluations = self._compile()
        shape = self.size, robot.n
        _check_memory(self.size, len(REPORT) * robot.n * np.dtype(dtype).itemsize)
        self._state: dict[str, Array] = {name: np.zeros(shape, dtype) for name in REPORT}
        self.reset()

    def _compile(self) -> tuple[NativeEnsemble, int]:
        """Return the native code of these settings, and the evaluations in a step."""
        integrator, method, refine = self._settings.values()
        step = record_step(integrator, self.robot.n, self.step_size / self.substeps)
        native = compile_ensemble(
            self.robot, step, scene=self.scene, method=method, dtype=self.dtype, refine=refine
        )
        calls = sum(instruction.op == 'call' for instruction in step.instructions)
        return native, 1 + self.substeps * calls

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != '_native'}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__ |= state
        self._native, _ = self._compile()

    def __copy__(self) -> Ensemble:
        # Robot, scene and code never change.
        twin = object.__new__(type(self))
        twin.__dict__ |= self.__dict__
        twin._state = deepcopy(self._state)
        return twin

    def __deepcopy__(self, memo: dict[int, Any]) -> Ensemble:
        return copy(self)

    @property
    def method(self) -> str:
        """The method that 'auto' stood for."""
        return self._native.method

    @property
    def q(self) -> Array:
        """Joint positions, (B, n) [rad or m]; a copy."""
        return np.array(self._state['q'])

    @property
    def qd(self) -> Array:
        """Joint velocities, (B, n) [rad/s or m/s]; a copy."""
        return np.array(self._state['qd'])

    @property
    def qdd(self) -> Array:
        """Accelerations at the end of the last step, (B, n) [rad/s^2 or m/s^2]; a copy."""
        return np.array(self._state['qdd'])

    @property
    def time(self) -> float:
        """Time of the states [s]."""
        return self._start + self._steps * self.step_size

    def reset(
        self, q: ArrayLike | None = None, qd: ArrayLike | None = None, time: float = 0.0
    ) -> None:
        """Set positions and velocities, (n,) or (B, n), default zero, and the time [s]."""
        shape = self.size, self.robot.n
        values = {
            name: spread(name, 0.0 if value is None else value, shape, self.dtype)
            for name, value in (('q', q), ('qd', qd), ('qdd', None))
        }
        for name, value in values.items():
            self._state[name][:] = value
        self._start = instant(time)
        self._steps = 0

    def rollout(
        self,
        taus: ArrayLike | None = None,
        *,
        steps: int | None = None,
        feedback: Law | None = None,
        wrench: ArrayLike | None = None,
        brakes: ArrayLike | None = None,
        every: int = 1,
        threads: int = 1,
    ) -> Trajectories:
        """
        Advance all arms by a number of steps.

        Parameters
        ----------
        taus : array_like
            Torques of each step [N m or N], (steps, n) or (B, steps, n); default zero.
        steps : int
            Number of steps; needed where no torques say it.
        feedback : Feedback or StateFeedback
            A law that adds to the torques; default none.
        wrench : array_like
            Force and moment on the last link, (6,) or (B, 6); exactly if the scene has one.
        brakes : array_like of bool
            Joints that stay where they are, (n,) or (B, n); only if the scene has brakes.
        every : int
            Steps from one state that is returned to the next; the last ones may not be.
        threads : int
            The most that are used; 0 is one per core. The bits are the same.

        Returns
        -------
        Trajectories
            States after `every`, 2 `every`, ... steps.

        """
        threads = thread_count(threads)
        taus, steps = self._torques(taus, steps)
        every = integer('every', every, 1)
        law, followed = law_arrays(feedback, self.size, steps, self.robot.n, self.dtype)
        given = {'tau': taus, **self._held(wrench, brakes), **followed}
        shape = self.size, steps // every, self.robot.n
        states = {name: np.empty(shape, self.dtype) for name in REPORT}
        sound = np.zeros(self.size, np.int64)
        begin = self._steps
        for first, count, interval in pieces(steps, every, self._steps_at_once):
            rows = slice(first // every, (first + count) // every)
            arrays = {
                name: array[:, first : first + count] if array.ndim == 3 else array
                for name, array in given.items()
            } | {f'{name}.out': array[:, rows] for name, array in states.items()}
            self._advance(arrays, (count, interval, law), sound, first, threads)
        time = self._start + self.step_size * np.arange(begin + every, self._steps + 1, every)
        status = 'ok' if (sound == steps).all() else 'not_finite'
        return Trajectories(time, states['q'], states['qd'], states['qdd'], status, sound)

    @property
    def _steps_at_once(self) -> int:
        """Steps of a register of arms that a signal may have to wait for."""
        return max(MAX_BLOCK_WORK // (self._native.work * self._evaluations), 1)

    def _advance(
        self,
        arrays: dict[str, Array],
        manner: tuple[int, int, int],
        sound: Array,
        first: int,
        threads: int,
    ) -> None:
        """
        Advance all arms by some steps, or none where the caller is interrupted.

        Arrays are (B, n) or (B, steps, n), strided as they are; `manner` is the number of steps,
        the interval at which states are written, and the law. `sound` counts on from `first`.
        """
        steps, every, law = manner
        state = {name: array.copy() for name, array in self._state.items()}
        table = np.array([_row((arrays | state).get(name)) for name in SLOTS], np.int64)
        good = np.zeros(self.size, np.int64)
        settings = (self.size - 1, steps, self.substeps, every, law)
        work = partial(_run_block, self._native, settings, table, good, (arrays, state))
        operations = self._native.work * self._evaluations * steps
        block = block_size(self.size, threads, self._native.width, operations)
        run(work, self.size, block, threads)
        sound[sound == first] += good[sound == first]
        self._state, self._steps = state, self._steps + steps

    def _torques(self, taus: ArrayLike | None, steps: int | None) -> tuple[Array, int]:
        """Return the torques, (B, steps, n), and the number of steps."""
        steps = None if steps is None else integer('steps', steps, 0)
        n = self.robot.n
        if taus is None:
            if steps is None:
                raise ValueError('steps is needed where taus does not say how many there are')
            return np.broadcast_to(np.zeros(n, self.dtype), (self.size, steps, n)), steps
        array = numbers('taus', taus, self.dtype)
        if array.ndim not in (2, 3):
            raise ValueError(
                f'taus must have shape (steps, {n}) or ({self.size}, steps, {n}), '
                f'got {array.shape}'
            )
        found = array.shape[-2]
        if steps not in (None, found):
            raise ValueError(f'taus holds {found} steps, but steps={steps} were asked for')
        return spread('taus', array, (self.size, found, n), self.dtype), found

    def _held(self, wrench: ArrayLike | None, brakes: ArrayLike | None) -> dict[str, Array]:
        """Return what stays the same for all steps, (B, 6) and (B, n)."""
        check_held(self.scene, wrench, brakes)
        held = {}
        if wrench is not None:
            held['wrench'] = spread('wrench', wrench, (self.size, 6), self.dtype)
        if self.scene.brakes:
            free = held_mask(brakes, self.robot.n, self.dtype)
            held['free'] = spread('brakes', free, (self.size, self.robot.n), self.dtype)
        return held


def pieces(steps: int, every: int, most: int) -> Iterator[tuple[int, int, int]]:
    """
    Yield where pieces of a rollout begin, how many steps they have, and their interval.

    A piece has at most `most` steps. The interval is counted from its beginning: states are
    written after `every`, 2 `every`, ... steps of the whole, and nowhere else.
    """
    if every <= most:
        most -= most % every
    first = 0
    while first < steps:
        count = min(most, steps - first)
        interval = every
        if every > most:
            count = min(count, every - first % every)
            interval = count + ((first + count) % every > 0)
        yield first, count, interval
        first += count


def _run_block(
    native: NativeEnsemble,
    manner: tuple[int, ...],
    table: Array,
    good: Array,
    alive: object,
    first: int,
    size: int,
) -> int:
    """Run a block of arms on the arrays of a table, which must stay alive meanwhile."""
    native.run(first, first + size, *manner, table.ctypes.data, good.ctypes.data)
    return 0


def _check_memory(size: int, each: int) -> None:
    """Raise ValueError for more arms than a machine can hold, which some only find out later."""
    if hasattr(os, 'sysconf'):
        there = os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES')
        if size * each > there:
            raise ValueError(
                f'size={size} arms take {size * each // 10**9} GB, but this machine has '
                f'{there // 10**9} GB'
            )


def _row(array: Array | None) -> tuple[int, int, int, int]:
    """Return pointer, and strides from arm to arm, element to element and step to step."""
    if array is None:
        return 0, 0, 0, 0
    arm, *step, element = array.strides
    return array.ctypes.data, arm, element, step[0] if step else 0
