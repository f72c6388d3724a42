# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What inputs and settings do to the arm: trajectories, the link, actuators, sensors, loads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from arm_messages import (
    INF,
    NAN,
    UNLIMITED,
    change,
    efforts,
    made,
    named,
    placed,
    request,
    state,
    states,
    taus,
    trajectory,
    verdict,
)
import numpy as np
import pytest
from test_arm_rules import CLOCKED, WELDED, A, B, C, ms, run

import pfd_core as pfd
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.noise import Channel as NoiseChannel
from pfd_ros.arm.noise import uniform as noise_uniform
from pfd_ros.arm.settings import Settings

NAMES = ('shoulder', 'elbow')
START = {'initial_positions': (0.3, -0.2)}
SERVO: dict[str, Any] = {'servo_p': (400.0, 200.0), 'servo_d': (40.0, 10.0)}
WEIGHTLESS = {'gravity': (0.0, 0.0, 0.0)}
PUSH = efforts(1.0, -0.5)


# Trajectories.


def knots(*shapes: np.polynomial.Polynomial, at: Sequence[float]) -> dict[str, Any]:
    """Return positions, velocities and accelerations of functions of time at some times."""
    names = ('positions', 'velocities', 'accelerations')
    return {
        name: [[shape.deriv(k)(t) for shape in shapes] for t in at] for k, name in enumerate(names)
    }


# A cubic and a quintic that end at rest after half a second.
REST = np.polynomial.Polynomial([-0.5, 1.0])
CUBIC = 0.2 + 3.0 * REST**2 + REST**3
QUINTIC = 0.1 + 2.0 * REST**3 - 4.0 * REST**4 + REST**5


@pytest.mark.parametrize(
    ('shapes', 'kinds'),
    [
        ((np.polynomial.Polynomial([0.3, 0.5]), np.polynomial.Polynomial([-0.2, -1.0])), 1),
        ((CUBIC, -CUBIC), 2),
        ((QUINTIC, QUINTIC + CUBIC), 3),
    ],
    ids=['linear', 'cubic', 'quintic'],
)
def test_targets_between_points_are_the_polynomial_of_their_degree(shapes, kinds):
    times = [0.0, 0.07, 0.3, 0.5]
    values = dict(list(knots(*shapes, at=times).items())[:kinds])
    engine = made(**SERVO, **START)
    engine.step([trajectory(NAMES, times, **values)], run=False)
    for k in range(500):
        engine.step()
        targets = engine.state.acting[2:]
        wanted = [[shape.deriv(d)(k * 1e-3) for shape in shapes] for d in range(2)]
        np.testing.assert_allclose(targets, wanted, rtol=0, atol=1e-12)
    engine.step()
    np.testing.assert_array_equal(
        engine.state.acting[2:], [[shape(0.5) for shape in shapes], [0, 0]]
    )


def test_the_arm_moves_from_its_state_to_the_first_point_and_holds_the_last():
    engine = made(**SERVO, **START, **WEIGHTLESS)
    plan = trajectory(('elbow',), [0.2], positions=[[0.4]])
    near = states(engine, plan, cycles=600)
    assert [x.position[0] for x in near] == [START['initial_positions'][0]] * 600  # braked
    targets = -0.2 + (0.4 + 0.2) * np.arange(200) / 200
    elbow = np.array([x.position[1] for x in near])
    assert np.abs(elbow[:200] - targets).max() < 0.15
    assert abs(elbow[-1] - 0.4) < 1e-3
    with_stamp = made(**SERVO, **START, **WEIGHTLESS)
    later = states(
        with_stamp, trajectory(('elbow',), [0.1], 100_000_000, positions=[[0.4]]), cycles=600
    )
    assert [x.position.tolist() for x in later] == [x.position.tolist() for x in near]


def test_continuous_joints_take_the_short_way_to_the_first_point_and_others_do_not():
    # As wraparound_joint in trajectory.cpp of joint_trajectory_controller.
    engine = made(**SERVO, **WEIGHTLESS, initial_positions=(6.4, -6.2))
    plan = trajectory(NAMES, [1.0, 2.0], positions=[[0.1, 0.1], [0.2, 4.0]])
    last = state(engine, plan, cycles=4000).position
    np.testing.assert_allclose(last, [0.2 + 2 * np.pi, 4.0 - 2 * np.pi], rtol=0, atol=1e-6)
    bounded = made(robot='puma560', servo_p=(9.0,) * 6, initial_positions=(0.0,) * 5 + (4.6,))
    states(bounded, trajectory(('joint6',), [0.1], positions=[[-4.6]]), cycles=200)
    assert bounded.state.newest[2, 5] == -4.6


