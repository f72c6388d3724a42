# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A serial chain on one processor: every link's quantities in the link's own axes.

    R_i = Rz(theta_i) Rx(alpha_i)      axes of frame i in axes i-1
    p_i = A_i' a_i [+ q_i z]           from the origin of frame i-1 to origin i, in axes i

This is the rotation of Denavit and Hartenberg, for any chain: A_i = Rz Rx Rz, and the last of
the three is removed by turning frame i about its own z axis, which is the axis of joint i + 1;
the next joint's angle starts from there. Frames are not moved along that axis, so that nearly
parallel axes do no harm. theta_i is q_i + constant for a rotational joint, and a constant for a
translational joint; the constant is added to the angle by its sine and cosine, so that a large
q_i loses no digits.

A vector is rotated by two planar rotations, 8 multiplications and 4 additions where a full matrix
takes 9 and 6, as in Walker and Orin 1982. Between the two rotations lie the axes of joint i:
fixed to link i, with z along the joint's axis.

Cost: 4 multiplications, 2 additions, a sine and a cosine for a rotational joint; 2 and 2 for a
translational joint, none for the last.

None means a vector that is known to be zero while recording, and costs nothing. Without an
external wrench frame n is laid on the last joint's axis: its twist is None, and so is its offset
unless the joint is translational.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.chain.base_axes import link_parameters
from pfd_core.algorithms.chain.interface import input_list, wrench_input
from pfd_core.machine.lanes import cos, sin, where
from pfd_core.machine.recorder import SCHEDULES, LaneArray, Lanes, Recorder
from pfd_core.machine.vectors import array, constants
from pfd_core.model import Plant
from pfd_core.model.geometry import product, rotation_z

Planar = tuple[Lanes, Lanes]
T = TypeVar('T', float, Lanes)
# Indices of the two axes of the plane of a rotation, and of its axis.
ABOUT_X = (1, 2, 0)
ABOUT_Z = (0, 1, 2)


@dataclass(frozen=True)
class Link:
    """
    One link at the input q, in its own axes.

    Attributes
    ----------
    slides : bool
        Whether its joint is translational.
    turn : tuple of Lanes
        Cosine and sine of theta, the rotation about the joint's axis.
    tilt : tuple of Lanes or None
        Cosine and sine of alpha, the twist from the joint's axis to the next one.
    p : LaneArray or None
        (3,), from the origin of the frame before to the origin of the link's frame [m].
    m : Lanes
        Mass [kg].
    s : LaneArray
        (3,), centre of mass from the origin of the link's frame [m].
    J : LaneArray
        (3, 3), inertia about the centre of mass [kg m^2].

    """

    slides: bool
    turn: Planar
    tilt: Planar | None
    p: Any
    m: Lanes
    s: LaneArray
    J: LaneArray


@dataclass(frozen=True)
class Chain:
    """
    The whole chain at the input q.

    Attributes
    ----------
    recorder : Recorder
        Of one lane.
    links : list of Link
        Base to tip.
    gravity : LaneArray or None
        (3,), acceleration of the base: minus gravity [m/s^2].
    wrench : tuple of LaneArray or None
        Force [N] and moment [N m], (3,) each, exerted on the last link about the origin of its
        frame, in its axes.

    """

    recorder: Recorder
    links: list[Link]
    gravity: LaneArray | None
    wrench: tuple[LaneArray, LaneArray] | None


def chain_in_link_axes(plant: Plant, schedule: str) -> Chain:
    """Return the chain of a plant at the input q; one processor has but one schedule."""
    if schedule not in SCHEDULES:
        raise ValueError(f'schedule must be one of {SCHEDULES}, got {schedule!r}')
    return chain_on(Recorder(1, 'sequential'), plant)


def chain_on(recorder: Recorder, plant: Plant) -> Chain:
    """Return the chain of a plant at the input q in a recording on one lane."""
    robot = plant.robot
    A, a, s, J = link_parameters(robot, keep_tip=plant.external_wrench)
    q = input_list(recorder, 'q', robot.n)
    links = []
    last = (1.0, 0.0)
    for i in range(robot.n):
        first, twist, following = zxz(A[i])
        Z = rotation_z(*following)
        slides = robot.joint_types[i] == 'prismatic'
        turn = planar(recorder, sum_of_angles(last, first))
        tilt = p = None
        if i < robot.n - 1 or plant.external_wrench:
            tilt = planar(recorder, twist)
            p = constants(recorder, product(Z, product(A[i].T, a[i])))
            if slides:
                p = _slid(p, tilt, q[i])
        elif slides:
            p = array([recorder.constant(0.0), recorder.constant(0.0), q[i]])
        links.append(
            Link(
                slides=slides,
                turn=turn if slides else _turned_by(q[i], turn),
                tilt=tilt,
                p=p,
                m=recorder.constant(robot.masses[i]),
                s=constants(recorder, product(Z, s[i])),
                J=constants(recorder, product(Z, J[i], Z.T)),
            )
        )
        last = following
    gravity = constants(recorder, -plant.gravity) if plant.gravity.any() else None
    return Chain(recorder, links, gravity, _wrench(recorder, plant, last))


