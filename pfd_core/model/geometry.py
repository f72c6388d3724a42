# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Rotations and rigid bodies as plain arrays, with zeros and ones that stay exact, and their checks.

A kernel folds a factor of exactly 0 or 1 away, so a twist of 90 degrees must not become 6e-17:
angles that are multiples of 90 degrees give exact matrices here.
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
# A rotation with 16 digits, or a product of a few, is orthonormal to some 1e-15; a rotation with
# 6 digits only to 1e-6, and would stretch every link.
ROTATION_TOLERANCE = 1e-12
# Rotating an inertia rounds at 1e-16 of its largest element, several times over; so does moving
# it to the centre of mass, at 1e-16 of the mass times the square of the distance.
INERTIA_TOLERANCE = 1e-12
# A flat body reaches the bound of the triangle rule; 1e-9 is far above its rounding and below the
# last published digit.
TRIANGLE_TOLERANCE = 1e-9
# A multiple of pi/2 is off by its own rounding: for two whole turns by 1e-15.
MOST_QUARTERS = 8
_QUARTERS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))  # cosine, sine


def product(first: Array, *others: Array) -> Array:
    """
    Return the matrix product of a matrix, (3, 3), with matrices, (3, 3), or vectors, (3,).

    NumPy's own product calls a BLAS, which rounds differently from one processor to another; this
    one gives the same bits everywhere, as a replay needs.
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


def chained(*frames: Placement) -> Placement:
    """Return the last frame in the base of the first; each frame is given in the one before."""
    R, p = frames[0]
    for turn, way in frames[1:]:
        R, p = snapped(product(R, turn)), p + product(R, way)
    return R, p


def inverse(placement: Placement) -> Placement:
    """Return the outer frame in the inner one."""
    R, p = placement
    return R.T, -product(R.T, p)


def without_residue(values: Array, scale: float) -> Array:
    """Return values with exact zeros for residues of rounding at a scale."""
    return np.where(np.abs(values) <= RIGHT_ANGLE_TOLERANCE * scale, 0.0, values)


def snapped(rotation: Array) -> Array:
    """
    Return a rotation, (3, 3), with exact 0, 1 and -1 for elements that differ by rounding.

    The rotation is returned unchanged if that would make it less orthonormal than rounding does.
    """
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


def welded_frames(placements: list[Placement], bodies: list[Body]) -> dict[str, Any]:
    """
    Return the fields of `Robot` for frames, masses, centres and inertias of a chain.

    `placements` are n + 1: joint 1 in the base link, joint 2 in joint 1, ..., the tip in joint n;
    `bodies` are n links, each in the frame of its joint. Joint i turns about, or slides along, z
    of a separate frame, with which link i moves; frame i of the paper is the frame of joint i+1 at
    rest on link i, frame 0 that of the first joint.
    """
    bodies = [
        (mass, product(A.T, c - a), product(A.T, J, A))
        for (A, a), (mass, c, J) in zip(placements[1:], bodies, strict=True)
    ]
    R, p = placements[0]
    return link_fields(placements[1:], bodies) | {'base_rotation': R, 'base_position': p}


def link_fields(placements: list[Placement], bodies: list[Body]) -> dict[str, Any]:
    """Return the fields of `Robot` for the frames of links, each in the one before, and bodies."""
    rotations, translations = zip(*placements, strict=True) if placements else ((), ())
    masses, centers, inertias = zip(*bodies, strict=True) if bodies else ((), (), ())
    return {
        'rotations': np.array(rotations),
        'translations': np.array(translations),
        'masses': np.array(masses),
        'centers': np.array(centers),
        'inertias': np.array(inertias),
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

    `moment` is the mass times the square of a length of the robot [kg m^2]: an element that is
    small compared with it may be rounding.
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
