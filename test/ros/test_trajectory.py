# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measures and diagnosis of a motion against closed forms, and the words of failed assertions."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest

import pfd_core as pfd
from pfd_ros.messages.joints import JOINT_UNITS
from pfd_ros.motion.metrics import overshoot, settling_time
from pfd_ros.motion.symptoms import Samples, oscillation, text_of
from pfd_ros.motion.symptoms import diagnosis as joint_diagnosis
from pfd_ros.testing import Limits, LockstepArm, Trajectory

# A wheel of 0.5 kg m^2 about a vertical axis: gravity has no torque, so PD control makes it the
# second-order system of the textbooks.
INERTIA = 0.5
WHEEL = """<robot name="wheel"><link name="base"/><link name="disc"><inertial>
<mass value="1"/><inertia ixx="0.5" iyy="0.5" izz="0.5" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="spin" type="revolute"><parent link="base"/><child link="disc"/><axis xyz="0 0 1"/>
<limit lower="-1.2" upper="1.2" effort="60" velocity="9"/></joint></robot>"""
STEP = 1e-4
TARGET = 0.8
# rad/s
FREQUENCY = 12.0


def unlimited(n: int) -> Limits:
    return Limits(*(sign * np.full(n, math.inf) for sign in (-1, 1, 1, 1)))


def motion(time, q, tau=None, **limits) -> Trajectory:
    """Return a trajectory of joints a, b, ... from columns."""
    q = np.asarray(q, float)
    q = q.reshape(len(q), -1)
    tau = np.zeros_like(q) if tau is None else np.asarray(tau, float).reshape(q.shape)
    names = tuple('abcdef'[: q.shape[1]])
    bounds = unlimited(q.shape[1])._replace(**{k: np.array(v) for k, v in limits.items()})
    return Trajectory(np.asarray(time, float), q, np.zeros_like(q), tau, names, bounds)


def step_response(damping: float, seconds: float = 2.0) -> Trajectory:
    """Return the answer of the wheel under PD to a step, at this damping ratio."""
    stiffness = INERTIA * FREQUENCY**2
    damper = 2 * damping * FREQUENCY * INERTIA
    with LockstepArm(WHEEL, step_size=STEP, substeps=1) as arm:
        return arm.run(lambda t, q, qd: stiffness * (TARGET - q) - damper * qd, seconds)


@pytest.mark.parametrize('damping', [0.2, 0.5, 0.7])
def test_the_overshoot_of_a_second_order_system_follows_from_its_damping_ratio(damping):
    expected = math.exp(-math.pi * damping / math.sqrt(1 - damping**2))
    (found,) = step_response(damping).overshoot(TARGET)
    # The controller samples; half a period of delay takes omega h / 2 from the damping.
    assert found == pytest.approx(expected, abs=4 * FREQUENCY * STEP)


def test_the_settling_time_of_a_critically_damped_system_solves_its_equation():
    response = step_response(1.0)
    # Within two percent: (1 + x) exp(-x) = 0.02 at x = 5.83392 time constants.
    (found,) = response.settling_time(TARGET, 0.02 * TARGET)
    assert found == pytest.approx(5.83392 / FREQUENCY, rel=0.005)
    assert response.overshoot(TARGET) == pytest.approx(0.0, abs=1e-6)


def test_settling_counts_from_the_last_sample_outside_of_the_band():
    time = np.arange(6.0) + 10
    q = np.array([0.0, 1.0, 1.2, 1.05, 0.95, 1.0])
    assert settling_time(time, q, 1.0, 0.1) == 3.0
    assert settling_time(time, q, 1.0, 0.01) == 5.0
    assert settling_time(time, q, 1.0, 2.0) == 0.0
    assert settling_time(time, q, 9.0, 0.1) == math.inf
    q[5] = math.nan
    assert settling_time(time, q, 1.0, 2.0) == math.inf


def test_overshoot_is_a_share_of_the_step_in_its_direction():
    assert overshoot(np.array([0.0, 1.1, 1.3, 0.9]), 1.0) == pytest.approx(0.3)
    assert overshoot(np.array([2.0, 0.8, 1.4]), 1.0) == pytest.approx(0.2)
    assert overshoot(np.array([2.0, 1.5]), 1.0) == 0.0
    assert math.isnan(overshoot(np.array([1.0, 1.5]), 1.0))


