# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Dry friction and joint stops: closed forms, located events, many impacts in a step."""

from __future__ import annotations

from functools import partial
from math import log, sqrt

import numpy as np
import pytest
from sampling import one_fast
from scipy.integrate import solve_ivp
from zoo import Array, joint, link, slider, urdf

import pfd_core as pfd

STEP = 1e-3
POINT = '0 0 0 0 0 0'
# Errors of RK4 at 1 ms with events located on its cubic output.
SLIDING = 1e-14  # constant deceleration, of which the output is exact
DAMPED = 2e-13
IMPLICIT = 4e-7  # imex2, of second order
REVERSING = 1e-10
BREAKING_AWAY = 1e-6  # caused by the motion of another joint, it waits for the end of a step
RESTING = 3e-9
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


def rotor(inertia: float) -> pfd.Robot:
    """Return a single joint with a vertical axis."""
    J = f'{inertia} {inertia} {inertia} 0 0 0'
    return pfd.load_robot(
        urdf(
            'rotor',
            link('base'),
            link('wheel', 1.0, J=J),
            joint('j', 'continuous', 'base', 'wheel'),
        )
    )


def test_a_sliding_rotor_stops_where_coulomb_friction_stops_it() -> None:
    run = simulated(rotor(0.5), pfd.Scene(friction=[2.0]), [0.0], [1.0], np.zeros((400, 1)))
    assert abs(run.q[-1, 0] - 0.125) < SLIDING
    stopped = run.time > 0.25
    assert (run.qd[stopped] == 0.0).all()
    assert (run.q[stopped] == run.q[-1]).all()


def test_a_rotor_with_damping_and_friction_stops_at_the_closed_form() -> None:
    inertia, d, friction, v = 0.5, 3.0, 2.0, 5.0
    scene = pfd.Scene(friction=[friction], damping=[d])
    time = inertia / d * log(1 + d * v / friction)
    angle = inertia / d * (v - friction / d * log(1 + d * v / friction))
    errors = []
    for parts in (1, 2):
        taus = np.zeros((400 * parts, 1))
        run = simulated(rotor(inertia), scene, [0.0], [v], taus, step_size=STEP / parts)
        errors.append(abs(run.q[-1, 0] - angle))
        assert run.time[np.flatnonzero(run.qd == 0.0)[0]] - time < STEP / parts
    # The event adds nothing to the error of rk4, of fourth order.
    assert errors[1] < DAMPED
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.1)


def test_the_implicit_damping_stops_a_rotor_with_friction_at_the_closed_form() -> None:
    inertia, d, friction, v = 0.5, 3.0, 2.0, 5.0
    scene = pfd.Scene(friction=[friction], damping=[d])
    angle = inertia / d * (v - friction / d * log(1 + d * v / friction))
    errors = []
    for substeps in (1, 4):
        settings = {'integrator': 'imex2', 'substeps': substeps}
        run = simulated(rotor(inertia), scene, [0.0], [v], np.zeros((400, 1)), **settings)
        assert run.qd[-1, 0] == 0.0
        errors.append(abs(run.q[-1, 0] - angle))
    assert errors[0] < IMPLICIT
    assert errors[1] < errors[0] / 4**1.8


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


def test_a_dropped_mass_comes_to_rest_within_one_step_of_the_last_bounce() -> None:
    e = 0.5
    scene = pfd.Scene(joint_limits=[[0.0, 100.0]], restitution=[e])
    run = simulated(slider(0, 1), scene, [1.0], [0.0], np.zeros((1500, 1)))
    rest = sqrt(2 / 9.81) * (1 + e) / (1 - e)
    first = np.flatnonzero(run.qd[:, 0] == 0.0)[0]
    assert 0 <= run.time[first] - rest < STEP
    assert abs(run.q[-1, 0]) < RESTING
    assert (run.q >= 0.0).all()
    assert (run.qd[first:] == 0.0).all()


