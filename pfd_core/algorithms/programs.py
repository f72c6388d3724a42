# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Whole programs by name: inverse dynamics, and forward dynamics by each method (FORWARD).

    H(q) qdd + C(q, qd) qd + G(q) = tau        Lee and Chang 1987, eq. (1)

    inverse_dynamics   tau from q, qd, qdd, by NE1
    terms              H and bias
    walker_orin_1 .. 4, articulated_body       serial, which the paper compares with
    pcrbm, pcrbm_array, pcgm                   the paper's, on n lanes, corrected
    pcrbm_1987, pcgm_1987                      the paper's step by step, for comparison with it
    pcrbm_base_origin, divide_and_conquer, constraint_forces   beyond the paper, on n lanes
    composite_body, grouped_articulated_body   serial methods at their cheapest, for kernels

On n lanes all METHODS, which kernels offer, take the bias from pfd_core.algorithms.beyond.omega,
which has fewer steps than the paper's NE1. Inputs are described in
pfd_core.algorithms.chain.interface. A new method is a row of FORWARD and, if it is serial,
iterative or not for kernels, a name in SERIAL, ITERATIVE or EMULATED.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from pfd_core.algorithms.beyond.base_origin import inertia_matrix_base_origin
from pfd_core.algorithms.beyond.constraint_forces import record_constraint_forces
from pfd_core.algorithms.beyond.divide_and_conquer import record_divide_and_conquer
from pfd_core.algorithms.beyond.omega import omega_torques
from pfd_core.algorithms.chain.base_axes import chain_on_lanes
from pfd_core.algorithms.chain.drives import commanded_torques
from pfd_core.algorithms.chain.equations import armature, torques
from pfd_core.algorithms.chain.interface import input_row, program_with_outputs
from pfd_core.algorithms.grouped.articulated_body import record_grouped_articulated_body
from pfd_core.algorithms.grouped.composite_body import record_composite_body
from pfd_core.algorithms.paper.newton_euler import newton_euler
from pfd_core.algorithms.paper.pcgm import TOLERANCE, record_pcgm
from pfd_core.algorithms.paper.pcgm_1987 import record_pcgm_1987
from pfd_core.algorithms.paper.pcrbm import inertia_matrix, record_pcrbm
from pfd_core.algorithms.paper.pcrbm_1987 import record_pcrbm_1987
from pfd_core.algorithms.paper.pcrbm_array import record_pcrbm_array
from pfd_core.algorithms.serial.articulated_body import record_articulated_body
from pfd_core.algorithms.serial.walker_orin import (
    record_walker_orin_1,
    record_walker_orin_2,
    record_walker_orin_3,
    record_walker_orin_4,
)
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Schedule
from pfd_core.model import Plant, check_instant
from pfd_core.model.checked_numbers import choice


def record_inverse_dynamics(plant: Plant, schedule: str | Schedule) -> Program:
    """
    Return the program of the commanded tau, (n,), from q, qd and qdd.

    Brakes and motor limits are ignored.
    """
    check_instant(plant)
    _check_payload(plant, 'inverse_dynamics')
    recorder, chain, at = chain_on_lanes(plant, schedule)
    qd, qdd = input_row(recorder, 'qd'), input_row(recorder, 'qdd')
    tau = torques(plant, chain, at, qd, qdd, newton_euler)
    (tau,) = commanded_torques(plant, [tau], (chain, at))
    return program_with_outputs(recorder, tau=tau)


def record_terms(plant: Plant, schedule: str | Schedule) -> Program:
    """Return the program of H, (n, n), and of the bias, (n,), from q and qd."""
    check_instant(plant)
    _check_payload(plant, 'terms')
    recorder, chain, at = chain_on_lanes(plant, schedule)
    bias = torques(plant, chain, at, input_row(recorder, 'qd'), None, newton_euler)
    rows = inertia_matrix(recorder, chain, at, armature(recorder, plant))
    n = recorder.lanes
    elements = [(rows[min(i, j)], max(i, j)) for i in range(n) for j in range(n)]
    recorder.output('H', (n, n), elements)
    return program_with_outputs(recorder, bias=bias)


FORWARD: dict[str, Callable[..., Program]] = {
    'walker_orin_1': record_walker_orin_1,
    'walker_orin_2': record_walker_orin_2,
    'walker_orin_3': record_walker_orin_3,
    'walker_orin_4': record_walker_orin_4,
    'articulated_body': record_articulated_body,
    'pcrbm': partial(record_pcrbm, link_torques=omega_torques),
    'pcrbm_array': partial(record_pcrbm_array, link_torques=omega_torques),
    'pcgm': partial(record_pcgm, link_torques=omega_torques),
    'pcrbm_base_origin': partial(
        record_pcrbm, link_torques=omega_torques, matrix=inertia_matrix_base_origin
    ),
    'divide_and_conquer': record_divide_and_conquer,
    'constraint_forces': record_constraint_forces,
    'composite_body': record_composite_body,
    'grouped_articulated_body': record_grouped_articulated_body,
    'pcrbm_1987': record_pcrbm_1987,
    'pcgm_1987': record_pcgm_1987,
}
# Emulated and counted, not compiled: for comparison with the paper, and a method that needs links
# with a mass and an inertia.
EMULATED = ('pcrbm_1987', 'pcgm_1987', 'constraint_forces')
METHODS = tuple(method for method in FORWARD if method not in EMULATED)
# Methods for one processor; the others have a lane for each joint.
SERIAL = (
    'walker_orin_1',
    'walker_orin_2',
    'walker_orin_3',
    'walker_orin_4',
    'articulated_body',
    'composite_body',
    'grouped_articulated_body',
)
# Methods that take a payload as an input.
PAYLOAD_METHODS = ('composite_body', 'grouped_articulated_body')
# Methods with a repeated part, whose outputs are also `iterations` and `converged`.
ITERATIVE = ('walker_orin_4', 'pcgm')
# They stop when their residual has fallen to the rounding of the number format.
TOLERANCES = {'float64': TOLERANCE, 'float32': TOLERANCE * 2.0**29}


def record_forward_dynamics(
    plant: Plant, method: str, schedule: str | Schedule, tolerance: float | None = None
) -> Program:
    """
    Return the program of a method.

    Its outputs are `qdd`, (n,), and `pivots`, (n,), all above zero exactly if H is positive
    definite, or, for an iterative method, `iterations` and `converged`, (1,). An iterative method
    stops at a tolerance, by default for double precision. ValueError for an unknown method, for
    effects that act over a step of time, and for processors that the method cannot use.
    """
    check_instant(plant)
    choice('method', method, FORWARD)
    _check_payload(plant, method)
    if isinstance(schedule, Schedule) and method in SERIAL:
        if schedule.processors not in (None, 1):
            raise ValueError(
                f'processors must be 1 for the serial method {method!r}, got {schedule.processors}'
            )
        schedule = schedule.name
    if tolerance is None or method not in ITERATIVE:
        return FORWARD[method](plant, schedule)
    return FORWARD[method](plant, schedule, tolerance=tolerance)


def _check_payload(plant: Plant, method: str) -> None:
    """Raise ValueError for a payload as an input of a method that has none."""
    if plant.payload_input and method not in PAYLOAD_METHODS:
        raise ValueError(
            f"a scene with payload='input' needs one of the methods {PAYLOAD_METHODS}, "
            f'got {method!r}'
        )
