# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors of derivatives of forward dynamics and of linearised steps, at the hard cases.

    q, qd, tau   of the kernel 'derivatives', emulated: the bits of native code
    A, B         of Simulator.linearize, one step of rk4, in native code

An error is |M - exact| / |exact| in the Frobenius norm, separately for each matrix. Velocities in
A and B are multiplied by the step.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.acceleration_derivatives import record_derivatives
from pfd_core.kernels.auto import default_of_derivatives
from pfd_core.kernels.passes.pipeline import lower
from pfd_core.kernels.passes.schedule import ORDERED
from pfd_core.machine.emulator import run
from pfd_core.machine.fused import fused
from pfd_core.machine.program import Program
from pfd_core.report.cases.hard_cases import ROUNDING, Case
from pfd_core.report.cases.problems import Problem, drawing, scene_of
from pfd_core.report.cases.quantities import STATE, linear_rk4
from pfd_core.report.cases.robots import Array
from pfd_core.report.contenders.pinocchio import Pinocchio, acceleration_and_derivatives
from pfd_core.report.contenders.work import LeftOutError
from pfd_core.report.measure import predictions
from pfd_core.report.measure.derivative_reference import (
    DERIVATIVES,
    STEPS,
    Exact,
    errors,
    exact,
    in_positions,
    step_length,
)
from pfd_core.report.measure.reference import Reference, kappa_j, kappa_s, reference
from pfd_core.simulation.simulator import Simulator

# Seed of a state on which no number of pfd_core was chosen.
HELD_OUT = 20261127
# The most joints: a reference of a longer chain takes many minutes.
LONGEST = 12
PEER = 'Pinocchio'
# Number format and steps of refinement of our kernels.
KERNELS = tuple((dtype, refine) for dtype in ROUNDING for refine in (0, 1))


@dataclass(frozen=True)
class Row:
    """
    A matrix of a case by one implementation.

    Attributes
    ----------
    matrix : str
        Name in derivative_reference.MATRICES.
    way : str
        'pfd' or PEER.
    dtype, refine : str, int
        Number format and steps of refinement.
    error, in_units : float
        Largest error over the states, and largest error over kappa_s u, with kappa_s at least 1.
    predicted : float or None
        Largest predicted error; None for a peer, and where the bound is 1 or more.
    share : float or None
        Largest error over its bound, predictions.FACTOR times the predicted error.
    met : bool or None
        Whether the bound is met.

    """

    matrix: str
    way: str
    dtype: str
    refine: int
    error: float
    in_units: float
    predicted: float | None = None
    share: float | None = None
    met: bool | None = None


@dataclass(frozen=True)
class Result:
    """
    The matrices of a case.

    Attributes
    ----------
    name : str
        Name of the case.
    n : int
        Joints.
    step : float
        Step of A and B [s].
    kappa_j, gain, share : float
        As in predictions.predicted_matrix.
    kappa_s : dict
        Matrix -> condition number.
    residual, difference : float
        Certificates of the reference.
    rows, held_out : tuple of Row
        At the first state of the case, and at a state of the seed HELD_OUT.

    """

    name: str
    n: int
    step: float
    kappa_j: float
    gain: float
    share: float
    kappa_s: dict[str, float]
    residual: float
    difference: float
    rows: tuple[Row, ...]
    held_out: tuple[Row, ...] = ()


@dataclass(frozen=True)
class Known:
    """A problem with its matrices, and kappa_J and kappa_s of its accelerations, (S,)."""

    problem: Problem
    exact: Exact
    kappa_j: Array
    kappa_s: Array


class Matrices:
    """Our matrices of a plant's states, in one number format, with steps of refinement."""

    def __init__(self, problem: Problem, dtype: str, refine: int, h: float | None) -> None:
        self.dtype, self.refine = dtype, refine
        plant = problem.plant
        recorded = record_derivatives(plant, *default_of_derivatives(plant, 'auto', refine), dtype)
        self._factors: Program = lower(recorded, dtype, longest=ORDERED).compiled
        self._h = h
        self._simulator: Simulator | None = None
        # Refinement hardly enters a step, which is short.
        if h is not None and not refine:
            scene = scene_of(plant)
            self._simulator = Simulator(
                plant.robot, scene, step_size=h, substeps=1, integrator='rk4', dtype=dtype
            )

    def of(self, states: dict[str, Array]) -> dict[str, NDArray[Any]]:
        """Return each matrix, (S, rows, columns)."""
        with np.errstate(all='ignore'):
            factors = run(self._factors, states, self.dtype)
            found = dict(zip(DERIVATIVES, _multiplied(factors), strict=True))
        if self._simulator is not None and self._h is not None:
            whole = in_positions(self._linearised(states).astype(np.float64), self._h)
            n = whole.shape[-1] // 3
            found |= {'A': whole[..., : 2 * n], 'B': whole[..., 2 * n :]}
        return found

    def _linearised(self, states: dict[str, Array]) -> NDArray[Any]:
        assert self._simulator is not None
        steps = []
        for k in range(len(states['q'])):
            state = {name: states[name][k] for name in states}
            steps.append(np.hstack(self._simulator.linearize(**state)))
        return np.array(steps)