def test_a_mass_that_bounces_without_loss_keeps_its_energy() -> None:
    scene = pfd.Scene(joint_limits=[[0.0, 100.0]], restitution=[1.0])
    run = simulated(slider(0, 1), scene, [1.0], [0.0], np.zeros((1500, 1)))
    energy = run.qd**2 / 2 + 9.81 * run.q
    assert np.abs(energy / 9.81 - 1).max() < ROUNDING_OF_1500_STEPS
    assert (run.q >= 0.0).all()


# Motions of the two-link arm with all events located, extrapolated in 80-bit arithmetic.
def test_two_links_under_friction_reverse_as_the_reference() -> None:
    scene = pfd.Scene(gravity=None, friction=[1.0, 0.3])
    run = simulated(two_links(), scene, [0.0, 0.5], [0.0, 4.0], np.zeros((2000, 2)))
    assert np.abs(run.q[-1] - [3.5322760195, -0.5835954232]).max() < REVERSING
    assert np.abs(run.qd[-1] - [0.6570523694, 1.3314731382]).max() < REVERSING


def test_two_links_break_away_and_stick_as_the_reference() -> None:
    scene = pfd.Scene(gravity=None, friction=[0.5, 2.0])
    taus = np.zeros((2500, 2))
    taus[:1600, 0] = 4.0
    run = simulated(two_links(), scene, [0.0, 0.8], [0.0, 0.0], taus)
    assert np.abs(run.q[-1] - [2.1214967672, 0.7507616090]).max() < BREAKING_AWAY
    assert abs(run.qd[-1, 0] - 1.1541032554) < BREAKING_AWAY
    assert run.qd[-1, 1] == 0.0
    slips = run.time[np.flatnonzero(run.qd[:, 1])[0]]
    assert 0 <= slips - 1.1933354141 < 2 * STEP


def test_two_links_hit_their_stops_as_the_reference() -> None:
    scene = pfd.Scene(
        gravity=(0, -9.81, 0),
        friction=[0.5, 0.2],
        joint_limits=[[-1.2, 1.2], [-0.8, 0.8]],
        restitution=[0.5, 0.5],
    )
    start = [0.0, 0.5], [1.0, 0.0]
    coarse = simulated(two_links(), scene, *start, np.zeros((500, 2)), step_size=2 * STEP)
    run = simulated(two_links(), scene, *start, np.zeros((2000, 2)), step_size=STEP / 2)
    errors = [np.abs(x.qd[-1] - [2.2212637060, -7.8403890917]).max() for x in (coarse, run)]
    assert np.abs(run.q[-1] - [-1.1969429056, -0.7909938927]).max() < REVERSING
    assert errors[1] < REVERSING
    # Six impacts and reversals leave rk4 its order; the reference has ten digits.
    assert errors[0] < 4**4 * (errors[1] + 0.5e-10)


def test_friction_that_falls_with_the_speed_stops_a_rotor_at_the_closed_form() -> None:
    """I v' = -Fc - (Fs - Fc)/(1 + (v/vs)^2): time to rest by partial fractions."""
    inertia, sliding, static, vs, v = 0.5, 2.0, 3.0, 0.1, 1.0
    scene = pfd.Scene(friction=[sliding], static_friction=[static], stribeck_velocity=[vs])
    run = simulated(rotor(inertia), scene, [0.0], [v], np.zeros((400, 1)))
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


def test_a_damped_bounce_falls_by_the_square_of_the_restitution() -> None:
    e, height = 0.8, 1.0
    scene = pfd.Scene(joint_limits=[[0.0, 100.0]], restitution=[e])
    run = simulated(slider(0, 1), scene, [height], [0.0], np.zeros((1200, 1)))
    fall = sqrt(2 * height / 9.81)
    at_top = np.searchsorted(run.time, fall + e * fall)
    assert abs(run.q[at_top, 0] - height * e**2) < 9.81 * STEP**2


def test_cached_code_of_one_scene_with_friction_is_not_used_for_another() -> None:
    # All have the same dynamics of held joints, from which their code takes its name.
    robot, ends = rotor(1.0), []
    for effects in ({}, {'effort_limits': [2.0]}, {'effort_limits': [4.0]}):
        for kind in (pfd.Simulator, partial(pfd.Ensemble, size=1)):
            sim = kind(robot, scene=pfd.Scene(gravity=None, friction=[1.0], **effects))
            sim.rollout(np.full((1000, 1), 11.0))
            ends.append(sim.qd.item())
    # The wheel turns by the motor's torque less its friction for a second.
    wanted = [10.0, 10.0, 1.0, 1.0, 3.0, 3.0]
    np.testing.assert_allclose(ends, wanted, rtol=0, atol=ROUNDING_OF_1500_STEPS)


