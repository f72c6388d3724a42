# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded states of the whole arm: what lacks its beginning or commands verifies from there."""

from __future__ import annotations

import json
from pathlib import Path

from plant_messages import efforts, joint_state, request, wrench
import pytest
from read_hostile import verified
from rewriting import ARRAY, STATES, TAKEN, Recording, Sent
from simulating import simulate

from pfd_ros.arm.arm import load_robot
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Arrival, Source, Verdict
from pfd_ros.arm.settings import Settings
from pfd_ros.arm.state import ArmState
from pfd_ros.cli.replay import INCOMPLETE
from pfd_ros.messages.convert import decode_bytes, encode_bytes, encode_string
from pfd_ros.recording.reader import LogError
from pfd_ros.replay.verify import read

SAVED = '/sim_arm/arm_state'
SETTINGS = {
    'recording_state_period': 0.05,
    'noise_position': 1e-3,
    'delay_state': 0.003,
    'delay_commands': 0.002,
    'command_timeout': 0.04,
    'external_wrench': True,
    'outputs': ('energy',),
}


def recorded(**settings: object) -> Recording:
    """Return a run of 300 steps, with a state after every 50, under all kinds of inputs."""
    commands: dict[int, list] = {k: [efforts(0.02 * k, 1.0)] for k in range(3, 280, 7)}
    commands[30] = [(Source.PARAMETERS, encode_string(json.dumps({'noise.position': 2e-3})))]
    commands[120] = [(Source.SET_STATE, joint_state(['elbow'], [0.2]))]
    return simulate(300, commands, **(SETTINGS | settings))


@pytest.fixture(scope='module')
def run() -> Recording:
    return recorded()


def from_step(whole: Recording, step: int) -> Recording:
    """Return a recording without what came before a step, as a filter by time leaves it."""
    found = whole.copy()
    first = found.on(STATES)[step - 1].log_ns
    found.keep(lambda message: message.log_ns >= first)
    return found


def test_states_of_the_whole_arm_are_recorded_and_verified(run: Recording, tmp_path: Path) -> None:
    assert [message.sequence for message in run.on(SAVED)] == [1, 2, 3, 4, 5, 6]
    states = [ArmState.from_bytes(decode_bytes(message.data)) for message in run.on(SAVED)]
    assert [state.cycle for state in states] == [50, 100, 150, 200, 250, 300]
    summary = read(run.copy().save(tmp_path / 'a.mcap'), verify=True)
    assert (summary.states, summary.absent) == (300, [])


def test_an_engine_continues_from_a_recorded_state_with_the_same_bits(run: Recording) -> None:
    settings = Settings(**{'robot': 'planar2', **SETTINGS})
    engine = Engine(settings, load_robot(settings))
    engine.restore(ArmState.from_bytes(decode_bytes(run.on(SAVED)[-2].data)))
    assert engine.cycles == 250
    # The next command is taken before step 255.
    states = {m.sequence: m.data for m in run.on(STATES)}
    for step in range(251, 255):
        (state,) = (o.data for o in engine.run_cycle().outputs if o.role == 'joint_states')
        assert state == states[step]