def test_torque_rates_are_differences_over_the_time_between_samples():
    time = np.array([0.0, 0.1, 0.3, 0.4])
    found = motion(time, np.zeros((4, 2)), [[0, 1], [1, 1], [-1, 1], [-1, 2]]).torque_rate()
    assert found == pytest.approx([10.0, 10.0])
    assert (motion([0.0], np.zeros((1, 2))).torque_rate() == 0).all()


def test_limits_are_hit_at_the_bound_itself_and_reported_in_the_order_of_time():
    q = np.array([[0.0, 0.0], [0.5, -1.0], [1.0, -2.0]])
    tau = [[0, 0], [0, 7], [0, 9]]
    found = motion(
        [0.0, 0.1, 0.2],
        q,
        tau,
        position_upper=[1.0, 3.0],
        position_lower=[-2.0, -2.5],
        effort=[10.0, 7.0],
    ).limits_hit()
    assert [(hit.joint, hit.kind, hit.time, hit.value, hit.bound) for hit in found] == [
        ('b', 'effort', 0.1, 7.0, 7.0),
        ('a', 'position', 0.2, 1.0, 1.0),
    ]


def test_a_failed_assertion_names_joint_time_value_and_bound():
    time = np.arange(5) / 10
    q = np.array([[0.0, 0.0], [0.4, 1.5], [0.8, 1.1], [1.0, 0.9], [1.0, 1.0]])
    tau = np.array([[0, 0], [1, 0], [5, 0], [5, 0], [5, 0]])
    found = motion(time, q, tau, position_upper=[2.0, 1.4])
    with pytest.raises(AssertionError) as settles:
        found.assert_settles(1.0, within=0.05, by=0.2)
    assert str(settles.value).splitlines()[0] == (
        "joint 'a' is 0.2 rad or m from its target 1 rad or m at t = 0.2 s, expected within "
        '0.05 rad or m from t = 0.2 s on'
    )
    # Each joint that fails has its line: the second one may be at fault.
    assert [x.split(':')[0] for x in str(settles.value).splitlines()[1:]] == ['  a', '  b']
    with pytest.raises(AssertionError) as beyond:
        found.assert_overshoot_below(0.25, 1.0)
    assert str(beyond.value).splitlines()[0] == (
        "joint 'b' is at 1.5 rad or m at t = 0.1 s, 50 % of its step beyond the target "
        '1 rad or m, expected below 25 %'
    )
    with pytest.raises(AssertionError) as rate:
        found.assert_torque_rate_below([30.0, 1.0])
    assert str(rate.value).splitlines()[0] == (
        "effort of joint 'a' changes by 40 (N m or N)/s at t = 0.2 s, from 1 N m or N to "
        '5 N m or N, expected below 30 (N m or N)/s'
    )
    with pytest.raises(AssertionError) as limit:
        found.assert_no_limit_hit()
    assert str(limit.value).splitlines()[0] == (
        "position of joint 'b' is 1.5 rad or m at t = 0.1 s, expected within its limit "
        '1.4 rad or m'
    )


def test_assertions_hold_where_the_motion_is_as_expected():
    response = step_response(0.7)
    response.assert_settles(TARGET, within=0.01, by=0.8)
    response.assert_overshoot_below(0.05, TARGET)
    response.assert_torque_rate_below(2 * FREQUENCY**3 * INERTIA * TARGET)
    response.assert_no_limit_hit()
    with pytest.raises(AssertionError, match='beyond the target'):
        response.assert_overshoot_below(0.04, TARGET, joint='spin')


def test_assertions_check_the_named_joints():
    found = motion([0.0, 0.1, 0.2], [[0, 5], [1.5, 5], [1, 5]])
    with pytest.raises(ValueError, match="joint 'b' starts at its target 5"):
        found.assert_overshoot_below(0.9, [1.0, 5.0])
    found.assert_overshoot_below(0.9, [1.0, 5.0], joint='a')
    found.assert_settles([0.0, 5.0], within=0.1, by=0.1, joint=['b'])
    with pytest.raises(ValueError, match=r'joint is \[\], expected a joint or several'):
        found.assert_settles(1.0, within=1.0, by=0.0, joint=[])
    with pytest.raises(ValueError, match="joint is 'c', expected one of"):
        found.assert_settles(1.0, within=1.0, by=0.0, joint='c')
    with pytest.raises(ValueError, match='by is 3'):
        found.assert_settles(1.0, within=1.0, by=3.0)
    for target in ([1, 2, 3], math.nan):
        with pytest.raises(ValueError, match=r'target is .*, expected one number or \(2,\)'):
            found.assert_overshoot_below(0.1, target)
    for bound in (math.nan, -1.0, [0.1, 0.1]):
        for assertion in (
            lambda bound: found.assert_settles(1.0, within=bound, by=0.1),
            lambda bound: found.assert_tracks(1.0, rms=bound),
            lambda bound: found.settling_time(1.0, bound),
            lambda bound: found.assert_overshoot_below(bound, 2.0),
        ):
            with pytest.raises(ValueError, match=r'is .*, expected one number, 0 or above'):
                assertion(bound)


