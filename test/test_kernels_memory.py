# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A process that compiles again and again keeps no memory of what it compiled."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys

import pytest

# Compilations before memory is measured: caches of Python, NumPy and the allocator are full then.
WARM_UP = 30
# Growth of the resident memory for each compilation [B]: pages that the allocator has fragmented.
# The pipeline of LLVM's passes alone takes 45 kB, and passes over a kernel four times as much.
GROWTH = 15_000
# Far longer than any of the processes takes [s].
PATIENCE = 3000.0
# The C library neither returns the end of the heap to the system nor takes it in small pieces:
# else one piece of 660 kB, kept or not, decides.
STEADY = {
    'MALLOC_TRIM_THRESHOLD_': '4000000',
    'MALLOC_TOP_PAD_': '1000000',
    'MALLOC_MMAP_THRESHOLD_': '100000000',
}
SCRIPT = """
import gc, os, sys
import pfd_core as pfd

def resident():
    gc.collect()
    with open('/proc/self/statm') as file:
        return int(file.read().split()[1]) * os.sysconf('SC_PAGE_SIZE')

def compiled(first, count):
    for k in range(first, first + count):
        pfd.compile_kernel(robot, scene=pfd.Scene(gravity=(0.0, 0.0, -9.0 - k)))
        gc.collect()  # else the heap is as large as what happens to be uncollected

robot = pfd.lock(pfd.load_robot('planar2'), {'elbow': 0.0})
warm_up, count = map(int, sys.argv[1:])
compiled(0, warm_up)
before = resident()
compiled(warm_up, count)
print((resident() - before) / count)
"""

needs_proc = pytest.mark.skipif(not Path('/proc/self/statm').exists(), reason='needs /proc')


def growth(count: int) -> float:
    """Return the memory [B] that a fresh process keeps for each of some compilations."""
    found = subprocess.run(
        [sys.executable, '-c', SCRIPT, str(WARM_UP), str(count)],
        env=os.environ | STEADY | {'PFD_CACHE': '', 'PYTHONPATH': os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
        timeout=PATIENCE,
    )
    return float(found.stdout)


@needs_proc
@pytest.mark.slow
@pytest.mark.timeout(PATIENCE)
def test_a_compilation_keeps_no_memory() -> None:
    assert growth(25) <= GROWTH


@needs_proc
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.timeout(PATIENCE)
def test_a_thousand_compilations_keep_no_memory() -> None:
    assert growth(1000) <= GROWTH
