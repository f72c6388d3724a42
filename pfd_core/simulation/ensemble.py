# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
An ensemble: many simulations of one robot at once, one arm per SIMD lane.

    many = Ensemble(robot, 4096)
    many.reset(q, qd)                                 (4096, n)
    runs = many.rollout(taus)                         torques, (steps, n) or (4096, steps, n)
    runs = many.rollout(steps=1000, feedback=Feedback(kp, kd, q_ref))

The whole loop over the steps is in native code, also where the torque depends on the state. Each
arm moves by the same bits as a Simulator alone would move it, whatever the size of the ensemble
and the number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.kernels.ensemble import LAW, SLOTS, compile_ensemble
from pfd_core.kernels.steps import REPORT
from pfd_core.kernels.threads import COUNT, block_size, count_of, new_job, run
from pfd_core.model import Robot, Scene
from pfd_core.simulation.integrators import record_step

Array = NDArray[Any]


@dataclass(frozen=True)
class Feedback:
    """
    A law that adds kp (q - state q) + kd (qd - state qd) to the torques of a step.

    The state is that at the beginning of the step, for which the torque is held; B arms, n joints.

    Attributes
    ----------
    kp, kd : array_like
        Gains of each joint, (n,) or (B, n) [N m/rad or N/m, and the same times s].
    q, qd : array_like
        What the state is to follow: (n,), (steps, n) or (B, steps, n) [rad or m, and per s].

    """

    kp: ArrayLike
    kd: ArrayLike
    q: ArrayLike
    qd: ArrayLike = 0.0


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
        for name, value in (('size', size), ('substeps', substeps)):
            if not isinstance(value, int) or value < 1:
                raise ValueError(f'{name} must be an integer of at least 1, got {value!r}')
        if not (math.isfinite(step_size) and step_size > 0):
            raise ValueError(f'step_size must be above zero seconds, got {step_size!r}')
        self.robot = robot
        self.size = size
        self.scene = Scene() if scene is None else scene
        self.step_size = step_size
        self.substeps = substeps
        self.dtype = dtype
        step = record_step(integrator, robot.n, step_size / substeps)
        self._native = compile_ensemble(
            robot, step, scene=self.scene, method=method, dtype=dtype, refine=refine
        )
        calls = sum(instruction.op == 'call' for instruction in step.instructions)
        self._evaluations = 1 + substeps * calls
        self._state: dict[str, Array] = {name: np.zeros((size, robot.n), dtype) for name in REPORT}
        self.reset()

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
        if not math.isfinite(time):
            raise ValueError(f'time must be finite, got {time!r}')
        shape = self.size, self.robot.n
        values = {
            name: _spread(name, 0.0 if value is None else value, shape, self.dtype)
            for name, value in (('q', q), ('qd', qd), ('qdd', None))
        }
        for name, value in values.items():
            self._state[name][:] = value
        self._start = time
        self._steps = 0

    def rollout(
        self,
        taus: ArrayLike | None = None,
        *,
        steps: int | None = None,
        feedback: Feedback | None = None,
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
        feedback : Feedback
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
        threads = count_of(threads)
        taus, steps = self._torques(taus, steps)
        if not isinstance(every, int) or every < 1:
            raise ValueError(f'every must be an integer of at least 1, got {every!r}')
        arrays = {'tau': taus, **self._held(wrench, brakes), **self._law(feedback, steps)}
        shape = self.size, steps // every, self.robot.n
        states = {name: np.empty(shape, self.dtype) for name in REPORT}
        sound = np.zeros(self.size, np.int64)
        if steps:
            arrays |= self._state | {f'{name}.out': value for name, value in states.items()}
            self._advance(arrays, steps, every, sound, threads)
        start, self._steps = self._steps, self._steps + steps
        time = self._start + self.step_size * np.arange(start + every, self._steps + 1, every)
        status = 'ok' if (sound == steps).all() else 'not_finite'
        return Trajectories(time, states['q'], states['qd'], states['qdd'], status, sound)

    def _advance(
        self, arrays: dict[str, Array], steps: int, every: int, sound: Array, threads: int
    ) -> None:
        """Run the native code on arrays (B, n) or (B, steps, n), strided as they are."""
        law = int(LAW[0] in arrays)
        table = [x for name in SLOTS for x in _row(arrays.get(name))]
        native = self._native
        job = new_job(table, threads, (steps, self.substeps, every, law, sound.ctypes.data))
        job[COUNT] = self.size
        work = native.work * self._evaluations * steps
        block = block_size(self.size, threads, native.width, work)
        run(native.code, 'ensemble', job, block, threads)

    def _torques(self, taus: ArrayLike | None, steps: int | None) -> tuple[Array, int]:
        """Return the torques, (B, steps, n), and the number of steps."""
        if steps is not None and (not isinstance(steps, int) or steps < 0):
            raise ValueError(f'steps must be an integer of at least 0, got {steps!r}')
        n = self.robot.n
        if taus is None:
            if steps is None:
                raise ValueError('steps is needed where taus does not say how many there are')
            return np.broadcast_to(np.zeros(n, self.dtype), (self.size, steps, n)), steps
        array = np.asarray(taus)
        if array.ndim not in (2, 3):
            raise ValueError(
                f'taus must have shape (steps, {n}) or ({self.size}, steps, {n}), '
                f'got {array.shape}'
            )
        found = array.shape[-2]
        if steps not in (None, found):
            raise ValueError(f'taus holds {found} steps, but steps={steps} were asked for')
        return _spread('taus', taus, (self.size, found, n), self.dtype), found

    def _held(self, wrench: ArrayLike | None, brakes: ArrayLike | None) -> dict[str, Array]:
        """Return what stays the same for all steps, (B, 6) and (B, n)."""
        held = {}
        if (wrench is not None) != self.scene.external_wrench:
            raise ValueError(
                'wrench is given exactly when the scene has external_wrench=True: '
                f'external_wrench={self.scene.external_wrench}, wrench={wrench!r}'
            )
        if wrench is not None:
            held['wrench'] = _spread('wrench', wrench, (self.size, 6), self.dtype)
        if brakes is not None and not self.scene.brakes:
            raise ValueError('brakes were given, but the scene has none: use Scene(brakes=True)')
        if self.scene.brakes:
            free = 1.0 - np.asarray(False if brakes is None else brakes, dtype=bool)
            held['free'] = _spread('brakes', free, (self.size, self.robot.n), self.dtype)
        return held

    def _law(self, feedback: Feedback | None, steps: int) -> dict[str, Array]:
        """Return gains, (B, n), and references, (B, steps, n)."""
        if feedback is None:
            return {}
        if not isinstance(feedback, Feedback):
            raise ValueError(f'feedback must be a Feedback, got {type(feedback).__name__}')
        n = self.robot.n
        gains, references = (self.size, n), (self.size, steps, n)
        shapes = {'kp': gains, 'kd': gains, 'q': references, 'qd': references}
        return {
            slot: _spread(f'feedback.{name}', getattr(feedback, name), shape, self.dtype)
            for slot, (name, shape) in zip(LAW, shapes.items(), strict=True)
        }


def _spread(name: str, value: ArrayLike, shape: tuple[int, ...], dtype: str) -> Array:
    """Return finite numbers broadcast to a shape; ValueError if they are not or do not fit."""
    try:
        array = np.asarray(value, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise ValueError(f'{name} must be an array of numbers, got {value!r}') from error
    if not np.isfinite(array).all():
        raise ValueError(f'{name} must be finite')
    try:
        return np.broadcast_to(array, shape)
    except ValueError as error:
        wanted = ' or '.join(str(shape[k:]) for k in range(len(shape)))
        raise ValueError(f'{name} must have shape {wanted}, got {array.shape}') from error


def _row(array: Array | None) -> tuple[int, int, int, int]:
    """Return pointer, and strides from arm to arm, element to element and step to step."""
    if array is None:
        return 0, 0, 0, 0
    arm, *step, element = array.strides
    return array.ctypes.data, arm, element, step[0] if step else 0
