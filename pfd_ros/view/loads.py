# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The torque of each joint compared with its limit, as a colour; and which joint is at a limit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.view.visuals import Colour

# From no torque to the limit.
SCALE = np.array([(70, 120, 200), (90, 190, 120), (245, 205, 60), (225, 60, 45)], float)
# Colours between the ends; few, since each change of colour is a message.
LEVELS = 33
UNKNOWN, AT_LIMIT = (150, 150, 150), (190, 40, 200)
# Distance from the end of a joint's range that counts as at it, as a part of the range.
NEAR = 2e-3


class Loads:
    """
    The colours of some joints.

    Parameters
    ----------
    urdf : Urdf
        The model, with the limits.
    joints : sequence of str
        Names of the joints.
    effort : ndarray, (N, joints)
        All efforts that will be shown: the largest one is the end of the scale of a joint without
        an effort limit.

    Attributes
    ----------
    unlimited : tuple of str
        The joints without an effort limit.

    """

    def __init__(self, urdf: pfd.Urdf, joints: Sequence[str], effort: NDArray[np.float64]) -> None:
        limits = [urdf.joints[name].limits for name in joints]
        ends = np.array([item.get('effort', np.inf) for item in limits])
        known = np.isfinite(ends) & (ends > 0)
        largest = np.max(np.abs(np.nan_to_num(effort)), axis=0, initial=0.0)
        # Without a scale a torque has no colour.
        self._ends = np.where(known, ends, np.where(largest > 0, largest, np.nan))
        self.unlimited = tuple(np.array(joints, object)[~known])
        self._lower = np.array([item.get('lower', -np.inf) for item in limits])
        self._upper = np.array([item.get('upper', np.inf) for item in limits])

    def colours(self, position: NDArray[np.float64], effort: NDArray[np.float64]) -> list[Colour]:
        """Return the colour of each joint at positions and efforts (joints,)."""
        with np.errstate(invalid='ignore', divide='ignore'):
            parts = np.where(effort == 0, 0.0, np.abs(effort) / self._ends)
            margin = NEAR * (self._upper - self._lower)
            at_limit = (position <= self._lower + margin) | (position >= self._upper - margin)
        # Without a range: unlimited, or both ends equal.
        at_limit &= np.isfinite(margin) & (margin > 0)
        return [
            AT_LIMIT if stuck else load_colour(part)
            for part, stuck in zip(parts.tolist(), at_limit.tolist(), strict=True)
        ]


def load_colour(part: float) -> Colour:
    """Return the colour of a torque that is a part of its limit, 0 to 1; grey for NaN."""
    if np.isnan(part):
        return UNKNOWN
    level = round(min(max(part, 0.0), 1.0) * (LEVELS - 1)) / (LEVELS - 1)
    places = np.linspace(0.0, 1.0, len(SCALE))
    red, green, blue = (round(float(np.interp(level, places, SCALE[:, k]))) for k in range(3))
    return red, green, blue