def _multiplied(factors: dict[str, Any]) -> Iterator[NDArray[Any]]:
    """Yield d qdd / d (q, qd, tau) from X, D and T, with the roundings of native code."""
    X, D = factors['X'], factors['D']
    n = X.shape[-1]
    total = X[..., :1] * D[..., :1, :]
    for k in range(1, n):
        total = fused(*np.broadcast_arrays(X[..., k : k + 1], D[..., k : k + 1, :], total))
    yield -total[..., :n]
    yield -total[..., n:]
    yield X * factors['T'][..., None, :] if 'T' in factors else X


def measured(case: Case) -> bool:
    """Return whether the derivatives of a case are measured."""
    return case.make().plant.robot.n <= LONGEST


def measure(case: Case) -> Result:
    """Return the matrices of a case: ten seconds for six joints, a minute for twelve."""
    problem = _first(case.make())
    with drawing(HELD_OUT, 1):
        held = case.make()
    accelerations = [reference(one, certified=False) for one in (problem, held)]
    pairs = zip(accelerations, (problem, held), strict=True)
    h = min(step_length(reached, one.states) for reached, one in pairs)
    own = solved(problem, accelerations[0], h, certified=True)
    other = solved(held, accelerations[1], h)
    rows: list[Row] = []
    held_rows: list[Row] = []
    for dtype, refine in KERNELS:
        matrices = Matrices(problem, dtype, refine, h)
        rows += our_rows(own, matrices)
        held_rows += our_rows(other, matrices)
    rows += _peer_rows(own, h)
    held_rows += _peer_rows(other, h)
    return Result(
        name=case.name,
        n=problem.plant.robot.n,
        step=h,
        kappa_j=float(own.kappa_j.max()),
        gain=float(own.exact.gain.max()),
        share=float(own.exact.share.max()),
        kappa_s={name: float(x.max()) for name, x in own.exact.kappa_s.items()},
        residual=own.exact.residual,
        difference=own.exact.difference,
        rows=tuple(rows),
        held_out=tuple(held_rows),
    )


def solved(
    problem: Problem, accelerations: Reference, h: float | None, certified: bool = False
) -> Known:
    """Return the matrices of a problem and of a step of h seconds, which None leaves out."""
    return Known(
        problem,
        exact(problem, accelerations, h, certified),
        kappa_j(problem),
        kappa_s(problem, accelerations),
    )


def our_rows(known: Known, matrices: Matrices) -> Iterator[Row]:
    """Yield the row of each matrix of our kernels."""
    dtype, refine = matrices.dtype, matrices.refine
    for name, matrix in matrices.of(known.problem.states).items():
        error = errors(matrix, known.exact.matrices[name])
        bounds = predictions.FACTOR * predicted_errors(known, name, dtype, refine)
        bounded = bool((bounds < 1).all())
        share = float(np.max(error / bounds)) if bounded else None
        yield Row(
            name,
            'pfd',
            dtype,
            refine,
            *_largest(known, name, error, dtype),
            predicted=float(np.max(bounds)) / predictions.FACTOR if bounded else None,
            share=share,
            met=None if share is None else share <= 1,
        )


def predicted_errors(known: Known, name: str, dtype: str, refine: int) -> Array:
    """Return the predicted error of a matrix, (S,)."""
    u = ROUNDING[dtype]
    # The error of the first answer is not estimated: its predicted error replaces it.
    first = predictions.SPREAD * known.kappa_j * u if refine else None
    acceleration = predictions.predicted(dtype, known.kappa_s, known.kappa_j, first)
    ones = np.ones(len(known.kappa_j))
    return predictions.predicted_matrix(
        dtype,
        known.exact.kappa_s[name],
        known.kappa_j,
        known.exact.share if name == 'A' else ones,
        known.exact.gain if name in ('q', 'A') else 0 * ones,
        acceleration,
    )


def _largest(known: Known, name: str, error: Array, dtype: str) -> tuple[float, float]:
    """Return the largest error, and the largest in kappa_s u."""
    units = error / np.maximum(known.exact.kappa_s[name], 1.0) / ROUNDING[dtype]
    return float(np.max(error)), float(np.max(units))


def _peer_rows(known: Known, h: float) -> Iterator[Row]:
    """Yield the rows of computeABADerivatives; none if it is missing or refuses the problem."""
    problem = known.problem
    if 'wrench' in problem.states:
        return
    try:
        peer = Pinocchio(problem.plant.robot)
        peer.answers(problem.plant)
        found = _peer_matrices(peer, problem.states, h)
    except (LeftOutError, ValueError, RuntimeError):
        return
    for name, matrix in found.items():
        error = errors(matrix, known.exact.matrices[name])
        yield Row(name, PEER, 'float64', 0, *_largest(known, name, error, 'float64'))


def _peer_matrices(peer: Pinocchio, states: dict[str, Array], h: float) -> dict[str, NDArray[Any]]:
    evaluate = acceleration_and_derivatives(peer)
    rows = [np.array(row) for row in zip(*(states[name] for name in STATE), strict=True)]
    with np.errstate(all='ignore'):
        J = np.array([evaluate(*row)[1].copy() for row in rows])
        found = dict(zip(DERIVATIVES, np.split(J, 3, axis=-1), strict=True))
        steps = np.array([linear_rk4(evaluate, q, qd, tau, h) for q, qd, tau in rows])
    parts = np.split(in_positions(steps, h), [2 * peer.model.nv], axis=-1)
    found |= dict(zip(STEPS, parts, strict=True))
    return found


def _first(problem: Problem) -> Problem:
    """Return a problem with its first state."""
    first = {name: x[:1] for name, x in problem.states.items()}
    return Problem(problem.plant, first, problem.at_hold)
