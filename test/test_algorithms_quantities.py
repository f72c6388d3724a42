# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quantities that a controller asks for: against Pinocchio, against one another, and counts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from oracle import WRENCH, Oracle, chains, relative
import pinocchio as pin
import pytest
from tolerances import DYNAMICS
from zoo import Array, random_state

from pfd_core.algorithms.quantities import RECORDERS
from pfd_core.machine.emulator import run
from pfd_core.model import Payload, Robot, Scene, load_robot, resolve

ARMS = ('puma560', 'ur5', 'panda')
FEW, MANY = 16, 100
EVERYTHING = Scene(
    damping='model',
    armature='model',
    external_wrench=True,
    brakes=True,
    effort_limits='model',
    gravity_compensation=True,
    payload=Payload(1.5, (0.1, -0.2, 0.3)),
)


def quantity(
    name: str, robot: Robot, scene: Scene | None = None, frame: str | None = None, **given: Any
) -> Array:
    program = RECORDERS[name](resolve(robot, scene), frame)
    assert len(program.outputs) == 1
    assert program.inputs == {key: given[key].size for key in program.inputs}
    (value,) = run(program, given).values()
    found: Array = value
    return found


def robots(count: int, seed: int) -> Iterator[tuple[np.random.Generator, Robot]]:
    """Yield the published arms and random chains of up to 12 joints."""
    for name in ARMS:
        yield np.random.default_rng(seed), load_robot(name)
    yield from chains(count, seed)


@pytest.mark.parametrize('count', [FEW, pytest.param(MANY, marks=pytest.mark.slow)])
def test_dynamic_quantities_agree_with_pinocchio(count: int) -> None:
    for rng, robot in robots(count, seed=61):
        oracle = Oracle(robot, robot.armature)
        model, data = oracle.model, oracle.data
        q, qd, qdd = random_state(rng, robot.n)
        rotors = Scene(armature='model')
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


def test_the_wrench_of_the_scene_is_taken_off_the_bias_and_the_torques() -> None:
    for rng, robot in robots(FEW, seed=62):
        oracle = Oracle(robot)
        q, qd, qdd = random_state(rng, robot.n)
        wrench = 10 * rng.normal(size=6)
        bias = quantity('bias_torques', robot, WRENCH, q=q, qd=qd, wrench=wrench)
        assert relative(bias, oracle.tau(q, qd, 0 * q, wrench)) < DYNAMICS
        tau = quantity('inverse_dynamics', robot, WRENCH, q=q, qd=qd, qdd=qdd, wrench=wrench)
        assert relative(tau, oracle.tau(q, qd, qdd, wrench)) < DYNAMICS


@pytest.mark.parametrize('count', [FEW, pytest.param(MANY, marks=pytest.mark.slow)])
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
