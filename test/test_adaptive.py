# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Adaptive integration: closed forms, tolerances kept, events of friction and stops, status."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
import math
from pathlib import Path
from typing import Any

from contact_oracle import Motion, random_case, random_start
import mpmath
import numpy as np
import pytest
import yaml
from zoo import Array, one_fast, random_chain, slider

from benchmarks.cases.problems import rods
from benchmarks.cases.robots import robot as report_robot
import pfd_core as pfd

# Error of an angle over 3 s in units of rtol: what `integrate` promises.
KEPT = 10.0


def pendulum(swing: float, times: np.ndarray) -> np.ndarray:
    """Return the angle of two rods of 0.5 m in line, released at rest at an angle `swing`."""
    # A rod of length L = 1: theta'' = -3 g / (2 L) sin theta; sin(theta/2) = k cd(w t, k).
    k, w = math.sin(swing / 2), math.sqrt(3 * 9.81 / 2)
    cd = [float(mpmath.ellipfun('cd', w * t, k=k)) for t in times]
    return 2 * np.arcsin(k * np.array(cd))


def swing_with_the_elbow_held(
    duration: float, swing: float = 2.0, **options: Any
) -> pfd.AdaptiveTrajectory:
    return pfd.integrate(
        pfd.load_robot('planar2'),
        np.zeros(2),
        duration,
        scene=pfd.Scene(brakes=True),
        brakes=[False, True],
        q=[-np.pi / 2 + swing, 0.0],
        qd=[0.0, 5.0],
        **options,
    )


def pendulum_errors(run: pfd.Trajectory, swing: float = 2.0) -> np.ndarray:
    return np.abs(run.q[:, 0] + np.pi / 2 - pendulum(swing, run.time))


def test_the_error_falls_with_the_eighth_power_of_the_step() -> None:
    errors = []
    for size in (0.2, 0.1, 0.05):
        # A tolerance that every step meets leaves the largest step.
        run = swing_with_the_elbow_held(6.0, 0.5, rtol=0.5, atol=1e3, max_step=size)
        np.testing.assert_allclose(np.diff(run.time), size, rtol=1e-9)
        # At the same times for all sizes.
        common = pendulum_errors(run, 0.5)[:: round(0.2 / size)]
        errors.append(math.sqrt((common**2).mean()))
    for coarse, fine in pairwise(errors):
        assert math.log2(coarse / fine) == pytest.approx(8, abs=0.2)


@pytest.mark.parametrize('rtol', one_fast([1e-4, 1e-7, 1e-10, 1e-13], 1e-10))
def test_a_pendulum_swings_as_in_its_closed_form_between_the_steps_too(rtol: float) -> None:
    run = swing_with_the_elbow_held(3.0, rtol=rtol, atol=rtol)
    assert run.status == 'ok'
    assert run.time[-1] == 3.0
    assert pendulum_errors(run).max() < KEPT * rtol
    between = run.at(np.linspace(0.0, 3.0, 301)[::-1])
    assert pendulum_errors(between).max() < KEPT * rtol
    for states in (run, between):
        np.testing.assert_array_equal(states.q[:, 1], 0.0)
        np.testing.assert_array_equal(states.qd[:, 1], 0.0)


