# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rules for the inputs of the arm: the verdict on each, and what it does to the arm."""

from __future__ import annotations

import json
from typing import Any

from arm_messages import (
    INF,
    NAN,
    STEP_NS,
    UNLIMITED,
    change,
    efforts,
    failed,
    made,
    named,
    payload,
    placed,
    request,
    same,
    state,
    states,
    tick,
    told,
    trajectory,
    verdict,
    wrench,
)
import gripper_arm
import numpy as np
import pytest

from pfd_ros.arm.description import load_robot as load_arm_robot
from pfd_ros.arm.engine import LARGEST as LARGEST_INPUT
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import LABELS as VERDICT_LABELS
from pfd_ros.arm.events import OPTIONAL as OPTIONAL_OUTPUTS
from pfd_ros.arm.events import Message as ArmMessage
from pfd_ros.arm.other_inputs import MOST_STEPS_AHEAD
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.values import decode_string, encode_string

NAMES, TIP = ('shoulder', 'elbow'), 'tip_link'
START = {'initial_positions': (0.3, -0.2)}
WEIGHTLESS = {'gravity': (0.0, 0.0, 0.0)}
PUSH = efforts(1.0, -0.5)


# Verdicts.

SINCE_NS = 5_000_000_000
FREE = {'robot': 'puma560', 'start_time': 5.0}
# Of three joints: one with both gains, one that follows positions, one that follows velocities.
GAINED = {**FREE, 'servo_p': (100.0, 100.0, *[0.0] * 4), 'servo_d': (10.0, 0.0, 1.0, *[0.0] * 3)}
A, B, C = 'joint1', 'joint2', 'joint3'
PLACED = {'robot': 'planar2', **START}
PUSHED = {'robot': 'planar2', **WEIGHTLESS, 'external_wrench': True}
CLOCKED = {'robot': 'planar2', 'time_source': 'clock', 'publish_clock': False}
WELDED = {'robot': 'puma560', 'locked': ('joint6', 'joint5'), 'locked_positions': (0.25, -0.5)}


def asked(text: str) -> ArmMessage:
    return ArmMessage('requests', encode_string(text))


# Accelerations between points at rest that overflow on the way.
HUGE = {kind: [[0], [0]] for kind in ('positions', 'velocities')} | {
    'accelerations': [[1e308], [0]]
}

