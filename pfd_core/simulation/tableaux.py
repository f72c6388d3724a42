# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Integrators as data: a step of length r of q'' = f(q, q'), with s evaluations f.

    K_i = f(Q_i, V_i)
    Q_i = q + r c_i v + r^2 sum_j Ab_ij K_j        V_i = v + r sum_j A_ij K_j
    q'  = q + r v     + r^2 sum_j bb_j  K_j        v'  = v + r sum_j b_j  K_j

A Runge-Kutta method has Ab = A A and bb = b A (Nystrom form); other methods state them.

imex2 is ARS(2, 2, 2): U. M. Ascher, S. J. Ruuth, R. J. Spiteri, Implicit-explicit Runge-Kutta
methods for time-dependent partial differential equations, Applied Numerical Mathematics 25 (1997),
2.6. Without damping it is the explicit method of its row. With a damping D it is partly implicit:
each stage solves

    (H + c r D) V = H w,   V = w - c r (H + c r D)^-1 D w,   c the diagonal coefficient

(pfd_core.simulation.stages). The positions take the weights of the velocities. It is L-stable in
D.

A new explicit integrator is a row, and every scene takes it, friction and stops included. The
implicit stages are those of imex2 alone.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
import math

Row = tuple[float, ...]


def of_stages(weights: Iterable[float], A: Iterable[Iterable[float]]) -> Row:
    """Return weights @ A by the same bits on every processor, unlike `@` of NumPy."""
    columns = (zip(weights, column, strict=True) for column in zip(*A, strict=True))
    return tuple(math.fsum(w * x for w, x in pairs) for pairs in columns)


@dataclass(frozen=True)
class Tableau:
    """The coefficients of an integrator of s stages: explicit, but for a damping if `implicit`."""

    c: Row  # times of the stages as parts of the step, (s,)
    A: tuple[Row, ...]  # weights of K in velocities of stages, (s, s), zero from the diagonal on
    b: Row  # weights of K in v', (s,)
    order: int  # power of r with which the error of a motion falls
    # Weights of K in positions; default b A and A A.
    b_bar: Row = ()
    A_bar: tuple[Row, ...] = ()
    # Diagonal coefficient c of the implicit stages, in a scene with damping; 0 for none.
    implicit: float = 0.0
    shared: bool = False  # whether the last evaluation of a step may be the first of the next
    # Of an embedded pair (pfd_core.simulation.embedded_pairs): the stage at the end of the step;
    # the weights of its two error estimates, (2, s), the higher order first; and the weights of
    # its dense output from the fourth row on, (4, s).
    end: int = 0
    estimates: tuple[Row, ...] = ()
    tail: tuple[Row, ...] = ()

    def __post_init__(self) -> None:
        """Write bb = b A and Ab = A A where no other weights of the positions are given."""
        if not self.b_bar:
            object.__setattr__(self, 'b_bar', of_stages(self.b, self.A))
            object.__setattr__(self, 'A_bar', tuple(of_stages(row, self.A) for row in self.A))

    @property
    def stages(self) -> int:
        """The number of evaluations of a step."""
        return len(self.c)

    @property
    def slope(self) -> int | None:
        """The last stage if its time is the end: its K is close to the acceleration there."""
        return self.stages - 1 if self.c[-1] == 1 else None


# Diagonal coefficient of the implicit stages of imex2, and weight of its first explicit stage.
IMEX_DIAGONAL = 1 - 1 / math.sqrt(2)
IMEX_FIRST = 1 - 1 / (2 * IMEX_DIAGONAL)

TABLEAUX = {
    'rk4': Tableau(
        c=(0.0, 0.5, 0.5, 1.0),
        A=((0.0,) * 4, (0.5, 0.0, 0.0, 0.0), (0.0, 0.5, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)),
        b=(1 / 6, 1 / 3, 1 / 3, 1 / 6),
        order=4,
    ),
    # The forces of an arm depend on the velocity, which is predicted for the second evaluation.
    'velocity_verlet': Tableau(
        c=(0.0, 1.0),
        A=((0.0, 0.0), (1.0, 0.0)),
        b=(0.5, 0.5),
        order=2,
        A_bar=((0.0, 0.0), (0.5, 0.0)),
        b_bar=(0.5, 0.0),
        shared=True,
    ),
    'imex2': Tableau(
        c=(0.0, IMEX_DIAGONAL),
        A=((0.0, 0.0), (IMEX_DIAGONAL, 0.0)),
        b=(IMEX_FIRST, 1 - IMEX_FIRST),
        order=2,
        A_bar=((0.0, 0.0), (IMEX_DIAGONAL**2, 0.0)),
        b_bar=(
            (1 - IMEX_DIAGONAL) * IMEX_DIAGONAL + IMEX_DIAGONAL * IMEX_FIRST,
            IMEX_DIAGONAL * (1 - IMEX_FIRST),
        ),
        implicit=IMEX_DIAGONAL,
    ),
}
INTEGRATORS = ('auto', *TABLEAUX)