def zxz(
    A: NDArray[np.float64],
) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
    """
    Return cosine and sine of the three angles of a rotation A = Rz Rx Rz, (3, 3).

    A matrix of exact zeros and ones gives exact zeros and ones. The third angle is measured
    after the first is taken away, so that their sum is right where the second is nearly zero
    and neither is well defined alone.
    """
    first = _unit(-A[1, 2], A[0, 2])
    rest = product(rotation_z(*first).T, A)
    return first, _unit(rest[2, 2], -rest[1, 2]), _unit(rest[0, 0], -rest[0, 1])


def _unit(x: float, y: float) -> tuple[float, float]:
    """Return (x, y) at length one, which removes rounding; (1, 0) for no length at all."""
    length = math.sqrt(x * x + y * y)
    return (x / length + 0.0, y / length + 0.0) if length > 0 else (1.0, 0.0)


def sum_of_angles(a: tuple[T, T], b: tuple[T, T]) -> tuple[T, T]:
    """Return cosine and sine of the sum of two angles given by theirs: numbers or lane values."""
    return a[0] * b[0] - a[1] * b[1], a[1] * b[0] + a[0] * b[1]


def _turned_by(q: Lanes, start: Planar) -> Planar:
    """Return cosine and sine of q plus the angle `start`."""
    with q.recorder.section('joint rotation'):
        return sum_of_angles((cos(q), sin(q)), start)


def _slid(p: LaneArray, tilt: Planar, q: Lanes) -> LaneArray:
    """Return p + q z; the joint's axis z has no x component in the link's axes."""
    with q.recorder.section('link vectors'):
        return array([p[0], p[1] + tilt[1] * q, p[2] + tilt[0] * q])


def planar(recorder: Recorder, angle: tuple[float, float]) -> Planar:
    """Return cosine and sine of an angle as constants."""
    return recorder.constant(angle[0]), recorder.constant(angle[1])


def _wrench(
    recorder: Recorder, plant: Plant, last: tuple[float, float]
) -> tuple[LaneArray, LaneArray] | None:
    """Return the input wrench in the axes of the last link, whose frame was turned."""
    if not plant.external_wrench:
        return None
    k = wrench_input(recorder)
    with recorder.section('wrench'):
        angle = planar(recorder, last)
        return rotated(angle, ABOUT_Z, k[:3]), rotated(angle, ABOUT_Z, k[3:])


def known(chain: Chain, values: Sequence[Lanes | None]) -> list[Lanes]:
    """Return values with the constant zero in the place of None."""
    zero = chain.recorder.constant(0.0)
    return [zero if value is None else value for value in values]


def released(free: Sequence[Lanes] | None, values: Sequence[Lanes]) -> list[Lanes]:
    """Return values, zero for braked joints; all of them without brakes (free is None)."""
    if free is None:
        return list(values)
    return [where(moves, value, 0.0) for moves, value in zip(free, values, strict=True)]


def rotated(angle: Planar, about: tuple[int, int, int], v: LaneArray) -> LaneArray:
    """Return a vector, (3,), rotated about x or z (4 multiplications, 2 additions)."""
    c, s = angle
    i, j, k = about
    result = np.empty(3, dtype=object)
    result[i], result[j], result[k] = c * v[i] - s * v[j], s * v[i] + c * v[j], v[k]
    return result


def rotated_matrix(
    angle: Planar, about: tuple[int, int, int], X: LaneArray, symmetric: bool
) -> LaneArray:
    """
    Return R X R', (3, 3), for R a rotation about x or z.

    12 multiplications and 11 additions; 8 and 8 for a symmetric X. cos^2 + sin^2 = 1 is used.
    """
    c, s = angle
    i, j, k = about
    t = s * (X[i, i] - X[j, j]) + c * (X[i, j] + X[j, i])
    st, ct = s * t, c * t
    Y = np.empty((3, 3), dtype=object)
    Y[i, i], Y[j, j], Y[k, k] = X[i, i] - st, X[j, j] + st, X[k, k]
    Y[i, j] = ct - X[j, i]
    Y[i, k], Y[j, k] = c * X[i, k] - s * X[j, k], s * X[i, k] + c * X[j, k]
    if symmetric:
        Y[j, i], Y[k, i], Y[k, j] = Y[i, j], Y[i, k], Y[j, k]
    else:
        Y[j, i] = ct - X[i, j]
        Y[k, i], Y[k, j] = c * X[k, i] - s * X[k, j], s * X[k, i] + c * X[k, j]
    return Y


def tilted(link: Link, v: Any) -> Any:
    """Return v, or None, from the link's axes to the axes of its joint."""
    return v if v is None or link.tilt is None else rotated(link.tilt, ABOUT_X, v)


def turned(link: Link, v: Any) -> Any:
    """Return v, or None, from the axes of the link's joint to the axes of link i-1."""
    return v if v is None else rotated(link.turn, ABOUT_Z, v)


def untilted(link: Link, v: Any) -> Any:
    """Return v, or None, from the axes of the link's joint to the link's axes."""
    return v if v is None or link.tilt is None else rotated(_back(link.tilt), ABOUT_X, v)


def unturned(link: Link, v: Any) -> Any:
    """Return v, or None, from the axes of link i-1 to the axes of the link's joint."""
    return v if v is None else rotated(_back(link.turn), ABOUT_Z, v)


def _back(angle: Planar) -> Planar:
    return angle[0], -angle[1]


def plus(*terms: Any) -> Any:
    """Return the sum of vectors or numbers, ignoring None; None if all are None."""
    result = None
    for term in terms:
        if term is not None:
            result = term if result is None else result + term
    return result
