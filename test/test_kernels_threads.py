# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Threads of a batch: the same bits however many there are; and the memory of a process."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
import os
from pathlib import Path
import subprocess
import sys
import threading
import time

import bridge
from bridge import block_size, run_blocks, thread_count
import numpy as np
import pytest
from sampling import one_fast
from zoo import random_chain, random_states

import pfd_core as pfd


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    # Blocks of single registers, so that a small batch is shared, and more threads than cores.
    monkeypatch.setattr(*bridge.target('MIN_BLOCK_WORK'), 1)
    monkeypatch.setattr(*bridge.target('SINGLE_THREAD_WORK'), 0)
    monkeypatch.setattr(*bridge.target('cores'), lambda: 8)
    monkeypatch.setattr(*bridge.target('thread_pool'), None)
    bridge.new_thread_pool()


@pytest.mark.parametrize('dtype', one_fast(['float64', 'float32']))
@pytest.mark.parametrize('order', ['C', 'F'])
def test_the_bits_depend_neither_on_the_threads_nor_on_the_size(dtype: str, order: str) -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'), dtype=dtype)
    whole = kernel(*random_states(6, 1000, dtype))
    for size in (0, 1, 7, 16, 17, 333, 1000):
        arrays = [np.array(x[:size], order=order) for x in random_states(6, 1000, dtype)]
        for count in (0, 1, 2, 3, 8):
            np.testing.assert_array_equal(kernel(*arrays, threads=count), whole[:size])


def test_every_argument_is_split_among_the_threads() -> None:
    rng = np.random.default_rng(71)
    scene = pfd.Scene(external_wrench=True, brakes=True)
    kernel = pfd.compile_kernel(random_chain(rng, 3), scene=scene)
    q, qd, tau = random_states(3, 200)
    wrench, brakes = rng.normal(size=(200, 6)), rng.random((200, 3)) < 0.3
    wanted = kernel(q, qd, tau, wrench, brakes=brakes)
    found = kernel(q, qd, tau, wrench, brakes=brakes, threads=3)
    np.testing.assert_array_equal(found, wanted)
    # One row for all states has a stride of zero.
    wanted = kernel(q, qd[0], tau, wrench[1], brakes=brakes[2])
    found = kernel(q, qd[0], tau, wrench[1], brakes=brakes[2], threads=3)
    np.testing.assert_array_equal(found, wanted)
    out = np.empty((200, 3), order='F')
    assert kernel(q[::-1], qd, tau, wrench, brakes=brakes, out=out, threads=2) is out
    np.testing.assert_array_equal(out, kernel(q[::-1], qd, tau, wrench, brakes=brakes))


def test_bound_arrays_are_computed_by_threads() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'))
    q, qd, tau = random_states(6, 500)
    out = np.empty((500, 6))
    step = kernel.bind(q, qd, tau, out, threads=2)
    q += 0.25
    step()
    np.testing.assert_array_equal(out, kernel(q, qd, tau))


def test_a_number_that_is_not_finite_is_found_in_any_block() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
    for row in (0, 100, 199):
        q, qd, tau = random_states(2, 200)
        tau[row, 1] = np.inf
        with pytest.raises(
            ValueError, match=rf'tau must be finite, got inf at index \[{row}, 1\]'
        ):
            kernel(q, qd, tau, threads=2)


def test_an_absurd_number_of_threads_is_cut_to_the_cores() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
    arrays = random_states(2, 300)
    np.testing.assert_array_equal(kernel(*arrays, threads=10**400), kernel(*arrays))
    assert thread_count(np.int64(10**8)) == bridge.cores()


def test_a_block_is_worth_a_worker_and_answers_a_signal_in_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(*bridge.target('MIN_BLOCK_WORK'), 500_000)
    monkeypatch.setattr(*bridge.target('SINGLE_THREAD_WORK'), 1_000_000)
    assert block_size(16_000, 8, 8, 500) == 16_000
    assert block_size(17_000, 8, 8, 500) == 8000
    assert block_size(1000, 8, 8, 50_000) == 128
    for number in (1, 2):
        assert block_size(10**9, number, 8, 500) == 8 * bridge.MAX_BLOCK_WORK // 500
        assert block_size(10**9, number, 8, 10 * bridge.MAX_BLOCK_WORK) == 8


