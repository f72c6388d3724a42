# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Adaptive steps: tolerances kept, events of friction and stops, interrupts, the same bits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

import bridge
from bridge import TARGET_LEVELS, host_target, missing_features
from contact_oracle import Motion
import numpy as np
from numpy.polynomial import Polynomial
import pinocchio as pin
import pytest
from sampling import one_fast
from scipy.optimize import brentq
from test_simulation_contact_random import random_case, random_start
import yaml
from zoo import Array, random_chain, slider, to_pinocchio

from benchmarks.cases.problems import rods
import pfd_core as pfd

# The true error of a motion in units of the tolerance. Seen 3.6.
KEPT = 10.0
TOLERANCES = [10.0**-k for k in range(3, 14)]
# Motions with ends in extended precision.
MOTIONS: dict[str, Any] = yaml.safe_load(
    (Path(__file__).parent / 'data' / 'motions.yaml').read_text(encoding='utf-8')
)
GRAVITY = 9.81
# Events at closed forms: roundings of a state of order one, summed over some events.
EXACT = 1e-13
PATIENCE = 120  # [s] in which Python starts and code is compiled, however busy the machine


def units(found: Array, wanted: Array, tolerance: float) -> float:
    """Return an error in units of a tolerance, as `integrate` defines it with atol = rtol."""
    scale = tolerance * (1 + np.abs(wanted))
    return float(np.sqrt((((found - wanted) / scale) ** 2).mean()))


def moved(name: str, **settings: Any) -> pfd.AdaptiveTrajectory:
    """Return a motion of MOTIONS by `integrate`."""
    row = MOTIONS[name]
    if 'rods' in row:
        problem = rods(*row['rods'])
        robot = problem.plant.robot
        start: dict[str, Any] = {key: problem.states[key][0] for key in ('q', 'qd')}
    else:
        robot = bridge.report_robot(row['arm'])
        start = {key: np.zeros(robot.n) + row[key] for key in ('q', 'qd')}
    numbers = row.get('scene', {}).items()
    scene = pfd.Scene(**{k: x if x == 'model' else np.full(robot.n, x) for k, x in numbers})
    torques = np.zeros(robot.n)
    return pfd.integrate(robot, torques, row['duration'], scene=scene, **start, **settings)


@pytest.mark.parametrize('name', one_fast(MOTIONS))
def test_the_true_error_of_a_smooth_motion_is_within_ten_tolerances(name: str) -> None:
    for rtol in TOLERANCES:
        run = moved(name, rtol=rtol, atol=rtol, refine=1)
        assert run.status == 'ok'
        assert units(run.q[-1], np.array(MOTIONS[name]['end']), rtol) < KEPT, rtol


@pytest.mark.slow
def test_refined_an_adaptive_run_takes_the_steps_of_the_motion_and_else_gives_up() -> None:
    settings: Any = {'rtol': 1e-12, 'atol': 1e-13, 'max_steps': 2000, 'dense': False}
    none, one, two = (
        moved('heavy_tip_1e8_planar_n12', refine=refine, **settings) for refine in range(3)
    )
    assert none.status != 'ok'
    assert one.status == two.status == 'ok'
    assert one.evaluations <= 1.05 * two.evaluations


def closed_form_of_a_wheel(t: Array) -> Array:
    """Return the angle of a wheel of inertia 2, damping 0.5 under 3 N m less 1 N m of friction."""
    inertia, damping, torque = 2.0, 0.5, 3.0 - 1.0
    return torque / damping * (t + inertia / damping * np.expm1(-damping / inertia * t))


def wheel() -> pfd.Robot:
    return pfd.load_robot(
        '<robot name="wheel"><link name="base"/><link name="rim"><inertial><mass value="1"/>'
        '<inertia ixx="2" iyy="2" izz="2" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="hub" type="continuous"><parent link="base"/><child link="rim"/>'
        '<axis xyz="0 0 1"/></joint></robot>'
    )


