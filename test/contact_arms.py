# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Arms with friction and stops, and their motions."""

from __future__ import annotations

from zoo import joint, link, urdf

import pfd_core as pfd

STEP = 1e-3
POINT = '0 0 0 0 0 0'


def two_links() -> pfd.Robot:
    """Return two links of 1 m with point masses of 1 kg at their ends, stretched at q = 0."""
    return pfd.load_robot(
        urdf(
            'two_links',
            *(link('base'), link('upper', 1.0, '1 0 0', J=POINT)),
            *(link('lower', 1.0, '1 0 0', J=POINT), joint('j1', 'continuous', 'base', 'upper')),
            joint('j2', 'continuous', 'upper', 'lower', xyz='1 0 0'),
        )
    )


def simulated(robot: pfd.Robot, scene: pfd.Scene, q, qd, taus, **settings):  # type: ignore[no-untyped-def]
    """Return the trajectory of a simulation from a state, in steps of 1 ms."""
    options = {'step_size': STEP, 'substeps': 1} | settings
    sim = pfd.Simulator(robot, scene, **options)
    sim.reset(q, qd)
    return sim.rollout(taus)
