# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Dry friction and joint stops: closed forms, conditions, an event-driven integration."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from math import log, sqrt

from contact_oracle import Case, Motion, TooManyEventsError, random_case, random_start
import numpy as np
from oracle import Oracle
import pinocchio as pin
import pytest
from zoo import BODY, Array, flywheel, joint, link, one_fast, random_chain, slider, urdf

import pfd_core as pfd

STEP = 1e-3
POINT = '0 0 0 0 0 0'
DAMPED = 2e-13
IMPLICIT = 1e-7  # imex2 at 0.5 ms, of second order
STRIBECK = 1e-8  # the bend at 0.1 rad/s is passed in 25 steps
ROUNDING_OF_1500_STEPS = 2e-13


def two_links() -> pfd.Robot:
    """Return two links of 1 m with point masses of 1 kg at their ends, stretched at q = 0."""
    return pfd.load_robot(
        urdf(
            'two_links',
            *(link('base'), link('upper', 1.0, '1 0 0', J=POINT)),
            *(link('lower', 1.0, '1 0 0', J=POINT), joint('j1', 'continuous', 'base', 'upper')),
            joint('j2', 'continuous', 'upper', 'lower', xyz='1 0 0'),
        )
    )


def simulated(robot: pfd.Robot, scene: pfd.Scene, q, qd, taus, **settings):  # type: ignore[no-untyped-def]
    """Return the trajectory of a simulation from a state, in steps of 1 ms."""
    options = {'step_size': STEP, 'substeps': 1} | settings
    sim = pfd.Simulator(robot, scene, **options)
    sim.reset(q, qd)
    return sim.rollout(taus)


@pytest.mark.parametrize(
    ('integrator', 'order', 'most'), [('rk4', 3.9, DAMPED), ('imex2', 1.8, IMPLICIT)]
)
def test_a_rotor_with_damping_and_friction_stops_at_the_closed_form(
    integrator: str, order: float, most: float
) -> None:
    inertia, d, friction, v = 0.5, 3.0, 2.0, 5.0
    scene = pfd.Scene(friction=[friction], damping=[d])
    time = inertia / d * log(1 + d * v / friction)
    angle = inertia / d * (v - friction / d * log(1 + d * v / friction))
    errors = []
    for parts in (1, 2):
        settings = {'step_size': STEP / parts, 'integrator': integrator}
        run = simulated(
            flywheel(inertia), scene, [0.0], [v], np.zeros((400 * parts, 1)), **settings
        )
        errors.append(abs(run.q[-1, 0] - angle))
        assert run.time[np.flatnonzero(run.qd == 0.0)[0]] - time < STEP / parts
    # The event adds nothing to the error of the integrator.
    assert errors[1] < most
    assert np.log2(errors[0] / errors[1]) > order


@pytest.mark.parametrize(('mu', 'steps'), [(0.7, 1000), (0.4, 2000)])
def test_a_mass_on_an_incline_stays_or_slides_back(mu: float, steps: int) -> None:
    g, slope = 9.81, np.pi / 6
    press, pull = g * np.cos(slope), g * np.sin(slope)
    scene = pfd.Scene(friction=[mu * press])
    rail = slider(float(np.cos(slope)), float(np.sin(slope)))
    run = simulated(rail, scene, [0.0], [1.0], np.zeros((steps, 1)))
    up = pull + mu * press
    top, turn = 1 / (2 * up), 1 / up
    down = max(pull - mu * press, 0.0)
    after = run.time - turn
    wanted = np.where(after < 0, run.time - up * run.time**2 / 2, top - down * after**2 / 2)
    assert np.abs(run.q[:, 0] - wanted).max() < ROUNDING_OF_1500_STEPS
    if down == 0.0:
        assert (run.qd[after > 0] == 0.0).all()


