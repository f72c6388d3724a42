# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors at the hard cases: of the kernel of method 'auto', of every method, and of peers.

Programs run on the emulator, which gives the bits of a kernel. Sine and cosine are written out in
elementary operations, so the errors are the same on every machine.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.convergence import with_nan_unless_converged
from pfd_core.algorithms.programs import ITERATIVE, METHODS, TOLERANCES
from pfd_core.algorithms.refinement import record_refined
from pfd_core.kernels.auto import default
from pfd_core.kernels.passes.pipeline import lower
from pfd_core.kernels.passes.sincos import expand_sines
from pfd_core.machine.emulator import run
from pfd_core.machine.program import Program
from pfd_core.model import Plant
from pfd_core.report.cases.hard_cases import ROUNDING, Case
from pfd_core.report.cases.problems import Problem, drawing
from pfd_core.report.cases.robots import Array
from pfd_core.report.contenders.mujoco import MUJOCO, Mujoco
from pfd_core.report.contenders.pinocchio import EVALUATIONS, Pinocchio
from pfd_core.report.contenders.work import LeftOutError
from pfd_core.report.measure import predictions
from pfd_core.report.measure.estimates import Estimated, errors_before, estimated
from pfd_core.report.measure.reference import (
    Reference,
    States,
    errors,
    kappa_j,
    kappa_s,
    reference,
)

# Seed of states on which no number of pfd_core was chosen, and how many of them.
HELD_OUT, HELD_OUT_STATES = 20261125, 4
# The most joints of a chain with held-out states: a state of a longer one takes a minute.
LONGEST_HELD_OUT = 60
# Methods for chains of more than FEW joints, and their largest number of joints. Other methods
# take minutes to record.
FEW = 12
MANY = {'composite_body': 40, 'grouped_articulated_body': 200, 'articulated_body': 40}
# What peer_answers yields where all peers are installed.
PEERS = (*EVALUATIONS, MUJOCO)


@dataclass(frozen=True)
class KernelRow:
    """
    The kernel of method 'auto' at a case.

    Attributes
    ----------
    dtype, refine, method : str, int, str
        Number format, requested steps of refinement, and the method that 'auto' selects, with
        ', refined' if it adds a step.
    error, in_units : float
        Largest error, and largest error over kappa_s u.
    predicted : float or None
        Largest predicted error over the states (predictions.predicted); None without a bound,
        where FACTOR times the predicted error of a state is 1 or more.
    share : float or None
        Largest error over its bound, predictions.FACTOR times the predicted error.
    met : bool or None
        Whether the bound is met, and the bits of the twin, if the case has one, are the same.
    before : float or None
        Largest error of the answer that refinement corrects, in the norm of the estimate.
    estimate : float or None
        Error estimate over that error, in the same state.

    """

    dtype: str
    refine: int
    method: str
    error: float
    in_units: float
    predicted: float | None
    share: float | None
    met: bool | None
    before: float | None = None
    estimate: float | None = None


@dataclass(frozen=True)
class MethodRow:
    """Largest error over the states of a case, by a method of ours as recorded, or by a peer."""

    way: str
    dtype: str
    refine: int
    error: float


@dataclass(frozen=True)
class CaseFacts:
    """A case with its condition numbers and the certificate of its reference."""

    name: str
    cause: str
    n: int
    states: int
    kappa_j: float
    kappa_s: float
    difference: float
    residual: float


def facts_of(
    case: Case, problem: Problem, known: Reference, conditions: tuple[Array, Array]
) -> dict[str, Any]:
    """Return the fields of CaseFacts; conditions are kappa_s and kappa_j."""
    return {
        'name': case.name,
        'cause': case.cause,
        'n': problem.plant.robot.n,
        'states': len(known.qdd),
        'kappa_j': float(conditions[1].max()),
        'kappa_s': float(conditions[0].max()),
        'difference': known.difference,
        'residual': known.residual,
    }


@dataclass(frozen=True)
class Result(CaseFacts):
    """Everything measured at a case; `held_out` are rows at states of the seed HELD_OUT."""

    kernels: tuple[KernelRow, ...]
    methods: tuple[MethodRow, ...]
    held_out: tuple[KernelRow, ...] = ()


def kernel_answer(problem: Problem, dtype: str, refine: int, method: str = 'auto') -> NDArray[Any]:
    """Return qdd (S, n), with the bits of the kernel."""
    method, refine = default(problem.plant, method, refine)
    program = lower(_record(problem.plant, method, refine, dtype), dtype, ['qdd']).compiled
    qdd: NDArray[Any] = _run(program, problem.states, dtype)['qdd']
    return qdd


def methods(n: int) -> tuple[str, ...]:
    """Return the methods that are measured on chains of n joints."""
    return tuple(name for name in METHODS if n <= (FEW if n <= FEW else MANY.get(name, 0)))


def _answer(recorded: Program, problem: Problem, dtype: str) -> NDArray[Any]:
    qdd: NDArray[Any] = _run(expand_sines(recorded, dtype), problem.states, dtype)['qdd']
    return qdd


def _record(plant: Plant, method: str, refine: int, dtype: str) -> Program:
    recorded = record_refined(plant, method, refine, TOLERANCES[dtype], None)
    # As in a kernel: an answer that has not converged is NaN.
    return with_nan_unless_converged(recorded, plant)