# Settings, and by them a message with its verdict, and a part of its detail.
VERDICTS: list[tuple[dict[str, Any], list[tuple[ArmMessage, str, str]]]] = [
    # Its first tick sets time: a trajectory from before would be over at once.
    (CLOCKED, [(trajectory(['elbow'], [1.0], effort=[[1.0]]), 'refused', 'no tick')]),
    (
        FREE,
        [
            (named([A, B], [1, 2]), 'accepted', ''),
            (named([A, B, 'x'], [1, 2, 3]), 'accepted', "unknown joints ['x']"),
            (named([A, B], [1, NAN]), 'accepted', ''),
            (named([A, B], [1, 2], position=[0, 0]), 'accepted', ''),
            (named([A, B], [1, 2], stamp_ns=SINCE_NS), 'accepted', ''),
            (named([], [1, 2]), 'no_names', '~/commands takes efforts without names'),
            (named([A, B], [1]), 'ragged', '2 names and 1 numbers in effort'),
            (named([A, B], [1, INF]), 'infinite', 'is inf'),
            (named([A, B], [-INF, NAN]), 'infinite', 'effort'),
            (named(['x', B], [INF, 1]), 'infinite', 'effort'),
            (named([A], [1], stamp_ns=SINCE_NS - 1), 'stale', f'expected {SINCE_NS} ns or later'),
            (named([A], [1], stamp_ns=-1), 'stale', 'stamp -1 ns'),
            (named([A, A], [1, 2]), 'duplicate_names', 'named twice'),
            (named([A], position=[1]), 'no_effort', 'got only position'),
            (named([A], position=[1], velocity=[2]), 'no_effort', 'only position and velocity'),
            (named([A]), 'no_effort', 'expected one effort for each name'),
            (named(['x', 'y'], [1, 2]), 'unknown_names', "none of ['x', 'y'] is a joint"),
            (named([A, B], [NAN, NAN]), 'unclaimed', 'every number is NaN'),
            (named([A, 'x'], [NAN, 1]), 'unclaimed', ''),
            (efforts(1, 2, 3, 4, 5, 6), 'accepted', ''),
            (efforts(1, 2), 'wrong_size', '2 numbers for 6 joints'),
            (efforts(1, 2, 3, 4, NAN, 6), 'not_finite', ''),
            (tick(5), 'malformed', 'time_source is not clock'),
            (wrench('link6', (1, 0, 0)), 'refused', 'external_wrench:=true'),
            (request('clear_wrench'), 'accepted', ''),
            # However long the names are, the detail is short.
            (named([f'{k}{"x" * 20}' for k in range(1000)], [1] * 1000), 'unknown_names', ''),
            (named([A, *[f'{k}{"x" * 20}' for k in range(1000)]], [1] * 1001), 'accepted', 'x'),
            (named(['x' * 60000], [1]), 'unknown_names', '60000 characters'),
        ],
    ),
    (
        GAINED,
        [
            (named([A, B], position=[1, 2]), 'accepted', ''),
            (named([A, C], velocity=[1, 2]), 'accepted', ''),
            (named([A, B], position=[1, NAN]), 'accepted', ''),
            (named([A, B, C], [1, 2, 3], [1, 2, 3], [1, 2, 3]), 'accepted', ''),
            # A joint without a gain for its target has its effort, or breaks the rule.
            (named([B, C], [NAN, 3], position=[1, 2]), 'accepted', ''),
            (named([B, C], [3, NAN], position=[1, 2]), 'no_effort', f"no effort for ['{C}']"),
            (named([A, C], position=[1, 2]), 'no_effort', 'no servo gain for their targets'),
            (named([A, B], velocity=[1, 2]), 'no_effort', f"['{B}']"),
            (named([A, B], [NAN] * 2, [NAN] * 2, [NAN] * 2), 'unclaimed', ''),
            (named([A, B], position=[1, -1e7]), 'refused', 'position -1e+07, expected 1e+06'),
            (named([A, B], [1, 2], velocity=[1e5, 0]), 'refused', 'velocity 100000'),
            (named(['x', A], position=[1e7, 0]), 'accepted', "unknown joints ['x']"),
        ],
    ),
    (
        GAINED,
        [
            (trajectory([A, B], [0, 1], positions=[[0, 1], [1, 2]]), 'accepted', ''),
            (trajectory([C], [0.1], effort=[[1]]), 'accepted', ''),
            (trajectory([A], [1], 4_500_000_000, positions=[[1]]), 'stale', 'before a reset'),
            (trajectory([A], [1], 10**18, positions=[[1]]), 'future', 'another clock'),
            (trajectory([], [1]), 'no_names', 'no joint names'),
            (trajectory([A, A], [1], positions=[[1, 1]]), 'duplicate_names', 'named twice'),
            (trajectory([A, 'x'], [1], positions=[[1, 1]]), 'unknown_names', "arm: ['x']"),
            (trajectory([A], []), 'malformed', 'there is no point'),
            (trajectory([A], [1, 1], positions=[[1], [1]]), 'malformed', 'do not increase'),
            (trajectory([A], [-1], positions=[[1]]), 'malformed', ''),
            (trajectory([A, B], [1], positions=[[1]]), 'malformed', '1 positions, expected 2'),
            (trajectory([A], [1], positions=[[NAN]]), 'not_finite', f"'{A}' at point 0 is nan"),
            (trajectory([A], [1], velocities=[[0]]), 'no_effort', 'neither positions nor efforts'),
            (
                trajectory([A], [1], positions=[[0]], accelerations=[[0]]),
                'no_effort',
                'accelerations without velocities',
            ),
            (trajectory([A, C], [1], positions=[[1, 1]]), 'no_effort', f"positions of ['{C}']"),
            (trajectory([A], [1], positions=[[1e7]]), 'refused', 'position 1e+07'),
            (trajectory([A], [0.1, 9], **HUGE), 'refused', f"'{A}' would go farther"),
            (trajectory([A], [0.1, 9], effort=[[1e308], [-1e308]]), 'refused', 'efforts overflow'),
            (
                trajectory([A], [1], positions=[[1]], velocities=[[0.1]]),
                'refused',
                'a velocity of the last point is not zero',
            ),
        ],
    ),
    (
        WELDED,
        [
            (named(['joint5', A, 'nobody'], [9, 1, 9]), 'accepted', "locked: ['joint5']"),
            (named(['joint5', A], [NAN, 1]), 'accepted', ''),
            (named(['joint5'], [1]), 'refused', "locked: ['joint5']"),
            (named(['joint6', 'joint5', 'nobody'], [1, 1, 1]), 'refused', 'joint6'),
            (named(['joint5'], [NAN]), 'unclaimed', ''),
            (placed(['joint6', 'nobody'], [1, 2]), 'unknown_names', "joints ['nobody']"),
            (placed(['joint6', 'joint5'], [1, 2]), 'refused', 'no position for any moving joint'),
            (placed([A, 'joint5'], [1, 2]), 'accepted', ''),
        ],
    ),
    ({**WELDED, 'publish_locked': False}, [(named(['joint5'], [1]), 'unknown_names', '')]),
    (
        PLACED,
        [
            (placed([], []), 'no_names', ''),
            (placed(['elbow'], [1e7]), 'refused', 'position 1e+07'),
            (placed(['elbow'], [1], [-1e5]), 'refused', 'velocity -100000'),
            (placed(['elbow', 'nobody'], [1, 2]), 'unknown_names', "unknown joints ['nobody']"),
            (placed(['elbow'], [NAN]), 'refused', 'no position'),
            (placed(['elbow'], []), 'malformed', 'no positions'),
            (placed(['elbow'], [1], effort=[1, 2]), 'ragged', ''),
            (request('step'), 'refused', 'step: the arm is not paused'),
            *(
                (asked(text), 'malformed', '')
                for text in (
                    *('', 'pause', '[]', '{}', '[' * 900, '{"request": "dance"}'),
                    '{"request": ["pause"]}',
                    '{"request": "pause", "count": 1}',
                    '{"request": "step", "count": 0}',
                    '{"request": "step", "count": true}',
                    '{"request": "step", "count": 1e3}',
                    '{"request": "step", "count": 10000000}',
                    json.dumps({'request': 'pause', '%s{0}' * 300: 1}),
                )
            ),
            (change(payload_mass=-1.0), 'refused', 'payload.mass is -1.0'),
            (
                change(payload_mass=1.0, payload_inertia=[1.0, 0.0, 0.0, -1.0, 0.0, 1.0]),
                'refused',
                'must not be negative in any direction',
            ),
            (
                change(payload_mass=1.0, payload_inertia=[1.0, 0.0, 0.0, 1.0, 0.0, 3.0]),
                'refused',
                'payload.inertia is not physically consistent',
            ),
            (change(payload_inertia=[0.0] * 2000), 'malformed', 'holds 2000 values'),
            (change(servo_p=[1.0]), 'refused', 'servo_p holds 1 numbers, expected 2'),
            (change(on_timeout='hold'), 'refused', 'expected servo_p above 0 for every joint'),
            (change(substeps=3), 'malformed', "['substeps'] cannot change while the arm runs"),
            (change(real_time_factor='x'), 'malformed', 'expected a number'),
            (ArmMessage('parameters', encode_string('5')), 'malformed', ''),
            (change(), 'malformed', 'expected at least one'),
            (payload('base_link', 1.0), 'unknown_names', 'does not move with the last link'),
            (payload(TIP, INF), 'refused', 'payload.mass holds inf'),
            (payload(TIP, 1.0, inertia=[0, 1, 0, 0, 0, 0]), 'refused', 'negative'),
            (ArmMessage('payload', b'\0\1\0\0'), 'malformed', 'message ends'),
        ],
    ),
    (
        PUSHED,
        [
            (wrench(TIP, (1, 0, 0)), 'accepted', ''),
            (wrench('nowhere', (1, 0, 0)), 'unknown_names', 'is not a frame of the arm'),
            (wrench('', (1, 0, 0)), 'unknown_names', "expected one of ['tip_link']"),
            (wrench('base_link', (1, 0, 0)), 'unknown_names', 'does not move with'),
            (wrench('%s{0}' * 9999), 'unknown_names', '(49995 characters)'),
            (wrench(TIP, (NAN, 0, 0)), 'not_finite', ''),
            (wrench(TIP, (1e300, 0, 0)), 'refused', 'expected 100000 N'),
            (ArmMessage('external_wrench', b''), 'malformed', 'expected plain CDR'),
            (wrench(TIP)._replace(data=wrench(TIP).data[:-1]), 'malformed', 'message ends'),
        ],
    ),
    (
        {'robot': 'planar2', 'autostart': False},
        [
            (PUSH, 'refused', 'the arm is inactive'),
            (named(['elbow'], [1]), 'refused', 'inactive'),
            (placed(['elbow'], [1]), 'refused', 'inactive'),
            (request('step'), 'refused', 'step: the arm is inactive'),
            (request('reset'), 'refused', 'reset: the arm is inactive'),
            (request('pause'), 'accepted', ''),
            (change(real_time_factor=0.5), 'accepted', ''),
            (request('activate'), 'accepted', ''),
            (PUSH, 'accepted', ''),
        ],
    ),
]


