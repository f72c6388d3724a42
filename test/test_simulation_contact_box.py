# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Held joints, released joints and impacts satisfy the conditions that define them."""

from __future__ import annotations

import numpy as np
from oracle import Oracle
import pytest
from zoo import Array, random_chain, slider

import pfd_core as pfd

# A time in which no state changes and no event happens, after which rates can be read.
INSTANT = 1e-15
# Torques of 1e3 N m of a chain of condition 1e4, after one step.
BALANCE = 1e-8
# An impact never adds energy but by rounding.
ENERGY = 1e-12


def instant(robot: pfd.Robot, scene: pfd.Scene, q: Array, qd: Array, tau: Array) -> pfd.Ensemble:
    """Return an ensemble after a step of no length from states, (B, n), under torques."""
    arms = pfd.Ensemble(robot, len(q), scene, step_size=INSTANT, substeps=1)
    arms.reset(q, qd)
    arms.rollout(tau[:, np.newaxis])
    return arms


# Joints, and those of them without friction.
REST = [(4, ()), (4, (0, 2)), *(pytest.param(n, (), marks=pytest.mark.slow) for n in (1, 2, 7))]


@pytest.mark.parametrize(('n', 'smooth'), REST)
def test_accelerations_from_rest_balance_the_torques_within_what_friction_and_stops_hold(
    n: int, smooth: tuple[int, ...]
) -> None:
    rng = np.random.default_rng(n)
    robot = random_chain(rng, n, 0.2)
    friction = rng.uniform(0.5, 2.0, n)
    friction[list(smooth)] = 0.0
    q = rng.choice([-1.0, 1.0, 0.3, -0.7], (200, n))
    oracle, zero = Oracle(robot), np.zeros(n)
    needed = np.array([oracle.tau(x, zero, zero) for x in q])
    tau = needed + rng.uniform(-20, 20, (200, n)) * rng.integers(0, 2, (200, n))
    tau[:20] = needed[:20] + friction * rng.uniform(-0.95, 0.95, (20, n))
    scene = pfd.Scene(friction=friction, joint_limits=[[-1.0, 1.0]] * n, restitution=0.3)
    qdd = instant(robot, scene, q, 0 * q, tau).qdd
    for x, a, given, bias in zip(q, qdd, tau, needed, strict=True):
        reaction = oracle.H(x) @ a + bias - given
        scale = BALANCE * (np.abs(given).max() + 2.0)
        lower = np.where(x == 1.0, -np.inf, -friction)
        upper = np.where(x == -1.0, np.inf, friction)
        assert (lower - scale <= reaction).all()
        assert (reaction <= upper + scale).all()
        # A stop pushes away alone, and a joint that moves feels its friction and no stop.
        assert (a[x == -1.0] >= 0).all()
        assert (a[x == 1.0] <= 0).all()
        wanted = np.where(a > 0, lower, upper)[a != 0.0]
        assert np.abs(reaction[a != 0.0] - wanted).max(initial=0.0) < scale
    assert smooth or (qdd[:20] == 0.0).all()
    held = qdd == 0.0
    assert (held.any(axis=1) & ~held.all(axis=1)).sum() > 10 or n == 1


