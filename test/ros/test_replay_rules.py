# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replays of arms that fail, of commands that overflow, and of files that still grow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import json
import os
from pathlib import Path
import subprocess
import sys

from plant_messages import UNLIMITED, efforts
import pytest
from rewriting import ARRAY, STATES, TAKEN, Recording, Sent
from ros_processes import environment
from simulating import START_NS, simulate

from pfd_ros.arm.events import TAKEN_COLUMNS, Source, Verdict
from pfd_ros.cli import main as command_line
from pfd_ros.cli.main import CLOSED_PIPE
from pfd_ros.cli.replay import INCOMPLETE
from pfd_ros.messages import convert
from pfd_ros.recording.format import END, HEAD, HeadKey
from pfd_ros.recording.reader import Log, LogError
from pfd_ros.replay.ordering import messages_of, placed_blocks
from pfd_ros.replay.verify import DifferenceError, read

MOVE = {3: [efforts(1.0, 2.0)], 9: [efforts(-1.0, 0.5), efforts(2.0, 0.0)]}
BLOW_UP = {5: [efforts(1.0, 2.0)], 12: [efforts(1e308, -1e308)]}


def told(path: Path, capsys: pytest.CaptureFixture[str], *args: str) -> tuple[int, str]:
    status = command_line.main(['replay', str(path), *args])
    return status, capsys.readouterr().out


@pytest.mark.parametrize(
    'settings',
    [
        {},
        {'publish_clock': False},
        {'publish_rate': 200.0, 'clock_rate': 500.0},
        {'publish_rate': 500.0, 'clock_rate': 200.0, 'start_time': 3.0},
        {'real_time_factor': 0.0},
    ],
    ids=str,
)
def test_a_run_verifies_at_any_rates(tmp_path: Path, settings: dict[str, float]) -> None:
    summary = read(simulate(37, MOVE, **settings).save(tmp_path / 'a.mcap'), verify=True)
    assert summary.complete
    assert summary.verdicts == {Verdict.ACCEPTED: 3}
    assert (summary.missing, summary.stopped_at, summary.failure) == (0, None, '')


def test_a_failed_arm_verifies_and_is_called_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = simulate(30, BLOW_UP, **UNLIMITED).save(tmp_path / 'a.mcap')
    status, text = told(path, capsys, '--verify')
    assert status == 0
    assert 'FAILED     simulation stopped after step 11: ' in text
    assert 'steps      11 of 0.001 s' in text
    assert text.splitlines()[-1] == (
        'verified: 30 states, every bit equal, '
        'and the simulation stopped after step 11 as recorded'
    )
    assert 'FAILED     simulation stopped after step 11: ' in told(path, capsys)[1]


def test_a_failed_arm_in_a_cut_off_file_is_called_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = simulate(30, BLOW_UP, **UNLIMITED).save(tmp_path / 'a.mcap', closed=False)
    for args, expected in (((), 0), (('--verify',), INCOMPLETE)):
        status, text = told(path, capsys, *args)
        assert status == expected
        assert 'FAILED     simulation stopped after step 11: ' in text


def test_an_arm_that_failed_behind_the_last_state_verifies(tmp_path: Path) -> None:
    run = simulate(14, BLOW_UP, **UNLIMITED, publish_rate=100.0, clock_rate=100.0)
    summary = read(run.save(tmp_path / 'a.mcap'), verify=True)
    assert (summary.states, summary.stopped_at) == (1, 11)


@pytest.mark.parametrize('change', [{'failure': ''}, {'failure': '', 'steps': 30}, {'steps': 10}])
def test_a_failure_that_is_recorded_otherwise_is_a_difference(
    tmp_path: Path, change: dict[str, object]
) -> None:
    run = simulate(30, BLOW_UP, **UNLIMITED)
    run.edit(END, 'totals', lambda totals: totals.update(change))
    with pytest.raises(LogError, match=r'the end: recorded|its end record counts'):
        read(run.save(tmp_path / 'a.mcap'), verify=True)


def test_a_failure_is_no_way_out_of_the_comparison(tmp_path: Path) -> None:
    run = simulate(30, MOVE)
    run.edit(END, 'totals', lambda totals: totals.update(failure='x', steps=20))
    with pytest.raises(DifferenceError, match=r'the end: recorded 20 steps'):
        read(run.save(tmp_path / 'a.mcap'), verify=True)


