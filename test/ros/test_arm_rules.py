# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rules for the inputs of the arm: the verdict on each, and what it does to the arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import json
from typing import Any

from arm_messages import (
    INF,
    NAN,
    STEP_NS,
    UNLIMITED,
    change,
    decode_array,
    efforts,
    failed,
    made,
    named,
    payload,
    placed,
    request,
    state,
    states,
    tick,
    trajectory,
    verdict,
    wrench,
)
from effect_cases import example
import numpy as np
import pinocchio as pin
import pytest
from ros_processes import example_robot

import pfd_core as pfd
from pfd_ros.arm.description import load_robot as load_arm_robot
from pfd_ros.arm.engine import LARGEST as LARGEST_INPUT
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import LABELS as VERDICT_LABELS
from pfd_ros.arm.events import OPTIONAL as OPTIONAL_OUTPUTS
from pfd_ros.arm.events import Message as ArmMessage
from pfd_ros.arm.noise import Channel as NoiseChannel
from pfd_ros.arm.noise import uniform as noise_uniform
from pfd_ros.arm.other_inputs import MOST_STEPS_AHEAD
from pfd_ros.arm.plant import scene_of, with_scene_text
from pfd_ros.arm.plant_settings import EFFECT_FIELDS as ARM_EFFECT_FIELDS
from pfd_ros.arm.plant_settings import joint_settings
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.numbers import decode_numbers
from pfd_ros.messages.text_and_arrays import decode_string, encode_string
from pfd_ros.messages.types import INERTIA as INERTIA_TYPE

NAMES, TIP = ('shoulder', 'elbow'), 'tip_link'
START = {'initial_positions': (0.3, -0.2)}
SERVO: dict[str, Any] = {'servo_p': (400.0, 200.0), 'servo_d': (40.0, 10.0)}
WEIGHTLESS = {'gravity': (0.0, 0.0, 0.0)}
PUSH = efforts(1.0, -0.5)


def taus(engine: Engine, cycles: int, *messages: ArmMessage) -> list[list[float]]:
    """Return the efforts of the next cycles."""
    return [each.effort.tolist() for each in states(engine, *messages, cycles=cycles)]


def told(engine: Engine, *messages: ArmMessage, cycles: int = 1) -> dict[str, bytes]:
    """Run some cycles, the messages before the first; return the last message of each role."""
    found: dict[str, bytes] = {}
    for k in range(cycles):
        found |= {m.role: m.data for m in engine.step(messages if k == 0 else ())[0]}
    return found


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
    settings: dict[str, Any], cases: list[tuple[ArmMessage, str, str]]
) -> None:
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


def test_the_table_above_has_every_label() -> None:
    # The future is of lockstep, below, as is NaN after a command.
    labels = {label for _, cases in VERDICTS for _, label, _ in cases}
    assert sorted(labels | {'future', 'all_nan'}) == sorted(VERDICT_LABELS)


@pytest.mark.parametrize('settings', [FREE, GAINED, {**FREE, 'delay_commands': 0.01}])
def test_nan_for_a_joint_that_was_commanded_is_told_and_its_command_is_kept(
    settings: dict[str, Any],
) -> None:
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


def same(one: Any, other: Any) -> bool:
    """Return whether two states have the same bits, but for what was refused."""
    fields = {name: value for name, value in vars(one).items() if name != 'refused'}
    return all(bits(value) == bits(vars(other)[name]) for name, value in fields.items())


def bits(value: Any) -> Any:
    """Return a value of a state as one that can be compared."""
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, pfd.SimulationState):
        return {name: array.tobytes() for name, array in value.arrays.items()}, value.status
    if isinstance(value, pfd.MotorState):
        return [array.tobytes() for array in (value.peaks, value.before, value.counts)]
    if isinstance(value, list | tuple):
        return [bits(each) for each in value]
    return repr(value)