@pytest.mark.parametrize(('settings', 'cases'), VERDICTS, ids=range(len(VERDICTS)))
def test_each_input_has_its_verdict_with_the_reason_and_a_refused_one_changes_nothing(
    settings, cases
):
    engine = made(**settings)
    for message, label, detail in cases:
        before = engine.save()
        produced, (found,) = engine.step([message], run=False)
        assert (found.label, detail in found.detail) == (label, True), (message, found)
        assert len(found.detail) < 700
        assert bool(found.detail) == (label != 'accepted' or bool(detail))
        assert found.accepted == (label == 'accepted')
        if label not in ('accepted', 'unclaimed'):
            (rejection,) = (m.data for m in produced if m.role == 'rejected')
            assert decode_string(rejection) == f'{message.role} {label}\n{found.detail}'
            assert same(before, engine.save())
            engine.state.refused.clear()
        elif message.role != 'requests':
            engine.restore(before)


def test_the_table_above_has_every_label():
    # The future is of lockstep, below, as is NaN after a command.
    labels = {label for _, cases in VERDICTS for _, label, _ in cases}
    assert sorted(labels | {'future', 'all_nan'}) == sorted(VERDICT_LABELS)


@pytest.mark.parametrize('settings', [FREE, GAINED, {**FREE, 'delay_commands': 0.01}])
def test_nan_for_a_joint_that_was_commanded_is_told_and_its_command_is_kept(settings):
    engine = made(**settings)
    engine.step([named([A, B], [1, 2])], run=False)
    before = engine.save()
    produced, (found,) = engine.step([named([A, B, C], [NAN, NAN, NAN])], run=False)
    assert (found.label, f"['{A}', '{B}']" in found.detail) == ('all_nan', True)
    assert [m.role for m in produced] == ['joint_commands', 'rejected']
    assert same(before, engine.save())
    # Nobody has claimed C.
    _, (found,) = engine.step([named([A, B, C], [3, NAN, NAN])], run=False)
    details = {remark.label: remark.detail for remark in found.remarks}
    assert (found.label, f"['{B}']" in details['some_nan']) == ('accepted', True)
    engine.step([request('reset')])
    assert engine.step([named([A], [NAN])], run=False)[1][0].label == 'unclaimed'