def test_commands_behind_the_last_state_are_validated_too(tmp_path: Path) -> None:
    run = simulate(14, {12: [efforts(1.0, 2.0)]}, publish_rate=100.0, publish_clock=False)
    assert read(run.save(tmp_path / 'a.mcap'), verify=True).verdicts == {Verdict.ACCEPTED: 1}
    run.on(ARRAY)[0].data = efforts(1.0)
    with pytest.raises(
        DifferenceError, match=r'step 12: .* recorded as ACCEPTED, replayed as WRON'
    ):
        read(run.save(tmp_path / 'a.mcap'), verify=True)


def overflowing() -> Recording:
    """Return a run with commands that never reached the arm, and rows that say so."""
    run = simulate(20, MOVE)
    at = next(k for k, m in enumerate(run.messages) if m.topic == TAKEN and m.sequence == 2)
    log_ns = run.messages[at].log_ns
    lost = [Sent(ARRAY, number, log_ns, efforts(1e308, 1e308)) for number in (4, 5)]
    rows = [
        Sent(TAKEN, number, log_ns, overflow_rows([9, Source.ARRAY, 2 + number]))
        for number in (2, 3)
    ]
    run.messages[at].sequence = 4
    run.messages[at:at] = [*lost, *rows]
    run.recount()
    return run


def overflow_rows(*rows: list[int]) -> bytes:
    return convert.encode_rows([[*row, Verdict.OVERFLOWED, 0] for row in rows], TAKEN_COLUMNS)


def test_commands_that_overflowed_are_not_given_to_the_arm(tmp_path: Path) -> None:
    summary = read(overflowing().save(tmp_path / 'a.mcap'), verify=True)
    assert summary.verdicts == {Verdict.ACCEPTED: 3, Verdict.OVERFLOWED: 2}
    assert summary.waiting == 0


@pytest.mark.parametrize(
    ('rows', 'error'),
    [
        (lambda: overflow_rows([8, Source.ARRAY, 4]), 'was recorded before it'),
        (lambda: overflow_rows([8, 1, 4], [9, 1, 5]), r'names steps \[8, 9\], expected one'),
        (lambda: overflow_rows([9, 0, 4], [9, 1, 5]), 'the same verdicts, in other rows'),
        (lambda: overflow_rows(), 'not as the node writes it'),
        (
            lambda: convert.encode_rows([[9, 1, 4, 12, 0], [9, 1, 5, 0, 0]], TAKEN_COLUMNS),
            'mixes commands validated and overflowed',
        ),
    ],
    ids=['of a cycle before', 'of two cycles', 'of two sources', 'empty', 'mixed'],
)
def test_rows_of_overflow_are_as_the_engine_writes_them(
    tmp_path: Path, rows: Callable[[], bytes], error: str
) -> None:
    run = overflowing()
    run.on(TAKEN)[1].data = rows()
    run.recount()
    with pytest.raises(LogError, match=error):
        read(run.save(tmp_path / 'a.mcap'), verify=True)


def test_a_command_that_was_never_taken_waits(tmp_path: Path) -> None:
    run = simulate(20, MOVE)
    run.messages.append(Sent(ARRAY, 4, run.messages[-1].log_ns, efforts(1.0, 1.0)))
    run.recount()
    assert read(run.save(tmp_path / 'a.mcap'), verify=True).waiting == 1


def test_a_cut_off_file_without_ticks_reports_the_number_of_missing_ticks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = simulate(20, MOVE)
    run.keep(lambda m: m.topic != '/clock' or m.sequence <= 8)
    path = run.save(tmp_path / 'a.mcap', closed=False)
    status, text = told(path, capsys, '--verify')
    assert status == INCOMPLETE
    # The last state may have been cut off from its tick.
    assert 'missing    11 clock ticks' in text


def test_a_digest_finds_a_change_that_a_replay_cannot_find(tmp_path: Path) -> None:
    run = simulate(20, MOVE)
    run.messages.append(Sent(ARRAY, 4, run.messages[-1].log_ns, efforts(1.0, 1.0)))
    run.recount()
    run.messages[-1].data = efforts(1.0, -1.0)
    path = run.save(tmp_path / 'a.mcap')
    for verify in (False, True):
        with pytest.raises(LogError, match='messages commands are not the recorded ones'):
            read(path, verify=verify)