def test_a_long_message_is_refused_and_recorded_as_far_as_a_replay_refuses_it_too() -> None:
    message = named(['x' * 2 * LARGEST_INPUT], [1.0])
    produced, (found,) = made().step([message], run=False)
    assert found.label == 'malformed'
    assert found.detail == f'{len(message.data)} bytes, expected {LARGEST_INPUT} at most'
    assert len(produced[0].data) == LARGEST_INPUT + 1
    assert made().step(produced[:1], run=False)[1][0].label == 'malformed'


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
def test_servos_add_their_efforts_to_those_fed_forward(
    commands: list[ArmMessage], wanted: list[float]
) -> None:
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
def test_a_joint_that_is_commanded_again_before_the_next_step_is_counted(
    first: ArmMessage, second: ArmMessage, again: list[str]
) -> None:
    for settings in ({}, {'delay_commands': 0.002}, {'joints': NAMES[::-1]}):
        engine = made(**settings)
        for _ in range(3):
            _, verdicts = engine.step([first, second])
            details = [remark.detail for found in verdicts for remark in found.remarks]
            assert len(details) == bool(again)
            assert all(repr(name) in details[0] for name in again)


def test_a_stamp_of_the_future_is_refused_in_lockstep_and_else_a_remark() -> None:
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


def test_a_state_of_joint_states_is_sent_back_as_it_came() -> None:
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


def test_a_jump_outside_the_stops_is_accepted_and_remarked() -> None:
    for stops, outside in ((True, True), (False, False)):
        engine = made(robot='puma560', joint_limits=stops)
        found = verdict(engine, placed([A], [3.0]))
        assert found.accepted
        assert [remark.label for remark in found.remarks] == ['outside_stops'] * outside
        assert not outside or "'joint1' is at 3, its stops at -2.79" in found.detail
        assert state(engine).position[0] == 3.0
        assert not verdict(engine, placed([A], [2.0])).remarks


def test_a_jump_of_some_joints_of_an_arm_that_has_run_away_is_refused() -> None:
    engine = made(robot='puma560', substeps=1, **UNLIMITED)
    assert np.abs(state(engine, efforts(*[1e40] * 6)).position).max() > 1e10
    found = verdict(engine, placed([A], [0.0]))
    assert found.label == 'refused'
    assert 'q must be finite' in found.detail
    assert verdict(engine, placed(engine.names, [0.5] * 6)).accepted
    assert state(engine).position.tolist() == [0.5] * 6


def test_in_lockstep_the_arm_waits_at_published_states_alone() -> None:
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


def test_after_a_reset_a_failed_arm_continues_at_the_time_of_its_cycle() -> None:
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


def test_simulated_time_ends_where_stamps_end_and_the_arm_says_so() -> None:
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


def test_time_begins_at_the_first_tick_and_steps_go_up_to_each_later_one() -> None:
    engine = made(**CLOCKED, step_size=0.002)
    assert engine.waiting
    for now, expected, cycles in ((7000, 7000, 0), (7001, 7000, 0), (7002, 7002, 1), (11, 0, 0)):
        found = verdict(engine, ms(now))
        assert found.label == ('stale' if now == 11 else 'accepted')
        assert run(engine) == expected or now == 11
        assert engine.state.cycle == cycles or now == 11
    assert run(engine, ms(7011)) == 7010
    assert engine.state.cycle == 5


def test_a_resumed_arm_does_not_catch_up_with_its_clock() -> None:
    for pause, resume in (('pause', 'resume'), ('deactivate', 'activate')):
        engine = made(**CLOCKED)
        assert run(engine, ms(100), request(pause), ms(200)) == 100
        assert run(engine, request(resume), ms(300)) == 300
        assert engine.state.cycle == 0


def test_a_tick_far_ahead_is_refused_until_a_reset_sets_the_time() -> None:
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


def test_the_clock_of_a_failed_arm_continues_and_a_reset_clears_the_failure() -> None:
    engine = made(**CLOCKED, **UNLIMITED)
    run(engine, ms(7000), efforts(1e300, 1e300), ms(7050))
    assert engine.state.failure
    assert engine.state.cycle == 50
    run(engine, ms(7060))
    assert engine.state.cycle == 60
    # A reset lets time leap to the next tick.
    assert run(engine, request('reset'), ms(7100), ms(7110)) == 7110
    assert not engine.state.failure


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
def test_targets_between_points_are_the_polynomial_of_their_degree(shapes, kinds: int) -> None:
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


def test_the_arm_moves_from_its_state_to_the_first_point_and_holds_the_last() -> None:
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


