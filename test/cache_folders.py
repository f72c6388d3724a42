# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What tests of the cache of compiled code share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from zoo import random_state

import pfd_core as pfd

ROOT = Path(__file__).resolve().parent.parent
LIFETIME = 120  # [s] of a child; far above what it takes


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def answers(kernel: pfd.Kernel) -> bytes:
    """Return the bits of one state and of a batch."""
    n = kernel.robot.n
    q, qd, tau = (np.array(x, kernel.dtype) for x in random_state(np.random.default_rng(3), n))
    rows = [np.tile(x, (9, 1)) for x in (q, qd, tau)]
    return kernel(q, qd, tau).tobytes() + kernel(*rows).tobytes()
