# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Whole programs: inverse dynamics, and forward dynamics by each method.

    H(q) qdd + C(q, qd) qd + G(q) = tau        Lee and Chang 1987, eqs (1), (2)

    inverse_dynamics   tau from q, qd, qdd     NE1
    pcrbm              qdd from q, qd, tau     H by PCRBM, bias by NE1, H qdd = tau - bias

The inputs are described in pfd_core.algorithms.equations.
"""

from __future__ import annotations

from collections.abc import Callable

from pfd_core.algorithms.cholesky import solve
from pfd_core.algorithms.equations import (
    armature,
    begin,
    finish,
    held_joints,
    joint_input,
    torque,
)
from pfd_core.algorithms.pcrbm import inertia_matrix
from pfd_core.machine.program import Program
from pfd_core.model import Plant


def record_inverse_dynamics(plant: Plant, schedule: str) -> Program:
    """Return the program of tau, (n,), from q, qd and qdd; a joint's brake plays no part."""
    recorder, chain, at = begin(plant, schedule)
    qd, qdd = joint_input(recorder, 'qd'), joint_input(recorder, 'qdd')
    tau = torque(recorder, plant, chain, at, qd, qdd)
    if plant.armature is not None:
        tau = tau + recorder.constant(plant.armature) * qdd
    return finish(recorder, tau=tau)


def record_pcrbm(plant: Plant, schedule: str) -> Program:
    """Return the program of qdd, (n,), from q, qd and tau; its pivots show whether H was sound."""
    recorder, chain, at = begin(plant, schedule)
    qd, tau = joint_input(recorder, 'qd'), joint_input(recorder, 'tau')
    y = tau - torque(recorder, plant, chain, at, qd, None)
    rows = inertia_matrix(recorder, chain, at, armature(recorder, plant))
    if plant.brakes:
        rows, y = held_joints(recorder, rows, y)
    qdd, pivots = solve(recorder, rows, y)
    return finish(recorder, qdd=qdd, pivots=pivots)


def record_terms(plant: Plant, schedule: str) -> Program:
    """Return the program of H, (n, n), and of the bias, (n,), from q and qd."""
    recorder, chain, at = begin(plant, schedule)
    qd = joint_input(recorder, 'qd')
    bias = torque(recorder, plant, chain, at, qd, None)
    rows = inertia_matrix(recorder, chain, at, armature(recorder, plant))
    n = recorder.lanes
    elements = [(rows[min(i, j)], max(i, j)) for i in range(n) for j in range(n)]
    recorder.output('H', (n, n), elements)
    return finish(recorder, bias=bias)


FORWARD: dict[str, Callable[[Plant, str], Program]] = {'pcrbm': record_pcrbm}
METHODS = tuple(FORWARD)


def record_forward_dynamics(plant: Plant, method: str, schedule: str) -> Program:
    """Return the program of a method; its outputs are `qdd` and `pivots`, (n,)."""
    if method not in FORWARD:
        raise ValueError(f'method must be one of {METHODS}, got {method!r}')
    return FORWARD[method](plant, schedule)