# ---- many impacts, bounces that end, joints at rest ------------------------------------------


G = 9.81
# Roundings of some hundred operations, in motions of order ten.
ROUNDING = 1e-12
# Events are found on the cubic output of RK4, and the reference joins motions by hand.
CASE = 1e-9


def shaped(q2: float) -> Array:
    """Return H of two links of 1 m with 1 kg at their ends."""
    c = np.cos(q2)
    return np.array([[3 + 2 * c, 1 + c], [1 + c, 1.0]])


def after_the_throw(duration: float) -> Array:
    """
    Return q and qd after joint 2 has hit its stop at 1 rad and thrown joint 1 off its own at 0.

    Joint 1 rests while joint 2 comes with -10 rad/s from 1.015 rad, under a friction of 0.1. The
    stop of joint 2 returns half the impulse that it needs to stop the joint, where joint 1 moves
    freely. Then both move under friction and a torque of 5 on joint 1.
    """
    tau, friction, restitution, way = np.array([5.0, 0.0]), 0.1, 0.5, 0.015
    # v2' = +0.1 on the way to the stop, in which joint 1 does not move.
    speed = sqrt(100 - 2 * friction * way)
    contact_time = (10 - speed) / friction
    H = shaped(1.0)
    inverse = np.linalg.inv(H)
    impulse = speed / inverse[1, 1]
    velocity = np.array([0.0, -speed]) + (1 + restitution) * impulse * inverse[:, 1]

    def rate(_: float, state: Array) -> Array:
        q, v = state[:2], state[2:]
        s = np.sin(q[1])
        bias = np.array([-s * (2 * v[0] * v[1] + v[1] ** 2), s * v[0] ** 2])
        return np.concatenate(
            [v, np.linalg.solve(shaped(q[1]), tau - bias - friction * np.sign(v))]
        )

    start = np.array([0.0, 1.0, *velocity])
    tight = {'method': 'DOP853', 'rtol': 1e-13, 'atol': 1e-14}
    end: Array = solve_ivp(rate, (0, duration - contact_time), start, **tight).y[:, -1]
    return end


@pytest.mark.parametrize('step', one_fast([2e-3, 1e-3, 1e-4], 1e-3))
def test_the_impact_of_one_joint_throws_another_off_the_stop_on_which_it_came_to_rest(
    step: float,
) -> None:
    scene = pfd.Scene(
        gravity=None,
        friction=[0.1, 0.1],
        restitution=0.5,
        joint_limits=[[-9.0, 0.0], [1.0, 9.0]],
    )
    taus = np.tile([5.0, 0.0], (round(2e-3 / step), 1))
    # Joint 1 falls onto its stop from 1e-12 rad, and stays there.
    run = simulated(two_links(), scene, [-1e-12, 1.015], [0.0, -10.0], taus, step_size=step)
    wanted = after_the_throw(2e-3)
    assert run.status == 'ok'
    assert np.abs(run.qd[-1] - [-5.656, 4.977]).max() < 1e-3  # as rounded in the report of it
    assert np.abs(np.concatenate([run.q[-1], run.qd[-1]]) - wanted).max() < CASE


def test_hits_without_loss_a_tenth_of_a_microsecond_apart_keep_the_energy() -> None:
    scene = pfd.Scene(gravity=None, joint_limits=[[0.0, 1e-6]], restitution=[1.0])
    run = simulated(slider(1, 0), scene, [0.0], [10.0], np.zeros((10, 1)), step_size=1e-4)
    assert np.abs(np.abs(run.qd) - 10.0).max() < ROUNDING


