# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whole turns of a joint, and the angle beside them."""

from __future__ import annotations

import numpy as np

from pfd_core.model.checked_numbers import Array

# 2 pi as a sum, of which the products with up to 2^30 turns are exact but for the last one's.
FULL_TURN = (
    float.fromhex('0x1.921fb40000000p+2'),
    float.fromhex('0x1.4442d00000000p-22'),
    float.fromhex('0x1.8469898cc5170p-46'),
)


def split_turns(q: Array, low: Array | None, turning: Array) -> tuple[Array, Array]:
    """
    Return angles from -pi to pi in float64 and numbers of whole turns, of positions q + low.

    Joints that do not turn, where `turning` is False, keep their position, with 0 turns.
    """
    angle = q.astype(np.float64)
    turns = np.where(turning, np.rint(angle / sum(FULL_TURN)), 0.0)
    for part in FULL_TURN:
        angle = angle - turns * part
    return angle if low is None else angle + low, turns.astype(np.int64)
