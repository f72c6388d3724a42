# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Predicted errors of forward dynamics and its derivatives, and the bounds of the hard cases.

A bound is FACTOR times the predicted error. No number here was chosen on a measured error.
Relative errors of a state, in units of rounding u:

    1                   the last sum of the answer is rounded
    SPREAD kappa_s      each number of robot, scene and state enters ROUNDINGS operations of the
                        Newton-Euler residual, in frames of the links. A rounding acts as a
                        relative change of that number by up to u, with root mean square RMS u.
                        Independent roundings add up as the root of their number (Higham and Mary
                        2019). kappa_s is the change of the answer for such changes
    SPREAD kappa_J      without refinement also the roundings of H and of its factor: the error of
                        a Cholesky factor scales with the condition of H after Jacobi scaling
                        (Demmel 1989; Higham, Accuracy and Stability, theorem 10.6)

With refinement, the error of the factor is multiplied by the error of the first answer, which the
kernel estimates. A kernel whose estimate leaves no digit has no bound.

A matrix of derivatives, or A and B of a step, has its own condition number kappa_s, and more
operations for each number:

    DERIVED kappa_s         differentiating a product adds three operations, a sum one
    DERIVED kappa_J share   H d qdd / d x = -d r / d x is solved with the factor of H, without
                            refinement. `share` is the part of A that forces cause
    gain share              times the predicted error of the acceleration at which inverse
                            dynamics is differentiated; only in d qdd / d q and A
"""

from __future__ import annotations

import math

import numpy as np

from pfd_core.report.cases.hard_cases import ROUNDING
from pfd_core.report.cases.robots import Array

FACTOR = 5.0
# Luh, Walker and Paul 1980: 150 n multiplications and 131 n additions; a link and its joint have
# mass, centre, inertia, offset of the next joint, position, velocity and torque.
ROUNDINGS = (150 + 131) / (1 + 3 + 6 + 3 + 3)
# A rounding is uniform within half of the last place, the digits before it are distributed as
# in Benford's law: the mean of 1 / m^2 over 1 <= m < 2 is 3 / (8 ln 2).
RMS = math.sqrt(3 / (8 * math.log(2)) / 3)
SPREAD = RMS * math.sqrt(ROUNDINGS)
# The same equations with their derivatives: 3 more operations for a product, 1 more for a sum.
DERIVED_ROUNDINGS = (4 * 150 + 2 * 131) / (1 + 3 + 6 + 3 + 3)
DERIVED = RMS * math.sqrt(DERIVED_ROUNDINGS)


def predicted(dtype: str, kappa_s: Array, kappa_j: Array, estimates: Array | None = None) -> Array:
    """
    Return the predicted relative error of each state, (S,).

    Parameters
    ----------
    dtype : {'float64', 'float32'}
        Number format.
    kappa_s, kappa_j : ndarray
        (S,), as in measure.reference.
    estimates : ndarray, optional
        (S,), estimated error of the first answer, for a refined kernel.

    """
    u = ROUNDING[dtype]
    factor = SPREAD * kappa_j * u
    first = factor if estimates is None else np.minimum(factor, estimates) * estimates
    result: Array = u * (1 + SPREAD * kappa_s) + first
    return result


def predicted_matrix(
    dtype: str, kappa_s: Array, kappa_j: Array, share: Array, gain: Array, acceleration: Array
) -> Array:
    """
    Return the predicted relative error of a matrix, for each state, (S,).

    Parameters
    ----------
    dtype : {'float64', 'float32'}
        Number format.
    kappa_s : ndarray
        (S,), of the matrix, as in measure.derivative_reference.
    kappa_j : ndarray
        (S,), as in measure.reference.
    share, gain : ndarray
        (S,), as in measure.derivative_reference; gain 0 for a matrix that no acceleration enters.
    acceleration : ndarray
        (S,), the predicted error of the acceleration.

    """
    u = ROUNDING[dtype]
    result: Array = u * (1 + DERIVED * kappa_s) + share * (
        DERIVED * kappa_j * u + gain * acceleration
    )
    return result
