# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs simulated here verify: at any rates, failed arms, cut off, without their beginning."""

from __future__ import annotations

import json
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

from bridge import (
    CLOSED_PIPE,
    END_RECORD,
    REPLAY_INCOMPLETE,
    DifferenceError,
    LogError,
    Source,
    Verdict,
    encode_string,
    pfd_main,
    read_recording,
)
from plant_messages import UNLIMITED, efforts, joint_state, request, wrench
import pytest
from read_hostile import verified
from rewriting import ARRAY, STATES, Recording, Sent
from ros_processes import environment
from simulating import simulate

SAVED = '/sim_arm/arm_state'
MOVE = {3: [efforts(1.0, 2.0)], 9: [efforts(-1.0, 0.5), efforts(2.0, 0.0)]}
BLOW_UP = {5: [efforts(1.0, 2.0)], 12: [efforts(1e308, -1e308)]}


def said_by(capsys: pytest.CaptureFixture[str], path: Path, *args: str) -> tuple[int, str]:
    status = pfd_main(['replay', str(path), *args])
    return status, capsys.readouterr().out


@pytest.mark.parametrize(
    'settings',
    [
        {},
        {'publish_clock': False},
        {'publish_rate': 500.0, 'clock_rate': 200.0, 'start_time': 3.0},
        {'real_time_factor': 0.0},
    ],
    ids=str,
)
def test_a_run_verifies_at_any_rates(tmp_path: Path, settings: dict[str, float]) -> None:
    summary = read_recording(simulate(37, MOVE, **settings).save(tmp_path / 'a.mcap'), verify=True)
    assert summary.complete
    assert summary.verdicts == {Verdict.ACCEPTED: 3}
    assert (summary.missing, summary.stopped_at, summary.failure) == (0, None, '')


# ---- a failed arm ----


@pytest.mark.parametrize('closed', [True, False])
def test_a_failed_arm_verifies_and_is_called_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], closed: bool
) -> None:
    path = simulate(30, BLOW_UP, **UNLIMITED).save(tmp_path / 'a.mcap', closed=closed)
    status, text = said_by(capsys, path, '--verify')
    assert status == (0 if closed else REPLAY_INCOMPLETE)
    assert 'FAILED     simulation stopped after step 11: ' in text
    assert 'FAILED     simulation stopped after step 11: ' in said_by(capsys, path)[1]


@pytest.mark.parametrize('change', [{'failure': ''}, {'failure': '', 'steps': 30}, {'steps': 10}])
def test_a_failure_that_is_recorded_otherwise_is_a_difference(
    tmp_path: Path, change: dict[str, object]
) -> None:
    run = simulate(30, BLOW_UP, **UNLIMITED)
    run.edit(END_RECORD, 'totals', lambda totals: totals.update(change))
    with pytest.raises(LogError, match=r'the end: recorded|its end record counts'):
        read_recording(run.save(tmp_path / 'a.mcap'), verify=True)


def test_a_failed_arm_and_its_reset_are_recorded_as_they_are_replayed(tmp_path: Path) -> None:
    # A replay skips cycles of a failed arm.
    run = simulate(
        200,
        {
            4: [wrench('tip_link', (0.0, 1.0, 0.0)), request('pause'), request('step', 100)],
            5: [efforts(1e308, -1e308)],
            150: [request('reset')],
        },
        recording_state_period=0.02,
        publish_rate=50.0,
        clock_rate=50.0,
        external_wrench=True,
        external_wrench_timeout=0.1,
        **UNLIMITED,
    )
    summary = read_recording(run.save(tmp_path / 'a.mcap'), verify=True)
    assert summary.verdicts == {Verdict.ACCEPTED: 5}
    assert summary.stopped_at is None


# ---- commands ----


def test_commands_behind_the_last_state_are_validated_too(tmp_path: Path) -> None:
    run = simulate(14, {12: [efforts(1.0, 2.0)]}, publish_rate=100.0, publish_clock=False)
    assert read_recording(run.save(tmp_path / 'a.mcap'), verify=True).verdicts == {
        Verdict.ACCEPTED: 1
    }
    run.on(ARRAY)[0].data = efforts(1.0)
    with pytest.raises(DifferenceError, match=r'step 12: .* ACCEPTED, replayed as WRON'):
        read_recording(run.save(tmp_path / 'a.mcap'), verify=True)


