# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Error estimates of refined kernels compared with the errors that they estimate, over random states.

An estimate applies to the answer before the step of refinement. The refined program itself has
that answer as an output, since a kernel without refinement rounds differently. Estimate and error
are compared where the error is above SHOWN; below, both are rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.grouped.inverse_dynamics import record_bias_torques
from pfd_core.algorithms.programs import TOLERANCES, record_forward_dynamics
from pfd_core.algorithms.refinement import record_refined
from pfd_core.kernels.auto import choose
from pfd_core.kernels.passes.pipeline import lower
from pfd_core.machine.emulator import run
from pfd_core.machine.program import Output, Program
from pfd_core.model import Plant, load_robot
from pfd_core.report.cases.problems import SEED, Problem, heavy_tip, payload, problem, rods
from pfd_core.report.cases.robots import Array
from pfd_core.report.measure.decimals import on_mpmath_numbers
from pfd_core.report.measure.differences import differences
from pfd_core.report.measure.reference import DIGITS

STATES = 500
# Target: estimates within FACTOR of errors above SHOWN.
FACTOR, SHOWN = 3.0, 1e-13


@dataclass(frozen=True)
class Estimated:
    """
    Error estimates of a refined kernel.

    Attributes
    ----------
    before : ndarray
        (S, n), the answer that the step corrects.
    estimates : ndarray
        Estimated relative error of `before`, max |delta| / max |qdd|.

    """

    before: NDArray[Any]
    estimates: Array


@dataclass(frozen=True)
class Row:
    """
    Estimates of one method on one robot.

    Attributes
    ----------
    robot, method : str
        Name in ROBOTS, and the method.
    states, shown : int
        Random states, and how many of them have an error above SHOWN.
    largest : float
        Largest error.
    least, most : float or None
        Smallest and largest ratio of estimate and error, where shown.
    alarm : float
        Largest estimate where the error is not above SHOWN.

    """

    robot: str
    method: str
    states: int
    shown: int
    largest: float
    least: float | None
    most: float | None
    alarm: float


def _drawn(make: Callable[[], Problem]) -> Callable[[int], Problem]:
    """Return a function that draws more states of a problem's plant, of the same reach."""

    def more(states: int) -> Problem:
        plant = make().plant
        found = problem(plant.robot, states=states)
        return replace(found, plant=plant)

    return more


def near_equilibrium(name: str, states: int) -> Problem:
    """Return states of an included arm; tau differs from the bias by a part of 1e-14 to 0.1."""
    found = problem(load_robot(name), states=states)
    bias = run(record_bias_torques(found.plant), found.states, 'float64')['bias']
    share = 10.0 ** -np.random.default_rng(SEED).integers(1, 15, (states, 1))
    return replace(found, states=found.states | {'tau': bias * (1.0 + share)})


def _any_state(name: str, states: int) -> Problem:
    return problem(load_robot(name), states=states)


ARMS = ('puma560', 'ur5', 'panda')
# Robots, each with a function of the number of states.
ROBOTS: dict[str, Callable[[int], Problem]] = {
    **{name: partial(_any_state, name) for name in ARMS},
    **{f'{name}, near equilibrium': partial(near_equilibrium, name) for name in ARMS},
    'panda, payload 1e6': _drawn(payload),
    'chain of 12': lambda states: rods(12, 'yz', states=states),
    'planar chain of 12': lambda states: rods(12, 'y', states=states),
    'planar chain of 12, near-stretched': lambda states: rods(12, 'y', q=1e-2, states=states),
    'heavy tip 1e8, n = 6': _drawn(partial(heavy_tip, 6, 'yz')),
    'heavy tip 1e8, planar, n = 6': _drawn(partial(heavy_tip, 6, 'y')),
}
METHODS = ('composite_body', 'grouped_articulated_body', 'articulated_body')


def record_with_first_answer(plant: Plant, method: str, dtype: str = 'float64') -> Program:
    """Return the refined program with one more output: `before`, the answer that it corrects."""
    program = record_refined(plant, method, 1, TOLERANCES[dtype], dtype)
    corrected = [program.instructions[register] for register, _ in program.outputs['qdd'].places]
    before = Output((plant.robot.n,), tuple((c.args[0], 0) for c in corrected))
    return replace(program, outputs={**program.outputs, 'before': before})


def estimated(problem: Problem, dtype: str, method: str = 'auto') -> Estimated:
    """
    Return error estimates of the refined kernel.

    A separate program computes them, as in `Kernel.error_estimate`.
    """
    method = choose(problem.plant, method, 1)
    recorded = record_with_first_answer(problem.plant, method, dtype)
    program = lower(recorded, dtype, ['error', 'before']).compiled
    # A lost answer divides by zero and overflows: its error is infinite.
    with np.errstate(all='ignore'):
        result = run(program, problem.states, dtype)
    return Estimated(result['before'], result['error'][:, 0].astype(np.float64))


def errors_before(found: Estimated, exact: NDArray[Any]) -> Array:
    """Return the error before refinement, (S,), which is estimated; infinity if not finite."""
    sound = np.isfinite(found.before).all(axis=-1)
    error = differences(np.where(sound[:, None], found.before, 0.0), exact)
    return np.where(sound, error.astype(np.float64), np.inf)


def row(robot: str, method: str, states: int = STATES) -> Row:
    """Return the estimates of a method on a robot of ROBOTS, in float64."""
    drawn = ROBOTS[robot](states)
    exact = _exact(robot, 'pcrbm' if method == 'articulated_body' else 'articulated_body', states)
    found = estimated(drawn, 'float64', method)
    errors = errors_before(found, exact)
    shown = errors > SHOWN
    ratios = found.estimates[shown] / errors[shown]
    return Row(
        robot,
        method,
        states,
        int(shown.sum()),
        float(errors.max()),
        float(np.min(ratios)) if shown.any() else None,
        float(np.max(ratios)) if shown.any() else None,
        float(found.estimates[~shown].max(initial=0.0)),
    )


@lru_cache(maxsize=2)  # of the present robot
def _exact(robot: str, method: str, states: int) -> NDArray[Any]:
    """Return qdd in DIGITS of the states of a robot by a method, (states, n)."""
    import mpmath

    drawn = ROBOTS[robot](states)
    program = record_forward_dynamics(drawn.plant, method, 'sequential')
    with mpmath.workdps(DIGITS):
        qdd: NDArray[Any] = on_mpmath_numbers(program, 'qdd')(drawn.states)
    return qdd


def rows() -> Iterator[Row]:
    """Yield a row for every robot and method."""
    for robot in ROBOTS:
        for method in METHODS:
            yield row(robot, method)


def misses(found: Sequence[Row]) -> list[Row]:
    """Return the rows with an estimate that differs from its error by more than FACTOR."""
    return [
        one
        for one in found
        if one.least is not None
        and one.most is not None
        and not (1 / FACTOR <= one.least <= one.most <= FACTOR)
    ]
