# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Damaged and hostile recordings: one line, status 1, little time, little memory.

All are made from the golden recording, and verified by one process.
"""

from __future__ import annotations

import json
from pathlib import Path
import struct
import subprocess
import sys
from typing import Any

import hostile_bytes
import hostile_heads
import hostile_messages
from mcap.opcode import Opcode
from mcap.writer import CompressionType
import pytest
from rewriting import GOLDEN, STATES, Recording, Sent, load
from ros_processes import environment

# A process and 180 files; drawn damage is in test_recording_random.
pytestmark = pytest.mark.slow

HERE = Path(__file__).resolve().parent
# Processor time in s after which a file that takes minutes is given up, and memory of the whole
# process in MB.
SECONDS = 30.0
MEGABYTES = 300.0
# A process that has hung in native code is ended after this, s.
PATIENCE = 300.0
# Enough for a file whose settings are read.
FIRST_MESSAGES = 3

REWRITTEN = {**hostile_messages.CASES, **hostile_heads.CASES}
EXPECTED = {
    **{name: case.expected for name, case in (REWRITTEN | hostile_bytes.CASES).items()},
    'sparse_file_of_gigabytes': 'expected at most',
    'chunk_of_empty_messages': 'GOLDEN',
}


def write(folder: Path) -> list[Path]:
    """Write a file for each case, in the order of EXPECTED."""
    names = iter(range(len(EXPECTED)))
    paths = []

    def next_path() -> Path:
        paths.append(folder / f'{next(names)}_GOLDEN.mcap')
        return paths[-1]

    golden = load(GOLDEN)
    short = Recording(golden.metadata, golden.attachments, golden.channels)
    short.messages = golden.messages[:FIRST_MESSAGES]
    for case in REWRITTEN.values():
        changed = (short if case.short else golden).copy()
        case.change(changed)
        changed.save(next_path(), closed=case.closed and not case.short)
    for case in hostile_bytes.CASES.values():
        next_path().write_bytes(case.content())
    with next_path().open('wb') as stream:
        stream.write(hostile_bytes.HEADER + struct.pack('<BQ', Opcode.ATTACHMENT, 1 << 33))
        stream.truncate(1 << 34)
    # Many messages in some kB.
    short.messages = [Sent(STATES, 1, golden.messages[0].log_ns, b'')] * 30_000
    short.save(next_path(), closed=False, chunk_size=1 << 24, compression=CompressionType.LZ4)
    return paths


@pytest.fixture(scope='module')
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """Return the result of verifying each case, and the good file before and after."""
    return replayed('--verify', tmp_path_factory.mktemp('hostile'))


def replayed(option: str, folder: Path) -> dict[str, dict[str, Any]]:
    """Return the result of `pfd replay` with an option for each case and for good files."""
    good = folder / 'good.mcap'
    good.write_bytes(GOLDEN.read_bytes())
    paths = [good, *write(folder), good]
    done = subprocess.run(
        [sys.executable, str(HERE / 'read_hostile.py'), option, str(SECONDS), *map(str, paths)],
        cwd=folder,
        env=environment(1),
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE,
    )
    results = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(results) == len(paths), done.stderr
    return dict(zip(['good', *EXPECTED, 'good again'], results, strict=True))


@pytest.mark.parametrize('name', EXPECTED)
def test_a_hostile_file_is_one_line_and_status_1(
    outcomes: dict[str, dict[str, Any]], name: str
) -> None:
    found = outcomes[name]
    assert found['status'] == 1, found
    assert found['out'] == ''
    lines = found['err'].splitlines()
    assert len(lines) == 1
    assert lines[0].isprintable()
    assert len(lines[0]) < 800
    assert EXPECTED[name] in lines[0]


def test_good_files_verify_before_and_after(outcomes: dict[str, dict[str, Any]]) -> None:
    for name in ('good', 'good again'):
        assert outcomes[name]['status'] == 0
        assert 'every bit equal' in outcomes[name]['out']


def test_no_file_takes_much_memory(outcomes: dict[str, dict[str, Any]]) -> None:
    assert outcomes['good again']['peak_mb'] < MEGABYTES


# Files that can be run, but with outputs that do not follow from their inputs.
DIFFERENT = {
    'end_failure',
    'other_robot',
    'row_other_verdict',
    'row_overflowed',
    'terminal_escapes',
}


def test_a_hostile_file_is_no_source_of_a_what_if_and_takes_little_memory(tmp_path: Path) -> None:
    # All in one test: each worker of a parallel run would make all of the files.
    found = replayed('--what-if', tmp_path)
    assert [name for name in EXPECTED if not _refused_or_run(name, found[name])] == []
    assert {found[name]['status'] for name in ('good', 'good again')} == {0}
    assert found['good again']['peak_mb'] < MEGABYTES


def _refused_or_run(name: str, found: dict[str, Any]) -> bool:
    lines = (found['out'] if name in DIFFERENT else found['err']).splitlines()
    printable = all(line.isprintable() for line in lines)
    if name in DIFFERENT:
        return printable and found['status'] == 0
    one = found['out'] == '' and len(lines) == 1 and len(lines[0]) < 800
    return printable and one and found['status'] == 1
