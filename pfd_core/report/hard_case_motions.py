# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Motions without acceleration, as one table (STEADY): q(t) = q(0) + qd t in closed form.

An arm that friction holds must not creep, and a wheel that turns for an hour must end at its
angle although the digits of q are taken by the turns. No motor acts. The error is the largest
difference of an angle from q(0) + qd t, modulo whole turns, at SAMPLES times of the motion [rad].
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from pfd_core.algorithms.programs import record_inverse_dynamics
from pfd_core.machine.emulator import run
from pfd_core.model import Robot, Scene, load_robot, resolve
from pfd_core.report.hard_case_problems import Array, chain
from pfd_core.report.hard_cases import ROUNDING
from pfd_core.simulation.simulator import Simulator

SAMPLES = 100
STEP = 1e-3
# Part of its friction that gravity takes at each joint of the arm in equilibrium.
HELD = 0.95
# Friction of the joints that gravity hardly loads [N m].
LEAST_FRICTION = 0.1


@dataclass(frozen=True)
class SteadyMotion:
    """
    A motion without acceleration.

    Attributes
    ----------
    name, cause : str
        Name, and the reason why the motion is hard.
    make : callable
        Returns the robot, its scene, and q and qd at the start, (n,) each.
    duration : float
        Time of the motion [s].
    bounds : dict
        Number format to the largest error allowed [rad].

    """

    name: str
    cause: str
    make: Callable[[], tuple[Robot, Scene, Array, Array]] = field(repr=False)
    duration: float
    bounds: dict[str, float]


@dataclass(frozen=True)
class SteadyRun:
    """The error of a motion in a number format [rad], and its bound."""

    name: str
    cause: str
    dtype: str
    duration: float
    error: float
    bound: float

    @property
    def met(self) -> bool:
        """Whether the error is within its bound."""
        return self.error <= self.bound


def _held() -> tuple[Robot, Scene, Array, Array]:
    """Return UR5 at rest, under friction of which gravity needs the part HELD."""
    robot = load_robot('ur5')
    q = np.array([0.3, -0.8, 1.1, 0.4, -0.6, 0.2])
    zero = np.zeros((1, robot.n))
    states = {'q': q[np.newaxis], 'qd': zero, 'qdd': zero}
    needed = run(record_inverse_dynamics(resolve(robot), 'parallel'), states)['tau'][0]
    friction = np.maximum(np.abs(needed) / HELD, LEAST_FRICTION)
    return robot, Scene(friction=friction), q, np.zeros(robot.n)


def _spinning() -> tuple[Robot, Scene, Array, Array]:
    """Return a rod that turns at 10 rad/s without gravity."""
    return chain(1, 'y'), Scene(gravity=None), np.zeros(1), np.array([10.0])


# The bounds were set before the motions were measured.
STEADY: Sequence[SteadyMotion] = (
    SteadyMotion(
        'stiction_hold',
        'friction as a steep slope, or as a soft constraint, lets a loaded joint creep',
        _held,
        10.0,
        {'float64': 1e-12, 'float32': 1e-6},
    ),
    SteadyMotion(
        'one_hour_spin',
        'the turns take the digits of the angle, and h qd falls below the last one',
        _spinning,
        3600.0,
        {'float64': 1e-9, 'float32': 0.02},
    ),
)


def steady_runs() -> Iterator[SteadyRun]:
    """Yield the run of each motion in each number format."""
    for motion in STEADY:
        for dtype in ROUNDING:
            found, bound = error(motion, dtype), motion.bounds[dtype]
            yield SteadyRun(motion.name, motion.cause, dtype, motion.duration, found, bound)


def error(motion: SteadyMotion, dtype: str) -> float:
    """Return the error of a motion in a number format; infinity if a state is not finite."""
    import mpmath

    robot, scene, q, qd = motion.make()
    simulator = Simulator(robot, scene, step_size=STEP, substeps=1, dtype=dtype)
    simulator.reset(q, qd)
    begin = simulator.q.astype(np.float64)
    taus = np.zeros((round(motion.duration / STEP / SAMPLES), robot.n))
    largest = 0.0
    for k in range(SAMPLES):
        if simulator.rollout(taus).status != 'ok':
            return np.inf
        passed = motion.duration * (k + 1) / SAMPLES
        with mpmath.workdps(30):
            for angle, turns, at, rate in zip(*simulator.wrapped, begin, qd, strict=True):
                wanted = at + rate * mpmath.mpf(passed) - 2 * mpmath.pi * int(turns)
                largest = max(largest, float(abs(wanted - float(angle))))
    return largest
