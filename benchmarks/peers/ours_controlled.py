# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Our own simulations of an arm under a controller.

In fixed steps an Ensemble of one or more arms with Feedback simulates the motion in one native
call. The adaptive integrator has no controller: Python computes the torques and calls `integrate`
for each period. `case` is a ControlledArm of benchmarks.cases.controlled_arm.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.peers.control_loop import Answer, Run, answer
from pfd_core.model import Scene
from pfd_core.simulation.adaptive import integrate
from pfd_core.simulation.ensemble import Ensemble
from pfd_core.simulation.feedback import Feedback

# Absolute tolerance of the adaptive integrator over the relative one.
ABSOLUTE = 1e-3


def fixed(
    case: Any,
    scene: Scene,
    substeps: int,
    integrator: str,
    dtype: str,
    method: str = 'auto',
    *,
    arms: int = 1,
) -> Run:
    """Return a run of an Ensemble of equal arms; ValueError for an unknown setting."""
    arm = Ensemble(
        case.robot,
        arms,
        scene,
        step_size=case.period,
        substeps=substeps,
        integrator=integrator,
        dtype=dtype,
        method=method,
    )
    law = Feedback(case.kp, case.kd, case.q, case.qd)
    start = np.tile(case.start, (arms, 1))
    rest = np.zeros_like(start)

    def run() -> Answer:
        arm.reset(start, rest)
        # Only the last state is kept.
        found = arm.rollout(case.taus, feedback=law, every=case.periods)
        if found.status != 'ok':
            return Answer(found.status.replace('_', ' '), arm.q[0], arm.qd[0])
        return answer(arm.q[0], arm.qd[0])

    return run


def adaptive(
    case: Any,
    tolerance: float,
    *,
    absolute: float | None = None,
    method: str = 'auto',
    refine: int = 0,
    max_step: float = np.inf,
) -> Run:
    """Return a run of `integrate`, called for each period."""
    atol = tolerance * ABSOLUTE if absolute is None else absolute

    def run() -> Answer:
        q, qd = case.start, np.zeros(case.robot.n)
        for k in range(case.periods):
            found = integrate(
                case.robot,
                case.torques(k, q, qd),
                case.period,
                scene=case.scene,
                q=q,
                qd=qd,
                rtol=tolerance,
                atol=atol,
                method=method,
                refine=refine,
                max_step=max_step,
                dense=False,
            )
            if found.status != 'ok':
                return Answer(found.status.replace('_', ' '), q, qd)
            q, qd = found.q[-1], found.qd[-1]
        return answer(q, qd)

    return run
