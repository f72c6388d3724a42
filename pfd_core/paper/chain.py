# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A serial chain on lanes, and its equations of motion.

    R_i   = Rz(q_i) A_i (rotational), A_i (translational)
    0R_i  = 0R_(i-1) R_i                                     eq. (13), FOHRA
    z_i-1 = third column of 0R_(i-1), z_0 = (0, 0, 1)        step 2, eq. (14)
    p*_i  = 0R_i (A_i' a_i)  [+ q_i z_(i-1), translational]
    s_i   = 0R_i s_i (link axes),  J_i = 0R_i J_i (link axes) 0R_i'
    H qdd = y,   y = torques of the motors - bias - torques of the joints at q, qd

Lee and Chang 1987, eqs (2.a), (2.b), where joints have no torques besides the motors', and section
2.5, steps 1 and 2. Base axes are the axes of frame 0. Lane i holds joint and link i + 1 (the paper
counts from 1): the link's frame and inertia, its joint's axis and component i + 1 of every vector
of n numbers; vectors are in base axes.

Parallel cost, L = ceil(log2 n): 12 multiplications and 6 additions for R_i, which the paper takes
as given; 3 r and 2 r for the recurrence, whose levels k = 0 .. L - 1 pack 9 (n - 2^k) elements of
matrices onto n lanes, r rounds in all: at n = 6 that is 51 and 34 with 160 routes, where 27 L and
18 L with 27 routes would do without packing (81 and 54) and the paper prints 27 L - 19 = 62 and
18 L - 14 = 40, without routes; 63 and 42 for the vectors. A prismatic joint anywhere in the chain
adds 3 and 3. The paper's counts hold for twists of 0 and 90 degrees: pfd_core.paper.first_level.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pfd_core.dynamics.drives import Gravity, motor_torques
from pfd_core.dynamics.interface import input_row, wrench_input
from pfd_core.dynamics.joint_torques import plus_joint_torques
from pfd_core.machine.lanes import cos, merge, on, sin
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import UPPER, array, rotated_symmetric
from pfd_core.model import Plant, Robot
from pfd_core.model.geometry import product
from pfd_core.model.values import Array
from pfd_core.paper import patterns
from pfd_core.paper.editions import OURS, Edition
from pfd_core.paper.lanes import shift
from pfd_core.paper.patterns import prefix_product, suffix


@dataclass(frozen=True)
class Links:
    """
    Constants of the links as rows over lanes, in link axes.

    Attributes
    ----------
    rotational, translational : tuple of int
        Lanes of the joints of each kind.
    A : LaneArray
        (3, 3), orientation of frame i in frame i-1 at q_i = 0.
    p : LaneArray
        (3,), A' a: from the origin of frame i-1 to the origin of frame i, in axes i [m].
    m : Lanes
        Mass [kg].
    s : LaneArray
        (3,), centre of mass from the origin of frame i [m].
    J : LaneArray
        (6,), inertia about the centre of mass [kg m^2].

    """

    rotational: tuple[int, ...]
    translational: tuple[int, ...]
    A: LaneArray
    p: LaneArray
    m: Lanes
    s: LaneArray
    J: LaneArray

    def by_kind(self, turning: Any, sliding: Any) -> Any:
        """Return `turning` on the lanes of rotational joints and `sliding` on the others."""
        if not self.translational:
            return turning
        if not self.rotational:
            return sliding
        return merge(on(sliding, self.translational), turning)


@dataclass(frozen=True)
class Pose:
    """
    Pose of the links, in base axes.

    Attributes
    ----------
    R : LaneArray
        (3, 3), 0R_i.
    z : LaneArray
        (3,), z_(i-1), the axis of joint i.
    p_star : LaneArray
        (3,), from the origin of frame i-1 to the origin of frame i [m].
    s : LaneArray
        (3,), centre of mass from the origin of frame i [m].
    J : LaneArray
        (6,), inertia about the centre of mass [kg m^2].

    """

    R: LaneArray
    z: LaneArray
    p_star: LaneArray
    s: LaneArray
    J: LaneArray


def chain_on_lanes(
    plant: Plant, schedule: str, edition: Edition = OURS
) -> tuple[Recorder, Links, Pose]:
    """Return a recorder on n lanes, the links on it, and their pose at the input q."""
    recorder = Recorder(plant.robot.n, schedule)
    chain = links(recorder, plant.robot, keep_tip=plant.external_wrench)
    return recorder, chain, _pose(chain, input_row(recorder, 'q'), edition)


def forward_equations(
    plant: Plant,
    schedule: str,
    torques: Callable[..., Lanes],
    edition: Edition = OURS,
) -> tuple[Recorder, Links, Pose, Lanes]:
    """
    Return a recorder on n lanes, the links, their pose at the input q, and y [N m or N].

    `torques` are of links, gravity and wrench: pfd_core.paper.newton_euler.torques.
    """
    recorder, chain, at = chain_on_lanes(plant, schedule, edition)
    qd, tau = input_row(recorder, 'qd'), input_row(recorder, 'tau')
    (tau,) = motor_torques(plant, [tau], [qd], compensation(plant, chain, at))
    bias = all_torques(plant, chain, at, qd, None, torques, edition)
    with recorder.section('right-hand side'):
        return recorder, chain, at, tau - bias


def all_torques(
    plant: Plant,
    chain: Links,
    at: Pose,
    qd: Lanes,
    qdd: Lanes | None,
    torques: Callable[..., Lanes],
    edition: Edition = OURS,
) -> Lanes:
    """Return the torques of links, gravity, wrench and joints; without qdd the bias."""
    recorder = qd.recorder
    wrench = None
    if plant.external_wrench:
        components = wrench_input(recorder)
        with recorder.section('wrench'):
            R = on(at.R, [recorder.lanes - 1])
            wrench = R @ components[:3], R @ components[3:]
    tau = torques(chain, at, qd, qdd, plant.gravity, wrench, edition.printed)
    (tau,) = plus_joint_torques(plant, [tau], [qd], None if qdd is None else [qdd])
    return tau


def rotors(recorder: Recorder, plant: Plant) -> Lanes | None:
    """Return the rotors' inertia on lanes, if the scene has any."""
    return None if plant.inertia is None else recorder.constant(plant.inertia)


def link_parameters(robot: Robot, keep_tip: bool) -> tuple[Array, Array, Array, Array]:
    """
    Return A, (n, 3, 3), a and s, (n, 3), and J, (n, 3, 3), of the links.

    Only an external wrench refers to the tip's frame. If it need not be kept, frame n is laid on
    the last joint's axis, where its offset and rotation vanish.
    """
    A, a, s, J = robot.rotations, robot.translations, robot.centers, robot.inertias
    if not keep_tip:
        A, a, s, J = A.copy(), a.copy(), s.copy(), J.copy()
        s[-1] = a[-1] + product(A[-1], s[-1])
        J[-1] = product(A[-1], J[-1], A[-1].T)
        A[-1], a[-1] = np.eye(3), 0.0
    return A, a, s, J


def links(recorder: Recorder, robot: Robot, keep_tip: bool) -> Links:
    """Return the constants of a robot's links on n lanes; keep_tip as for link_parameters."""
    A, a, s, J = link_parameters(robot, keep_tip)
    p = np.array([product(A[i].T, a[i]) for i in range(robot.n)])
    row = recorder.constant
    return Links(
        rotational=tuple(np.flatnonzero(robot.turning).tolist()),
        translational=tuple(np.flatnonzero(~robot.turning).tolist()),
        A=array([[row(A[:, i, k]) for k in range(3)] for i in range(3)]),
        p=array([row(p[:, i]) for i in range(3)]),
        m=row(robot.masses),
        s=array([row(s[:, i]) for i in range(3)]),
        J=array([row(J[:, i, k]) for i, k in UPPER]),
    )


def _pose(chain: Links, q: Lanes, edition: Edition) -> Pose:
    """Return the pose of the links at joint positions q [rad or m]."""
    recorder = q.recorder
    with recorder.section('joint rotation'):
        R = chain.A
        if chain.rotational:
            angle = on(q, chain.rotational)
            c, s = cos(angle), sin(angle)
            turned = array([c * R[0] - s * R[1], s * R[0] + c * R[1], R[2]])
            R = array(merge(turned, R))
    with recorder.section('orientation'):
        R = patterns.product(R) if edition.printed else prefix_product(R)
    with recorder.section('link vectors'):
        z0 = array([recorder.constant(value) for value in (0.0, 0.0, 1.0)])
        z = merge(shift(R[:, 2], 1), z0)
        p_star = R @ chain.p
        if chain.translational:
            p_star = merge(p_star + z * on(q, chain.translational), p_star)
        return Pose(R, z, p_star, R @ chain.s, rotated_symmetric(R, chain.J))


def compensation(plant: Plant, chain: Links, at: Pose) -> Gravity:
    """Return the gravity torques of a model as a function of it, for links and their pose."""
    return lambda model: [gravity_torques(chain, at, plant, model)]


def gravity_torques(chain: Links, at: Pose, plant: Plant, model: Plant) -> Lanes:
    """
    Return the torques that hold a model at rest at the input q, [N m or N], on n lanes.

        M_i   = sum of m_j, j >= i                       mass of links i..n, a constant
        h_i   = sum of m_j s_j + M_j p*_j, j >= i        their first moment about o_(i-1)
        tau_i = a . (z_(i-1) x h_i)  (rotational),  M_i a . z_(i-1)  (translational),  a = -g

    The model has the joints of a plant, whose links and pose are given. First moments add up: no
    force and no moment has to be carried along the chain. Parallel cost, rotational joints,
    gravity along an axis of the base: 9 multiplications and 3 L + 4 additions, and 9 and 6 more
    for a model with other centres of mass.
    """
    recorder = chain.m.recorder
    masses, s = chain.m, at.s
    if model.robot != plant.robot:
        _, _, centers, _ = link_parameters(model.robot, keep_tip=plant.external_wrench)
        masses = recorder.constant(model.robot.masses)
        s = at.R @ array([recorder.constant(row) for row in centers.T])
    carried = recorder.constant(np.cumsum(model.robot.masses[::-1])[::-1])
    h = suffix(lambda left, right: left + right, masses * s + carried * at.p_star)
    tau: Lanes = _along_gravity(model, lambda i, j, k: at.z[i] * h[j] - at.z[j] * h[i])
    if not chain.translational:
        return tau
    z = on(carried, chain.translational) * at.z
    sliding: Lanes = merge(_along_gravity(model, lambda i, j, k: z[k]), tau)
    return sliding


def _along_gravity(model: Plant, component: Callable[[int, int, int], Lanes]) -> Any:
    """Return a . v for a = -g; the arguments give v_k, and i, j, k follow each other in a turn."""
    terms = [
        -g * component((k + 1) % 3, (k + 2) % 3, k)
        for k, g in enumerate(model.gravity.tolist())
        if g
    ]
    return sum(terms, 0.0)
