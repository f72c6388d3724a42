# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Inverse dynamics by NE1, H and the bias on n lanes, as whole programs.

    H(q) qdd + C(q, qd) qd + G(q) = tau        Lee and Chang 1987, eq. (1)

    inverse_dynamics   tau from q, qd, qdd
    terms              H and bias
"""

from __future__ import annotations

from pfd_core.algorithms.chain.base_axes import chain_on_lanes
from pfd_core.algorithms.chain.equations import armature, compensation, torques
from pfd_core.algorithms.paper.newton_euler import newton_euler
from pfd_core.algorithms.paper.pcrbm import inertia_matrix
from pfd_core.dynamics.drives import commanded_torques
from pfd_core.dynamics.interface import input_row, program_with_outputs
from pfd_core.dynamics.methods import check_payload
from pfd_core.machine.program import Program
from pfd_core.model import Plant, check_instant


def record_inverse_dynamics(plant: Plant, schedule: str) -> Program:
    """
    Return the program of the commanded tau, (n,), from q, qd and qdd.

    Brakes and motor limits are ignored.
    """
    check_instant(plant)
    check_payload(plant, 'inverse_dynamics')
    recorder, chain, at = chain_on_lanes(plant, schedule)
    qd, qdd = input_row(recorder, 'qd'), input_row(recorder, 'qdd')
    tau = torques(plant, chain, at, qd, qdd, newton_euler)
    (tau,) = commanded_torques(plant, [tau], compensation(plant, chain, at))
    return program_with_outputs(recorder, tau=tau)


def record_terms(plant: Plant, schedule: str) -> Program:
    """Return the program of H, (n, n), and of the bias, (n,), from q and qd."""
    check_instant(plant)
    check_payload(plant, 'terms')
    recorder, chain, at = chain_on_lanes(plant, schedule)
    bias = torques(plant, chain, at, input_row(recorder, 'qd'), None, newton_euler)
    rows = inertia_matrix(recorder, chain, at, armature(recorder, plant))
    n = recorder.lanes
    elements = [(rows[min(i, j)], max(i, j)) for i in range(n) for j in range(n)]
    recorder.output('H', (n, n), elements)
    return program_with_outputs(recorder, bias=bias)
