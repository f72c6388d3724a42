# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Adaptive integration of one arm in double precision, for offline runs and references.

    run = integrate(robot, tau, 10.0, q=q, rtol=1e-11)
    run.time, run.q, run.qd, run.qdd         at the ends of the steps
    run.at(np.linspace(0.0, 10.0, 501))      at any times: dense output

The state y = (q, qd) obeys y' = (qd, f(q, qd, tau)), f the forward dynamics of a native kernel.
The steps and the dense output are those of an embedded pair (pfd_core.simulation.embedded_pairs),
their sizes follow from its estimates of the error (pfd_core.simulation.step_control).
The torque acts continuously, whereas a Simulator holds it for each step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
import math

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.kernels.compile import compile_kernel
from pfd_core.model import Robot, Scene, given_scene, resolve, scene_inputs
from pfd_core.model.checked_numbers import Array, choice, integer, real_array, real_number
from pfd_core.model.scene_checks import switch
from pfd_core.simulation.embedded_pairs import PAIRS, interpolate
from pfd_core.simulation.step_control import SMALLEST_RTOL, Steps
from pfd_core.simulation.trajectory import Trajectory

TorqueLaw = Callable[[float, Array, Array], ArrayLike]


@dataclass(frozen=True, eq=False)
class AdaptiveTrajectory(Trajectory):
    """
    A Trajectory at the start and at the end of each accepted step, K + 1 times.

    Its status is 'ok', or the reason for an end before the duration: 'not_finite' where a number
    overflows however small the step, 'step_too_small' where the tolerance cannot be met, or
    'too_many_steps'. `finite_steps` is K. `qdd` is under the torque at each time.

    Attributes
    ----------
    evaluations : int
        Evaluations of the forward dynamics, those for the dense output included.
    rejected_steps : int
        Steps that were tried and taken again with a smaller size.
    _dense : numpy.ndarray
        (K, 7, 2 n), coefficients of the dense output in each step.

    """

    evaluations: int
    rejected_steps: int
    _dense: Array | None = field(repr=False)

    def at(self, times: ArrayLike) -> Trajectory:
        """
        Return the states at times (M,) [s], from 0 to the end of the run, in any order.

        Within a step they are a polynomial of one order less than the step. The accelerations
        are the derivative of its velocities.

        Raises
        ------
        ValueError
            If a time lies outside the run, or the run has no dense output or no step.

        """
        points = real_array('times', times, shape=('M',))
        if self._dense is None:
            raise ValueError('states between the steps need integrate(..., dense=True)')
        if not len(self._dense):
            raise ValueError(f'the run has no step to look into: status {self.status!r}')
        end = self.time[-1]
        outside = points[(points < 0) | (points > end)]
        if outside.size:
            raise ValueError(f'times must lie from 0 to {end:g} s, got {outside[0]}')
        step = np.searchsorted(self.time[1:-1], points, side='right')
        size = np.diff(self.time)[step, np.newaxis]
        part = (points - self.time[step])[:, np.newaxis] / size
        begin = np.hstack([self.q, self.qd])[step]
        rise, slope = interpolate(self._dense[step], part)
        q, qd = np.hsplit(begin + rise, 2)
        qdd = np.hsplit(slope / size, 2)[1]
        return Trajectory(points.copy(), q, qd, qdd, 'ok', len(points))