TIME = np.arange(101) / 100.0


def sine(t: float) -> list[float]:
    return [math.sin(t), 0.5]


def test_a_motion_tracks_a_reference_within_its_largest_error_and_its_rms():
    exact = np.array([sine(t) for t in TIME.tolist()])
    off = exact + np.array([0.02, 0.0])
    off[50, 1] += 0.1
    found = motion(TIME, off)
    for reference in (sine, exact):
        found.assert_tracks(reference, within=0.1001, rms=0.0201)
        found.assert_tracks(reference, rms=0.0201, joint='a')
        found.assert_tracks(reference, within=1e-9, after=0.505, joint='b')
        with pytest.raises(AssertionError) as beyond:
            found.assert_tracks(reference, within=0.05)
        assert str(beyond.value).splitlines()[0] == (
            "joint 'b' is 0.1 rad or m from its target 0.5 rad or m at t = 0.5 s, expected within "
            '0.05 rad or m from t = 0 s on'
        )
        with pytest.raises(
            AssertionError, match=r"the error of joint 'a' has an rms of 0\.02 rad or m, exp"
        ):
            found.assert_tracks(reference, rms=0.019)
    time, (names, times, positions, within) = beyond.value.__dict__['motion']
    assert (time, names, within) == (0.5, ('a', 'b'), 0.05)
    assert (times == TIME).all()
    assert (positions == exact).all()
    for wrong, text in (
        ({'within': 0.1, 'reference': np.zeros((3, 2))}, r'reference is .* of shape \(3, 2\)'),
        ({'within': 0.1, 'reference': [math.nan, 0.0]}, 'expected finite numbers'),
        ({'within': 0.1, 'reference': {'a': 0.0, 'b': 0.5}}, "reference is {'a': 0.0, "),
        ({'within': '1', 'reference': sine}, "within is '1', expected one number"),
        ({'reference': sine}, 'expected within=..., rms=... or both'),
        ({'within': 0.1, 'reference': sine, 'after': 3.0}, 'after is 3 s, expected at most'),
    ):
        with pytest.raises(ValueError, match=text):
            found.assert_tracks(**wrong)


def test_a_motion_that_is_not_finite_tracks_nothing():
    q = np.zeros((101, 2))
    q[70] = math.nan
    with pytest.raises(
        AssertionError, match=r'nan rad or m from its target 0 rad or m at t = 0\.7 s'
    ):
        motion(TIME, q).assert_tracks([0.0, 0.0], within=1.0)


def test_the_tip_of_a_planar_arm_is_where_its_angles_say():
    robot = pfd.load_robot('planar2')
    q = np.array([[0.0, 0.0], [0.3, -0.2]])
    found = Trajectory(
        np.array([0.0, 0.1]), q, 0 * q, 0 * q, robot.joint_names, unlimited(2), robot
    )
    tip = found.tip()
    # Both links turn in one plane: a turn of the first joint keeps the distance from the base.
    turned = Trajectory(
        found.time, q + np.array([0.7, 0.0]), 0 * q, 0 * q, robot.joint_names, unlimited(2), robot
    )
    reach = np.linalg.norm(turned.tip(), axis=1)
    assert np.linalg.norm(tip, axis=1) == pytest.approx(reach)
    found.assert_tip_tracks(tip, within=1e-12)
    with pytest.raises(
        AssertionError, match=r'the tip is \S+ m from its target at t = 0\.1 s, exp'
    ):
        found.assert_tip_tracks(tip[0], within=1e-3)
    with pytest.raises(ValueError, match='the motion has no robot'):
        motion(TIME, np.zeros((101, 2))).tip()