@pytest.mark.parametrize('rtol', one_fast(TOLERANCES, TOLERANCES[6]))
def test_a_constant_torque_moves_a_damped_wheel_with_friction_as_its_closed_form_says(
    rtol: float,
) -> None:
    scene = pfd.Scene(damping=[0.5], friction=[1.0])
    run = pfd.integrate(wheel(), [3.0], 3.0, scene=scene, rtol=rtol, atol=rtol)
    times = np.linspace(0, 3, 100)
    for found in (run, run.at(times)):
        for k, t in enumerate(found.time):
            assert units(found.q[k], closed_form_of_a_wheel(np.array([t])), rtol) < KEPT
    assert run.events.size == 0


@pytest.mark.parametrize('seed', [0, 1, 4, 6])
@pytest.mark.slow
def test_the_true_error_through_friction_and_stops_is_within_ten_tolerances(seed: int) -> None:
    # The other integration keeps to 1e-13 in a step; its motions are not chaotic.
    rng = np.random.default_rng(seed)
    case, scene = random_case(rng)
    q, qd = random_start(rng, case)
    other = Motion(case, q, qd)
    other.advance(0.05)
    wanted = np.concatenate([other.q, other.v])
    assert other.events
    assert not other.ambiguous
    for rtol in TOLERANCES:
        run = pfd.integrate(
            case.robot, case.tau, 0.05, scene=scene, q=q, qd=qd, rtol=rtol, atol=rtol
        )
        assert run.status == 'ok'
        assert units(np.concatenate([run.q[-1], run.qd[-1]]), wanted, rtol) < KEPT, rtol


@pytest.mark.parametrize('rtol', one_fast([1e-3, 1e-9, 1e-13], 1e-9))
def test_a_ball_bounces_at_the_times_of_its_closed_form(rtol: float) -> None:
    restitution, height = 0.8, 1.0
    hit = np.sqrt(2 * height / GRAVITY)
    hits, speed = [hit], GRAVITY * hit
    while hits[-1] < 2.0:
        speed *= restitution
        hits.append(hits[-1] + 2 * speed / GRAVITY)
    hits.pop()
    scene = pfd.Scene(joint_limits=[[0.0, np.inf]], restitution=[restitution])
    run = pfd.integrate(slider(0, 1), [0.0], 2.0, scene=scene, q=[height], rtol=rtol)
    assert run.status == 'ok'
    np.testing.assert_allclose(run.events, hits, rtol=0, atol=EXACT)
    at_hits = np.isin(run.time, run.events)
    np.testing.assert_array_equal(run.q[at_hits], 0.0)
    np.testing.assert_allclose(
        run.qd[at_hits, 0], GRAVITY * hit * restitution ** np.arange(1, len(hits) + 1), atol=1e-12
    )
    # Between two hits a parabola, to the end of the step that the hit cuts.
    middle = (hits[0] + hits[1]) / 2
    top = run.at([middle])
    np.testing.assert_allclose(top.qd, 0.0, atol=1e-12)
    np.testing.assert_allclose(top.q, (GRAVITY * hit * restitution) ** 2 / 2 / GRAVITY, atol=1e-12)


def test_a_ball_comes_to_rest_after_all_of_its_bounces_and_stays() -> None:
    restitution = 0.5
    scene = pfd.Scene(joint_limits=[[0.0, np.inf]], restitution=[restitution])
    run = pfd.integrate(slider(0, 1), [0.0], 5.0, scene=scene, q=[1.0])
    assert run.status == 'ok'
    assert run.q[-1] == run.qd[-1] == run.qdd[-1] == 0
    wanted = np.sqrt(2 / GRAVITY) * (1 + 2 * restitution / (1 - restitution))
    # The bounces that are left out are lower than 1e-12 m.
    assert run.events[-1] == pytest.approx(wanted, abs=1e-5)


@pytest.mark.parametrize('duration', [1e2, 1e4, 1e7])
def test_a_ball_bounces_in_a_long_run_as_in_a_short_one(duration: float) -> None:
    restitution, speed = 0.9, 1.0
    wanted = [1.0]
    while (restitution * speed) ** 2 / 2 > 1e-12:  # the height of the next bounce [m]
        speed *= restitution
        wanted.append(wanted[-1] + 2 * speed)
    scene = pfd.Scene(gravity=None, joint_limits=[[0.0, np.inf]], restitution=[restitution])
    run = pfd.integrate(slider(1, 0), [-1.0], duration, scene=scene, q=[0.5])
    assert run.status == 'ok'
    np.testing.assert_allclose(run.events, wanted, rtol=0, atol=1e-12)
    assert run.q[-1] == run.qd[-1] == 0


