# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fresh processes that compute with threads end with the expected status, every time."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import cycle, islice
import os
from pathlib import Path
import subprocess
import sys

from process_with_threads import STATUSES, WAYS
import pytest

SCRIPT = Path(__file__).with_name('process_with_threads.py')
THREADS = (2, 0, 3)
# Far longer than any of them takes; a process that hangs is killed and reported.
PATIENCE = 120.0
SIDE_BY_SIDE = 2


def ending(case: tuple[str, int]) -> str:
    """Return how a process ended that should not have ended so, or nothing."""
    way, count = case
    command = [sys.executable, '-W', 'ignore::DeprecationWarning', str(SCRIPT), way, str(count)]
    try:
        run = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        return f'{way}, {count} threads: hangs'
    errors = run.stderr.strip().splitlines()
    quiet = not errors or (way == 'by SIGINT' and errors[-1] == 'KeyboardInterrupt')
    if run.returncode == STATUSES.get(way, 0) and quiet:
        return ''
    return f'{way}, {count} threads: status {run.returncode}, {errors[-3:]}'


def cases(number: int) -> list[tuple[str, int]]:
    """Return cases: all ways, each with the next number of threads; then once more, ..."""
    ways = [way for way in WAYS if way != 'with fork' or hasattr(os, 'fork')]
    rounds = [
        (way, THREADS[(k + start) % len(THREADS)])
        for start in range(len(THREADS))
        for k, way in enumerate(ways)
    ]
    return list(islice(cycle(rounds), number))


def failures(number: int) -> list[str]:
    with ThreadPoolExecutor(SIDE_BY_SIDE) as starters:
        return [text for text in starters.map(ending, cases(number)) if text]


@pytest.mark.slow
def test_processes_with_threads_end_well() -> None:
    assert failures(len(WAYS)) == []


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.timeout(3600)
def test_hundreds_of_processes_with_any_number_of_threads_end_well() -> None:
    assert failures(300) == []