def test_continuous_joints_take_the_short_way_to_the_first_point_and_others_do_not() -> None:
    # As wraparound_joint in trajectory.cpp of joint_trajectory_controller.
    engine = made(**SERVO, **WEIGHTLESS, initial_positions=(6.4, -6.2))
    plan = trajectory(NAMES, [1.0, 2.0], positions=[[0.1, 0.1], [0.2, 4.0]])
    last = state(engine, plan, cycles=4000).position
    np.testing.assert_allclose(last, [0.2 + 2 * np.pi, 4.0 - 2 * np.pi], rtol=0, atol=1e-6)
    bounded = made(robot='puma560', servo_p=(9.0,) * 6, initial_positions=(0.0,) * 5 + (4.6,))
    states(bounded, trajectory(('joint6',), [0.1], positions=[[-4.6]]), cycles=200)
    assert bounded.state.newest[2, 5] == -4.6


def test_efforts_are_linear_between_points_need_no_gains_and_stay() -> None:
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
def test_a_trajectory_ends_with_the_next_command_a_jump_a_reset_and_a_stop(event) -> None:
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
def test_joints_that_the_next_command_does_not_name_come_to_rest_at_the_last_target(event) -> None:
    engine = made(**SERVO, **START, **WEIGHTLESS)
    states(engine, PLANNED, cycles=500)
    there = engine.state.newest[2, 0]
    assert engine.state.newest[3, 0] == pytest.approx(0.7)
    near = state(engine, event, cycles=3000)
    np.testing.assert_allclose(near.position, [there, 0.0], rtol=0, atol=1e-6)


def test_a_sample_is_lost_delayed_and_seen_by_the_watchdog_as_a_command_is() -> None:
    engine = made(**SERVO, **START, delay_commands=0.005, drop_commands=0.5, command_timeout=0.1)
    states(engine, PLANNED, cycles=400)
    assert engine.state.timeouts == 0
    assert 100 < engine.state.lost < 300
    target = engine.state.acting[2, 0]
    assert 0.3 + 0.7 * 0.37 < target < 0.3 + 0.7 * 0.3951


def test_a_trajectory_continues_after_a_pause_where_it_was_with_a_followed_clock_too() -> None:
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


def test_in_lockstep_the_arm_waits_for_an_answer_from_the_last_point_on() -> None:
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


def test_a_watchdog_waits_for_the_first_command_and_acts_once_after_the_last() -> None:
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


def test_refused_and_nan_messages_do_not_feed_the_watchdog_and_a_pause_is_no_silence() -> None:
    engine = made(command_timeout=0.005)
    engine.step([efforts(1.0, 0.5)])
    for _ in range(5):
        engine.step([efforts(1.0), named(NAMES, [NAN, NAN])])
    assert engine.state.timed_out
    engine.step([efforts(1.0, 0.5), request('pause')])
    for _ in range(20):
        engine.step()
    assert taus(engine, 5, request('resume')) == [[1.0, 0.5]] * 5


def test_on_timeout_zero_commands_zero_effort_and_leaves_brakes_on() -> None:
    engine = made(command_timeout=0.005, on_timeout='zero', **WEIGHTLESS)
    assert taus(engine, 7, named(['shoulder'], [2.0])) == [[2.0, 0.0]] * 5 + [[0.0, 0.0]] * 2
    velocity = state(engine, cycles=20).velocity
    # Stretched, a rod of 2 kg and 1 m about its end; without gravity its speed stays.
    assert velocity[0] == pytest.approx(5e-3 * 2.0 / (2.0 / 3.0), rel=1e-6)
    assert velocity[1] == 0.0


def test_on_timeout_hold_keeps_the_position_at_the_timeout_by_the_servo() -> None:
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


def test_a_delayed_command_acts_some_cycles_later_and_is_judged_at_once() -> None:
    engine = made(delay_commands=0.003)
    _, (found,) = engine.step([efforts(1.0, 0.5)])
    assert found.accepted
    commands = named(['elbow'], [9.0]), named(['shoulder'], [7.0])
    assert taus(engine, 4, *commands) == [[0.0, 0.0]] * 2 + [[1.0, 0.5], [7.0, 9.0]]