def test_efforts_are_linear_between_points_need_no_gains_and_stay():
    engine = made(**UNLIMITED)
    plan = trajectory(NAMES, [0.0, 0.004, 0.006], effort=[[1, 2], [5, 2], [0, 0]])
    found = taus(engine, 10, plan)
    assert found[:6] == [[1, 2], [2, 2], [3, 2], [4, 2], [5, 2], [2.5, 1]]
    assert found[6:] == [[0, 0]] * 4


PLANNED = trajectory(NAMES, [1.0], positions=[[1.0, 1.0]])


@pytest.mark.parametrize(
    'event',
    [
        PUSH,
        named(['elbow'], [1.0]),
        placed(NAMES, [0.0, 0.0]),
        request('reset'),
        request('deactivate'),
        trajectory(['elbow'], [0.0], effort=[[1.0]]),
    ],
    ids=['array', 'named', 'jump', 'reset', 'deactivate', 'another'],
)
def test_a_trajectory_ends_with_the_next_command_a_jump_a_reset_and_a_stop(event):
    engine = made(**SERVO, **START)
    states(engine, PLANNED, cycles=100)
    before = engine.state.newest[2].copy()
    engine.step([event])
    for _ in range(20):
        engine.step([request('activate')])
        target = engine.state.newest[2]
        assert all(np.isnan(target) | (target == before))


@pytest.mark.parametrize(
    'event',
    [
        trajectory(['elbow'], [0.5], positions=[[0.0]]),
        named(['elbow'], [0.0], position=[0.0], velocity=[0.0]),
    ],
    ids=['trajectory', 'command'],
)
def test_joints_that_the_next_command_does_not_name_come_to_rest_at_the_last_target(event):
    engine = made(**SERVO, **START, **WEIGHTLESS)
    states(engine, PLANNED, cycles=500)
    there = engine.state.newest[2, 0]
    assert engine.state.newest[3, 0] == pytest.approx(0.7)
    near = state(engine, event, cycles=3000)
    np.testing.assert_allclose(near.position, [there, 0.0], rtol=0, atol=1e-6)


def test_a_sample_is_lost_delayed_and_seen_by_the_watchdog_as_a_command_is():
    engine = made(**SERVO, **START, delay_commands=0.005, drop_commands=0.5, command_timeout=0.1)
    states(engine, PLANNED, cycles=400)
    assert engine.state.timeouts == 0
    assert 100 < engine.state.lost < 300
    target = engine.state.acting[2, 0]
    assert 0.3 + 0.7 * 0.37 < target < 0.3 + 0.7 * 0.3951


def test_a_trajectory_continues_after_a_pause_where_it_was_with_a_followed_clock_too():
    found = []
    for paused in (False, True):
        engine = made(**CLOCKED, **UNLIMITED)
        run(engine, ms(100), trajectory(NAMES, [0.0, 0.1], effort=[[0, 0], [100, 50]]), ms(150))
        if paused:
            run(engine, request('pause'), ms(400))
            run(engine, request('resume'), ms(500))
        efforts_on_the_way = []
        for k in range(1, 31):
            run(engine, ms((500 if paused else 150) + k))
            efforts_on_the_way.append(engine.state.newest[0].tolist())
        found.append(efforts_on_the_way)
    assert found[0] == [[50.0 + k, 25.0 + k / 2] for k in range(30)]
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-9)


def test_in_lockstep_the_arm_waits_for_an_answer_from_the_last_point_on():
    engine = made(**SERVO, **START, lockstep=True, wait_for_controller=True)
    assert engine.waiting
    engine.step([trajectory(NAMES, [0.02], positions=[[0.5, 0.0]])])
    cycles = 1
    while not engine.waiting:
        engine.step()
        cycles += 1
    assert cycles == 20
    engine.step([PUSH])
    assert engine.state.trajectory is None


# The link: watchdog, delay, drop-out.