def test_hits_of_two_joints_without_loss_keep_the_energy() -> None:
    scene = pfd.Scene(gravity=None, joint_limits=[[-9, 0], [1, 9]], restitution=1.0)
    q, v = np.array([-5e-6, 1 + 1.1e-5]), np.array([5.0, -10.0])
    for step in (2e-3, 1e-4):
        # Joint 1 hits after 1 us, joint 2 after 1.1 us, and each again.
        run = simulated(
            two_links(), scene, q, v, np.zeros((round(2e-3 / step), 2)), step_size=step
        )
        end = run.qd[-1] @ shaped(run.q[-1, 1]) @ run.qd[-1]
        assert end == pytest.approx(v @ shaped(q[1]) @ v, rel=CASE)


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


@pytest.mark.parametrize('integrator', ['rk4', 'velocity_verlet', 'imex2'])
def test_a_damped_mass_comes_to_rest_on_its_stop(integrator: str) -> None:
    scene = pfd.Scene(
        joint_limits=[[0.1, 100.0]], restitution=[0.9], damping=[30.0], friction=[0.5]
    )
    settings = {'integrator': integrator}
    run = simulated(slider(0, 1), scene, [0.3], [-3.0], np.zeros((2000, 1)), **settings)
    assert run.status == 'ok'
    assert run.q[-1, 0] == 0.1
    assert run.qd[-1, 0] == 0.0


def test_a_mass_that_dips_beyond_its_stop_within_a_step_hits_it() -> None:
    """Against a force of 1000 N it would turn 25 um beyond the stop after half a step."""
    force, way, speed = 1000.0, 1e-4, 0.5
    scene = pfd.Scene(gravity=None, joint_limits=[[0.0, 1.0]], restitution=[1.0])
    run = simulated(slider(1, 0), scene, [way], [-speed], np.full((1, 1), force))
    hit = sqrt(speed**2 - 2 * force * way)
    left = STEP - (speed - hit) / force
    assert run.q[0, 0] == pytest.approx(hit * left + force * left**2 / 2, rel=CASE)
    assert run.qd[0, 0] == pytest.approx(hit + force * left, rel=CASE)


def test_a_step_of_too_many_impacts_ends_in_a_status() -> None:
    """A gap of 100 nm at 10 m/s: 100 000 hits in a step."""
    scene = pfd.Scene(gravity=None, joint_limits=[[0.0, 1e-7]], restitution=[1.0])
    arm = pfd.Simulator(slider(1, 0), scene, step_size=STEP, substeps=1)
    arm.reset([5e-8], [10.0])
    run = arm.rollout(np.zeros((3, 1)))
    assert (run.status, run.finite_steps, arm.status) == ('too_many_events', 0, 'too_many_events')
    arm.reset([5e-8], [1e-3])
    assert arm.status == 'ok'
    assert arm.rollout(np.zeros((3, 1))).status == 'ok'
    arms = pfd.Ensemble(slider(1, 0), 3, scene, step_size=STEP, substeps=1)
    arms.reset([5e-8], [[1e-3], [10.0], [2e-3]])
    runs = arms.rollout(steps=3)
    assert (runs.status, arms.status) == ('too_many_events', 'too_many_events')
    assert runs.finite_steps.tolist() == [3, 0, 3]


def test_an_overflow_is_not_taken_for_too_many_impacts() -> None:
    # An acceleration that is no number: a mass of 0.5 kg under the largest force.
    scene = pfd.Scene(gravity=None, joint_limits=[[0.0, 1.0]])
    arm = pfd.Simulator(slider(1, 0, 0.5), scene)
    arm.reset([0.5], [0.0])
    assert arm.rollout(np.full((1, 1), np.finfo(float).max)).status == 'not_finite'


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


@pytest.mark.parametrize('friction', [[0.0], [1.0]])
def test_a_stop_holds_a_joint_with_static_friction(friction: list[float]) -> None:
    scene = pfd.Scene(
        gravity=None, friction=friction, static_friction=[3.0], joint_limits=[[-1.0, 0.05]]
    )
    run = simulated(slider(1, 0), scene, [0.0], [0.0], np.full((400, 1), 4.0))
    assert (run.q <= 0.05).all()
    assert run.q[-1, 0] == 0.05
    assert run.qd[-1, 0] == 0.0


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
