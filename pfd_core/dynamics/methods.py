# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Methods of forward dynamics: the table FORWARD, one row each.

    H(q) qdd + C(q, qd) qd + G(q) = tau        Lee and Chang 1987, eq. (1)

Kernels, emulation and the tables of the documentation follow from the rows. A new method is a row,
which names the module with the function that records its program, record_<name of the method>; it
is imported when the method is first recorded. Inputs are described in pfd_core.dynamics.

On n lanes all METHODS, which kernels offer, take our form of the bias, which has fewer steps than
the paper's NE1 (pfd_core.paper.newton_euler).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pfd_core.forking import load
from pfd_core.model.plant import Plant, check_instant
from pfd_core.model.values import choice, quote

if TYPE_CHECKING:
    from pfd_core.machine.program import Program


@dataclass(frozen=True)
class Method:
    """A method of forward dynamics; a call returns its program."""

    name: str
    title: str  # what it is called on pages
    module: str  # of pfd_core; its record_<name> takes a plant, and for n lanes a schedule
    # Whether it has a repeated part, the outputs `iterations` and `converged`, and the argument
    # `tolerance`.
    iterative: bool = False
    payload: bool = False  # whether it takes numbers of a plant as inputs
    followers: bool = True  # of a serial one, whether it takes joints that move with others
    compiled: bool = True  # whether kernels offer it; the others are emulated and counted only

    @property
    def serial(self) -> bool:
        """Whether it is for one processor; the others have a lane for each joint."""
        return self.module.startswith('dynamics.')

    def __call__(self, plant: Plant, schedule: str, **options: Any) -> Program:
        """Record the program; `options` are further arguments of the method's function."""
        place = () if self.serial else (schedule,)
        program: Program = load(f'{self.module}.record_{self.name}')(plant, *place, **options)
        return program


_ROWS = (
    Method('walker_orin_1', "Walker and Orin's method 1", 'dynamics.composite'),
    Method('walker_orin_2', "Walker and Orin's method 2", 'dynamics.composite'),
    Method('walker_orin_3', "Walker and Orin's method 3", 'dynamics.composite'),
    Method('walker_orin_4', "Walker and Orin's method 4", 'dynamics.conjugate', iterative=True),
    Method(
        *('articulated_body', "Featherstone's articulated-body method", 'dynamics.articulated'),
        followers=False,
    ),
    Method('pcrbm', 'Parallel composite rigid bodies', 'paper.composite'),
    Method(
        'pcrbm_array', 'Parallel composite rigid bodies with the triangular array', 'paper.array'
    ),
    Method('pcgm', 'Parallel conjugate gradients', 'paper.conjugate', iterative=True),
    Method('pcrbm_base_origin', 'PCRBM about the base origin', 'paper.composite'),
    Method(
        *('divide_and_conquer', 'Divide and conquer, after Featherstone 1999'),
        'paper.divide_and_conquer',
    ),
    Method(
        *('articulated_body_doubling', 'Articulated bodies by recursive doubling'),
        'paper.articulated_doubling',
    ),
    # It needs links with a mass and an inertia.
    Method(
        *('constraint_forces', "Constraint forces, after Fijany, Sharf and D'Eleuterio 1995"),
        'paper.constraint_forces',
        compiled=False,
    ),
    Method(
        *('composite_body', 'Composite bodies with grouped parameters, for kernels'),
        'dynamics.composite',
        payload=True,
    ),
    Method(
        *('grouped_articulated_body', 'Articulated bodies with grouped parameters, for kernels'),
        'dynamics.articulated',
        payload=True,
        followers=False,
    ),
    Method(
        *('pcrbm_1987', 'PCRBM step by step as in the paper, for comparison', 'paper.composite'),
        compiled=False,
    ),
    Method(
        *('pcgm_1987', 'PCGM step by step as in the paper, for comparison', 'paper.conjugate'),
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
    check_followers(plant, method)
    row = FORWARD[method]
    options = {'tolerance': tolerance} if row.iterative and tolerance is not None else {}
    return row(plant, schedule, **options)


def check_payload(plant: Plant, method: str) -> None:
    """Raise ValueError for numbers as inputs of a method that takes none."""
    if plant.varied and method not in PAYLOAD_METHODS:
        raise ValueError(
            "a scene with payload='input', or an ensemble with parameters, needs one of the "
            f'methods {PAYLOAD_METHODS}, got {method!r}'
        )


def check_followers(plant: Plant, method: str) -> None:
    """Raise ValueError for a robot with followers and a method that takes none."""
    taken = tuple(row.name for row in _ROWS if row.serial and row.followers)
    if plant.robot.followers and method not in taken:
        raise ValueError(
            f'{quote(plant.robot.followers[0].name)} of {quote(plant.robot.name)} follows another '
            f'joint, which needs one of the methods {taken}, got {method!r}'
        )
