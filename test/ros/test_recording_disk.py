# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings on a disk that fails, fills up or hangs, under names that cannot be or get lost."""

from __future__ import annotations

from collections.abc import Callable
import errno
import os
from pathlib import Path
import shutil
import threading

from mcap.records import Attachment
from plant_messages import efforts
import pytest
from recordings import (
    HAS_DEFINITIONS,
    check_failed,
    counts,
    fail_after,
    flushed,
    largest_file,
    only_there,
    raising,
    read,
    refuse,
    running,
    start,
    write,
)
from rewriting import Recording
from simulating import simulate
from waiting import wait_until

from pfd_ros.recording import recorder as recording
from pfd_ros.recording.format import HEAD
from pfd_ros.recording.mcap_file import FileHead, TimeBase, Topic
from pfd_ros.recording.recorder import LogRecorder
from pfd_ros.replay import verify as replay

pytestmark = pytest.mark.skipif(not HAS_DEFINITIONS, reason='needs definitions of ROS')

# --- faults of the disk


def half(real: Callable[..., int]) -> Callable[..., int]:
    """Return a write that takes half and then fails."""

    def write(file: int, data: memoryview) -> int:
        if len(data) > 100:
            return real(file, data[: len(data) // 2])
        return refuse()

    return write


FAULTS = {
    'error': ({'write': lambda real: refuse}, 'Input/output error'),
    'nothing taken': ({'write': lambda real: lambda *args: 0}, 'no bytes written'),
    'half taken': ({'write': half}, 'Input/output error'),
    'half taken, not to be taken back': (
        {'write': half, 'ftruncate': lambda real: raising(OSError(errno.EROFS, 'read-only'))},
        'Input/output error',
    ),
    'sync': ({'fdatasync': lambda real: refuse}, 'Input/output error'),
    'stat': ({'stat': lambda real: refuse}, 'Input/output error'),
}


@pytest.mark.parametrize('name', FAULTS)
def test_a_fault_of_the_disk_ends_the_recording_with_its_cause(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls, cause = FAULTS[name]
    monkeypatch.setattr(recording, 'SYNC_SECONDS', 0.02)
    recorder, reports = running(tmp_path / 'a.mcap')
    for call, fake in calls.items():
        real = getattr(os, call)
        monkeypatch.setattr(os, call, only_there(fake(real), real))
    sent = fail_after(recorder, 20)
    torn = 'ftruncate' in calls
    check_failed(recorder, reports, sent, tmp_path / 'a.mcap', torn=torn)
    assert f'a.mcap cannot be written: {cause}; the part written so far' in recorder.error


@pytest.mark.parametrize('call', ['fdatasync', 'close'])
def test_closing_the_file_may_fail_too(
    call: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, 'SYNC_SECONDS', 1e9)
    recorder, reports = running(tmp_path / 'a.mcap')
    real = getattr(os, call)
    monkeypatch.setattr(os, call, only_there(lambda file: (real(file), refuse()), real))
    recorder.close()
    assert recorder.failed
    assert len(reports) == 1
    assert 'Input/output error' in reports[0]


def test_a_disk_that_takes_a_few_bytes_at_a_time_gets_them_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.write
    monkeypatch.setattr(os, 'write', only_there(lambda file, data: real(file, data[:7]), real))
    recorder, reports = start(tmp_path / 'a.mcap')
    flushed(recorder, 100)
    recorder.close()
    found, entries = read(tmp_path / 'a.mcap')
    assert found.complete
    assert counts(entries) == [100, 0]
    assert not reports


# --- a full disk


def test_a_disk_that_is_full_at_the_start_leaves_no_file(tmp_path: Path) -> None:
    with (
        largest_file(100),
        pytest.raises(OSError, match=r'a\.mcap cannot be written: File too large'),
    ):
        start(tmp_path / 'a.mcap')
    assert not list(tmp_path.iterdir())


def record_all(run: Recording, path: Path, room: int) -> tuple[LogRecorder, list[str]]:
    """Record the messages of a run on a disk with room for so many bytes of them."""
    files = [Attachment(0, 0, file.name, file.kind, file.data) for file in run.attachments]
    values = {k: v for k, v in run.head(HEAD).items() if k not in ('digests', 'digest')}
    head = FileHead('test', values, files, TimeBase())
    topics = [Topic(kind.topic, kind.schema, '') for kind in run.channels]
    place = {topic.name: k for k, topic in enumerate(topics)}
    reports: list[str] = []
    recorder = LogRecorder(path, topics, head, reports.append, flush_seconds=1e-3)
    with largest_file(path.stat().st_size + room):
        for m in run.messages:
            recorder.record(place[m.topic], m.sequence, m.data)
        recorder.close()
    return recorder, reports


def test_the_part_of_a_run_before_the_disk_was_full_replays_to_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A flush for each round, of which the disk takes the first few.
    monkeypatch.setattr(recording, 'ROUND_MESSAGES', 50)
    run = simulate(400, {1: [efforts(1.0, 2.0)]}, real_time_factor=0.0, publish_clock=False)
    recorder, reports = record_all(run, tmp_path / 'a.mcap', 8_000)
    assert len(reports) == 1
    assert 'File too large; the part written so far is readable' in reports[0]
    summary = replay.read(tmp_path / 'a.mcap', verify=True)
    assert not summary.complete
    states = [topic.name for topic in recorder.topics].index('/joint_states')
    assert 0 < summary.states == recorder.recorded[states] < 400
    assert recorder.recorded[states] + recorder.dropped[states] == 400


# --- names that cannot be


def fifo(folder: Path) -> Path:
    os.mkfifo(folder / 'fifo')
    return folder / 'fifo'


def dangling(folder: Path) -> Path:
    (folder / 'link').symlink_to(folder / 'nothing')
    return folder / 'link'


def looping(folder: Path) -> Path:
    (folder / 'loop').symlink_to(folder / 'loop')
    return folder / 'loop' / 'a.mcap'


def refusing(folder: Path) -> Path:
    """Return a name in a folder that takes no file, from root neither."""
    if os.geteuid() == 0:
        return Path('/sys/a.mcap')
    (folder / 'closed').mkdir(mode=0o500)
    return folder / 'closed' / 'a.mcap'


TAKEN = 'exists and is not overwritten'
BAD_NAMES = {
    'fifo': (fifo, FileExistsError, TAKEN),
    'dangling link': (dangling, FileExistsError, TAKEN),
    'folder': (lambda folder: folder, FileExistsError, TAKEN),
    'nothing': (lambda folder: Path(), FileExistsError, TAKEN),
    'device': (lambda folder: Path('/dev/full'), FileExistsError, TAKEN),
    'no folder': (
        lambda folder: folder / 'nix' / 'a.mcap',
        OSError,
        r'nix/a\.mcap cannot be written: No such file',
    ),
    'below a file': (lambda folder: Path('/dev/full/a.mcap'), OSError, 'Not a directory'),
    'loop': (looping, OSError, 'Too many levels of symbolic links'),
    'refusing folder': (refusing, OSError, 'cannot be written'),
    '300 characters': (lambda folder: folder / ('a' * 300), OSError, 'File name too long'),
    '400 kB': (lambda folder: folder / ('nix/' * 100_000), OSError, 'File name too long'),
    'two lines': (lambda folder: folder / 'two\nlines' / 'a', OSError, 'No such file'),
    'null': (lambda folder: folder / 'a\0b', ValueError, 'is not a valid file name'),
    'surrogate': (lambda folder: folder / '\ud800', ValueError, 'is not a valid file name'),
}


@pytest.mark.parametrize('name', BAD_NAMES)
def test_a_name_that_cannot_be_written_is_one_line_at_the_start(name: str, tmp_path: Path) -> None:
    make, kind, text = BAD_NAMES[name]
    path = make(tmp_path)
    before = sorted(tmp_path.rglob('*')), threading.active_count()
    with pytest.raises(kind, match=text) as caught:
        start(path)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 400
    assert (sorted(tmp_path.rglob('*')), threading.active_count()) == before


def test_a_file_is_never_written_over(tmp_path: Path) -> None:
    (tmp_path / 'a.mcap').write_bytes(b'dear')
    with pytest.raises(FileExistsError, match=rf'a\.mcap {TAKEN}'):
        write(tmp_path / 'a.mcap', 1)
    assert (tmp_path / 'a.mcap').read_bytes() == b'dear'


# --- names that get lost


def replace(path: Path) -> None:
    path.with_name('b.mcap').write_bytes(b'other')
    os.link(path, path.with_name('c.mcap'))
    # At once: between two renames the name would be nobody's.
    path.with_name('b.mcap').replace(path)


def cover(path: Path) -> None:
    shutil.rmtree(path.parent)
    path.parent.write_bytes(b'a file in the place of the folder')


LOSSES: dict[str, tuple[Callable[[Path], object], str]] = {
    'remove': (Path.unlink, 'removed'),
    'remove_folder': (lambda path: shutil.rmtree(path.parent), 'removed'),
    'cover': (cover, 'removed'),
    'move': (lambda path: path.rename(path.with_name('b.mcap')), 'moved'),
    'move_folder': (lambda path: path.parent.rename(path.parent.with_name('b')), 'moved'),
    'replace': (replace, 'replaced'),
}


@pytest.mark.parametrize('name', LOSSES)
@pytest.mark.parametrize('closing', [False, True], ids=['running', 'closing'])
def test_a_file_that_loses_its_name_is_a_failure(
    name: str, closing: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lose, loss = LOSSES[name]
    monkeypatch.setattr(recording, 'SYNC_SECONDS', 1e9 if closing else 0.02)
    path = tmp_path / 'folder' / 'a.mcap'
    path.parent.mkdir()
    recorder, reports = running(path)
    lose(path)
    if not closing:
        wait_until(lambda: recorder.failed)
    recorder.close()
    (line,) = reports
    assert line.startswith(f'recording stopped: {path} was {loss} while it was written; keep log')


@pytest.mark.parametrize('closing', [False, True], ids=['running', 'closing'])
@pytest.mark.parametrize('part', [0.0, 0.9])
def test_a_truncated_file_is_a_failure_and_keeps_its_remaining_messages(
    part: float, closing: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, 'SYNC_SECONDS', 1e9)
    path = tmp_path / 'a.mcap'
    recorder, reports = running(path)
    whole = path.read_bytes()
    size = int(part * len(whole))
    os.truncate(path, size)
    if not closing:
        fail_after(recorder, 20)
    recorder.close()
    (line,) = reports
    assert f'{path} was truncated from {len(whole)} to {size} bytes while it was written' in line
    assert recorder.failed
    assert path.read_bytes() == whole[:size]


def test_a_relative_name_works_after_a_change_of_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    recorder, reports = start(Path('a.mcap'))
    monkeypatch.chdir('/')
    recorder.close()
    assert not reports
    assert read(tmp_path / 'a.mcap')[0].complete
