# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
What crosses a joint, and the sweeps over a chain of joints, on one processor.

Link i is described in axes B_i, fixed to it, with z along the axis of joint i and the origin on
this axis (pfd_core.dynamics.links). From B_(i-1) to B_i:

    R_i = Rx(alpha_(i-1)) Rz(theta_i),   r_i = p_(i-1) [+ q_i Rx(alpha_(i-1)) z]

    turned_back      vector R' v           inward           vector R v
    inward_matrix    matrix R X R'         force_in         force and moment, about the next origin
    body_in          mass, first moment and inertia, about the next origin

    from_tip         x_i = own_i + moved(joint i+1, x_(i+1))          a suffix, tip to base
    to_base          x carried from joint j to the base               a column of a row sweep

A vector is turned by two planar rotations, 8 multiplications and 4 additions, where a full matrix
takes 9 and 6 (Walker and Orin 1982). Elements that an algorithm knows to be zero are the number
0.0 and cost nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, TypeVar

import numpy as np

from pfd_core.machine.recorder import LaneArray, Lanes
from pfd_core.machine.vectors import UPPER, array, cross, symmetric_matrix, symmetric_sum

T = TypeVar('T')
# Cosine and sine of an angle: values, or numbers known while recording.
Planar = tuple[Any, Any]
Force = tuple[LaneArray, LaneArray]  # force and moment about the origin of the axes, (3,) each
# Mass, first moment, (3,), and inertia, (3, 3), about the origin of the axes.
Body = tuple[Any, LaneArray, LaneArray]
# Indices of the two axes of the plane of a rotation, and of its axis.
ABOUT_X = (1, 2, 0)
ABOUT_Z = (0, 1, 2)


@dataclass(frozen=True)
class Joint:
    """A joint at the input q: its link's axes B_i, seen from B_(i-1)."""

    slides: bool  # whether it is translational
    turn: Planar  # theta_i
    twist: Planar  # alpha_(i-1)
    square: bool  # whether alpha_(i-1) is 90 degrees, one way or the other, exactly
    parallel: bool  # whether alpha_(i-1) is 0 or 180 degrees, exactly
    r: LaneArray  # origin of B_i from the origin of B_(i-1), (3,), in axes B_(i-1) [m]


def sum_of_angles(a: Planar, b: Planar) -> Planar:
    """Return cosine and sine of the sum of two angles given by theirs."""
    return a[0] * b[0] - a[1] * b[1], a[1] * b[0] + a[0] * b[1]


def turned(angle: Planar, about: tuple[int, int, int], v: LaneArray) -> LaneArray:
    """Return a vector, (3,), turned about x or z (4 multiplications, 2 additions)."""
    c, s = angle
    i, j, k = about
    w = np.empty(3, dtype=object)
    w[i], w[j], w[k] = c * v[i] - s * v[j], s * v[i] + c * v[j], v[k]
    return w


def turned_matrix(
    angle: Planar, about: tuple[int, int, int], A: LaneArray, symmetric: bool
) -> LaneArray:
    """
    Return R A R', (3, 3), for R a rotation about x or z.

    12 multiplications and 11 additions; 8 and 8 for a symmetric A. cos^2 + sin^2 = 1 is used.
    """
    c, s = angle
    i, j, k = about
    t = s * (A[i, i] - A[j, j]) + c * (A[i, j] + A[j, i])
    st, ct = s * t, c * t
    B = np.empty((3, 3), dtype=object)
    B[i, i], B[j, j], B[k, k] = A[i, i] - st, A[j, j] + st, A[k, k]
    B[i, j] = ct - A[j, i]
    B[i, k], B[j, k] = c * A[i, k] - s * A[j, k], s * A[i, k] + c * A[j, k]
    if symmetric:
        B[j, i], B[k, i], B[k, j] = B[i, j], B[i, k], B[j, k]
    else:
        B[j, i] = ct - A[i, j]
        B[k, i], B[k, j] = c * A[k, i] - s * A[k, j], s * A[k, i] + c * A[k, j]
    return B


def turned_back(joint: Joint, v: LaneArray) -> LaneArray:
    """Return a vector of B_(i-1) in the axes B_i: R' v."""
    (c, s), (ca, sa) = joint.turn, joint.twist
    y, z = ca * v[1] + sa * v[2], ca * v[2] - sa * v[1]
    return array([c * v[0] + s * y, c * y - s * v[0], z])


