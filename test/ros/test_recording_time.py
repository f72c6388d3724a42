# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The time base of a recording: log time is the time of day or simulated time."""

from __future__ import annotations

from collections.abc import Iterator
import json
from pathlib import Path
import time
from typing import Any

from bridge import (
    HEAD_RECORD,
    LockstepArm,
    LogError,
    Settings,
    decode_joint_state,
    pfd_main,
    read_motion,
    read_recording,
)
from mcap.reader import make_reader
import numpy as np
from plant_messages import efforts
import pytest
from rewriting import load
from simulating import simulate

from pfd_ros import read_log

BASES = ('wall', 'simulated')
STATES, ACCELERATION = '/joint_states', '/sim_arm/acceleration'
ARRAYS = (ACCELERATION, '/sim_arm/inertia_matrix', '/sim_arm/energy')


def recorded(path: Path, **settings: Any) -> tuple[int, int]:
    """Record a run of 0.1 s with outputs that have no stamp; return when it began and ended."""
    begun = time.time_ns()
    outputs = ['acceleration', 'inertia_matrix', 'energy']
    with LockstepArm('ur5', recording=path, outputs=outputs, **settings) as arm:
        arm.run(lambda t, q, qd: -5.0 * qd, 0.1)
    return begun, time.time_ns()


def messages(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield topic and message in file order, by the reader of MCAP."""
    with path.open('rb') as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            yield channel.topic, message


@pytest.mark.parametrize(
    ('settings', 'base'),
    [
        ({}, 'wall'),
        ({'real_time_factor': 2.0}, 'simulated'),
        ({'real_time_factor': 0.0}, 'simulated'),
        ({'lockstep': True}, 'simulated'),
        ({'time_source': 'clock', 'publish_clock': False}, 'simulated'),
        ({'real_time_factor': 2.0, 'recording_time': 'wall'}, 'wall'),
        ({'recording_time': 'simulated'}, 'simulated'),
    ],
)
def test_log_time_is_wall_in_real_time_alone_unless_a_parameter_sets_it(
    settings: dict[str, Any], base: str
) -> None:
    assert Settings(**settings).log_time == base


@pytest.mark.parametrize('base', BASES)
def test_log_time_and_publish_time_are_wall_and_simulated_time(base: str, tmp_path: Path) -> None:
    begun, ended = recorded(tmp_path / 'a.mcap', recording_time=base)
    times: list[int] = []
    stamps: list[int] = []
    for topic, message in messages(tmp_path / 'a.mcap'):
        pair = message.log_time, message.publish_time
        wall, simulated = pair if base == 'wall' else pair[::-1]
        assert begun <= wall <= ended
        times.append(message.log_time)
        if topic == STATES:
            stamps.append(simulated)
            assert simulated == decode_joint_state(message.data).stamp_ns
    assert len(stamps) == 100
    assert times == sorted(times)


@pytest.mark.parametrize('base', BASES)
def test_messages_of_one_state_have_one_log_time(base: str, tmp_path: Path) -> None:
    recorded(tmp_path / 'a.mcap', recording_time=base)
    states: dict[int, tuple[int, int]] = {}
    arrays = 0
    for topic, message in messages(tmp_path / 'a.mcap'):
        pair = message.log_time, message.publish_time
        if topic == STATES:
            states[message.sequence] = pair
        if topic in ARRAYS:
            assert pair == states[message.sequence]
            arrays += 1
    assert arrays == 3 * len(states) == 300


def test_the_arm_in_lockstep_records_simulated_time_and_stores_the_choice_of_auto(
    tmp_path: Path,
) -> None:
    recorded(tmp_path / 'a.mcap')
    found = load(tmp_path / 'a.mcap')
    assert json.loads(found.head(HEAD_RECORD)['settings'])['recording_time'] == 'simulated'
    spans = [message.log_time for _, message in messages(tmp_path / 'a.mcap')]
    # From the start of simulated time in lockstep, one step, to a step beyond the last state.
    assert (spans[0], spans[-1]) == (1_000_000, 101_000_000)


@pytest.mark.parametrize('base', BASES)
def test_either_time_base_verifies_and_gives_the_same_motion(base: str, tmp_path: Path) -> None:
    recorded(tmp_path / 'a.mcap', recording_time=base)
    begun, ended = recorded(tmp_path / 'b.mcap', recording_time='wall')
    summary = read_recording(tmp_path / 'a.mcap', verify=True)
    assert not summary.absent
    assert 0 < summary.seconds < (ended - begun) * 1e-9 + 60.0
    one, other = (read_motion(tmp_path / f'{name}.mcap').motion for name in 'ab')
    assert np.array_equal(one.q, other.q)


@pytest.mark.parametrize('base', BASES)
def test_arrays_without_a_stamp_have_the_time_of_their_states(base: str, tmp_path: Path) -> None:
    recorded(tmp_path / 'a.mcap', recording_time=base)
    log = read_log(tmp_path / 'a.mcap')
    for topic in ARRAYS:
        assert np.array_equal(log[topic].time, log[STATES].time)
        assert np.array_equal(log[topic].log_time, log[STATES].log_time)


def test_info_prints_the_time_base(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recorded(tmp_path / 'a.mcap')
    assert pfd_main(['info', str(tmp_path / 'a.mcap')]) == 0
    assert 'begin      0.001000 s of simulated time\n' in capsys.readouterr().out
    assert pfd_main(['info', str(tmp_path / 'a.mcap'), '--json']) == 0
    assert json.loads(capsys.readouterr().out)['run']['log_time'] == 'simulated'


def test_two_time_bases_compare_as_equal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for base in BASES:
        recorded(tmp_path / f'{base}.mcap', recording_time=base)
    assert pfd_main(['compare', *(str(tmp_path / f'{base}.mcap') for base in BASES)]) == 0
    capsys.readouterr()


def test_a_jump_of_numbers_is_refused_by_simulated_time_too(tmp_path: Path) -> None:
    made = simulate(50, {3: [efforts(1.0, -1.0)]}, real_time_factor=0.0)
    for message in made.on(STATES)[20:]:
        message.sequence += 10**7
    with pytest.raises(LogError, match='when at most'):
        read_recording(made.save(tmp_path / 'a.mcap', closed=False))


def test_a_file_without_publish_times_verifies(tmp_path: Path) -> None:
    # As programs write it that copy log times alone.
    made = simulate(5000, {3: [efforts(1.0, -1.0)]}, real_time_factor=0.0, publish_rate=100.0)
    for message in made.messages:
        message.published_ns = message.log_ns
    made.recount()
    assert not read_recording(made.save(tmp_path / 'a.mcap'), verify=True).absent
