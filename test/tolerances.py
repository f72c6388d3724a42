# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tolerances that more than one file uses, each with its cause, and the errors they bound."""

import numpy as np
from numpy.typing import NDArray

# H, bias and torque of chains of up to 12 skew links, relative to the largest element. Both
# sides sum some hundred rounded terms about different points: seen up to 4e-14.
DYNAMICS = 1e-12

# qdd relative to the largest element, times the condition number of H after Jacobi scaling:
# solving H qdd = y multiplies the rounding of H by just that number, and no less.
ACCELERATION = 1e-12

# The same in single precision, whose rounding is 2^29 times larger.
SINGLE = DYNAMICS * 2.0**29

# 50-digit arithmetic against itself over some thousand operations.
FIFTY_DIGITS = 1e-45


def relative(found: NDArray[np.float64], wanted: NDArray[np.float64]) -> float:
    """Return the largest difference relative to the largest wanted element."""
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


def jacobi_condition(H: NDArray[np.float64]) -> float:
    """Return the condition number of H after scaling its diagonal to one."""
    scale = 1 / np.sqrt(np.diag(H))
    return float(np.linalg.cond(H * scale * scale[:, None]))