@pytest.mark.parametrize('rtol', one_fast([1e-3, 1e-9, 1e-13], 1e-9))
def test_a_sliding_block_stops_by_coulomb_friction_and_stays(rtol: float) -> None:
    mass, friction, speed = 2.0, 3.0, 1.5
    block = slider(1, 0, mass)
    run = pfd.integrate(
        block, [0.0], 4.0, scene=pfd.Scene(friction=[friction]), qd=[speed], rtol=rtol
    )
    np.testing.assert_allclose(run.events, [speed * mass / friction], rtol=0, atol=EXACT)
    assert run.q[-1, 0] == pytest.approx(speed**2 * mass / friction / 2, abs=EXACT)
    assert run.qd[-1] == run.qdd[-1] == 0


def test_a_block_breaks_away_when_the_torque_of_a_law_exceeds_its_friction() -> None:
    # 2 t exceeds 3 at 1.5 s; from there x = (t - 1.5)^3 / 6 of a mass of 2 kg.
    law: Callable[..., Array] = lambda t, q, qd: np.array([2 * t])  # noqa: E731
    run = pfd.integrate(slider(1, 0, 2.0), law, 3.0, scene=pfd.Scene(friction=[3.0]))
    np.testing.assert_allclose(run.events, [1.5], rtol=0, atol=1e-10)
    assert run.q[-1, 0] == pytest.approx(1.5**3 / 6, abs=1e-11)


@pytest.mark.parametrize('after', [0.5 + 1e-7, 1.0, 100.0])
@pytest.mark.parametrize('jump', [1e-3, 1 / 3, 1.9])
def test_a_block_breaks_away_when_the_torque_of_a_law_jumps_above_its_friction(
    jump: float, after: float
) -> None:
    law: Callable[..., Array] = lambda t, q, qd: np.array([after if t >= jump else 0.1])  # noqa: E731
    run = pfd.integrate(
        slider(1, 0), law, 2.0, scene=pfd.Scene(gravity=None, friction=[0.5]), rtol=1e-13
    )
    np.testing.assert_allclose(run.events, [jump], rtol=0, atol=EXACT)
    assert run.qd[-1, 0] == pytest.approx((after - 0.5) * (2.0 - jump), rel=1e-12)


def test_the_centrifugal_torque_takes_a_joint_off_its_stop_when_it_exceeds_the_motor_s() -> None:
    # While the elbow is on its stop the arm is one body: w = a t, and the elbow needs the torque
    # of a and w^2.
    robot = pfd.load_robot('planar2')
    bent, torque = np.array([0.0, -2.0]), np.array([1.0, -2.0])
    model = to_pinocchio(robot)
    model.gravity.setZero()
    data = model.createData()
    a = torque[0] / pin.crba(model, data, bent)[0, 0]
    of_a = pin.rnea(model, data, bent, np.zeros(2), np.array([a, 0.0]))[1]
    of_w = pin.rnea(model, data, bent, np.array([1.0, 0.0]), np.zeros(2))[1]
    # lambda = of_a + w^2 of_w - torque is above zero on the lower stop.
    assert of_a > torque[1]
    assert of_w < 0
    release = np.sqrt((torque[1] - of_a) / of_w) / a
    scene = pfd.Scene(gravity=None, joint_limits=[[-np.inf, np.inf], [-2.0, np.inf]])
    for rtol in (1e-3, 1e-9, 1e-13):
        run = pfd.integrate(robot, torque, 1.2 * release, scene=scene, q=bent, rtol=rtol)
        assert run.status == 'ok'
        np.testing.assert_allclose(run.events, [release], rtol=1e-11)
        before = run.time < release * (1 - 1e-9)
        np.testing.assert_array_equal(run.q[before, 1], -2.0)
        assert run.q[-1, 1] > -2.0