def test_a_long_message_is_refused_and_recorded_as_far_as_a_replay_refuses_it_too():
    message = named(['x' * 2 * LARGEST_INPUT], [1.0])
    produced, (found,) = made().step([message], run=False)
    assert found.label == 'malformed'
    assert found.detail == f'more than {LARGEST_INPUT} bytes'
    assert len(produced[0].data) == LARGEST_INPUT + 1
    assert made().step(produced[:1], run=False)[0] == produced


# What commands do.


@pytest.mark.parametrize(
    ('commands', 'wanted'),
    [
        ([named([A, B], [1, NAN], [0.1, 0.2])], [11, 20, 0]),
        # Each kind of number is kept for each joint.
        ([named([A], [1], [0.1]), named([A, C], [NAN, 3], [NAN, 0.4], [0.5, 0.6])], [16, 0, 3.6]),
        ([named([A], position=[0.1], velocity=[0.2]), named([A], [7], [NAN], [NAN])], [19, 0, 0]),
        # A kind without numbers is no command of it: a position alone has no feed-forward.
        ([named([A, B], [1, 2], [0.1, 0.2], [3, 4]), named([B], position=[0.3])], [41, 30, 0]),
        # An effort alone ends the servo, by name and without.
        ([named([A, B], [1, 2], [0.1, 0.2], [3, 4]), named([A], [5])], [5, 22, 0]),
        ([named([A, B], [1, 2], [0.1, 0.2]), efforts(1, 2, 3, 0, 0, 0)], [1, 2, 3]),
    ],
)
def test_servos_add_their_efforts_to_those_fed_forward(commands, wanted):
    engine = made(**GAINED, **UNLIMITED)
    # From rest at zero: effort + p position + d velocity.
    found = state(engine, *commands).effort
    np.testing.assert_allclose(found, [*wanted, 0, 0, 0], rtol=1e-15)


