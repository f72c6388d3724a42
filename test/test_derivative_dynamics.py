# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Derivatives of forward and inverse dynamics: both modes, differences, Pinocchio, identities."""

from __future__ import annotations

from typing import Any

from bridge import (
    DERIVATIVE_MODES,
    ITERATIVE_METHODS,
    derivative_program,
    directional_program,
    eliminate_dead_code,
    fold_program,
    lower_program,
    program_operations,
    record_forward_dynamics,
    record_inverse_dynamics,
    record_link_torques,
    resolve_plant,
    run_program,
)
from central_differences import differences
import mpmath
import numpy as np
from oracle import Oracle, chains, every, jacobi_condition, relative
import pinocchio as pin
import pytest
from sampling import one_fast
from tolerances import ACCELERATION, DYNAMICS, FIFTY_DIGITS
from zoo import Array, random_chain, random_state

import pfd_core as pfd

EVERYTHING = pfd.Scene(external_wrench=True, damping='model', armature='model', brakes=True)
# Central differences over 1e-16 on 50 digits: third derivatives times 1e-32 are cut off.
DIFFERENCES = 1e-26
STATE = ['q', 'qd', 'tau']
GROUPED = ('composite_body', 'grouped_articulated_body')


def arm(kind: str) -> tuple[pfd.Robot, pfd.Scene, dict[str, Array]]:
    """Return the UR5 at gravity, or a skew chain in a scene with everything; and inputs."""
    rng = np.random.default_rng(3)
    if kind == 'ur5':
        robot, scene = pfd.load_robot('ur5'), pfd.Scene()
    else:
        types = ['revolute', 'prismatic', 'continuous', 'prismatic']
        robot, scene = random_chain(rng, 4, joint_types=types), EVERYTHING
    q, qd, tau = random_state(rng, robot.n)
    inputs = {'q': q, 'qd': qd, 'tau': tau, 'qdd': rng.normal(size=robot.n)}
    if kind != 'ur5':
        inputs |= {'wrench': 10 * rng.normal(size=6), 'free': np.array([1, 1, 0, 1.0])}
    return robot, scene, inputs


def short(program: pfd.Program, output: str) -> pfd.Program:
    """Return the program of one output with equal expressions shared."""
    return eliminate_dead_code(fold_program(program), [output])


def forward(robot: pfd.Robot, scene: pfd.Scene, method: str = 'composite_body') -> pfd.Program:
    return short(record_forward_dynamics(resolve_plant(robot, scene), method, 'sequential'), 'qdd')


def jacobians(
    program: pfd.Program, inputs: dict[str, Array], output: str, names: list[str], mode: str
) -> dict[str, Any]:
    """Return the Jacobians of an output on 50 digits, by the input's name."""
    made = derivative_program(program, [output], names, mode)
    found = run_program(made, {key: inputs[key] for key in program.inputs}, digits=50)
    return {name: found[f'd {output}/d {name}'] for name in names}


def assert_close(found: Any, wanted: Any, tolerance: float) -> None:
    with mpmath.workdps(50):
        assert np.abs(found - wanted).max() <= tolerance * max(1, np.abs(wanted).max())


@pytest.mark.parametrize(
    ('method', 'kind'),
    [
        *((name, 'chain') for name in pfd.METHODS if name not in ITERATIVE_METHODS),
        *((name, 'ur5') for name in ('articulated_body', *GROUPED)),
    ],
)
@pytest.mark.slow
def test_forward_dynamics_of_every_method_agrees_with_differences_in_both_modes(
    method: str, kind: str
) -> None:
    robot, scene, inputs = arm(kind)
    program = forward(robot, scene, method)
    names = STATE + (['wrench'] if kind == 'chain' else [])
    tangent, adjoint = (
        jacobians(program, inputs, 'qdd', names, mode) for mode in DERIVATIVE_MODES
    )
    for name in names:
        assert_close(tangent[name], adjoint[name], FIFTY_DIGITS)
        assert_close(tangent[name], differences(program, inputs, 'qdd', name), DIFFERENCES)