@pytest.mark.sweep
@pytest.mark.parametrize('closed', [False, True])
@pytest.mark.parametrize('step', [2, 49, 50, 51, 130, 249])
def test_a_recording_without_its_beginning_verifies_from_the_first_state_in_it(
    run: Recording, tmp_path: Path, step: int, closed: bool
) -> None:
    # The end record belongs to the whole run.
    path = from_step(run, step).save(tmp_path / 'a.mcap', closed=closed)
    status, said = verified(path)
    assert status == INCOMPLETE, said
    start = 50 * -(-step // 50) if step > 3 else 1
    compared = 300 - start if step > 3 else 299
    assert f'equal as far as it goes: {compared} states, every bit equal' in said
    missing = said.rpartition('; missing: ')[2]
    assert missing.startswith('the beginning of the log' if closed else 'the end of the file')


@pytest.mark.parametrize('topic', [STATES, '/clock', '/sim_arm/energy', SAVED, ARRAY, TAKEN])
def test_a_changed_bit_behind_a_missing_beginning_is_found(
    run: Recording, tmp_path: Path, topic: str
) -> None:
    altered = from_step(run, 130)
    altered.on(topic)[-1].flip()
    status, said = verified(altered.save(tmp_path / 'a.mcap', closed=False))
    assert status == 1, said
    assert len(said.splitlines()) == 1


def test_a_recording_that_ends_before_its_first_state_cannot_be_verified(
    run: Recording, tmp_path: Path
) -> None:
    short = from_step(run, 251)
    short.keep(lambda message: message.topic != SAVED)
    with pytest.raises(LogError, match=r'lacks .* records of commands taken before step'):
        read(short.save(tmp_path / 'a.mcap', closed=False), verify=True)


def test_a_recording_that_lacks_rows_continues_at_the_next_state(
    run: Recording, tmp_path: Path
) -> None:
    slow = run.copy()
    lost = slow.on(TAKEN)[10:13]
    slow.lose(lost)
    status, said = verified(slow.save(tmp_path / 'a.mcap', closed=False))
    assert status == INCOMPLETE, said
    assert 'lacks 3 records of commands' in said
    assert 'missing: the end of the file, which was not closed, inputs of steps' in said


def test_a_beginning_without_commands_is_replayed_from_the_start(tmp_path: Path) -> None:
    # Only the state tells that all rows are gone.
    quiet = simulate(120, {3: [efforts(1.0, 2.0)]}, recording_state_period=0.05)
    path = from_step(quiet, 20).save(tmp_path / 'a.mcap', closed=False)
    status, said = verified(path)
    assert status == INCOMPLETE, said
    assert 'equal as far as it goes: 70 states, every bit equal' in said


@pytest.mark.parametrize(
    ('change', 'expected'),
    [
        (lambda state: setattr(state, 'cycle', 51), 'belongs to step 51, expected step 50'),
        (lambda state: setattr(state, 'row_messages', 2), 'counts 2 records of commands'),
        (lambda state: state.q.__setitem__(0, 9.0), 'step 50: arm_state: q of the whole state'),
    ],
)
def test_a_false_state_is_refused(run: Recording, tmp_path: Path, change, expected: str) -> None:
    altered = run.copy()
    message = altered.on(SAVED)[0]
    state = ArmState.from_bytes(decode_bytes(message.data))
    change(state)
    message.data = encode_bytes(state.to_bytes())
    altered.recount()
    status, said = verified(altered.save(tmp_path / 'a.mcap'))
    assert status == 1
    assert expected in said


def test_a_state_of_other_settings_is_refused(run: Recording, tmp_path: Path) -> None:
    other = recorded(seed=9)
    altered = from_step(run, 20)
    altered.on(SAVED)[0].data = other.on(SAVED)[0].data
    status, said = verified(altered.save(tmp_path / 'a.mcap', closed=False))
    assert status == 1
    assert 'the state after step 50 was saved with other settings' in said


@pytest.mark.parametrize('data', [b'', b'\0\1\0\0', encode_bytes(b''), encode_bytes(b'x' * 99)])
def test_bytes_that_are_no_state_are_refused(run: Recording, tmp_path: Path, data: bytes) -> None:
    altered = run.copy()
    altered.on(SAVED)[0].data = data
    altered.recount()
    status, said = verified(altered.save(tmp_path / 'a.mcap'))
    assert status == 1
    assert len(said.splitlines()) == 1


def test_a_failed_arm_and_its_reset_are_recorded_as_they_are_replayed(tmp_path: Path) -> None:
    # A replay skips cycles of a failed arm.
    blown = simulate(
        200,
        {
            4: [wrench('tip_link', (0.0, 1.0, 0.0)), request('pause'), request('step', 100)],
            5: [efforts(1e308, -1e308)],
            150: [request('reset')],
        },
        recording_state_period=0.02,
        publish_rate=50.0,
        clock_rate=50.0,
        effort_limits=False,
        torque_speed=False,
        external_wrench=True,
        external_wrench_timeout=0.1,
    )
    assert len(blown.on(SAVED)) == 10
    summary = read(blown.save(tmp_path / 'a.mcap'), verify=True)
    assert summary.verdicts == {Verdict.ACCEPTED: 5}
    assert summary.stopped_at is None


def test_no_states_are_recorded_without_a_period(tmp_path: Path) -> None:
    none = recorded(recording_state_period=0.0)
    assert none.on(SAVED) == []
    assert SAVED not in {kind.topic for kind in none.channels}
    read(none.save(tmp_path / 'a.mcap'), verify=True)


def test_flood_of_inputs_without_rows_takes_bounded_memory(run: Recording, tmp_path: Path) -> None:
    altered = from_step(run, 130)
    last = altered.on(ARRAY)[0].sequence
    altered.keep(lambda m: m.topic not in (ARRAY, TAKEN))
    place = altered.messages.index(altered.on(SAVED)[0])
    log_ns = altered.messages[place].log_ns
    flood = [Sent(ARRAY, last + k, log_ns, bytes(8)) for k in range(70_000)]
    altered.messages[place:place] = flood
    status, said = verified(altered.save(tmp_path / 'a.mcap', closed=False))
    assert status == 1
    assert 'were never taken' in said


@pytest.mark.parametrize(
    ('robot', 'settings'),
    [
        ('planar2', {}),
        ('ur5', {}),
        ('ur5', {'delay_state': 0.2, 'delay_commands': 0.1}),
        ('panda', {'noise_position': 1e-3, 'outputs': ('energy', 'tip_pose')}),
    ],
)
def test_a_state_has_a_bounded_size_by_joints_and_delay(robot: str, settings: dict) -> None:
    chosen = Settings(robot=robot, **settings)
    engine = Engine(chosen, load_robot(chosen))
    n = engine.arm.robot.n
    for k in range(400):
        engine.run_cycle([Arrival(Source.ARRAY, k + 1, efforts(*[1.0] * n))])
    delayed = chosen.state_delay_steps + chosen.command_delay_steps
    size = len(engine.state.to_bytes())
    assert size < 8000 + 600 * n + delayed * (300 + 50 * n)
    assert size > 3000
