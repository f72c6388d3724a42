# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Drives and springs: compensation, limits and stiffness, against Pinocchio and closed forms."""

from __future__ import annotations

from bridge import (
    FORWARD_METHODS,
    SERIAL_METHODS,
    cut_off,
    record_motor_torques,
    resolve_plant,
)
from bridge import run_program as run
from drive_scenes import (
    PAYLOAD,
    given,
    motors,
    oracle_of,
    scenes,
    tolerance,
    wanted_qdd,
)
import numpy as np
from oracle import chains, every, jacobi_condition, relative
import pytest
from sampling import one_fast
from tolerances import DYNAMICS, SINGLE
from zoo import random_chain

import pfd_core as pfd

# ---- accelerations ---------------------------------------------------------------------------


# Each effect by itself: test_effects.
@pytest.mark.parametrize('name', one_fast(['all', 'limited compensation']))
@pytest.mark.parametrize('method', pfd.METHODS)
def test_every_method_agrees_with_pinocchio(method: str, name: str) -> None:
    rng = np.random.default_rng(61)
    for n, share in ((1, 1.0), (4, 0.3)):
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


@pytest.mark.parametrize('name', one_fast(['all', 'limited compensation', 'springs']))
@pytest.mark.parametrize(('refine', 'dtype'), [(0, 'float64'), (1, 'float64'), (0, 'float32')])
def test_kernels_agree_with_pinocchio(name: str, refine: int, dtype: str) -> None:
    rng = np.random.default_rng(62)
    robot = random_chain(rng, 4, joint_types=['revolute', 'prismatic', 'continuous', 'revolute'])
    scene = scenes(4)[name]
    kernel = pfd.compile_kernel(robot, scene=scene, refine=refine, dtype=dtype)
    for _ in range(4):
        at = given(rng, robot, scene)
        most = tolerance('auto', robot, scene, at['q'])
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
