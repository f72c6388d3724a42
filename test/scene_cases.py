# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A disc that closed forms describe, and synthetic motions, for reports of a scene."""

from __future__ import annotations

from bridge import DrivenMotion, TimingPace
import numpy as np
from zoo import joint, link, urdf

import pfd_core as pfd

# Rounding of some hundred steps of a motion of about a radian, and of differences of it.
ROUNDING = 1e-12
FAST = TimingPace(chunk=1e-5, turns=2, budget=0.1)
WINDOW = 0.1
# A disc of 0.5 kg m^2 on a vertical axis: gravity does not turn it.
INERTIA = 0.5
DISC = urdf(
    'disc',
    link('base'),
    link('disc', 1.0, J=f'0.3 0.3 {INERTIA} 0 0 0'),
    joint('axis', 'continuous', 'base', 'disc', extra='<limit velocity="9" effort="40"/>'),
)


def motion_of(
    robot: pfd.Robot,
    taus: np.ndarray,
    *,
    qd: float = 0.0,
    held: np.ndarray | None = None,
    after: tuple[int, ...] = (0,),
) -> DrivenMotion:
    """Return a motion whose state is known at its start, at rest at 0 unless qd says otherwise."""
    n, states = robot.n, len(after)
    return DrivenMotion(
        'made up',
        'a test',
        {'step_size': 1e-3, 'substeps': 2, 'integrator': 'rk4', 'method': 'auto'},
        taus,
        np.zeros(taus.shape, bool) if held is None else held,
        np.array(after),
        np.zeros((states, n)),
        np.full((states, n), qd),
    )
