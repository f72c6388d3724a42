# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Forward dynamics by constraint forces: one lane a joint, and steps that grow as log2 n.

The unknowns are the five components of the wrench that each joint transmits without its motor. The
chain is cut at its joints into n free links, each driven by the wrenches f_i at its inner and
f_(i+1) at its outer joint. E, constant in the link's axes, is the inverse of the link's inertia
between two points: the acceleration of the point at joint a for a wrench at the point of joint b,

    E_ab = [ J^-1                 J^-1 [b]          ]      a, b from the centre of mass,
           [ -[a] J^-1    1/m 1 - [a] J^-1 [b]      ]      [.] cross products

    f_i = W l_i + t y_i,     W' t = 0        y = tau - bias, the torque along the joint

Each joint permits no acceleration but its own, W' (a_i - a_(i-1)) = 0, which is a block
tridiagonal system with 5 x 5 blocks, symmetric and positive definite,

    A_i l_i + C_i' l_(i-1) + C_(i+1) l_(i+1) = r_i
    A_i = W' (E_ii of link i + G' E_oo of link i-1 G) W
    C_i = -W' E_io of link i-1 G W
    r_i = -W' (E_ii + G' E_oo G) t y_i + W' E_io G t y_(i+1) + W' G' E_oi t y_(i-1)

    qdd_i = t' (a_i - a_(i-1)),      a_i = E_ii f_i - E_io G f_(i+1),  E of link 0 is zero

with i and o for the inner and the outer joint of a link, and G for joint i at q_i, a rotation by
q_i about its axis or a slide along it. Components are in axes fixed to link i with z along joint
i, in the order (n_x, n_y, f_x, f_y, e, t): t is along the joint, n_z for a rotational and f_z
for a translational one; e is the other of n_z and f_z.

