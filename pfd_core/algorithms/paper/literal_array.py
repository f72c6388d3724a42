# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The paper's Cholesky factorisation as printed, on n processors and on the triangular array.

Neither yields the Cholesky factor of a matrix in general; both return the residual and a status.
The equations (11), (12) in the order of Procedure Set-Ordering are recorded in
pfd_core.algorithms.paper.set_ordering and run here; the array:

    C_ki^(1) = h_ki,  C_ki^(m+1) = C_ki^(m) - h_im h_km      eqs (29), (30)
    l_kk = sqrt(C_kk^(k)),  l_ki = C_ki^(i) / h_ii           eq. (31)

Lee and Chang 1987, section 2.6, Figures 1 and 2. The drawing of Figure 1 is not available;
the streams are reconstructed from the description. Row 1 is at the bottom. Column i gets
h_ii ... h_ni and the flag * from below, from cycle 3i - 2; row k gets h_(k+1)k ... h_nk, h_kk from
the left, from cycle 2k. A cell keeps the first item that comes from below, h_ki, and sends the
others on. The times of the paper follow: h_n1 is stored at 2n - 1, h_nn and the flag meet
in P_n1 at 2n, the last result leaves at 3n - 1. (That all input is stored after 2n - 1 cycles
holds for column 1 only; h_nn is stored in P_nn at 3n - 2.) The result is the matrix of equations
(11) and (12): for PUMA 560, UR5 and Panda a wrong matrix, or the root of a negative number.
pfd_core.algorithms.paper.triangular_array is the design that works.

The paper calls h_ij the elements of H. Were each h_ki replaced by l_ki as soon as that is known,
(11), (12) and (29) to (31) would be Cholesky's, column after column; the products could then not
be formed first, as Procedure Set-Ordering has it.

Misprints of Figure 2: the square cell's second result is C_out, not u_out. Its condition
u_in = h_ki compares numbers, and an equal element further down the stream would be kept too;
here it means the first item.

Parallel cost: 3n - 1 cycles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.algorithms.paper.array_solver import square_matrix
from pfd_core.algorithms.paper.set_ordering import record_literal_cholesky
from pfd_core.algorithms.paper.triangular_array import (
    DIVIDE,
    FLAG,
    MULTIPLY,
    ROOT,
    Item,
    into,
    quotient,
    root,
    triangle,
)
from pfd_core.machine.emulator import run
from pfd_core.paper.systolic import Link, Ports, Step, Trace

STORE = 'store'


@dataclass(frozen=True)
class Literal:
    """
    Result of equations (11) and (12) for a matrix.

    Attributes
    ----------
    L : numpy.ndarray
        (n, n), lower triangle; NaN for the root of a negative number.
    residual : float
        max|L L' - H| / max|H|; NaN if L is not finite.
    status : str
        'ok' if L L' = H within rounding, 'wrong_matrix' if it is not; 'negative_radicand' if
        some l_kk does not exist, 'not_finite' if an h_ii that divides is zero.

    """

    L: NDArray[Any]
    residual: float
    status: str


def literal_cholesky(H: ArrayLike) -> Literal:
    """
    Run equations (11) and (12) on n emulated processors.

    Parameters
    ----------
    H : array_like
        (n, n), symmetric; the lower triangle is read.

    Raises
    ------
    ValueError
        If H is not a square matrix of finite numbers.

    """
    H = square_matrix(H)
    result = run(record_literal_cholesky(len(H), 'parallel'), {'H': H.ravel()})
    return checked(H, result['L'])


def checked(H: NDArray[Any], L: NDArray[Any]) -> Literal:
    """Return a would-be factor of a matrix with its residual and status."""
    n = len(H)
    lower = np.tril_indices(n)
    if not np.isfinite(L.astype(np.float64)).all():
        roots = np.diag(L).astype(np.float64)
        return Literal(L, np.nan, 'negative_radicand' if np.isnan(roots).any() else 'not_finite')
    size = float(max(abs(H[lower])))
    difference = (L @ L.T - H)[lower].astype(np.float64)
    residual = float(abs(difference).max()) / size if size else 0.0
    # The bound of Cholesky's backward error: |L L' - H| <= (n + 1) u max|H|, u half of eps.
    eps = float(np.finfo(L.dtype if L.dtype != object else np.float64).eps)
    return Literal(L, residual, 'ok' if residual <= (n + 1) * eps else 'wrong_matrix')


def literal_circular(u: Any, ports: Ports) -> Step:
    """Keep h_kk, divide by it, take the root at the flag: Figure 2 (a)."""
    item, below = ports['left'], ports['down']
    if u is None:
        return Step(below.value, {}, STORE)
    if below.mark == FLAG:
        return Step(u, {'up': below, 'right': Item(root(item.value))}, ROOT)
    return Step(u, {'up': below, 'right': Item(quotient(item.value, u))}, DIVIDE)


def literal_square(u: Any, ports: Ports) -> Step:
    """Keep h_ki, the first to come, and subtract its products: Figure 2 (b)."""
    item, below = ports['left'], ports['down']
    if u is None:
        return Step(below.value, {}, STORE)
    rest = Item(item.value - u * (u if below.mark == FLAG else below.value))
    return Step(u, {'up': below, 'right': rest}, MULTIPLY)


@dataclass(frozen=True)
class LiteralRun:
    """Result of the literal design for a matrix, and the record of the array's run."""

    result: Literal
    trace: Trace


def literal_array(H: ArrayLike) -> LiteralRun:
    """
    Run the literal design on a matrix.

    Parameters
    ----------
    H : array_like
        (n, n), symmetric: floats or mpmath numbers; the lower triangle is read.

    Raises
    ------
    ValueError
        If H is not a square matrix of finite numbers.

    """
    H = square_matrix(H)
    n = len(H)
    array = triangle(n, literal_circular, literal_square, back=False)
    with np.errstate(all='ignore'):
        trace = array.run(literal_streams(H))
    L = np.zeros_like(H)
    for k in range(n):
        *off_diagonal, diagonal = trace.leaving((k + 1, k + 1), 'right')
        L[k + 1 :, k] = [item.value for item in off_diagonal]
        L[k, k] = diagonal.value
    return LiteralRun(checked(H, L), trace)


def literal_streams(H: NDArray[Any]) -> dict[Link, dict[int, Item]]:
    """Return the items that enter columns from below and rows from the left, by cycle."""
    n = len(H)
    streams: dict[Link, dict[int, Item]] = {}
    for k in range(n):
        below = [Item(H[m, k]) for m in range(k, n)] + [Item(None, FLAG)]
        left = [Item(H[m, k]) for m in range(k + 1, n)] + [Item(H[k, k])]
        streams[into((k + 1, k + 1), 'down')] = dict(enumerate(below, 3 * k + 1))
        streams[into((k + 1, 1), 'left')] = dict(enumerate(left, 2 * k + 2))
    return streams
