# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings whose threads and processes end at any moment, many times over."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
import json
from pathlib import Path
import random
import signal
import subprocess
import sys
import time
from typing import Any

import pytest
from recordings import HAS_DEFINITIONS, counts, digests, read
from ros_processes import environment, in_namespaces
from waiting import PATIENCE

from pfd_ros.recording import reader as log

HERE = Path(__file__).resolve().parent
OFTEN = [2, pytest.param(40, marks=[pytest.mark.slow, pytest.mark.long])]
# Longest time that a process lives on before its signal, s.
LIFE = 0.3
AT_ONCE = 4

pytestmark = pytest.mark.skipif(not HAS_DEFINITIONS, reason='needs definitions of ROS')


@contextmanager
def recording(path: Path, way: str, *before: str) -> Iterator[subprocess.Popen[bytes]]:
    """Start a process that records, wait until it does, and leave none behind."""
    command = [*before, sys.executable, str(HERE / 'recording_process.py'), str(path), way]
    process = subprocess.Popen(
        command,
        env=environment(0),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # Unbuffered: `communicate` does not see bytes that `readline` read ahead.
        bufsize=0,
    )
    try:
        assert process.stdout.readline() == b'ready\n', process.communicate()
        yield process
    finally:
        process.kill()
        process.communicate(timeout=PATIENCE)


def check_messages(entries: list[log.Entry]) -> None:
    """Check that the messages of each topic are the first that were recorded, in order."""
    for role in ('joint_states', 'joint_commands'):
        mine = [entry for entry in entries if entry.role == role]
        assert [e.sequence for e in mine] == list(range(1, len(mine) + 1))
        assert all(e.data == e.sequence.to_bytes(8, 'little') * (e.sequence % 64) for e in mine)
    times = [entry.log_ns for entry in entries]
    assert times == sorted(times)


def several(often: int, once: Callable[[Path], None], folder: Path) -> None:
    """Do something often, a few at a time: mostly it waits for processes."""
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for _ in pool.map(once, [folder / f'{k}.mcap' for k in range(often)]):
            pass


def check_cut_off(path: Path) -> list[int]:
    """Check a file that was never closed; return how many messages of each topic it holds."""
    found, entries = read(path)
    assert not found.complete
    assert min(counts(entries)) > 0
    check_messages(entries)
    return counts(entries)


@pytest.mark.parametrize('often', OFTEN)
@pytest.mark.parametrize('way', ['kill', 'raise'])
@pytest.mark.slow
def test_a_process_that_ends_without_closing_leaves_the_first_messages_of_each_topic(
    way: str, often: int, tmp_path: Path
) -> None:
    rng = random.Random(1)

    def once(path: Path) -> None:
        with recording(path, way) as process:
            if way == 'kill':
                time.sleep(LIFE * rng.random())
                process.kill()
            assert process.wait(PATIENCE) == {'kill': -signal.SIGKILL, 'raise': 1}[way]
        check_cut_off(path)

    several(often, once, tmp_path)


def told_by(process: subprocess.Popen[bytes]) -> dict[str, Any]:
    """Return the last line of a process that must end well: the counts of its recorder."""
    output, errors = process.communicate(timeout=PATIENCE)
    assert (process.returncode, errors) == (0, b'')
    return json.loads(output)


@pytest.mark.parametrize('often', OFTEN)
@pytest.mark.slow
def test_closing_while_two_threads_write_leaves_exact_counts_and_digests(
    often: int, tmp_path: Path
) -> None:
    def once(path: Path) -> None:
        with recording(path, 'close') as process:
            told = told_by(process)
        found, entries = read(path)
        assert found.complete
        assert (told['error'], told['dropped']) == ('', [0, 0])
        assert json.loads(found.end_texts['recorded']) == told['recorded'] == counts(entries)
        assert json.loads(found.end_texts['digests']) == digests(entries)
        check_messages(entries)

    several(often, once, tmp_path)


@pytest.mark.parametrize('often', OFTEN)
@pytest.mark.slow
def test_a_process_whose_disk_hangs_in_the_kernel_ends_all_the_same(
    often: int, tmp_path: Path
) -> None:
    def once(path: Path) -> None:
        with recording(path, 'clog') as process:
            told = told_by(process)
        assert 'closing took longer than 0.2 s' in told['error']
        assert check_cut_off(path) == told['recorded']

    several(often, once, tmp_path)


def test_a_full_file_system_ends_the_recording_and_leaves_it_readable(tmp_path: Path) -> None:
    folder = tmp_path / 'small'
    folder.mkdir()
    # The mount is the process's own and ends with it; its file is read through /proc.
    script = 'mount -t tmpfs -o size=256k tmpfs "$0" && exec "$@"'
    before = (*in_namespaces('--mount'), 'sh', '-c', script, str(folder))
    with recording(folder / 'a.mcap', 'full', *before) as process:
        told = json.loads(process.stdout.readline())
        held = check_cut_off(Path(f'/proc/{process.pid}/root{folder}/a.mcap'))
    assert told['error'].endswith(
        'a.mcap cannot be written: No space left on device; the part written so far is readable'
    )
    assert held == told['recorded']
