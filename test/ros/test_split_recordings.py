# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A recording in several files: each is readable alone, and all of them are one run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
import json
from pathlib import Path
import shutil
import time

from driven_runs import SETTINGS, opened_run, recorded_run, run_steps
from mcap.reader import make_reader
from mcap.writer import Writer
import numpy as np
import pytest
from recordings import largest_file
from rewriting import Recording, load
from rosbags.highlevel import AnyReader

from pfd_ros import read_log
from pfd_ros.arm.events import Verdict
from pfd_ros.arm.settings import Settings
from pfd_ros.arm.state import ArmState
from pfd_ros.cli import main as command_line
from pfd_ros.cli.replay import INCOMPLETE
from pfd_ros.messages.convert import decode_bytes, encode_bytes
from pfd_ros.recording import run_parts
from pfd_ros.recording.format import END, HEAD
from pfd_ros.recording.reader import LogError
from pfd_ros.recording.recover import recover
from pfd_ros.replay.verify import DifferenceError, read, read_run

STATES, SAVED = '/joint_states', '/sim_arm/arm_state'
OPENING = ['/robot_description', '/tf_static']
STEPS = 330


@pytest.fixture(scope='module')
def run(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return the files of a run of 330 steps, a new one after every 100."""
    folder = tmp_path_factory.mktemp('run')
    recorded_run(folder / 'run.mcap', STEPS, recording_max_duration=0.12)
    return sorted(folder.iterdir())


@pytest.fixture
def copies(run: list[Path], tmp_path: Path) -> list[Path]:
    return [Path(shutil.copy(path, tmp_path)) for path in run]


def said_by(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str]:
    """Return status and output of `pfd`."""
    status = command_line.main([str(word) for word in words])
    said = capsys.readouterr()
    return status, said.out + said.err


def resealed(part: Recording, path: Path) -> None:
    """Write an altered file with the counts and the digests of its messages."""
    part.recount()
    before = json.loads(part.head(HEAD).get('part', '{"recorded": {}}'))['recorded']
    part.edit(END, 'recorded', lambda own: {t: n + before.get(t, 0) for t, n in own.items()})
    part.save(path)


def messages_of(path: Path) -> list[tuple[str, int, bytes]]:
    """Return topic, number and bytes of the messages, by the reader of the package mcap."""
    with path.open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        return [
            (channel.topic, message.sequence, message.data)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]


def test_names_in_order_are_files_in_order(run: list[Path]) -> None:
    assert [path.name for path in run] == [f'run_00000{k}.mcap' for k in (1, 2, 3, 4)]
    starts = [read(path).start for path in run]
    assert starts == [0, 100, 200, 300]


def test_files_together_have_the_messages_of_a_run_in_one_file(
    run: list[Path], tmp_path: Path
) -> None:
    whole = messages_of(recorded_run(tmp_path / 'one.mcap', STEPS))
    found: dict[str, list[tuple[int, bytes]]] = {}
    for path in run:
        for topic, sequence, data in messages_of(path):
            messages = found.setdefault(topic, [])
            if (sequence, data) in messages:
                continue  # repeated
            messages.append((sequence, data))
    expected: dict[str, list[tuple[int, bytes]]] = {}
    for topic, sequence, data in whole:
        expected.setdefault(topic, []).append((sequence, data))
    # The state of the whole arm has the settings, which differ in the limit.
    assert [n for n, _ in found.pop(SAVED)] == [n for n, _ in expected.pop(SAVED)]
    assert found == expected


def test_each_file_begins_with_the_urdf_the_frames_and_the_state_of_the_whole_arm(
    run: list[Path],
) -> None:
    commands = '/sim_arm/commands'
    for path in run[1:]:
        topics = [topic for topic, *_ in messages_of(path)]
        # The command of the step before has not been taken yet.
        assert topics[:4] == [*OPENING, commands, SAVED]
        times = [message.log_ns for message in load(path).messages]
        assert times == sorted(times)


def test_each_file_is_opened_by_rosbags_and_read_log(run: list[Path]) -> None:
    states = 0
    for path in run:
        with AnyReader([path]) as reader:
            assert {c.topic for c in reader.connections} >= {*OPENING, STATES, '/tf', SAVED}
            states += sum(c.topic == STATES for c, _, _ in reader.messages())
        log = read_log(path)
        assert log.settings['robot'] == 'planar2'
        assert log[STATES].position.shape[1] == 2
    assert states == read_run(run).compared > 250


@pytest.mark.parametrize('source', ['folder', 'files', 'backwards'])
def test_read_log_reads_the_files_as_the_run_in_one_file(
    source: str, run: list[Path], tmp_path: Path
) -> None:
    paths = {'folder': run[0].parent, 'files': run, 'backwards': run[::-1]}[source]
    log, whole = read_log(paths), read_log(recorded_run(tmp_path / 'one.mcap', STEPS))
    assert log.complete
    assert log.topics == whole.topics
    for topic in log.topics:
        if topic == SAVED:  # it has the settings, which differ in the limit
            assert len(log[topic]) == len(whole[topic])
            continue
        assert log.messages(topic) == whole.messages(topic)
    assert (np.diff(log[STATES].log_ns) >= 0).all()


def test_a_window_of_a_run_is_that_of_the_log_times(run: list[Path]) -> None:
    every = read_log(run, topics=[STATES])[STATES]
    begin = min(load(run[0]).messages, key=lambda message: message.log_ns).log_ns
    some = read_log(run, topics=[STATES], start=0.09, end=0.21)[STATES]
    at = (every.log_ns - begin) / 1e9
    inside = (at >= 0.09) & (at < 0.21)
    assert 100 < len(some) < len(every)
    assert some.position.tobytes() == every.position[inside].tobytes()


def test_a_run_without_one_of_its_files_is_read_as_incomplete(
    run: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    for paths, missing in (
        ([run[0], *run[2:]], 'part 2 of the run'),
        (run[2:], 'parts 1 to 2 of the run'),
        (run[:2], 'the parts of the run after part 2'),
    ):
        assert not read_log(paths).complete
        status, said = said_by(capsys, 'info', *paths)
        assert status == 0
        assert f'missing    {missing}' in said
        assert f'of what is there; missing: {missing}' in said


def test_files_that_are_not_one_run_are_one_line(
    run: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = recorded_run(tmp_path / 'other.mcap', 20)
    empty = tmp_path / 'empty'
    empty.mkdir()
    foreign = tmp_path / 'foreign.mcap'
    with foreign.open('xb') as stream:
        writer = Writer(stream)
        writer.start()
        writer.finish()
    for paths, line in (
        ([*run, other], 'other.mcap is of another run than'),
        ([run[0], run[0]], 'are both part 1'),
        ([run[0], foreign], 'foreign.mcap is not a recording of this node'),
        ([empty], 'empty is a folder without MCAP files'),
    ):
        for command in (['info'], ['report', 'log']):
            status, said = said_by(capsys, *command, *paths)
            assert status == 1
            assert len(said.splitlines()) == 1
            assert line in said
        with pytest.raises(LogError, match=line):
            read_log(paths)


def test_a_run_has_a_bounded_number_of_files(
    run: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_parts, 'MOST_PARTS', 3)
    with pytest.raises(LogError, match='4 files, expected at most 3'):
        read_log(run[0].parent)


def test_info_sums_the_files_of_a_run(run: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    counts = Counter[str]()
    for topic, _, _ in {message for path in run for message in messages_of(path)}:
        counts[topic] += 1
    for words in (run, [run[0].parent]):
        status, said = said_by(capsys, 'info', *words, '--json')
        assert status == 0
        found = json.loads(said)
        assert {
            t: item['messages'] for t, item in found['topics'].items() if item['messages']
        } == (counts)
        assert found['files'] == [str(path) for path in run]
        assert found['absent'] == []
        assert found['bytes'] == sum(path.stat().st_size for path in run)
        parts = [read(path) for path in run]
        assert found['run']['steps'] == STEPS == sum(part.simulated for part in parts)
        assert found['run']['states'] == sum(part.states for part in parts)
        assert found['run']['accepted'] == sum(p.verdicts[Verdict.ACCEPTED] for p in parts)
    status, said = said_by(capsys, 'info', *run)
    assert 'files      4 of one run' in said
    assert 'replay     can be verified with `pfd replay LOG ... --verify`' in said


def test_a_changed_run_of_several_files_has_the_bits_of_the_run_in_one_file(
    run: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = recorded_run(tmp_path / 'one.mcap', STEPS)
    logs = []
    for name, words in (('one', [whole]), ('files', run), ('folder', [run[0].parent])):
        out = tmp_path / f'new_{name}.mcap'
        change = ('--what-if', 'payload.mass=0.5', '--out', out)
        status, said = said_by(capsys, 'replay', *words, *change)
        assert status == 0, said
        logs.append(read_log(out))
    assert len(logs[0][STATES]) > 250
    for log in logs[1:]:
        for topic in (STATES, '/sim_arm/commands', '/sim_arm/applied_commands'):
            assert log.messages(topic) == logs[0].messages(topic)
    status, said = said_by(capsys, 'replay', run[0], run[2], '--what-if')
    assert status == 1
    assert 'does not continue' in said


def test_the_files_of_a_run_verify_as_a_whole_in_any_order_and_by_their_folder(
    run: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    for words in (run, run[::-1], [run[0].parent]):
        status, said = said_by(capsys, 'replay', *words, '--verify')
        assert status == 0, said
        assert 'in 4 files, every bit equal' in said.splitlines()[-1]


def test_each_file_verifies_alone_as_far_as_it_goes(
    run: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    before = ['', 'part 1 of the run', 'parts 1 to 2 of the run', 'parts 1 to 3 of the run']
    for k, path in enumerate(run):
        status, said = said_by(capsys, 'replay', path, '--verify')
        assert status == INCOMPLETE, said
        after = [f'the parts of the run after part {k + 1}'] if k < 3 else []
        missing = ', '.join([*filter(None, [before[k]]), *after])
        assert said.splitlines()[-1].endswith(f'every bit equal; missing: {missing}')
        assert said_by(capsys, 'replay', path, '--verify', '--allow-incomplete')[0] == 0
        summary = read(path, verify=True)
        assert summary.uncompared == 0
        assert summary.states + summary.unpublished == (100 if k < 3 else 30)


@pytest.mark.parametrize(
    ('kept', 'missing'),
    [
        ([0, 1, 2], 'the parts of the run after part 3'),
        ([1, 2, 3], 'part 1 of the run'),
        ([0, 3], 'parts 2 to 3 of the run'),
        ([1], 'part 1 of the run, the parts of the run after part 2'),
    ],
)
def test_missing_files_are_named(
    run: list[Path], capsys: pytest.CaptureFixture[str], kept: list[int], missing: str
) -> None:
    status, said = said_by(capsys, 'replay', *(run[k] for k in kept), '--verify')
    assert status == INCOMPLETE, said
    assert said.splitlines()[-1].endswith(f'; missing: {missing}')


def test_a_file_twice_and_a_file_of_another_run_are_refused(
    run: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    twice = Path(shutil.copy(run[1], tmp_path / 'b.mcap'))
    status, said = said_by(capsys, 'replay', *run, twice, '--verify')
    assert (status, said.count('\n')) == (1, 1)
    assert 'are both part 2' in said
    recorded_run(tmp_path / 'other.mcap', STEPS, recording_max_duration=0.12)
    other = tmp_path / 'other_000002.mcap'
    status, said = said_by(capsys, 'replay', run[0], other, *run[2:], '--verify')
    assert (status, said) == (1, f'pfd replay: {other} is of another run than {run[0]}\n')


def test_a_file_that_was_exchanged_for_one_of_the_same_run_is_refused(copies: list[Path]) -> None:
    altered = load(copies[1])
    altered.keep(lambda message: message.topic != '/tf')
    resealed(altered, copies[1])
    with pytest.raises(LogError, match=r'run_000003.* does not follow .*run_000002'):
        read_run(copies)


def test_a_changed_bit_is_found_in_each_file(copies: list[Path]) -> None:
    for path in copies:
        whole = path.read_bytes()
        for topic in (STATES, SAVED, '/sim_arm/commands', '/sim_arm/applied_commands'):
            altered = load(path)
            altered.on(topic)[-1].flip()
            resealed(altered, path)
            with pytest.raises(LogError):
                read_run([path], verify=True)
            with pytest.raises(LogError):
                read_run(copies, verify=True)
        path.write_bytes(whole)
    assert read_run(copies, verify=True).absent == []


def test_a_state_at_a_boundary_is_compared_with_the_replay_of_the_file_before(
    copies: list[Path],
) -> None:
    altered = load(copies[1])
    saved = altered.on(SAVED)[0]
    state = ArmState.from_bytes(decode_bytes(saved.data))
    state.link.sent += 1
    saved.data = encode_bytes(state.to_bytes())
    resealed(altered, copies[1])
    with pytest.raises(DifferenceError, match='step 150: arm_state: link of the whole state'):
        read(copies[1], verify=True)
    with pytest.raises(DifferenceError, match='step 100: arm_state: link of the whole state'):
        read_run(copies[:2], verify=True)


@pytest.mark.parametrize('cut', [0, 1, 3])
def test_a_file_that_was_cut_off_and_recovered_is_named_and_the_others_verify(
    copies: list[Path], capsys: pytest.CaptureFixture[str], cut: int, tmp_path: Path
) -> None:
    data = copies[cut].read_bytes()
    copies[cut].write_bytes(data[: len(data) * 2 // 5])
    status, said = said_by(capsys, 'replay', *copies, '--verify')
    assert status == INCOMPLETE, said
    name = copies[cut].name
    assert said.endswith(f'; missing: the end of the file, which was not closed ({name})\n')
    (tmp_path / 'recovered').mkdir()
    whole = tmp_path / 'recovered' / name
    recover(copies[cut], whole)
    copies[cut] = whole
    status, said = said_by(capsys, 'replay', *copies, '--verify')
    assert status == INCOMPLETE, said
    assert (
        f'the end record of the node, without which messages at the end may be missing ({name})'
        in said
    )


def test_info_names_the_part(run: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    status, said = said_by(capsys, 'info', run[1])
    assert status == 0
    assert 'in part 2 of a run that begins after step 100' in said
    assert (
        'replay     as part 2 of a run: `pfd replay LOG ... --verify` with all its files' in said
    )
    status, said = said_by(capsys, 'info', run[1], '--json')
    found = json.loads(said)['run']
    assert (found['part'], found['first_step'], found['continues']) == (2, 101, True)


def test_a_later_file_is_no_start_of_a_changed_run(
    run: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    status, said = said_by(capsys, 'replay', run[1], '--what-if', 'friction=true')
    assert (status, said.count('\n')) == (1, 1)
    assert 'is part 2 of a run: expected a log from its start' in said


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
    assert read_run(files, verify=True).absent == []


def test_a_run_below_its_limits_is_one_file_of_number_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded_run(tmp_path / 'run.mcap', 60, recording_max_size=10**9, recording_max_duration=1e3)
    (only,) = tmp_path.iterdir()
    assert only.name == 'run_000001.mcap'
    status, said = said_by(capsys, 'replay', only, '--verify')
    assert status == 0
    assert 'part' not in said


def test_messages_that_were_dropped_before_a_boundary_are_counted_once(tmp_path: Path) -> None:
    # As for a slow disk: the queue takes nothing for some steps around a boundary.
    driver, log = opened_run(
        tmp_path / 'run.mcap', recording_max_duration=0.1, recording_flush_period=0.01
    )
    recorder = log.recorder

    def disturb(step: int) -> None:
        if not 90 <= step <= 110:
            return
        full = step < 110
        while len(recorder._queue):
            time.sleep(0.001)
        # Each message is looked at.
        recorder._free = -1
        recorder._capacities = [
            (0, 0) if full and not t.vital and t.name != SAVED else (1 << 17, 1 << 26)
            for t in recorder.topics
        ]

    run_steps(driver, log, 250, disturb)
    with pytest.raises(Exception, match='were not recorded'):
        log.close()
    found = read_run(sorted(tmp_path.iterdir()), verify=True)
    assert len(found.parts) == 3
    lost = [sum(part.lost.values()) for part in found.parts]
    assert (lost[0] > 0, lost[1] > 0, lost[2]) == (True, True, 0)
    assert sum(lost) == sum(recorder.dropped)
    assert any('were not recorded' in line for line in found.absent)


# --- bad limits and files


@pytest.mark.parametrize(
    ('values', 'expected'),
    [
        ({'recording_max_size': -1}, 'recording_max_size is -1, expected 0 to'),
        ({'recording_max_duration': -0.5}, 'recording_max_duration is -0.5, expected 0.0 to'),
        ({'recording_max_duration': float('nan')}, 'recording_max_duration holds nan'),
        ({'recording_max_duration': float('inf')}, 'recording_max_duration holds inf'),
        ({'recording_flush_period': 0.0}, 'recording_flush_period is 0.0, expected 0.01 to'),
        ({'recording_flush_period': float('nan')}, 'recording_flush_period holds nan'),
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


def test_a_size_below_that_of_the_head_is_refused_and_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match='recording_max_size is 500 bytes, expected more than'):
        opened_run(tmp_path / 'run.mcap', recording_max_size=500)
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_another_recording_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / 'run_000007.mcap').write_bytes(b'mine')
    with pytest.raises(FileExistsError, match=r'run_000007\.mcap exists, of another recording'):
        opened_run(tmp_path / 'run.mcap', recording_max_duration=0.1)
    assert [path.name for path in tmp_path.iterdir()] == ['run_000007.mcap']


def failed(folder: Path, before: Callable[[], object]) -> str:
    """Return the error of a run that cannot begin its second file, and check what it leaves."""
    driver, log = opened_run(folder / 'run.mcap', recording_max_duration=0.1)
    before()
    run_steps(driver, log, 150)
    with pytest.raises(Exception, match='recording stopped: ') as caught:
        log.close()
    recorder = log.recorder
    assert log.engine.cycles == 150
    states = [topic.name for topic in recorder.topics].index(STATES)
    found = read(folder / 'run_000001.mcap', verify=True)
    assert found.states == recorder.recorded[states]
    assert found.steps == 100
    return str(caught.value)


def test_a_second_file_that_exists_ends_the_recording_with_one_line(tmp_path: Path) -> None:
    second = tmp_path / 'run_000002.mcap'
    error = failed(tmp_path, lambda: second.write_bytes(b'mine'))
    assert error == (
        f'recording stopped: {second} exists and is not overwritten; choose another name; '
        'the part written so far is readable'
    )
    assert second.read_bytes() == b'mine'


def test_a_disk_that_is_full_at_a_split_ends_the_recording_with_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pfd_ros.recording import run_files

    real = run_files.McapFile

    def full(path: Path, *args: object) -> object:
        if path.name.endswith('2.mcap'):
            with largest_file(10):
                return real(path, *args)
        return real(path, *args)

    monkeypatch.setattr(run_files, 'McapFile', full)
    error = failed(tmp_path, lambda: None)
    assert 'run_000002.mcap cannot be written: File too large; the part written so far' in error
    assert [path.name for path in tmp_path.iterdir()] == ['run_000001.mcap']


@pytest.mark.parametrize('leap', [-3600 * 10**9, 3600 * 10**9])
def test_a_clock_that_jumps_moves_no_boundary(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, leap: int
) -> None:
    driver, log = opened_run(
        tmp_path / 'run.mcap', recording_max_duration=0.1, recording_time='wall'
    )
    real = time.time_ns
    monkeypatch.setattr(time, 'time_ns', lambda: real() + leap)
    run_steps(driver, log, 250)
    log.close()
    found = read_run(sorted(tmp_path.iterdir()), verify=True)
    assert [part.start for part in found.parts] == [0, 100, 200]
    assert found.absent == []


@pytest.mark.parametrize(
    ('change', 'expected'),
    [
        ({'number': 1}, 'number of part is 1, expected 2 and more'),
        ({'number': True}, 'number of part is True'),
        ({'first': 'x'}, "first of part is 'x', expected SHA-256"),
        ({'previous': None}, 'previous of part is None, expected SHA-256'),
        ({'recorded': 7}, 'recorded is 7, expected an object'),
        ({'dropped': {}}, r'messages dropped before it are of \[\]'),
    ],
)
def test_a_damaged_place_in_the_head_is_one_line(
    copies: list[Path], change: dict[str, object], expected: str
) -> None:
    altered = load(copies[1])
    altered.edit(HEAD, 'part', lambda part: part | change)
    altered.save(copies[1])
    with pytest.raises(LogError, match=expected) as caught:
        read_run(copies)
    assert '\n' not in str(caught.value)


def test_a_folder_without_files_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, said = said_by(capsys, 'replay', tmp_path, '--verify')
    assert (status, said) == (1, f'pfd replay: {tmp_path} is a folder without MCAP files\n')


def test_an_unfinished_second_file_of_a_running_node_is_read_to_its_last_flush(
    tmp_path: Path,
) -> None:
    driver, log = opened_run(tmp_path / 'run.mcap', recording_max_duration=0.1)
    states = [topic.name for topic in log.recorder.topics].index(STATES)
    run_steps(driver, log, 150)
    while log.recorder.recorded[states] < 100:
        time.sleep(0.005)
    found = read_run(sorted(tmp_path.iterdir()), verify=True)
    assert len(found.parts) == 2
    assert found.absent == ['the end of the file, which was not closed (run_000002.mcap)']
    log.close()
    assert read_run(sorted(tmp_path.iterdir()), verify=True).absent == []
