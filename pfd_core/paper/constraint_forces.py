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
forward dynamics", IEEE Trans. Robotics and Automation 11 (1995); derived here from its abstract.

Parallel cost in addition to pose and bias, for rotational joints and n > 1:

    link constants     255 multiplications, 154 additions, 4 divisions
    joint equations    140 and 90, 6 routes
    elimination        515 L - 125 and 430 L - 100, 5 L divisions, 90 L - 25 routes
    constraint forces  55 and 40, 5 divisions
    accelerations      32 and 27, 7 routes

The last level makes no C. Link constants depend on the robot alone, but are counted.

Accuracy: the error grows with the condition of the block system, which depends on the masses and
inertias of the links and is far above that of H: with masses over 8 decades no digit may be right
(docs/report/since-1987.md).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np

from pfd_core.machine.lanes import cos, merge, on, sin
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder, lanes_of
from pfd_core.machine.vectors import (
    array,
    crossing,
    dot,
    rotated_symmetric,
    symmetric_matrix,
    symmetric_product,
    upper,
)
from pfd_core.model.plant import Plant
from pfd_core.paper.chain import Chain, link_parameters, rows
from pfd_core.paper.lanes import shift
from pfd_core.paper.newton_euler import forward_equations

FIVE = range(5)
E, T = 4, 5  # places of the components e and t


def record_constraint_forces(plant: Plant, schedule: str) -> Program:
    """
    Return the program of qdd, (n,), from q, qd and tau, and of each lane's last pivot.

    ValueError for a plant with rotors, brakes, or a link without mass or inertia.
    """
    _check(plant)
    chain, y = forward_equations(plant, schedule)
    recorder, n = chain.recorder, plant.robot.n
    with recorder.section('joint rotation'):
        joint = joint_motion(chain, recorder.input_row('q'))
    slides = set(chain.translational)
    with recorder.section('link constants'):
        body = _bodies(recorder, plant, range(n))
        J = rotated_symmetric(body.A, body.J)
        own = ordered(_at_point(J, body.m, body.inner), slides, slides)
        if n > 1:
            # Lane i has its link i and, for the joint between them, link i - 1.
            later, before = range(1, n), _bodies(recorder, plant, [0, *range(n - 1)])
            outer = _at_point(before.J, before.m, before.outer)  # in the axes of the outer frame
            outer = ordered(on(outer, later), slides, slides)
            through = on(_through(before), later)
            through = ordered(through, {i + 1 for i in slides}, slides)
    with recorder.section('joint equations'):
        A = array([own[k] for k in upper(5)])
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
        K, inverse, w = _factored(A, r[:, None])
        forces = inverse * w[:, 0]
        for i in reversed(FIVE):
            for j in range(i + 1, 5):
                forces[i] = forces[i] - K[j, i] * forces[j]
    with recorder.section('accelerations'):
        f = array([*forces, y])
        qdd = own[T] @ f
        if n > 1:
            moved = joint.across(f, back=False)
            at_outer = outer[T] @ moved - through[:, T] @ array([*shift(forces, 1), shift(y, 1)])
            qdd = merge(qdd + at_outer, qdd)
            qdd = merge(qdd - shift(through[T] @ moved, -1), qdd)
    return recorder.program(qdd=qdd, pivots=inverse[-1])


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


class Joint(NamedTuple):
    """The motion of each joint at q, the transformation G between two links."""

    turn: tuple[Lanes, Lanes] | None  # cosine and sine, on the lanes of rotational joints
    slide: Lanes | None  # displacement [m] on the others

    def before(self) -> Joint:
        """Return the motion of each joint on the lane of the link before it."""
        turn = self.turn and (shift(self.turn[0], -1), shift(self.turn[1], -1))
        return Joint(turn, None if self.slide is None else shift(self.slide, -1))

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
            d, slid = self.slide, [nx, ny, fx, fy]
            if back:
                slid[2:] = fx + d * ny, fy - d * nx
            else:
                slid[:2] = nx - d * fy, ny + d * fx
            slid = on(array(slid), lanes_of(d.defined))
            moved = slid if self.turn is None else merge(slid, moved)
        return array([*moved, *rest])


def joint_motion(chain: Chain, q: Lanes) -> Joint:
    """Return the motion of the joints; that of the first, before which no link is, has no use."""
    turns, slides = ([i for i in lanes if i] for lanes in (chain.rotational, chain.translational))
    angle = on(q, turns) if turns else None
    turn = None if angle is None else (cos(angle), sin(angle))
    return Joint(turn, on(q, slides) if slides else None)


