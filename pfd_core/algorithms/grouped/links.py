# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Links with grouped inertial parameters: the fewest numbers that a chain's dynamics depend on.

Axes B_i are fixed to link i, with z along the axis of joint i and the origin on it. From B_(i-1)
to B_i:

    R_i = Rx(alpha_(i-1)) Rz(theta_i),  r_i = p_(i-1) [+ q_i Rx(alpha_(i-1)) z]

These are Denavit and Hartenberg's frames, for any chain: turning B_i about its z adds a constant
to an angle, and moving its origin along z makes p_y vanish, unless the origin would go far away
(the common normal of nearly parallel axes).

A body is its mass m, first moment h and inertia I about the origin. The part of link i that is
symmetric about the axis of its own rotational joint, m, h_z and diag(I_yy, I_yy, 0), moves with
link i - 1 as well as with link i, and is added to link i - 1 once, while recording; so is the
inertia about the centre of mass of a link on a translational joint. The remaining numbers,
I_xx - I_yy, I_xy, I_xz, I_yz, I_zz, h_x and h_y, are the base parameters: no kernel reads more of
a link.

Source: Mayeda, Yoshida and Osuka 1990 and Gautier and Khalil 1990 (base inertial parameters);
Khalil and Kleinfinger 1987 (that they cut the cost of the recursions).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.chain.link_axes import sum_of_angles, zxz
from pfd_core.model import Plant
from pfd_core.model.geometry import product, rotation_x, rotation_z

Array = NDArray[np.float64]

# Largest distance that an origin is moved along its axis, in lengths of the link: large distances
# cause large first moments, whose cancellation loses digits.
REACH = 2.0


@dataclass(frozen=True)
class Tip:
    """Axes of frame i, (3, 3), and its origin, (3,) [m], in axes B_i: of frame n the tip."""

    rotation: Array
    p: Array


@dataclass(frozen=True)
class JointAxes:
    """
    Axes B_i of one link.

    Attributes
    ----------
    slides : bool
        Whether its joint is translational.
    start : tuple of float
        Cosine and sine of theta_i at q_i = 0.
    twist : tuple of float
        Cosine and sine of alpha_(i-1), from the axis of joint i - 1 to that of joint i.
    p : ndarray
        (3,), origin of B_i at q_i = 0, in axes B_(i-1) [m].
    end : Tip
        Pose of frame i.

    """

    slides: bool
    start: tuple[float, float]
    twist: tuple[float, float]
    p: Array
    end: Tip


@dataclass(frozen=True)
class CenteredLink(JointAxes):
    """
    A link by the parameters that the robot is given by, in its axes B_i.

    Attributes
    ----------
    m : float
        Mass [kg].
    center : ndarray
        (3,), centre of mass [m].
    J : ndarray
        (3, 3), inertia about the centre of mass [kg m^2].

    """

    m: float
    center: Array
    J: Array


@dataclass(frozen=True)
class GroupedLink(JointAxes):
    """
    A link by grouped parameters, in its axes B_i.

    Attributes
    ----------
    m : float
        Mass [kg].
    h : ndarray
        (3,), first moment [kg m].
    inertia : ndarray
        (3, 3), about the origin [kg m^2].

    """

    m: float
    h: Array
    inertia: Array


def grouped_links(plant: Plant) -> tuple[list[GroupedLink], Tip]:
    """Return the grouped links of a plant, base to tip, and the pose of frame n."""
    centered, tip = centered_links(plant)
    links = [_about_the_origin(link) for link in centered]
    for i in range(len(links) - 1, 0, -1):
        links[i], moved = _split(links[i])
        links[i - 1] = _added(links[i - 1], to_previous_axes(links[i], moved))
    return links, tip


Body = tuple[float, Array, Array]  # mass, first moment, inertia about the origin


def centered_links(plant: Plant) -> tuple[list[CenteredLink], Tip]:
    """Return the links of a plant, not grouped, base to tip, and the pose of frame n."""
    robot = plant.robot
    links: list[CenteredLink] = []
    before, twist, p = (1.0, 0.0), (1.0, 0.0), np.zeros(3)
    slid = 0.0  # distance that the origin of B_i was moved along its axis
    for i in range(robot.n):
        A, a = robot.rotations[i], robot.translations[i]
        first, tilt, following = zxz(A)
        Z = rotation_z(*first)
        axis = np.array([0.0, 0.0, slid])
        center = product(Z.T, a + product(A, robot.centers[i])) - axis
        J = product(Z.T, A, robot.inertias[i], A.T, Z)
        m = float(robot.masses[i])
        offset = product(Z.T, a) - axis
        start = sum_of_angles(before, first)
        slides = robot.joint_types[i] == 'prismatic'
        end = Tip(product(rotation_x(*tilt), rotation_z(*following)), offset)
        links.append(CenteredLink(slides, start, twist, p, end, m, center, J))
        slid = _slide(offset, tilt)
        p = offset + slid * product(rotation_x(*tilt), np.array([0.0, 0.0, 1.0]))
        if slid:
            p[1] = 0.0  # exactly, without the rounding of the line above
        before, twist = following, tilt
    return links, links[-1].end


def _about_the_origin(link: CenteredLink) -> GroupedLink:
    inertia = link.J + link.m * moments(link.center, link.center)
    h = link.m * link.center
    return GroupedLink(link.slides, link.start, link.twist, link.p, link.end, link.m, h, inertia)


def _slide(offset: Array, tilt: tuple[float, float]) -> float:
    """Return the distance along the next axis that makes p_y of the next origin vanish, or 0."""
    sine = tilt[1]
    if offset[1] == 0 or sine == 0:
        return 0.0
    distance = float(offset[1]) / sine
    return distance if abs(distance) <= REACH * float(np.sqrt(offset @ offset)) else 0.0


def _split(link: GroupedLink) -> tuple[GroupedLink, Body]:
    """Return the rest of a link, and the part that moves with the link before it as well."""
    if link.slides:
        J = link.inertia - (moments(link.h, link.h) / link.m if link.m else 0.0)
        return replace(link, inertia=link.inertia - J), (0.0, np.zeros(3), J)
    yy = float(link.inertia[1, 1])
    inertia = link.inertia - np.diag([yy, yy, 0.0])
    h = np.array([link.h[0], link.h[1], 0.0])
    rest = replace(link, m=0.0, h=h, inertia=inertia)
    return rest, (link.m, np.array([0.0, 0.0, link.h[2]]), np.diag([yy, yy, 0.0]))


def to_previous_axes(link: JointAxes, body: Body) -> Body:
    """Return a body of B_i that does not depend on q_i, in axes B_(i-1)."""
    m, h, inertia = body
    R = rotation_x(*link.twist)
    if link.slides:
        R = product(R, rotation_z(*link.start))
    h = product(R, h)
    inertia = product(R, inertia, R.T)
    shift = moments(link.p, h) + moments(h, link.p) + m * moments(link.p, link.p)
    return m, h + m * link.p, inertia + shift


def _added(link: GroupedLink, body: Body) -> GroupedLink:
    m, h, inertia = body
    return replace(link, m=link.m + m, h=link.h + h, inertia=link.inertia + inertia)


def moments(a: Array, b: Array) -> Array:
    """Return a.b 1 - b a' (3, 3): the inertia of a point at a for the first moment b."""
    dot = math.fsum((a * b).tolist())
    return dot * np.eye(3) - np.multiply.outer(b, a)
