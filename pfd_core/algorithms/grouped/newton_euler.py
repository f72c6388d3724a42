# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The equations of motion on one processor, in link axes, with grouped inertial parameters.

    H(q) qdd = y,   y = tau - bias - torques of the joints at qd

The bias, base to tip and back (W = [wd] + [w][w], so that W p is the acceleration of a point p):

    w_i = R'w [+ z qd],  wd_i = R'wd [+ R'w x z qd],  a_i = R'(a + W r) {+ 2 R'w x z qd}
    f = m a + W h,  n = h x a + (I wd + w x I w),  sums of f and n from the tip

[rotational], {translational}. Luh, Walker and Paul 1980; base parameters of
pfd_core.algorithms.grouped.links, Khalil and Kleinfinger 1987. H qdd = y is solved by
composite_body and articulated_body.

One register holds one number; everything of link i is in axes B_i.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pfd_core.algorithms.chain.drives import motor_torques
from pfd_core.algorithms.chain.interface import input_list, wrench_input
from pfd_core.algorithms.chain.joint_torques import minus_joint_torques
from pfd_core.algorithms.chain.link_axes import planar, sum_of_angles
from pfd_core.algorithms.grouped.links import GroupedLink, JointAxes, Tip, grouped_links
from pfd_core.algorithms.grouped.payload_input import with_payload_input
from pfd_core.machine.lanes import cos, sin
from pfd_core.machine.recorder import LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import UPPER, array, constants, cross
from pfd_core.model import Plant


@dataclass(frozen=True)
class Axes:
    """
    Axes B_i of a link at the input q.

    Attributes
    ----------
    slides : bool
        Whether its joint is translational.
    turn, twist : tuple of Lanes
        Cosine and sine of theta_i and of alpha_(i-1).
    square, parallel : bool
        Whether alpha_(i-1) is 90 degrees, one way or the other, or 0 or 180 degrees, exactly.
    r : LaneArray
        (3,), origin of B_i from the origin of B_(i-1), in axes B_(i-1) [m].

    """

    slides: bool
    turn: tuple[Lanes, Lanes]
    twist: tuple[Lanes, Lanes]
    square: bool
    parallel: bool
    r: LaneArray


@dataclass(frozen=True)
class Link(Axes):
    """
    A link at the input q, with grouped parameters.

    Attributes
    ----------
    m : Lanes
        Mass [kg].
    h : LaneArray
        (3,), first moment [kg m].
    inertia : LaneArray
        (6,), about the origin: xx, xy, xz, yy, yz, zz [kg m^2].

    """

    m: Lanes
    h: LaneArray
    inertia: LaneArray


def grouped_equations(plant: Plant) -> tuple[Recorder, list[Link], list[Lanes]]:
    """Return a recorder, the links of a plant at the input q, and y, (n,) [N m or N]."""
    recorder = Recorder(1, 'sequential')
    q, qd, tau = (input_list(recorder, name, plant.robot.n) for name in ('q', 'qd', 'tau'))
    tau = motor_torques(plant, tau, qd)
    links, tip = links_at(recorder, plant, q)
    with recorder.section('bias'):
        bias = chain_torques(recorder, plant, links, tip, qd)
        y = [t - b for t, b in zip(tau, bias, strict=True)]
        y = minus_joint_torques(plant, y, qd)
    return recorder, links, y


def links_at(recorder: Recorder, plant: Plant, q: Sequence[Lanes]) -> tuple[list[Link], Tip]:
    """Return the links of a plant at the input q, base to tip, and the pose of frame n."""
    numbers, tip = grouped_links(plant)
    with recorder.section('rotations'):
        links = [_link(recorder, *pair) for pair in zip(numbers, q, strict=True)]
    return (_with_payload(recorder, plant, links) if plant.payload_input else links), tip


def _with_payload(recorder: Recorder, plant: Plant, links: Sequence[Link]) -> list[Link]:
    """Return links whose parameters are inputs as far as a payload changes them."""
    bodies = with_payload_input(recorder, plant.robot, [[x.m, *x.h, *x.inertia] for x in links])
    return [
        replace(link, m=body[0], h=array(body[1:4]), inertia=array(body[4:]))
        for link, body in zip(links, bodies, strict=True)
    ]


def _link(recorder: Recorder, link: GroupedLink, q: Lanes) -> Link:
    return Link(
        **vars(axes_at(recorder, link, q)),
        m=recorder.constant(link.m),
        h=constants(recorder, link.h),
        inertia=constants(recorder, [link.inertia[k] for k in UPPER]),
    )


def axes_at(recorder: Recorder, link: JointAxes, q: Lanes) -> Axes:
    """Return the axes of a link at the input q."""
    turn = planar(recorder, link.start)
    twist = planar(recorder, link.twist)
    r = constants(recorder, link.p)
    if link.slides:
        r = array([r[0], r[1] - twist[1] * q, r[2] + twist[0] * q])
    else:
        turn = sum_of_angles((cos(q), sin(q)), turn)
    square, parallel = (x == 0 for x in link.twist)
    return Axes(link.slides, turn, twist, square, parallel, r)


def inward(link: Axes, v: LaneArray) -> LaneArray:
    """Return a vector of B_i in the axes B_(i-1): R v."""
    (c, s), (ca, sa) = link.turn, link.twist
    x, y = c * v[0] - s * v[1], s * v[0] + c * v[1]
    return array([x, ca * y - sa * v[2], sa * y + ca * v[2]])


def outward(link: Axes, v: LaneArray) -> LaneArray:
    """Return a vector of B_(i-1) in the axes B_i: R' v."""
    (c, s), (ca, sa) = link.turn, link.twist
    y, z = ca * v[1] + sa * v[2], ca * v[2] - sa * v[1]
    return array([c * v[0] + s * y, c * y - s * v[0], z])


def inward_symmetric(link: Axes, X: LaneArray) -> LaneArray:
    """Return a symmetric matrix of B_i, six elements, in the axes B_(i-1): R X R'."""
    (c, s), (ca, sa) = link.turn, link.twist
    xx, xy, xz, yy, yz, zz = turned_about_z(c, s, X)
    if link.square:  # y and z change places, which takes no rounding
        return array([xx, -(sa * xz), sa * xy, zz, -yz, yy])
    # About x: the same with y, z, x instead of x, y, z.
    yy, yz, xy, zz, xz, xx = turned_about_z(ca, sa, array([yy, yz, xy, zz, xz, xx]))
    return array([xx, xy, xz, yy, yz, zz])


def turned_about_z(c: Lanes, s: Lanes, X: LaneArray) -> LaneArray:
    """Return Rz X Rz'; cos^2 + sin^2 = 1 is used (8 multiplications, 8 additions)."""
    xx, xy, xz, yy, yz, zz = X
    t = s * (xx - yy) + c * (xy + xy)
    st = s * t
    return array([xx - st, c * t - xy, c * xz - s * yz, yy + st, s * xz + c * yz, zz])


def chain_torques(
    recorder: Recorder,
    plant: Plant,
    links: Sequence[Link],
    tip: Tip,
    qd: Sequence[Lanes],
    qdd: Sequence[Lanes] | None = None,
) -> list[Lanes]:
    """Return the torques of links, gravity and wrench, (n,); without qdd the bias."""
    forces = []
    for link, motion in zip(links, motions(recorder, plant, links, qd, qdd), strict=True):
        n = moment(motion, link.inertia) + cross(link.h, motion.a)
        forces.append((link.m * motion.a + motion.spin @ link.h, n))
    return joint_torques(recorder, plant, links, tip, forces)


@dataclass(frozen=True)
class Motion:
    """
    Motion of a link, in its axes B_i.

    Attributes
    ----------
    w, wd : LaneArray
        (3,), angular velocity [rad/s] and acceleration [rad/s^2].
    a : LaneArray
        (3,), acceleration of the origin, minus gravity [m/s^2].
    squares : LaneArray
        (6,), xx, xy, xz, yy, yz, zz of w w'.
    spin : LaneArray
        (3, 3), W = [wd] + [w][w].

    """

    w: LaneArray
    wd: LaneArray
    a: LaneArray
    squares: LaneArray
    spin: LaneArray


def motions(
    recorder: Recorder,
    plant: Plant,
    links: Sequence[Axes],
    qd: Sequence[Lanes],
    qdd: Sequence[Lanes] | None = None,
) -> Iterator[Motion]:
    """Yield the motion of each link, base to tip; without qdd it is zero."""
    zero = recorder.constant(0.0)
    w, wd = (array([zero] * 3) for _ in range(2))
    a = constants(recorder, -plant.gravity)
    spin: Any = None  # W of the link before
    for i, (link, rate) in enumerate(zip(links, qd, strict=True)):
        w, wd = outward(link, w), outward(link, wd)
        a = outward(link, a if spin is None else a + spin @ link.r)
        if link.slides:
            a = a + 2.0 * array([w[1] * rate, -(w[0] * rate), zero])
        else:
            wd = array([wd[0] + w[1] * rate, wd[1] - w[0] * rate, wd[2]])
            w = array([w[0], w[1], w[2] + rate])
        if qdd is not None:
            along = a if link.slides else wd
            along[2] = along[2] + qdd[i]
        squares = _products(w)
        spin = _spin(squares, wd)
        yield Motion(w, wd, a, squares, spin)


def _products(w: LaneArray) -> LaneArray:
    """Return xx, xy, xz, yy, yz, zz of w w'."""
    return array([w[i] * w[j] for i in range(3) for j in range(i, 3)])


def _spin(squares: LaneArray, wd: LaneArray) -> LaneArray:
    """Return W = [wd] + [w][w], (3, 3), from w w'."""
    xx, xy, xz, yy, yz, zz = squares
    return array(
        [
            [-(yy + zz), xy - wd[2], xz + wd[1]],
            [xy + wd[2], -(xx + zz), yz - wd[0]],
            [xz - wd[1], yz + wd[0], -(xx + yy)],
        ]
    )


def moment(motion: Motion, inertia: LaneArray) -> LaneArray:
    """Return I wd + w x I w, from elements of W."""
    wd, W = motion.wd, motion.spin
    xx, xy, xz, yy, yz, zz = inertia
    _, sxy, sxz, _, syz, _ = motion.squares
    return array(
        [
            xx * wd[0] + (zz - yy) * syz + yz * (W[1, 1] - W[2, 2]) + xz * W[1, 0] - xy * W[2, 0],
            yy * wd[1] + (xx - zz) * sxz + xz * (W[2, 2] - W[0, 0]) + xy * W[2, 1] - yz * W[0, 1],
            zz * wd[2] + (yy - xx) * sxy + xy * (W[0, 0] - W[1, 1]) + yz * W[0, 2] - xz * W[1, 2],
        ]
    )


def joint_torques(
    recorder: Recorder,
    plant: Plant,
    links: Sequence[Axes],
    tip: Tip,
    forces: Sequence[tuple[LaneArray, LaneArray]],
) -> list[Lanes]:
    """Return the torque of each joint, from force and moment that each link needs."""
    torques: list[Lanes] = []
    f = n = None
    for link, force in zip(reversed(links), reversed(forces), strict=True):
        if f is not None:
            f, n = force[0] + f, force[1] + n
        else:
            f, n = less_wrench(recorder, tip, force) if plant.external_wrench else force
        torques.append(f[2] if link.slides else n[2])
        f, n = moved(link, f, n)
    return torques[::-1]


def less_wrench(
    recorder: Recorder, tip: Tip, force: tuple[LaneArray, LaneArray]
) -> tuple[LaneArray, LaneArray]:
    """Return force and moment of the last link minus the wrench on it."""
    k = wrench_input(recorder)
    R, p = constants(recorder, tip.rotation), constants(recorder, tip.p)
    f = R @ k[:3]
    return force[0] - f, force[1] - (R @ k[3:] + cross(p, f))


def moved(link: Axes, f: LaneArray, n: LaneArray) -> tuple[LaneArray, LaneArray]:
    """Return force and moment of axes and origin B_i in axes and about the origin of B_(i-1)."""
    f, n = inward(link, f), inward(link, n)
    return f, n + cross(link.r, f)