def test_the_time_of_a_controller_is_asserted_and_its_bound_named():
    def slow(_t, q, qd):
        time.sleep(0.002)
        return np.zeros(1)

    with LockstepArm(WHEEL) as arm:
        run = arm.run(slow, 0.01)
    # A sleep is never shorter; how much longer depends on the machine.
    run.assert_computes_within(60.0)
    with pytest.raises(AssertionError, match=r'expected at most 1 ms'):
        run.assert_computes_within(0.001)
    with pytest.raises(ValueError, match=r'quantile is 2, expected 0 to 1'):
        run.assert_computes_within(0.001, quantile=2)


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_a_failed_assertion_says_of_a_wrong_sign_that_the_torque_drives_the_joint_to_its_stop(
    sign,
):
    goal = sign * TARGET
    with LockstepArm(WHEEL, joint_limits=True) as arm:
        run = arm.run(lambda t, q, qd: -20.0 * (goal - q) - 2.0 * qd, 3.0)
    with pytest.raises(AssertionError) as failed:
        run.assert_settles(goal, within=0.01, by=2.0)
    (line,) = str(failed.value).splitlines()[1:]
    limit, force = f'{-1.2 * sign:.4g}', f'{run.tau[-1, 0]:.4g}'
    assert f'position limit {limit} rad, 2 rad from its target {goal:.4g} rad' in line
    assert f'{force} N m, which drives it away from the target (wrong sign?)' in line


def test_a_joint_on_its_way_does_not_rest_and_the_line_has_its_velocity():
    # A damper of 40 N m s/rad holds the wheel at 20 / 40 rad/s.
    with LockstepArm(WHEEL) as arm:
        run = arm.run(lambda t, q, qd: 20.0 - 40.0 * qd, 0.5)
    with pytest.raises(AssertionError) as failed:
        run.assert_settles(TARGET, within=0.01, by=0.2)
    line, off = str(failed.value).splitlines()[1], TARGET - run.q[-1, 0]
    assert f'is {off:.4g} rad from its target 0.8 rad and moves to it at 0.5 rad/s' in line


# What a motion shows: oscillation, and the diagnosis of a joint.

SAMPLE = 1e-3
TIMES = SAMPLE * np.arange(1, 2001)
TURN = 2 * math.pi
NO_LIMIT = (-math.inf, math.inf)
UNITS = {item: unit for item, (unit, _) in JOINT_UNITS.items()}
# A turning point is right to half a step: two of them in more than 1.6 s.
FREQUENCY_TOLERANCE = SAMPLE / 1.6
# A peak between two samples is missed by (2 pi f h / 2)^2 / 2 of its height, at 44 Hz the most.
PEAK_TOLERANCE = (math.pi * 44 * SAMPLE) ** 2 / 2
# That on peaks at random, over 2 s.
GROWTH_TOLERANCE = PEAK_TOLERANCE / 2


def diagnosis(
    q: Any,
    target: Any = None,
    tau: Any = 0.0,
    full: float = math.inf,
    stops: tuple[float, float] = NO_LIMIT,
    period: float = SAMPLE,
    **more: Any,
) -> dict[str, str]:
    """Return the diagnosis of a motion q (N,), with efforts and their limit."""
    limits = {'position': stops, 'velocity': NO_LIMIT, 'effort': (-full, full)}
    state = TIMES, q, np.gradient(q, SAMPLE), np.broadcast_to(tau, q.shape)
    return joint_diagnosis(Samples(*state, target, limits, UNITS, period), **more)


@pytest.mark.parametrize(('frequency', 'growth'), [(3.0, -1.5), (12.5, 0.0), (44.0, 2.0)])
def test_an_oscillation_has_the_frequency_amplitude_and_growth_that_it_was_made_of(
    frequency, growth
):
    signal = 0.7 * np.exp(growth * TIMES) * np.sin(TURN * frequency * TIMES) + 4.0
    found = oscillation(TIMES, signal)
    assert found is not None
    assert found.frequency == pytest.approx(frequency, rel=FREQUENCY_TOLERANCE)
    assert found.growth == pytest.approx(growth, abs=GROWTH_TOLERANCE)
    if growth == 0.0:
        assert found.amplitude == pytest.approx(0.7, rel=PEAK_TOLERANCE)


def test_an_oscillation_from_sample_to_sample_has_half_the_control_rate():
    found = oscillation(TIMES, np.resize([1.0, -1.0], len(TIMES)))
    assert found is not None
    assert found.frequency == pytest.approx(500.0, rel=FREQUENCY_TOLERANCE)
    assert (found.amplitude, found.growth) == (1.0, pytest.approx(0.0, abs=1e-12))


def test_noise_below_a_share_of_the_motion_and_a_single_step_are_no_oscillation():
    noise = np.random.default_rng(0).uniform(-0.01, 0.01, len(TIMES))
    assert oscillation(TIMES, TIMES + noise) is None
    assert oscillation(TIMES, np.exp(-5 * TIMES) * TIMES) is None