def _run(program: Program, states: States, dtype: str) -> dict[str, Any]:
    # A lost answer divides by zero and overflows: its error is infinite.
    with np.errstate(all='ignore'):
        return run(program, states, dtype)


def peer_answers(problem: Problem) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield qdd (S, n) by each peer, except a missing one and one that refuses the problem."""
    if 'wrench' in problem.states:
        return
    states = list(zip(*(problem.states[name] for name in ('q', 'qd', 'tau')), strict=True))
    for peer in (Pinocchio, Mujoco):
        try:
            answers = peer(problem.plant.robot).answers(problem.plant)
            found = {
                name: np.array([np.array(answer(*state)) for state in states])
                for name, answer in answers.items()
            }
        except (LeftOutError, ValueError, RuntimeError):
            continue
        yield from found.items()


def measure(case: Case) -> Result:
    """Return everything measured at a case: seconds for six joints, minutes for 200."""
    problem = case.make()
    known, n = reference(problem), problem.plant.robot.n
    conditions = kappa_s(problem, known), kappa_j(problem)
    others = [row for name in methods(n) for row in _method_rows(problem, known, name)]
    others += [
        MethodRow(name, 'float64', 0, worst(found, known)) for name, found in peer_answers(problem)
    ]
    return Result(
        **facts_of(case, problem, known, conditions),
        kernels=tuple(kernel_rows(problem, known, conditions)),
        methods=tuple(others),
        held_out=held_out(case),
    )


def _method_rows(problem: Problem, known: Reference, method: str) -> Iterator[MethodRow]:
    recorded: dict[object, Program] = {}
    for dtype in ROUNDING:
        for refine in (0, 1):
            # Of the number format, a recording has the tolerance at which iterations stop.
            key = refine, method in ITERATIVE and dtype
            if key not in recorded:
                recorded[key] = _record(problem.plant, method, refine, dtype)
            qdd = _answer(recorded[key], problem, dtype)
            yield MethodRow(method, dtype, refine, worst(qdd, known))


def held_out(case: Case) -> tuple[KernelRow, ...]:
    """Return the refined kernel's rows at HELD_OUT_STATES; one of a long chain, or none."""
    n = case.make().plant.robot.n
    if n > LONGEST_HELD_OUT:
        return ()
    with drawing(HELD_OUT, HELD_OUT_STATES if n <= FEW else 1):
        problem = case.make()
        known = reference(problem, certified=False)
        conditions = kappa_s(problem, known), kappa_j(problem)
        return tuple(kernel_row(problem, known, conditions, dtype, 1) for dtype in ROUNDING)


def worst(found: NDArray[Any], known: Reference) -> float:
    """Return the largest error over the states."""
    return float(errors(found, known).max())


def kernel_rows(
    problem: Problem, known: Reference, conditions: tuple[Array, Array]
) -> Iterator[KernelRow]:
    """Yield the kernel's errors in both number formats; conditions are kappa_s and kappa_j."""
    plain, refined = (default(problem.plant, 'auto', refine) for refine in (0, 1))
    for dtype in ROUNDING:
        row = kernel_row(problem, known, conditions, dtype, 1)
        if plain == refined and problem.twin is None:
            method = f'{row.method}, refined'
            yield replace(row, refine=0, method=method, before=None, estimate=None)
        else:
            yield kernel_row(problem, known, conditions, dtype, 0)
        yield row


def kernel_row(
    problem: Problem,
    known: Reference,
    conditions: tuple[Array, Array],
    dtype: str,
    refine: int,
) -> KernelRow:
    """Return the kernel's errors in a number format, without or with refinement."""
    method, steps = default(problem.plant, 'auto', refine)
    found = estimated(problem, dtype) if steps else None
    qdd = kernel_answer(problem, dtype, refine)
    error = errors(qdd, known)
    bounds = predictions.FACTOR * predicted_errors(known, conditions, dtype, found)
    bounded = bool((bounds < 1).all())
    share = float(np.max(error / bounds)) if bounded else None
    met = None if share is None else share <= 1
    if problem.twin is not None and refine:
        met = met is not False and bool(
            (kernel_answer(problem.twin(), dtype, refine) == qdd).all()
        )
    return KernelRow(
        dtype,
        refine,
        method + ', refined' * (steps > refine),
        float(error.max()),
        float(np.max(error / conditions[0]) / ROUNDING[dtype]),
        float(np.max(bounds)) / predictions.FACTOR if bounded else None,
        share,
        met,
        *(_estimate(found, known) if found and refine else ()),
    )


def predicted_errors(
    known: Reference, conditions: tuple[Array, Array], dtype: str, found: Estimated | None
) -> Array:
    """Return the predicted error of each state, (S,), of a refined kernel if `found`."""
    if found is None:
        return predictions.predicted(dtype, *conditions)
    # An estimate is relative to the answer, which is nearly zero for an arm in equilibrium.
    norms = ((known.qdd * known.qdd).sum(axis=-1) ** 0.5 / known.scale).astype(np.float64)
    return predictions.predicted(dtype, *conditions, found.estimates * norms)


def _estimate(found: Estimated, known: Reference) -> tuple[float, float | None]:
    """Return the largest error before the step, and the ratio of its estimate and it."""
    before = errors_before(found, known.qdd)
    k = int(np.argmax(before))
    sound = 0 < before[k] < np.inf and np.isfinite(found.estimates[k])
    return float(before[k]), float(found.estimates[k] / before[k]) if sound else None