@pytest.mark.parametrize(
    ('first', 'second', 'again'),
    [
        (PUSH, PUSH, ['shoulder', 'elbow']),
        (PUSH, named(['elbow'], [1.0]), ['elbow']),
        (named(['elbow'], [1.0]), PUSH, ['elbow']),
        (named(['elbow'], [1.0]), named(['shoulder'], [1.0]), []),
    ],
)
def test_a_joint_that_is_commanded_again_before_the_next_step_is_counted(first, second, again):
    for settings in ({}, {'delay_commands': 0.002}, {'joints': NAMES[::-1]}):
        engine = made(**settings)
        for _ in range(3):
            _, verdicts = engine.step([first, second])
            details = [remark.detail for found in verdicts for remark in found.remarks]
            assert len(details) == bool(again)
            assert all(repr(name) in details[0] for name in again)


def test_a_stamp_of_the_future_is_refused_in_lockstep_and_else_a_remark():
    engine = made(lockstep=True)
    there = state(engine, PUSH).stamp_ns
    found = verdict(engine, named(['elbow'], [1.0], stamp_ns=there + 1))
    assert (found.label, 'use_sim_time' in found.detail) == ('future', True)
    assert engine.waiting
    assert verdict(engine, named(['elbow'], [1.0], stamp_ns=there)).accepted
    # Under a followed clock the newest tick is not the future.
    engine = made(**CLOCKED, lockstep=True)
    engine.step([tick(100 * STEP_NS), PUSH], run=False)
    engine.step([tick(105 * STEP_NS)])
    assert verdict(engine, named(['elbow'], [1.0], stamp_ns=106 * STEP_NS)).label == 'future'
    assert verdict(engine, named(['elbow'], [1.0], stamp_ns=105 * STEP_NS)).accepted
    free = made()
    assert verdict(free, named(['elbow'], [1.0], stamp_ns=STEP_NS)).remarks == ()
    found = verdict(free, named(['elbow'], [1.0], stamp_ns=1_700_000_000 * 1_000_000_000))
    assert [remark.label for remark in found.remarks] == ['future', 'overwritten']


