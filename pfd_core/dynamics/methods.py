# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Methods of forward dynamics by name: the table FORWARD, whose rows name modules.

    H(q) qdd + C(q, qd) qd + G(q) = tau        Lee and Chang 1987, eq. (1)

    walker_orin_1 .. 4, articulated_body       serial, which the paper compares with
    pcrbm, pcrbm_array, pcgm                   the paper's, on n lanes, corrected
    pcrbm_1987, pcgm_1987                      the paper's step by step, for comparison with it
    pcrbm_base_origin, divide_and_conquer, constraint_forces   beyond the paper, on n lanes
    composite_body, grouped_articulated_body   serial methods at their cheapest, for kernels

On n lanes all METHODS, which kernels offer, take the bias from pfd_core.algorithms.beyond.omega,
which has fewer steps than the paper's NE1. Inputs are described in pfd_core.dynamics.interface. A
new method is a row of the table: its module is imported when the method is first recorded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from pfd_core.forking import load
from pfd_core.model import Plant, check_instant
from pfd_core.model.values import choice

if TYPE_CHECKING:
    from pfd_core.machine.program import Program


@dataclass(frozen=True)
class Method:
    """
    A method of forward dynamics; a call returns its program.

    Attributes
    ----------
    name : str
        Its name.
    module, record : str
        Module of pfd_core, and its function of a plant, and of a schedule for n lanes.
    parts : mapping
        Further arguments of the function, which are functions as well: name -> (module, function).
    serial : bool
        Whether it is for one processor; the others have a lane for each joint.
    iterative : bool
        Whether it has a repeated part, with the outputs `iterations` and `converged` and the
        argument `tolerance`.
    payload : bool
        Whether it takes numbers of a plant as inputs, such as those of a payload.
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

    def __call__(self, plant: Plant, schedule: str, **options: Any) -> Program:
        """Record the program; `options` are further arguments of the method's function."""
        record = load(f'pfd_core.{self.module}', self.record)
        parts = {key: load(f'pfd_core.{m}', f) for key, (m, f) in self.parts.items()}
        place = () if self.serial else (schedule,)
        program: Program = record(plant, *place, **parts | options)
        return program


OMEGA = {'link_torques': ('algorithms.beyond.omega', 'omega_torques')}
BASE_ORIGIN = {'matrix': ('algorithms.beyond.base_origin', 'inertia_matrix_base_origin')}
_ROWS = (
    Method('walker_orin_1', 'dynamics.composite', 'record_walker_orin_1', serial=True),
    Method('walker_orin_2', 'dynamics.composite', 'record_walker_orin_2', serial=True),
    Method('walker_orin_3', 'dynamics.composite', 'record_walker_orin_3', serial=True),
    Method(
        'walker_orin_4', 'dynamics.conjugate', 'record_walker_orin_4', serial=True, iterative=True
    ),
    Method('articulated_body', 'dynamics.articulated', 'record_articulated_body', serial=True),
    Method('pcrbm', 'algorithms.paper.pcrbm', 'record_pcrbm', OMEGA),
    Method('pcrbm_array', 'algorithms.paper.pcrbm_array', 'record_pcrbm_array', OMEGA),
    Method('pcgm', 'algorithms.paper.pcgm', 'record_pcgm', OMEGA, iterative=True),
    Method('pcrbm_base_origin', 'algorithms.paper.pcrbm', 'record_pcrbm', OMEGA | BASE_ORIGIN),
    Method(
        'divide_and_conquer', 'algorithms.beyond.divide_and_conquer', 'record_divide_and_conquer'
    ),
    # It needs links with a mass and an inertia.
    Method(
        'constraint_forces',
        'algorithms.beyond.constraint_forces',
        'record_constraint_forces',
        compiled=False,
    ),
    Method(
        'composite_body', 'dynamics.composite', 'record_composite_body', serial=True, payload=True
    ),
    Method(
        'grouped_articulated_body',
        'dynamics.articulated',
        'record_grouped_articulated_body',
        serial=True,
        payload=True,
    ),
    # For comparison with the paper.
    Method('pcrbm_1987', 'algorithms.paper.pcrbm_1987', 'record_pcrbm_1987', compiled=False),
    Method('pcgm_1987', 'algorithms.paper.pcgm_1987', 'record_pcgm_1987', compiled=False),
)
FORWARD = {method.name: method for method in _ROWS}
METHODS = tuple(method.name for method in _ROWS if method.compiled)
EMULATED_METHODS = tuple(method.name for method in _ROWS if not method.compiled)
SERIAL = tuple(method.name for method in _ROWS if method.serial)
PAYLOAD_METHODS = tuple(method.name for method in _ROWS if method.payload)
ITERATIVE = tuple(method.name for method in _ROWS if method.iterative)


def record_forward_dynamics(
    plant: Plant, method: str, schedule: str, tolerance: float | None = None
) -> Program:
    """
    Return the program of a method.

    Its outputs are `qdd`, (n,), and `pivots`, (n,), all above zero exactly if H is positive
    definite, or, for an iterative method, `iterations` and `converged`, (1,). An iterative method
    stops at a tolerance, by default for double precision. ValueError for an unknown method and for
    effects that act over a step of time.
    """
    check_instant(plant)
    choice('method', method, FORWARD)
    check_payload(plant, method)
    row = FORWARD[method]
    if tolerance is None or not row.iterative:
        return row(plant, schedule)
    return row(plant, schedule, tolerance=tolerance)


def check_payload(plant: Plant, method: str) -> None:
    """Raise ValueError for numbers as inputs of a method that takes none."""
    if plant.varied and method not in PAYLOAD_METHODS:
        raise ValueError(
            "a scene with payload='input', or an ensemble with parameters, needs one of the "
            f'methods {PAYLOAD_METHODS}, got {method!r}'
        )
