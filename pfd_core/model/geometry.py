# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Rotations and rigid bodies as plain arrays, with zeros and ones that stay exact, and their checks.

A kernel folds a factor of exactly 0 or 1 away, so multiples of 90 degrees give exact matrices.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.model.values import Array, quote

Placement = tuple[Array, Array]  # axes, (3, 3), and origin, (3,) [m], of a frame in another
AT_ORIGIN: Placement = (np.eye(3), np.zeros(3))
Body = tuple[float, Array, Array]  # mass [kg], its centre, (3,) [m], inertia about it, (3, 3)

# Sine and cosine of the double nearest a multiple of pi/2 differ from 0 and 1 by at most 1 ulp of
# the angle; two products of such matrices add a few more. A larger difference was meant.
RIGHT_ANGLE_TOLERANCE = 8 * np.finfo(float).eps
# A snapped rotation must be as orthonormal as rounding leaves any rotation.
ORTHONORMAL_TOLERANCE = 16 * np.finfo(float).eps
# Of a rotation with 16 digits, or a product of a few; one with 6 digits would stretch every link.
ROTATION_TOLERANCE = 1e-12
# Rotating an inertia, or moving it to the centre of mass, rounds at 1e-16 several times over.
INERTIA_TOLERANCE = 1e-12
# A flat body reaches the bound of the triangle rule: above its rounding, below published digits.
TRIANGLE_TOLERANCE = 1e-9
# A multiple of pi/2 is off by its own rounding: for two whole turns by 1e-15.
MOST_QUARTERS = 8
_QUARTERS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))  # cosine, sine


def product(first: Array, *others: Array) -> Array:
    """
    Return the matrix product of a matrix, (3, 3), with matrices, (3, 3), or vectors, (3,).

    With the same bits everywhere, as a replay needs; NumPy's own product calls a BLAS.
    """
    result = first
    for other in others:
        # Multiplied, then summed over the inner index, in its order.
        terms = result[:, :, None] * (other[None, :, None] if other.ndim == 1 else other[None])
        summed = terms[:, 0] + terms[:, 1] + terms[:, 2]
        result = summed[:, 0] if other.ndim == 1 else summed
    return result


def cos_sin_degrees(angle: float) -> tuple[float, float]:
    """Return cosine and sine of an angle in degrees, exact for multiples of 90."""
    quarters, rest = divmod(angle, 90.0)
    if rest == 0.0:
        return _QUARTERS[int(quarters) % 4]
    return math.cos(math.radians(angle)), math.sin(math.radians(angle))


def cos_sin(angle: float) -> tuple[float, float]:
    """Return cosine and sine of an angle [rad], exact for the doubles nearest right angles."""
    quarters = round(angle / (math.pi / 2))
    if abs(quarters) <= MOST_QUARTERS and angle == quarters * (math.pi / 2):
        return _QUARTERS[quarters % 4]
    return math.cos(angle), math.sin(angle)


def rotation_x(cosine: float, sine: float) -> Array:
    """Return the rotation about x, (3, 3), from the cosine and sine of its angle."""
    return np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]], dtype=float)


def rotation_z(cosine: float, sine: float) -> Array:
    """Return the rotation about z, (3, 3), from the cosine and sine of its angle."""
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]], dtype=float)


def rotation_rpy(roll: float, pitch: float, yaw: float) -> Array:
    """Return the rotation by roll, pitch and yaw [rad] about the fixed axes x, y, z, (3, 3)."""
    cosine, sine = cos_sin(pitch)
    about_y = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]], dtype=float)
    return product(rotation_z(*cos_sin(yaw)), about_y, rotation_x(*cos_sin(roll)))