def test_counts_are_compared_with_the_end_record(tmp_path: Path) -> None:
    run = simulate(20, MOVE)
    run.keep(lambda m: m.topic != STATES or m.sequence != 7)
    with pytest.raises(LogError, match='holds 19 of 20 messages joint_states: 7 to 7 are missing'):
        read(run.save(tmp_path / 'a.mcap'), verify=True)


def test_a_file_that_a_power_cut_left_full_of_zeros_is_cut_off(tmp_path: Path) -> None:
    path = simulate(20, MOVE).save(tmp_path / 'a.mcap', closed=False)
    with path.open('ab') as stream:
        stream.write(bytes(100_000))
    summary = read(path, verify=True)
    assert (summary.complete, summary.states) == (False, 20)


def test_a_file_that_still_grows_is_verified_up_to_where_it_was(tmp_path: Path) -> None:
    run = simulate(200, MOVE)
    whole = run.save(tmp_path / 'a.mcap', closed=False, chunk_size=500).read_bytes()
    path = tmp_path / 'b.mcap'
    path.write_bytes(whole[: len(whole) * 3 // 4])

    def grow(part: float) -> None:
        path.write_bytes(whole)

    summary = read(path, verify=True, progress=grow)
    assert 0 < summary.states < 200


def test_sequence_numbers_continue_beyond_32_bits(tmp_path: Path) -> None:
    # The file continues a run after as many states.
    run = simulate(1)
    none = {channel.topic: 0 for channel in run.channels}
    part = {'number': 2, 'first': '0' * 64, 'previous': '0' * 64, 'dropped': none}
    part['recorded'] = none | {STATES: (1 << 32) - 2}
    run.head(HEAD)[HeadKey.PART] = json.dumps(part)
    later, (state, *_) = START_NS + (1 << 33) * 1_000_000, run.on(STATES)
    numbers = [(1 << 32) - 1, 1 << 32, (1 << 32) + 1]
    run.messages = [
        replace(state, sequence=n & 0xFFFFFFFF, log_ns=later, published_ns=later) for n in numbers
    ]
    log = Log(run.save(tmp_path / 'a.mcap', closed=False))
    found = [message for block in placed_blocks(log) for message in messages_of(block)]
    assert [message.number for message in found] == numbers
    assert [message.lost for message in found] == [0, 0, 0]


# --- no regular file, and no reader of the output


def replay(*args: str, **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, '-m', 'pfd_ros.cli.main', 'replay', *args],
        env=environment(1),
        text=True,
        check=False,
        timeout=60,
        **{'capture_output': True, **options},
    )


def assert_one_line(done: subprocess.CompletedProcess[str], expected: str) -> None:
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert expected in done.stderr


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
    assert command_line.main(['replay', str(tmp_path / name)]) == 1
    err = capsys.readouterr().err
    assert len(err.splitlines()) == 1
    assert expected in err
    assert name in err


def test_a_pipe_without_a_reader_ends_the_command_quietly(tmp_path: Path) -> None:
    path = simulate(20, MOVE).save(tmp_path / 'a.mcap')
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = replay(str(path), capture_output=False, stdout=writing, stderr=subprocess.PIPE)
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (CLOSED_PIPE, '')


@pytest.mark.skipif(not Path('/dev/full').exists(), reason='there is no full disk')
def test_a_full_disk_is_one_line(tmp_path: Path) -> None:
    path = simulate(20, MOVE).save(tmp_path / 'a.mcap')
    with open('/dev/full', 'w') as full:
        done = replay(str(path), capture_output=False, stdout=full, stderr=subprocess.PIPE)
    assert_one_line(done, 'No space left')


def test_a_name_that_no_terminal_should_show_is_escaped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = simulate(20, MOVE)
    name = '\x1b[2Jred\n\r\x07'
    run.edit('pfd_ros', 'settings', lambda settings: settings.update(robot=name))
    assert json.loads(run.head('pfd_ros')['settings'])['robot'] == name
    status, text = told(run.save(tmp_path / 'a.mcap'), capsys)
    assert status == 0
    assert text.replace('\n', '').isprintable()
    assert r'\x1b[2Jred' in text
