# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A serial chain on lanes: constants of the links (Links) and their pose at positions q (Pose).

    R_i   = Rz(q_i) A_i (rotational), A_i (translational)
    0R_i  = 0R_(i-1) R_i                                     eq. (13), FOHRA
    z_i-1 = third column of 0R_(i-1), z_0 = (0, 0, 1)        step 2, eq. (14)
    p*_i  = 0R_i (A_i' a_i)  [+ q_i z_(i-1), translational]
    s_i   = 0R_i s_i (link axes),  J_i = 0R_i J_i (link axes) 0R_i'

Lee and Chang 1987, section 2.5, steps 1 and 2. Base axes are the axes of frame 0. Lane i holds
link i + 1 (the paper counts from 1): its frame, its joint's axis and its inertia.

Parallel cost, L = ceil(log2 n): 12 multiplications and 6 additions for R_i, which the paper takes
as given; 3 r and 2 r for the recurrence, whose levels k = 0 .. L - 1 pack 9 (n - 2^k) elements of
matrices onto n lanes, r rounds in all: at n = 6 that is 51 and 34 with 160 routes, where 27 L and
18 L with 27 routes would do without packing (81 and 54) and the paper prints 27 L - 19 = 62 and
18 L - 14 = 40, without routes; 63 and 42 for the vectors. A prismatic joint anywhere in the chain
adds 3 and 3. The paper's counts hold for twists of 0 and 90 degrees:
pfd_core.algorithms.paper.fohra_first_level.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pfd_core.dynamics.interface import input_row
from pfd_core.machine.lanes import cos, merge, on, sin
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import UPPER, array, rotated_symmetric
from pfd_core.model import Plant, Robot
from pfd_core.model.geometry import product
from pfd_core.model.values import Array
from pfd_core.paper.lanes import shift
from pfd_core.paper.patterns import prefix_product

# Products over lanes of matrices, (3, 3).
Recurrence = Callable[[LaneArray], LaneArray]


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
    plant: Plant, schedule: str, orientation: Recurrence = prefix_product
) -> tuple[Recorder, Links, Pose]:
    """Return a recorder on n lanes, the links on it, and their pose at the input q, as `pose`."""
    recorder = Recorder(plant.robot.n, schedule)
    chain = links(recorder, plant.robot, keep_tip=plant.external_wrench)
    return recorder, chain, pose(recorder, chain, input_row(recorder, 'q'), orientation)


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


def pose(
    recorder: Recorder, chain: Links, q: Lanes, orientation: Recurrence = prefix_product
) -> Pose:
    """
    Return the pose of the links at joint positions q [rad or m].

    `orientation` gives the products R_1 .. R_i of the rotations R_i, (3, 3), by lanes.
    """
    with recorder.section('joint rotation'):
        R = _joint_rotation(chain, q)
    with recorder.section('orientation'):
        R = orientation(R)
    with recorder.section('link vectors'):
        z0 = array([recorder.constant(value) for value in (0.0, 0.0, 1.0)])
        z = merge(shift(R[:, 2], 1), z0)
        p_star = R @ chain.p
        if chain.translational:
            p_star = merge(p_star + z * on(q, chain.translational), p_star)
        return Pose(R, z, p_star, R @ chain.s, rotated_symmetric(R, chain.J))


def wrench_in_base_axes(at: Pose, wrench: LaneArray) -> tuple[LaneArray, LaneArray]:
    """Return force and moment, (3,) each, of a wrench (6,) given in the last link's axes."""
    recorder = wrench[0].recorder
    with recorder.section('wrench'):
        R = on(at.R, [recorder.lanes - 1])
        return R @ wrench[:3], R @ wrench[3:]


def _joint_rotation(chain: Links, q: Lanes) -> LaneArray:
    """Return R_i, (3, 3): Rz(q_i) A_i, and A_i on the lanes of translational joints."""
    A = chain.A
    if not chain.rotational:
        return A
    angle = on(q, chain.rotational)
    c, s = cos(angle), sin(angle)
    turned = array([c * A[0] - s * A[1], s * A[0] + c * A[1], A[2]])
    return array(merge(turned, A))
