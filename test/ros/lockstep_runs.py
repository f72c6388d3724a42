# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of an arm in lockstep, compared bit for bit."""

from __future__ import annotations

from bridge import RunTrajectory
import numpy as np

GOAL = np.array([0.3, -0.6, 0.9, 0.2, -0.5, 0.4])
FIELDS = ('time', 'q', 'qd', 'tau')


def assert_same_bits(one: RunTrajectory, other: RunTrajectory) -> None:
    for name in FIELDS:
        a, b = getattr(one, name), getattr(other, name)
        assert a.shape == b.shape
        assert a.tobytes() == b.tobytes(), name