def test_a_watchdog_waits_for_the_first_command_and_acts_once_after_the_last():
    engine = made(command_timeout=0.005)
    assert not any(map(any, taus(engine, 20)))
    assert engine.state.timeouts == 0
    assert taus(engine, 3, efforts(1.0, 0.5)) == [[1.0, 0.5]] * 3
    assert taus(engine, 8, efforts(2.0, 0.5)) == [[2.0, 0.5]] * 5 + [[0.0, 0.0]] * 3
    assert (engine.state.timeouts, engine.state.timed_out) == (1, True)
    # Braked: the arm stands from the next state on.
    there = state(engine)
    assert not there.velocity.any()
    assert state(engine, cycles=50).position.tobytes() == there.position.tobytes()
    assert engine.state.timeouts == 1
    assert taus(engine, 7, efforts(3.0, 0.5)) == [[3.0, 0.5]] * 5 + [[0.0, 0.0]] * 2
    assert engine.state.timeouts == 2
    engine.step([efforts(3.0, 0.5)])
    assert not engine.state.timed_out


def test_refused_and_nan_messages_do_not_feed_the_watchdog_and_a_pause_is_no_silence():
    engine = made(command_timeout=0.005)
    engine.step([efforts(1.0, 0.5)])
    for _ in range(5):
        engine.step([efforts(1.0), named(NAMES, [NAN, NAN])])
    assert engine.state.timed_out
    engine.step([efforts(1.0, 0.5), request('pause')])
    for _ in range(20):
        engine.step()
    assert taus(engine, 5, request('resume')) == [[1.0, 0.5]] * 5


def test_on_timeout_zero_commands_zero_effort_and_leaves_brakes_on():
    engine = made(command_timeout=0.005, on_timeout='zero', **WEIGHTLESS)
    assert taus(engine, 7, named(['shoulder'], [2.0])) == [[2.0, 0.0]] * 5 + [[0.0, 0.0]] * 2
    velocity = state(engine, cycles=20).velocity
    # Stretched, a rod of 2 kg and 1 m about its end; without gravity its speed stays.
    assert velocity[0] == pytest.approx(5e-3 * 2.0 / (2.0 / 3.0), rel=1e-6)
    assert velocity[1] == 0.0


def test_on_timeout_hold_keeps_the_position_at_the_timeout_by_the_servo():
    engine = made(command_timeout=0.005, on_timeout='hold', **WEIGHTLESS, **SERVO)
    there = state(engine, efforts(1.0, -0.5), cycles=5)
    assert taus(engine, 1) == [(-np.array(SERVO['servo_d']) * there.velocity).tolist()]
    np.testing.assert_allclose(state(engine, cycles=4000).position, there.position, atol=1e-9)
    # A torque command ends it.
    assert taus(engine, 1, efforts(1.0, 0.5)) == [[1.0, 0.5]]
    # One for one joint leaves the other held.
    settings = {'command_timeout': 0.005, 'on_timeout': 'hold', 'delay_commands': 0.001}
    engine = made(**settings, **WEIGHTLESS, **SERVO)
    taus(engine, 50, efforts(1.0, -0.5))
    assert taus(engine, 4, named(['shoulder'], [0.5]))[-1][1] != 0.0


def test_a_delayed_command_acts_some_cycles_later_and_is_judged_at_once():
    engine = made(delay_commands=0.003)
    _, (found,) = engine.step([efforts(1.0, 0.5)])
    assert found.accepted
    commands = named(['elbow'], [9.0]), named(['shoulder'], [7.0])
    assert taus(engine, 4, *commands) == [[0.0, 0.0]] * 2 + [[1.0, 0.5], [7.0, 9.0]]


def test_a_delay_acts_on_targets_and_not_on_the_torques_of_a_servo():
    late, prompt = made(delay_commands=0.004, **SERVO), made(**SERVO)
    target = named(NAMES, position=[0.1, -0.1])
    taus(late, 4, target)
    assert taus(late, 100) == taus(prompt, 100, target)


@pytest.mark.parametrize('event', [request('reset'), placed(NAMES, [0.3, 0.3])])
def test_a_reset_and_a_jump_discard_delayed_commands_and_targets(event):
    engine = made(delay_commands=0.003, command_timeout=0.004)
    taus(engine, 2, efforts(1.0, 0.5))
    assert not any(map(any, taus(engine, 30, event)))
    assert engine.state.timeouts == 0
    engine = made(**SERVO)
    state(engine, named(NAMES, position=[1.0, 1.0]))
    assert taus(engine, 3, event)[1:] == [[0.0, 0.0]] * 2


def test_the_watchdog_counts_from_where_the_delay_ends():
    engine = made(delay_commands=0.003, command_timeout=0.002)
    found = taus(engine, 7, efforts(1.0, 0.5))
    assert found == [[0.0, 0.0]] * 3 + [[1.0, 0.5]] * 2 + [[0.0, 0.0]] * 2
    assert engine.state.timeouts == 1


