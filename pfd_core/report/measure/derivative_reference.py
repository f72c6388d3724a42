# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Derivatives of forward dynamics and linearised steps in 50 digits, and their condition numbers.

Five matrices of a state:

    q, qd, tau   d qdd / d q, d qdd / d qd, d qdd / d tau, (n, n) each
    A, B         derivatives of the state after a step of classical Runge-Kutta, by the state
                 before, (2n, 2n), and by the torque, (2n, n). Velocities are multiplied by the
                 step, so that both halves of a state are positions

The reference is a central difference over DISTANCE of forward dynamics in DIGITS digits: no rule
of differentiation enters. It is certified twice:

    residual     torque that the Newton-Euler equations miss when state, torque and acceleration
                 change together, relative to the largest change of a torque
    difference   from the derivative of the recorded articulated-body program, by the rules of each
                 operation (machine.derivative), multiplied stage by stage (linear_rk4)

Norms are Frobenius norms. With DIRECTIONS neighbours (STEP_DIRECTIONS for A and B), whose numbers
all differ by their 2^-40th part (measure.reference), and a vector w of drawn signs,

    kappa_s   largest |(M' - M) w| / |M| over 2^-40. The mean square of |(M' - M) w| is
              |M' - M|^2 (Hutchinson 1990)
    gain      relative change of d qdd / d q for a relative change of the acceleration at which
              its inverse dynamics is differentiated
    share     |A - A of an arm without accelerations| / |A|
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.programs import record_forward_dynamics, record_inverse_dynamics
from pfd_core.machine.program import Program
from pfd_core.model import Plant
from pfd_core.report.cases.problems import SEED, Problem
from pfd_core.report.cases.quantities import STATE, linear_rk4
from pfd_core.report.cases.robots import Array
from pfd_core.report.measure.decimals import on_mpmath_numbers
from pfd_core.report.measure.quantity_reference import differentiated
from pfd_core.report.measure.reference import DIGITS as CERTIFIED
from pfd_core.report.measure.reference import (
    STEP,
    Reference,
    States,
    neighbours,
)

Numbers = NDArray[Any]
# Of a state's q, qd and tau, (..., n) each.
Function = Callable[[Numbers, Numbers, Numbers], Numbers]

DERIVATIVES, STEPS = ('q', 'qd', 'tau'), ('A', 'B')
MATRICES = (*DERIVATIVES, *STEPS)
# A central difference cuts off third derivatives times DISTANCE^2, and loses 40 digits.
DIGITS, DISTANCE = 130, '1e-40'
# Of the largest value of a function: smaller derivatives are roundings.
ROUNDED = '1e-70'
# Neighbours of which A and B are computed, too.
STEP_DIRECTIONS = 4
# Accelerations drawn for `gain`.
GAINS = 2
# No joint moves or accelerates by more than this in a step [rad or m].
MOVES = 2.0**-7


@dataclass(frozen=True)
class Exact:
    """
    The matrices of S states in 50 digits, with certificates and condition numbers.

    Attributes
    ----------
    matrices : dict
        Name in MATRICES -> (S, rows, columns) of mpmath.mpf.
    kappa_s : dict
        Name in MATRICES -> (S,).
    gain, share : ndarray
        (S,); share is zero without steps.
    residual : float
        Largest missed torque, relative; NaN without certificates.
    difference : float
        Largest error of the second evaluation; NaN without certificates.

    """

    matrices: dict[str, Numbers]
    kappa_s: dict[str, Array]
    gain: Array
    share: Array
    residual: float = np.nan
    difference: float = np.nan


def step_length(known: Reference, states: Mapping[str, Array]) -> float:
    """Return the step [s], a power of two up to MOVES, in which no joint moves more than MOVES."""
    speed = float(np.abs(states['qd']).max())
    acceleration = float(np.abs(known.qdd).max())
    longest = MOVES
    if speed > 0:
        longest = min(longest, MOVES / speed)
    if acceleration > 0:
        longest = min(longest, (MOVES / acceleration) ** 0.5)
    return float(2.0 ** np.floor(np.log2(longest)))


