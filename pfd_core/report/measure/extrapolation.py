# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Reference motions by extrapolation in extended precision.

A macro step of H seconds is taken with 1, 2, ..., k substeps by a method of low order, and the
k ends are extrapolated to substeps of no length (Aitken and Neville):

    midpoint   modified midpoint in 2 j substeps: error in even powers, order 2 k. Gragg 1965,
               Bulirsch and Stoer 1966
    implicit   (M + h D) (v' - v) = h (tau - bias - D v), q' = q + h v', in j substeps, M = H(q):
               order k, for strong damping D. Deuflhard 1983

Both are given in Hairer, Norsett, Wanner, Solving Ordinary Differential Equations, volumes I
(II.9) and II (IV.9). Numbers are decimal (decimals.evaluator); the forward dynamics are
articulated bodies in link axes. The self-difference of a reference is its distance to one with
fewer macro steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from decimal import Decimal, localcontext
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.programs import record_forward_dynamics, record_terms
from pfd_core.model import Plant, without_viscosity
from pfd_core.report.cases.motions import Extrapolation, Motion, Reference
from pfd_core.report.measure.decimals import evaluator

Numbers = NDArray[Any]
# State at the end of a macro step from (state, length, number of substeps).
Substeps = Callable[[Numbers, Decimal, int], Numbers]
# Digits that are stored.
STORED = 25
# Macro steps of the second computation, as a part of the first one's.
FEWER = 0.75


def computed(motion: Motion) -> Reference:
    """Return the reference of a motion."""
    fine, coarse = (
        end_of_motion(motion.plant, motion.q, motion.qd, motion.macro_steps(steps), motion.way)[0]
        for steps in (motion.steps, int(FEWER * motion.steps))
    )
    return Reference(
        tuple(f'{angle:.{STORED}g}' for angle in fine), float(max(abs(fine - coarse)))
    )


def end_of_motion(
    plant: Plant,
    q: Sequence[float],
    qd: Sequence[float],
    steps: Sequence[Fraction],
    way: Extrapolation,
) -> Numbers:
    """
    Return the state (2, n), q and qd, of Decimals, at the end of macro steps, without torques.

    Parameters
    ----------
    plant : Plant
        Robot and scene.
    q, qd : sequence of float
        State at the start, (n,).
    steps : sequence of Fraction
        Lengths of the macro steps [s].
    way : Extrapolation
        Scheme, columns and digits.

    """
    with localcontext() as context:
        context.prec = way.digits
        state: Numbers = np.array([[Decimal(x) for x in row] for row in (q, qd)])
        even = way.scheme == 'midpoint'
        substeps = _midpoint(plant) if even else _implicit(plant)
        counts = [(1 + even) * j for j in range(1, way.columns + 1)]
        for length in steps:
            H = Decimal(length.numerator) / length.denominator
            state = _extrapolated(
                [substeps(state, H, count) for count in counts], counts, 1 + even
            )
    return state


def _extrapolated(ends: Sequence[Numbers], counts: Sequence[int], power: int) -> Numbers:
    """Return the limit of substeps of no length, for errors in powers of (1 / count)^power."""
    row: list[Numbers] = []
    for j, end in enumerate(ends):
        following = [end]
        for k in range(1, j + 1):
            ratio = Decimal(counts[j] ** power) / counts[j - k] ** power
            following.append(following[k - 1] + (following[k - 1] - row[k - 1]) / (ratio - 1))
        row = following
    return row[-1]


def _midpoint(plant: Plant) -> Substeps:
    evaluate = evaluator(record_forward_dynamics(plant, 'articulated_body', 'sequential'))
    torques = [Decimal(0)] * plant.robot.n

    def slope(state: Numbers) -> Numbers:
        q, qd = state
        rate: Numbers = np.array([qd, evaluate({'q': q, 'qd': qd, 'tau': torques})['qdd']])
        return rate

    def substeps(state: Numbers, H: Decimal, count: int) -> Numbers:
        h = H / count
        before, at = state, state + h * slope(state)
        for _ in range(count - 1):
            before, at = at, before + 2 * h * slope(at)
        end: Numbers = at
        return end

    return substeps


def _implicit(plant: Plant) -> Substeps:
    """Return Euler steps with implicit damping: (M + h D) (v' - v) = h (tau - bias - D v)."""
    if plant.viscosity is None:
        raise ValueError('an implicit reference is for a scene with damping')
    damping = np.array([Decimal(d) for d in plant.viscosity.tolist()])
    evaluate = evaluator(record_terms(without_viscosity(plant), 'sequential'))
    n = plant.robot.n

    def substeps(state: Numbers, H: Decimal, count: int) -> Numbers:
        h = H / count
        q, qd = state
        for _ in range(count):
            terms = evaluate({'q': q, 'qd': qd})
            matrix = np.array(terms['H']).reshape(n, n)
            matrix[np.diag_indices(n)] += h * damping
            qd = qd + h * _solved(matrix, -np.array(terms['bias']) - damping * qd)
            q = q + h * qd
        end: Numbers = np.array([q, qd])
        return end

    return substeps


def _solved(matrix: Numbers, force: Numbers) -> Numbers:
    """Return x of matrix x = force by elimination, for a positive definite matrix."""
    n = len(force)
    rows, x = matrix.copy(), force.copy()
    for k in range(n):
        for i in range(k + 1, n):
            factor = rows[i, k] / rows[k, k]
            rows[i] = rows[i] - factor * rows[k]
            x[i] = x[i] - factor * x[k]
    for k in range(n - 1, -1, -1):
        x[k] = (x[k] - rows[k, k + 1 :] @ x[k + 1 :]) / rows[k, k]
    solution: Numbers = x
    return solution