def test_a_share_of_the_commands_is_lost_by_the_seed_and_changes_nothing():
    engine, last = made(drop_commands=0.25, seed=7), 0.0
    lost = [noise_uniform(7, NoiseChannel.COMMAND_DROP, k, 1)[0] < 0.25 for k in range(1, 2001)]
    for k in range(2000):
        last = last if lost[k] else float(k % 9)
        assert taus(engine, 1, efforts(float(k % 9), 0.0)) == [[last, 0.0]]
    assert engine.state.lost == sum(lost)
    # Four standard deviations of a binomial distribution.
    assert abs(engine.state.lost - 500) < 4 * np.sqrt(2000 * 0.25 * 0.75)


def test_a_lost_command_answers_in_lockstep_and_does_not_start_the_watchdog():
    engine = made(drop_commands=1.0, command_timeout=0.002, lockstep=True)
    assert taus(engine, 9, efforts(1.0, 0.5)) == [[0.0, 0.0]]
    assert engine.waiting
    assert verdict(engine, efforts(1.0, 0.5)).accepted
    assert not engine.waiting
    assert (engine.state.lost, engine.state.timeouts) == (2, 0)


# Actuators: the reflex, limits, servos.

# 2000 N m/s are 2 N m in a cycle of a millisecond.
REFLEX, OFF = {'reflex_effort_rate': 2000.0}, {'reflex_effort_rate': 0.0}


def test_a_jump_of_an_effort_closes_the_brakes_until_a_reset():
    engine = made(**REFLEX)
    # The first effort of a joint on its brake may be any.
    assert taus(engine, 2, efforts(9.0, 5.0)) == [[9.0, 5.0]] * 2
    assert taus(engine, 2, efforts(11.0, 3.0)) == [[11.0, 3.0]] * 2
    found = states(engine, efforts(11.0, 5.001), cycles=3)
    assert [each.effort.tolist() for each in found] == [[0.0, 0.0]] * 3
    assert not found[0].velocity.any()
    assert engine.state.tripped == "the effort of 'elbow' changed by 2.001 in one step, limit 2"
    assert verdict(engine, efforts(1.0, 1.0)).detail == engine.state.tripped
    assert verdict(engine, named(['elbow'], [1.0])).label == 'refused'
    assert not any(map(any, taus(engine, 5)))
    engine.step([request('reset')])
    assert taus(engine, 2, efforts(1.0, 1.0)) == [[1.0, 1.0]] * 2
    assert (engine.state.trips, engine.state.tripped) == (1, '')


@pytest.mark.parametrize(
    ('settings', 'commands', 'trips'),
    [
        (SERVO, [[named(NAMES, position=[x, 0.0])] for x in (0.0, 0.004)], 0),
        (SERVO, [[named(NAMES, position=[x, 0.0])] for x in (0.0, 0.1)], 1),
        ({}, [[efforts(1e308, 0.0)], [efforts(-1e308, 0.0)]], 1),
        # It does not see the jump of the watchdog.
        ({'command_timeout': 0.005, 'on_timeout': 'zero'}, [[efforts(9.0, -5.0)], *[[]] * 9], 0),
        # It looks at efforts from the next one on.
        (OFF, [[efforts(9.0, 0.0)], [change(**REFLEX), efforts(0.0, 0.0)]], 0),
        (OFF, [[efforts(9.0, 0.0)], [change(**REFLEX)], [efforts(0.0, 0.0)]], 1),
    ],
)
def test_a_reflex_sees_the_efforts_that_are_wanted(settings, commands, trips):
    engine = made(**{**REFLEX, **settings}, **WEIGHTLESS)
    for events in commands:
        engine.step(events)
    assert engine.state.trips == trips
    assert bool(engine.state.timeouts) == ('command_timeout' in settings)


def acted(engine: Engine, effort: Sequence[float], qd: Sequence[float]) -> list[float]:
    """Return the efforts that act on joints at these velocities, by NAMES."""
    engine.step([placed(NAMES, [0.0, 0.0], qd)])
    found = state(engine, named(NAMES, effort))
    return [float(found.effort[found.names.index(name)]) for name in NAMES]