def test_friction_that_falls_with_the_speed_stops_a_rotor_at_the_closed_form() -> None:
    """I v' = -Fc - (Fs - Fc)/(1 + (v/vs)^2): time to rest by partial fractions."""
    inertia, sliding, static, vs, v = 0.5, 2.0, 3.0, 0.1, 1.0
    scene = pfd.Scene(friction=[sliding], static_friction=[static], stribeck_velocity=[vs])
    run = simulated(flywheel(inertia), scene, [0.0], [v], np.zeros((400, 1)))
    c = sqrt(static / sliding)
    # dt = -I (1 + u^2) / (Fc (u^2 + c^2)) vs du, u = v / vs.
    time = inertia * vs / sliding * (v / vs + (1 - c**2) / c * np.arctan(v / vs / c))
    first = np.flatnonzero(run.qd[:, 0] == 0.0)[0]
    assert 0 <= run.time[first] - time < STEP
    way = (
        inertia
        * vs**2
        / sliding
        * ((v / vs) ** 2 / 2 + (1 - c**2) / 2 * log(1 + (v / vs / c) ** 2))
    )
    assert abs(run.q[-1, 0] - way) < STRIBECK


# ---- many impacts, bounces that end, joints at rest ------------------------------------------


G = 9.81
# Roundings of some hundred operations, in motions of order ten.
ROUNDING = 1e-12
# Events are found on the cubic output of RK4, and the reference joins motions by hand.
CASE = 1e-9


@pytest.mark.parametrize('restitution', one_fast([1.0, 0.99], 0.99))
def test_a_mass_that_rattles_between_two_stops_keeps_moving(restitution: float) -> None:
    """10 mm at 30 m/s: three hits and more in a step of 1 ms."""
    gap, speed = 0.01, 30.0
    scene = pfd.Scene(gravity=None, joint_limits=[[0.0, gap]], restitution=[restitution])
    run = simulated(slider(1, 0), scene, [0.5 * gap], [speed], np.zeros((20, 1)))
    for time, q, v in zip(run.time, run.q[:, 0], run.qd[:, 0], strict=True):
        left, way, sign, now = time, 0.5 * gap, 1.0, speed
        while left * now > way:
            left, way, sign, now = left - way / now, gap, -sign, now * restitution
        place = (gap - way if sign > 0 else way) + sign * now * left
        assert q == pytest.approx(place, abs=CASE * gap)
        assert v == pytest.approx(sign * now, rel=CASE)


@pytest.mark.parametrize(
    ('restitution', 'friction'),
    [
        *((0.0, 2.0), (0.9, 0.0), (0.97, 2.0)),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in ((0.0, 0.0), (0.5, 0.0), (0.5, 2.0), (0.9, 2.0), (0.97, 0.0))
        ),
    ],
)
def test_a_mass_that_bounces_lies_on_its_stop_within_a_step_of_the_last_bounce(
    restitution: float, friction: float
) -> None:
    """Bounces go up under g + f and down under g - f: a geometric series of times."""
    up, down = G + friction, G - friction
    speed, rest = sqrt(2 * down), sqrt(2 / down)
    ratio = restitution * sqrt(down / up)
    rest += restitution * speed * (1 / up + 1 / sqrt(up * down)) / (1 - ratio)
    scene = pfd.Scene(joint_limits=[[0.0, 100.0]], restitution=[restitution], friction=[friction])
    steps = round(rest / STEP) + 300
    for kind in (pfd.Simulator, partial(pfd.Ensemble, size=1)):
        sim = kind(slider(0, 1), scene=scene, step_size=STEP, substeps=1)
        sim.reset([1.0], [0.0])
        run = sim.rollout(np.zeros((steps, 1)))
        q, v = run.q.reshape(-1), run.qd.reshape(-1)
        still = run.time >= rest + STEP
        assert run.status == 'ok'
        assert (q >= 0).all()
        assert (q[still] == 0.0).all()
        assert (v[still] == 0.0).all()
        moving = run.time < rest - STEP
        assert ((q[moving] != 0.0) | (v[moving] != 0.0)).all()


