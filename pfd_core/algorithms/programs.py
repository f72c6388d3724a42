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
pfd_core.algorithms.chain.interface. A new method is a row of the table: it names the module of
the method, which is imported when the method is first recorded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pfd_core.forking import load, no_fork
from pfd_core.machine.iteration import TOLERANCE
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Schedule
from pfd_core.model import Plant, check_instant
from pfd_core.model.values import choice

PACKAGE = __name__.rpartition('.')[0]


@dataclass(frozen=True)
class Method:
    """
    A method of forward dynamics; a call returns its program.

    Attributes
    ----------
    name : str
        Its name.
    module, record : str
        Module of pfd_core.algorithms, and its function of a plant and a schedule.
    parts : mapping
        Further arguments of the function, which are functions as well: name -> (module, function).
    serial : bool
        Whether it is for one processor; the others have a lane for each joint.
    iterative : bool
        Whether it has a repeated part, with the outputs `iterations` and `converged` and the
        argument `tolerance`.
    payload : bool
        Whether it takes a payload as an input.
    compiled : bool
        Whether kernels offer it; the others are emulated and counted only.

    """

    name: str
    module: str
    record: str
    parts: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    serial: bool = False
    iterative: bool = False
    payload: bool = False
    compiled: bool = True

    def __call__(self, plant: Plant, schedule: str | Schedule, **options: Any) -> Program:
        """Record the program; `options` are further arguments of the method's function."""
        record = load(f'{PACKAGE}.{self.module}', self.record)
        parts = {key: load(f'{PACKAGE}.{m}', f) for key, (m, f) in self.parts.items()}
        program: Program = record(plant, schedule, **parts | options)
        return program


OMEGA = {'link_torques': ('beyond.omega', 'omega_torques')}
BASE_ORIGIN = {'matrix': ('beyond.base_origin', 'inertia_matrix_base_origin')}
_ROWS = (
    Method('walker_orin_1', 'serial.walker_orin', 'record_walker_orin_1', serial=True),
    Method('walker_orin_2', 'serial.walker_orin', 'record_walker_orin_2', serial=True),
    Method('walker_orin_3', 'serial.walker_orin', 'record_walker_orin_3', serial=True),
    Method(
        'walker_orin_4', 'serial.walker_orin', 'record_walker_orin_4', serial=True, iterative=True
    ),
    Method('articulated_body', 'serial.articulated_body', 'record_articulated_body', serial=True),
    Method('pcrbm', 'paper.pcrbm', 'record_pcrbm', OMEGA),
    Method('pcrbm_array', 'paper.pcrbm_array', 'record_pcrbm_array', OMEGA),
    Method('pcgm', 'paper.pcgm', 'record_pcgm', OMEGA, iterative=True),
    Method('pcrbm_base_origin', 'paper.pcrbm', 'record_pcrbm', OMEGA | BASE_ORIGIN),
    Method('divide_and_conquer', 'beyond.divide_and_conquer', 'record_divide_and_conquer'),
    # It needs links with a mass and an inertia.
    Method(
        'constraint_forces', 'beyond.constraint_forces', 'record_constraint_forces', compiled=False
    ),
    Method(
        'composite_body',
        'grouped.composite_body',
        'record_composite_body',
        serial=True,
        payload=True,
    ),
    Method(
        'grouped_articulated_body',
        'grouped.articulated_body',
        'record_grouped_articulated_body',
        serial=True,
        payload=True,
    ),
    # For comparison with the paper.
    Method('pcrbm_1987', 'paper.pcrbm_1987', 'record_pcrbm_1987', compiled=False),
    Method('pcgm_1987', 'paper.pcgm_1987', 'record_pcgm_1987', compiled=False),
)
FORWARD = {method.name: method for method in _ROWS}
METHODS = tuple(method.name for method in _ROWS if method.compiled)
EMULATED_METHODS = tuple(method.name for method in _ROWS if not method.compiled)
SERIAL = tuple(method.name for method in _ROWS if method.serial)
PAYLOAD_METHODS = tuple(method.name for method in _ROWS if method.payload)
ITERATIVE = tuple(method.name for method in _ROWS if method.iterative)
# Iterative methods stop when their residual has fallen to the rounding of the number format.
TOLERANCES = {'float64': TOLERANCE, 'float32': TOLERANCE * 2.0**29}


def record_inverse_dynamics(plant: Plant, schedule: str | Schedule) -> Program:
    """
    Return the program of the commanded tau, (n,), from q, qd and qdd.

    Brakes and motor limits are ignored.
    """
    with no_fork:
        from pfd_core.algorithms.chain.base_axes import chain_on_lanes
        from pfd_core.algorithms.chain.drives import commanded_torques
        from pfd_core.algorithms.chain.equations import torques
        from pfd_core.algorithms.chain.interface import input_row, program_with_outputs
        from pfd_core.algorithms.paper.newton_euler import newton_euler

    check_instant(plant)
    _check_payload(plant, 'inverse_dynamics')
    recorder, chain, at = chain_on_lanes(plant, schedule)
    qd, qdd = input_row(recorder, 'qd'), input_row(recorder, 'qdd')
    tau = torques(plant, chain, at, qd, qdd, newton_euler)
    (tau,) = commanded_torques(plant, [tau], (chain, at))
    return program_with_outputs(recorder, tau=tau)


def record_terms(plant: Plant, schedule: str | Schedule) -> Program:
    """Return the program of H, (n, n), and of the bias, (n,), from q and qd."""
    with no_fork:
        from pfd_core.algorithms.chain.base_axes import chain_on_lanes
        from pfd_core.algorithms.chain.equations import armature, torques
        from pfd_core.algorithms.chain.interface import input_row, program_with_outputs
        from pfd_core.algorithms.paper.newton_euler import newton_euler
        from pfd_core.algorithms.paper.pcrbm import inertia_matrix

    check_instant(plant)
    _check_payload(plant, 'terms')
    recorder, chain, at = chain_on_lanes(plant, schedule)
    bias = torques(plant, chain, at, input_row(recorder, 'qd'), None, newton_euler)
    rows = inertia_matrix(recorder, chain, at, armature(recorder, plant))
    n = recorder.lanes
    elements = [(rows[min(i, j)], max(i, j)) for i in range(n) for j in range(n)]
    recorder.output('H', (n, n), elements)
    return program_with_outputs(recorder, bias=bias)


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
    row = FORWARD[method]
    if isinstance(schedule, Schedule) and row.serial:
        if schedule.processors not in (None, 1):
            raise ValueError(
                f'processors must be 1 for the serial method {method!r}, got {schedule.processors}'
            )
        schedule = schedule.name
    if tolerance is None or not row.iterative:
        return row(plant, schedule)
    return row(plant, schedule, tolerance=tolerance)


def _check_payload(plant: Plant, method: str) -> None:
    """Raise ValueError for a payload as an input of a method that has none."""
    if plant.payload_input and method not in PAYLOAD_METHODS:
        raise ValueError(
            f"a scene with payload='input' needs one of the methods {PAYLOAD_METHODS}, "
            f'got {method!r}'
        )