def exact(problem: Problem, known: Reference, h: float | None, certified: bool = True) -> Exact:
    """
    Return the matrices of a problem.

    Parameters
    ----------
    problem : Problem
        Plant and states.
    known : Reference
        Its accelerations.
    h : float, optional
        Step [s] of A and B; None for derivatives alone.
    certified : bool
        Whether to compute residual and difference, the latter at the first state.

    Returns
    -------
    Exact

    Raises
    ------
    ImportError
        Without mpmath.

    """
    import mpmath

    with mpmath.workdps(DIGITS):
        plant, states = problem.plant, _wide(problem.states)
        found = matrices(plant, states, h)
        gain, residual = _equation(plant, states, known, found, certified)
        return Exact(
            found,
            _kappa_s(problem, found, h),
            gain,
            _share(found['A']) if h is not None else np.zeros(len(gain)),
            residual,
            _difference(plant, states, found, h) if certified else np.nan,
        )


def matrices(plant: Plant, states: States, h: float | None) -> dict[str, Numbers]:
    """Return the matrices of states of mpmath numbers by central differences; A, B if h is."""
    n = plant.robot.n
    qdd = _forward(plant, states)
    unit = np.eye(3 * n)
    found = dict(zip(DERIVATIVES, _split(_along(qdd, states, unit), n), strict=True))
    if h is not None:
        unit[n : 2 * n] /= h
        whole = _along(_step(qdd, h), states, unit)
        found |= {'A': whole[..., : 2 * n], 'B': whole[..., 2 * n :]}
    return found


def norm(matrix: Numbers) -> Numbers:
    """Return the Frobenius norm of each state's matrix, (S,)."""
    result: Numbers = (matrix * matrix).sum(axis=(-2, -1)) ** 0.5
    return result


def size_of(matrix: Numbers) -> Numbers:
    """Return what changes of each state's matrix are relative to, (S,): its norm, 1 for zero."""
    size = norm(matrix)
    result: Numbers = np.where(size == 0, 1, size)
    return result


def errors(found: Numbers, exact: Numbers) -> Array:
    """
    Return |found - exact| / |exact| of each state, (S,); infinity where found is not finite.

    An error of a matrix that is zero is absolute.
    """
    import mpmath

    sound = np.asarray(np.isfinite(found).all(axis=(-2, -1)))
    answer = np.where(sound[:, None, None], found, 0.0).astype(np.float64)
    with mpmath.workdps(CERTIFIED):
        error = (norm(answer.astype(object) - exact) / size_of(exact)).astype(np.float64)
    result: Array = np.where(sound, error, np.inf)
    return result


def in_positions(matrix: Numbers, h: float) -> Numbers:
    """Return [A B], (..., 2n, 3n), with velocities multiplied by the step h, a power of two."""
    n = matrix.shape[-1] // 3
    scaled: Numbers = matrix.copy()
    scaled[..., n:, :] *= h
    scaled[..., n : 2 * n] /= h
    return scaled


def _wide(states: Mapping[str, Numbers]) -> States:
    import mpmath

    number = np.vectorize(mpmath.mpf, otypes=[object])
    return {name: number(x) for name, x in states.items()}


def _split(matrix: Numbers, n: int) -> list[Numbers]:
    return [matrix[..., k : k + n] for k in range(0, matrix.shape[-1], n)]


def _forward(plant: Plant, states: States) -> Function:
    """Return the acceleration, (S, K, n), of K points near each of S states."""
    program = record_forward_dynamics(plant, 'articulated_body', 'sequential')
    return _evaluated(program, states, STATE, 'qdd')


def _evaluated(
    program: Program, states: States, names: tuple[str, ...], output: str
) -> Callable[..., Numbers]:
    """Return a function of inputs (S, K, n); other inputs come from the states."""
    others = {name: x[:, None] for name, x in states.items() if name not in names}
    on_numbers = on_mpmath_numbers(program, output)

    def evaluate(*given: Numbers) -> Numbers:
        batch = given[0].shape[:-1]
        inputs = dict(zip(names, given, strict=True))
        inputs |= {k: np.broadcast_to(x, (*batch, x.shape[-1])) for k, x in others.items()}
        result: Numbers = on_numbers(inputs)
        return result

    return evaluate