def test_joints_with_friction_that_throw_each_other_off_their_stops_come_to_rest_there() -> None:
    robot = random_chain(np.random.default_rng(0), 2, 0.0)
    stops = [[-1.0, 0.0], [-1.0, 0.0]]
    scene = pfd.Scene(gravity=None, joint_limits=stops, friction=[0.2, 0.1], restitution=0.5)
    arm = pfd.Simulator(robot, scene, step_size=1e-2, substeps=1)
    arm.reset([-1e-4, 0.0], [1.0, 0.0])
    assert arm.rollout(np.full((20, 2), 5.0)).status == 'ok'
    assert not arm.q.any()
    assert not arm.qd.any()


def test_an_ensemble_reports_for_each_arm_why_it_failed() -> None:
    scene = pfd.Scene(gravity=None, joint_limits=[[0.0, 1e-7]], restitution=[1.0])
    arms = pfd.Ensemble(slider(1, 0, 0.5), 4, scene, step_size=STEP, substeps=1)
    arms.reset([5e-8], [[1e-3], [10.0], [0.0], [2e-3]])
    taus = np.zeros((4, 2, 1))
    taus[2] = np.finfo(float).max
    assert arms.rollout(taus).finite_steps.tolist() == [2, 0, 0, 2]
    assert arms.statuses.tolist() == ['ok', 'too_many_events', 'not_finite', 'ok']
    arms.rollout(steps=1)
    assert arms.statuses.tolist() == ['ok', 'too_many_events', 'not_finite', 'ok']
    arms.reset([5e-8], [1e-3])
    assert arms.statuses.tolist() == ['ok'] * 4
    arm = pfd.Simulator(slider(1, 0, 0.5), scene, step_size=STEP, substeps=1)
    arm.reset([5e-8], [10.0])
    run = arm.rollout(np.zeros((3, 1)))
    assert (run.status, run.finite_steps, arm.status) == ('too_many_events', 0, 'too_many_events')
    bare = pfd.Ensemble(slider(1, 0), 2, pfd.Scene(gravity=None))
    bare.reset([0.0], [[0.0], [np.finfo(float).max]])
    bare.rollout(np.full((2, 3, 1), [[[0.0]], [[np.finfo(float).max]]]))
    assert bare.statuses.tolist() == ['ok', 'not_finite']


@pytest.mark.parametrize('kind', [pfd.Simulator, partial(pfd.Ensemble, size=1)])
def test_a_joint_with_static_friction_alone_sticks_and_slides_without_friction(kind) -> None:  # type: ignore[no-untyped-def]
    scene = pfd.Scene(gravity=None, friction=[0.0], static_friction=[3.0])
    sim = kind(slider(1, 0), scene=scene, step_size=STEP, substeps=1)
    held = sim.rollout(np.full((100, 1), 2.0))
    assert (held.q == 0.0).all()
    moved = sim.rollout(np.full((100, 1), 4.0))
    assert moved.qd[..., -1, 0] == pytest.approx(0.4, rel=ROUNDING)
    # It stops after 0.2 s and 0.04 m more, and 2 N do not bring it back.
    back = sim.rollout(np.full((300, 1), -2.0))
    assert (back.qd[..., 250:, 0] == 0.0).all()
    assert back.q[..., -1, 0] == pytest.approx(0.06, rel=ROUNDING)


# ---- a second of three joints of a PUMA 560, torques that change every 0.25 s ------------------

ROTORS = [0.8, 4.0, 0.8]
# Name -> integrator, sliding friction, other fields of the scene, largest torques, seed,
# positions, and the largest error of a position after the second [rad].
MOTIONS = {
    'reversals': ('rk4', [6, 8, 3], {}, [25, 60, 15], 2, [0, 0.2, 0.3], 8e-12),
    'joints that break away': ('rk4', [18, 40, 9], {}, [25, 60, 15], 4, [0, -0.3, 1.3], 4e-12),
    'strong damping': (
        'imex2',
        [6, 8, 3],
        {'damping': [50, 800, 100]},
        [60, 120, 40],
        2,
        [0, 0.2, 0.3],
        5e-7,
    ),
}