def test_noise_is_no_oscillation_and_hides_none():
    noise, wave = np.random.default_rng(0).normal(size=len(TIMES)), 5 * np.sin(TURN * 8 * TIMES)
    assert oscillation(TIMES, noise) is None
    assert oscillation(TIMES, noise + 50 * TIMES) is None
    found = oscillation(TIMES, noise + wave)
    # A turn is where noise makes it: half an eighth of a period off, at either end.
    assert found is not None
    assert found.frequency == pytest.approx(8.0, abs=0.125 / (TIMES[-1] - TIMES[0] - 0.125))
    assert diagnosis(0.9 + 1e-4 * noise, 1.0).keys() == {'offset'}


SINE = 0.5 * np.sin(TURN * 2.0 * TIMES)
FAST = 0.02 * np.sin(TURN * 25 * TIMES)
LATE = 0.5 * np.sin(TURN * 2.0 * (TIMES - 0.02))
HELD = np.minimum(2.0 * TIMES, 0.8)
AWAY = 0.01 * np.exp(3 * TIMES)
# Motion, target or reference, torque, the kind of its first symptom, and numbers with their units.
MOTIONS: dict[str, tuple[Any, Any, Any, str, str]] = {
    'off its target': (
        *(1.1 - np.exp(-9 * TIMES), 1.0, -20.8, 'offset'),
        'rests at 1.1 rad, 0.1 rad from its target 1 rad, with a torque of -20.8 N m',
    ),
    'off, its effort not known': (
        *(1.1 - np.exp(-9 * TIMES), 1.0, np.nan, 'offset'),
        'rests at 1.1 rad, 0.1 rad from its target 1 rad',
    ),
    # Its error changes by less than a tenth in the last tenth of the motion, and it moves.
    'steady and slow': (
        *(0.2 * TIMES, 1.0, 0.0, 'motion'),
        'is 0.6 rad from its target 1 rad and moves to it at 0.2 rad/s',
    ),
    'fast, then at once at rest': (
        *(np.minimum(0.4 * TIMES, 0.799), 1.0, 0.0, 'motion'),
        'is 0.201 rad from its target 1 rad, with a velocity of 0 rad/s',
    ),
    'falls away': (AWAY, 0.0, -5.0, 'divergence', 'growing by 3 /s'),
    'is driven away': (AWAY, 0.0, 5.0, 'driven away', 'is 4.034 rad from its target 0 rad'),
    'runs away with a ripple': (
        AWAY + 0.1 * FAST,
        0.0,
        -5.0,
        'motion',
        'away from it at 12.4 rad/s',
    ),
    'at its end stop': (HELD, 0.5, -3.0, 'end stop', '0.3 rad from its target 0.5 rad'),
    'driven to its end stop': (HELD, -1.0, 4.0, 'end stop', '1.8 rad from its target -1 rad'),
    'about a target': (FAST, 0.0, 0.0, 'oscillation', '25 Hz (0.025 of the control rate)'),
    'no target known': (FAST, None, 0.0, 'oscillation', '25 Hz (0.025 of the control rate)'),
    'its reference': (SINE, SINE, 0.0, 'tracking', 'follows its reference within 0 rad'),
    'behind its reference': (LATE, SINE, 0.0, 'tracking', 'within 0.1253 rad'),
    'half a period behind': (-SINE, SINE, 0.0, 'lost', '1 rad off at t = 0.125 s'),
    'no reference known': (SINE, None, 0.0, '', 'no oscillation'),
    'about a reference': (SINE + FAST, SINE, 0.0, 'oscillation', '25 Hz'),
    'a ramp': (0.3 * TIMES - 0.01, 0.3 * TIMES, 0.0, 'tracking', 'within 0.01 rad'),
}


@pytest.mark.parametrize('name', MOTIONS)
def test_a_motion_is_diagnosed_by_its_target_or_its_reference(name):
    q, target, tau, kind, text = MOTIONS[name]
    found = diagnosis(q, target, tau, stops=(-9.0, 0.8) if q is HELD else NO_LIMIT)
    assert next(iter(found), '') == kind, found
    assert text in text_of(found)
    # A torque is blamed if it points away from the target.
    assert ('wrong sign' in text_of(found)) == ('driven' in name)