def _step(qdd: Function, h: float) -> Function:
    """Return the state, (S, K, 2n), after a step of classical Runge-Kutta, as q and h qd."""

    def end(q: Numbers, qd: Numbers, tau: Numbers) -> Numbers:
        slopes = [(qd, qdd(q, qd, tau))]
        for part in (h / 2, h / 2, h):
            v, a = slopes[-1]
            moved = q + part * v, qd + part * a
            slopes.append((moved[1], qdd(*moved, tau)))
        (v1, a1), (v2, a2), (v3, a3), (v4, a4) = slopes
        v, a = v1 + 2 * v2 + 2 * v3 + v4, a1 + 2 * a2 + 2 * a3 + a4
        return np.concatenate([q + h * v / 6, h * (qd + h * a / 6)], axis=-1)

    return end


def _along(function: Function, states: States, directions: Numbers) -> Numbers:
    """
    Return the derivatives of a function of q, qd and tau along directions, (S, m, K).

    `directions` are (K, 3n), the same for all states.
    """
    import mpmath

    change = mpmath.mpf(DISTANCE)
    x = np.concatenate([states[name] for name in STATE], axis=-1)[:, None]
    moves = change * directions.astype(object)
    # Both ends in one evaluation, whose operations take long for few points, too.
    values = function(*np.split(x + np.concatenate([moves, -moves]), 3, axis=-1))
    ahead, behind = np.split(values, 2, axis=1)
    slope = (ahead - behind) / (2 * change)
    # The rounding of a function that does not depend on an input.
    zero = np.abs(slope) <= mpmath.mpf(ROUNDED) * np.abs(ahead).max(axis=-1, keepdims=True)
    result: Numbers = np.where(zero, 0, slope).swapaxes(-2, -1)
    return result


def _equation(
    plant: Plant, states: States, known: Reference, found: dict[str, Numbers], certified: bool
) -> tuple[Array, float]:
    """
    Return gain, (S,), and the largest residual of the derivatives.

    Both are derivatives of inverse dynamics: with r = ID(q, qd, qdd) - tau = 0,
    d r / d x + H d qdd / d x = 0. H times a vector is a difference of inverse dynamics, which is
    linear in qdd.
    """
    n = plant.robot.n
    program = record_inverse_dynamics(plant, 'sequential')
    torques = _evaluated(program, states, ('q', 'qd', 'qdd'), 'tau')
    qdd = _wide({'qdd': known.qdd})['qdd']
    gain = _gain(torques, states, qdd, known, found)
    if not certified:
        return gain, np.nan
    # Columns by q and qd; those by tau are the unit matrix.
    unit = np.eye(2 * n)
    directions = np.hstack([unit, np.zeros((2 * n, n))])
    at_qdd = states | {'tau': qdd}
    by_state = _along(torques, at_qdd, directions)
    columns = np.concatenate([found[name] for name in DERIVATIVES], axis=-1).swapaxes(-2, -1)
    q, qd, bias_qdd = (
        np.broadcast_to(x[:, None], columns.shape) for x in (states['q'], states['qd'], qdd)
    )
    by_qdd = (torques(q, qd, bias_qdd + columns) - torques(q, qd, bias_qdd)).swapaxes(-2, -1)
    missed = by_qdd.copy()
    missed[..., : 2 * n] = missed[..., : 2 * n] + by_state
    missed[..., 2 * n :] = missed[..., 2 * n :] - np.eye(n)
    worst = 0.0
    for name, part in zip(DERIVATIVES, _split(missed, n), strict=True):
        k = DERIVATIVES.index(name)
        size = np.eye(n) if name == 'tau' else by_state[..., k * n : (k + 1) * n]
        largest = np.abs(size).max(axis=(-2, -1))
        # Torques that no position changes, of slides, leave nothing to be relative to.
        largest = np.where(largest == 0, 1, largest)
        worst = max(worst, float((np.abs(part).max(axis=(-2, -1)) / largest).max()))
    return gain, worst


