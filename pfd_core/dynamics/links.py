# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Links with grouped inertial parameters: the fewest numbers that a chain's dynamics depend on.

Axes B_i are fixed to link i, with z along the axis of joint i and the origin on it. From B_(i-1)
to B_i:

    R_i = Rx(alpha_(i-1)) Rz(theta_i),  r_i = p_(i-1) [+ q_i Rx(alpha_(i-1)) z]

These are Denavit and Hartenberg's frames, for any chain: turning B_i about its z adds a constant
to an angle, and moving its origin along z makes p_y vanish, unless the origin would go far away
(the common normal of nearly parallel axes). Between parallel axes it makes p_z vanish where the
origin is far from its neighbours.

A body is its mass m, first moment h and inertia I about the origin. The part of link i that is
symmetric about the axis of its own rotational joint, m, h_z and diag(I_yy, I_yy, 0), moves with
link i - 1 as well as with link i, and is added to link i - 1 once, while recording; so is the
inertia about the centre of mass of a link on a translational joint. The remaining numbers,
I_xx - I_yy, I_xy, I_xz, I_yz, I_zz, h_x and h_y, are the base parameters: no kernel reads more of
a link. They are differences of moments that grow with the square of the distance of a link from
the origins, and so are computed in DIGITS digits.

Source: Mayeda, Yoshida and Osuka 1990 and Gautier and Khalil 1990 (base inertial parameters);
Khalil and Kleinfinger 1987 (that they cut the cost of the recursions).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from decimal import Context, Decimal, localcontext
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfd_core.dynamics.joints import sum_of_angles
from pfd_core.machine.vectors import UPPER
from pfd_core.model.geometry import Placement, product, rotation_x, rotation_z
from pfd_core.model.robot import Robot

# Kinds of parameters of links, see pfd_core.dynamics.chain.
GROUPED, CENTERED, GIVEN = 'grouped', 'centered', 'given'
# Numbers of a body: mass, first moment or centre of mass, six elements of the inertia.
NUMBERS = 10

Array = NDArray[Any]
Angle = tuple[float, float]  # cosine and sine
# Mass, first moment and inertia about the origin, of floats or Decimals.
Body = tuple[Any, Array, Array]

# Largest distance that an origin is moved along its axis, in lengths of the link: large distances
# cause large first moments, whose cancellation loses digits.
REACH = 2.0

# Between parallel axes any place of an origin serves: it is moved if that brings it so many times
# nearer to its neighbours.
NEARER = 8.0

# Digits in which parameters are grouped. Where a link or its frame is far along an axis, large
# moments of inertia cancel: 1e6 m from the axis of a joint take 13 digits.
DIGITS = 50
# Parameters that float64 groups with so small an error, relative to the parameter or to the
# inertia about the joint's axis, keep its bits. All arms of config/robots have only such ones.
KEPT = 64 * 2.0**-53


class Link(NamedTuple):
    """A link by the parameters that the robot is given by, in its axes B_i."""

    slides: bool  # whether its joint is translational
    start: Angle  # theta_i at q_i = 0
    twist: Angle  # alpha_(i-1), from the axis of joint i - 1 to the axis of joint i
    p: Array  # origin of B_i at q_i = 0, in axes B_(i-1), (3,) [m]
    end: Placement  # pose of frame i; of frame n the tip
    m: float  # mass [kg]
    center: Array  # centre of mass, (3,) [m]
    arm: Array  # the same from the origin of frame i [m]
    J: Array  # inertia about the centre of mass, (3, 3) [kg m^2]


def link_numbers(robot: Robot, kind: str) -> Array:
    """Return the NUMBERS of each link, (n, NUMBERS), by the kind of parameters."""
    links = centered_links(robot, moved=kind != GIVEN)
    if kind == GROUPED:
        return _grouped_numbers(links)
    return np.array([body_numbers((x.m, x.center, x.J)) for x in links])


def body_numbers(body: Body) -> Array:
    """Return the NUMBERS of a body."""
    m, vector, inertia = body
    return np.array([m, *vector, *(inertia[k] for k in UPPER)])


def _grouped_numbers(links: Sequence[Link]) -> Array:
    """Return grouped parameters; those that float64 has computed within KEPT, and masses, stay."""
    rounded = _grouped(links, float)
    with localcontext(Context(prec=DIGITS)):
        exact = _grouped(links, Decimal)
    scale = np.full(exact.shape, np.inf)
    scale[:, 1:4] = np.abs(exact[:, 1:4]).max(axis=1, keepdims=True)
    scale[:, 4:] = np.abs(exact[:, 9:])
    near = np.abs(rounded - exact) <= KEPT * np.maximum(np.abs(exact), scale)
    return np.where(near, rounded, exact)


def _grouped(links: Sequence[Link], number: Callable[[float], Any]) -> Array:
    """Return grouped parameters, (n, NUMBERS), computed in one kind of numbers."""

    def numbers(values: Array) -> Array:
        result: Array = np.array([number(x) for x in values.flat], dtype=object)
        return result.reshape(values.shape)

    bodies: list[Body] = []
    for link in links:
        m, center, J = number(link.m), numbers(link.center), numbers(link.J)
        bodies.append((m, m * center, J + m * moments(center, center)))
    found = grouped(links, bodies, numbers)
    return np.array([body_numbers(body) for body in found]).astype(np.float64)


