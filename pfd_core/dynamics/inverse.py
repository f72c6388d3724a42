# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The inverse X of the inertia matrix, by the factor of H or by articulated bodies, and refined.

    composite bodies      row after row of L X = D^-1 L'^-1, whose right side is triangular
    articulated bodies    column j is the acceleration at rest by a unit torque on joint j

Only elements on and above the diagonal are kept of a column, so that its solution goes from joint
j to the base and back, and X is symmetric. The articulated bodies are those of the acceleration
and recorded once. All other methods take the factor.

A step of refinement computes the torques that each column misses, e_j - H x_j, link by link
(parameters as given), and adds their accelerations by the same method, as
pfd_core.dynamics.refinement does for accelerations.

A factor loses digits with the condition number of H. Articulated bodies keep them where joints
are coaxial, a refined column also where the tip is heavy
(docs/decisions/0017-derivatives.md).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from pfd_core.dynamics.factors import Factors, Matrix, solution, symmetric
from pfd_core.dynamics.refinement import record_residual, solver
from pfd_core.machine.recorder import Lanes, Recorder, inline
from pfd_core.model.effects import INERTIA
from pfd_core.model.plant import Plant

# Methods that solve for single columns; the others share the factor of composite bodies.
BY_COLUMNS = ('articulated_body', 'grouped_articulated_body')


def inverse_inertia(
    recorder: Recorder, plant: Plant, factors: Factors, method: str, steps: int
) -> Matrix:
    """
    Return H^-1, (n, n), symmetric, with rows and columns of zeros for braked joints.

    It is by a method, with steps of refinement; methods that take no factors leave those unread.
    """
    n = plant.robot.n
    zero, one = recorder.constant(0.0), recorder.constant(1.0)
    still = replace(plant.only(INERTIA), external_wrench=False)
    units = [[one if i == j else zero for i in range(n)] for j in range(n)]
    by_columns = solver(recorder, still, method) if method in BY_COLUMNS else None

    def solve(y: Sequence[Lanes]) -> list[Lanes]:
        return solution(factors, y) if by_columns is None else by_columns(y)['qdd']

    X = symmetric([solve(unit) for unit in units]) if by_columns else _by_factors(factors)
    if not steps:
        return X
    residual = record_residual(still)
    for _ in range(steps):
        columns = []
        for unit, x in zip(units, X, strict=True):
            given = {'qd': [zero] * n, 'qdd': x, 'tau': unit}
            missed = inline(recorder, residual, given)['residual']
            columns.append([a + d for a, d in zip(x, solve(missed), strict=True)])
        X = symmetric(columns)
    return X


def _by_factors(factors: Factors) -> Matrix:
    """Return H^-1, row after row of L X = D^-1 L'^-1, whose right side is triangular."""
    X: Matrix = []
    for L, diagonal in zip(factors.L, factors.inverses, strict=True):
        row: list[Lanes] = []
        for j in range(len(L)):
            column = (X[max(j, k)][min(j, k)] for k in range(len(L)))
            row.append(-fused_product(L, column))
        for factor, x in zip(L, row, strict=True):
            diagonal = diagonal - factor * x
        X.append([*row, diagonal])
    return symmetric(X)


def fused_product(row: Iterable[Lanes], column: Iterable[Lanes]) -> Lanes:
    """Return the sum of products in their order, each fused with the sum of those before."""
    total: Lanes | None = None
    for x, d in zip(row, column, strict=True):
        total = x * d if total is None else x.recorder.apply('fma', x, d, total)
    assert total is not None
    return total
