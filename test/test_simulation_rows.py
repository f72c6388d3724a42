# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of the state besides q and qd: simulated, copied and stored with it."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest

import pfd_core as pfd

TAUS = np.random.default_rng(1).normal(size=(30, 2))
# Motors that lag, and positions as sums: rows that a step needs of the step before.
SCENES = {
    'smooth': pfd.Scene(motor_lag=[0.02, 0.0]),
    'with friction and stops': pfd.Scene(
        motor_lag=[0.02, 0.0], friction=[0.2, 0.1], joint_limits=[(-0.3, 0.4), (-0.5, 0.6)]
    ),
}
SETTINGS: dict[str, Any] = {'compensated': True, 'integrator': 'rk4'}


def start(many: int = 1) -> Any:
    return np.random.default_rng(2).uniform(-0.2, 0.2, (many, 2))


@pytest.mark.parametrize('scene', SCENES.values(), ids=SCENES)
@pytest.mark.parametrize(
    'twin', [copy.copy, copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))]
)
def test_a_copy_carries_all_parts_of_the_state_on(scene: pfd.Scene, twin: Any) -> None:
    sim = pfd.Simulator(pfd.load_robot('planar2'), scene, **SETTINGS)
    for _ in range(2):
        # Parts of the state begin at zero again.
        sim.reset(q=start()[0])
        right = sim.rollout(TAUS)
    sim.reset(q=start()[0])
    np.testing.assert_array_equal(sim.rollout(TAUS[:10]).q, right.q[:10])
    other = twin(sim)
    for tau, q, qd in zip(TAUS[10:], right.q[10:], right.qd[10:], strict=True):
        other.step(tau)
        np.testing.assert_array_equal(other.q, q)
        np.testing.assert_array_equal(other.qd, qd)
    assert (other.tau_motor != sim.tau_motor).any()


@pytest.mark.parametrize('scene', SCENES.values(), ids=SCENES)
def test_arms_of_an_ensemble_have_their_own_parts_of_the_state(scene: pfd.Scene) -> None:
    robot, starts = pfd.load_robot('planar2'), start(5)
    many = pfd.Ensemble(robot, 5, scene, **SETTINGS)
    many.reset(starts, 0.5)
    first = many.rollout(TAUS[:10])
    rest = pickle.loads(pickle.dumps(many)).rollout(TAUS[10:])
    sim = pfd.Simulator(robot, scene, **SETTINGS)
    for k, q in enumerate(starts):
        sim.reset(q, np.full(2, 0.5))
        right = sim.rollout(TAUS)
        np.testing.assert_array_equal(np.concatenate([first.q[k], rest.q[k]]), right.q)
