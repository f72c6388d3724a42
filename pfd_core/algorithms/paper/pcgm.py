# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
PCGM as a whole program: pose, bias, and conjugate gradients on H qdd = tau - bias.

    steps 1, 2   0R_i, z_i, p*_i, s_i, J_i           chain
    step 3       the bias                            omega
    steps 4..16  conjugate gradients, H u by NE1     conjugate_gradient, inertia_times (packed)

Lee and Chang 1987, section 3; what is corrected there is said in conjugate_gradient.

Parallel cost of k trips at n = 6, rotational joints, R_i given: 182 + 47 k multiplications, 2 k
divisions, 189 + 62 k additions and 214 + 116 k routes. The paper has 499 and 621 in all for k = 6
and counts no routes; in float64 six joints take 7 to 13 trips to converge, which is 525 to 819 and
623 to 995 (docs/report/counts.md).

Lane i holds link i + 1 and component i + 1 of every vector.
"""

from __future__ import annotations

import math

from pfd_core.algorithms.beyond.omega import bias_omega
from pfd_core.algorithms.chain.equations import armature, begin, finish, joint_input, torque
from pfd_core.algorithms.paper.conjugate_gradient import TOLERANCE, conjugate_gradient
from pfd_core.algorithms.paper.ne1_product import prepare, times
from pfd_core.algorithms.paper.pcrbm import composite_forces
from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes
from pfd_core.model import Plant


def record_pcgm(
    plant: Plant,
    schedule: str,
    *,
    start: bool = False,
    jacobi: bool = False,
    tolerance: float = TOLERANCE,
    at_most: int | None = None,
) -> Program:
    """
    Return the program of qdd, (n,), trips and converged, (1,), from q, qd and tau.

    Parameters
    ----------
    plant : Plant
        The robot in its scene.
    schedule : str
        'parallel' or 'sequential'.
    start : bool
        Whether an input `start`, (n,), is the first estimate of qdd instead of zero.
    jacobi : bool
        Whether to scale by the diagonal of H, which composite bodies give.
    tolerance, at_most
        As for conjugate_gradient.

    """
    recorder, chain, at = begin(plant, schedule)
    qd, tau = joint_input(recorder, 'qd'), joint_input(recorder, 'tau')
    y = tau - torque(recorder, plant, chain, at, qd, None, bias_omega)
    rotors = armature(recorder, plant)
    prepared = prepare(recorder, chain, at, rotors, packed=True)
    free = joint_input(recorder, 'free') if plant.brakes else None

    def free_part(x: Lanes) -> Lanes:
        return x if free is None else where(free, x, 0.0)

    inverse = None
    if jacobi:
        _, _, diagonal = composite_forces(recorder, chain, at, rotors)
        inverse = 1.0 / (diagonal if free is None else where(free, diagonal, math.inf))
    solution = conjugate_gradient(
        recorder,
        lambda u: free_part(times(prepared, u)),
        free_part(y),
        start=free_part(joint_input(recorder, 'start')) if start else None,
        inverse_diagonal=inverse,
        tolerance=tolerance,
        at_most=at_most,
    )
    recorder.output('trips', (1,), [(solution.trips, 0)])
    recorder.output('converged', (1,), [(solution.converged, 0)])
    return finish(recorder, qdd=solution.x)