@pytest.mark.parametrize('seed', range(8))
@pytest.mark.slow
def test_an_impact_never_adds_energy_and_no_joint_moves_on_into_its_stop(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 2 + seed % 6
    robot = random_chain(rng, n, 0.2)
    scene = pfd.Scene(
        gravity=None, joint_limits=[[-1.0, 1.0]] * n, restitution=rng.uniform(0, 1, n)
    )
    q = rng.choice([-1.0, 1.0, 0.2], (256, n), p=[0.4, 0.4, 0.2])
    before = rng.normal(size=(256, n))
    after = instant(robot, scene, q, before, 0 * q).qd
    oracle = Oracle(robot)
    into = ((q == -1.0) & (before < 0)) | ((q == 1.0) & (before > 0))
    still = ((q == -1.0) & (after < 0)) | ((q == 1.0) & (after > 0))
    assert into.any(axis=1).sum() > 128
    assert not still.any()
    for x, v, w in zip(q, before, after, strict=True):
        H = oracle.H(x)
        assert w @ H @ w <= v @ H @ v * (1 + ENERGY)


def test_an_impact_of_one_joint_turns_its_velocity_by_the_restitution() -> None:
    rng = np.random.default_rng(2)
    robot, n = random_chain(rng, 3, 0.0), 3
    scene = pfd.Scene(gravity=None, joint_limits=[[-1, 1]] * n, restitution=[0.2, 0.5, 1.0])
    oracle = Oracle(robot)
    for i, e in enumerate([0.2, 0.5, 1.0]):
        q, v = rng.uniform(-0.9, 0.9, (1, n)), rng.normal(size=(1, n))
        q[0, i], v[0, i] = 1.0, 2.0
        after = instant(robot, scene, q, v, 0 * q).qd[0]
        impulse = oracle.H(q[0]) @ (after - v[0])
        assert after[i] == pytest.approx(-e * v[0, i], rel=BALANCE)
        others = np.arange(n) != i
        assert np.abs(impulse[others]).max() < BALANCE * abs(impulse[i])


def test_a_braked_joint_takes_no_part_in_an_impact() -> None:
    rng = np.random.default_rng(4)
    robot = random_chain(rng, 3, 0.0)
    scene = pfd.Scene(gravity=None, joint_limits=[[-1, 1]] * 3, restitution=[1.0] * 3, brakes=True)
    q, v, held = [0.3, 1.0, 0.1], [0.0, 2.0, -1.0], np.array([True, False, False])
    sim = pfd.Simulator(robot, scene, step_size=INSTANT, substeps=1)
    sim.reset(q, v)
    sim.step(np.zeros(3), brakes=held)
    assert sim.qd[0] == 0.0
    H = Oracle(robot).H(np.array(q))[1:, 1:]
    change = sim.qd[1:] - v[1:]
    assert abs((H @ change)[1]) < BALANCE * abs((H @ change)[0])
    assert sim.qd[1] == pytest.approx(-2.0, rel=BALANCE)


def loaded_arm(share: float) -> tuple[pfd.Robot, Array, Array]:
    """Return UR5, a pose, and friction of which gravity needs a share."""
    robot = pfd.load_robot('ur5')
    q = np.array([0.3, -0.8, 1.1, 0.4, -0.6, 0.2])
    needed = np.abs(pfd.inverse_dynamics(robot, q, 0 * q, 0 * q))
    return robot, q, np.maximum(needed / share, 0.1)


def test_an_arm_under_a_steady_or_shaking_torque_below_its_friction_does_not_creep() -> None:
    robot, q, friction = loaded_arm(1.0)
    sim = pfd.Simulator(robot, pfd.Scene(friction=friction))
    needed = pfd.inverse_dynamics(robot, q, 0 * q, 0 * q)
    shaken = 0.8 + 0.15 * np.sin(10 * np.pi * 1e-3 * np.arange(10_000))
    for share in (np.full(10_000, 0.95), shaken):
        sim.reset(q)
        run = sim.rollout(needed * (1 - share[:, np.newaxis]))
        assert (run.q == q).all()
        assert (run.qd == 0.0).all()
        assert (run.qdd == 0.0).all()


@pytest.mark.parametrize(
    ('integrator', 'dtype', 'brakes'),
    [
        ('rk4', 'float64', False),
        ('rk4', 'float32', True),
        ('velocity_verlet', 'float64', True),
        ('imex2', 'float64', True),
    ],
)
@pytest.mark.slow
def test_an_arm_moves_by_the_same_bits_alone_step_by_step_and_in_an_ensemble(
    integrator: str, dtype: str, brakes: bool
) -> None:
    rng = np.random.default_rng(7)
    robot, n = random_chain(rng, 3, 0.0), 3
    scene = pfd.Scene(
        friction=rng.uniform(0.5, 3, n),
        static_friction=[4.0] * n,
        stribeck_velocity=[0.1] * n,
        joint_limits=[[-1.0, 1.0]] * n,
        restitution=0.5,
        brakes=brakes,
        external_wrench=True,
        damping=[0.05] * n,
        armature=[0.1] * n,
        motor_lag=[0.01, 0.0, 0.02],
    )
    settings = {'step_size': 2e-3, 'dtype': dtype, 'integrator': integrator}
    held = {'brakes': np.arange(n) == 1} if brakes else {}
    q, qd = rng.uniform(-0.9, 0.9, (11, n)), rng.normal(0, 3, (11, n))
    qd[::3] = 0.0
    taus = rng.normal(0, 8, (11, 300, n))
    wrench = rng.normal(0, 5, 6)
    arms = pfd.Ensemble(robot, 11, scene, **settings)
    arms.reset(q, qd)
    many = arms.rollout(taus, wrench=wrench, threads=2, **held)
    assert (many.finite_steps == 300).all()
    assert (many.qd == 0).any(axis=(1, 2)).sum() > 8
    for k in range(11):
        alone = pfd.Simulator(robot, scene, **settings)
        alone.reset(q[k], qd[k])
        run = alone.rollout(taus[k], wrench=wrench, **held)
        for name in ('q', 'qd', 'qdd'):
            np.testing.assert_array_equal(getattr(run, name), getattr(many, name)[k], name)
    stepped = pfd.Simulator(robot, scene, **settings)
    stepped.reset(q[10], qd[10])
    for tau in taus[10]:
        stepped.step(tau, wrench, **held)
    np.testing.assert_array_equal(stepped.q, run.q[-1])
    np.testing.assert_array_equal(stepped.qdd, run.qdd[-1])


@pytest.mark.parametrize('integrator', pfd.INTEGRATORS)
@pytest.mark.parametrize('damping', [None, [1e-9]])
def test_all_integrators_take_steps_with_friction_and_stops(
    integrator: str, damping: list[float] | None
) -> None:
    # 1 kg under 3 N and a friction of 1 N, from a reversal to an impact at 1 m.
    scene = pfd.Scene(
        gravity=None, friction=[1.0], damping=damping, joint_limits=[[-1.0, 1.0]], restitution=0.5
    )
    sim = pfd.Simulator(slider(1, 0), scene, integrator=integrator)
    sim.reset([0.5], [-0.5])
    run = sim.rollout(np.full((1000, 1), 3.0))
    assert run.status == 'ok'
    way = 0.5 + 0.5**2 / 8
    # It meets the stop with 2 sqrt(way), and returns with half of that, against 4 N.
    left = 1.0 - (0.125 + np.sqrt(way))
    assert run.qd[-1, 0] == pytest.approx(4 * left - np.sqrt(way), abs=1e-6)


def test_an_arm_whose_step_ends_at_a_stop_waits_there_while_another_one_hits() -> None:
    h = 2.0**-10
    scene = pfd.Scene(gravity=None, joint_limits=[[-1.0, h]], restitution=[0.5])
    arms = pfd.Ensemble(slider(1, 0), 2, scene, step_size=h, substeps=1)
    arms.reset([[0.0], [h / 2]], [[1.0], [1.0]])
    run = arms.rollout(steps=2)
    assert run.q[..., 0].tolist() == [[h, h / 2], [3 * h / 4, h / 4]]
    assert run.qd[..., 0].tolist() == [[1.0, -0.5], [-0.5, -0.5]]


def test_stops_out_of_reach_leave_the_motion_as_it_is_with_lagging_motors() -> None:
    rng = np.random.default_rng(3)
    robot, n = random_chain(rng, 3), 3
    lag = {'motor_lag': [0.01, 0.0, 0.002], 'armature': [0.1] * n}
    far = pfd.Scene(joint_limits=[[-100.0, 100.0]] * n, **lag)
    taus = rng.normal(0, 20, (200, n))
    ends = []
    for scene in (pfd.Scene(**lag), far):
        sim = pfd.Simulator(robot, scene)
        sim.reset([0.1] * n, [0.5] * n)
        ends.append(sim.rollout(taus))
    for name in ('q', 'qd', 'qdd'):
        free, bounded = (getattr(run, name) for run in ends)
        assert np.abs(free - bounded).max() < BALANCE * np.abs(free).max()


def test_a_motor_that_lags_breaks_a_joint_away_when_its_torque_reaches_the_friction() -> None:
    """Torque u (1 - exp(-t/T)) against friction F: v = (u - F)(t - t0) - u T (e0 - e), m = 1."""
    u, lag, friction = 20.0, 0.05, 8.0
    scene = pfd.Scene(gravity=None, friction=[friction], motor_lag=[lag])
    sim = pfd.Simulator(slider(1, 0), scene, step_size=1e-3, substeps=1)
    run = sim.rollout(np.full((200, 1), u))
    away = -lag * np.log(1 - friction / u)
    assert (run.qd[run.time < away] == 0.0).all()
    t = run.time[run.time > away]
    wanted = (u - friction) * (t - away) - u * lag * (np.exp(-away / lag) - np.exp(-t / lag))
    # The joint is released at the end of the step in which its torque reaches the friction.
    assert np.abs(run.qd[run.time > away, 0] - wanted).max() < u / lag * 1e-3**2


@pytest.mark.parametrize('lag', [1e-5, 1e-3, 1.0, 10.0])
def test_a_motor_that_lags_takes_a_joint_without_any_other_torque_off_its_stop(lag: float) -> None:
    """Torque 1 - exp(-t/T) on 1 kg from rest: v = t - T (1 - exp(-t/T))."""
    scene = pfd.Scene(gravity=None, joint_limits=[[0.0, 1.0]], motor_lag=[lag])
    sim = pfd.Simulator(slider(1, 0), scene, step_size=1e-3, substeps=1)
    run = sim.rollout(np.ones((100, 1)))
    assert run.status == 'ok'
    assert run.qd[-1, 0] == pytest.approx(0.1 + lag * np.expm1(-0.1 / lag), rel=1e-2)


@pytest.mark.parametrize(
    ('seed', 'integrator', 'damping'), [(0, 'rk4', 0.0), (2, 'velocity_verlet', 1000.0)]
)
def test_two_joints_that_throw_each_other_off_their_stops_come_to_rest_there(
    seed: int, integrator: str, damping: float
) -> None:
    robot = random_chain(np.random.default_rng(seed), 2, 0.0)
    limits = [[-1.0, 0.0], [-1.0, 0.0]]
    scene = pfd.Scene(gravity=None, damping=[damping, 0.0], joint_limits=limits)
    sim = pfd.Simulator(robot, scene, step_size=1e-3, substeps=1, integrator=integrator)
    sim.reset([-1e-5, 0.0], [0.2, 0.0])
    sim.rollout(np.full((5, 2), 5.0))
    assert sim.status == 'ok'
    assert not sim.q.any()
    assert not sim.qd.any()


def test_a_slow_joint_under_friction_moves_in_float32() -> None:
    """At 1000 m a step of 1e-5 m is a sixth of the last digit of a position in float32."""
    scene = pfd.Scene(gravity=None, friction=[1e-9])
    sim = pfd.Simulator(slider(1, 0), scene, step_size=1e-3, substeps=1, dtype='float32')
    sim.reset([1000.0], [0.01])
    run = sim.rollout(np.zeros((10_000, 1)))
    assert abs(float(run.q[-1, 0]) - 1000.1) < np.spacing(np.float32(1000.0))


def test_friction_acts_behind_the_limits_of_the_motor() -> None:
    """A command of 100 N gives a motor of 5 N, of which a friction of 3 N leaves 2 N for 1 kg."""
    scene = pfd.Scene(gravity=None, friction=[3.0], effort_limits=[5.0])
    sim = pfd.Simulator(slider(1, 0), scene, step_size=1e-3, substeps=1)
    run = sim.rollout(np.full((100, 1), 100.0))
    assert run.qd[-1, 0] == pytest.approx(0.2, rel=1e-12)
    assert run.qdd[-1, 0] == pytest.approx(2.0, rel=1e-12)


def test_a_motor_below_the_static_friction_does_not_move_its_joint_whatever_the_command() -> None:
    scene = pfd.Scene(gravity=None, friction=[3.0], static_friction=[6.0], effort_limits=[5.0])
    sim = pfd.Simulator(slider(1, 0), scene)
    assert (sim.rollout(np.full((100, 1), 1e6)).q == 0.0).all()


def test_drives_that_compensate_gravity_hold_an_arm_whose_friction_is_below_it() -> None:
    robot, q, friction = loaded_arm(20.0)
    held = pfd.Scene(friction=friction, gravity_compensation=True, payload=None)
    falls = pfd.Scene(friction=friction)
    for scene, stays in ((held, True), (falls, False)):
        sim = pfd.Simulator(robot, scene)
        sim.reset(q)
        assert (sim.rollout(np.zeros((200, 6))).q == q).all() == stays


@pytest.mark.long
@pytest.mark.parametrize('dtype', ['float64', 'float32'])
@pytest.mark.parametrize('integrator', pfd.INTEGRATORS[1:])
def test_twelve_joints_with_everything_move_by_the_same_bits_in_any_lane(
    integrator: str, dtype: str
) -> None:
    rng, n, arms, steps = np.random.default_rng(3), 12, 19, 120
    scene = pfd.Scene(
        armature=rng.uniform(0.3, 1, n),
        friction=rng.uniform(0, 3, n),
        damping=rng.uniform(0.1, 1, n),
        joint_limits=[[-0.4, 0.4]] * n,
        restitution=0.5,
        motor_lag=rng.uniform(0, 0.01, n) * (rng.random(n) < 0.6),
        brakes=True,
    )
    settings = {'integrator': integrator, 'dtype': dtype, 'compensated': True}
    robot = random_chain(rng, n, 0.2)
    q = rng.uniform(-0.35, 0.35, (arms, n))
    qd = rng.normal(0, 1.5, (arms, n)) * (rng.random((arms, n)) < 0.7)
    taus = np.repeat(rng.normal(0, 10, (arms, steps // 30, n)), 30, axis=1)
    brakes = rng.random((arms, n)) < 0.1
    many = pfd.Ensemble(robot, arms, scene, **settings)
    many.reset(q, qd)
    runs = many.rollout(taus, brakes=brakes)
    assert runs.status == 'ok'
    assert (runs.qd == 0.0)[~np.repeat(brakes[:, np.newaxis], steps, axis=1)].any()
    one = pfd.Simulator(robot, scene, **settings)
    for k in range(0, arms, 3):
        one.reset(q[k], qd[k])
        alone = one.rollout(taus[k], brakes=brakes[k])
        for name in ('q', 'qd', 'qdd'):
            np.testing.assert_array_equal(getattr(runs, name)[k], getattr(alone, name))
    order = rng.permutation(arms)[:11]
    some = pfd.Ensemble(robot, len(order), scene, **settings)
    some.reset(q[order], qd[order])
    np.testing.assert_array_equal(some.rollout(taus[order], brakes=brakes[order]).q, runs.q[order])