@pytest.mark.parametrize(
    ('settings', 'effort', 'qd', 'wanted'),
    [
        # The model states 20 and 10 N m, both at 20 rad/s.
        ({}, (1e300, -10.5), (0.0, 0.0), [20.0, -10.0]),
        ({}, (-21.0, 3.0), (0.0, 0.0), [-20.0, 3.0]),
        ({}, (-0.0, 10.0), (17.0, -17.0), [-0.0, 10.0]),
        # Driving torque drops beyond the speed limit, braking torque does not.
        *(
            ({}, (sign * 20.0, 0.0), (turn * sign * speed, 0.0), [sign * most, 0.0])
            for sign in (1.0, -1.0)
            for speed, left in ((19.9, 20.0), (20.0, 20.0), (30.0, 10.0), (40.0, 0.0), (90.0, 0.0))
            for turn, most in ((1.0, left), (-1.0, 20.0))
        ),
        # A bound, not a factor: less than that passes.
        ({}, (9.0, 0.0), (30.0, 0.0), [9.0, 0.0]),
        ({}, (5.0, 10.0), (50.0, 0.1), [0.0, 10.0]),
        ({'joints': NAMES[::-1]}, (99.0, 99.0), (0.0, 40.0), [20.0, 0.0]),
        (UNLIMITED, (1e3, -11.0), (50.0, -50.0), [1e3, -11.0]),
        # The first row of a table holds at any speed.
        ({'effort_limits': False}, (99.0, 99.0), (30.0, 0.0), [10.0, 10.0]),
        ({'torque_speed': False}, (99.0, 9.0), (19.0, 50.0), [20.0, 9.0]),
    ],
)
def test_efforts_stay_within_the_limits_of_the_motors(settings, effort, qd, wanted):
    engine = made(**WEIGHTLESS, **settings)
    found = acted(engine, effort, qd)
    assert found == pytest.approx(wanted, rel=1e-12, abs=0.0)
    assert [str(x) for x in found if x == 0.0] == [str(x) for x in wanted if x == 0.0]
    cut = any(abs(a) < abs(b) * (1 - 1e-12) for a, b in zip(found, effort, strict=True))
    assert engine.state.motors.counts[0] == cut


@pytest.mark.parametrize(
    ('scene', 'wanted'),
    [
        # Limits of the scene act within the step, and what is told is the effort before them.
        (pfd.Scene(effort_limits=(3.0, 1.0), torque_speed='model'), [1e3, -1e3]),
        (pfd.Scene(effort_limits=(3.0, 1.0)), [0.0, -10.0]),
        (pfd.Scene(torque_speed=[[(1.0, 5.0)]] * 2), [20.0, -10.0]),
    ],
)
def test_limits_of_the_scene_replace_the_parameters(scene, wanted):
    engine = made(scene=pfd.scene_to_yaml(scene))
    assert acted(engine, (1e3, -1e3), (40.0, 40.0)) == wanted


@pytest.mark.parametrize(('masses', 'most'), [((1.0, 1.0), 1000.0), ((400.0, 100.0), 25_000.0)])
def test_a_joint_whose_model_states_no_limit_gets_a_wide_one(masses, most):
    # 1000 N m at least, or the weight of all links at 5 m.
    limits = {'effort_limit': np.array([INF, 10.0]), 'masses': np.array(masses)}
    robot = replace(pfd.load_robot('planar2'), velocity_limit=np.array([INF, 20.0]), **limits)
    engine = Engine(Settings(robot='planar2', **WEIGHTLESS), robot)
    assert acted(engine, (1e9, 1e9), (99.0, 0.0)) == [most, 10.0]
    assert acted(engine, (1e9, 0.0), (150.0, 0.0))[0] == pytest.approx(most / 2)


# Sensors and noise.


def table(messages: list[Any], kind: str) -> np.ndarray:
    return np.array([getattr(message, kind) for message in messages])


def test_noise_has_its_standard_deviation_and_leaves_the_true_motion_alone():
    sizes = {'position': 0.5, 'velocity': 0.25, 'effort': 2.0}
    noises = {f'noise_{kind}': size for kind, size in sizes.items()}
    exact, noisy, other = made(**START), made(**START, **noises, seed=1), made(**START, **noises)
    true, measured = (states(engine, PUSH, cycles=2000) for engine in (exact, noisy))
    assert exact.state.rows.tobytes() == noisy.state.rows.tobytes()
    different = states(other, PUSH, cycles=20)
    for kind, size in sizes.items():
        errors = (table(measured, kind) - table(true, kind)).ravel() / size
        # Five standard deviations of the mean and of the variance, of a fixed seed.
        assert abs(errors.mean()) < 5 / np.sqrt(errors.size)
        assert abs((errors**2).mean() - 1) < 5 * np.sqrt(2 / errors.size)
        assert not (table(different, kind) == table(measured[:20], kind)).any()