def test_a_grazed_stop_is_found_between_two_looks_at_the_step() -> None:
    # Under a constant force the joint turns 1e-9 m beyond its stop, for 9e-5 s within 1 s.
    depth, speed = 1e-9, 1.0
    force = 2.0
    way = speed**2 / (2 * force) - depth
    scene = pfd.Scene(gravity=None, joint_limits=[[-way, np.inf]], restitution=[1.0])
    run = pfd.integrate(slider(1, 0), [force], 1.0, scene=scene, qd=[-speed])
    hit = (speed - np.sqrt(2 * force * depth)) / force
    np.testing.assert_allclose(run.events, [hit], rtol=0, atol=1e-11)
    assert run.q.min() >= -way


@pytest.mark.parametrize(('seed', 'stribeck'), one_fast([(8, False), (5, True)]))
def test_chains_of_impacts_end_and_pass_no_stop(seed: int, stribeck: bool) -> None:
    # The joints throw each other off their stops, with velocities that fall below 1e-9 rad/s. Seen
    # 300 and 2300 attempts.
    rng = np.random.default_rng(seed)
    case, scene = random_case(rng)
    n = case.robot.n
    if stribeck:
        static = case.friction * rng.uniform(1, 2, n)
        velocity = rng.uniform(0.1, 1, n)
        scene = replace(scene, static_friction=static, stribeck_velocity=velocity)
    q, qd = random_start(rng, case)
    run = pfd.integrate(case.robot, case.tau, 2.0, scene=scene, q=q, qd=qd, max_steps=5000)
    assert run.status == 'ok'
    assert (run.q >= case.limits[:, 0]).all()
    assert (run.q <= case.limits[:, 1]).all()


@pytest.mark.parametrize('beyond', [1e-9, 1e-3, 0.3])
@pytest.mark.parametrize(
    ('speed', 'force', 'wanted', 'events'),
    [
        # At rest, pushed further out: the stop holds the joint where it is.
        (0.0, -1.0, lambda q, t: q, 0),
        (0.0, 1.0, lambda q, t: q + t**2 / 2, 0),
        (0.5, 0.0, lambda q, t: q + 0.5 * t, 0),
        # Further out: an impact at the start.
        (-0.5, 0.0, lambda q, t: q + 0.25 * t, 0),
        # Back into the range, out again, and an impact at the stop.
        (2.0, -2.0, lambda q, t: bounced(q, t), 1),
    ],
)
def test_a_joint_that_starts_beyond_its_stop_may_return_and_goes_no_further(
    beyond: float, speed: float, force: float, wanted: Callable[..., float], events: int
) -> None:
    scene = pfd.Scene(gravity=None, joint_limits=[[0.0, 9.0]], restitution=[0.5])
    for rtol in (1e-3, 1e-9, 1e-13):
        run = pfd.integrate(
            slider(1, 0), [force], 2.5, scene=scene, q=[-beyond], qd=[speed], rtol=rtol
        )
        assert run.status == 'ok'
        assert run.q.min() == -beyond
        assert len(run.events) == events
        assert run.q[-1, 0] == pytest.approx(wanted(-beyond, 2.5), abs=1e-11)


@pytest.mark.parametrize('rtol', one_fast([1e-3, 1e-6, 1e-9, 1e-12], 1e-12))
def test_a_joint_that_turns_beyond_its_stop_is_held_where_it_turns(rtol: float) -> None:
    scene = pfd.Scene(gravity=None, joint_limits=[[0.0, 9.0]], restitution=[0.5])
    run = pfd.integrate(slider(1, 0), [-1.0], 0.5, scene=scene, q=[-0.1], qd=[0.1], rtol=rtol)
    assert run.q[-1, 0] == pytest.approx(-0.1 + 0.1**2 / 2, abs=EXACT)
    assert run.qd[-1] == 0


def bounced(q: float, t: float) -> float:
    """Return where a mass of 1 kg is after a bounce at 0, from q with 2 m/s under -2 N."""
    root = np.sqrt(1 + q)
    left = t - 1 - root
    return root * left - left**2


@pytest.mark.parametrize(('speed', 'force'), [(1.0, 1e2), (1e3, 1e8), (1e4, 1e6)])
def test_a_joint_that_enters_its_range_and_leaves_it_in_one_step_hits_its_stop(
    speed: float, force: float
) -> None:
    way = 1e-3 * speed**2 / force
    scene = pfd.Scene(gravity=None, joint_limits=[[0.0, np.inf]], restitution=[0.5])
    hit = (speed + np.sqrt(speed**2 - 2 * force * way)) / force
    for rtol in (0.5, 1e-3, 1e-9):
        run = pfd.integrate(
            slider(1, 0), [-force], 1.1 * hit, scene=scene, q=[-way], qd=[speed], rtol=rtol
        )
        np.testing.assert_allclose(run.events, [hit], rtol=1e-12)


