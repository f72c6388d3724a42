# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conditions on a rotation and an inertia, and the rounding that they tolerate."""

from __future__ import annotations

import numpy as np

from pfd_core.model.error_text import quote
from pfd_core.model.geometry import Array

# A rotation with 16 digits, or a product of a few, is orthonormal to some 1e-15; a rotation with
# 6 digits only to 1e-6, and would stretch every link.
ROTATION_TOLERANCE = 1e-12
# Rotating an inertia rounds at 1e-16 of its largest element, several times over; so does moving
# it to the centre of mass, at 1e-16 of the mass times the square of the way.
INERTIA_TOLERANCE = 1e-12
# A flat body reaches the bound of the triangle rule; 1e-9 is far above its rounding and below the
# last published digit.
TRIANGLE_TOLERANCE = 1e-9


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
