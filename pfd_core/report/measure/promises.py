# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
What forward dynamics promise by analysis, and the bounds of the hard cases: FACTOR times that.

No number here was chosen on a measured error. Relative errors of a state, in units of rounding u:

    1                   the last sum of the answer is rounded
    SPREAD kappa_s      each number of robot, scene and state enters ROUNDINGS operations of the
                        Newton-Euler residual, in frames of the links. A rounding acts as a
                        relative change of that number by up to u, RMS u in the mean, and
                        independent roundings add up as the root of their number (Higham and Mary
                        2019). kappa_s is what such changes of all numbers do to the answer
    SPREAD kappa_J      without refinement also the roundings of H and of its factor: the error of
                        a Cholesky factor scales with the condition of H after Jacobi scaling
                        (Demmel 1989; Higham, Accuracy and Stability, theorem 10.6)

Refined, the error of the factor is multiplied by the error of the first answer instead, which the
kernel estimates. A kernel whose estimate leaves no digit promises nothing.
"""

from __future__ import annotations

import math

import numpy as np

from pfd_core.report.cases.hard_cases import ROUNDING
from pfd_core.report.cases.robots import Array

FACTOR = 5.0
# Luh, Walker and Paul 1980: 150 n multiplications and 131 n additions; a link and its joint have
# mass, centre, inertia, the way to the next joint, position, velocity and torque.
ROUNDINGS = (150 + 131) / (1 + 3 + 6 + 3 + 3)
# A rounding is uniform within half of the last place, the digits before it are distributed as
# in Benford's law: the mean of 1 / m^2 over 1 <= m < 2 is 3 / (8 ln 2).
RMS = math.sqrt(3 / (8 * math.log(2)) / 3)
SPREAD = RMS * math.sqrt(ROUNDINGS)


def promised(dtype: str, kappa_s: Array, kappa_j: Array, estimates: Array | None = None) -> Array:
    """
    Return the relative error that is promised for each state, (S,).

    Parameters
    ----------
    dtype : {'float64', 'float32'}
        Number format.
    kappa_s, kappa_j : ndarray
        (S,), as in measure.reference.
    estimates : ndarray, optional
        (S,), of the error of the first answer, for a refined kernel.

    """
    u = ROUNDING[dtype]
    factor = SPREAD * kappa_j * u
    first = factor if estimates is None else np.minimum(factor, estimates) * estimates
    result: Array = u * (1 + SPREAD * kappa_s) + first
    return result
