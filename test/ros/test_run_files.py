# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A recording in several files: each is readable alone, and all of them are one run."""

from __future__ import annotations

from pathlib import Path
import shutil

from bridge import (
    REPLAY_INCOMPLETE,
    LogError,
    Settings,
    pfd_main,
    read_recording_run,
)
from driven_runs import SETTINGS, opened_run, recorded_run, run_steps
import numpy as np
import pytest

from pfd_ros import read_log

STATES, SAVED = '/joint_states', '/sim_arm/arm_state'
STEPS = 330


@pytest.fixture(scope='module')
def run(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return the files of a run of 330 steps, a new one after every 100."""
    folder = tmp_path_factory.mktemp('run')
    recorded_run(folder / 'run.mcap', STEPS, recording_max_duration=0.12)
    return sorted(folder.iterdir())


@pytest.fixture(scope='module')
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the same run in one file."""
    return recorded_run(tmp_path_factory.mktemp('whole') / 'one.mcap', STEPS)


def said_by(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str]:
    """Return status and output of `pfd`."""
    status = pfd_main([str(word) for word in words])
    said = capsys.readouterr()
    return status, said.out + said.err


@pytest.mark.parametrize('source', ['folder', 'files', 'backwards'])
def test_read_log_reads_the_files_as_the_run_in_one_file(
    source: str, run: list[Path], whole: Path
) -> None:
    paths = {'folder': run[0].parent, 'files': run, 'backwards': run[::-1]}[source]
    log, one = read_log(paths), read_log(whole)
    assert log.complete
    assert log.topics == one.topics
    for topic in log.topics:
        if topic == SAVED:  # it has the settings, which differ in the limit
            assert len(log[topic]) == len(one[topic])
            continue
        assert log.messages(topic) == one.messages(topic)
    assert (np.diff(log[STATES].log_ns) >= 0).all()


def test_the_files_of_a_run_verify_as_a_whole_in_any_order_and_by_their_folder(
    run: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    for words in (run, run[::-1], [run[0].parent]):
        status, said = said_by(capsys, 'replay', *words, '--verify')
        assert status == 0, said
        assert 'in 4 files, every bit equal' in said.splitlines()[-1]
    status, said = said_by(capsys, 'info', *run)
    assert status == 0
    assert 'files      4 of one run' in said


@pytest.mark.parametrize(
    ('kept', 'missing'),
    [
        ([0, 1, 2], 'the parts of the run after part 3'),
        ([1, 2, 3], 'part 1 of the run'),
        ([0, 3], 'parts 2 to 3 of the run'),
        ([1], 'part 1 of the run, the parts of the run after part 2'),
    ],
)
def test_a_run_without_some_of_its_files_verifies_as_far_as_it_goes_and_names_them(
    run: list[Path], capsys: pytest.CaptureFixture[str], kept: list[int], missing: str
) -> None:
    paths = [run[k] for k in kept]
    status, said = said_by(capsys, 'replay', *paths, '--verify')
    assert status == REPLAY_INCOMPLETE, said
    assert said.splitlines()[-1].endswith(f'every bit equal; missing: {missing}')
    # One file alone is read as a log.
    assert read_log(paths).complete == (len(paths) == 1)


def test_files_that_are_not_one_run_are_one_line(
    run: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = recorded_run(tmp_path / 'other.mcap', 20)
    twice = Path(shutil.copy(run[1], tmp_path / 'b.mcap'))
    empty = tmp_path / 'empty'
    empty.mkdir()
    for paths, line in (
        ([*run, other], 'other.mcap is of another run than'),
        ([*run, twice], 'are both part 2'),
        ([empty], 'empty is a folder without MCAP files'),
    ):
        for command in (['info'], ['replay', '--verify']):
            status, said = said_by(capsys, *command, *paths)
            assert status == 1
            assert len(said.splitlines()) == 1
            assert line in said
        with pytest.raises(LogError, match=line):
            read_log(paths)


def test_files_by_size_have_about_that_size(tmp_path: Path) -> None:
    driver, log = opened_run(tmp_path / 'run.mcap', recording_max_size=120_000)
    run_steps(driver, log, 1800)
    log.close()
    files = sorted(tmp_path.iterdir())
    assert len(files) > 2
    # 50 steps from one state of the whole arm to the next have less than 10 kB.
    sizes = [path.stat().st_size for path in files]
    assert max(sizes) < 130_000
    assert min(sizes[:-1]) > 100_000
    assert read_recording_run(files, verify=True).absent == []


@pytest.mark.parametrize(
    ('values', 'expected'),
    [
        ({'recording_max_size': -1}, 'recording_max_size is -1, expected 0 to'),
        ({'recording_max_duration': float('nan')}, 'recording_max_duration holds nan'),
        ({'recording_flush_period': 0.0}, 'recording_flush_period is 0.0, expected 0.01 to'),
        (
            {'recording_max_size': 10**6, 'recording_state_period': 0.0},
            'recording_max_size and recording_max_duration need recording_state_period above 0',
        ),
    ],
)
def test_limits_that_cannot_be_are_one_line(values: dict[str, float], expected: str) -> None:
    with pytest.raises(ValueError, match=expected) as caught:
        Settings(**{**SETTINGS, **values})
    assert '\n' not in str(caught.value)


def test_a_file_of_another_recording_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / 'run_000007.mcap').write_bytes(b'mine')
    with pytest.raises(FileExistsError, match=r'run_000007\.mcap exists, of another recording'):
        opened_run(tmp_path / 'run.mcap', recording_max_duration=0.1)
    assert [path.name for path in tmp_path.iterdir()] == ['run_000007.mcap']
