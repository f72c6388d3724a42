# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""NE1 and the terms H and bias against Pinocchio, and against each other."""

from __future__ import annotations

from bridge import (
    FORWARD_METHODS,
    MACHINE_SCHEDULES,
    record_inverse_dynamics,
    record_terms,
    resolve_plant,
    run_program,
)
import numpy as np
from oracle import WRENCH, Oracle, chains, every, jacobi_condition, relative
import pytest
from sampling import one_fast
from tolerances import ACCELERATION, DYNAMICS
from zoo import random_chain, random_state

import pfd_core as pfd


@pytest.mark.parametrize(('schedule', 'step'), one_fast([('parallel', 2), ('sequential', 4)]))
def test_terms_and_inverse_dynamics_of_random_chains_agree_with_pinocchio(
    schedule: str, step: int
) -> None:
    # The 48 chains have every number of joints with every share of prismatic ones. The emulator
    # runs the program of one processor scalar by scalar: fewer chains for that.
    for rng, robot in every(step, chains(48, seed=1)):
        plant, oracle = resolve_plant(robot, WRENCH), Oracle(robot)
        q, qd, qdd = random_state(rng, robot.n)
        wrench = rng.normal(size=6) * 10
        H, bias = oracle.H(q), oracle.tau(q, qd, 0 * q, wrench)
        terms = run_program(record_terms(plant, schedule), {'q': q, 'qd': qd, 'wrench': wrench})
        assert relative(terms['H'], H) < DYNAMICS, robot
        assert relative(terms['bias'], bias) < DYNAMICS, robot
        tau = oracle.tau(q, qd, qdd, wrench)
        inputs = {'q': q, 'qd': qd, 'wrench': wrench}
        found = run_program(record_inverse_dynamics(plant, schedule), {**inputs, 'qdd': qdd})[
            'tau'
        ]
        assert relative(found, tau) < DYNAMICS, robot


@pytest.mark.parametrize('schedule', one_fast(MACHINE_SCHEDULES, 'parallel'))
def test_torque_is_recovered_from_the_accelerations_it_causes(schedule: str) -> None:
    for rng, robot in every(5, chains(36, seed=4)):
        plant = resolve_plant(
            robot, pfd.Scene(external_wrench=True, damping='model', armature='model')
        )
        q, qd, tau = random_state(rng, robot.n)
        inputs = {'q': q, 'qd': qd, 'wrench': rng.normal(size=6)}
        qdd = run_program(FORWARD_METHODS['pcrbm'](plant, schedule), {**inputs, 'tau': tau})['qdd']
        found = run_program(record_inverse_dynamics(plant, schedule), {**inputs, 'qdd': qdd})[
            'tau'
        ]
        H = run_program(record_terms(plant, schedule), inputs)['H']
        # A residual is as large as the rounding of H qdd, not of tau.
        scale = np.abs(H) @ np.abs(qdd) + np.abs(tau)
        assert np.all(np.abs(found - tau) < ACCELERATION * scale * jacobi_condition(H))


def test_gravity_off_at_rest_leaves_no_bias() -> None:
    rng = np.random.default_rng(7)
    robot = random_chain(rng, 5)
    inputs = {'q': rng.normal(size=5), 'qd': np.zeros(5)}
    terms = run_program(
        record_terms(resolve_plant(robot, pfd.Scene(gravity=None)), 'parallel'), inputs
    )
    np.testing.assert_array_equal(terms['bias'], np.zeros(5))


def test_damping_adds_to_the_bias_and_rotors_to_the_diagonal_of_the_inertia_matrix() -> None:
    rng = np.random.default_rng(8)
    robot = random_chain(rng, 4)
    inputs = dict(zip(('q', 'qd'), random_state(rng, 4)[:2], strict=True))
    bare, full = (
        run_program(record_terms(resolve_plant(robot, scene), 'parallel'), inputs)
        for scene in (pfd.Scene(), pfd.Scene(damping='model', armature='model'))
    )
    np.testing.assert_allclose(
        full['bias'] - bare['bias'], robot.damping * inputs['qd'], rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(full['H'] - bare['H'], np.diag(robot.armature), rtol=0, atol=1e-12)