Odd-even elimination: every lane removes its two neighbours at a distance s = 1, 2, 4, .. from its
equation, so that after L = ceil(log2 n) levels each has l_i alone. With A = K D K' on each lane,
P = K^-1 C_i', Q = K^-1 C_(i+s), w = K^-1 r,

    A_i <- A_i - (Q' D^-1 Q)_(i-s) - (P' D^-1 P)_(i+s)
    C_i <- -(P' D^-1 Q)_(i-s)
    r_i <- r_i - (Q' D^-1 w)_(i-s) - (P' D^-1 w)_(i+s)

Source: Fijany, Sharf and D'Eleuterio, "Parallel O(log N) algorithms for computation of manipulator
forward dynamics", IEEE Trans. Robotics and Automation 11 (1995). Blocks, points and elimination
are derived here from its abstract; their counts differ from the counts of the source.

Parallel cost in addition to pose and bias, for rotational joints and n > 1:

    link constants     255 multiplications, 154 additions, 4 divisions
    joint equations    140 and 90, 6 routes
    elimination        515 L - 125 and 430 L - 100, 5 L divisions, 90 L - 25 routes
    constraint forces  55 and 40, 5 divisions
    accelerations      32 and 27, 7 routes

Elimination: 515 = 30 for K and D, 10 x 11 for P, Q and w, 50 for D^-1 P and D^-1 Q, and
5 (15 + 15 + 25 + 5 + 5) for the products; 430 = 20 + 110 + 4 x 65, and 40 for the sums; a level
routes 25 elements of C to the left, and 15 + 5 and 15 + 5 and 25 results. The last level makes no
C. Link constants depend on the robot alone, but are counted: 60 and 34 for 1/J, 1/m and the
inner points of two links a lane, 75 and 48, 30 and 18, 90 and 54 for E_ii, E_oo and E_io.

Accuracy: the error grows with the condition of the block system, which depends on the inertias of
the links and not on H, and is far above the condition of H. A link with inertia about one axis
only makes the system singular. On 80 random chains of up to 12 joints in float64, whose H has
conditions of 25 in the median and 920 at most after Jacobi scaling, the system has 3900 and 2e5;
qdd has relative errors of 4e-12 in the median, 5e-10 in nine of ten and 2e-8 at most. PCRBM has
2e-15 and 4e-14 there.

The method needs links with a mass and an inertia, and joints without rotors and brakes; other
plants are refused.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from pfd_core.dynamics.interface import input_row, program_with_outputs
from pfd_core.machine.lanes import cos, merge, on, sin
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder, lanes_of
from pfd_core.machine.vectors import (
    UPPER,
    array,
    crossing,
    dot,
    rotated_symmetric,
    symmetric_matrix,
)
from pfd_core.model import Plant
from pfd_core.paper.chain import Chain, link_parameters
from pfd_core.paper.lanes import shift
from pfd_core.paper.newton_euler import forward_equations

FIVE = range(5)
UPPER_OF_FIVE = [(i, j) for i in FIVE for j in range(i, 5)]
E, T = 4, 5  # places of the components e and t


@dataclass(frozen=True)
class Body:
    """
    Constants of one link on each lane, and the inverse of its inertia.

    Attributes
    ----------
    A : LaneArray
        (3, 3), orientation of its outer frame in the axes of its inner joint.
    J : LaneArray
        (6,), inverse of the inertia about the centre of mass, in the axes of the outer frame
        [1/(kg m^2)].
    m : Lanes
        Inverse of the mass [1/kg].
    inner, outer : LaneArray
        (3,), from the centre of mass to the inner joint, in its axes, and to the outer frame [m].

    """

    A: LaneArray
    J: LaneArray
    m: Lanes
    inner: LaneArray
    outer: LaneArray


@dataclass(frozen=True)
class Joint:
    """
    The motion of each joint between two links at q: the transformation G.

    Attributes
    ----------
    turn : tuple of Lanes or None
        Cosine and sine on the lanes of rotational joints.
    slide : Lanes or None
        Displacement on the lanes of translational joints [m].

    """

    turn: tuple[Lanes, Lanes] | None
    slide: Lanes | None

    def across(self, v: Any, back: bool) -> LaneArray:
        """
        Return G v, or G' v if `back`, for the first five or six components.

        8 multiplications, 4 additions.
        """
        nx, ny, fx, fy, *rest = v
        moved = array([nx, ny, fx, fy])
        if self.turn is not None:
            c, s = self.turn[0], self.turn[1] if back else -self.turn[1]
            moved = array([c * nx + s * ny, c * ny - s * nx, c * fx + s * fy, c * fy - s * fx])
        if self.slide is not None:
            d = self.slide
            slid = (
                [nx, ny, fx + d * ny, fy - d * nx] if back else [nx - d * fy, ny + d * fx, fx, fy]
            )
            slid = on(array(slid), lanes_of(d.defined))
            moved = slid if self.turn is None else array(merge(slid, moved))
        return array([*moved, *rest])


def _joint(q: Lanes, chain: Chain) -> Joint:
    """Return the motion of the joints; that of the first, before which no link is, has no use."""
    turns, slides = (
        [lane for lane in lanes if lane] for lanes in (chain.rotational, chain.translational)
    )
    angle = on(q, turns) if turns else None
    return Joint(
        None if angle is None else (cos(angle), sin(angle)), on(q, slides) if slides else None
    )


def record_constraint_forces(plant: Plant, schedule: str) -> Program:
    """
    Return the program of qdd, (n,), from q, qd and tau, and of its pivots.

    The pivots are the last pivot of each lane's matrix, all positive for links with a mass and an
    inertia. ValueError for a plant with rotors, brakes, or a link without mass or inertia.
    """
    _check(plant)
    chain, y = forward_equations(plant, schedule)
    recorder, n = chain.recorder, chain.recorder.lanes
    with recorder.section('joint rotation'):
        joint = _joint(input_row(recorder, 'q'), chain)
    slides = set(chain.translational)
    with recorder.section('link constants'):
        own = _ordered(_at_inner(_bodies(recorder, plant, range(n))), slides, slides)
        if n > 1:
            # Lane i has its link i and, for the joint between them, link i - 1.
            before = _bodies(recorder, plant, [max(i - 1, 0) for i in range(n)])
            outer = _at_point(before.J, before.m, before.outer)  # in the axes of the outer frame
            outer = _ordered(on(outer, range(1, n)), slides, slides)
            through = _through(before)
            through = _ordered(on(through, range(1, n)), {i + 1 for i in slides}, slides)
    with recorder.section('joint equations'):
        A = array([own[k] for k in UPPER_OF_FIVE])
        r = -own[:5, T] * y
        C: LaneArray | None = None
        if n > 1:
            A = merge(A + _seen_from_link(joint, outer), A)
            felt = through[T, :5] * shift(y, 1) - outer[:5, T] * y
            r = merge(r + joint.across(felt, back=True), r)
            r = merge(r + shift(through[:5, T] * y, -1), r)
            C = -array([joint.across(through[k, :5], back=True) for k in FIVE])
    with recorder.section('elimination'):
        stride = 1
        while C is not None:
            A, r, C = _eliminated(A, r, C, stride)
            stride *= 2
    with recorder.section('constraint forces'):
        forces, pivot = _solved(A, r)
    with recorder.section('accelerations'):
        f = array([*forces, y])
        qdd = own[T] @ f
        if n > 1:
            moved = joint.across(f, back=False)
            at_outer = outer[T] @ moved - through[:, T] @ array([*shift(forces, 1), shift(y, 1)])
            qdd = merge(qdd + at_outer, qdd)
            qdd = merge(qdd - shift(through[T] @ moved, -1), qdd)
    return program_with_outputs(recorder, qdd=qdd, pivots=pivot)


def _check(plant: Plant) -> None:
    """Raise ValueError for a plant that the method cannot handle."""
    robot = plant.robot
    if plant.inertia is not None or plant.brakes:
        raise ValueError(
            "method 'constraint_forces' needs a scene without rotor inertias and brakes; "
            "use 'divide_and_conquer' or 'pcrbm'"
        )
    least = np.linalg.eigvalsh(robot.inertias)[:, 0]
    for name, mass, inertia in zip(robot.joint_names, robot.masses, least, strict=True):
        if not (mass > 0 and inertia > 0):
            raise ValueError(
                f"method 'constraint_forces' needs links with a mass and an inertia, "
                f'got {mass:g} kg and at least {inertia:g} kg m^2 on joint {name!r}'
            )


# The inverse of a link's inertia between its joints, (6, 6), moments before forces.


def _bodies(recorder: Recorder, plant: Plant, links: Collection[int]) -> Body:
    """Return the constants of the given links, one a lane."""
    at = list(links)
    A, a, s, J = (x[at] for x in link_parameters(plant.robot, plant.external_wrench))

    def rows(values: Any) -> LaneArray:
        return array([recorder.constant(values[:, k]) for k in range(values.shape[1])])

    R = rows(A.reshape(-1, 9)).reshape(3, 3)
    centre = rows(s)
    inertia = array([recorder.constant(J[:, i, k]) for i, k in UPPER])
    return Body(
        A=R,
        J=_inverse(inertia),
        m=1.0 / recorder.constant(plant.robot.masses[at]),
        inner=-(R @ centre + rows(a)),
        outer=-centre,
    )


def _inverse(S: LaneArray) -> LaneArray:
    """Return the inverse of a symmetric matrix, (6,) (21 multiplications, 8 additions, 1 div)."""
    xx, xy, xz, yy, yz, zz = S
    first = array([yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy])
    others = [xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy]
    scale = 1.0 / dot(array([xx, xy, xz]), first)
    return array([scale * x for x in (*first, *others)])


def _at_inner(body: Body) -> LaneArray:
    """Return E_ii in the axes of the inner joint (75 multiplications, 48 additions)."""
    return _at_point(rotated_symmetric(body.A, body.J), body.m, body.inner)


def _at_point(J: LaneArray, m: Lanes, p: LaneArray) -> LaneArray:
    """Return E between a point and itself (30 multiplications, 18 additions)."""
    whole, px = symmetric_matrix(J), crossing(p)
    mixed = whole @ px
    lever = [px[i] @ mixed[:, j] for i, j in UPPER]
    force = array([m - x if i == j else -x for (i, j), x in zip(UPPER, lever, strict=True)])
    return np.block([[whole, mixed], [mixed.T, symmetric_matrix(force)]])


def _through(body: Body) -> LaneArray:
    """Return E_io, rows in the axes of the inner joint (90 multiplications, 54 additions)."""
    inner, outer = crossing(body.inner), crossing(body.outer)
    turned = body.A @ symmetric_matrix(body.J)
    mixed = turned @ outer
    return np.block([[turned, mixed], [-(inner @ turned), body.m * body.A - inner @ mixed]])


def _ordered(X: LaneArray, rows: Collection[int], columns: Collection[int]) -> LaneArray:
    """Return X with components in the order n_x, n_y, f_x, f_y, e, t by each lane's joints."""
    first = _components(X, rows)
    return array(_components(first.T, columns).T)


def _components(X: LaneArray, translational: Collection[int]) -> LaneArray:
    e, t = X[5], X[2]
    lanes = [lane for lane in lanes_of(X[0, 0].defined) if lane in translational]
    if lanes:
        e, t = merge(on(t, lanes), e), merge(on(e, lanes), t)
    return np.vstack([X[[0, 1, 3, 4]], [e, t]])


def _seen_from_link(joint: Joint, outer: LaneArray) -> LaneArray:
    """Return the upper triangle of W' G' E_oo G W (72 multiplications, 36 additions)."""
    half = array([*(joint.across(outer[k, :5], back=True) for k in range(4)), outer[E, :5]])
    whole = [joint.across(half[:, k], back=True) for k in FIVE]
    return array([whole[j][i] for i, j in UPPER_OF_FIVE])


# The block tridiagonal system.


def _factored(A: LaneArray) -> tuple[LaneArray, LaneArray]:
    """
    Return the lower K, (5, 5), and 1/D, (5,), of a symmetric A = K D K', (15,).

    30 multiplications, 20 additions, 5 divisions.
    """
    rest: dict[tuple[int, int], Any] = dict(zip(UPPER_OF_FIVE, A, strict=True))
    K = np.empty((5, 5), dtype=object)
    inverse = []
    for k in FIVE:
        inverse.append(1.0 / rest[k, k])
        for i in range(k + 1, 5):
            K[i, k] = rest[k, i] * inverse[k]
        for i in range(k + 1, 5):
            for j in range(i, 5):
                rest[i, j] = rest[i, j] - K[i, k] * rest[k, j]
    return K, array(inverse)


def _forward(K: LaneArray, B: LaneArray) -> LaneArray:
    """Return K^-1 B, (5, k) or (5,): 10 multiplications and additions for each column."""
    rows: list[Any] = []
    for i in FIVE:
        row = B[i]
        for j in range(i):
            row = row - K[i, j] * rows[j]
        rows.append(row)
    return array(rows)


def _eliminated(
    A: LaneArray, r: LaneArray, C: LaneArray, stride: int
) -> tuple[LaneArray, LaneArray, LaneArray | None]:
    """Return the equations without the neighbours at a distance `stride`; C is None at the end."""
    K, inverse = _factored(A)
    P, Q, w = _forward(K, C.T), _forward(K, shift(C, -stride)), _forward(K, r)
    scaled_P, scaled_Q = (inverse[:, None] * X for X in (P, Q))
    from_left = array([*_upper(scaled_Q, Q), *(scaled_Q.T @ w)])
    from_right = array([*_upper(scaled_P, P), *(scaled_P.T @ w)])
    mine = array([*A, *r])
    mine = merge(mine - shift(from_left, stride), mine)
    mine = merge(mine - shift(from_right, -stride), mine)
    last = 2 * stride >= A[0].recorder.lanes
    return mine[:15], mine[15:], None if last else -shift(P.T @ scaled_Q, stride)


def _upper(X: LaneArray, Y: LaneArray) -> list[Lanes]:
    """Return the upper triangle of the symmetric X' Y."""
    return [X[:, i] @ Y[:, j] for i, j in UPPER_OF_FIVE]


def _solved(A: LaneArray, r: LaneArray) -> tuple[LaneArray, Lanes]:
    """Return A^-1 r, (5,), and 1 over the last pivot (55 multiplications, 40 additions, 5 div)."""
    K, inverse = _factored(A)
    x = list(inverse * _forward(K, r))
    for i in reversed(FIVE):
        for j in range(i + 1, 5):
            x[i] = x[i] - K[j, i] * x[j]
    return array(x), inverse[-1]
