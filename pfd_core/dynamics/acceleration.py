# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Derivatives of forward dynamics with respect to q, qd and tau, by the implicit function theorem.

    r(q, qd, qdd) = ID(q, qd, qdd) - motor torques = 0,   X = H^-1 = (dr / d qdd)^-1
    d qdd / d(q, qd) = -X D     D = dr / d(q, qd) at the answer qdd
    d qdd / d tau    = X T      T = d motor torques / d tau, a diagonal; one without limits

D of the links is from pfd_core.dynamics.derivatives, over composite bodies; H
and the bias are by-products, and H = L' D L gives qdd and X. D of the joints and D of the drives
are tangents of the programs of their torques (pfd_core.machine.derivative). Both are diagonal but
for the gravity that the drives compensate.

X is by the factor of H, row after row of L X = D^-1 L'^-1, whose right side is triangular, or, for
methods by articulated bodies, column after column: the acceleration at rest by a unit torque. Only
elements on and above the diagonal are kept of a column, so that its solution goes from its joint
to the base and back, and X is symmetric. The articulated bodies are those of the acceleration and
recorded once. A step of refinement computes the torques that each column misses, e_j - H x_j, link
by link (parameters as given), and adds their accelerations by the same method, as
pfd_core.dynamics.refinement does for accelerations. A factor loses digits with the condition
number of H. Articulated bodies keep them where joints are coaxial, a refined column also where the
tip is heavy (docs/decisions/0017-derivatives.md).

A braked joint has zeros in its row and its column of X. At a motor limit, where the torque has
no derivative, it is taken on the side that the program selects.

Carpentier and Mansard 2018 (derivatives of forward dynamics by derivatives of inverse dynamics
and H^-1).

Cost: the product X D takes 2 n^3 multiplications, factors and X n^3 / 2 and all else n^2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from pfd_core.dynamics.chain import chain_of
from pfd_core.dynamics.composite import (
    Factors,
    Matrix,
    factorise,
    reduced,
    solution,
    symmetric,
)
from pfd_core.dynamics.derivatives import (
    by_positions,
    by_velocities,
    inertia_matrix,
    minus_bias,
    moving_chain,
)
from pfd_core.dynamics.drives import record_motor_torques
from pfd_core.dynamics.joint_torques import minus_joint_torques, record_joint_torques
from pfd_core.dynamics.numbers import free_input, rotors
from pfd_core.dynamics.refinement import (
    record_answer,
    record_residual,
    refined,
    solver,
)
from pfd_core.machine.derivative import derivative
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder, inline
from pfd_core.machine.vectors import array
from pfd_core.model.effects import INERTIA
from pfd_core.model.plant import Plant, check_instant, has_drives

OWN_METHOD = 'composite_body'
# Methods that solve for single columns; the others share the factor of composite bodies.
BY_COLUMNS = ('articulated_body', 'grouped_articulated_body')


def record_derivatives(
    plant: Plant, method: str = OWN_METHOD, refine: int = 0, dtype: str = 'float64'
) -> Program:
    """
    Return the program of the factors of d qdd / d(q, qd, tau) = [-X D, X T], from q, qd and tau.

    D is taken at the qdd of a method, with `refine` steps of refinement; an iterative method
    iterates to the rounding of `dtype`. X takes the same method and steps
    (`inverse_inertia`). Outputs are `qdd`, (n,), `X`, (n, n), `D`, (n, 2 n), and with
    motor limits `T`, (n,). ValueError for an unknown method and for effects that act over a step
    of time.
    """
    check_instant(plant)
    n = plant.robot.n
    chain = chain_of(plant)
    recorder, qd = chain.recorder, chain.inputs('qd')
    moving = moving_chain(chain, qd)
    by_qd = by_velocities(moving)
    with recorder.section('solve'):
        factors = factorise(inertia_matrix(moving), free_input(recorder, plant))
    of_motors = record_motor_torques(plant)
    of_motors = _with_derivatives(of_motors) if has_drives(plant) else of_motors
    motors = inline(recorder, of_motors, {})
    joints = inline(recorder, _with_derivatives(record_joint_torques(plant)), {})
    torques = minus_joint_torques(plant, motors['tau'], qd)
    if method == OWN_METHOD:
        y = minus_bias(moving, by_qd, torques, qd)
        qdd = refined(plant, solution(factors, y), partial(solution, factors), refine)
    else:
        answer = record_answer(plant, method, refine, dtype)
        qdd = inline(recorder, answer, {})['qdd']
    known = None  # the torques left for the links, unless brakes or followers give some of them
    if not (plant.brakes or plant.robot.followers):
        own = rotors(recorder, plant)
        known = [t - rotor * a for t, rotor, a in zip(torques, own, qdd, strict=True)]
    by_q = by_positions(moving, qd, qdd, known)
    with recorder.section('joints and drives'):
        links = {'q': reduced(plant.robot, by_q), 'qd': reduced(plant.robot, by_qd)}
        D = _with_joints_and_drives(links, joints, motors)
    with recorder.section('inverse'):
        X = inverse_inertia(recorder, plant, factors, method, refine)[-1]
    results = {'qdd': qdd, 'X': X, 'D': D}
    if 'd tau/d tau' in motors:
        by_tau = motors['d tau/d tau'][:: n + 1]
        if by_tau != [recorder.constant(1.0)] * n:
            results['T'] = by_tau
    return recorder.program(**results)