# Requests, lockstep, activity, a followed clock.


def test_a_state_of_joint_states_is_sent_back_as_it_came():
    for settings in ({}, {'robot': 'puma560', **WELDED}):
        engine = made(**settings)
        count = len(engine.names)
        saved = told(engine, efforts(*np.ones(count)), cycles=3)['joint_states']
        before = state(made(**settings), ArmMessage('set_state', saved))
        for _ in range(3):
            # Also after a jump and a reset, which are later than its stamp.
            state(engine, request('reset'))
            there = state(engine, ArmMessage('set_state', saved))
            assert there.position.tobytes() == before.position.tobytes()
            assert there.velocity.tobytes() == before.velocity.tobytes()
            assert before.velocity[:count].all()
            assert not there.effort.any()


def test_a_jump_outside_the_stops_is_accepted_and_remarked():
    for stops, outside in ((True, True), (False, False)):
        engine = made(robot=gripper_arm.urdf(), locked=('finger',), joint_limits=stops)
        found = verdict(engine, placed(['shoulder'], [3.5]))
        assert found.accepted
        assert [remark.label for remark in found.remarks] == ['outside_stops'] * outside
        assert not outside or "'shoulder' is at 3.5, its stops at -3" in found.detail
        assert state(engine).position[0] == 3.5
        assert not verdict(engine, placed(['shoulder'], [2.0])).remarks


def test_a_jump_of_some_joints_of_an_arm_that_has_run_away_is_refused():
    engine = made(robot='puma560', substeps=1, **UNLIMITED)
    assert np.abs(state(engine, efforts(*[1e40] * 6)).position).max() > 1e10
    found = verdict(engine, placed([A], [0.0]))
    assert found.label == 'refused'
    assert 'q must be finite' in found.detail
    assert verdict(engine, placed(engine.names, [0.5] * 6)).accepted
    assert state(engine).position.tolist() == [0.5] * 6


def test_in_lockstep_the_arm_waits_at_published_states_alone():
    engine = made(lockstep=True, wait_for_controller=True)
    assert engine.waiting
    assert len(states(engine, PUSH, cycles=9)) == 1
    engine = made(lockstep=True, publish_rate=250.0)
    engine.step([PUSH], run=False)
    for cycle in range(1, 13):
        assert not engine.waiting
        engine.step()
        assert engine.published == engine.waiting == (cycle % 4 == 0)
        engine.step([PUSH] if engine.waiting else [], run=False)
    dropping = made(lockstep=True, drop_state=0.5)
    found = []
    for _ in range(100):
        produced, _ = dropping.step([PUSH])
        shown = 'joint_states' in [m.role for m in produced]
        found.append((shown, dropping.published, dropping.waiting))
    assert set(found) == {(True, True, True), (False, False, False)}


@pytest.mark.parametrize('start', [0.0, 1e-10, 0.0005])
def test_a_second_answer_to_the_first_state_of_a_run_in_lockstep_is_stale(start):
    waits = {'lockstep': True, 'wait_for_controller': True, 'start_time': start}
    engine = made(**{**waits, 'start_time': Settings(**waits).started(7.0, 0).start_time})
    answer = named(NAMES, [1.0, 2.0], stamp_ns=engine.stamp_ns)
    assert [engine.step([answer])[1][0].label for _ in range(2)] == ['accepted', 'stale']
    # A state that waits for an answer after an activation is sent again, too.
    answer = named(NAMES, [1.0, 2.0], stamp_ns=engine.stamp_ns)
    assert verdict(engine, request('deactivate'), request('activate'), answer).accepted


