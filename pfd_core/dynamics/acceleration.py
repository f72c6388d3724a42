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

A braked joint has zeros in its row and its column of X. At a motor limit, where the torque has
no derivative, it is taken on the side that the program selects.

Carpentier and Mansard 2018 (derivatives of forward dynamics by derivatives of inverse dynamics
and H^-1).

Cost: the product X D takes 2 n^3 multiplications, factors and X n^3 / 2 and all else n^2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from pfd_core.dynamics.chain import chain_of
from pfd_core.dynamics.convergence import with_nan_unless_converged
from pfd_core.dynamics.derivatives import (
    by_positions,
    by_velocities,
    inertia_matrix,
    minus_bias,
    moving_chain,
)
from pfd_core.dynamics.drives import record_motor_torques
from pfd_core.dynamics.factors import Matrix, factorise, reduced, solution
from pfd_core.dynamics.interface import free_input, program_with_outputs
from pfd_core.dynamics.inverse import inverse_inertia
from pfd_core.dynamics.joint_torques import minus_joint_torques, record_joint_torques
from pfd_core.dynamics.numbers import rotors
from pfd_core.dynamics.refinement import record_refined, refined
from pfd_core.machine.derivative import derivative
from pfd_core.machine.iteration import TOLERANCES
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder, inline
from pfd_core.machine.vectors import array
from pfd_core.model.plant import Plant, check_instant, has_drives

OWN_METHOD = 'composite_body'


def record_derivatives(
    plant: Plant, method: str = OWN_METHOD, refine: int = 0, dtype: str = 'float64'
) -> Program:
    """
    Return the program of the factors of d qdd / d(q, qd, tau) = [-X D, X T], from q, qd and tau.

    D is taken at the qdd of a method, with `refine` steps of refinement; an iterative method
    iterates to the rounding of `dtype`. X takes the same method and steps
    (pfd_core.dynamics.inverse). Outputs are `qdd`, (n,), `X`, (n, n), `D`, (n, 2 n), and with
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
        program = record_refined(plant, method, refine, TOLERANCES[dtype])
        answer = with_nan_unless_converged(program, plant)
        qdd = inline(recorder, answer, {})['qdd']
    by_q = by_positions(moving, qd, qdd, _minus_inertia(recorder, plant, torques, qdd))
    with recorder.section('joints and drives'):
        links = {'q': reduced(plant.robot, by_q), 'qd': reduced(plant.robot, by_qd)}
        D = _with_joints_and_drives(links, joints, motors)
    with recorder.section('inverse'):
        X = inverse_inertia(recorder, plant, factors, method, refine)
    results = {'qdd': qdd, 'X': X, 'D': D}
    if 'd tau/d tau' in motors:
        by_tau = motors['d tau/d tau'][:: n + 1]
        if by_tau != [recorder.constant(1.0)] * n:
            results['T'] = by_tau
    return program_with_outputs(recorder, **results)


def _minus_inertia(
    recorder: Recorder, plant: Plant, torques: Sequence[Lanes], qdd: Sequence[Lanes]
) -> list[Lanes] | None:
    """Return the torques left for the links; None if brakes or followers give some of them."""
    if plant.brakes or plant.robot.followers:
        return None
    own = rotors(recorder, plant)
    return [t - rotor * a for t, rotor, a in zip(torques, own, qdd, strict=True)]


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
