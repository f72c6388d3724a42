# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
PCGM: H qdd = tau - bias by conjugate gradients, H times a vector by the Newton-Euler method.

    0R_i, z_i, p*_i, s_i, J_i, bias                                    steps 1 to 3
    w_0 = y - H x_0,  v = P w,  u_0 = v_0,  e_0 = w_0' v_0             P the preconditioner or 1
    t = H u,  g = e / u't,  x <- x + g u,  w <- w - g t                Appendix B, steps 5 to 9
    v = P w,  e' = w' v,  u <- v + (e'/e) u                            steps 10 to 13

Lee and Chang 1987, section 3 and Appendix B, after Walker and Orin 1982, method 4; the
preconditioner is ours. Corrected: a start x_0 other than zero needs w_0 = y - H x_0 (printed: y);
step 16 goes back to step 7, not to step 5; step 7 leaves x alone (printed: x_1 = tau). The printed
stops, e = 0 and n iterations, are replaced: with rounding e is hardly ever zero beyond one joint,
and the directions lose their orthogonality, so that beyond three joints most states need more than
n iterations; here the stop is e <= tolerance^2 e_0, and a direction with u't <= 0 ends the
iteration. The recursive residual that the stop reads is no measure of the error.

H u is NE1 with qd = 0, no gravity and no wrench (sums are recurrences over links):

    wd_i  = sum of z u                            rotational joints only
    a_i   = sum of wd x p* [+ z u, translational joint]
    F_i   = m (a + wd x s),  N_i = J wd
    f_i   = sum of F from the tip,  n_i = sum of s x F + N + p* x f from the tip
    (H u)_i = z_(i-1) . n_i  (rotational),  z_(i-1) . f_i  (translational)

Step 7 sets gravity to zero; its item (b) leaves out external forces, too. Otherwise the result is
not linear in u. Every vector refers to a point of its link, so that the product is as accurate as
H itself.

Parallel cost of H u, rotational joints, L = ceil(log2 n): 42 multiplications and 12 L + 29
additions; the paper prints 42 and 12 L + 26, a vector sum less. A prismatic joint anywhere
in the chain adds 3 additions, rotor inertia 1 multiplication and 1 addition.

Parallel cost, L = ceil(log2 n), plus the cost of H u: 5 multiplications, 2 L + 3 additions and
2 divisions an iteration, Jacobi scaling 1 more multiplication. The paper's 49 multiplications and
14 L + 30 additions an iteration leave 7 and 2 L + 4 in addition to its H u, divisions among them.

In all, with k iterations at n = 6, rotational joints, R_i given, the bias of
pfd_core.algorithms.beyond.omega and packed sums in H u: 182 + 47 k multiplications, 2 k divisions,
189 + 62 k additions and 214 + 116 k routes. The paper has 499 and 621 in all for k = 6 and counts
no routes; in float64 six joints take 7 to 13 iterations to converge, which is 525 to 819 and 623
to 995, seen on 3000 states of three arms.

Lane i holds link i + 1, its vectors in base axes, and component i + 1 of every vector of n
numbers; sums lie on lane 0 and are broadcast.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
import math

from pfd_core.algorithms.chain.base_axes import Links, Pose
from pfd_core.algorithms.chain.equations import LinkTorques, armature, forward_equations
from pfd_core.algorithms.paper.newton_euler import (
    newton_euler,
    rotational_part,
    summed,
    torques_of,
)
from pfd_core.algorithms.paper.pcrbm import composite_forces
from pfd_core.dynamics.interface import input_row, program_with_outputs
from pfd_core.machine.iteration import TOLERANCE, iterate
from pfd_core.machine.lanes import merge, on, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.machine.vectors import array, cross, symmetric_times
from pfd_core.model import Plant
from pfd_core.paper.lanes import broadcast
from pfd_core.paper.patterns import prefix, prefix_sum, suffix_sum, total

# Walks through directions that rounding has made dependent take a multiple of n; the hardest
# chains of up to 30 joints need 6 n.
ITERATIONS_PER_JOINT, ITERATIONS_AT_LEAST = 12, 20


@dataclass(frozen=True)
class Solution:
    """
    Result of conjugate gradients.

    Attributes
    ----------
    x : Lanes
        The solution, component i + 1 on lane i.
    iterations : Lanes
        Iterations taken.
    converged : Lanes
        Above zero on lane 0 if the residual fell below the tolerance.

    """

    x: Lanes
    iterations: Lanes
    converged: Lanes


def default_limit(n: int) -> int:
    """Return the largest number of iterations for n joints."""
    return ITERATIONS_PER_JOINT * n + ITERATIONS_AT_LEAST


def conjugate_gradient(
    recorder: Recorder,
    times: Callable[[Lanes], Lanes],
    y: Lanes,
    *,
    start: Lanes | None = None,
    inverse_diagonal: Lanes | None = None,
    tolerance: float = TOLERANCE,
    at_most: int | None = None,
) -> Solution:
    """
    Return the solution of H x = y.

    Parameters
    ----------
    recorder : Recorder
        On n lanes.
    times : callable
        times(u) is H u; it is recorded once or, with a start, twice.
    y : Lanes
        Right-hand side.
    start : Lanes, optional
        x_0; default zero, which saves one product.
    inverse_diagonal : Lanes, optional
        1/h_ii, to scale by (Jacobi); default no preconditioner.
    tolerance : float
        Stop when the (scaled) residual has fallen by this factor.
    at_most : int, optional
        Largest number of iterations; default default_limit(n).

    """
    with recorder.section('first residual'):
        w = y if start is None else y - times(start)
        v = w if inverse_diagonal is None else w * inverse_diagonal
        e0 = total(w * v)
        limit = (tolerance * tolerance) * e0
        x = recorder.constant(0.0) if start is None else start

    def step(x: Lanes, w: Lanes, u: Lanes, e: Lanes) -> tuple[tuple[Lanes, ...], Lanes]:
        with recorder.section('product with H'):
            t = times(u)
        with recorder.section('iteration'):
            ut = total(u * t)
            g = broadcast(where(ut, e / ut, 0.0), 0)
            x, w = x + g * u, w - g * t
            v = w if inverse_diagonal is None else w * inverse_diagonal
            after = total(w * v)
            u = v + broadcast(after / e, 0) * u
            return (x, w, u, after), where(ut, after, 0.0)

    limit_of_iterations = default_limit(recorder.lanes) if at_most is None else at_most
    state = (x, w, v, e0)
    (x, _, _, e), iterations = iterate(step, state, e0, limit_of_iterations, floor=limit)
    with recorder.section('convergence'):
        # One if e <= limit, zero residuals included; NaN fails the comparison with minus one.
        return Solution(x, iterations, where(e - limit, 0.0, where(e + 1.0, 1.0, 0.0)))


def inertia_times(
    chain: Links, pose: Pose, u: Lanes, armature: Lanes | None = None, packed: bool = False
) -> Lanes:
    """
    Return H u, (H u)_i on lane i [N m or N].

    Parameters
    ----------
    chain, pose : Links, Pose
        Constants of the links and their pose.
    u : Lanes
        Accelerations [rad/s^2 or m/s^2].
    armature : Lanes or None
        Inertia that each joint's rotor adds to the diagonal [kg m^2 or kg].
    packed : bool
        Whether the levels of the sums over links are packed onto full rows of lanes: fewer
        additions (at n = 6 the sums take 24 instead of 36) for more routes.

    """
    zero = array([u.recorder.constant(0.0)] * 3)
    zu = pose.z * u
    from_base = prefix_sum if packed else partial(summed, prefix)
    wd = from_base(rotational_part(chain, zu, zero))
    t = cross(wd, pose.p_star)
    if chain.translational:
        t = merge(t + on(zu, chain.translational), t)
    a = from_base(array(t))
    F = chain.m * (a + cross(wd, pose.s))
    N = symmetric_times(pose.J, wd)
    product = torques_of(chain, pose, F, N, None, suffix_sum if packed else None)
    return product if armature is None else product + armature * u


def record_pcgm(
    plant: Plant,
    schedule: str,
    *,
    link_torques: LinkTorques = newton_euler,
    start: bool = False,
    jacobi: bool = False,
    tolerance: float = TOLERANCE,
    at_most: int | None = None,
) -> Program:
    """
    Return the program of qdd, (n,), iterations and converged, (1,), from q, qd and tau.

    Parameters
    ----------
    plant : Plant
        The robot in its scene.
    schedule : str
        One of SCHEDULES.
    link_torques : callable
        Torques of the links for the bias; default NE1, the paper's.
    start : bool
        Whether an input `start`, (n,), is the first estimate of qdd instead of zero.
    jacobi : bool
        Whether to scale by the diagonal of H, which composite bodies give.
    tolerance, at_most
        As for conjugate_gradient.

    """
    recorder, chain, at, y = forward_equations(plant, schedule, link_torques)
    rotors = armature(recorder, plant)
    free = input_row(recorder, 'free') if plant.brakes else None

    def free_part(x: Lanes) -> Lanes:
        return x if free is None else where(free, x, 0.0)

    inverse = None
    if jacobi:
        _, _, diagonal = composite_forces(recorder, chain, at, rotors)
        inverse = 1.0 / (diagonal if free is None else where(free, diagonal, math.inf))
    solution = conjugate_gradient(
        recorder,
        lambda u: free_part(inertia_times(chain, at, u, rotors, packed=True)),
        free_part(y),
        start=free_part(input_row(recorder, 'start')) if start else None,
        inverse_diagonal=inverse,
        tolerance=tolerance,
        at_most=at_most,
    )
    return program_with_outputs(
        recorder, iterations=[solution.iterations], converged=[solution.converged], qdd=solution.x
    )