def test_after_a_reset_a_failed_arm_continues_at_the_time_of_its_cycle():
    engine, fresh = failed(**START), made(**START, **UNLIMITED)
    assert engine.state.failures == 1
    assert verdict(engine, payload(TIP, 1.0)).detail == 'the simulation has stopped'
    stopped = state(engine, cycles=50)
    for name in ('pause', 'deactivate'):
        engine.step([request(name)], run=False)
        assert engine.waiting
        engine.step([request({'pause': 'resume', 'deactivate': 'activate'}[name])], run=False)
    assert np.isfinite([stopped.position, stopped.velocity, stopped.effort]).all()
    after = state(engine, request('reset'))
    assert (engine.state.failure, engine.state.failures) == ('', 1)
    assert after.stamp_ns == engine.state.cycle * STEP_NS > stopped.stamp_ns + 50 * STEP_NS
    assert after.position.tolist() == [0.3, -0.2]
    one, other = (state(each, efforts(1.0, 2.0), cycles=20) for each in (engine, fresh))
    assert one.position.tobytes() == other.position.tobytes()
    assert one.velocity.tobytes() == other.velocity.tobytes()


def test_simulated_time_ends_where_stamps_end_and_the_arm_says_so():
    engine = made(**CLOCKED)
    end_ns = (1 << 31) * 1_000_000_000
    engine.step([tick(end_ns - 3 * STEP_NS)], run=False)
    assert [each.stamp_ns for each in states(engine, tick(end_ns - 1), cycles=9)] == [
        end_ns - 2 * STEP_NS,
        end_ns - STEP_NS,
    ]
    free = made(start_time=2e9)
    free.state.origin_ns = end_ns - 3 * STEP_NS
    assert state(free, cycles=9).stamp_ns == end_ns - STEP_NS
    assert 'simulated time is at its end' in free.state.failure


def run(engine: Engine, *messages: ArmMessage) -> int:
    """Step until the arm stands, and return its simulated time, ms."""
    engine.step(messages, run=False)
    for _ in range(1000):
        if engine.waiting:
            return engine.stamp_ns // STEP_NS
        engine.step()
    raise AssertionError('it never stands')


def ms(time: int) -> ArmMessage:
    return tick(time * STEP_NS)


def test_time_begins_at_the_first_tick_and_steps_go_up_to_each_later_one():
    engine = made(**CLOCKED, step_size=0.002)
    assert engine.waiting
    for now, expected, cycles in ((7000, 7000, 0), (7001, 7000, 0), (7002, 7002, 1), (11, 0, 0)):
        found = verdict(engine, ms(now))
        assert found.label == ('stale' if now == 11 else 'accepted')
        assert run(engine) == expected or now == 11
        assert engine.state.cycle == cycles or now == 11
    assert run(engine, ms(7011)) == 7010
    assert engine.state.cycle == 5


def test_a_resumed_arm_does_not_catch_up_with_its_clock():
    for pause, resume in (('pause', 'resume'), ('deactivate', 'activate')):
        engine = made(**CLOCKED)
        assert run(engine, ms(100), request(pause), ms(200)) == 100
        assert run(engine, request(resume), ms(300)) == 300
        assert engine.state.cycle == 0


def test_a_tick_far_ahead_is_refused_until_a_reset_sets_the_time():
    engine = made(**CLOCKED)
    far = 101 + MOST_STEPS_AHEAD
    assert run(engine, ms(100)) == 100
    assert verdict(engine, ms(far)).label == 'refused'
    engine.step([request('reset')])
    assert engine.waiting
    assert verdict(engine, ms(99)).label == 'stale'
    assert run(engine, ms(far)) == far
    # The jump of the reset is the step to the next tick.
    assert run(engine, ms(far + 1)) == far + 1
    assert engine.state.cycle == 1


def test_the_clock_of_a_failed_arm_continues_and_a_reset_clears_the_failure():
    engine = made(**CLOCKED, **UNLIMITED)
    run(engine, ms(7000), efforts(1e300, 1e300), ms(7050))
    assert engine.state.failure
    assert engine.state.cycle == 50
    run(engine, ms(7060))
    assert engine.state.cycle == 60
    # A reset lets time leap to the next tick.
    assert run(engine, request('reset'), ms(7100), ms(7110)) == 7110
    assert not engine.state.failure


