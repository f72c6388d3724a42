# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A real run, replayed: the same bits, and every change of the file found and placed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import io
from pathlib import Path
import struct
import subprocess
import sys

from bridge import (
    END_RECORD,
    REPLAY_INCOMPLETE,
    DifferenceError,
    LogError,
    Verdict,
    decode_joint_state,
    pfd_main,
    progress_on,
    read_motion,
    read_recording,
    what_if,
)
import numpy as np
import pytest
from rewriting import GOLDEN, STATES, TAKEN, Sent, load, rewrite
from ros_processes import environment
from simulating import states_of

pytestmark = pytest.mark.ros


def only(topic: str, sequences: Iterable[int]) -> Callable[[str, Sent], bool]:
    wanted = set(sequences)
    return lambda name, message: name == topic and message.sequence in wanted


def test_the_replay_of_a_run_has_the_same_bits(recorded: Path) -> None:
    summary = read_recording(recorded, verify=True)
    assert summary.complete
    assert summary.missing == 0
    assert summary.states == summary.steps > 200
    assert summary.verdicts == {Verdict.ACCEPTED: 21, Verdict.UNKNOWN_NAMES: 1}


def test_the_run_moved_after_it_was_braked(recorded: Path) -> None:
    # Otherwise equal bits would prove nothing.
    states = states_of(recorded)
    assert not any(states[50].velocity)
    assert np.abs(states[-1].position).max() > 1e-3
    # Later the wrist turns at its limit, where its motor has no torque left.
    assert [0.0, 1.0, 0.0, 0.1, 0.0, 0.1] in [state.effort.tolist() for state in states]


@pytest.mark.parametrize('field', ['position', 'velocity', 'effort'])
def test_one_flipped_bit_is_found_and_placed(
    recorded: Path, tmp_path: Path, field: str, capsys: pytest.CaptureFixture[str]
) -> None:
    hit = only('/joint_states', [123])

    def change(topic: str, message: Sent) -> Sent:
        if not hit(topic, message):
            return message
        # The last joint's number in the array, counted from the end: three arrays of a count,
        # perhaps padding, and six doubles.
        arrays = decode_joint_state(message.data)
        values = getattr(arrays, field).tobytes()
        at = {'position': 0, 'velocity': 1, 'effort': 2}[field]
        start = len(message.data) - len(values) - (2 - at) * (len(values) + 8)
        assert message.data[start : start + len(values)] == values
        return message.flip(start + 5 * 8)

    rewrite(recorded, tmp_path / 'a.mcap', change)
    status = pfd_main(['replay', str(tmp_path / 'a.mcap'), '--verify'])
    printed = capsys.readouterr().err
    assert status == 1
    assert 'step 123' in printed
    assert f', {field}: recorded ' in printed
    names = states_of(recorded)[0].names
    assert repr(names[5]) in printed
    assert printed.count('0x') == 2


def test_the_sign_of_a_zero_is_a_bit_like_any_other(recorded: Path, tmp_path: Path) -> None:
    hit = only('/joint_states', [5])

    def change(topic: str, message: Sent) -> Sent:
        # The last number is the effort of a held joint; its sign is the top bit of its last byte.
        if hit(topic, message):
            assert message.data[-8:] == bytes(8)
            message.data = message.data[:-1] + b'\x80'
        return message

    rewrite(recorded, tmp_path / 'a.mcap', change)
    with pytest.raises(DifferenceError, match=r'step 5: .*effort: recorded -0\.0 .*replayed 0\.0'):
        read_recording(tmp_path / 'a.mcap', verify=True)


def test_a_changed_command_is_found_where_it_was_taken(recorded: Path, tmp_path: Path) -> None:
    hit = only('/joint_commands', [20])
    rewrite(recorded, tmp_path / 'a.mcap', lambda t, m: m.flip(-2) if hit(t, m) else m)
    expected = r'step \d+: message 20 of joint_commands: recorded with CRC-32 0x\w+, it has'
    with pytest.raises(DifferenceError, match=expected):
        read_recording(tmp_path / 'a.mcap', verify=True)


def without(recorded: Path, tmp_path: Path, topic: str, numbers: Iterable[int]) -> Path:
    """Return the recording of a run that was killed, and whose disk had been too slow before."""
    hit = only(topic, numbers)
    return rewrite(
        recorded, tmp_path / 'a.mcap', lambda t, m: None if hit(t, m) else m, closed=False
    )


@pytest.mark.parametrize('number', [2, 6])
def test_a_lost_record_of_taken_commands_is_named(tmp_path: Path, number: int) -> None:
    # The sixth holds a refused command: without it no state differs.
    path = without(GOLDEN, tmp_path, TAKEN, [number])
    with pytest.raises(LogError, match='lacks 1 records of commands taken before step'):
        read_recording(path, verify=True)
    assert 'lacks 1 records' in read_recording(path).obstacle


