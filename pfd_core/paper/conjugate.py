# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
PCGM: H qdd = tau - bias by conjugate gradients, H times a vector by the Newton-Euler method.

    1 to 3  0R_i, z_i, p*_i, s_i, J_i, bias
    4       y = tau - b,  w_0 = y - H x_0,  u_0 = w_0                     (printed: w_0 = y)
    5, 6    e_0 = w_0' w_0;  stop if it is zero
    7       t = H u by NE1                                                (printed: also x_1 = t)
    8       g = e / u't
    9, 10   x <- x + g u;  stop in iteration n
    11      w <- w - g t
    12, 13  e' = w' w;  stop if it is zero
    14, 15  u <- w + (e'/e) u
    16      back to step 7                                                (printed: 5)

Lee and Chang 1987, section 3 and Appendix B, after Walker and Orin 1982, method 4. The misprints
are in pfd_core.paper.editions. The paper's form ends with step 10 of iteration n, so that steps 11
to 16 are run n - 1 times; item (d) counts them n times.

n iterations give the answer in exact arithmetic only: with rounding e is hardly ever zero beyond
one joint, and the directions lose their orthogonality (docs/report/counts.md). Ours stops at
e <= tolerance^2 y'y; a direction with u't <= 0 ends the iteration. The recursive residual that the
stop reads is no measure of the error; pfd.emulate estimates that by the equations of motion.

Parallel cost of an iteration, rotational joints, L = ceil(log2 n), n > 1: 47 multiplications,
14 L + 32 additions and 2 divisions; back to step 5 as printed 1 multiplication and L additions
more; the last one ends before 3 and L + 2 of these and a division. The paper prints 49, divisions
among them, and 14 L + 30. Before the iteration the paper's form takes 27 L + 151 multiplications
and 34 L + 108 additions with R_i given, with twists of 0 and 90 degrees 22 and 17 fewer; it prints
27 L + 124 and 34 L + 87. Our form takes 182 + 47 k multiplications, 2 k divisions, 189 + 62 k
additions and 214 + 116 k routes for k iterations at n = 6; the paper 499 and 621 for k = 6.

Lane i holds link i + 1 and component i + 1 of every vector of n numbers; sums lie on lane 0 and
are broadcast.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from pfd_core.machine.iteration import TOLERANCE, iterate, leave_the_last
from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes
from pfd_core.model.plant import Plant
from pfd_core.paper.editions import OURS, STEP_4, STEP_7, STEP_16, Edition, edition_of
from pfd_core.paper.lanes import broadcast
from pfd_core.paper.newton_euler import forward_equations, inertia_times
from pfd_core.paper.patterns import total


def most_iterations(n: int) -> int:
    """Return the largest number of iterations of our form for n joints."""
    # Walks through directions that rounding has made dependent take a multiple of n; the hardest
    # chains of up to 30 joints need 6 n.
    return 12 * n + 20


def record_pcgm(
    plant: Plant,
    schedule: str,
    *,
    start: bool = False,
    tolerance: float = TOLERANCE,
    edition: Edition = OURS,
) -> Program:
    """
    Return the program of qdd, (n,), iterations and converged, (1,), from q, qd and tau.

    With `start` an input of this name, (n,), is the first estimate of qdd instead of zero. Our
    form stops when the residual has fallen by the factor `tolerance`, or after most_iterations(n);
    the paper's, which packs nothing, after n.
    """
    chain, y = forward_equations(plant, schedule, edition)
    recorder = chain.recorder
    free = recorder.input_row('free') if plant.brakes else None

    def free_part(x: Lanes) -> Any:
        return x if free is None else where(free, x, 0.0)

    def times(u: Lanes) -> Any:
        return free_part(inertia_times(chain, u, packs=not edition.printed))

    w = y = free_part(y)
    x = free_part(recorder.input_row('start')) if start else recorder.constant(0.0)
    if start and not edition.has(STEP_4):
        with recorder.section('step 4'):
            w = y - times(x)
    with recorder.section('first inner product'):
        e, floor = total(w * w), None
        if not edition.printed:
            # Of y, not of the residual of the start: after a good start few iterations are needed.
            floor = (tolerance * tolerance) * (e if w is y else total(y * y))

    def step(x: Lanes, w: Lanes, u: Lanes, e: Lanes) -> tuple[tuple[Lanes, ...], Any]:
        with recorder.section('step 7'):
            t = times(u)
            x = t if edition.has(STEP_7) else x
        with recorder.section('step 8'):
            ut = total(u * t)
            g = broadcast(e / ut if edition.printed else where(ut, e / ut, 0.0), 0)
        with recorder.section('step 9'):
            x = x + g * u
        if edition.printed:
            leave_the_last(recorder)
        with recorder.section('step 11'):
            w = w - g * t
        with recorder.section('step 12'):
            after = total(w * w)
        with recorder.section('steps 14, 15'):
            u = w + broadcast(after / e, 0) * u
        if edition.has(STEP_16):
            with recorder.section('step 5'):
                after = total(w * w)
        return (x, w, u, after), after if edition.printed else where(ut, after, 0.0)

    n = recorder.lanes
    at_most = n if edition.printed else most_iterations(n)
    (x, _, _, last), iterations = iterate(step, (x, w, w, e), e, at_most, floor=floor)
    converged = recorder.constant(1.0)
    if floor is not None:
        with recorder.section('convergence'):
            # One if e <= limit, zero residuals included; NaN fails the comparison with minus one.
            converged = where(last - floor, 0.0, where(last + 1.0, 1.0, 0.0))
    return recorder.program(iterations=[iterations], converged=[converged], qdd=x)


def record_pcgm_1987(
    plant: Plant, schedule: str, *, misprints: Collection[str] = (), start: bool = False
) -> Program:
    """Return PCGM in the paper's form, with misprints taken as printed by name."""
    return record_pcgm(plant, schedule, start=start, edition=edition_of('pcgm_1987', misprints))