# Floods, and what the roles are for.


def test_a_flood_of_refused_inputs_is_counted_beyond_64_kb_a_second():
    engine = made()
    flood = [named(['x' * 1000], [1.0])] * 100
    produced, verdicts = engine.step(flood, run=False)
    recorded = sum(m.role == 'joint_commands' for m in produced)
    assert recorded == sum(m.role == 'rejected' for m in produced)
    assert 50 < recorded < 70
    assert len(verdicts) == 100
    # Another kind has a share of its own, and what is accepted is always recorded.
    produced, _ = engine.step([efforts(1.0), PUSH], run=False)
    assert [m.role for m in produced] == ['commands', 'rejected', 'commands']
    counts = [m for _ in range(1000) for m in engine.step()[0] if m.role == 'rejected_counts']
    (text,) = (decode_string(m.data) for m in counts)
    assert text == f'joint_commands unknown_names\n{100 - recorded} more in this second'
    assert counts[0].cycle == 0
    produced, _ = engine.step(flood[:1], run=False)
    assert [m.role for m in produced] == ['joint_commands', 'rejected']
    # A refusal after which lockstep goes on is recorded in any flood.
    engine = made(lockstep=True, reflex_effort_rate=2000.0)
    engine.step([efforts(1.0, 0.0)])
    engine.step([efforts(9.0, 0.0)])
    engine.step([named(NAMES, [0.0, 0.0])] * 2000)
    assert engine.waiting
    produced, _ = engine.step([named(NAMES, [0.0, 0.0])] * 3)
    assert [m.role for m in produced][:2] == ['joint_commands', 'rejected']
    assert len(produced) == 4


@pytest.mark.parametrize('roles', [(), ('joint_states',), ('commands', 'clock', 'true_states')])
def test_only_the_roles_that_somebody_needs_are_encoded_and_the_arm_moves_the_same(roles):
    settings = Settings(robot='planar2', outputs=OPTIONAL_OUTPUTS, external_wrench=True)
    robot = load_arm_robot(settings, 'planar2')
    engine, other = Engine(settings, robot), Engine(settings, robot, roles)
    for events in ([PUSH], [efforts(1.0)], [payload(TIP, 1.0)], [wrench(TIP, (1, 2, 3))], []):
        produced, verdicts = engine.step(events)
        wanted = [m for m in produced if m.role in roles]
        assert other.step(events) == (wanted, verdicts)
    assert same(engine.save(), other.save())


def test_outputs_come_in_the_order_of_the_table_each_at_its_rate():
    settings = {'publish_rate': 500.0, 'clock_rate': 250.0, 'outputs': OPTIONAL_OUTPUTS}
    engine = made(**settings)
    found = [[m.role for m in engine.step()[0]] for _ in range(4)]
    shown = ['joint_states', *OPTIONAL_OUTPUTS]
    assert found == [[], shown, [], [*shown, 'clock']]
    produced, _ = engine.step([efforts(1.0), payload(TIP, 1.0)])
    assert [m.role for m in produced] == ['commands', 'rejected', 'payload', 'payload_in_use']
    assert {m.cycle for m in produced} == {5}
    again = engine.present()
    assert [m.role for m in again] == [*shown, 'clock']
    assert engine.present() == again
    assert [m.role for m in made(publish_clock=False).step()[0]] == ['joint_states']


def test_a_state_that_is_presented_again_is_the_same_message():
    settings = {'noise_position': 1.0, 'delay_state': 0.002, 'external_wrench': True}
    engine = made(**settings, outputs=('tip_wrench', 'true_states'), lockstep=True)
    produced, _ = engine.step([PUSH, wrench(TIP, (1.0, 0.0, 0.0))])
    engine.step([wrench(TIP, (2.0, 0.0, 0.0))])
    shown = {'joint_states', 'tip_wrench', 'true_states', 'clock'}
    assert engine.present() == [m for m in produced if m.role in shown]