def test_a_delay_acts_on_targets_and_not_on_the_torques_of_a_servo() -> None:
    late, prompt = made(delay_commands=0.004, **SERVO), made(**SERVO)
    target = named(NAMES, position=[0.1, -0.1])
    taus(late, 4, target)
    assert taus(late, 100) == taus(prompt, 100, target)


@pytest.mark.parametrize('event', [request('reset'), placed(NAMES, [0.3, 0.3])])
def test_a_reset_and_a_jump_discard_delayed_commands_and_targets(event: ArmMessage) -> None:
    engine = made(delay_commands=0.003, command_timeout=0.004)
    taus(engine, 2, efforts(1.0, 0.5))
    assert not any(map(any, taus(engine, 30, event)))
    assert engine.state.timeouts == 0
    engine = made(**SERVO)
    state(engine, named(NAMES, position=[1.0, 1.0]))
    assert taus(engine, 3, event)[1:] == [[0.0, 0.0]] * 2


def test_the_watchdog_counts_from_where_the_delay_ends() -> None:
    engine = made(delay_commands=0.003, command_timeout=0.002)
    found = taus(engine, 7, efforts(1.0, 0.5))
    assert found == [[0.0, 0.0]] * 3 + [[1.0, 0.5]] * 2 + [[0.0, 0.0]] * 2
    assert engine.state.timeouts == 1


def test_a_share_of_the_commands_is_lost_by_the_seed_and_changes_nothing() -> None:
    engine, last = made(drop_commands=0.25, seed=7), 0.0
    lost = [noise_uniform(7, NoiseChannel.COMMAND_DROP, k, 1)[0] < 0.25 for k in range(1, 2001)]
    for k in range(2000):
        last = last if lost[k] else float(k % 9)
        assert taus(engine, 1, efforts(float(k % 9), 0.0)) == [[last, 0.0]]
    assert engine.state.lost == sum(lost)
    # Four standard deviations of a binomial distribution.
    assert abs(engine.state.lost - 500) < 4 * np.sqrt(2000 * 0.25 * 0.75)


def test_a_lost_command_answers_in_lockstep_and_does_not_start_the_watchdog() -> None:
    engine = made(drop_commands=1.0, command_timeout=0.002, lockstep=True)
    assert taus(engine, 9, efforts(1.0, 0.5)) == [[0.0, 0.0]]
    assert engine.waiting
    assert verdict(engine, efforts(1.0, 0.5)).accepted
    assert not engine.waiting
    assert (engine.state.lost, engine.state.timeouts) == (2, 0)


# Actuators: the reflex, limits, servos.

# 2000 N m/s are 2 N m in a cycle of a millisecond.
REFLEX, OFF = {'reflex_effort_rate': 2000.0}, {'reflex_effort_rate': 0.0}


def test_a_jump_of_an_effort_closes_the_brakes_until_a_reset() -> None:
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
def test_a_reflex_sees_the_efforts_that_are_wanted(
    settings: dict[str, Any], commands: list[list[ArmMessage]], trips: int
) -> None:
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
def test_efforts_stay_within_the_limits_of_the_motors(
    settings: dict[str, Any], effort: Any, qd: Any, wanted: list[float]
) -> None:
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
def test_limits_of_the_scene_replace_the_parameters(scene: pfd.Scene, wanted: Any) -> None:
    engine = made(scene=pfd.scene_to_yaml(scene))
    assert acted(engine, (1e3, -1e3), (40.0, 40.0)) == wanted


@pytest.mark.parametrize(('masses', 'most'), [((1.0, 1.0), 1000.0), ((400.0, 100.0), 25_000.0)])
def test_a_joint_whose_model_states_no_limit_gets_a_wide_one(masses, most) -> None:
    # 1000 N m at least, or the weight of all links at 5 m.
    limits = {'effort_limit': np.array([INF, 10.0]), 'masses': np.array(masses)}
    robot = replace(pfd.load_robot('planar2'), velocity_limit=np.array([INF, 20.0]), **limits)
    engine = Engine(Settings(robot='planar2', **WEIGHTLESS), robot)
    assert acted(engine, (1e9, 1e9), (99.0, 0.0)) == [most, 10.0]
    assert acted(engine, (1e9, 0.0), (150.0, 0.0))[0] == pytest.approx(most / 2)


