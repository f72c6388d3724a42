# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replays of stretches in one native call find what replays of single cycles find."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from plant_messages import UNLIMITED, efforts
import pytest
from rewriting import ARRAY, CLOCK, STATES, Recording, load
from simulating import simulate

from pfd_ros.advice import read_motion
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Source, Verdict
from pfd_ros.messages.stamped import effort_encoder
from pfd_ros.replay.verify import DifferenceError, read
from pfd_ros.testing.lockstep_arm import LockstepArm

CYCLES = 600


def driven(path: Path, **settings) -> Path:
    with LockstepArm('planar2', recording=path, **settings) as arm:
        rng = np.random.default_rng(2)
        arm.run(lambda t, q, qd: 60.0 * (0.5 - q) - 6.0 * qd + rng.normal(size=2), 0.2)
        arm.set(servo_p=[1.0, 1.0])
        arm.run(lambda t, q, qd: 30.0 * (0.2 - q) - 6.0 * qd, 0.2)
        arm.reset()
        arm.run(lambda t, q, qd: 400.0 * rng.normal(size=2), CYCLES * 1e-3 - 0.4)
    return path


@pytest.fixture(scope='module')
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return driven(tmp_path_factory.mktemp('runs') / 'run.mcap')


@pytest.fixture
def lengths(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the numbers of cycles that native calls run, which grow."""
    found: list[int] = []
    stretch = Engine.stretch

    def counted(engine: Engine, *given):
        rows = stretch(engine, *given)
        found.append(0 if rows is None else len(rows))
        return rows

    monkeypatch.setattr(Engine, 'stretch', counted)
    return found


def single_cycles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Engine, 'stretch', lambda *given: None)


@pytest.mark.parametrize(
    'settings',
    [{}, {'joints': ('elbow', 'shoulder')}, {'publish_rate': 200.0}, {'clock_rate': 100.0}],
)
def test_almost_all_cycles_of_a_run_are_verified_in_a_few_calls(
    settings, tmp_path: Path, lengths: list[int]
) -> None:
    summary = read(driven(tmp_path / 'a.mcap', **settings), verify=True)
    lengths_of_replay = [n for n in lengths if n > 10]
    assert summary.states == summary.steps // (5 if 'publish_rate' in settings else 1)
    assert sum(lengths_of_replay) > 0.9 * CYCLES
    assert len(lengths_of_replay) <= 4


def test_noise_is_replayed_cycle_by_cycle(tmp_path: Path, lengths: list[int]) -> None:
    path = driven(tmp_path / 'a.mcap', noise_position=1e-4)
    lengths.clear()
    read(path, verify=True)
    assert not any(lengths)


def flip(topic: str, place: int, at: int) -> Callable[[Path, Path], Path]:
    def alter(path: Path, other: Path) -> Path:
        recording = load(path)
        recording.on(topic)[place].flip(at)
        recording.recount()
        return recording.save(other)

    return alter


@pytest.mark.parametrize(
    'alter',
    [flip(STATES, 100, -1), flip(STATES, 300, 5), flip(CLOCK, 150, 5), flip(ARRAY, 50, -2)],
    ids=['effort', 'stamp', 'tick', 'command'],
)
def test_a_flipped_bit_in_a_stretch_is_placed_as_in_single_cycles(
    run: Path, tmp_path: Path, alter, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = alter(run, tmp_path / 'a.mcap')
    with pytest.raises(DifferenceError) as found:
        read(path, verify=True)
    single_cycles(monkeypatch)
    with pytest.raises(DifferenceError) as wanted:
        read(path, verify=True)
    assert str(found.value) == str(wanted.value)


def named(stamps: Callable[[int], int], **settings) -> Recording:
    """Return a run under a command by name in each cycle, the joints not in published order."""
    encoder = effort_encoder(('elbow', 'shoulder'))
    rng = np.random.default_rng(4)
    commands = {
        k: [(Source.NAMED, encoder.encode(stamps(k), rng.normal(size=2) * 20.0))]
        for k in range(1, 301)
    }
    return simulate(301, commands, **settings)


@pytest.mark.parametrize('settings', [{}, {'servo_p': (5.0, 5.0)}, {'lockstep': True}])
def test_commands_by_name_are_replayed_in_stretches(
    settings, tmp_path: Path, lengths: list[int]
) -> None:
    # In lockstep each command has the stamp of the state that it answers.
    recording = named(lambda k: (k - 1) * 1_000_000, **settings)
    summary = read(recording.save(tmp_path / 'a.mcap'), verify=True)
    assert summary.verdicts[Verdict.ACCEPTED] == 300
    assert sum(lengths) > 290


@pytest.mark.parametrize('stale', [(), (150,)])
def test_a_stale_command_by_name_is_rejected_as_in_single_cycles(
    stale: tuple[int, ...], tmp_path: Path, lengths: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    # One stamp older than the state to answer.
    recording = named(lambda k: (k - 1 - (k in stale)) * 1_000_000, lockstep=True)
    path = recording.save(tmp_path / 'a.mcap')
    summary = read(path, verify=True)
    assert summary.verdicts.get(Verdict.STALE, 0) == len(stale)
    assert any(lengths)
    single_cycles(monkeypatch)
    assert read(path, verify=True).verdicts == summary.verdicts


def test_an_arm_that_fails_in_a_stretch_is_replayed_to_its_failure(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    with LockstepArm('planar2', recording=path, **UNLIMITED) as arm:
        arm.run(lambda t, q, qd: 10.0 * (0.5 - q) - qd, 0.2)
        with pytest.raises(Exception, match='not finite'):
            arm.run(lambda t, q, qd: np.full(2, 1e300), 0.2)
    summary = read(path, verify=True)
    assert 'not finite' in summary.failure
    assert summary.stopped_at == arm.engine.arm.step


@pytest.mark.parametrize(('every', 'first_braked'), [(10, 2001), (2, 401)])
def test_a_reflex_within_a_stretch_is_replayed_in_its_cycle(
    every: int, first_braked: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A command every few cycles; the effort of the 201st is further from the last than allowed.
    commands = {
        1 + every * k: [efforts(1.0 + (9.0 if k == 200 else 0.0), 0.0)] for k in range(260)
    }
    path = simulate(260 * every, commands, reflex_effort_rate=2000.0).save(tmp_path / 'a.mcap')
    assert read(path, verify=True).verdicts[Verdict.REFUSED] == 59
    braked = read_motion(path).motion.braked
    assert np.flatnonzero(braked.all(axis=1))[0] + 1 == first_braked
    single_cycles(monkeypatch)
    assert read(path, verify=True).verdicts[Verdict.REFUSED] == 59
    assert read_motion(path).motion.braked.tobytes() == braked.tobytes()


def test_the_motion_of_a_run_equals_single_cycles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / 'a.mcap'
    with LockstepArm('planar2', recording=path, joints=('elbow', 'shoulder')) as arm:
        arm.run(lambda t, q, qd: 30.0 * (0.5 - q) - 2.0 * qd, 0.3)
    found = read_motion(path).motion
    single_cycles(monkeypatch)
    wanted = read_motion(path).motion
    assert len(found.taus) == 300
    for name, value in vars(wanted).items():
        if isinstance(value, np.ndarray):
            assert getattr(found, name).tobytes() == value.tobytes(), name
