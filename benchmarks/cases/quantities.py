# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Quantities whose times are compared, their arguments and states.

All numbers of states are rounded to float32, so that one reference serves both number formats.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.problems import SEED
from benchmarks.cases.robots import Array, single
from pfd_core.kernels.compile import inverse_dynamics
from pfd_core.model import Robot

FORWARD = 'forward_dynamics'
STATE = ('q', 'qd', 'tau')
# Quantity to the names of its arguments.
QUANTITIES = {
    FORWARD: STATE,
    'inverse_dynamics': ('q', 'qd', 'qdd'),
    'inertia_matrix': ('q',),
    'bias_torques': ('q', 'qd'),
    'derivatives': STATE,
}

Evaluation = Callable[[NDArray[Any], NDArray[Any], NDArray[Any]], tuple[Any, Any]]


def random_states(robot: Robot, count: int) -> dict[str, Array]:
    """Return q, qd, qdd and the torques of that acceleration, (count, n) each."""
    rng = np.random.default_rng(SEED)
    q, qd, qdd = (
        single(reach * rng.uniform(-1, 1, (count, robot.n))) for reach in (np.pi, 1.0, 1.0)
    )
    return {'q': q, 'qd': qd, 'qdd': qdd, 'tau': single(inverse_dynamics(robot, q, qd, qdd))}


def linear_rk4(
    evaluate: Evaluation, q: NDArray[Any], qd: NDArray[Any], tau: NDArray[Any], step: Any
) -> NDArray[Any]:
    """
    Return [A B], (..., 2n, 3n), of a step of classical Runge-Kutta, stage by stage.

    `evaluate` returns qdd, (..., n), and its derivatives by q, qd and tau, (..., n, 3n). The
    numbers may be of any type.
    """
    n = q.shape[-1]
    start = np.broadcast_to(np.eye(3 * n)[: 2 * n], (*q.shape[:-1], 2 * n, 3 * n))
    x, v, by_start = q, qd, start
    slopes = []
    for part in (0.5, 0.5, 1.0, 0.0):
        qdd, J = evaluate(x, v, tau)
        by_state = J[..., : 2 * n] @ by_start
        by_state[..., 2 * n :] += J[..., 2 * n :]
        slope = np.concatenate([by_start[..., n:, :], by_state], axis=-2)
        slopes.append(slope)
        x, v, by_start = q + part * step * v, qd + part * step * qdd, start + part * step * slope
    a, b, c, d = slopes
    result: NDArray[Any] = start + step / 6 * (a + 2 * b + 2 * c + d)
    return result