@pytest.mark.parametrize('name', MOTIONS)
def test_events_keep_the_accuracy_of_the_integrator(name: str) -> None:
    integrator, friction, fields, torques, seed, q, largest = MOTIONS[name]
    robot = pfd.load_robot('puma560', locked={f'joint{k}': 0.3 for k in (4, 5, 6)})
    scene = pfd.Scene(armature=ROTORS, friction=friction, **fields)
    signs = np.array([[1], [-1], [1], [-1]]) * np.array([1, -1, 1])
    taus = np.random.default_rng(seed).uniform(0.4, 1, (4, 3)) * torques * signs
    run = simulated(
        robot, scene, q, [0.5, -0.5, 1.0], np.repeat(taus, 250, axis=0), integrator=integrator
    )
    state, events = (np.array(q, float), np.array([0.5, -0.5, 1.0])), 0
    for tau in taus:
        motion = pfd.integrate(
            robot, tau, 0.25, scene=scene, q=state[0], qd=state[1], rtol=1e-12, atol=1e-14
        )
        state, events = (motion.q[-1], motion.qd[-1]), events + len(motion.events)
    assert events > 0
    assert np.abs(run.q[-1] - state[0]).max() < largest


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
REST = [(3, ()), (3, (0, 2)), *(pytest.param(n, (), marks=pytest.mark.slow) for n in (1, 2, 7))]


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


def test_a_restitution_gives_back_no_more_energy_than_the_compression_took() -> None:
    # H = ((5, 2), (2, 1)) when stretched: the compression of qd = (-1, 0) takes the energy 5 by
    # the impulses (5, 2). The first one alone would give 25, of which sqrt(5/25) is left; joint 2
    # is thrown into its stop, which takes what it has.
    scene = pfd.Scene(gravity=None, joint_limits=[[0.0, 9.0]] * 2, restitution=[1.0, 0.0])
    arms = instant(two_links(), scene, np.zeros((1, 2)), np.array([[-1.0, 0.0]]), np.zeros((1, 2)))
    np.testing.assert_allclose(arms.qd[0], [sqrt(1 / 5), 0.0], rtol=ENERGY, atol=0)


def test_an_arm_under_a_steady_or_shaking_torque_below_its_friction_does_not_creep() -> None:
    robot = pfd.load_robot('ur5')
    q = np.array([0.3, -0.8, 1.1, 0.4, -0.6, 0.2])
    needed = pfd.inverse_dynamics(robot, q, 0 * q, 0 * q)
    friction = np.maximum(np.abs(needed), 0.1)
    sim = pfd.Simulator(robot, pfd.Scene(friction=friction))
    shaken = 0.8 + 0.15 * np.sin(10 * np.pi * 1e-3 * np.arange(10_000))
    for share in (np.full(10_000, 0.95), shaken):
        sim.reset(q)
        run = sim.rollout(needed * (1 - share[:, np.newaxis]))
        assert (run.q == q).all()
        assert (run.qd == 0.0).all()
        assert (run.qdd == 0.0).all()


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


SHORT_STEP = 1e-4
DURATION = 0.05
# Errors of velocities after DURATION, of motions that are not chaotic [rad/s or m/s].
VELOCITY = 1e-6
# A motion is chaotic, for this, if an error in the initial state grows by more than this factor.
CHAOTIC = 300.0
NUDGE = 1e-8
# Truncation of RK4 in a step, over the energy of the arm.
GAIN = 1e-9
# A joint is found at its stop to the error of the cubic in a step [rad or m].
BEYOND = 1e-9

# Scenes of the measured orders: two to four joints, four to eight impacts and reversals, no joint
# that breaks away within a step.
ORDER_SEEDS = (1, 9, 14)
# Errors from 4 ms to 1 ms; the last events before an end are at other places of the steps, which
# moves the order of a single scene by half.
ORDER_STEPS = (4e-3, 2e-3, 1e-3)
ORDER_DURATION = 0.048
ORDER_SCATTER = 0.5