def test_a_small_batch_starts_no_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    monkeypatch.setattr(*bridge.target('cores'), lambda: 8)
    monkeypatch.setattr(*bridge.target('thread_pool'), None)
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'))
    arrays = random_states(6, 4096)
    np.testing.assert_array_equal(kernel(*arrays, threads=2), kernel(*arrays))


def test_workers_have_ended_their_blocks_when_the_caller_is_stopped() -> None:
    caller, working = threading.get_ident(), threading.Semaphore(0)
    begun: list[int] = []
    ended: list[int] = []

    def work(first: int, size: int) -> int:
        if threading.get_ident() == caller:
            assert working.acquire(timeout=60)
            raise KeyboardInterrupt
        begun.append(first)
        working.release()
        time.sleep(0.01)
        ended.append(first)
        return 0

    with pytest.raises(KeyboardInterrupt):
        run_blocks(work, 1000, 1, 3)
    assert 1 <= len(begun) < 1000
    assert sorted(begun) == sorted(ended)


@pytest.mark.parametrize('stage', ['ended', 'thread'])
def test_the_caller_works_alone_where_no_worker_can_be_had(
    stage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if stage == 'ended':
        bridge.thread_pool.shutdown()
    else:

        def refuse(self: threading.Thread) -> None:
            raise RuntimeError("can't start new thread")

        monkeypatch.setattr(threading.Thread, 'start', refuse)
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
    arrays = random_states(2, 300)
    np.testing.assert_array_equal(kernel(*arrays, threads=4), kernel(*arrays))


def test_many_callers_share_the_workers() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'))
    arrays = random_states(6, 3000)
    expected = kernel(*arrays)
    with ThreadPoolExecutor(4) as callers:
        found = list(callers.map(lambda _: kernel(*arrays, threads=3), range(80)))
    for out in found:
        np.testing.assert_array_equal(out, expected)


def test_a_kernel_may_be_deleted_as_soon_as_it_has_answered() -> None:
    # Memory of code that is gone is unmapped.
    robot = pfd.load_robot('planar2')
    q, qd, tau = random_states(2, 40)
    expected = pfd.compile_kernel(robot)(q, qd, tau)
    for _ in range(50):
        found = pfd.compile_kernel(robot)(q, qd, tau, threads=4)
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    ('files', 'expected'),
    [
        ({}, 8),
        ({'/proc/self/cgroup': '0::/', '/sys/fs/cgroup/cpu.max': 'max 100000'}, 8),
        ({'/proc/self/cgroup': '0::/\n', '/sys/fs/cgroup/cpu.max': '150000 100000\n'}, 2),
        ({'/proc/self/cgroup': '0::/', '/sys/fs/cgroup/cpu.max': '1000 100000'}, 1),
        ({'/proc/self/cgroup': '0::/', '/sys/fs/cgroup/cpu.max': 'no number'}, 8),
        ({'/proc/self/cgroup': '1:cpu:/\n0::/a/b\n', '/sys/fs/cgroup/a/cpu.max': '3 1'}, 3),
        ({'/proc/self/cgroup': '0::/../out', '/sys/fs/cgroup/cpu.max': '400000 100000'}, 4),
    ],
)
def test_the_smallest_quota_of_all_cgroups_and_the_affinity_bound_the_cores(
    files: dict[str, str], expected: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_text(path: Path) -> str:
        try:
            return files[os.path.normpath(path)]
        except KeyError:
            raise FileNotFoundError from None

    monkeypatch.undo()
    monkeypatch.setattr(os, 'sched_getaffinity', lambda _: set(range(8)), raising=False)
    monkeypatch.setattr(Path, 'read_text', read_text)
    assert bridge.cores.__wrapped__() == expected


# ---- memory ----


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