@pytest.mark.parametrize('rtol', one_fast([1e-3, 1e-9, 1e-13], 1e-9))
@pytest.mark.parametrize('gap', [1e-12, 1e-9, 1e-3])
def test_a_joint_that_turns_in_front_of_its_stop_has_no_event(gap: float, rtol: float) -> None:
    speed, force = 1.0, 2.0
    scene = pfd.Scene(joint_limits=[[-(speed**2) / (2 * force) - gap, np.inf]], gravity=None)
    run = pfd.integrate(slider(1, 0), [force], 2.0, scene=scene, qd=[-speed], rtol=rtol)
    assert run.events.size == 0
    assert run.q[-1, 0] == pytest.approx(-2.0 * speed + force * 2.0, abs=1e-12)


@pytest.mark.parametrize('rtol', one_fast([1e-1, 1e-3, 1e-9, 1e-13], 1e-3))
def test_a_block_driven_to_and_fro_from_rest_is_released_at_each_turn(rtol: float) -> None:
    # Under the torque v' less friction F it does not rest, and a step may be as long as the run:
    # its velocity is v(t) -+ F t + c.
    v = Polynomial.fromroots([0.0, 1.0, 2.0, 3.0])
    friction, duration = 0.01, 3.5
    turns, sign, rest = [], -1.0, v + Polynomial([0.0, friction])
    for near in (1.0, 2.0, 3.0):
        turns.append(brentq(rest, near - 0.2, near + 0.2))
        rest += 2 * sign * friction * Polynomial([-turns[-1], 1.0])
        sign = -sign
    run = pfd.integrate(
        slider(1, 0),
        lambda t, q, qd: [v.deriv()(t)],
        duration,
        scene=pfd.Scene(gravity=None, friction=[friction]),
        rtol=rtol,
        atol=rtol,
    )
    assert run.status == 'ok'
    np.testing.assert_allclose(run.events, turns, rtol=0, atol=1e-12)
    assert run.qd[-1, 0] == pytest.approx(rest(duration), abs=1e-11)


def test_an_arm_that_friction_holds_takes_one_step() -> None:
    for scene in (
        pfd.Scene(friction=[50.0, 50.0]),
        pfd.Scene(friction=[50.0, 50.0], joint_limits=[[0.0, 1.0]] * 2),
    ):
        run = pfd.integrate(pfd.load_robot('planar2'), np.zeros(2), 1e4, scene=scene)
        assert (run.status, run.finite_steps, len(run.events)) == ('ok', 1, 0)
        np.testing.assert_array_equal(run.at([0.0, 5e3, 1e4]).q, 0.0)


def test_the_state_at_the_end_of_a_run_is_after_the_impact_that_ends_it() -> None:
    scene = pfd.Scene(gravity=None, joint_limits=[[0.0, np.inf]], restitution=[0.5])
    runs = [
        pfd.integrate(slider(1, 0), [-1.0], 3.0, scene=scene, q=[0.5], max_steps=steps)
        for steps in range(1, 12)
    ]
    assert sum(run.time[-1] in run.events for run in runs) > 3
    for run in runs:
        at = run.at(run.time)
        for name in ('q', 'qd', 'qdd'):
            np.testing.assert_array_equal(getattr(at, name), getattr(run, name))


def test_states_before_an_event_lead_to_it() -> None:
    scene = pfd.Scene(friction=[0.5, 0.2], joint_limits=[[-2, 2]] * 2, restitution=0.5)
    run = pfd.integrate(
        pfd.load_robot('planar2'), [1.0, 0.5], 4.0, scene=scene, qd=[3.0, -2.0], rtol=1e-10
    )
    assert run.events.size > 10
    just_before = run.at(run.events * (1 - 1e-12))
    at_events = np.isin(run.time, run.events)
    np.testing.assert_allclose(just_before.q, run.q[at_events], rtol=0, atol=1e-10)