def inward(joint: Joint, v: LaneArray) -> LaneArray:
    """Return a vector of B_i in the axes B_(i-1): R v."""
    return turned(joint.twist, ABOUT_X, turned(joint.turn, ABOUT_Z, v))


def inward_matrix(joint: Joint, A: LaneArray, symmetric: bool = True) -> LaneArray:
    """Return a matrix, (3, 3), of B_i in the axes B_(i-1): R A R'."""
    A = turned_matrix(joint.turn, ABOUT_Z, A, symmetric)
    if not joint.square:
        return turned_matrix(joint.twist, ABOUT_X, A, symmetric)
    # y and z change places, which takes no rounding.
    sa = joint.twist[1]
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = A
    across = [-(sa * xz), sa * xy]
    down = across if symmetric else [-(sa * zx), sa * yx]
    return array([[xx, *across], [down[0], zz, -zy], [down[1], -yz, yy]])


def force_in(joint: Joint, force: Force) -> Force:
    """Return a force of axes and origin B_i in axes and about the origin of B_(i-1)."""
    f, n = (inward(joint, v) for v in force)
    return f, n + cross(joint.r, f)


def body_in(joint: Joint, body: Body) -> Body:
    """Return a body of B_i in axes and about the origin of B_(i-1)."""
    m, h, J = body
    h, r = inward(joint, h), joint.r
    e = h + h + m * r
    xx, yy, zz = (r[k] * e[k] for k in range(3))
    xy, xz, yz = (r[i] * h[j] + h[i] * r[j] + m * (r[i] * r[j]) for i, j in UPPER if i != j)
    shift = symmetric_matrix(array([yy + zz, -xy, -xz, xx + zz, -yz, xx + yy]))
    return m, h + m * r, symmetric_sum(inward_matrix(joint, J), shift)


def body_sum(a: Body, b: Body) -> Body:
    """Return two bodies as one."""
    return a[0] + b[0], a[1] + b[1], symmetric_sum(a[2], b[2])


def force_sum(a: Force, b: Force) -> Force:
    """Return the sum of two forces."""
    return a[0] + b[0], a[1] + b[1]


def along(joint: Joint, force: Force) -> Any:
    """Return the torque of a joint that carries a force and a moment [N m or N]."""
    return force[0][2] if joint.slides else force[1][2]


def unit_force(joint: Joint, body: Body) -> Force:
    """Return the force of a body under a unit acceleration of its joint."""
    m, h, J = body
    if joint.slides:
        return array([0.0, 0.0, m]), array([h[1], -h[0], 0.0])
    # Of an inertia, which may not be exactly symmetric, only the upper triangle is read.
    return array([-h[1], h[0], 0.0]), J[:, 2].copy()


def from_tip(
    joints: Sequence[Joint],
    own: Sequence[T],
    plus: Callable[[T, T], T],
    moved: Callable[[Joint, T], T],
) -> Iterator[tuple[Joint, T]]:
    """
    Yield each joint with the sum of all beyond it, tip to base: own + moved(sum of the next).

    A sum is recorded when it is read. The order of a recording is part of its bits.
    """
    total: T | None = None
    for i in reversed(range(len(joints))):
        total = own[i] if total is None else plus(own[i], moved(joints[i + 1], total))
        yield joints[i], total


def to_base(
    joints: Sequence[Joint], j: int, x: T, moved: Callable[[Joint, T], T]
) -> Iterator[tuple[Joint, T]]:
    """Yield joints j, j-1 .. 0, each with x in the axes of its link."""
    carried = accumulate(joints[j:0:-1], lambda at, joint: moved(joint, at), initial=x)
    return zip(joints[j::-1], carried, strict=True)


def plus_cross(v: LaneArray, a: LaneArray, b: LaneArray) -> LaneArray:
    """Return v + a x b, product by product: a kernel fuses each with the sum so far."""
    x = v[0] + a[1] * b[2] - a[2] * b[1]
    y = v[1] + a[2] * b[0] - a[0] * b[2]
    return array([x, y, v[2] + a[0] * b[1] - a[1] * b[0]])


def with_axis(v: LaneArray, along_z: Lanes | float) -> LaneArray:
    """Return a vector plus one along z."""
    return array([v[0], v[1], v[2] + along_z])