@pytest.mark.sweep
@pytest.mark.parametrize('kind', ['ur5', 'chain'])
@pytest.mark.parametrize('algorithm', ['on lanes', 'grouped'])
def test_inverse_dynamics_agrees_with_differences_in_both_modes(algorithm: str, kind: str) -> None:
    robot, scene, inputs = arm(kind)
    plant = resolve_plant(robot, scene)
    grouped = algorithm == 'grouped'
    recorded = (
        record_link_torques(plant) if grouped else record_inverse_dynamics(plant, 'sequential')
    )
    program = short(recorded, 'tau')
    names = ['q', 'qd', 'qdd'] + (['wrench'] if kind == 'chain' else [])
    tangent, adjoint = (
        jacobians(program, inputs, 'tau', names, mode) for mode in DERIVATIVE_MODES
    )
    for name in names:
        assert_close(tangent[name], adjoint[name], FIFTY_DIGITS)
        assert_close(tangent[name], differences(program, inputs, 'tau', name), DIFFERENCES)


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


@pytest.mark.parametrize('kind', one_fast(['ur5', 'chain'], 'chain'))
def test_the_hessian_of_a_weighted_acceleration_is_symmetric_and_agrees_with_differences(
    kind: str,
) -> None:
    robot, scene, inputs = arm(kind)
    gradient = directional_program(forward(robot, scene), ['qdd'], ['q', 'qd'], 'adjoint')
    inputs['d qdd'] = np.random.default_rng(6).normal(size=robot.n)
    hessian = derivative_program(gradient, ['d q', 'd qd'], ['q', 'qd'])
    found = run_program(hessian, {key: inputs[key] for key in hessian.inputs}, digits=50)
    whole = np.block([[found[f'd d {y}/d {x}'] for x in ('q', 'qd')] for y in ('q', 'qd')])
    assert_close(whole, whole.T, FIFTY_DIGITS)
    assert np.abs(whole).max() > 0.1
    for x in ('q', 'qd'):
        wanted = differences(gradient, inputs, 'd q', x)
        assert_close(found[f'd d q/d {x}'], wanted, DIFFERENCES)


# Operations that lowering may leave, changes of sign apart: d qdd/d(q, qd, tau) and
# d tau/d(q, qd), tangent and adjoint.
MOST = {
    ('ur5', 'qdd'): (2184, 3837),
    ('ur5', 'tau'): (1768, 1813),
    ('panda', 'qdd'): (6172, 8243),
    ('panda', 'tau'): (4528, 3529),
}


@pytest.mark.parametrize(('name', 'output'), list(MOST))
@pytest.mark.slow
def test_the_arms_take_no_more_operations_than_promised(name: str, output: str) -> None:
    robot = pfd.load_robot(name)
    inverse = output == 'tau'
    program = (
        short(record_link_torques(resolve_plant(robot)), 'tau')
        if inverse
        else forward(robot, pfd.Scene())
    )
    for mode, most in zip(DERIVATIVE_MODES, MOST[name, output], strict=True):
        made = derivative_program(program, [output], STATE[: 2 if inverse else 3], mode)
        counts = program_operations(lower_program(made, 'float64').compiled)
        assert sum(counts.values()) - counts['neg'] <= most, mode


@pytest.mark.parametrize('mode', DERIVATIVE_MODES)
def test_the_lowered_program_computes_the_same_derivatives(mode: str) -> None:
    robot, scene, inputs = arm('chain')
    made = derivative_program(forward(robot, scene), ['qdd'], [*STATE, 'wrench'], mode)
    given = {key: inputs[key] for key in made.inputs}
    wanted = run_program(made, given)
    found = run_program(lower_program(made, 'float64').compiled, given)
    assert found.keys() == wanted.keys()
    for name, value in wanted.items():
        assert relative(found[name], value) < DYNAMICS