def test_a_bias_is_added_in_the_order_in_which_joints_are_published():
    order = {'joints': NAMES[::-1], 'initial_positions': (-0.2, 0.3)}
    true = states(made(**order), PUSH, cycles=3)
    for kind in ('position', 'velocity', 'effort'):
        biased = states(made(**order, **{f'bias_{kind}': (0.25, 0.0)}), PUSH, cycles=3)
        assert biased[0].names == NAMES[::-1]
        assert (table(biased, kind) == table(true, kind) + np.array([0.25, 0.0])).all()


def test_measured_numbers_are_the_nearest_steps_of_the_encoder_and_finite():
    step = 2 * np.pi / 4096
    true = states(made(**START), PUSH, cycles=50)
    measured = states(made(**START, quantization_position=step), PUSH, cycles=50)
    counts = table(measured, 'position') / step
    assert np.allclose(counts, np.rint(counts), rtol=0, atol=1e-9)
    error = np.abs(table(measured, 'position') - table(true, 'position'))
    assert 0 < error.max() <= step / 2 * (1 + 1e-12)
    # Numbers that are coarser than the step stay as they are.
    coarse = made(quantization_effort=1e-10, **UNLIMITED)
    assert state(coarse, efforts(1e7 / 3, -0.26)).effort.tolist() == [1e7 / 3, -0.26]


def test_a_delayed_state_is_the_one_of_earlier_under_the_stamp_of_now():
    true = states(made(**START), PUSH, cycles=20)
    late = states(made(**START, delay_state=0.003), PUSH, cycles=20)
    assert [m.stamp_ns for m in late] == [m.stamp_ns for m in true]
    for kind in ('position', 'velocity', 'effort'):
        assert (table(late, kind)[3:] == table(true, kind)[:-3]).all()
    assert late[0].position.tolist() == [0.3, -0.2]
    assert not late[2].effort.any()
    # It counts steps whatever is published.
    few = states(made(**START, delay_state=0.003, publish_rate=200.0), PUSH, cycles=20)
    assert table(few, 'position').tolist() == table(true, 'position')[1:18:5].tolist()


def test_a_reset_shows_at_once_and_repeats_noise_and_losses_and_a_jump_does_not():
    settings = {'noise_position': 1e-4, 'noise_velocity': 1e-2, 'drop_state': 0.25, 'seed': 5}
    engine = made(**START, **settings, drop_commands=0.5)

    def episode():
        found = []
        for k in range(300):
            for each in states(engine, efforts(0.01 * k, 0.0)):
                found.append((k, each.position.tolist(), each.velocity.tolist()))
        return found

    first, lost = episode(), engine.state.lost
    assert 100 < lost < 200
    assert 180 < len(first) < 270
    engine.step([request('reset')])
    assert episode() == first
    assert engine.state.lost == 2 * lost
    engine.step([placed(NAMES, [0.3, -0.2])])
    assert episode() != first
    late = made(**START, delay_state=0.005)
    assert state(late, PUSH, cycles=30).velocity.all()
    after = states(late, request('reset'), cycles=8)
    assert table(after, 'position').tolist() == [[0.3, -0.2]] * 8


def test_other_noise_while_the_arm_runs_keeps_the_states_under_way():
    settings = {**START, 'delay_state': 0.003, 'noise_position': 1e-4, 'seed': 5}
    engine, steady = made(**settings, noise_velocity=1e-2), made(**settings)
    for each in (engine, steady):
        states(each, PUSH, cycles=30)
    engine.step([change(noise_velocity=0.0)], run=False)
    assert engine.measured().tobytes() == steady.measured().tobytes()


def test_locked_joints_are_published_after_the_others_at_rest_without_errors():
    engine = made(**WELDED, joints=('joint4', A, B, C), noise_position=1.0, bias_effort=(1.0,) * 4)
    found = state(engine, efforts(1, 2, 3, 4), cycles=5)
    assert found.names == ('joint4', A, B, C, 'joint6', 'joint5')
    assert found.position[4:].tolist() == [0.25, -0.5]
    assert found.velocity[4:].tolist() == found.effort[4:].tolist() == [0.0, 0.0]
    assert found.effort[:4].tolist() == [2, 3, 4, 5]
    assert found.velocity[:4].all()
    assert state(made(**WELDED, publish_locked=False)).names == (A, B, C, 'joint4')