# Sensors and noise.


def table(messages: list[Any], kind: str) -> np.ndarray:
    return np.array([getattr(message, kind) for message in messages])


def test_noise_has_its_standard_deviation_and_leaves_the_true_motion_alone() -> None:
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


def test_a_bias_is_added_in_the_order_in_which_joints_are_published() -> None:
    order = {'joints': NAMES[::-1], 'initial_positions': (-0.2, 0.3)}
    true = states(made(**order), PUSH, cycles=3)
    for kind in ('position', 'velocity', 'effort'):
        biased = states(made(**order, **{f'bias_{kind}': (0.25, 0.0)}), PUSH, cycles=3)
        assert biased[0].names == NAMES[::-1]
        assert (table(biased, kind) == table(true, kind) + np.array([0.25, 0.0])).all()


def test_measured_numbers_are_the_nearest_steps_of_the_encoder_and_finite() -> None:
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


def test_a_delayed_state_is_the_one_of_earlier_under_the_stamp_of_now() -> None:
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


def test_a_reset_shows_at_once_and_repeats_noise_and_losses_and_a_jump_does_not() -> None:
    settings = {'noise_position': 1e-4, 'noise_velocity': 1e-2, 'drop_state': 0.25, 'seed': 5}
    engine = made(**START, **settings, drop_commands=0.5)

    def episode() -> list[tuple[int, list[float], list[float]]]:
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


def test_other_noise_while_the_arm_runs_keeps_the_states_under_way() -> None:
    settings = {**START, 'delay_state': 0.003, 'noise_position': 1e-4, 'seed': 5}
    engine, steady = made(**settings, noise_velocity=1e-2), made(**settings)
    for each in (engine, steady):
        states(each, PUSH, cycles=30)
    engine.step([change(noise_velocity=0.0)], run=False)
    assert engine.measured().tobytes() == steady.measured().tobytes()


def test_locked_joints_are_published_after_the_others_at_rest_without_errors() -> None:
    engine = made(**WELDED, joints=('joint4', A, B, C), noise_position=1.0, bias_effort=(1.0,) * 4)
    found = state(engine, efforts(1, 2, 3, 4), cycles=5)
    assert found.names == ('joint4', A, B, C, 'joint6', 'joint5')
    assert found.position[4:].tolist() == [0.25, -0.5]
    assert found.velocity[4:].tolist() == found.effort[4:].tolist() == [0.0, 0.0]
    assert found.effort[:4].tolist() == [2, 3, 4, 5]
    assert found.velocity[:4].all()
    assert state(made(**WELDED, publish_locked=False)).names == (A, B, C, 'joint4')


# The wrench and the payload, against Pinocchio.

UR5 = str(example_robot('ur_description/urdf/ur5_robot.urdf'))
POSE = (0.3, -1.2, 0.9, 0.4, -0.7, 1.1)
TAU = (1.0, -20.0, 5.0, 0.3, -0.2, 0.1)
CENTER, INERTIA = (0.1, -0.02, 0.05), (0.02, 0.001, -0.002, 0.03, 0.003, 0.025)


def moving_ur5(*messages: ArmMessage, **settings: Any) -> tuple[Any, np.ndarray]:
    """Return the last state of an arm that has moved, and its accelerations."""
    given = {'robot': UR5, 'initial_positions': POSE, 'step_size': 1e-4, **settings}
    engine = made(**given, outputs=('acceleration',))
    assert all(engine.step([efforts(*TAU), *messages], run=False)[1])
    last = state(engine, cycles=199)
    qdd = decode_array(told(engine)['acceleration']).values
    row = engine.state.rows[engine.state.now]
    assert np.abs(last.velocity).max() > 0.05
    return row, qdd


