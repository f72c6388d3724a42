# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Derivatives of the program of forward dynamics: Pinocchio's, and second derivatives."""

from __future__ import annotations

from typing import Any

from bridge import (
    DERIVATIVE_MODES,
    derivative_program,
    directional_program,
    eliminate_dead_code,
    fold_program,
    record_forward_dynamics,
    resolve_plant,
    run_program,
)
from central_differences import differences
import mpmath
import numpy as np
from oracle import Oracle, chains, every, jacobi_condition
import pinocchio as pin
import pytest
from sampling import one_fast
from tolerances import ACCELERATION, FIFTY_DIGITS
from zoo import random_chain, random_state

import pfd_core as pfd

EVERYTHING = pfd.Scene(external_wrench=True, damping='model', armature='model', brakes=True)
# Central differences over 1e-16 on 50 digits: third derivatives times 1e-32 are cut off.
DIFFERENCES = 1e-26
STATE = ['q', 'qd', 'tau']


def forward(robot: pfd.Robot, scene: pfd.Scene) -> pfd.Program:
    """Return a program of qdd with equal expressions shared."""
    plant = resolve_plant(robot, scene)
    program = record_forward_dynamics(plant, 'composite_body', 'sequential')
    return eliminate_dead_code(fold_program(program), ['qdd'])


def assert_close(found: Any, wanted: Any, tolerance: float) -> None:
    with mpmath.workdps(50):
        assert np.abs(found - wanted).max() <= tolerance * max(1, np.abs(wanted).max())


@pytest.mark.parametrize('mode', one_fast(DERIVATIVE_MODES, 'adjoint'))
def test_random_chains_agree_with_pinocchio(mode: str) -> None:
    small = (pair for pair in chains(30, seed=61) if pair[1].n <= 6)
    for rng, robot in every(2, small):
        oracle = Oracle(robot, robot.armature)
        q, qd, qdd = random_state(rng, robot.n)
        tau = oracle.tau(q, qd, qdd)
        pin.computeABADerivatives(oracle.model, oracle.data, q, qd, tau)
        upper = np.triu(oracle.data.Minv)
        X = upper + np.triu(upper, 1).T
        wanted = {'q': oracle.data.ddq_dq, 'qd': oracle.data.ddq_dv, 'tau': X}
        program = derivative_program(
            forward(robot, pfd.Scene(armature='model')), ['qdd'], STATE, mode
        )
        found = run_program(program, {'q': q, 'qd': qd, 'tau': tau})
        largest = max(np.abs(J).max() for J in wanted.values())
        for name in STATE:
            error = np.abs(found[f'd qdd/d {name}'] - wanted[name]).max() / largest
            assert error < ACCELERATION * jacobi_condition(oracle.H(q)), robot


def test_the_hessian_of_a_weighted_acceleration_is_symmetric_and_agrees_with_differences() -> None:
    rng = np.random.default_rng(3)
    types = ['revolute', 'prismatic', 'continuous', 'prismatic']
    robot = random_chain(rng, 4, joint_types=types)
    inputs = dict(zip(STATE, random_state(rng, 4), strict=True))
    inputs |= {'wrench': 10 * rng.normal(size=6), 'free': np.array([1, 1, 0, 1.0])}
    inputs['d qdd'] = rng.normal(size=4)
    gradient = directional_program(forward(robot, EVERYTHING), ['qdd'], ['q', 'qd'], 'adjoint')
    hessian = derivative_program(gradient, ['d q', 'd qd'], ['q', 'qd'])
    found = run_program(hessian, {key: inputs[key] for key in hessian.inputs}, digits=50)
    whole = np.block([[found[f'd d {y}/d {x}'] for x in ('q', 'qd')] for y in ('q', 'qd')])
    assert_close(whole, whole.T, FIFTY_DIGITS)
    assert np.abs(whole).max() > 0.1
    for x in ('q', 'qd'):
        wanted = differences(gradient, inputs, 'd q', x)
        assert_close(found[f'd d q/d {x}'], wanted, DIFFERENCES)
