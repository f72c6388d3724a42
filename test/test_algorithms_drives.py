# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Drives and springs: compensation, limits and stiffness, against Pinocchio and closed forms."""

from __future__ import annotations

from dataclasses import replace

from bridge import (
    FORWARD_METHODS,
    MACHINE_SCHEDULES,
    SERIAL_METHODS,
    cut_off,
    record_inverse_dynamics,
    record_motor_torques,
    resolve_plant,
)
from bridge import run_program as run
from drive_scenes import (
    NAMES,
    PAYLOAD,
    given,
    gravity_torques,
    motors,
    oracle_of,
    scenes,
    tolerance,
    wanted_qdd,
)
import numpy as np
from oracle import Oracle, chains, jacobi_condition, relative
import pytest
from sampling import one_fast
from tolerances import DYNAMICS, FIFTY_DIGITS, SINGLE
from zoo import random_chain

import pfd_core as pfd

# ---- accelerations ---------------------------------------------------------------------------


@pytest.mark.parametrize('name', NAMES)
@pytest.mark.parametrize('method', pfd.METHODS)
@pytest.mark.slow
def test_every_method_agrees_with_pinocchio(method: str, name: str) -> None:
    rng = np.random.default_rng(61)
    for n, share in ((1, 0.0), (1, 1.0), (2, 0.5), (4, 0.3)):
        robot = random_chain(rng, n, share)
        scene = scenes(robot.n)[name]
        at = given(rng, robot, scene)
        wanted = wanted_qdd(robot, scene, at)
        most = tolerance(method, robot, scene, at['q'])
        for schedule in (
            ('sequential',) if method in SERIAL_METHODS else ('parallel', 'sequential')
        ):
            found = run(FORWARD_METHODS[method](resolve_plant(robot, scene), schedule), at)['qdd']
            assert relative(found, wanted) < most, (robot, schedule)


@pytest.mark.parametrize(
    ('name', 'refine'),
    [*((name, 0) for name in NAMES), ('all', 1), ('limited compensation', 1), ('springs', 1)],
)
@pytest.mark.slow
def test_kernels_agree_with_pinocchio(name: str, refine: int) -> None:
    rng = np.random.default_rng(62)
    every_type = ['revolute', 'prismatic', 'continuous', 'revolute']
    for types in (['revolute'] * 6, every_type) if name == 'all' else (every_type,):
        robot = random_chain(rng, len(types), joint_types=types)
        scene = scenes(robot.n)[name]
        kernel = pfd.compile_kernel(robot, scene=scene, refine=refine)
        for _ in range(4):
            at = given(rng, robot, scene)
            most = tolerance('auto', robot, scene, at['q'])
            assert relative(kernel(**at), wanted_qdd(robot, scene, at)) < most


@pytest.mark.parametrize('name', one_fast(['all', 'exact compensation']))
def test_kernels_of_single_precision_agree_too(name: str) -> None:
    rng = np.random.default_rng(63)
    robot = random_chain(rng, 5, joint_types=['revolute'] * 5)
    scene = scenes(5)[name]
    at = given(rng, robot, scene)
    found = pfd.compile_kernel(robot, scene=scene, dtype='float32')(**at)
    most = SINGLE * jacobi_condition(oracle_of(robot, scene).H(at['q']))
    assert relative(found, wanted_qdd(robot, scene, at)) < most


def test_methods_on_lanes_agree_in_50_digits() -> None:
    rng = np.random.default_rng(64)
    robot = random_chain(rng, 4, joint_types=['revolute', 'prismatic', 'revolute', 'continuous'])
    # Tables whose slopes are no doubles: those are rounded once, when the program is recorded.
    scene = replace(scenes(4)['all'], torque_speed=[[(0.1, 7.0), (3.1, 0.1)], *[None] * 3])
    plant, at = resolve_plant(robot, scene), given(rng, robot, scene)
    wanted, *others = (
        run(FORWARD_METHODS[method](plant, schedule), at, digits=50)['qdd']
        for method in ('pcrbm', 'pcrbm_array', 'pcrbm_base_origin', 'divide_and_conquer')
        for schedule in MACHINE_SCHEDULES
    )
    for found in others:
        assert max(abs(found - wanted)) < FIFTY_DIGITS * max(abs(wanted))


@pytest.mark.parametrize('name', one_fast(['all', 'limited compensation', 'effort limits']))
def test_motors_and_an_arm_without_drives_are_the_arm_with_them(name: str) -> None:
    for rng, robot in chains(12, seed=69):
        scene = scenes(robot.n)[name]
        plant, at = resolve_plant(robot, scene), given(rng, robot, scene)
        tau = run(record_motor_torques(plant), {k: at[k] for k in ('q', 'qd', 'tau')})['tau']
        wanted = motors(robot, scene, at['q'], at['qd'], at['tau'])
        assert np.abs(tau - wanted).max() < DYNAMICS * np.abs(wanted).max()
        undriven = plant.only('links', 'inertia', 'viscosity', 'joints')
        program = FORWARD_METHODS['composite_body'](undriven, 'sequential')
        found = run(program, at | {'tau': tau})['qdd']
        assert relative(found, wanted_qdd(robot, scene, at)) < tolerance('', robot, scene, at['q'])


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
@pytest.mark.parametrize('most', [np.inf, 11.0])
def test_a_motor_is_bounded_by_its_table_where_it_drives(
    qd: float, tau: float, force: float, most: float
) -> None:
    scene = pfd.Scene(gravity=None, torque_speed=[ROWS], effort_limits=[most])
    assert pfd.forward_dynamics(SLIDER, [0.0], [qd], [tau], scene=scene) * 2.0 == force