def _with_derivatives(torques: Program) -> Program:
    """Return the program of torques tau and of their derivatives by its inputs."""
    return derivative(torques, ['tau'], [x for x in ('q', 'qd', 'tau') if x in torques.inputs])


def _with_joints_and_drives(
    links: Mapping[str, Matrix], joints: Mapping[str, Any], motors: Mapping[str, Any]
) -> Matrix:
    """Return D from the derivatives of the torques of links, joints and motors by q and qd."""
    n = len(links['q'])
    D = []
    for name, matrix in links.items():
        total = array(matrix)
        by = f'd tau/d {name}'
        if by in joints:
            for i, rate in enumerate(joints[by][:: n + 1]):
                total[i, i] = total[i, i] + rate
        if by in motors:
            total = total - array(motors[by]).reshape(n, n)
        D.append(total)
    return [[*row, *row_qd] for row, row_qd in zip(*D, strict=True)]


def record_inverse_inertia(plant: Plant, method: str) -> Program:
    """Return the program of H^-1 from q: `first` by a method, and `X` after a refinement of it."""
    chain = chain_of(plant)
    H = inertia_matrix(moving_chain(chain, chain.inputs('qd')))
    factors = factorise(H, free_input(chain.recorder, plant))
    first, X = inverse_inertia(chain.recorder, plant, factors, method, 1)
    return chain.recorder.program(first=first, X=X)


def inverse_inertia(
    recorder: Recorder, plant: Plant, factors: Factors, method: str, steps: int
) -> list[Matrix]:
    """
    Return H^-1, (n, n), symmetric, with rows and columns of zeros for braked joints.

    The first is by a method, the others follow by steps of refinement; methods that take no
    factors leave those unread.
    """
    n = plant.robot.n
    zero, one = recorder.constant(0.0), recorder.constant(1.0)
    still = replace(plant.only(INERTIA), external_wrench=False)
    units = [[one if i == j else zero for i in range(n)] for j in range(n)]
    by_columns = solver(recorder, still, method) if method in BY_COLUMNS else None

    def solve(y: Sequence[Lanes]) -> list[Lanes]:
        return solution(factors, y) if by_columns is None else by_columns(y)['qdd']

    first = [solve(unit) for unit in units] if by_columns else _by_factors(recorder, factors)
    found = [symmetric(first)]
    for _ in range(steps):
        residual, columns = record_residual(still), []
        for unit, x in zip(units, found[-1], strict=True):
            given = {'qd': [zero] * n, 'qdd': x, 'tau': unit}
            missed = inline(recorder, residual, given)['residual']
            columns.append([a + d for a, d in zip(x, solve(missed), strict=True)])
        found.append(symmetric(columns))
    return found


def _by_factors(recorder: Recorder, factors: Factors) -> Matrix:
    """Return H^-1, row after row of L X = D^-1 L'^-1, whose right side is triangular."""
    X: Matrix = []
    for L, diagonal in zip(factors.L, factors.inverses, strict=True):
        row: list[Lanes] = []
        for j in range(len(L)):
            total = L[0] * X[j][0]
            for k in range(1, len(L)):
                total = recorder.apply('fma', L[k], X[max(j, k)][min(j, k)], total)
            row.append(-total)
        for factor, x in zip(L, row, strict=True):
            diagonal = diagonal - factor * x
        X.append([*row, diagonal])
    return X
