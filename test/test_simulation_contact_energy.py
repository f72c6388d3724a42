# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Arms left to themselves under friction and stops lose energy and stay in their range."""

from __future__ import annotations

import numpy as np
from oracle import Oracle
import pytest
from zoo import Array, random_chain

import pfd_core as pfd

STEPS = 400
# All gains of kinetic energy in STEPS steps of 1 ms, over that at the beginning: truncation of RK4
# while friction is small, and rounding. An impact alone would add a thousandth of it.
GAINS = 1e-10
# A joint is found at its stop to the cubic's error of fourth order in the step [rad or m].
BEYOND = 1e-7


def random_scene(rng: np.random.Generator, n: int) -> tuple[pfd.Scene, Array]:
    """Return a scene of rotors, friction and stops, some of each absent, and the stops."""
    limits = np.sort(rng.uniform(-1.5, 1.5, (n, 2)), axis=1) + np.array([0.0, 0.1])
    limits[rng.random(n) < 0.2] = [-np.inf, np.inf]
    friction = rng.uniform(0, 2, n) * (rng.random(n) < 0.7)
    scene = pfd.Scene(
        gravity=None,
        armature=rng.uniform(0.5, 2, n),
        friction=friction,
        static_friction=friction * rng.uniform(1, 2, n),
        stribeck_velocity=rng.uniform(0.1, 1, n),
        joint_limits=limits,
        restitution=rng.uniform(0, 1, n),
    )
    return scene, limits


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.slow
def test_an_arm_left_to_itself_gains_no_energy_and_passes_no_stop(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, count = int(rng.integers(2, 8)), 16
    robot = random_chain(rng, n, 0.2)
    scene, limits = random_scene(rng, n)
    lower, upper = np.where(np.isfinite(limits), limits, [-1.0, 1.0]).T
    where = rng.random((count, n))
    q = rng.uniform(lower, upper, (count, n))
    q = np.where(where < 0.1, lower, np.where(where > 0.9, upper, q))
    qd = rng.normal(0, 3, (count, n)) * (rng.random((count, n)) < 0.8)
    arms = pfd.Ensemble(robot, count, scene, step_size=1e-3, substeps=1)
    arms.reset(q, qd)
    runs = arms.rollout(steps=STEPS)
    assert runs.status == 'ok'
    assert (runs.q >= limits[:, 0] - BEYOND).all()
    assert (runs.q <= limits[:, 1] + BEYOND).all()
    oracle = Oracle(robot, np.asarray(scene.armature))
    for k in range(count):
        states = zip([q[k], *runs.q[k]], [qd[k], *runs.qd[k]], strict=True)
        energy = np.array([v @ oracle.H(x) @ v for x, v in states])
        assert np.maximum(np.diff(energy), 0).sum() <= GAINS * energy[0]
