# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pause, step, reset, jumps to a state, and lockstep: the engine alone, without ROS."""

from __future__ import annotations

from collections.abc import Sequence
import functools
import json

from bridge import (
    Arrival,
    Engine,
    JointMessage,
    Source,
    Verdict,
    decode_joint_state,
    encode_string,
)
import plant_messages
from plant_messages import asked, efforts, joint_state, verdict
import pytest

STEP_NS = 1_000_000
NAN = float('nan')
made = functools.partial(plant_messages.made, initial_positions=(0.3, -0.2))
PUSH = Arrival(Source.ARRAY, 1, efforts(1.0, -0.5))


def joint_message(source: Source, names: Sequence[str], *args, **other) -> Arrival:
    return Arrival(source, 1, joint_state(names, *args, **other))


def placed(names: Sequence[str], position: Sequence[float], **other) -> Arrival:
    return joint_message(Source.SET_STATE, names, position, **other)


def pushed(stamp_ns: int, effort: float = 1.0) -> Arrival:
    return joint_message(Source.NAMED, ['shoulder'], effort=[effort], stamp_ns=stamp_ns)


def state(engine: Engine) -> JointMessage:
    (found,) = (output.data for output in engine.step() if output.role == 'joint_states')
    return decode_joint_state(found)


def test_a_paused_arm_does_only_requested_steps() -> None:
    engine = made()
    assert not engine.waiting
    assert verdict(engine, asked('pause')) is Verdict.ACCEPTED
    assert engine.waiting
    assert verdict(engine, asked('step', 3)) is Verdict.ACCEPTED
    for _ in range(3):
        assert not engine.waiting
        engine.step()
    assert engine.waiting
    assert verdict(engine, asked('resume')) is Verdict.ACCEPTED
    assert not engine.waiting
    assert engine.cycles == engine.arm.step == 3


def test_steps_are_rejected_outside_of_a_pause_and_discarded_at_its_end() -> None:
    engine = made()
    assert verdict(engine, asked('step')) is Verdict.REFUSED
    engine.take([asked('pause'), asked('step', 9), asked('resume'), asked('pause')])
    assert engine.waiting


def test_a_reset_is_the_initial_state_at_the_next_stamp_with_every_joint_braked() -> None:
    engine = made()
    engine.run_cycle([PUSH])
    for _ in range(20):
        moving = state(engine)
    assert moving.velocity.all()
    engine.take([asked('reset')])
    there = state(engine)
    assert there.position.tolist() == [0.3, -0.2]
    assert not there.velocity.any()
    assert there.stamp_ns == moving.stamp_ns + STEP_NS
    later = [state(engine) for _ in range(50)][-1]
    assert later.position.tolist() == [0.3, -0.2]
    assert later.stamp_ns == there.stamp_ns + 50 * STEP_NS


@pytest.mark.parametrize('event', [asked('reset'), placed(['elbow'], [1.0])], ids=['reset', 'set'])
def test_commands_from_before_a_jump_are_stale_and_no_snap_back(event: Arrival) -> None:
    engine = made()
    engine.run_cycle([PUSH])
    before = state(engine).stamp_ns
    engine.take([event])
    assert verdict(engine, pushed(before)) is Verdict.STALE
    there = state(engine)
    assert verdict(engine, pushed(before)) is Verdict.STALE
    assert verdict(engine, pushed(there.stamp_ns)) is Verdict.ACCEPTED


def test_a_jump_is_exactly_the_given_state_and_ends_the_last_efforts() -> None:
    engine = made()
    engine.run_cycle([PUSH])
    engine.take([placed(['elbow', 'shoulder'], [0.7, -1.1], velocity=[2.0, NAN])])
    there = state(engine)
    assert there.position.tolist() == [-1.1, 0.7]
    assert there.velocity.tolist() == [0.0, 2.0]
    assert not there.effort.any()
    # Not braked: it swings on.
    after = state(engine)
    assert after.velocity.all()
    assert not after.effort.any()


def test_a_state_of_joint_states_is_sent_back_as_it_came_with_its_efforts_and_its_stamp() -> None:
    engine = made()
    engine.run_cycle([PUSH])
    (saved,) = (output.data for output in engine.step() if output.role == 'joint_states')
    before = decode_joint_state(saved)
    assert before.effort.all()
    for _ in range(3):
        # Also after a jump and a reset, which are later than its stamp.
        engine.take([asked('reset')])
        state(engine)
        assert verdict(engine, Arrival(Source.SET_STATE, 1, saved)) is Verdict.ACCEPTED
        there = state(engine)
        assert there.position.tobytes() == before.position.tobytes()
        assert there.velocity.tobytes() == before.velocity.tobytes()
        assert not there.effort.any()


def test_a_jump_of_one_joint_keeps_the_others_and_their_brakes() -> None:
    engine = made()
    engine.take([placed(['elbow'], [0.7])])
    there = [state(engine) for _ in range(5)][-1]
    assert there.position.tolist() == [0.3, 0.7]
    assert not there.velocity.any()