def test_a_wrench_and_a_payload_in_carried_frames_move_the_arm_as_in_pinocchio() -> None:
    for frame in ('wrist_3_link', 'tool0', 'ee_link'):
        pushed = wrench(frame, (12.0, -7.0, 20.0), (0.8, -1.5, 0.6))
        loaded = payload(frame, 2.5, CENTER, INERTIA)
        (q, qd, _), qdd = moving_ur5(pushed, loaded, external_wrench=True)
        model = pin.buildModelFromUrdf(UR5)
        place = model.frames[model.getFrameId(frame)]
        xx, xy, xz, yy, yz, zz = INERTIA
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        without = pin.aba(model, model.createData(), q, qd, np.array(TAU))
        body = pin.Inertia(2.5, np.array(CENTER), inertia)
        model.appendBodyToJoint(place.parentJoint, body, place.placement)
        # Force and torque at the frame's origin, brought to the frame of its joint.
        force = pin.Force(np.array([12.0, -7.0, 20.0]), np.array([0.8, -1.5, 0.6]))
        forces = pin.StdVec_Force()
        forces.extend([pin.Force.Zero() for _ in range(model.njoints)])
        forces[place.parentJoint] = place.placement.act(force)
        wanted = pin.aba(model, model.createData(), q, qd, np.array(TAU), forces)
        assert np.abs(wanted - without).max() > 1.0
        np.testing.assert_allclose(qdd, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())


def pushes(engine: Engine, *messages: ArmMessage) -> list[bool]:
    """Return whether each of the next ten steps is pushed, as ~/tip_wrench tells."""
    found = []
    for k in range(10):
        data = told(engine, *(messages if k == 0 else ()))['tip_wrench']
        found.append(any(decode_numbers(data, 'geometry_msgs/msg/WrenchStamped').values))
    return found


def test_a_wrench_holds_until_it_is_replaced_cleared_or_the_arm_reset() -> None:
    engine, on = made(**PUSHED), wrench(TIP, (0.0, 3.0, 0.0))
    assert pushes(engine) == [False] * 10
    assert pushes(engine, efforts(0.0, 0.0), on) == [True] * 10
    assert state(engine).velocity.all()
    assert pushes(engine, wrench(TIP)) == [False] * 10
    assert pushes(engine, on, request('clear_wrench')) == [False] * 10
    assert pushes(engine, on, request('reset')) == [False] * 10
    assert not state(engine).velocity.any()
    # One stamped before the reset, which came after 41 steps, is stale.
    assert verdict(engine, wrench(TIP, stamp_ns=41 * STEP_NS)).label == 'stale'
    assert verdict(engine, wrench(TIP, stamp_ns=42 * STEP_NS)).accepted
    scene = pfd.scene_to_yaml(pfd.Scene(gravity=None, external_wrench=True))
    assert pushes(made(scene=scene), on) == [True] * 10


@pytest.mark.parametrize(
    ('timeout', 'steps'), [(0.003, 3), (0.0031, 4), (1e-9, 1), (0.1 + 0.2 - 0.297, 3)]
)
def test_a_wrench_with_a_timeout_acts_for_so_much_simulated_time(timeout, steps) -> None:
    engine, on = made(**PUSHED, external_wrench_timeout=timeout), wrench(TIP, (0.0, 3.0, 0.0))
    assert pushes(engine, on) == [True] * steps + [False] * (10 - steps)
    # The timeout counts for the wrenches that come after it.
    changed = change(external_wrench_timeout=0.0)
    assert pushes(engine, on, changed) == [True] * steps + [False] * (10 - steps)
    assert pushes(engine, on) == [True] * 10


BODY = {'payload_mass': 2.5, 'payload_center': CENTER, 'payload_inertia': INERTIA}