def grouped(
    links: Sequence[Link],
    bodies: Sequence[Body],
    numbers: Callable[[Array], Array],
    whole: bool = False,
) -> list[Body]:
    """
    Return bodies less the parts that move with the link before as well, which are added to it.

    Bodies are in axes B_i; `numbers` converts the axes to the kind of numbers that they have. The
    result is linear in the bodies if a translational joint passes the `whole` inertia on, not the
    inertia about the centre of mass.
    """
    result = list(bodies)
    for i in range(len(links) - 1, 0, -1):
        result[i], carried = _split(links[i].slides, result[i], whole)
        moved = _to_previous_axes(links[i], carried, numbers)
        result[i - 1] = tuple(x + y for x, y in zip(result[i - 1], moved, strict=True))
    return result


def centered_links(robot: Robot, moved: bool = True, bodies: Robot | None = None) -> list[Link]:
    """
    Return the links of a robot, not grouped, base to tip.

    Unless origins are `moved` along their axes, that of B_i is the origin of frame i-1: then no
    number is a sum, and rotations of zeros and ones round nothing but `center`. The bodies of the
    links are the robot's, or, in the robot's axes, those of a robot with the same frames.
    """
    bodies = robot if bodies is None else bodies
    links: list[Link] = []
    before, twist, p = (1.0, 0.0), (1.0, 0.0), np.zeros(3)
    slid = 0.0  # distance that the origin of B_i was moved along its axis
    for i in range(robot.links):
        A, a = robot.rotations[i], robot.translations[i]
        first, tilt, following = zxz(A)
        Z = rotation_z(*first)
        axis = np.array([0.0, 0.0, slid])
        arm = product(A, bodies.centers[i])
        center = product(Z.T, a + arm) - axis
        J = product(Z.T, A, bodies.inertias[i], A.T, Z)
        m = float(bodies.masses[i])
        offset = product(Z.T, a) - axis
        start = sum_of_angles(before, first)
        slides = robot.movers[i].kind == 'prismatic'
        end = product(rotation_x(*tilt), rotation_z(*following)), offset
        links.append(Link(slides, start, twist, p, end, m, center, product(Z.T, arm), J))
        slid = _slide(offset, tilt) if moved else 0.0
        if moved and tilt[1] == 0 and i + 1 < robot.links:
            slid = _level(-tilt[0] * float(offset[2]), robot, i + 1)
        p = offset + slid * product(rotation_x(*tilt), np.array([0.0, 0.0, 1.0]))
        if slid and tilt[1]:
            p[1] = 0.0  # exactly, without the rounding of the line above
        before, twist = following, tilt
    return links


def zxz(A: Array) -> tuple[Angle, Angle, Angle]:
    """
    Return cosine and sine of the three angles of a rotation A = Rz Rx Rz, (3, 3).

    A matrix of exact zeros and ones gives exact zeros and ones. The third angle is measured
    after the first is taken away, so that their sum is right where the second is nearly zero
    and neither is well defined alone.
    """
    first = _unit(-A[1, 2], A[0, 2])
    rest = product(rotation_z(*first).T, A)
    return first, _unit(rest[2, 2], -rest[1, 2]), _unit(rest[0, 0], -rest[0, 1])


def _unit(x: float, y: float) -> Angle:
    """Return (x, y) at length one, which removes rounding; (1, 0) for no length at all."""
    length = math.sqrt(x * x + y * y)
    return (x / length + 0.0, y / length + 0.0) if length > 0 else (1.0, 0.0)


def _slide(offset: Array, tilt: Angle) -> float:
    """Return the distance along the next axis that makes p_y of the next origin vanish, or 0."""
    sine = tilt[1]
    if offset[1] == 0 or sine == 0:
        return 0.0
    distance = float(offset[1]) / sine
    return distance if abs(distance) <= REACH * float(np.sqrt(offset @ offset)) else 0.0


def _level(distance: float, robot: Robot, i: int) -> float:
    """
    Return the distance along an axis parallel to the one before at which their origins meet, or 0.

    An origin is moved only if the farthest of its neighbours, the next origin and the centre of
    link i, comes NEARER times as near.
    """
    A, a = robot.rotations[i], robot.translations[i]
    heights = float(a[2]), float((a + product(A, robot.centers[i]))[2])
    before = max(abs(x) for x in (distance, *heights))
    after = max(abs(x - distance) for x in heights)
    return distance if NEARER * after < before else 0.0


def _split(slides: bool, body: Body, whole: bool) -> tuple[Body, Body]:
    """Return the rest of a link, and the part that moves with the link before it as well."""
    m, h, inertia = body
    if slides:
        J = inertia if whole or not m else inertia - moments(h, h) / m
        return (m, h, inertia - J), (0, 0 * h, J)
    yy = inertia[1, 1]
    symmetric = np.diag(np.array([yy, yy, 0], dtype=inertia.dtype))
    across, along = (np.array(v, dtype=h.dtype) for v in ([h[0], h[1], 0], [0, 0, h[2]]))
    return (0, across, inertia - symmetric), (m, along, symmetric)


def _to_previous_axes(link: Link, body: Body, numbers: Callable[[Array], Array]) -> Body:
    """Return a body of B_i that does not depend on q_i, in axes B_(i-1)."""
    m, h, inertia = body
    R = rotation_x(*link.twist)
    if link.slides:
        R = product(R, rotation_z(*link.start))
    R, p = numbers(R), numbers(link.p)
    h = product(R, h)
    inertia = product(R, inertia, R.T)
    shift = moments(p, h) + moments(h, p) + m * moments(p, p)
    return m, h + m * p, inertia + shift


def moments(a: Array, b: Array) -> Array:
    """Return a.b 1 - b a' (3, 3): the inertia of a point at a for the first moment b."""
    products = (a * b).tolist()
    dot = math.fsum(products) if isinstance(products[0], float) else sum(products)
    result: Array = dot * np.eye(3, dtype=a.dtype) - np.multiply.outer(b, a)
    return result