@pytest.mark.parametrize(
    ('growth', 'word'), [(-2.0, 'decaying'), (0.0, 'steady'), (0.2, 'steady'), (2.0, 'growing')]
)
def test_an_oscillation_decays_or_grows_only_if_all_of_it_does(growth, word):
    wave = 0.3 * np.exp(growth * TIMES) * np.sin(TURN * 2.0 * TIMES)
    assert word in text_of(diagnosis(wave, 0.0))
    # Smaller ripples at its end do not make it decay.
    rippled = wave + 0.01 * (TIMES > 1.5) * np.sin(TURN * 25 * TIMES)
    assert growth < 0.0 or 'decaying' not in text_of(diagnosis(rippled, 0.0))


def test_an_oscillation_is_compared_with_the_rate_of_the_commands_if_it_is_known():
    assert '(0.1 of the control rate)' in text_of(diagnosis(FAST, 0.0, period=4e-3))
    assert 'control rate' not in text_of(diagnosis(FAST, 0.0, period=math.nan))


def test_commanded_efforts_and_the_ones_that_motors_gave_have_one_diagnosis():
    commanded = 50.0 * np.sin(TURN * 3 * TIMES)
    measured = np.clip(commanded, -20.0, 20.0)
    q = 1.1 - np.exp(-9 * TIMES)
    found = text_of(diagnosis(q, 1.0, commanded, full=20.0))
    assert found == text_of(diagnosis(q, 1.0, measured, full=20.0))
    k = int(np.argmax(np.abs(commanded) >= 20.0))
    assert f'first effort 20 N m at or beyond its limit 20 N m at t = {TIMES[k]:.6g} s' in found
    share = 100 * np.mean(np.abs(commanded) >= 20.0)
    assert f'at the torque limit 20 N m for {share:.3g} % of the time' in found


def test_a_joint_that_was_never_commanded_is_braked_whatever_it_does():
    assert [*diagnosis(FAST, 0.0, 30.0, full=20.0, commanded=False)] == ['never commanded']


def test_what_a_log_does_not_hold_hits_no_limit_and_an_assertion_about_it_is_an_error():
    found = motion([0.0, 0.1], np.zeros((2, 2)), [[math.nan, 1.0]] * 2, effort=[5.0, 5.0])
    found.assert_no_limit_hit()
    found.assert_no_limit_hit('effort', joint='b')
    found.assert_torque_rate_below(1.0, joint='b')
    assert found.symptoms()[0] == 'a: no oscillation, no limit reached'
    for wrong in (found.assert_no_limit_hit, found.assert_torque_rate_below):
        with pytest.raises(ValueError, match="the motion has no effort of joint 'a'"):
            wrong('effort' if wrong == found.assert_no_limit_hit else 1.0)


@pytest.mark.parametrize('q', [AWAY, 2.0 * TIMES, SINE + FAST])
def test_without_velocities_a_diagnosis_is_by_those_of_the_positions(q):
    limits = {'position': NO_LIMIT, 'velocity': NO_LIMIT, 'effort': NO_LIMIT}
    state = TIMES, q, np.full(len(q), math.nan), np.zeros(len(q))
    assert joint_diagnosis(Samples(*state, 0.0, limits, UNITS, SAMPLE)) == diagnosis(q, 0.0)


def test_infinite_numbers_of_a_log_are_no_warnings_but_failed_assertions():
    tau = np.where(TIMES < 1.0, 1.0, math.inf)
    limits = {'position': NO_LIMIT, 'velocity': NO_LIMIT, 'effort': NO_LIMIT}
    state = TIMES, np.zeros(len(TIMES)), np.ones(len(TIMES)), tau
    assert joint_diagnosis(Samples(*state, 0.0, limits, UNITS, SAMPLE))
    found = motion([0.0, 0.1, 0.2], [[math.inf], [0.0], [1.0]], [[0.0], [math.inf], [0.0]])
    assert np.isnan(found.overshoot(1.0)).all()
    with pytest.raises(AssertionError, match='nan % of its step beyond the target'):
        found.assert_overshoot_below(0.5, 1.0)
    lost = motion([0.0, 0.1, 0.2], [[0.0], [math.nan], [1.0]])
    with pytest.raises(AssertionError, match=r"joint 'a' is at nan rad or m at t = 0\.1 s"):
        lost.assert_overshoot_below(0.5, 1.0)
    with pytest.raises(AssertionError, match='is inf rad or m from its target'):
        found.assert_settles(1.0, within=0.1, by=0.0)
    with pytest.raises(AssertionError, match="effort of joint 'a' changes by inf"):
        found.assert_torque_rate_below(1.0)
