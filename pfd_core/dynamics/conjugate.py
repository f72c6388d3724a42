# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Forward dynamics by conjugate gradients on one processor: method 4 of Walker and Orin (1982).

H qdd = y is solved without H: H u are the torques of the accelerations u at rest, without gravity.
In exact arithmetic n iterations are enough. With rounding the directions lose their orthogonality:
skew chains of 32 joints take 90 iterations, with masses from 1 to 1e4 140, in float32 ten times as
many; in float64 six joints take 7 to 12, seen on 3000 states of three arms.

Serial cost, rotational joints of a skew chain, no wrench, besides the parts before H in
pfd_core.dynamics.composite:

    part      multiplications    additions
    start     n + 1              n - 1
    H u       68n - 67           56n - 62       an iteration, n > 1
    CG        5n                 5n - 2         an iteration, and 2 divisions
    status    0                  2              and 1 division

For n = 6 in 6 iterations that is 2738 and 2279. Lee and Chang 1987, Table 1, have formulas that
give 2805 and 2532 and print 3435 and 2532: with 117n instead of 12n the first would.
"""

from __future__ import annotations

from collections.abc import Sequence
import operator
from typing import Any

from pfd_core.dynamics.chain import chain_of
from pfd_core.dynamics.links import GIVEN
from pfd_core.dynamics.newton_euler import right_side, torques
from pfd_core.dynamics.numbers import free_input, rotors
from pfd_core.machine.iteration import TOLERANCE, iterate
from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes
from pfd_core.model.plant import Plant

ITERATIONS_PER_JOINT = 20
SPARE_ITERATIONS = 10


def record_walker_orin_4(plant: Plant, tolerance: float = TOLERANCE) -> Program:
    """
    Return the program of conjugate gradients from zero, without braked joints.

    The iteration ends when the residual has fallen by the factor `tolerance`, at least 0 and below
    1, or after 20 n + 10 iterations. Outputs are qdd, (n,), `iterations`, (1,), the
    number taken, and `converged`, (1,), one if the residual fell below the tolerance. It is zero
    if the iterations ran out, if H was found not positive definite (u'Hu <= 0; qdd is then the
    iterate so far) or with NaN and infinity. ValueError for a tolerance out of range.
    """
    if not 0 <= tolerance < 1:
        raise ValueError(f'tolerance must be at least 0 and below 1, got {tolerance}')
    chain = chain_of(plant, GIVEN)
    recorder, n = chain.recorder, plant.robot.n
    own = rotors(recorder, plant)
    free = free_input(recorder, plant)
    y = _released(free, right_side(chain))
    with recorder.section('start'):
        first = _inner(y, y)
        enough = (tolerance * tolerance) * first

    def step(*state: Lanes) -> tuple[tuple[Lanes, ...], Lanes]:
        u = state[2 * n : 3 * n]
        with recorder.section('H u'):
            t = torques(chain, [0.0] * n, u, loads=False)
            t = _released(free, [a + r * b for a, r, b in zip(t, own, u, strict=True)])
        with recorder.section('conjugate gradient'):
            return _step(state, t)

    start = (*[recorder.constant(0.0)] * n, *y, *y, first)
    at_most = ITERATIONS_PER_JOINT * n + SPARE_ITERATIONS
    state, iterations = iterate(step, start, first, at_most, floor=enough)
    with recorder.section('status'):
        # NaN is not above `enough`; like infinity, it fails the test of 1 / (1 + e).
        finite = where(1.0 / (1.0 + state[-1]), 1.0, 0.0)
        converged = where(state[-1] - enough, 0.0, finite)
    return recorder.program(qdd=state[:n], iterations=[iterations], converged=[converged])


def _step(state: Sequence[Lanes], t: Sequence[Lanes]) -> tuple[tuple[Lanes, ...], Lanes]:
    """Return x, residual w, direction u and e = w.w after a step along u, for t = H u; and e."""
    n = len(t)
    x, w, u, e = state[:n], state[n : 2 * n], state[2 * n : 3 * n], state[-1]
    curvature = _inner(u, t)
    # Without positive curvature the state stays as it is and the iteration ends.
    alpha = where(curvature, e / where(curvature, curvature, 1.0), 0.0)
    x = [a + alpha * b for a, b in zip(x, u, strict=True)]
    w = [a - alpha * b for a, b in zip(w, t, strict=True)]
    following = _inner(w, w)
    beta = following / where(e, e, 1.0)
    u = [a + beta * b for a, b in zip(w, u, strict=True)]
    return (*x, *w, *u, following), where(curvature, following, 0.0)


def _inner(a: Sequence[Lanes], b: Sequence[Lanes]) -> Any:
    return sum(map(operator.mul, a, b), 0.0)


def _released(free: Sequence[Lanes] | None, values: Sequence[Lanes]) -> list[Lanes]:
    """Return values, zero for braked joints; all of them without brakes (free is None)."""
    if free is None:
        return list(values)
    return [where(moves, value, 0.0) for moves, value in zip(free, values, strict=True)]