def angles_of_quaternion(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """
    Return roll, pitch and yaw [rad] of a quaternion of any norm but 0, precise at any pitch.

    Bernardes and Viollet 2022: half the sum and half the difference of roll and yaw are angles of
    two planar vectors, and the pitch follows from their lengths. At a pitch of a right angle one
    of the vectors is zero, apart from rounding, and its angle arbitrary.
    """
    scale = RIGHT_ANGLE_TOLERANCE * math.hypot(x, y, z, w)
    a, b, c, d = (0.0 if abs(n) <= scale else n for n in (w - y, x + z, y + w, z - x))
    half_sum, half_difference = math.atan2(b, a), math.atan2(d, c)
    pitch = 2 * math.atan2(math.hypot(c, d), math.hypot(a, b)) - math.pi / 2
    return half_sum - half_difference, pitch, half_sum + half_difference


def composed(outer: Placement, inner: Placement) -> Placement:
    """Return a frame that is given in another one, in the frame outside of both."""
    (R, p), (turn, way) = outer, inner
    return product(R, turn), p + product(R, way)


def chained(*frames: Placement) -> Placement:
    """Return the last frame in the base of the first; each frame is given in the one before."""
    R, p = frames[0]
    for frame in frames[1:]:
        R, p = composed((R, p), frame)
        R = snapped(R)
    return R, p


def inverse(placement: Placement) -> Placement:
    """Return the outer frame in the inner one."""
    R, p = placement
    return R.T, -product(R.T, p)


def without_residue(values: Array, scale: float) -> Array:
    """Return values with exact zeros for residues of rounding at a scale."""
    return np.where(np.abs(values) <= RIGHT_ANGLE_TOLERANCE * scale, 0.0, values)


def snapped(rotation: Array) -> Array:
    """Return a rotation, (3, 3), with exact 0, 1 and -1 for elements that differ by rounding."""
    result = rotation.copy()
    for value in (0.0, 1.0, -1.0):
        result[np.abs(result - value) <= RIGHT_ANGLE_TOLERANCE] = value
    error = np.abs(result.T @ result - np.eye(3)).max()
    return result if error <= ORTHONORMAL_TOLERANCE else rotation


def axis_rotation(axis: ArrayLike) -> Array:
    """
    Return a rotation, (3, 3), whose third column is the given axis, (3,), made unit length.

    The identity for z, a signed permutation for the other coordinate axes, and otherwise the
    rotation that turns z to the axis by the shortest way.
    """
    # The largest component is divided out first: a long or short axis neither over- nor
    # underflows, and an aligned one comes out exact.
    v = np.asarray(axis, dtype=float)
    v = v / np.abs(v).max()
    v = v / np.sqrt((v * v).sum()) + 0.0
    x, y, z = v.tolist()
    if z < 0:
        # From -z instead, after half a turn about x: the formula below divides by 1 + z.
        half_turn = np.diag([1.0, -1.0, -1.0])
        return product(half_turn, axis_rotation(product(half_turn, v))) + 0.0
    if y == z == 0:
        return np.array([[0, 0, x], [x, 0, 0], [0, 1, 0]])
    if x == z == 0:
        return np.array([[0, y, 0], [0, 0, y], [1, 0, 0]])
    if x == y == 0:
        return np.eye(3)
    k = 1.0 / (1.0 + z)
    return np.array([[1 - k * x * x, -k * x * y, x], [-k * x * y, 1 - k * y * y, y], [-x, -y, z]])


def symmetric(xx: float, yy: float, zz: float, xy: float, yz: float, xz: float) -> Array:
    """Return the symmetric matrix, (3, 3), with these elements."""
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], dtype=float)


def merged(first: Body, second: Body) -> Body:
    """Return two bodies, given in one frame and welded together, as one."""
    (m1, c1, J1), (m2, c2, J2) = first, second
    mass = m1 + m2
    if m1 == 0 or m2 == 0:
        return mass, c1 if m2 == 0 else c2, J1 + J2
    # The two centres lie on one line with the common one, so that a reduced mass describes them.
    center = (m1 * c1 + m2 * c2) / mass
    offset = c2 - c1
    x, y, z = offset * offset
    apart = m1 * m2 / mass * ((x + y + z) * np.eye(3) - np.outer(offset, offset))
    return mass, center, J1 + J2 + apart


def moved(frame: Placement, body: Body) -> Body:
    """Return a body that is given in a frame as seen from outside of it."""
    (R, p), (mass, center, J) = frame, body
    return mass, p + product(R, center), product(R, J, R.T)


def seen_in(frame: Placement, body: Body) -> Body:
    """Return a body as seen in a frame."""
    (R, p), (mass, center, J) = frame, body
    return mass, product(R.T, center - p), product(R.T, J, R)


def welded_fields(placements: list[Placement], bodies: list[Body]) -> dict[str, Any]:
    """
    Return the fields of `Robot` for bodies in the frames of joints, each given in the one before.

    `placements` are n + 1: joint 1 in the base link, ..., the tip in joint n. Link i moves with
    the frame of joint i; frame i of the paper is that of joint i+1 at rest on link i.
    """
    return chain_fields(placements, [*map(seen_in, placements[1:], bodies)])


def chain_fields(placements: list[Placement], bodies: list[Body]) -> dict[str, Any]:
    """Return the fields of `Robot` for frames 0 to n, each in the one before, and n bodies."""
    (R, p), *frames = placements
    return {
        'base_rotation': R,
        'base_position': p,
        'rotations': np.array([R for R, _ in frames]),
        'translations': np.array([p for _, p in frames]),
        'masses': np.array([mass for mass, _, _ in bodies]),
        'centers': np.array([center for _, center, _ in bodies]),
        'inertias': np.array([J for _, _, J in bodies]),
    }


def check_rotation(label: str, R: Array) -> None:
    """Raise ValueError unless a matrix, (3, 3), is a rotation."""
    error = float(np.abs(R.T @ R - np.eye(3)).max())
    if error > ROTATION_TOLERANCE:
        raise ValueError(
            f'{label} must be orthonormal to {ROTATION_TOLERANCE:g}, it is off by {error:.1e}; '
            'write its elements with 16 digits'
        )
    if np.linalg.det(R) < 0:
        raise ValueError(f'{label} must be right-handed, its determinant is -1')


def check_inertia(label: str, J: Array, moment: float = 0.0) -> None:
    """
    Raise ValueError unless an inertia, (3, 3), is symmetric and has no negative moment.

    An element that is small compared with `moment` [kg m^2], of the robot, may be rounding.
    """
    tolerance = INERTIA_TOLERANCE * max(float(np.abs(J).max()), moment)
    if np.abs(J - J.T).max() > tolerance:
        raise ValueError(f'{label} must be symmetric, got {quote(J.tolist())}')
    moments = np.linalg.eigvalsh(J)
    if moments[0] < -tolerance:
        raise ValueError(
            f'{label} must not be negative in any direction, but its principal moments are '
            f'{moments.tolist()} kg m^2'
        )