def energies(case: Case, run: pfd.Trajectory, q: Array, v: Array) -> Array:
    """Return kinetic and potential energy, less the work of the torques, at all steps."""
    oracle = Oracle(case.robot, case.armature)
    found = []
    for x, w in zip([q, *run.q], [v, *run.qd], strict=True):
        potential = pin.computePotentialEnergy(oracle.model, oracle.data, x)
        found.append(w @ oracle.H(x) @ w / 2 + potential - case.tau @ x)
    return np.array(found)


def compared(rng: np.random.Generator, starts: int) -> tuple[list[float], int]:
    """Return errors of the motions of one scene from some states, and how many are ambiguous."""
    case, scene = random_case(rng)
    lower, upper = case.limits.T
    sim = pfd.Simulator(case.robot, scene, step_size=SHORT_STEP, substeps=1)
    steps, errors, unclear = round(DURATION / SHORT_STEP), [], 0
    for _ in range(starts):
        q, v = random_start(rng, case)
        sim.reset(q, v)
        run = sim.rollout(np.tile(case.tau, (steps, 1)))
        assert run.status == 'ok'
        assert (run.q >= lower - BEYOND).all()
        assert (run.q <= upper + BEYOND).all()
        energy = energies(case, run, q, v)
        assert np.diff(energy).max() <= GAIN * np.abs(energy).max()
        nudge = NUDGE * rng.uniform(-1, 1, (2, len(q)))
        try:
            ends, ambiguous = [], False
            for first, speed in ((q, v), (np.clip(q + nudge[0], lower, upper), v + nudge[1])):
                motion = Motion(case, first, speed)
                motion.advance(DURATION)
                ends.append(np.concatenate([motion.q, motion.v]))
                ambiguous |= motion.ambiguous
        except TooManyEventsError:
            continue
        if np.abs(ends[1] - ends[0]).max() > CHAOTIC * NUDGE:
            continue
        unclear += ambiguous
        if not ambiguous:
            errors.append(float(np.abs(run.qd[-1] - ends[0][len(q) :]).max()))
    return errors, unclear


@pytest.mark.long
@pytest.mark.parametrize('seed', ORDER_SEEDS)
def test_integrators_keep_their_order_through_the_events_of_random_scenes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    case, scene = random_case(rng)
    q, v = random_start(rng, case)
    damping = rng.uniform(0.5, 3.0, case.robot.n)
    case, scene = replace(case, damping=damping), replace(scene, damping=damping)
    motion = Motion(case, q, v)
    motion.advance(ORDER_DURATION)
    assert len(motion.events) > 3
    wanted = np.concatenate([motion.q, motion.v])
    for integrator, order in (('rk4', 4), ('velocity_verlet', 2), ('imex2', 2)):
        errors = []
        for step in ORDER_STEPS:
            sim = pfd.Simulator(
                case.robot, scene, step_size=step, substeps=1, integrator=integrator
            )
            sim.reset(q, v)
            run = sim.rollout(np.tile(case.tau, (round(ORDER_DURATION / step), 1)))
            errors.append(np.abs(np.concatenate([run.q[-1], run.qd[-1]]) - wanted).max())
        found = np.log(errors[0] / errors[-1]) / np.log(ORDER_STEPS[0] / ORDER_STEPS[-1])
        assert found > order - ORDER_SCATTER


@pytest.mark.parametrize(
    ('seeds', 'starts'),
    [
        ([0], 3),
        *(pytest.param([seed], 20, marks=pytest.mark.long) for seed in range(100, 150)),
    ],
)
def test_random_scenes_move_as_an_event_driven_integration(seeds: list[int], starts: int) -> None:
    found = [compared(np.random.default_rng(seed), starts) for seed in seeds]
    errors = [x for each, _ in found for x in each]
    motions = starts * len(found)
    assert sum(unclear for _, unclear in found) < motions / 2
    assert starts != 3 or len(errors) > motions / 2
    assert max(errors, default=0.0) < VELOCITY


