# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A torque is held for a step: a PD loop is stable up to the limits of sampling, not beyond them.

An integrator with the controller inside its implicit solve would call every gain stable.
"""

from __future__ import annotations

from bridge import TABLEAUX
import numpy as np
from oracle import Oracle
import pytest
from sampling import one_fast
from zoo import WHEEL

import pfd_core as pfd

# Moment of inertia of the wheel about its joint [kg m^2].
INERTIA = 0.025


@pytest.mark.sweep
@pytest.mark.parametrize('substeps', one_fast([1, 3], 3))
@pytest.mark.parametrize('integrator', TABLEAUX)
@pytest.mark.parametrize(
    ('kp', 'kd', 'radius'),
    [
        (40_000.0, 50.0, 1.058),  # kp/kd = 800 > 2/T = 500
        (10_000.0, 50.0, None),
        (400.0, 480.0, None),
        (400.0, 510.0, 1.040),  # kd > 2 I/T
    ],
)
def test_a_sampled_loop_is_the_closed_form_of_the_hold(
    kp: float, kd: float, radius: float | None, integrator: str, substeps: int
) -> None:
    T = 4e-3
    # One step of I dqd/dt = u, u = -kp q - kd qd of its beginning; gains for 1 kg m^2.
    A = np.array([[1 - kp * T**2 / 2, T - kd * T**2 / 2], [-kp * T, 1 - kd * T]])
    if radius is None:
        assert np.abs(np.linalg.eigvals(A)).max() < 1
    else:
        assert np.abs(np.linalg.eigvals(A)).max() == pytest.approx(radius, abs=5e-4)
    many = pfd.Ensemble(
        pfd.load_robot(WHEEL),
        1,
        pfd.Scene(gravity=None),
        step_size=T,
        substeps=substeps,
        integrator=integrator,
    )
    many.reset([1.0])
    run = many.rollout(steps=300, feedback=pfd.Feedback([INERTIA * kp], [INERTIA * kd], [0.0]))
    state = np.array([1.0, 0.0])
    for q, qd in zip(run.q[0, :, 0], run.qd[0, :, 0], strict=True):
        state = A @ state
        np.testing.assert_allclose([q, qd], state, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize('damped', [False, True])
@pytest.mark.parametrize('integrator', TABLEAUX)
def test_an_arm_is_stable_just_below_the_limit_of_its_lightest_direction(
    integrator: str, damped: bool
) -> None:
    # kd < 2/(T lambda_max(H^-1)), for kp/kd below 2/T, and a little less for damping d beside kd:
    # the part of a step that d leaves of a velocity, and of the pull of a torque.
    robot, T, ratio = pfd.load_robot('puma560'), 1e-3, 400.0
    q = np.array([0.1, -0.7, 0.9, 0.3, 0.2, 0.5])
    H = Oracle(robot, robot.armature).H(q)
    fastest = 1 / np.linalg.eigvalsh(H)[0]
    d = 0.2 / (T * fastest) if damped else 0.0
    x = d * T * fastest
    left, pull = np.exp(-x), -np.expm1(-x) / x if damped else 1.0
    limit = (1 + left) / (pull * T * fastest)
    scene = pfd.Scene(gravity=None, armature='model', damping=np.full(6, d) if damped else None)
    for factor, stable in ((0.95, True), (1.05, False)):
        many = pfd.Ensemble(robot, 1, scene, step_size=T, integrator=integrator)
        kd = factor * limit
        many.reset(q, np.full(6, 1e-9))
        law = pfd.Feedback(np.full(6, ratio * kd), np.full(6, kd), q)
        run = many.rollout(steps=200, feedback=law)
        assert (np.abs(run.q[0, -1] - q).max() < 1e-10) == stable


# ---- a small velocity of a held joint ---------------------------------------------------------

STATES, SCENES, SMALL = 25, 8, 1e-4
ARMATURE = np.array([0.8, 4.0, 0.8])


@pytest.mark.parametrize('seed', range(SCENES))
def test_a_small_velocity_of_a_held_joint_changes_the_end_of_an_implicit_step_little(
    seed: int,
) -> None:
    # Damping D of strengths h D / H up to 120, and torques that keep the other joints moving.
    rng, h = np.random.default_rng(seed), 1e-3
    robot = pfd.load_robot('puma560', locked={f'joint{k}': 0.3 for k in (4, 5, 6)})
    rotors = pfd.Scene(armature=ARMATURE)
    H = pfd.compile_kernel(robot, scene=rotors, quantity='inertia_matrix')
    bias = pfd.compile_kernel(robot, scene=rotors, quantity='bias_torques')
    q, v = rng.uniform(-1, 1, (STATES, 3)), rng.uniform(-1.5, 1.5, (STATES, 3))
    diagonals = np.diagonal(H(q), axis1=1, axis2=2)
    damping = diagonals.min(axis=0) / h * np.exp(rng.uniform(np.log(0.05), np.log(120), 3))
    friction, held = rng.uniform(2, 20, 3), rng.integers(3, size=STATES)
    of = np.arange(STATES), held
    v[of] = 0.0
    tau = bias(q, v) + damping * v + friction * (np.sign(v) + rng.uniform(-0.3, 0.3, v.shape))
    scene = pfd.Scene(armature=ARMATURE, friction=friction, damping=damping)
    arms = pfd.Ensemble(robot, STATES, scene, step_size=h, substeps=1, integrator='imex2')
    ends = []
    for velocity in (0.0, SMALL, -SMALL):
        v[of] = velocity
        arms.reset(q, v)
        arms.rollout(tau[:, np.newaxis])
        ends.append(np.hstack([arms.q, arms.qd]))
    assert (ends[0][of[0], 3 + held] == 0.0).all()
    for end in ends[1:]:
        assert np.abs(end - ends[0]).max() < 10 * SMALL
