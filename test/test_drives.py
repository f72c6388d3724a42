# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Drives and springs: compensation, limits and stiffness, against Pinocchio and closed forms."""

from __future__ import annotations

from bridge import (
    FORWARD_METHODS,
    record_motor_torques,
    resolve_plant,
)
from bridge import run_program as run
import numpy as np
from oracle import Oracle, chains, every, jacobi_condition, relative
import pinocchio as pin
import pytest
from sampling import one_fast
from tolerances import ACCELERATION, DYNAMICS, SINGLE
from zoo import Array, random_chain, random_state, to_pinocchio

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
        'effort limits': pfd.Scene(effort_limits=efforts),
        'limited compensation': pfd.Scene(gravity_compensation=True, effort_limits=[4.0] * n),
        'springs': pfd.Scene(stiffness=stiffness),
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


def tolerance(robot: pfd.Robot, scene: pfd.Scene, q: Array) -> float:
    return ACCELERATION * jacobi_condition(oracle_of(robot, scene).H(q))


@pytest.mark.parametrize('name', one_fast(['all', 'limited compensation', 'springs']))
@pytest.mark.parametrize(('refine', 'dtype'), [(0, 'float64'), (1, 'float64'), (0, 'float32')])
def test_kernels_agree_with_pinocchio(name: str, refine: int, dtype: str) -> None:
    rng = np.random.default_rng(62)
    robot = random_chain(rng, 4, joint_types=['revolute', 'prismatic', 'continuous', 'revolute'])
    scene = scenes(4)[name]
    kernel = pfd.compile_kernel(robot, scene=scene, refine=refine, dtype=dtype)
    for _ in range(4):
        at = given(rng, robot, scene)
        most = tolerance(robot, scene, at['q'])
        if dtype == 'float32':
            most = SINGLE * jacobi_condition(oracle_of(robot, scene).H(at['q']))
        assert relative(kernel(**at), wanted_qdd(robot, scene, at)) < most


@pytest.mark.parametrize('name', one_fast(['all', 'limited compensation', 'effort limits']))
def test_motors_and_an_arm_without_drives_are_the_arm_with_them(name: str) -> None:
    for rng, robot in every(3, chains(12, seed=69)):
        scene = scenes(robot.n)[name]
        plant, at = resolve_plant(robot, scene), given(rng, robot, scene)
        tau = run(record_motor_torques(plant), {k: at[k] for k in ('q', 'qd', 'tau')})['tau']
        wanted = motors(robot, scene, at['q'], at['qd'], at['tau'])
        assert np.abs(tau - wanted).max() < DYNAMICS * np.abs(wanted).max()
        undriven = plant.only('links', 'inertia', 'viscosity', 'joints')
        program = FORWARD_METHODS['composite_body'](undriven, 'sequential')
        found = run(program, at | {'tau': tau})['qdd']
        assert relative(found, wanted_qdd(robot, scene, at)) < tolerance(robot, scene, at['q'])


# ---- limits ----------------------------------------------------------------------------------


def weightless(n: int) -> pfd.Robot:
    """Return sliding bodies of 2 kg whose motions do not act on each other."""
    return pfd.Robot(
        name='sliders',
        joint_names=tuple(f'joint{i + 1}' for i in range(n)),
        joint_types=('prismatic',) * n,
        # Frame i is turned by 90 degrees about x: axes z, -y, -z, ...
        rotations=np.array([[[1, 0, 0], [0, 0, -1], [0, 1, 0]]] * n, float),
        translations=np.zeros((n, 3)),
        masses=np.array([0.0] * (n - 1) + [2.0]),
        centers=np.zeros((n, 3)),
        inertias=np.zeros((n, 3, 3)),
    )


SLIDER = weightless(1)
ROWS = [(1.0, 10.0), (3.0, 4.0)]


