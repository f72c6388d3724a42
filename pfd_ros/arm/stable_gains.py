# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The largest gains with which a PD loop through a zero-order hold is stable.

A controller reads the state every T seconds and holds its torque -kp q - kd qd until the next
reading. Linearize about a configuration with the inertia matrix H, without delay, damping and
friction. Let the gains be proportional to a diagonal D: kp = p D and kd = d D. The loop then
separates into one sampled loop for each mode of the pair (H, D); its inertia m is an eigenvalue of
D^-1 H. With a = p T^2 / (2 m) and b = d T / m its characteristic polynomial is
z^2 - (2 - a - b) z + (1 + a - b). Its roots lie inside the unit circle if, and only if,

    0 < a < b < 2,   that is   p / d < 2 / T   and   d < 2 m / T

(criterion of Jury). So the mode with the least inertia sets the bounds. Its inertia is far below
the joint inertias, since a torque at one joint accelerates the others too.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class GainLimits(NamedTuple):
    """Bounds of stable gains; beyond any of them the loop diverges.

    Attributes
    ----------
    ratio
        Bound of kp / kd, 1/s.
    velocity
        Bounds of kd (n,), N m s/rad or N s/m, if all joints have the same share of their bounds.
    position
        Bounds of kp (n,), N m/rad or N/m, which are reached only with kd close to its bound.
    equal_velocity
        Bound of kd, if it is the same number for each joint.
    """

    ratio: float
    velocity: NDArray[Any]
    position: NDArray[Any]
    equal_velocity: float


def gain_limits(inertia: NDArray[Any], period: float) -> GainLimits:
    """Return the bounds of a PD loop.

    Parameters
    ----------
    inertia
        H (n, n), kg m^2 or kg, positive definite.
    period
        Time from one reading of the state to the next, T, s.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the matrix is not finite and positive definite.
    """
    if not np.isfinite(inertia).all():
        raise np.linalg.LinAlgError('the inertia matrix is not finite')
    np.linalg.cholesky(inertia)
    diagonal = np.diagonal(inertia)
    scale = 1.0 / np.sqrt(diagonal)
    # 1 without coupling, close to 0 where the joints throw each other about.
    share = np.linalg.eigvalsh(scale[:, None] * inertia * scale)[0]
    velocity = 2.0 * share * diagonal / period
    return GainLimits(
        ratio=2.0 / period,
        velocity=velocity,
        position=2.0 / period * velocity,
        equal_velocity=float(2.0 * np.linalg.eigvalsh(inertia)[0] / period),
    )
