# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes with drives and springs, and an arm in them by Pinocchio and element by element."""

from __future__ import annotations

import numpy as np
from oracle import Oracle, jacobi_condition
import pinocchio as pin
from tolerances import ACCELERATION
from zoo import Array, random_state, to_pinocchio

import pfd_core as pfd

PAYLOAD = pfd.Payload(2.0, (0.1, -0.05, 0.2), np.diag([0.02, 0.03, 0.04]))
OTHER = pfd.Payload(0.7, (0.0, 0.1, 0.1))


def table(i: int) -> list[tuple[float, float]] | None:
    """Return the table of joint i: none, one row, two rows, or three with a bend."""
    rows = [(0.5, 12.0), (1.0, 6.0), (2.5, 1.0)]
    return rows[: i % 4] or None


def scenes(n: int) -> dict[str, pfd.Scene]:
    """Return scenes of n joints with a drive or a spring each, and one with all effects."""
    tables = [table(i + 1) for i in range(n)]
    efforts = [np.inf if i % 3 == 2 else 3.0 + i for i in range(n)]
    stiffness, rest = np.linspace(5.0, 50.0, n), np.linspace(-1.0, 1.0, n)
    found = {
        'exact compensation': pfd.Scene(gravity_compensation=True),
        'compensation without the payload': pfd.Scene(gravity_compensation=True, payload=PAYLOAD),
        'compensation of another model': pfd.Scene(
            payload=PAYLOAD,
            gravity_compensation=pfd.Scene(gravity=(1.0, -2.0, -9.0), payload=OTHER),
        ),
        'compensation in space': pfd.Scene(gravity=None, gravity_compensation=pfd.Scene()),
        'effort limits': pfd.Scene(effort_limits=efforts),
        'torque and speed': pfd.Scene(torque_speed=tables),
        'limited compensation': pfd.Scene(gravity_compensation=True, effort_limits=[4.0] * n),
        'springs': pfd.Scene(stiffness=stiffness),
        'springs that rest anywhere': pfd.Scene(stiffness=stiffness, rest_position=rest),
    }
    found['all'] = pfd.Scene(
        damping='model',
        armature='model',
        payload=PAYLOAD,
        external_wrench=True,
        stiffness=stiffness,
        rest_position=rest,
        effort_limits=efforts,
        torque_speed=tables,
        gravity_compensation=pfd.Scene(payload=OTHER),
    )
    return found


NAMES = tuple(scenes(1))


def gravity_torques(robot: pfd.Robot, scene: pfd.Scene, q: Array) -> Array:
    """Return the gravity torques of a robot in a scene by Pinocchio."""
    carrying = robot if scene.payload is None else pfd.with_payload(robot, scene.payload)
    model = to_pinocchio(carrying)
    model.gravity.linear = np.zeros(3) if scene.gravity is None else np.array(scene.gravity)
    found: Array = pin.computeGeneralizedGravity(model, model.createData(), q)
    return found


def motors(robot: pfd.Robot, scene: pfd.Scene, q: Array, qd: Array, tau: Array) -> Array:
    """Return the torques of the motors, element by element."""
    model = scene.gravity_compensation
    if model is not False:
        model = pfd.Scene(gravity=scene.gravity) if model is True else model
        tau = tau + gravity_torques(robot, model, q)
    tau = tau.copy()
    for i in range(robot.n):
        most = np.inf if scene.effort_limits is None else scene.effort_limits[i]
        rows = None if scene.torque_speed is None else scene.torque_speed[i]
        speeds, torques = ([0.0], [np.inf]) if rows is None else np.transpose(rows)
        driving = min(most, np.interp(abs(qd[i]), speeds, torques))
        braking = min(most, torques[0])
        sign = 1.0 if qd[i] > 0 else -1.0
        tau[i] = sign * min(max(sign * tau[i], -braking), driving)
    return tau


def passive(robot: pfd.Robot, scene: pfd.Scene, q: Array, qd: Array) -> Array:
    """Return the torques that joints with damping and springs take."""
    tau = np.zeros(robot.n)
    if scene.damping is not None:
        tau += robot.damping * qd
    if scene.stiffness is not None:
        rest = np.zeros(robot.n) if scene.rest_position is None else scene.rest_position
        tau += np.array(scene.stiffness) * (q - rest)
    return tau


def oracle_of(robot: pfd.Robot, scene: pfd.Scene) -> Oracle:
    carrying = robot if scene.payload is None else pfd.with_payload(robot, scene.payload)
    oracle = Oracle(carrying, robot.armature if scene.armature else None)
    oracle.model.gravity.linear = np.zeros(3) if scene.gravity is None else np.array(scene.gravity)
    return oracle


def given(rng: np.random.Generator, robot: pfd.Robot, scene: pfd.Scene) -> dict[str, Array]:
    q, qd, tau = random_state(rng, robot.n)
    inputs = {'q': q, 'qd': qd, 'tau': 3.0 * tau}
    return inputs | ({'wrench': rng.normal(size=6)} if scene.external_wrench else {})


def wanted_qdd(robot: pfd.Robot, scene: pfd.Scene, at: dict[str, Array]) -> Array:
    """Return Pinocchio's accelerations under the torques of motors, joints and wrench."""
    tau = motors(robot, scene, at['q'], at['qd'], at['tau'])
    tau = tau - passive(robot, scene, at['q'], at['qd'])
    return oracle_of(robot, scene).qdd(at['q'], at['qd'], tau, at.get('wrench'))


def tolerance(method: str, robot: pfd.Robot, scene: pfd.Scene, q: Array) -> float:
    H = oracle_of(robot, scene).H(q)
    unscaled = method in ('walker_orin_4', 'pcgm')
    return ACCELERATION * (float(np.linalg.cond(H)) if unscaled else jacobi_condition(H))
