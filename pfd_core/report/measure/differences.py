# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Differences of results, relative to the largest entry of a state."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def differences(found: NDArray[Any], wanted: NDArray[Any]) -> NDArray[Any]:
    """
    Return max|found - wanted| / max|wanted| of each state, (...,), of arrays (..., size).

    `wanted` may hold numbers of any type, such as mpmath.mpf.
    """
    off = np.asarray(found, float).astype(wanted.dtype) - wanted
    result: NDArray[Any] = np.abs(off).max(axis=-1) / np.abs(wanted).max(axis=-1)
    return result


def largest_difference(found: NDArray[Any], wanted: NDArray[Any]) -> float:
    """Return the largest of the differences."""
    return float(np.max(differences(found, wanted)))
