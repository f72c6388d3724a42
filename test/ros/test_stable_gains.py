# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bounds of PD gains, against the closed form of one joint and sampled loops."""

from __future__ import annotations

import numpy as np
import pytest

import pfd_core as pfd
from pfd_ros.arm.stable_gains import gain_limits

PERIOD = 0.001


def radius(inertia: np.ndarray, kp: np.ndarray, kd: np.ndarray, period: float) -> float:
    """Return the spectral radius of the loop, sampled exactly under a torque that is held."""
    n = len(inertia)
    gain = -np.linalg.solve(inertia, np.hstack([np.diag(kp), np.diag(kd)]))
    free = np.block([[np.eye(n), period * np.eye(n)], [np.zeros((n, n)), np.eye(n)]])
    loop = free + np.vstack([period**2 / 2 * gain, period * gain])
    return float(np.abs(np.linalg.eigvals(loop)).max())


def test_one_joint_has_the_bounds_of_the_closed_form() -> None:
    # I = 1, T = 4 ms: kp/kd < 500, kd < 500; kp/kd = 800 diverges, with radius 1.058.
    limits = gain_limits(np.array([[1.0]]), 0.004)
    assert limits.ratio == pytest.approx(500.0)
    assert limits.velocity[0] == limits.equal_velocity == pytest.approx(500.0)
    assert limits.position[0] == pytest.approx(250_000.0)
    loop = radius(np.eye(1), np.array([40_000.0]), np.array([50.0]), 0.004)
    assert loop == pytest.approx(1.058, abs=5e-4)


@pytest.mark.parametrize('entry', [float('nan'), float('inf'), -1.0, 0.0])
def test_a_matrix_that_no_arm_has_is_refused(entry: float) -> None:
    with pytest.raises(np.linalg.LinAlgError):
        gain_limits(np.diag([1.0, entry]), PERIOD)


def inertias() -> list[np.ndarray]:
    rng = np.random.default_rng(5)
    made = []
    for n in (1, 2, 6):
        factor = rng.normal(size=(n, n)) * rng.uniform(0.1, 3.0, n)
        made.append(factor.T @ factor + 1e-3 * np.eye(n))
    for name in ('puma560', 'ur5'):
        robot = pfd.load_robot(name)
        made.append(pfd.compile_kernel(robot, quantity='inertia_matrix')(rng.normal(size=6)))
    return made


@pytest.mark.parametrize('inertia', inertias(), ids=lambda h: f'{len(h)}')
def test_the_sampled_loop_is_stable_just_below_each_bound_and_unstable_above(inertia) -> None:
    limits = gain_limits(inertia, PERIOD)
    n = len(inertia)

    def stable(share: float, of_ratio: float, kd: np.ndarray) -> bool:
        return radius(inertia, share * of_ratio * limits.ratio * kd, share * kd, PERIOD) < 1.0

    equal = np.full(n, limits.equal_velocity)
    for kd in (limits.velocity, equal):
        assert stable(0.999, 0.5, kd)
        assert not stable(1.001, 0.5, kd)
        assert stable(0.5, 0.999, kd)
        assert not stable(0.5, 1.001, kd)
    assert radius(inertia, 0.998 * limits.position, 0.999 * limits.velocity, PERIOD) < 1.0
    assert radius(inertia, 1.001 * limits.position, 0.999 * limits.velocity, PERIOD) > 1.0