# The inverse of a link's inertia between its joints, (6, 6), moments before forces.


class Body(NamedTuple):
    """Constants of one link on each lane."""

    A: LaneArray  # (3, 3), orientation of its outer frame in the axes of its inner joint
    J: LaneArray  # (6,), inverse inertia about the centre of mass, outer axes [1/(kg m^2)]
    m: Lanes  # inverse mass [1/kg]
    inner: LaneArray  # (3,), from the centre of mass to the inner joint, in its axes [m]
    outer: LaneArray  # (3,), and to the outer frame


def _bodies(recorder: Recorder, plant: Plant, links: Sequence[int]) -> Body:
    """Return the constants of the given links, one a lane."""
    at = list(links)
    parameters = link_parameters(plant.robot, plant.external_wrench)
    A, a, centre, (xx, xy, xz, yy, yz, zz) = (rows(recorder, x[at]) for x in parameters)
    first = array([yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy])
    others = [xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy]
    scale = 1.0 / dot(array([xx, xy, xz]), first)
    J = array([scale * x for x in (*first, *others)])
    m = 1.0 / recorder.constant(plant.robot.masses[at])
    return Body(A, J, m, -(A @ centre + a), -centre)


def _at_point(J: LaneArray, m: Lanes, p: LaneArray) -> LaneArray:
    """Return E between a point and itself (30 multiplications, 18 additions)."""
    whole, px = symmetric_matrix(J), crossing(p)
    mixed = whole @ px
    force = -symmetric_product(px, mixed.T)
    for k in (0, 3, 5):  # the diagonal
        force[k] = m + force[k]
    return np.block([[whole, mixed], [mixed.T, symmetric_matrix(force)]])


def _through(body: Body) -> LaneArray:
    """Return E_io, rows in the axes of the inner joint (90 multiplications, 54 additions)."""
    inner, outer = crossing(body.inner), crossing(body.outer)
    turned = body.A @ symmetric_matrix(body.J)
    mixed = turned @ outer
    return np.block([[turned, mixed], [-(inner @ turned), body.m * body.A - inner @ mixed]])


def ordered(X: LaneArray, rows: Collection[int], columns: Collection[int]) -> LaneArray:
    """Return X with components in the order n_x, n_y, f_x, f_y, e, t by each lane's joints."""
    return array(_components(_components(X, rows).T, columns).T)


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
    return array([whole[j][i] for i, j in upper(5)])


# The block tridiagonal system.


def _eliminated(
    A: LaneArray, r: LaneArray, C: LaneArray, stride: int
) -> tuple[LaneArray, LaneArray, LaneArray | None]:
    """Return the equations without the neighbours at a distance `stride`; C is None at the end."""
    _, inverse, right = _factored(A, np.hstack([C.T, shift(C, -stride), r[:, None]]))
    P, Q, w = right[:, :5], right[:, 5:10], right[:, 10]
    scaled_P, scaled_Q = (inverse[:, None] * X for X in (P, Q))
    mine = array([*A, *r])
    for scaled, X, by in ((scaled_Q, Q, stride), (scaled_P, P, -stride)):
        neighbours = array([*symmetric_product(scaled.T, X.T), *(scaled.T @ w)])
        mine = merge(mine - shift(neighbours, by), mine)
    last = 2 * stride >= A[0].recorder.lanes
    return mine[:15], mine[15:], None if last else -shift(P.T @ scaled_Q, stride)


def _factored(A: LaneArray, right: LaneArray) -> tuple[LaneArray, LaneArray, LaneArray]:
    """
    Return the lower K, 1/D, (5,), and K^-1 right of A = K D K', given by its 15 elements.

    30 multiplications, 20 additions, 5 divisions, and 10 and 10 for each column on the right.
    """
    S = np.hstack([symmetric_matrix(A), right])
    K, inverse = np.empty((5, 5), dtype=object), np.empty(5, dtype=object)
    for k in FIVE:
        inverse[k] = 1.0 / S[k, k]
        K[k + 1 :, k] = S[k, k + 1 : 5] * inverse[k]
        for i in range(k + 1, 5):
            S[i, i:] = S[i, i:] - K[i, k] * S[k, i:]
    return K, inverse, S[:, 5:]
