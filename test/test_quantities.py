# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quantities for controllers: against Pinocchio, against one another, and counts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from bridge import (
    Frame,
    lower_program,
    program_operations,
    resolve_plant,
    rotation_z,
    run_program,
)
import numpy as np
from oracle import ARMS, Oracle, chains, relative
import pinocchio as pin
import pytest
from tolerances import DYNAMICS
from zoo import Array, random_chain, random_state

import pfd_core as pfd

FEW, MANY = 6, 100
SEVERAL = [FEW, pytest.param(MANY, marks=[pytest.mark.slow, pytest.mark.long])]
# Operations of a lowered program, changes of sign apart, sine and cosine written out.
MOST = {
    'ur5': {
        'inverse_dynamics': 388,
        'inertia_matrix': 248,
        'bias_torques': 370,
        'gravity_torques': 173,
        'energy': 227,
        'tip_pose': 265,
        'tip_jacobian': 227,
        'tip_velocity': 230,
        'wrench_torques': 222,
    },
    'panda': {
        'inverse_dynamics': 630,
        'inertia_matrix': 439,
        'bias_torques': 611,
        'gravity_torques': 275,
        'energy': 372,
        'tip_pose': 328,
        'tip_jacobian': 314,
        'tip_velocity': 296,
        'wrench_torques': 267,
    },
}


def quantity(
    name: str,
    robot: pfd.Robot,
    scene: pfd.Scene | None = None,
    frame: str | None = None,
    **given: Any,
) -> Array:
    program = pfd.QUANTITIES[name](resolve_plant(robot, scene), frame)
    assert len(program.outputs) == 1
    assert program.inputs == {key: given[key].size for key in program.inputs}
    (value,) = run_program(program, given).values()
    found: Array = value
    return found


def robots(count: int, seed: int) -> Iterator[tuple[np.random.Generator, pfd.Robot]]:
    """Yield the published arms, one with parallel axes, and random chains of up to 12 joints."""
    rng = np.random.default_rng(seed)
    for name in ARMS:
        # A value that the model does not state is 0.
        yield rng, replace(pfd.load_robot(name), silent={})
    yield rng, parallel_axes(rng)
    yield from chains(count, seed)


def parallel_axes(rng: np.random.Generator) -> pfd.Robot:
    """Return a chain of four and two parallel axes, one of which slides and one points back."""
    types = ['revolute', 'revolute', 'prismatic', 'revolute', 'revolute', 'continuous']
    robot = random_chain(rng, 6, joint_types=types)
    angles = rng.uniform(-np.pi, np.pi, 6)
    rotations = np.array([rotation_z(np.cos(x), np.sin(x)) for x in angles])
    rotations[1] = rotations[1] @ np.diag([1.0, -1.0, -1.0])
    rotations[3] = robot.rotations[3]
    return replace(robot, name='parallel', rotations=rotations)


@pytest.mark.parametrize('count', SEVERAL)
def test_dynamic_quantities_agree_with_pinocchio(count: int) -> None:
    for rng, robot in robots(count, seed=61):
        oracle = Oracle(robot, robot.armature)
        model, data = oracle.model, oracle.data
        q, qd, qdd = random_state(rng, robot.n)
        rotors = pfd.Scene(armature='model')
        H = quantity('inertia_matrix', robot, rotors, q=q)
        np.testing.assert_array_equal(H, H.T)
        assert relative(H, oracle.H(q)) < DYNAMICS
        tau = quantity('inverse_dynamics', robot, rotors, q=q, qd=qd, qdd=qdd)
        assert relative(tau, oracle.tau(q, qd, qdd)) < DYNAMICS
        bias = quantity('bias_torques', robot, rotors, q=q, qd=qd)
        assert relative(bias, pin.nonLinearEffects(model, data, q, qd)) < DYNAMICS
        gravity = quantity('gravity_torques', robot, rotors, q=q)
        wanted = pin.computeGeneralizedGravity(model, data, q)
        assert np.abs(gravity - wanted).max() < DYNAMICS * np.abs(bias).max()
        kinetic, potential = quantity('energy', robot, rotors, q=q, qd=qd)
        # Pinocchio 3 and 4 differ in whether the energy of rotors is part of it.
        model.armature = np.zeros(robot.n)
        wanted = pin.computeKineticEnergy(model, data, q, qd) + qd @ (robot.armature * qd) / 2
        assert relative(kinetic, wanted) < DYNAMICS
        wanted = pin.computePotentialEnergy(model, data, q)
        weight = 9.81 * float(robot.masses.sum())
        assert abs(potential - wanted) < DYNAMICS * max(abs(wanted), weight)