def ranged(*ranges: tuple[float, float]) -> pfd.Robot:
    """Return joints `j0`, `j1` ... with ranges, in a row."""
    names = [f'l{k}' for k in range(len(ranges))]
    limits = ' velocity="3" effort="80"'
    return pfd.load_robot(
        urdf(
            'ranged',
            link('base'),
            *(link(name, 1.0, '0 0 -0.5', J=BODY) for name in names),
            *(
                joint(
                    *(f'j{k}', 'revolute', ['base', *names][k], name),
                    extra=f'<limit lower="{low}" upper="{high}"{limits}/>',
                )
                for k, (name, (low, high)) in enumerate(zip(names, ranges, strict=True))
            ),
        )
    )


# 0 is inside, below, above, at an end, and outside an end without another one.
RANGES = (-0.3, 0.1), (0.1, 4.9), (-3.0, -1.0), (0.0, 1.0), (0.25, np.inf), (-np.inf, -2.0)
INSIDE = [0.0, 0.1 + (4.9 - 0.1) / 2, -2.0, 0.0, 0.25, -2.0]
STOPS = pfd.Scene(joint_limits='model', gravity=None)


def test_an_arm_starts_at_zero_or_in_the_middle_of_ranges_that_exclude_it() -> None:
    np.testing.assert_array_equal(pfd.start_positions(ranged(*RANGES)), INSIDE)
    robot, inside = ranged(*RANGES[:2]), INSIDE[:2]
    for arm in (pfd.Simulator(robot, STOPS), pfd.Ensemble(robot, 3, STOPS)):
        for _ in range(2):
            np.testing.assert_array_equal(arm.q, np.broadcast_to(inside, arm.q.shape))
            arm.reset([0.05, 1.4])
            arm.reset()
    run = pfd.integrate(robot, np.zeros(robot.n), 0.01, scene=STOPS)
    np.testing.assert_array_equal(run.q[0], inside)
    assert not pfd.Simulator(robot).q.any()  # without stops


@pytest.mark.parametrize('name', pfd.known_robots())
def test_an_included_arm_starts_inside_its_stops_and_is_at_none(name: str) -> None:
    robot = pfd.load_robot(name)
    start = pfd.start_positions(robot)
    assert np.all((robot.position_lower < start) & (start < robot.position_upper))


@pytest.mark.parametrize('beyond', [-0.5, 5.0])
def test_a_state_outside_the_stops_is_said_with_a_position_that_lies_inside(beyond: float) -> None:
    robot = ranged(*RANGES[:2])
    named = rf"'j1'.* at {beyond:g}, its stops at 0.1 and 4.9: set it to 2.5"
    sim = pfd.Simulator(robot, STOPS)
    with pytest.warns(pfd.PhysicsWarning, match=named):
        sim.reset([0.0, beyond])
    assert sim.q.tolist() == [0.0, beyond]
    with pytest.warns(pfd.PhysicsWarning, match=named):
        pfd.integrate(robot, [0.0, 0.0], 0.001, scene=STOPS, q=[0.0, beyond])
    arms = pfd.Ensemble(robot, 4, STOPS)
    states = np.tile(INSIDE[:2], (4, 1))
    states[2:, 1] = beyond
    with pytest.warns(pfd.PhysicsWarning, match=r'arm 2 \(2 of 4 arms\) is at'):
        arms.reset(states)
    pfd.Simulator(robot).reset([0.0, beyond])  # without stops


def test_a_state_at_a_stop_in_either_format_is_not_outside_it() -> None:
    robot = ranged(*RANGES[:2])
    for dtype in ('float32', 'float64'):
        sim = pfd.Simulator(robot, STOPS, dtype=dtype)
        for q in (robot.position_lower, robot.position_upper):
            sim.reset(q)
            sim.step([0.0, 0.0])
            sim.reset(sim.q)
