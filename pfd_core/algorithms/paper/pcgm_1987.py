# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Procedure PCGM step by step as the paper prints it: n iterations, H u by NE1.

    1, 2    0R_i by FOHRA;  z_i, p*_i, s_i, J_i in base axes
    3       b by NE1
    4       y = tau - b,  w_0 = u_0 = y - H x_0                       (printed: y)
    5, 6    e_0 = w_0' w_0;  stop if it is zero
    7       t = H u_i by NE1                                          (printed: also x_1 = t)
    8       g_i = e_i / u_i't
    9, 10   x_(i+1) = x_i + g_i u_i;  stop if i = n - 1
    11      w_(i+1) = w_i - g_i t
    12, 13  e_(i+1) = w_(i+1)' w_(i+1);  stop if it is zero
    14, 15  u_(i+1) = w_(i+1) + (e_(i+1)/e_i) u_i
    16      i = i + 1, back to step 7                                 (printed: 5)

Lee and Chang 1987, section 3. Corrected, and nothing else: step 4 for an estimate x_0 that is not
zero, step 7, which leaves x unchanged, and the number in step 16. MISPRINTS names the parts that
can run as printed. Here steps 11 to 15 also run in the last iteration, as item (d) counts them.

n iterations give the answer in exact arithmetic only. Output `converged` is always one, since the
procedure ends in any case; pfd_core.dynamics.convergence checks afterwards whether qdd satisfies
the equations of motion. pfd_core.algorithms.paper.pcgm iterates until it has converged.

Parallel cost, rotational joints, L = ceil(log2 n), n > 1, R_i given: 27 L + 151 multiplications
and 34 L + 108 additions, and in each of n iterations 47 multiplications, 14 L + 32 additions and 2
divisions; back to step 5 as printed 1 multiplication and L additions more. The paper prints
27 L + 124, 34 L + 87, 49 (divisions among them) and 14 L + 30.

Lane i holds link i + 1 and component i + 1 of every vector of n numbers; sums lie on lane 0 and
are broadcast.
"""

from __future__ import annotations

from collections.abc import Collection

from pfd_core.algorithms.chain.equations import armature, forward_equations
from pfd_core.algorithms.paper.newton_euler import newton_euler
from pfd_core.algorithms.paper.pcgm import inertia_times
from pfd_core.algorithms.paper.pcrbm_1987 import fohra
from pfd_core.dynamics.interface import input_row, program_with_outputs
from pfd_core.machine.iteration import iterate
from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes
from pfd_core.model import Plant
from pfd_core.model.values import choice
from pfd_core.paper.lanes import broadcast
from pfd_core.paper.patterns import total

# Parts that can run as printed: name, and the error.
STEP_4, STEP_7, STEP_16 = 'step 4', 'step 7', 'step 16'
MISPRINTS = {
    STEP_4: 'w_0 = tau - b for any x_0, where tau - b - H x_0 is needed',
    STEP_7: 'x_1 = t overwrites the iterate',
    STEP_16: 'the loop goes back to step 5 and repeats the inner product of step 12',
}


def record_pcgm_1987(
    plant: Plant, schedule: str, *, misprints: Collection[str] = (), start: bool = False
) -> Program:
    """
    Return the program of qdd, (n,), iterations and converged, (1,), from q, qd and tau.

    Parameters
    ----------
    plant : Plant
        Robot and scene.
    schedule : str
        One of SCHEDULES; nothing is packed.
    misprints : collection of str
        Names in MISPRINTS: parts taken as printed.
    start : bool
        Whether an input `start`, (n,), is the estimate x_0 instead of zero.

    """
    for name in misprints:
        choice('misprint', name, MISPRINTS)
    recorder, chain, at, y = forward_equations(plant, schedule, newton_euler, fohra)
    rotors = armature(recorder, plant)
    free = input_row(recorder, 'free') if plant.brakes else None

    def free_part(x: Lanes) -> Lanes:
        return x if free is None else where(free, x, 0.0)

    def times(u: Lanes) -> Lanes:
        return free_part(inertia_times(chain, at, u, rotors))

    x = free_part(input_row(recorder, 'start')) if start else recorder.constant(0.0)
    w = free_part(y)
    if start and STEP_4 not in misprints:
        with recorder.section('step 4'):
            w = w - times(x)
    with recorder.section('first inner product'):
        e = total(w * w)

    def step(x: Lanes, w: Lanes, u: Lanes, e: Lanes) -> tuple[tuple[Lanes, ...], Lanes]:
        with recorder.section('step 7'):
            t = times(u)
        if STEP_7 in misprints:
            x = t
        with recorder.section('step 8'):
            g = broadcast(e / total(u * t), 0)
        with recorder.section('steps 9 to 11'):
            x, w = x + g * u, w - g * t
        with recorder.section('step 12'):
            after = total(w * w)
        with recorder.section('steps 14, 15'):
            u = w + broadcast(after / e, 0) * u
        if STEP_16 in misprints:
            with recorder.section('step 5'):
                after = total(w * w)
        return (x, w, u, after), after

    (x, _, _, _), iterations = iterate(step, (x, w, w, e), e, recorder.lanes)
    one = [recorder.constant(1.0)]
    return program_with_outputs(recorder, iterations=[iterations], converged=one, qdd=x)