@pytest.mark.parametrize('count', SEVERAL)
def test_quantities_of_the_tip_agree_with_pinocchio(count: int) -> None:
    for rng, robot in robots(count, seed=63):
        model = Oracle(robot).model
        data, tip = model.createData(), model.nframes - 1
        q, qd, _ = random_state(rng, robot.n)
        J, local = (  # Pinocchio drops the second axis of a single column.
            pin.computeFrameJacobian(model, data, q, tip, axes).reshape(6, robot.n)
            for axes in (pin.LOCAL_WORLD_ALIGNED, pin.LOCAL)
        )
        assert relative(quantity('tip_jacobian', robot, q=q), J) < DYNAMICS
        assert relative(quantity('tip_velocity', robot, q=q, qd=qd), J @ qd) < DYNAMICS
        pin.framesForwardKinematics(model, data, q)
        pose = quantity('tip_pose', robot, q=q)
        assert relative(pose, data.oMf[tip].homogeneous) < DYNAMICS
        k = 10 * rng.normal(size=6)
        found = quantity('wrench_torques', robot, q=q, wrench=k)
        assert relative(found, local.T @ k) < DYNAMICS


@pytest.mark.parametrize('count', SEVERAL)
def test_columns_of_the_inertia_matrix_are_torques_of_unit_accelerations_to_16_u(
    count: int,
) -> None:
    for rng, robot in robots(count, seed=65):
        scene = pfd.Scene(gravity=None, armature='model')
        q = rng.uniform(-np.pi, np.pi, robot.n)
        H = quantity('inertia_matrix', robot, scene, q=q)
        program = pfd.QUANTITIES['inverse_dynamics'](resolve_plant(robot, scene))
        columns = np.eye(robot.n)
        given = {'q': 0 * columns + q, 'qd': 0 * columns, 'qdd': columns}
        assert relative(run_program(program, given)['tau'].T, H) <= 16 * 2.0**-53, robot


@pytest.mark.parametrize('name', ARMS)
def test_the_base_link_does_not_move_and_a_wrench_on_it_needs_no_torques(name: str) -> None:
    robot = replace(
        pfd.load_robot(name), base_rotation=rotation_z(0.6, 0.8), base_position=np.ones(3)
    )
    n = robot.n
    q, qd, _ = random_state(np.random.default_rng(69), n)
    equal = np.testing.assert_array_equal
    base = robot.base
    equal(quantity('tip_jacobian', robot, frame=base, q=q), np.zeros((6, n)))
    equal(quantity('tip_velocity', robot, frame=base, q=q, qd=qd), np.zeros(6))
    equal(quantity('tip_pose', robot, frame=base, q=q), np.eye(4))
    k = np.ones(6)
    equal(quantity('wrench_torques', robot, frame=base, q=q, wrench=k), np.zeros(n))
    for key in ('tip_pose', 'tip_jacobian', 'tip_velocity', 'wrench_torques'):
        still = lower_program(pfd.QUANTITIES[key](resolve_plant(robot), base), 'float64').compiled
        assert program_operations(still) == {}, key
        assert still.inputs['q'] == n


def test_a_frame_within_the_chain_does_not_feel_the_joints_beyond() -> None:
    rng = np.random.default_rng(70)
    robot = random_chain(rng, 6)
    robot = replace(robot, frames={'third': Frame(3, np.eye(3), rng.normal(size=3))})
    q, qd, _ = random_state(rng, 6)
    J = quantity('tip_jacobian', robot, frame='third', q=q)
    np.testing.assert_array_equal(J[:, 3:], np.zeros((6, 3)))
    np.testing.assert_allclose(
        quantity('tip_velocity', robot, frame='third', q=q, qd=qd), J @ qd, rtol=DYNAMICS
    )
    k = rng.normal(size=6)
    turn = quantity('tip_pose', robot, frame='third', q=q)[:3, :3]
    wanted = J.T @ np.concatenate([turn @ k[:3], turn @ k[3:]])
    found = quantity('wrench_torques', robot, frame='third', q=q, wrench=k)
    assert relative(found, wanted) < DYNAMICS


@pytest.mark.parametrize('name', list(MOST))
def test_quantities_take_no_more_operations_than_promised(name: str) -> None:
    plant = resolve_plant(pfd.load_robot(name))
    for key, most in MOST[name].items():
        program = lower_program(pfd.QUANTITIES[key](plant), 'float64').compiled
        counts = program_operations(program)
        assert sum(count for op, count in counts.items() if op != 'neg') <= most, key


def test_a_quantity_of_a_scene_costs_only_the_effects_that_it_reads() -> None:
    robot = pfd.load_robot('ur5')
    scene = pfd.Scene(
        damping=np.ones(6), effort_limits=np.ones(6), brakes=True, external_wrench=True
    )
    for name in ('inertia_matrix', 'gravity_torques', 'energy', 'tip_pose', 'wrench_torques'):
        first, second = (
            program_operations(
                lower_program(pfd.QUANTITIES[name](resolve_plant(robot, s)), 'float64').compiled
            )
            for s in (None, scene)
        )
        assert first == second, name