def test_a_command_that_was_never_taken_waits_and_its_digest_is_checked(tmp_path: Path) -> None:
    run = simulate(20, MOVE)
    run.messages.append(Sent(ARRAY, 4, run.messages[-1].log_ns, efforts(1.0, 1.0)))
    run.recount()
    assert read_recording(run.save(tmp_path / 'a.mcap'), verify=True).waiting == 1
    run.messages[-1].data = efforts(1.0, -1.0)
    with pytest.raises(LogError, match='messages commands are not the recorded ones'):
        read_recording(run.save(tmp_path / 'a.mcap'))


# ---- files ----


def test_a_file_that_a_power_cut_left_full_of_zeros_is_cut_off(tmp_path: Path) -> None:
    path = simulate(20, MOVE).save(tmp_path / 'a.mcap', closed=False)
    with path.open('ab') as stream:
        stream.write(bytes(100_000))
    summary = read_recording(path, verify=True)
    assert (summary.complete, summary.states) == (False, 20)


@pytest.mark.parametrize(
    ('name', 'expected'),
    [
        ('fifo', 'is not a regular file'),
        ('/dev/zero', 'is not a regular file'),
        ('folder', 'folder without MCAP files'),
        ('nix', 'No such file'),
        ('empty', 'not an MCAP file'),
        ('loop', 'symbolic links'),
    ],
)
def test_a_file_that_is_no_recording_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, expected: str
) -> None:
    os.mkfifo(tmp_path / 'fifo')
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'empty').touch()
    (tmp_path / 'loop').symlink_to('loop')
    assert pfd_main(['replay', str(tmp_path / name)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert expected in line
    assert name in line


def test_a_pipe_without_a_reader_ends_the_command_quietly(tmp_path: Path) -> None:
    path = simulate(20, MOVE).save(tmp_path / 'a.mcap')
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(
            [sys.executable, '-m', 'pfd_ros.cli.main', 'replay', str(path)],
            env=environment(1),
            text=True,
            check=False,
            timeout=60,
            stdout=writing,
            stderr=subprocess.PIPE,
        )
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (CLOSED_PIPE, '')


def test_a_name_that_no_terminal_should_show_is_escaped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = simulate(20, MOVE)
    run.edit('pfd_ros', 'settings', lambda settings: settings.update(robot='\x1b[2Jred\n\r\x07'))
    status, text = said_by(capsys, run.save(tmp_path / 'a.mcap'))
    assert status == 0
    assert text.replace('\n', '').isprintable()
    assert r'\x1b[2Jred' in text


# ---- recorded states of the whole arm ----


@pytest.fixture(scope='module')
def run() -> Recording:
    """Return a run of 300 steps, with a state after every 50, under all kinds of inputs."""
    commands: dict[int, list[Any]] = {k: [efforts(0.02 * k, 1.0)] for k in range(3, 280, 7)}
    commands[30] = [(Source.PARAMETERS, encode_string(json.dumps({'noise.position': 2e-3})))]
    commands[120] = [(Source.SET_STATE, joint_state(['elbow'], [0.2]))]
    return simulate(
        300,
        commands,
        recording_state_period=0.05,
        noise_position=1e-3,
        delay_state=0.003,
        delay_commands=0.002,
        command_timeout=0.04,
        external_wrench=True,
        outputs=('energy',),
    )


def from_step(whole: Recording, step: int) -> Recording:
    """Return a recording without what came before a step, as a filter by time leaves it."""
    found = whole.copy()
    first = found.on(STATES)[step - 1].log_ns
    found.keep(lambda message: message.log_ns >= first)
    return found


def test_states_of_the_whole_arm_are_recorded_and_verified(run: Recording, tmp_path: Path) -> None:
    assert [message.sequence for message in run.on(SAVED)] == [1, 2, 3, 4, 5, 6]
    summary = read_recording(run.copy().save(tmp_path / 'a.mcap'), verify=True)
    assert (summary.states, summary.absent) == (300, [])


@pytest.mark.parametrize(('step', 'closed'), [(2, True), (50, False), (51, True), (249, False)])
def test_a_recording_without_its_beginning_verifies_from_the_first_state_in_it(
    run: Recording, tmp_path: Path, step: int, closed: bool
) -> None:
    # The end record belongs to the whole run.
    path = from_step(run, step).save(tmp_path / 'a.mcap', closed=closed)
    status, said = verified(path)
    assert status == REPLAY_INCOMPLETE, said
    compared = 300 - 50 * -(-step // 50) if step > 3 else 299
    assert f'equal as far as it goes: {compared} states, every bit equal' in said
    missing = said.rpartition('; missing: ')[2]
    assert missing.startswith('the beginning of the log' if closed else 'the end of the file')
