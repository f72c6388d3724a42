# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Iterations of PCGM to a given error of qdd, from cold and warm starts, scaled and not.

The error of an iterate is max|x - qdd| / max|qdd|, qdd by PCRBM. The recursive residual does not
measure it. Every iterate of STATES states is observed while the emulator runs the counted program.
Sine and cosine are expanded into other operations, so that iterations are the same on every
machine.

    plain       the paper's: x_0 = 0, no preconditioner
    scaled      residuals divided by the diagonal of H, which composite bodies give (Jacobi)
    warm        x_0 is qdd one cycle of CYCLE earlier, at q - qd CYCLE, qd - qdd CYCLE, same torque
    both        scaled, from the warm start
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from pfd_core.algorithms.emulation import in_sections
from pfd_core.algorithms.paper.pcgm import default_limit, record_pcgm
from pfd_core.algorithms.paper.pcrbm_1987 import record_pcrbm_1987
from pfd_core.algorithms.programs import FORWARD
from pfd_core.kernels.passes.sincos import expand_sines
from pfd_core.machine.emulator import run
from pfd_core.machine.program import Program, Steps
from pfd_core.model import resolve
from pfd_core.report.cases.problems import seeded_states
from pfd_core.report.cases.robots import Array, uniform_chain
from pfd_core.report.measure.counts import CORRECTED, GIVEN, row
from pfd_core.report.measure.differences import differences

SIZES = (2, 3, 4, 5, 6, 8, 12, 16, 24, 32, 48, 64)
STATES = 100
TOLERANCES = (1e-3, 1e-6, 1e-9)
CYCLE = 1e-3  # [s]


class Variant(NamedTuple):
    """Whether residuals are scaled by the diagonal of H, and whether the start is warm."""

    scaled: bool = False
    warm: bool = False


VARIANTS = {
    'plain': Variant(),
    'scaled': Variant(scaled=True),
    'warm': Variant(warm=True),
    'both': Variant(scaled=True, warm=True),
}


@dataclass(frozen=True)
class Reached:
    """
    Iterations of a variant at one n until the error of qdd is within a tolerance.

    Attributes
    ----------
    n, variant, tolerance : int, str, float
        Joints, name in VARIANTS, largest error.
    states, missed : int
        States, and states that did not reach the tolerance within `limit` iterations.
    median, worst : int
        Iterations; the median is the lower one. `limit` where a state did not reach it.
    limit : int
        Largest number of iterations.
    within_n : float
        Share of states that reached it after at most n iterations.
    error_after_n, worst_after_n : float
        Median and largest error after n iterations.

    """

    n: int
    variant: str
    tolerance: float
    states: int
    missed: int
    median: int
    worst: int
    limit: int
    within_n: float
    error_after_n: float
    worst_after_n: float


@dataclass(frozen=True)
class Price:
    """
    Steps of a variant of PCGM with one lane per link, rotations of the joints given.

    Attributes
    ----------
    n, variant : int, str
        Joints, name in VARIANTS.
    first, each : Steps
        Before the loop, and in each iteration.

    """

    n: int
    variant: str
    first: Steps
    each: Steps

    def total(self, iterations: int) -> Steps:
        """Return the steps of some iterations."""
        return sum([self.each] * iterations, self.first)


@dataclass(frozen=True)
class Study:
    """
    Iterations and their cost.

    Attributes
    ----------
    iterations : list of Reached
        By n, variant and tolerance.
    prices : list of Price
        By n and variant.
    pcrbm : dict
        Joints to the steps of `pcrbm_1987`, for comparison; as in a Price.

    """

    iterations: list[Reached]
    prices: list[Price]
    pcrbm: dict[int, Steps]


def study(n: int) -> Study:
    """Measure one n."""
    prices = [price(n, variant) for variant in VARIANTS]
    return Study(list(measure_iterations(n)), prices, {n: direct(n)})


def joined(studies: Iterable[Study]) -> Study:
    """Return some studies as one."""
    whole = Study([], [], {})
    for one in studies:
        whole.iterations.extend(one.iterations)
        whole.prices.extend(one.prices)
        whole.pcrbm.update(one.pcrbm)
    return whole


def measure_iterations(n: int) -> Iterator[Reached]:
    """Yield every variant at an n and every tolerance."""
    states = seeded_states(n, STATES)
    for variant in VARIANTS:
        yield from _reached(n, variant, errors_of_iterates(n, variant, states))


def errors_of_iterates(n: int, variant: str, states: dict[str, Array]) -> Array:
    """
    Return the errors of x_0, x_1, ... of each state, (iterations + 1, states).

    `states` holds q, qd and tau, (states, n); after its last iteration a state keeps its error.
    """
    plant = resolve(uniform_chain(n))
    direct = expand_sines(FORWARD['pcrbm'](plant, 'parallel'), 'float64')
    wanted = run(direct, states)['qdd']
    inputs = dict(states)
    if VARIANTS[variant].warm:
        before = {'q': -CYCLE * states['qd'], 'qd': -CYCLE * wanted, 'tau': 0.0}
        inputs['start'] = run(direct, {key: states[key] + before[key] for key in before})['qdd']
    errors: list[Array] = []

    def observe(rows: list[Any]) -> None:
        # Rows are (lanes, states), x first.
        errors.append(differences(np.broadcast_to(rows[0], wanted.T.shape).T, wanted))

    run(expand_sines(_program(n, variant), 'float64'), inputs, observe=observe)
    return np.array(errors)


def _program(n: int, variant: str) -> Program:
    plant, chosen = resolve(uniform_chain(n)), VARIANTS[variant]
    # With one lane per link, as in the paper.
    return record_pcgm(plant, 'unpacked', start=chosen.warm, jacobi=chosen.scaled)


def _reached(n: int, variant: str, errors: Array) -> Iterator[Reached]:
    limit = default_limit(n)
    after_n = errors[min(n, len(errors) - 1)]
    for tolerance in TOLERANCES:
        inside = errors <= tolerance
        missed = ~inside.any(axis=0)
        first = np.sort(np.where(missed, limit, inside.argmax(axis=0)))
        yield Reached(
            n=n,
            variant=variant,
            tolerance=tolerance,
            states=errors.shape[1],
            missed=int(missed.sum()),
            median=int(first[(len(first) - 1) // 2]),
            worst=int(first[-1]),
            limit=limit,
            within_n=float(np.mean(inside[: n + 1].any(axis=0))),
            error_after_n=float(np.sort(after_n)[(len(after_n) - 1) // 2]),
            worst_after_n=float(after_n.max()),
        )


def price(n: int, variant: str) -> Price:
    """Return the steps of a variant: `pcgm_1987`, and what the variant adds to it."""
    once, twice = (row('pcgm', n, k, CORRECTED).unpacked for k in (1, 2))
    each = twice - once
    first = once - each
    if variant != 'plain':
        # The same sections in both, so that the rotations of the joints cancel.
        plain, changed = (_program(n, name) for name in ('plain', variant))
        more = [changed.count(iterations=k) - plain.count(iterations=k) for k in (1, 2)]
        each += more[1] - more[0]
        first += more[0] - (more[1] - more[0])
    return Price(n, variant, first, each)


def direct(n: int) -> Steps:
    """Return the steps of `pcrbm_1987` with one lane per link, rotations of the joints given."""
    program = record_pcrbm_1987(resolve(uniform_chain(n)), 'unpacked')
    return program.count() - in_sections(program, GIVEN)
