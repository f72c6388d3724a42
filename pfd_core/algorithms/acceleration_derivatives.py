# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Derivatives of forward dynamics with respect to q, qd and tau, by the implicit function theorem.

    r(q, qd, qdd) = ID(q, qd, qdd) - motor torques = 0,   X = H^-1
    d qdd / d(q, qd) = -X D,   D = dr / d(q, qd) at the answer qdd
    d qdd / d tau = X T,       T = d motor torques / d tau, a diagonal; 1 without limits
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from pfd_core.algorithms.chain.interface import input_list
from pfd_core.algorithms.grouped.newton_euler import links_at
from pfd_core.algorithms.refinement import inline, record_refined
from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.machine.vectors import array
from pfd_core.model import Plant

Matrix = list[list[Lanes]]


def record_derivatives(plant: Plant, method: str = 'composite_body', refine: int = 0) -> Program:
    """
    Return the program of qdd, (n,), X, (n, n), and D, (n, 2 n), from q, qd and tau.

    Parameters
    ----------
    plant : Plant
        Robot and scene.
    method : str
        A name in METHODS, of which qdd comes.
    refine : int
        Steps of refinement of qdd.

    """
    import os
    from pfd_core.algorithms.grouped.shared_axes import in_shared_axes
    from pfd_core.algorithms.grouped import torque_derivatives as td
    from pfd_core.algorithms.grouped.newton_euler import outward, motions
    from pfd_core.machine.vectors import dot, constants
    own = 'B' in os.environ['OPT']
    recorder = Recorder(1, 'sequential')
    n = plant.robot.n
    q, qd, tau = (input_list(recorder, name, n) for name in ('q', 'qd', 'tau'))
    links, tip = links_at(recorder, plant, q)
    if 'S' in os.environ['OPT']:
        links = in_shared_axes(links)
    ch = td.composites(links, qd)
    H = td.inertia_matrix(ch)
    if plant.armature is not None:
        for i, rotor in enumerate(plant.armature):
            H[i][i] = H[i][i] + float(rotor)
    by_qd = td.by_velocities(ch)
    if own:
        from pfd_core.algorithms.grouped.composite_body import solve
        y = []
        a = outward(links[0], constants(recorder, -plant.gravity))
        half = [0.5 * x for x in qd]
        for i in range(n):
            t = tau[i]
            for j in range(n):
                t = t - by_qd[i][j] * half[j]
            y.append(t - dot(ch.units[i][0].f, a))
        qdd, _ = solve(H, y, None)
    else:
        qdd = inline(recorder, record_refined(plant, method, refine), {})['qdd']
    moving = list(motions(recorder, plant, links, qd, qdd))
    forces = td.joint_forces(recorder, plant, links, tip, moving)
    by_q = td.by_positions(ch, moving, forces)
    X = _inverse(H, None)
    D = [[*row, *row_qd] for row, row_qd in zip(by_q, by_qd, strict=True)]
    for name, rows in (('qdd', [qdd]), ('X', X), ('D', D)):
        shape = (n,) if name == 'qdd' else (n, len(rows[0]))
        recorder.output(name, shape, [(value, 0) for row in rows for value in row])
    return recorder.program()


def record_acceleration_derivatives(
    plant: Plant, method: str = 'composite_body', refine: int = 0
) -> Program:
    """Return the program of d qdd / d(q, qd, tau), (n, 3 n), from q, qd and tau."""
    recorder = Recorder(1, 'sequential')
    n = plant.robot.n
    parts = inline(recorder, record_derivatives(plant, method, refine), {})
    X, D = array(parts['X']).reshape(n, n), array(parts['D']).reshape(n, 2 * n)
    with recorder.section('product'):
        rows = [[*(-_product(row, column) for column in D.T), *row] for row in X]
    recorder.output('derivatives', (n, 3 * n), [(value, 0) for row in rows for value in row])
    return recorder.program()


def _product(row: Iterable[Lanes], column: Iterable[Lanes]) -> Lanes:
    """Return row . column, each product after the first fused with the sum so far."""
    pairs = iter(zip(row, column, strict=True))
    x, d = next(pairs)
    total: Lanes = x * d
    for x, d in pairs:
        total = total.recorder.apply('fma', x, d, total)
    return total


def _inverse(H: Sequence[Sequence[Lanes]], free: Sequence[Lanes] | None) -> Matrix:
    """Return the inverse of H, given by the lower triangle, with zeros for held joints."""
    n = len(H)
    rows = [list(row) for row in H]
    L: list[list[Lanes]] = [[] for _ in H]
    inverses: list[Lanes] = [row[-1] for row in H]
    for k in range(n - 1, -1, -1):
        last = rows[k]
        inverses[k] = 1.0 / last[k]
        if free is not None:
            inverses[k] = where(free[k], inverses[k], 0.0)
        L[k] = [h * inverses[k] for h in last[:k]]
        for i, factor in enumerate(L[k]):
            rows[i] = [h - factor * last[j] for j, h in enumerate(rows[i])]
    # M = L^-1 and X = M D^-1 M', M without its unit diagonal.
    M: Matrix = []
    X: Matrix = []
    for i in range(n):
        M.append([])
        for j in range(i):
            total = -L[i][j]
            for k in range(j + 1, i):
                total = total - L[i][k] * M[k][j]
            M[i].append(total)
        scaled = [m * inverses[k] for k, m in enumerate(M[i])] + [inverses[i]]
        X.append([])
        for j in range(i + 1):
            total = scaled[j]
            for k in range(j):
                total = total + scaled[k] * M[j][k]
            X[i].append(total)
    return [[X[max(i, j)][min(i, j)] for j in range(n)] for i in range(n)]
