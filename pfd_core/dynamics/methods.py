# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Methods of forward dynamics: the table FORWARD, one row each.

    H(q) qdd + C(q, qd) qd + G(q) = tau        Lee and Chang 1987, eq. (1)

Kernels, emulation and the tables of the documentation follow from the rows. A new method is a row,
which names the function that records its program; its module is imported when the method is first
recorded. Inputs are described in pfd_core.dynamics.interface.

On n lanes all METHODS, which kernels offer, take our form of the bias, which has fewer steps than
the paper's NE1 (pfd_core.paper.newton_euler).
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
    title : str
        What it is called on pages.
    record : str
        'module.function' of pfd_core, a function of a plant, and of a schedule for n lanes.
    parts : mapping
        Further arguments of the function by name, which are such functions as well.
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
    title: str
    record: str
    parts: Mapping[str, str] = field(default_factory=dict)
    serial: bool = False
    iterative: bool = False
    payload: bool = False
    compiled: bool = True

    def __call__(self, plant: Plant, schedule: str, **options: Any) -> Program:
        """Record the program; `options` are further arguments of the method's function."""
        parts = {name: load(path) for name, path in self.parts.items()}
        place = () if self.serial else (schedule,)
        program: Program = load(self.record)(plant, *place, **parts | options)
        return program


BASE_ORIGIN = {'matrix': 'paper.composite.inertia_matrix_base_origin'}
_ROWS = (
    *(
        Method(
            f'walker_orin_{k}',
            f"Walker and Orin's method {k}",
            f'dynamics.{module}.record_walker_orin_{k}',
            serial=True,
            iterative=k == 4,
        )
        for k, module in enumerate(('composite', 'composite', 'composite', 'conjugate'), 1)
    ),
    Method(
        'articulated_body',
        "Featherstone's articulated-body method",
        'dynamics.articulated.record_articulated_body',
        serial=True,
    ),
    Method('pcrbm', 'Parallel composite rigid bodies', 'paper.composite.record_pcrbm'),
    Method(
        'pcrbm_array',
        'Parallel composite rigid bodies with the triangular array',
        'paper.array.record_pcrbm_array',
    ),
    Method(
        'pcgm',
        'Parallel conjugate gradients',
        'paper.conjugate.record_pcgm',
        iterative=True,
    ),
    Method(
        'pcrbm_base_origin',
        'PCRBM about the base origin',
        'paper.composite.record_pcrbm',
        BASE_ORIGIN,
    ),
    Method(
        'divide_and_conquer',
        'Divide and conquer, after Featherstone 1999',
        'paper.divide_and_conquer.record_divide_and_conquer',
    ),
    # It needs links with a mass and an inertia.
    Method(
        'constraint_forces',
        "Constraint forces, after Fijany, Sharf and D'Eleuterio 1995",
        'paper.constraint_forces.record_constraint_forces',
        compiled=False,
    ),
    Method(
        'composite_body',
        'Composite bodies with grouped parameters, for kernels',
        'dynamics.composite.record_composite_body',
        serial=True,
        payload=True,
    ),
    Method(
        'grouped_articulated_body',
        'Articulated bodies with grouped parameters, for kernels',
        'dynamics.articulated.record_grouped_articulated_body',
        serial=True,
        payload=True,
    ),
    Method(
        'pcrbm_1987',
        'PCRBM step by step as in the paper, for comparison',
        'paper.composite.record_pcrbm_1987',
        compiled=False,
    ),
    Method(
        'pcgm_1987',
        'PCGM step by step as in the paper, for comparison',
        'paper.conjugate.record_pcgm_1987',
        compiled=False,
    ),
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