def test_motors_brakes_and_wrench_act_in_a_scene_with_events_as_in_the_simulator() -> None:
    robot = random_chain(np.random.default_rng(8), 3)
    settings: dict[str, Any] = {
        'friction': [0.3, 0.3, 0.3],
        'static_friction': [0.5, 0.5, 0.5],
        'stribeck_velocity': [0.1, 0.1, 0.1],
        'joint_limits': [[-1, 1]] * 3,
        'restitution': 0.5,
        'effort_limits': [4.0] * 3,
        'gravity_compensation': True,
        'armature': [0.1] * 3,
        'external_wrench': True,
        'brakes': True,
    }
    scene = pfd.Scene(**settings)
    held = {'wrench': [1.0, 2.0, 3.0, 0.1, 0.2, 0.3], 'brakes': [False, True, False]}
    torque, duration = np.array([5.0, 0.0, -3.0]), 0.5
    run = pfd.integrate(robot, torque, duration, scene=scene, rtol=1e-11, **held)
    assert run.events.size
    sim = pfd.Simulator(robot, scene, step_size=1e-4, substeps=1, integrator='rk4')
    fixed = sim.rollout(np.tile(torque, (round(duration / 1e-4), 1)), **held)
    # The fixed steps let a joint that another one releases wait for the end of the step.
    np.testing.assert_allclose(run.q[-1], fixed.q[-1], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(run.q[:, 1], 0.0)


def test_a_motor_lag_is_refused() -> None:
    with pytest.raises(ValueError, match="'motor_lag' of the scene acts over a step of time"):
        pfd.integrate(
            pfd.load_robot('planar2'), [0, 0], 1.0, scene=pfd.Scene(motor_lag=[0.1, 0.1])
        )


@pytest.mark.slow
def test_a_motion_that_stability_cuts_into_too_many_steps_is_too_stiff() -> None:
    scene = pfd.Scene(damping=np.full(6, 100.0))
    run = pfd.integrate(
        pfd.load_robot('puma560'), np.zeros(6), 10.0, scene=scene, rtol=1e-6, max_steps=2000
    )
    assert run.status == 'too_stiff'
    assert run.stiff_steps > run.finite_steps / 2
    smooth = pfd.integrate(pfd.load_robot('puma560'), np.zeros(6), 10.0, max_steps=20)
    assert (smooth.status, smooth.stiff_steps) == ('too_many_steps', 0)


# ---- laws, interrupts, pieces, processors -----------------------------------------------------


def test_an_exception_of_a_law_ends_the_run_and_is_passed_on() -> None:
    calls = []

    def law(t: float, q: Array, qd: Array) -> Array:
        calls.append(t)
        if t > 0.5:
            raise ZeroDivisionError('as planned')
        return np.zeros(2)

    for scene in (None, pfd.Scene(friction=[0.1, 0.1], joint_limits=[[-1, 1]] * 2)):
        calls.clear()
        with pytest.raises(ZeroDivisionError, match='as planned'):
            pfd.integrate(pfd.load_robot('planar2'), law, 1.0, scene=scene)
        assert sum(t > 0.5 for t in calls) == 1


def test_a_torque_that_is_not_finite_is_a_status_where_friction_holds_the_joint_too() -> None:
    def law(t: float, q: Array, qd: Array) -> Array:
        return np.array([np.nan if t > 0.5 else 0.0, 0.0])

    scene = pfd.Scene(gravity=None, friction=[5.0, 0.1])
    run = pfd.integrate(pfd.load_robot('planar2'), law, 1.0, scene=scene, qd=[0.0, 3.0])
    assert run.status == 'not_finite'
    assert run.time[-1] == pytest.approx(0.5, abs=1e-12)
    assert np.isfinite(run.q).all()


@pytest.mark.parametrize('dense', [True, False])
def test_a_law_of_constant_torques_is_a_constant_torque_and_called_once_an_evaluation(
    dense: bool,
) -> None:
    calls: list[float] = []

    def law(t: float, q: Array, qd: Array) -> list[float]:
        calls.append(t)
        return [1.0, 0.5]

    settings: Any = {
        'scene': pfd.Scene(friction=[0.5, 0.2], joint_limits=[[-2, 2]] * 2, restitution=0.5),
        'qd': [3.0, -2.0],
        'dense': dense,
    }
    robot = pfd.load_robot('planar2')
    run = pfd.integrate(robot, law, 4.0, **settings)
    constant = pfd.integrate(robot, [1.0, 0.5], 4.0, **settings)
    assert run.events.size > 10
    assert run.evaluations == constant.evaluations == len(calls)
    for name in ('time', 'q', 'qd', 'qdd', 'events'):
        np.testing.assert_array_equal(getattr(run, name), getattr(constant, name))


@pytest.mark.parametrize('law', [False, True])
def test_the_length_of_the_pieces_does_not_change_a_bit(
    law: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = pfd.Scene(friction=[0.5, 0.2], joint_limits=[[-2, 2]] * 2, restitution=0.5)
    tau: Any = (lambda t, q, qd: -qd) if law else [1.0, 0.5]

    def run() -> tuple[Any, ...]:
        found = pfd.integrate(pfd.load_robot('planar2'), tau, 4.0, scene=scene, qd=[3.0, -2.0])
        arrays = (found.time, found.q, found.qd, found.qdd, found.events)
        counts = (found.status, found.evaluations, found.rejected_steps)
        return (*(x.tobytes() for x in arrays), found.at([1.0, 2.0]).q.tobytes(), *counts)

    wanted = run()
    assert run() == wanted
    monkeypatch.setattr(*bridge.target('ADAPTIVE_FIRST_OPERATIONS'), 1)
    monkeypatch.setattr(*bridge.target('ADAPTIVE_PIECE_SECONDS'), 1e-9)
    assert run() == wanted


BITS = """
import hashlib
import numpy as np
import pfd_core as pfd

found = hashlib.sha256()
for scene in (
    pfd.Scene(),
    pfd.Scene(friction=[2.0] * 2, joint_limits=[[-1.5, 1.5]] * 2, restitution=0.5),
):
    run = pfd.integrate(pfd.load_robot('planar2'), np.ones(2), 1.0, scene=scene, qd=np.ones(2))
    for x in (run.time, run.q, run.qd, run.qdd, run.events, run.at(np.linspace(0, 1, 9)).q):
        found.update(x.tobytes())
print(run.status, len(run.events) > 2, found.hexdigest())
"""


@cache
def bits(cpu: str) -> str:
    environment = os.environ | {'PFD_TARGET_CPU': cpu}
    done = subprocess.run(
        [sys.executable, '-c', BITS],
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.stdout.startswith('ok True'), done.stderr
    return done.stdout


@pytest.mark.parametrize('cpu', TARGET_LEVELS)
@pytest.mark.slow
def test_a_run_has_the_same_bits_on_another_processor(cpu: str) -> None:
    if not host_target().triple.startswith('x86_64') or missing_features(cpu):
        pytest.skip(f'this machine does not run code for {cpu}')
    assert bits(cpu) == bits('')


INTERRUPTED = """
import os, signal, sys, threading, time
import numpy as np
import pfd_core as pfd

signal.signal(signal.SIGINT, signal.default_int_handler)
robot = pfd.load_robot('planar2')
kind = sys.argv[1]
scene = pfd.Scene(friction=[1e-3, 1e-3]) if kind == 'friction' else pfd.Scene()
tau = (lambda t, q, qd: [0.0, 0.0]) if kind == 'law' else [0.0, 0.0]
settings = dict(scene=scene, q=[0.5, 0.5], dense=False)
pfd.integrate(robot, tau, 0.1, **settings)
for _ in range(3):
    begun = time.perf_counter()
    try:
        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
        pfd.integrate(robot, tau, 1e6, max_steps=10**9, max_step=1e-3, **settings)
        sys.exit('it was not interrupted')
    except KeyboardInterrupt:
        pass
wanted = pfd.integrate(robot, tau, 1.0, **settings)
assert wanted.status == 'ok'
print('interrupted')
"""


@pytest.mark.parametrize('kind', one_fast(['smooth', 'friction', 'law'], 'friction'))
def test_a_run_is_interrupted_within_its_steps(kind: str) -> None:
    done = subprocess.run(
        [sys.executable, '-c', INTERRUPTED, kind],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.stdout == 'interrupted\n', done.stderr
    assert not done.stderr
