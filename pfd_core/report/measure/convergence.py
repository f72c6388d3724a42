# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Iterations of conjugate gradients to converge in double precision, and the error after n of them.

The paper counts n iterations, which exact arithmetic needs at most. Here a state has converged
when its recursive residual has fallen to the first one times TOLERANCE of
pfd_core.algorithms.paper.pcgm, which is rounding. An error is max|difference| / max|reference| of
qdd, the reference being PCRBM's answer.

The programs run on the emulator with sine and cosine expanded into the other operations, so that
iterations and errors are the same on every machine.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from pfd_core.algorithms.programs import FORWARD, ITERATIVE
from pfd_core.kernels.passes.sincos import expand_sines
from pfd_core.machine.emulator import run
from pfd_core.machine.program import Program
from pfd_core.model import Robot, load_robot, resolve
from pfd_core.report.cases.problems import seeded_states
from pfd_core.report.cases.robots import Array, uniform_chain
from pfd_core.report.measure.differences import differences

CHAINS = (2, 3, 4, 5, 6, 8, 12, 16, 24)
ARMS = ('puma560', 'ur5', 'panda')
STATES = 1000


@dataclass(frozen=True)
class Convergence:
    """
    The iterations of an iterative method over many states of one robot.

    Attributes
    ----------
    system, robot : str
        Method and robot.
    n, states : int
        Joints, and number of states.
    least, median, most : int
        Iterations until the residual has fallen to rounding; the median is the lower one.
    error_after_n, worst_after_n : float
        Median and largest relative error of qdd after n iterations.
    worst_converged : float
        Largest relative error at the end.

    """

    system: str
    robot: str
    n: int
    states: int
    least: int
    median: int
    most: int
    error_after_n: float
    worst_after_n: float
    worst_converged: float


def robots(sizes: Iterable[int] = CHAINS, arms: Iterable[str] = ARMS) -> Iterator[Robot]:
    """Yield chains of equal links, and arms by name."""
    yield from map(uniform_chain, sizes)
    yield from map(load_robot, arms)


def measure_convergence(robot: Robot) -> list[Convergence]:
    """Return the iterations of both iterative methods for a robot."""
    return [convergence(method, robot) for method in ITERATIVE]


def convergence(method: str, robot: Robot) -> Convergence:
    """Return the iterations of one method over STATES states; RuntimeError if one fails."""
    plant, n = resolve(robot), robot.n
    state = seeded_states(n, STATES)

    def answer(program: Program) -> dict[str, Array]:
        return run(expand_sines(program, 'float64'), state)

    wanted = answer(FORWARD['pcrbm'](plant, 'parallel'))['qdd']
    whole = answer(FORWARD[method](plant, 'parallel'))
    if not (whole['converged'] > 0).all():
        raise RuntimeError(f'{method} did not converge in some state of {robot.name}')
    after_n = differences(answer(FORWARD[method](plant, 'parallel', at_most=n))['qdd'], wanted)
    iterations = np.sort(whole['iterations'].ravel()).astype(int)
    return Convergence(
        system=method,
        robot=robot.name,
        n=n,
        states=STATES,
        least=int(iterations[0]),
        median=int(iterations[(STATES - 1) // 2]),
        most=int(iterations[-1]),
        error_after_n=float(np.sort(after_n)[(STATES - 1) // 2]),
        worst_after_n=float(after_n.max()),
        worst_converged=float(differences(whole['qdd'], wanted).max()),
    )
