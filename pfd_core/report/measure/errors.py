# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors at the hard cases: of the kernel of method 'auto', of every method, and of peers.

Programs run on the emulator, which gives the bits of a kernel; sine and cosine are written out in
other operations, so that the errors are the same on every machine.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.convergence import with_nan_unless_converged
from pfd_core.algorithms.programs import METHODS, TOLERANCES
from pfd_core.algorithms.refinement import record_refined
from pfd_core.kernels.auto import default
from pfd_core.kernels.passes.pipeline import lower
from pfd_core.kernels.passes.sincos import expand_sines
from pfd_core.machine.emulator import run
from pfd_core.machine.program import Program
from pfd_core.model import Plant
from pfd_core.report.cases.hard_cases import ROUNDING, Case
from pfd_core.report.cases.problems import Problem
from pfd_core.report.cases.robots import Array
from pfd_core.report.contenders.mujoco import MUJOCO, Mujoco
from pfd_core.report.contenders.pinocchio import EVALUATIONS, Pinocchio
from pfd_core.report.contenders.work import LeftOutError
from pfd_core.report.measure.estimates import errors_before, estimated
from pfd_core.report.measure.reference import (
    Reference,
    States,
    errors,
    kappa_j,
    kappa_s,
    reference,
)

# Methods for chains of more than FEW joints, with the most joints: others take minutes to record.
FEW = 12
MANY = {'composite_body': 40, 'grouped_articulated_body': 200, 'articulated_body': 40}
SAME_BITS = 'the bits of its twin'
# What peer_answers yields where all peers are installed.
PEERS = (*EVALUATIONS, MUJOCO)


@dataclass(frozen=True)
class KernelRow:
    """
    The kernel of method 'auto' at a case.

    Attributes
    ----------
    dtype, refine, method : str, int, str
        Number format, steps of refinement that were asked for, and the method that 'auto'
        selects, with ', refined' if it adds a step.
    error, in_units : float
        Largest error, and largest error over kappa_s u.
    bound : str or None
        The bound of the case as a string, if any.
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
    bound: str | None
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
class Result:
    """Everything measured at a case."""

    name: str
    cause: str
    n: int
    states: int
    kappa_j: float
    kappa_s: float
    difference: float
    residual: float
    kernels: tuple[KernelRow, ...]
    methods: tuple[MethodRow, ...]


def kernel_answer(problem: Problem, dtype: str, refine: int, method: str = 'auto') -> NDArray[Any]:
    """Return qdd (S, n), with the bits of the kernel."""
    method, refine = default(problem.plant, method, refine)
    program = lower(_record(problem.plant, method, refine, dtype), dtype, ['qdd']).compiled
    qdd: NDArray[Any] = _run(program, problem.states, dtype)['qdd']
    return qdd


def methods(n: int) -> tuple[str, ...]:
    """Return the methods that are measured on chains of n joints."""
    return tuple(name for name in METHODS if n <= (FEW if n <= FEW else MANY.get(name, 0)))


def method_answer(problem: Problem, method: str, dtype: str, refine: int) -> NDArray[Any]:
    """Return qdd (S, n) by the program of a method as recorded, before it is folded and fused."""
    recorded = _record(problem.plant, method, refine, dtype)
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
    """Yield qdd (S, n) by each peer, except a missing one and one that refuses the robot."""
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
    condition = kappa_s(problem, known)
    others = [
        MethodRow(name, dtype, refine, worst(method_answer(problem, name, dtype, refine), known))
        for name in methods(n)
        for dtype in ROUNDING
        for refine in (0, 1)
    ]
    others += [
        MethodRow(name, 'float64', 0, worst(found, known)) for name, found in peer_answers(problem)
    ]
    return Result(
        name=case.name,
        cause=case.cause,
        n=n,
        states=len(known.qdd),
        kappa_j=kappa_j(problem),
        kappa_s=float(condition.max()),
        difference=known.difference,
        residual=known.residual,
        kernels=tuple(kernel_rows(case, problem, known, condition)),
        methods=tuple(others),
    )


def worst(found: NDArray[Any], known: Reference) -> float:
    """Return the largest error over the states."""
    return float(errors(found, known).max())


def kernel_rows(
    case: Case, problem: Problem, known: Reference, condition: Array
) -> Iterator[KernelRow]:
    """Yield the kernel's errors in both number formats, without and with refinement."""
    for dtype, u in ROUNDING.items():
        for refine in (0, 1):
            qdd, estimate = _kernel(problem, known, dtype, refine)
            found = errors(qdd, known)
            bound = case.bound(dtype, refine)
            text = None if bound is None else str(bound)
            met = None if bound is None else bool((found <= bound.at(dtype, condition)).all())
            if problem.twin is not None and refine:
                met = met is not False and bool(
                    (kernel_answer(problem.twin(), dtype, refine) == qdd).all()
                )
                text = SAME_BITS if text is None else f'{text}, {SAME_BITS}'
            method, steps = default(problem.plant, 'auto', refine)
            method += ', refined' * (steps > refine)
            in_units = float(np.max(found / condition) / u)
            yield KernelRow(
                dtype, refine, method, float(found.max()), in_units, text, met, *estimate
            )


def _kernel(
    problem: Problem, known: Reference, dtype: str, refine: int
) -> tuple[NDArray[Any], tuple[float, float | None] | tuple[()]]:
    """Return qdd and, refined, the largest error before with the ratio of estimate and error."""
    if not refine:
        return kernel_answer(problem, dtype, refine), ()
    found = estimated(problem, dtype)
    before = errors_before(found, known.qdd)
    k = int(np.argmax(before))
    sound = 0 < before[k] < np.inf and np.isfinite(found.estimates[k])
    ratio = float(found.estimates[k] / before[k]) if sound else None
    return found.qdd, (float(before[k]), ratio)