def _gain(
    torques: Callable[..., Numbers],
    states: States,
    qdd: Numbers,
    known: Reference,
    found: dict[str, Numbers],
) -> Array:
    """Return the relative change of d qdd / d q for one of the acceleration's norm, (S,)."""
    n = qdd.shape[-1]
    rng = np.random.default_rng(SEED)
    directions = np.hstack([np.eye(n), np.zeros((n, 2 * n))])
    still = _along(torques, states | {'tau': 0 * qdd}, directions)
    largest = np.zeros(len(qdd))
    size = size_of(found['q'])
    for _ in range(GAINS):
        signs = rng.choice([-1.0, 1.0], qdd.shape)
        other = signs * known.scale[:, None] / n**0.5
        moving = _along(torques, states | {'tau': _wide({'': other})['']}, directions)
        change = _product(found['tau'], moving - still)
        largest = np.maximum(largest, (norm(change) / size).astype(np.float64))
    return largest


def _product(left: Numbers, right: Numbers) -> Numbers:
    """Return the products of matrices of any numbers, (S, n, n)."""
    result: Numbers = np.array([a @ b for a, b in zip(left, right, strict=True)])
    return result


def _kappa_s(problem: Problem, found: dict[str, Numbers], h: float | None) -> dict[str, Array]:
    n = problem.plant.robot.n
    sizes = {name: size_of(x) for name, x in found.items()}
    largest = {name: np.zeros(len(x)) for name, x in found.items()}
    for k, (plant, states) in enumerate(neighbours(problem)):
        rng = np.random.default_rng([SEED, k])
        near = _wide(states)
        qdd = _forward(plant, near)
        length = h if k < STEP_DIRECTIONS else None
        for name, change in _changes(qdd, near, found, length, rng, n):
            relative = (change / sizes[name]).astype(np.float64) / STEP
            largest[name] = np.maximum(largest[name], relative)
    return largest


def _changes(
    qdd: Function,
    states: States,
    found: dict[str, Numbers],
    h: float | None,
    rng: np.random.Generator,
    n: int,
) -> Iterator[tuple[str, Numbers]]:
    """Yield the name of each matrix and |(M' - M) w|, (S,), w of drawn signs."""
    signs = rng.choice([-1.0, 1.0], 3 * n)
    groups: list[tuple[tuple[str, ...], Function, list[Array], float]] = [
        (DERIVATIVES, qdd, np.split(np.arange(3 * n), 3), 1.0)
    ]
    if h is not None:
        groups.append((STEPS, _step(qdd, h), np.split(np.arange(3 * n), [2 * n]), h))
    for names, function, columns, length in groups:
        rows = np.zeros((len(names), 3 * n))
        for row, own in zip(rows, columns, strict=True):
            row[own] = signs[own]
        rows[:, n : 2 * n] /= length
        moved = _along(function, states, rows)
        for j, (name, own) in enumerate(zip(names, columns, strict=True)):
            change = moved[..., j] - found[name] @ signs[own]
            yield name, (change * change).sum(axis=-1) ** 0.5


def _share(A: Numbers) -> Array:
    """Return the part of A that forces give: the rest is of an arm at constant velocity."""
    n = A.shape[-1] // 2
    free = np.eye(2 * n)
    free[:n, n:] = np.eye(n)
    result: Array = (norm(A - free) / norm(A)).astype(np.float64)
    return result


def _difference(plant: Plant, states: States, found: dict[str, Numbers], h: float | None) -> float:
    """Return how far the derivative of the recorded program is from the matrices, at a state."""
    import mpmath

    others = {name: x[:1] for name, x in states.items() if name not in STATE}
    evaluate = differentiated(plant, DIGITS, **others)
    n = plant.robot.n
    q, qd, tau = (states[name][:1] for name in STATE)
    _, J = evaluate(q, qd, tau)
    second = dict(zip(DERIVATIVES, _split(J, n), strict=True))
    if h is not None:
        whole = in_positions(linear_rk4(evaluate, q, qd, tau, mpmath.mpf(h)), h)
        second |= {'A': whole[..., : 2 * n], 'B': whole[..., 2 * n :]}
    largest = 0.0
    for name, matrix in second.items():
        known = found[name][:1]
        largest = max(largest, float(np.max(norm(matrix - known) / size_of(known))))
    return largest
