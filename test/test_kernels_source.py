# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recording and compiling from many threads and in children of a process that does."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
import gc
import os
import signal
import threading
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from zoo import random_chain

import pfd_core as pfd
from pfd_core.kernels import source as recipe
from pfd_core.kernels.runtime import disk_cache as cache
from pfd_core.kernels.runtime import jit as engine

THREADS = 8
TURNS = 100
LIFETIME = 120  # [s] of a child; far above what it takes


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let another thread run between the look at the collector and what is done about it."""

    def enabled() -> bool:
        found = gc.isenabled()
        time.sleep(1e-5)
        return found

    slow = SimpleNamespace(isenabled=enabled, enable=gc.enable, disable=gc.disable)
    monkeypatch.setattr(recipe, 'gc', slow)
    yield
    gc.enable()


@pytest.fixture
def uncached(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile everything."""
    monkeypatch.setenv(cache.VARIABLE, '')


# Takes long enough to compile that a process is copied meanwhile.
LONG = '\n  '.join(
    [
        'define double @f(double %y0) {',
        *(f'%y{k + 1} = fadd double %y{k}, {k}.5' for k in range(1000)),
        'ret double %y1000\n}',
    ]
)


def record_nothing(turns: int) -> None:
    for _ in range(turns):
        with recipe.uncollected():
            time.sleep(1e-5)
            assert not gc.isenabled()


def test_cycles_are_collected_again_after_recordings_by_many_threads(hurried: None) -> None:
    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(record_nothing, [TURNS] * THREADS))
    assert gc.isenabled()


def test_cycles_stay_where_garbage_collection_is_disabled(hurried: None) -> None:
    gc.disable()
    record_nothing(1)
    assert not gc.isenabled()


def child_ends(work: Callable[[], Any]) -> int:
    """Return how a child ends that does some work and fails if it collects no cycles."""
    child = os.fork()
    if not child:
        enabled = gc.isenabled()
        signal.alarm(LIFETIME)
        work()
        os._exit(not enabled)
    return os.waitpid(child, 0)[1]


@pytest.mark.skipif(not hasattr(os, 'fork'), reason='needs fork')
@pytest.mark.filterwarnings('ignore:This process .* is multi-threaded:DeprecationWarning')
@pytest.mark.parametrize(
    'work',
    [lambda: record_nothing(10), lambda: engine.compile_ir(LONG).address('f')],
    ids=['records', 'compiles'],
)
def test_a_child_of_a_process_that_is_busy_with_kernels_may_be_so_too(
    hurried: None, uncached: None, work: Callable[[], Any]
) -> None:
    over = threading.Event()

    def busy() -> None:
        while not over.is_set():
            work()

    with ThreadPoolExecutor(2) as pool:
        threads = [pool.submit(busy) for _ in range(2)]
        try:
            ends = [child_ends(work) for _ in range(10)]
        finally:
            over.set()
    assert not any(ends)
    assert all(thread.result() is None for thread in threads)


@pytest.mark.slow
def test_threads_that_compile_one_kernel_together_get_the_same_bits(uncached: None) -> None:
    robot = random_chain(np.random.default_rng(1), 3)
    rows = np.random.default_rng(2).uniform(-1, 1, (3, 5, robot.n))

    def bits(_: int) -> bytes:
        kernel = pfd.compile_kernel(robot)
        return kernel(*rows[:, 0]).tobytes() + kernel(*rows).tobytes()

    with ThreadPoolExecutor(THREADS) as pool:
        assert set(pool.map(bits, range(THREADS))) == {bits(0)}


@pytest.mark.slow
def test_threads_that_call_a_batch_first_together_get_the_same_bits(uncached: None) -> None:
    robot = random_chain(np.random.default_rng(1), 3)
    rows = np.random.default_rng(2).uniform(-1, 1, (3, 5, robot.n))
    wanted = pfd.compile_kernel(robot)(*rows).tobytes()
    for _ in range(4):
        kernel = pfd.compile_kernel(robot)
        barrier = threading.Barrier(THREADS)

        def bits(_: int, kernel: pfd.Kernel = kernel, start: threading.Barrier = barrier) -> bytes:
            start.wait()
            return kernel(*rows).tobytes()

        with ThreadPoolExecutor(THREADS) as pool:
            assert set(pool.map(bits, range(THREADS))) == {wanted}


def test_many_threads_may_compile_the_same_ir(uncached: None) -> None:
    ir = 'define i64 @f(i64 %x) {{\n  %y = add i64 %x, {}\n  ret i64 %y\n}}'
    assert engine.compile_ir(ir.format(1)).address('f')

    def address(k: int) -> int:
        return engine.compile_ir(ir.format(k % 3)).address('f')

    with ThreadPoolExecutor(THREADS) as pool:
        assert all(pool.map(address, range(10 * THREADS)))