def test_a_torque_law_of_time_and_state_moves_an_arm_as_it_was_computed_to() -> None:
    # The torque that the accelerations of 0.3 + cos(w t) need in the state of the moment.
    robot = random_chain(np.random.default_rng(4), 3)
    w = np.arange(1.0, 4.0)
    q0 = 0.3 + np.ones(3)

    def law(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return pfd.inverse_dynamics(robot, q, qd, -(w**2) * np.cos(w * t))

    run = pfd.integrate(robot, law, 1.0, q=q0, rtol=1e-10)
    np.testing.assert_allclose(run.q, 0.3 + np.cos(np.outer(run.time, w)), atol=1e-8)
    np.testing.assert_allclose(run.qd, -w * np.sin(np.outer(run.time, w)), atol=1e-8)
    np.testing.assert_allclose(run.qdd, -(w**2) * np.cos(np.outer(run.time, w)), atol=1e-7)


def test_evaluations_are_counted() -> None:
    robot = pfd.load_robot('planar2')
    times: list[float] = []

    def law(t: float, q: np.ndarray, qd: np.ndarray) -> list[float]:
        times.append(t)
        q[:] = qd[:] = 7.0  # a copy
        return [0.5, 0.2]

    for dense, stages in ((True, 15), (False, 12)):
        times.clear()
        run = pfd.integrate(robot, law, 1.0, dense=dense)
        assert run.evaluations == len(times)
        assert run.evaluations == 1 + stages * run.finite_steps + 12 * run.rejected_steps
        assert run.finite_steps == len(run.time) - 1
        constant = pfd.integrate(robot, [0.5, 0.2], 1.0, dense=dense)
        np.testing.assert_array_equal(run.q, constant.q)


@pytest.mark.parametrize(
    ('tau', 'steps'),
    [
        ([1e200, 0.0], 0),
        (lambda t, q, qd: np.full(2, np.nan), 0),
        (lambda t, q, qd: np.full(2, np.nan if t > 0.5 else 0.0), None),
    ],
)
def test_a_number_that_is_not_finite_is_a_status(tau: Any, steps: int | None) -> None:
    run = pfd.integrate(pfd.load_robot('planar2'), tau, 1.0)
    assert run.status == 'not_finite'
    assert np.isfinite(run.q).all()
    assert np.isfinite(run.qd).all()
    if steps is None:
        assert run.time[-1] == pytest.approx(0.5, abs=1e-12)
        assert np.isfinite(run.at([0.25]).q).all()
    else:
        assert run.finite_steps == steps
        with pytest.raises(ValueError, match="no step to look into: status 'not_finite'"):
            run.at([0.0])


def test_a_torque_without_a_limit_of_its_error_is_a_step_too_small() -> None:
    noise = np.random.default_rng(5)
    run = pfd.integrate(
        pfd.load_robot('planar2'), lambda t, q, qd: 1e6 * noise.normal(size=2), 1.0
    )
    assert run.status == 'step_too_small'


def test_the_number_of_steps_is_bounded() -> None:
    robot = pfd.load_robot('planar2')
    run = pfd.integrate(robot, np.zeros(2), 100.0, max_steps=7)
    assert run.status == 'too_many_steps'
    assert run.finite_steps + run.rejected_steps == 7
    assert run.time[-1] < 100.0


def test_states_are_given_within_a_run_that_was_to_keep_them() -> None:
    robot = pfd.load_robot('planar2')
    with pytest.raises(ValueError, match=r'times must lie from 0 to 1 s, got 1\.5'):
        pfd.integrate(robot, np.zeros(2), 1.0).at([0.5, 1.5])
    with pytest.raises(ValueError, match=r'need integrate\(..., dense=True\)'):
        pfd.integrate(robot, np.zeros(2), 1.0, dense=False).at([0.5])
    with pytest.raises(ValueError, match='rtol must be at least 1e-14 and below 1, got 1e-16'):
        pfd.integrate(robot, np.zeros(2), 1.0, rtol=1e-16)


TOLERANCES = [10.0**-k for k in range(3, 14)]
# Motions with ends in extended precision.
MOTIONS: dict[str, Any] = yaml.load(
    (Path(__file__).parent / 'data' / 'motions.yaml').read_bytes(), yaml.CSafeLoader
)
GRAVITY = 9.81
# Events at closed forms: roundings of a state of order one, summed over some events.
EXACT = 1e-13


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
        robot = report_robot(row['arm'])
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
    for rtol in TOLERANCES[::2]:
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
@pytest.mark.filterwarnings('ignore:.*outside the stops:pfd_core.PhysicsWarning')
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


def bounced(q: float, t: float) -> float:
    """Return where a mass of 1 kg is after a bounce at 0, from q with 2 m/s under -2 N."""
    root = np.sqrt(1 + q)
    left = t - 1 - root
    return root * left - left**2


def test_motors_brakes_and_wrench_act_in_a_scene_with_events_as_in_the_simulator() -> None:
    robot = random_chain(np.random.default_rng(8), 2)
    settings: dict[str, Any] = {
        'friction': [0.3, 0.3],
        'static_friction': [0.5, 0.5],
        'stribeck_velocity': [0.1, 0.1],
        'joint_limits': [[-1, 1]] * 2,
        'restitution': 0.5,
        'effort_limits': [4.0] * 2,
        'gravity_compensation': True,
        'armature': [0.1] * 2,
        'external_wrench': True,
        'brakes': True,
    }
    scene = pfd.Scene(**settings)
    held = {'wrench': [1.0, 2.0, 3.0, 0.1, 0.2, 0.3], 'brakes': [False, True]}
    torque, duration = np.array([5.0, -3.0]), 0.5
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
    robot = pfd.load_robot('planar2')
    scene = pfd.Scene(damping=[1e4, 1e4])
    run = pfd.integrate(robot, [0, 0], 10.0, scene=scene, rtol=1e-6, max_steps=2000)
    assert run.status == 'too_stiff'
    assert run.stiff_steps > run.finite_steps / 2
    smooth = pfd.integrate(robot, [0, 0], 10.0, max_steps=20)
    assert (smooth.status, smooth.stiff_steps) == ('too_many_steps', 0)


# ---- laws, interrupts, pieces, processors -----------------------------------------------------


def test_an_exception_of_a_law_ends_the_run_and_is_passed_on() -> None:
    calls = []

    def law(t: float, q: Array, qd: Array) -> Array:
        calls.append(t)
        if t > 0.5:
            raise ZeroDivisionError('as planned')
        return np.zeros(2)

    with pytest.raises(ZeroDivisionError, match='as planned'):
        pfd.integrate(pfd.load_robot('planar2'), law, 1.0)
    assert sum(t > 0.5 for t in calls) == 1


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
    monkeypatch.setattr('pfd_core.simulation.adaptive.FIRST_OPERATIONS', 1)
    monkeypatch.setattr('pfd_core.kernels.simulations.PIECE_SECONDS', 1e-9)
    assert run() == wanted