def integrate(
    robot: Robot,
    tau: ArrayLike | TorqueLaw,
    duration: float,
    *,
    scene: Scene | None = None,
    q: ArrayLike | None = None,
    qd: ArrayLike | None = None,
    wrench: ArrayLike | None = None,
    brakes: ArrayLike | None = None,
    rtol: float = 1e-9,
    atol: float = 1e-12,
    integrator: str = 'dop853',
    method: str = 'auto',
    refine: int = 0,
    dense: bool = True,
    max_step: float = math.inf,
    max_steps: int = 100_000,
) -> AdaptiveTrajectory:
    """
    Return the motion of an arm, integrated with steps that keep to a tolerance.

    Parameters
    ----------
    robot : Robot
        The chain.
    tau : array_like or callable
        Torques [N m or N], (n,): constant, or tau(t, q, qd) with t in seconds since the start.
    duration : float
        Seconds to integrate, above zero.
    scene : Scene, optional
        Which effects are on; default: rigid links and gravity.
    q, qd : array_like
        State at the start, (n,) [rad or m, and per s]; default zero.
    wrench : array_like
        Force and moment on the last link, (6,); exactly if the scene has one.
    brakes : array_like of bool
        Joints that stay where they are, (n,); only if the scene has brakes, default none.
    rtol, atol : float
        Error in a step, as root mean square over the state of error / (atol + rtol |state|): at
        most 1. The error of the motion is larger, by what the arm amplifies and the steps add.
    integrator : str
        A name in pfd_core.simulation.embedded_pairs.PAIRS.
    method, refine
        As for compile_kernel.
    dense : bool
        Whether the run has states between the steps; costs three evaluations a step.
    max_step : float
        Largest step [s], for torques with pulses that a longer step would not see.
    max_steps : int
        Steps to try at most, accepted or rejected.

    Raises
    ------
    ValueError
        If an argument is not one of these or does not fit the robot; so for a torque that tau
        returns, except a non-finite one, which the step size control treats as overflow.

    """
    resolve(robot, scene)  # ValueError for a wrong robot or scene
    choice('integrator', integrator, PAIRS)
    duration = _above_zero('duration', duration)
    longest = min(duration, _above_zero('max_step', max_step, finite=False))
    tolerances = _above_zero('atol', atol), real_number('rtol', rtol)
    if not SMALLEST_RTOL <= tolerances[1] < 1:
        raise ValueError(f'rtol must be at least {SMALLEST_RTOL} and below 1, got {rtol}')
    max_steps = integer('max_steps', max_steps, 1)
    slope = _Slope(robot, scene, tau, wrench, brakes, method, refine)
    start = slope.start(q, qd)
    steps = Steps(PAIRS[integrator], slope, start, tolerances, switch('dense', dense))
    # Overflow is a status of the run.
    with np.errstate(over='ignore', invalid='ignore'):
        status = steps.run(duration, longest, max_steps)
    states, slopes = np.array(steps.states), np.array(steps.slopes)
    n = robot.n
    return AdaptiveTrajectory(
        time=np.array(steps.times),
        q=states[:, :n].copy(),
        qd=states[:, n:].copy(),
        _qdd=slopes[:, n:].copy(),
        status=status,
        finite_steps=len(states) - 1,
        evaluations=slope.evaluations,
        rejected_steps=steps.rejected,
        _dense=np.array(steps.dense).reshape(-1, 7, 2 * n) if dense else None,
    )


class _Slope:
    """The right-hand side y' = (qd, f(q, qd, tau)) of a robot in a scene, and its evaluations."""

    def __init__(
        self,
        robot: Robot,
        scene: Scene | None,
        tau: ArrayLike | TorqueLaw,
        wrench: ArrayLike | None,
        brakes: ArrayLike | None,
        method: str,
        refine: int,
    ) -> None:
        self.n = robot.n
        self.evaluations = 0
        scene = given_scene(scene)
        self._torque = _checked_law(tau, self.n) if callable(tau) else _constant_law(tau, self.n)
        inputs = scene_inputs(scene, self.n, 'float64', wrench, brakes)
        self._free = inputs.get('free')
        self._kernel = partial(
            compile_kernel(robot, method=method, scene=scene, refine=refine),
            wrench=inputs.get('wrench'),
            brakes=None if self._free is None else self._free == 0,
        )

    def start(self, q: ArrayLike | None, qd: ArrayLike | None) -> Array:
        """Return the state at the start, (2 n,); braked joints do not move."""
        state = np.zeros(2 * self.n)
        for part, name, value in zip(np.split(state, 2), ('q', 'qd'), (q, qd), strict=True):
            if value is not None:
                part[:] = real_array(name, value, shape=(self.n,))
        if self._free is not None:
            state[self.n :][self._free == 0] = 0.0
        return state

    def __call__(self, time: float, state: Array) -> Array:
        """Return the slope at a state, (2 n,); NaN where the state or the torque is not finite."""
        slope = np.full(2 * self.n, np.nan)
        if not np.isfinite(state).all():
            return slope
        q, qd = state[: self.n], state[self.n :]
        tau = self._torque(time, q, qd)
        if not np.isfinite(tau).all():
            return slope
        self.evaluations += 1
        slope[: self.n] = qd
        slope[self.n :] = self._kernel(q, qd, tau)
        return slope


def _constant_law(tau: ArrayLike, n: int) -> Callable[[float, Array, Array], Array]:
    fixed = real_array('tau', tau, shape=(n,)).copy()
    return lambda time, q, qd: fixed


def _checked_law(tau: TorqueLaw, n: int) -> Callable[[float, Array, Array], Array]:
    def law(time: float, q: Array, qd: Array) -> Array:
        # Copies: the caller's function may keep or change its arguments.
        found = tau(time, q.copy(), qd.copy())
        return real_array('tau(t, q, qd)', found, shape=(n,), finite=False)

    return law


def _above_zero(name: str, value: float, finite: bool = True) -> float:
    number = real_number(name, value, finite=finite)
    if not number > 0:
        raise ValueError(f'{name} must be above zero, got {number}')
    return number