def test_a_table_is_cut_off_at_the_effort_limit() -> None:
    rng = np.random.default_rng(65)
    speeds = np.linspace(0, 12, 500)
    for _ in range(200):
        k = rng.integers(1, 6)
        rows = np.array([np.cumsum(rng.uniform(0.1, 2, k)), np.cumsum(rng.uniform(0, 2, k))[::-1]])
        most = rng.uniform(0.1, 8)
        cut = cut_off(rows.T, most)
        expected = np.minimum(np.interp(speeds, *rows), most)
        np.testing.assert_allclose(np.interp(speeds, *cut.T), expected, rtol=1e-13, atol=1e-13)
        assert (np.diff(cut[:, 0]) > 0).all()
    rows = np.array([(1.0, 3.0), (2.0, 1.0)])
    assert cut_off(rows, 3.0) is rows
    np.testing.assert_array_equal(cut_off(rows, 1.0), [(1.0, 1.0)])
    # The corner would fall on the second row.
    steep = np.array([(1.0, 1e20), (np.nextafter(1.0, 2.0), 0.0)])
    assert (np.diff(cut_off(steep, 1e-5)[:, 0]) > 0).all()


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


@pytest.mark.parametrize('integrator', one_fast(['rk4', 'imex2']))
def test_an_arm_with_drives_moves_alone_as_in_an_ensemble(integrator: str) -> None:
    rng = np.random.default_rng(70)
    robot = random_chain(rng, 4, joint_types=['revolute', 'prismatic', 'revolute', 'continuous'])
    scene = replace(scenes(4)['all'], external_wrench=False)
    q, taus = rng.uniform(-1, 1, (3, 4)), rng.uniform(-9, 9, (3, 40, 4))
    arms = pfd.Ensemble(robot, 3, scene, integrator=integrator)
    arms.reset(q=q)
    together = arms.rollout(taus)
    for i in range(3):
        sim = pfd.Simulator(robot, scene, integrator=integrator)
        sim.reset(q=q[i])
        alone = sim.rollout(taus[i])
        np.testing.assert_array_equal(alone.q, together.q[i])
        np.testing.assert_array_equal(alone.qd, together.qd[i])


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


@pytest.mark.parametrize('name', one_fast(['compensation of another model', 'all'], 'all'))
def test_inverse_dynamics_gives_the_commanded_torques(name: str) -> None:
    for rng, robot in chains(12, seed=67):
        scene = replace(scenes(robot.n)[name], effort_limits=None, torque_speed=None)
        at = given(rng, robot, scene)
        qdd, tau = wanted_qdd(robot, scene, at), at.pop('tau')
        for schedule in ('parallel', 'sequential'):
            program = record_inverse_dynamics(resolve_plant(robot, scene), schedule)
            found = run(program, at | {'qdd': qdd})['tau']
            size = np.abs(gravity_torques(robot, scene, at['q'])).max() + np.abs(tau).max()
            H = oracle_of(robot, scene).H(at['q'])
            assert np.abs(found - tau).max() < DYNAMICS * jacobi_condition(H) * size
        if robot.n == 4:
            found = pfd.inverse_dynamics(
                robot, at['q'], at['qd'], qdd, scene=scene, wrench=at.get('wrench')
            )
            assert np.abs(found - tau).max() < DYNAMICS * jacobi_condition(H) * size


def test_a_payload_that_is_not_compensated_pulls_the_arm_down() -> None:
    robot = pfd.load_robot('ur5')
    scene = pfd.Scene(payload=PAYLOAD, gravity_compensation=True)
    q = np.array([0.3, -1.0, 0.8, 0.2, 0.4, 0.0])
    alone = gravity_torques(robot, pfd.Scene(), q)
    missing = gravity_torques(robot, pfd.Scene(payload=PAYLOAD), q) - alone
    held = pfd.forward_dynamics(robot, q, 0 * q, missing, scene=scene)
    assert np.abs(held).max() < 1e-10
    assert pfd.forward_dynamics(robot, q, 0 * q, 0 * q, scene=scene)[1] > 0.1


# ---- springs ---------------------------------------------------------------------------------


def test_a_body_on_a_spring_swings_as_it_should() -> None:
    # w h = 0.2, where the swing shall still be right: RK4 loses (w h)^6 / 144 of it a step.
    k, m, h = 20000.0, 2.0, 0.002
    w = np.sqrt(k / m)
    scene = pfd.Scene(gravity=None, stiffness=[k], rest_position=[0.1])
    sim = pfd.Simulator(SLIDER, scene, step_size=h, substeps=1, integrator='rk4')
    sim.reset(q=[0.15])
    run = sim.rollout(np.zeros((500, 1)))
    expected = 0.1 + 0.05 * np.cos(w * run.time)
    assert w * h == pytest.approx(0.2)
    assert np.abs(run.q[:, 0] - expected).max() < 0.05 * (500 * 0.2**5 / 120)


def test_springs_hold_an_arm_in_the_equilibrium_of_pinocchio() -> None:
    rng = np.random.default_rng(68)
    robot = random_chain(rng, 6, joint_types=['revolute'] * 6)
    q = rng.uniform(-1, 1, 6)
    stiffness = np.full(6, 25.0)
    rest = q + gravity_torques(robot, pfd.Scene(), q) / stiffness
    scene = pfd.Scene(stiffness=stiffness, rest_position=rest)
    free = pfd.forward_dynamics(robot, q, 0 * q, 0 * q)
    held = pfd.forward_dynamics(robot, q, 0 * q, 0 * q, scene=scene)
    assert np.abs(held).max() < 1e-12 * np.abs(free).max() * jacobi_condition(Oracle(robot).H(q))