def test_jumps_of_one_cycle_follow_each_other() -> None:
    engine = made()
    engine.take([placed(['elbow'], [0.7]), asked('reset'), placed(['shoulder'], [NAN])])
    engine.take([placed(['shoulder'], [1.0])])
    assert state(engine).position.tolist() == [1.0, -0.2]


def test_a_pause_lets_a_jump_through() -> None:
    engine = made()
    engine.take([asked('pause'), placed(['elbow'], [0.7])])
    assert not engine.waiting
    assert state(engine).position[1] == 0.7
    assert engine.waiting


@pytest.mark.parametrize(
    ('event', 'wanted'),
    [
        (placed([], []), Verdict.NO_NAMES),
        (placed(['elbow'], [1.0, 2.0]), Verdict.RAGGED),
        (placed(['elbow'], [float('inf')]), Verdict.INFINITE),
        (placed(['elbow'], [1e7]), Verdict.REFUSED),
        (placed(['elbow'], [1.0], velocity=[-1e5]), Verdict.REFUSED),
        (placed(['elbow', 'nobody'], [1.0, 2.0]), Verdict.UNKNOWN_NAMES),
        (placed(['elbow', 'elbow'], [1.0, 2.0]), Verdict.DUPLICATE_NAMES),
        (placed(['elbow'], [NAN]), Verdict.ALL_NAN),
        (placed(['elbow'], []), Verdict.MALFORMED),
        (placed(['elbow'], [1.0], effort=[1.0, 2.0]), Verdict.RAGGED),
        (placed(['elbow'], [], effort=[1.0]), Verdict.MALFORMED),
    ],
)
def test_a_state_that_is_refused_changes_nothing(event: Arrival, wanted: Verdict) -> None:
    engine, untouched = made(), made()
    for one in (engine, untouched):
        one.run_cycle([PUSH])
    assert verdict(engine, event) is wanted
    assert engine.step() == untouched.step() or wanted is Verdict.ALL_NAN
    assert engine.arm.q.tobytes() == untouched.arm.q.tobytes()


@pytest.mark.parametrize(
    'told',
    [
        '',
        'pause',
        '[]',
        '{}',
        '{"request": "dance"}',
        '{"request": ["pause"]}',
        '{"request": "pause", "count": 1}',
        '{"request": "step", "count": 0}',
        '{"request": "step", "count": true}',
        '{"request": "step", "count": 1e3}',
        '{"request": "step", "count": 10000000}',
        json.dumps({'request': 'pause', '%s{0}' * 300: 1}),
        '[' * 900,
    ],
)
def test_a_request_is_read_strictly(told: str) -> None:
    engine = made()
    event = Arrival(Source.REQUEST, 1, encode_string(told))
    assert verdict(engine, event) is Verdict.MALFORMED
    assert not engine.waiting


def test_lockstep_runs_free_until_the_first_command_and_then_waits_for_each() -> None:
    engine = made(lockstep=True)
    for _ in range(3):
        assert not engine.waiting
        engine.step()
    first = pushed(engine.arm.stamp_ns)
    assert verdict(engine, first) is Verdict.ACCEPTED
    for _ in range(5):
        assert not engine.waiting
        stamp = state(engine).stamp_ns
        assert engine.waiting
        assert verdict(engine, pushed(stamp - STEP_NS)) is Verdict.STALE
        assert engine.waiting
        assert verdict(engine, pushed(stamp)) is Verdict.ACCEPTED


def test_in_lockstep_the_arm_waits_at_published_states_for_a_command_with_or_without_stamp() -> (
    None
):
    engine = made(lockstep=True, publish_rate=250.0)
    engine.take([PUSH])
    for cycle in range(1, 13):
        assert not engine.waiting
        engine.step()
        assert engine.waiting == (cycle % 4 == 0)
        engine.take([PUSH] if engine.waiting else [])


def test_in_lockstep_nan_for_every_joint_is_an_answer_and_a_malformed_message_is_not() -> None:
    engine = made(lockstep=True)
    engine.run_cycle([PUSH])
    wrong = Arrival(Source.ARRAY, 1, efforts(1.0))
    quiet = joint_message(Source.NAMED, ['elbow'], effort=[NAN])
    assert verdict(engine, wrong) is Verdict.WRONG_SIZE
    assert engine.waiting
    assert verdict(engine, quiet) is Verdict.ALL_NAN
    assert not engine.waiting


def test_a_reset_in_lockstep_shows_its_state_and_waits_for_an_answer_to_it() -> None:
    engine = made(lockstep=True)
    engine.run_cycle([PUSH])
    engine.take([asked('reset')])
    assert not engine.waiting
    there = state(engine)
    assert engine.waiting
    assert verdict(engine, pushed(there.stamp_ns - STEP_NS)) is Verdict.STALE
    assert verdict(engine, pushed(there.stamp_ns)) is Verdict.ACCEPTED
    assert not engine.waiting


def test_the_present_state_can_be_sent_again_without_a_cycle() -> None:
    engine = made()
    engine.run_cycle([PUSH])
    again = {output.role: output.data for output in engine.present()}
    last = engine.present()
    assert {output.role: output.data for output in last} == again
    assert engine.cycles == 1