@pytest.mark.parametrize(
    ('qd', 'tau', 'force'),
    [
        (0.5, 20.0, 10.0),  # drives, slow
        (2.0, 20.0, 7.0),  # drives, between the rows
        (2.0, 5.0, 5.0),
        (3.0, 20.0, 4.0),
        (9.0, 20.0, 4.0),  # faster than the last row
        (2.0, -20.0, -10.0),  # brakes
        (-2.0, -20.0, -7.0),
        (-2.0, 20.0, 10.0),
        (0.0, 20.0, 10.0),  # at rest either way
        (0.0, -20.0, -10.0),
        (-0.0, 20.0, 10.0),
    ],
)
@pytest.mark.parametrize('most', [np.inf, 11.0, 8.0, 3.0])
def test_a_motor_is_bounded_by_its_table_where_it_drives(
    qd: float, tau: float, force: float, most: float
) -> None:
    scene = pfd.Scene(gravity=None, torque_speed=[ROWS], effort_limits=[most])
    found = pfd.forward_dynamics(SLIDER, [0.0], [qd], [tau], scene=scene) * 2.0
    assert found == np.clip(force, -most, most)


def test_a_table_whose_corner_at_the_effort_limit_falls_on_a_row_has_a_torque() -> None:
    steep = [(1.0, 1e20), (np.nextafter(1.0, 2.0), 0.0)]
    scene = pfd.Scene(gravity=None, torque_speed=[steep], effort_limits=[1e-5])
    for qd in (0.5, 1.0, 2.0):
        found = pfd.forward_dynamics(SLIDER, [0.0], [qd], [1.0], scene=scene)
        assert 0 <= found * 2.0 <= 1e-5


@pytest.mark.parametrize('integrator', ['rk4', 'velocity_verlet', 'imex2'])
def test_a_motor_that_weakens_with_speed_comes_to_the_speed_of_its_table(integrator: str) -> None:
    # m v' = a - b v - d v between the rows: v = v_end (1 - exp(-(b + d) t / m)).
    a, b, d, m = 12.0, 3.0, 1.0, 2.0
    scene = pfd.Scene(gravity=None, damping=[d], torque_speed=[[(0.0, a), (4.0, 0.0)]])
    sim = pfd.Simulator(SLIDER, scene, integrator=integrator, step_size=1e-3)
    velocity = sim.rollout(np.full((1000, 1), 50.0)).qd[-1, 0]
    expected = a / (b + d) * (1 - np.exp(-(b + d) / m))
    error = {'rk4': 1e-12, 'velocity_verlet': 1e-6, 'imex2': 1e-6}[integrator]
    assert abs(velocity - expected) < error * expected


def test_a_limited_arm_is_one_that_is_given_limited_torques() -> None:
    rng = np.random.default_rng(66)
    robot = random_chain(rng, 5)
    limits = [2.0, np.inf, 1.0, 3.0, 2.0]
    taus = rng.uniform(-5, 5, (50, 5))
    sims = [pfd.Simulator(robot, pfd.Scene(effort_limits=e)) for e in (limits, None)]
    limited = sims[0].rollout(taus)
    clipped = sims[1].rollout(np.clip(taus, -np.array(limits), limits))
    np.testing.assert_array_equal(limited.q, clipped.q)
    np.testing.assert_array_equal(limited.qdd, clipped.qdd)


# ---- gravity compensation --------------------------------------------------------------------


def test_an_arm_that_is_compensated_exactly_is_weightless() -> None:
    robot = pfd.load_robot('panda')
    plant = resolve_plant(
        robot, pfd.Scene(payload=PAYLOAD, gravity_compensation=pfd.Scene(payload=PAYLOAD))
    )
    assert plant.digest == resolve_plant(robot, pfd.Scene(gravity=None, payload=PAYLOAD)).digest
    # A limit might cut the torques of the compensation off.
    scene = pfd.Scene(gravity_compensation=True, effort_limits=[1.0] * 7)
    assert resolve_plant(robot, scene).gravity_compensation is not None