def test_a_lost_last_record_of_a_command_that_moved_the_arm_is_found(tmp_path: Path) -> None:
    # Nothing follows it on its channel, so that only the states can tell.
    last = load(GOLDEN).on(TAKEN)[-1].sequence
    with pytest.raises(DifferenceError, match=r'step \d+: joint'):
        read_recording(without(GOLDEN, tmp_path, TAKEN, [last]), verify=True)


def test_lost_states_are_counted_and_the_others_still_equal(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = without(recorded, tmp_path, STATES, range(50, 90))
    summary = read_recording(path, verify=True)
    assert (summary.missing, summary.states) == (40, read_recording(recorded).states - 40)
    assert pfd_main(['replay', str(path)]) == 0
    assert 'missing    40 states' in capsys.readouterr().out


def test_a_recording_that_lacks_states_for_a_slow_disk_is_no_damage_but_fails_to_verify(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    slow = load(recorded)
    last = slow.on(STATES)[-1].sequence
    slow.keep(lambda m: m.topic != STATES or m.sequence not in (*range(50, 90), last))
    slow.recount()
    slow.edit(END_RECORD, 'dropped', lambda dropped: dropped.update({STATES: 41}))
    path = slow.save(tmp_path / 'a.mcap')
    summary = read_recording(path, verify=True)
    assert (summary.missing, summary.dropped, summary.states) == (41, 41, last - 41)
    assert pfd_main(['replay', str(path), '--verify']) == REPLAY_INCOMPLETE
    assert 'missing: 41 messages that were not recorded' in capsys.readouterr().out


def test_a_cut_off_recording_verifies_up_to_the_cut(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = recorded.read_bytes()
    # The footer: the start of the summary, two numbers more, and the magic bytes.
    (summary,) = struct.unpack_from('<Q', data, len(data) - 28)
    (tmp_path / 'a.mcap').write_bytes(data[: int(0.7 * summary)])
    arguments = ['replay', str(tmp_path / 'a.mcap'), '--verify']
    assert pfd_main(arguments) == REPLAY_INCOMPLETE
    printed = capsys.readouterr().out
    assert 'cut off' in printed
    assert 'every bit equal; missing: the end of the file, which was not closed' in printed
    assert pfd_main([*arguments, '--allow-incomplete']) == 0


@pytest.mark.parametrize('changed', [False, True])
def test_a_recording_without_its_end_record_is_equal_as_far_as_it_goes_or_differs(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], changed: bool
) -> None:
    run = load(recorded)
    run.metadata = [item for item in run.metadata if item[0] != END_RECORD]
    if changed:
        run.on(STATES)[70].flip(-5)
    status = pfd_main(['replay', str(run.save(tmp_path / 'a.mcap')), '--verify'])
    said = capsys.readouterr()
    assert status == (1 if changed else REPLAY_INCOMPLETE)
    assert ('missing: the end record of the node' in said.out) != changed


def test_a_recording_without_states_is_read_and_not_simulated(
    recorded: Path, tmp_path: Path
) -> None:
    path = without(recorded, tmp_path, STATES, range(1, 1 << 20))
    with pytest.raises(LogError, match='holds no states, so there is nothing to verify'):
        read_recording(path, verify=True)
    for simulate in (what_if, read_motion):
        with pytest.raises(LogError, match='holds no states, so there is nothing to simulate'):
            simulate(path)
    assert read_recording(path).states == 0
    assert not (tmp_path / f'{path.stem}_what_if.mcap').exists()


def test_a_summary_lists_the_contents_of_the_file(
    recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert pfd_main(['replay', str(recorded)]) == 0
    printed = capsys.readouterr().out
    assert '21 accepted, 1 rejected' in printed
    assert '1 unknown_names' in printed
    assert 'cut off' not in printed
    assert 'equal' not in printed


def test_the_progress_is_drawn_on_a_terminal_and_nowhere_else() -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    draw = progress_on(terminal)
    assert draw is not None
    draw(0.5)
    draw(0.501)
    assert terminal.getvalue().count('50 %') == 1
    assert progress_on(None) is None
    assert progress_on(io.StringIO()) is None


def test_a_recording_is_verified_where_there_is_no_ros(recorded: Path, tmp_path: Path) -> None:
    program = (
        'import sys\n'
        "for name in ('rclpy', 'sensor_msgs', 'std_msgs'): sys.modules[name] = None\n"
        'from bridge import pfd_main\n'
        'raise SystemExit(pfd_main(sys.argv[1:]))\n'
    )
    done = subprocess.run(
        [sys.executable, '-c', program, 'replay', str(recorded), '--verify'],
        cwd=tmp_path,
        env=environment(1),
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert 'every bit equal' in done.stdout