def test_the_payload_in_use_is_told_with_the_first_state_it_acts_on() -> None:
    engine = made(**BODY)

    def news(*messages: ArmMessage) -> list[tuple[int, float]]:
        produced, _ = engine.step(messages)
        bodies = [decode_numbers(m.data, INERTIA_TYPE) for m in produced if 'in_use' in m.role]
        assert all(body.frame_id == TIP for body in bodies)
        return [(body.stamp_ns // STEP_NS, body.values[0]) for body in bodies]

    assert news() == [(1, 2.5)]
    assert news() == []
    assert news(change(real_time_factor=0.5), change(payload_mass=2.5)) == []
    assert news(change(payload_mass=1.0), payload(TIP, 3.0)) == [(4, 3.0)]
    assert news(payload(TIP, 0.0)) == [(5, 0.0)]
    assert engine.plant.scene.payload is None


def test_only_the_first_of_many_payloads_compiles_code(emitted) -> None:
    outputs = ('acceleration', 'inertia_matrix', 'gravity_torques', 'energy', 'tip_pose')
    engine = made(**START, outputs=outputs)
    state(engine, payload(TIP, 1.0), change(gravity_compensation=True))
    state(engine, change(gravity_compensation=False))
    native = len(emitted)
    for k in range(100):
        body = payload(TIP, 0.01 * k, (0.1, 0.001 * k, 0.0), INERTIA)
        compensated = change(gravity_compensation=bool(k % 2))
        assert state(engine, body, compensated).stamp_ns == (k + 3) * STEP_NS
    assert len(emitted) == native
    assert engine.plant.scene.payload.mass == 0.99


def test_a_change_that_was_prepared_compiles_nothing_and_has_had_no_effect(emitted) -> None:
    engine, message = made(**START), payload(TIP, 1.25, CENTER)
    before = engine.save()
    engine.prepare(message.role, message.data)
    engine.prepare('payload', b'no message')
    assert same(before, engine.save())
    native = len(emitted)
    assert verdict(engine, message).accepted
    assert len(emitted) == native


def test_gravity_compensation_holds_the_robot_and_not_its_payload() -> None:
    engine = made(**START)
    held = state(engine, efforts(0.0, 0.0), change(gravity_compensation=True), cycles=500)
    np.testing.assert_allclose(held.position, (0.3, -0.2), rtol=0, atol=1e-12)
    assert np.abs(state(engine, payload(TIP, 1.0), cycles=50).velocity).max() > 0.1
    engine.step([payload(TIP, 0.0), change(gravity_compensation=False)])
    assert engine.plant.scene == made().plant.scene


def test_friction_stops_and_motor_lag_continue_with_a_new_payload() -> None:
    chosen = {'joint_friction': (0.3, 0.1), 'motor_lag': (0.05, 0.0), 'joint_limits': True}
    engine = made(**chosen, **START)
    state(engine, efforts(4.0, 1.0), cycles=40)
    lagging = engine.state.simulation.arrays['tau_motor'].copy()
    assert 0.5 < lagging[0] < 3.5
    assert verdict(engine, payload(TIP, 1.5)).accepted
    assert engine.state.simulation.arrays['tau_motor'].tolist() == lagging.tolist()


# The scene of the settings.

SCENE = pfd.Scene(
    damping=(0.5, 0.2),
    armature=(0.1, 0.1),
    effort_limits=(3.0, 1.0),
    gravity_compensation=True,
    payload=pfd.Payload(0.5, (0.1, 0.0, 0.0)),
    friction=(0.3, 0.1),
    static_friction=(0.4, 0.1),
    joint_limits=((-0.02, 2.0), (-2.0, 2.0)),
    restitution=(0.5, 0.5),
    motor_lag=(0.002, 0.0),
)


def test_settings_keep_the_content_of_a_scene_file(tmp_path) -> None:
    path, text = tmp_path / 'scene.yaml', pfd.scene_to_yaml(SCENE)
    path.write_text('# by hand\n' + text)
    settings = with_scene_text(Settings(robot='planar2', scene=str(path)))
    assert settings.scene == text
    path.unlink()
    assert with_scene_text(settings) == settings
    engine, braked = made(scene=text, substeps=3), pfd.Scene(**{**vars(SCENE), 'brakes': True})
    assert engine.plant.scene.digest == braked.digest
    wanted = pfd.Simulator(pfd.load_robot('planar2'), braked, substeps=3)
    for _ in range(20):
        wanted.step([2.0, 5.0])
    assert state(engine, efforts(2.0, 5.0), cycles=20).position.tobytes() == wanted.q.tobytes()


def test_changes_replace_the_effects_of_a_scene_file() -> None:
    heavy = pfd.Payload(2.0, (0.1, 0.0, 0.0))
    scene = pfd.Scene(payload=heavy, gravity_compensation=True, damping=(0.5, 0.2))
    engine = made(scene=pfd.scene_to_yaml(scene))
    assert engine.plant.scene.payload == heavy
    engine.step([change(payload_mass=1.0)])
    assert engine.plant.scene.payload == pfd.Payload(1.0, (0.1, 0.0, 0.0))
    assert engine.plant.scene.gravity_compensation
    engine.step([change(payload_mass=0.0, gravity_compensation=False)])
    assert engine.plant.scene == pfd.Scene(damping=(0.5, 0.2), brakes=True)


def test_the_numbers_of_each_joint_make_the_scene_of_the_table_of_effects() -> None:
    order = np.array([1, 0])
    wanted, settings = {}, {}
    for field in ARM_EFFECT_FIELDS:
        names = list(joint_settings(field))
        if names:
            wanted[field.name] = np.array(example(field, 2))
            columns = wanted[field.name].reshape(2, -1).T
            for name, column in zip(names, columns, strict=True):
                settings[name] = tuple(column[order].tolist())
    found = scene_of(Settings(robot='planar2', **settings), order)
    assert found == pfd.Scene(**wanted, brakes=True)
    assert pfd.load_scene(pfd.scene_to_yaml(found)) == found


@pytest.mark.parametrize(
    ('wrong', 'text'),
    [
        ({'scene': '/etc/passwd'}, "scene is '/etc/passwd', expected the YAML of a scene"),
        ({'scene': 'damping: [1, 2, 3]\n'}, "has 3 numbers, but 'planar2' has 2 joints"),
        ({'scene': 'damping: 5\n'}, 'damping must be None'),
        ({'scene': 'payload: input\n'}, "'input', expected a table"),
        ({'joint_damping': (1.0, 2.0, 3.0)}, 'damping holds 3 numbers, expected 2, one for each'),
        ({'bias_effort': (1.0,)}, r'bias\.effort holds 1 numbers, expected 2'),
        ({'joints': ('shoulder', 'wrist')}, r"joints is \['shoulder', 'wrist'\], expected each"),
        ({'joints': ('shoulder',) * 2}, 'expected each joint of .* once'),
        ({'joints': ('x' * 9999,) * 1000}, '9999 characters.*and 992 more'),
        ({'initial_positions': (0.0,)}, 'initial_positions holds 1 numbers, expected 2'),
        ({'robot': 'r2d2'}, 'r2d2'),
        ({'robot': ''}, 'robot is empty'),
        ({'tip_link': 'nowhere'}, 'nowhere'),
        ({'locked': ('{0}',)}, r'\{0\}'),
        ({'start_time': -1.0}, 'only a node knows'),
        *(
            ({'on_timeout': 'hold', **gains}, "'hold', expected servo_p above 0")
            for gains in ({}, {'servo_p': (1.0, 0.0)}, {'servo_d': (1.0, 1.0)})
        ),
    ],
)
def test_settings_that_do_not_go_with_the_robot_are_refused(wrong: dict, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        made(**wrong)


# Floods, and what the roles are for.


def test_a_flood_of_refused_inputs_is_counted_beyond_64_kb_a_second() -> None:
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
def test_only_the_roles_that_somebody_needs_are_encoded_and_the_arm_moves_the_same(roles) -> None:
    settings = Settings(robot='planar2', outputs=OPTIONAL_OUTPUTS, external_wrench=True)
    robot = load_arm_robot(settings, 'planar2')
    engine, other = Engine(settings, robot), Engine(settings, robot, roles)
    for events in ([PUSH], [efforts(1.0)], [payload(TIP, 1.0)], [wrench(TIP, (1, 2, 3))], []):
        produced, verdicts = engine.step(events)
        wanted = [m for m in produced if m.role in roles]
        assert other.step(events) == (wanted, verdicts)
    assert same(engine.save(), other.save())


def test_outputs_come_in_the_order_of_the_table_each_at_its_rate() -> None:
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


def test_a_state_that_is_presented_again_is_the_same_message() -> None:
    settings = {'noise_position': 1.0, 'delay_state': 0.002, 'external_wrench': True}
    engine = made(**settings, outputs=('tip_wrench', 'true_states'), lockstep=True)
    produced, _ = engine.step([PUSH, wrench(TIP, (1.0, 0.0, 0.0))])
    engine.step([wrench(TIP, (2.0, 0.0, 0.0))])
    shown = {'joint_states', 'tip_wrench', 'true_states', 'clock'}
    assert engine.present() == [m for m in produced if m.role in shown]
