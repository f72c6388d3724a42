# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Threads of a batch: the same bits however many there are, and nobody is kept waiting."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from test_kernels_kernel import states
from zoo import random_chain

import pfd_core as pfd
from pfd_core.kernels import helpers, threads


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    # Blocks of single registers, so that a small batch is shared, and more threads than cores.
    monkeypatch.setattr(threads, 'LEAST', 1)
    monkeypatch.setattr(threads, 'cores', lambda: 8)


@pytest.mark.parametrize('dtype', ['float64', 'float32'])
@pytest.mark.parametrize('order', ['C', 'F'])
def test_the_bits_depend_neither_on_the_threads_nor_on_the_size(dtype: str, order: str) -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'), dtype=dtype)
    whole = kernel(*states(6, 1000, dtype))
    for size in (0, 1, 7, 16, 17, 333, 1000):
        arrays = [np.array(x[:size], order=order) for x in states(6, 1000, dtype)]
        for count in (0, 1, 2, 3, 8):
            np.testing.assert_array_equal(kernel(*arrays, threads=count), whole[:size])


def test_every_argument_is_dealt_out() -> None:
    rng = np.random.default_rng(71)
    scene = pfd.Scene(external_wrench=True, brakes=True)
    kernel = pfd.compile_kernel(random_chain(rng, 3), scene=scene)
    q, qd, tau = states(3, 200)
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
    q, qd, tau = states(6, 500)
    out = np.empty((500, 6))
    step = kernel.bind(q, qd, tau, out, threads=2)
    q += 0.25
    step()
    np.testing.assert_array_equal(out, kernel(q, qd, tau))


def test_a_number_that_is_not_finite_is_found_in_any_block() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
    for row in (0, 100, 199):
        q, qd, tau = states(2, 200)
        tau[row, 1] = np.inf
        with pytest.raises(
            ValueError, match=rf'tau must be finite, got inf at index \[{row}, 1\]'
        ):
            kernel(q, qd, tau, threads=2)


@pytest.mark.parametrize('wrong', [-1, 1.5, None])
def test_a_number_of_threads_that_makes_no_sense_is_refused(wrong: object) -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
    for arrays in (states(2, 3), [x[0] for x in states(2, 3)]):
        with pytest.raises(ValueError, match='threads must be an integer of at least 0'):
            kernel(*arrays, threads=wrong)  # type: ignore[arg-type]


def test_an_argument_too_few_or_too_many_is_named() -> None:
    robot, wrench = pfd.load_robot('planar2'), np.zeros((30, 6))
    pushed = pfd.compile_kernel(robot, scene=pfd.Scene(external_wrench=True, brakes=True))
    free = pfd.compile_kernel(robot)
    for kernel, given, missing in (
        (pushed, {}, 'needs wrench='),
        (pushed, {'wrench': wrench}, 'needs brakes='),
        (free, {'wrench': wrench}, 'wrench was given'),
    ):
        with pytest.raises(ValueError, match=missing):
            kernel(*states(2, 30), threads=2, **given)


def test_blocks_are_whole_registers_and_enough_for_every_thread() -> None:
    for count in (1, 100, 4096, 65536):
        for number in (2, 3, 16):
            size = threads.block_size(count, number, 8, 600)
            assert size % 8 == 0
            assert size <= max(8, count // number + 8)


def test_a_block_is_worth_a_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, 'LEAST', 500_000)
    assert threads.block_size(1000, 8, 8, 500) == 1000
    assert threads.block_size(1000, 8, 8, 50_000) == 16


def test_a_helper_that_sleeps_is_woken_and_one_that_looks_is_not_needed() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'))
    arrays = states(6, 20_000)
    expected = kernel(*arrays)
    for pause in (0.0, 20 * helpers.AWAKE, 0.0, 2 * helpers.AWAKE, helpers.AWAKE):
        time.sleep(pause)
        np.testing.assert_array_equal(kernel(*arrays, threads=2), expected)


def test_helpers_take_a_part_of_the_work() -> None:
    # On a busy machine a helper may come too late for one batch, but not for every one.
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'))
    arrays = states(6, 50_000)

    def done() -> int:
        return sum(int(helper.mailbox[helpers.LEFT]) for helper in helpers.Helper.all)

    kernel(*arrays, threads=2)
    before, end = done(), time.monotonic() + 20
    while done() == before and time.monotonic() < end:
        kernel(*arrays, threads=2)
    assert done() > before


def test_no_more_helpers_are_started_than_there_are_other_cores(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
    arrays = states(2, 500)
    expected = kernel(*arrays)
    started = len(helpers.Helper.all)
    monkeypatch.setattr(threads, 'cores', lambda: 1)
    monkeypatch.setattr(helpers.Helper, 'idle', [])
    np.testing.assert_array_equal(kernel(*arrays, threads=4), expected)
    assert len(helpers.Helper.all) == started


def test_helpers_end_when_they_are_told_whether_they_look_or_sleep() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'))
    arrays = states(6, 20_000)
    for pause in (0.0, 20 * helpers.AWAKE, 0.0):
        kernel(*arrays, threads=2)
        working = list(helpers.Helper.all)
        assert working
        time.sleep(pause)
        helpers.Helper.stop()
        assert not any(helper.is_alive() for helper in working)
        assert not helpers.Helper.all


SCRIPT = """
import numpy as np
import pfd_core as pfd
kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
x = np.zeros((100_000, 2))
kernel(x, x, x, threads=2)
{last}
"""


@pytest.mark.parametrize('last', ['', 'import time; time.sleep(0.1)', 'raise SystemExit(0)'])
def test_a_process_ends_while_its_helpers_look_or_sleep(last: str) -> None:
    run = subprocess.run(
        [sys.executable, '-c', SCRIPT.format(last=last)],
        capture_output=True,
        text=True,
        timeout=60,
        cwd=Path(__file__).parent.parent,
    )
    assert (run.returncode, run.stderr) == (0, '')


def test_many_callers_share_the_threads() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'))
    arrays = states(6, 3000)
    expected = kernel(*arrays)
    found: list[np.ndarray] = []

    def work() -> None:
        found.extend(kernel(*arrays, threads=3) for _ in range(20))

    callers = [threading.Thread(target=work) for _ in range(4)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert len(found) == 80
    assert len(set(helpers.Helper.idle)) == len(helpers.Helper.idle)
    for out in found:
        np.testing.assert_array_equal(out, expected)


def test_a_thread_that_comes_late_still_finds_the_code() -> None:
    # Kernels are forgotten as soon as they have answered; memory of code that is gone is unmapped.
    robot = pfd.load_robot('planar2')
    q, qd, tau = states(2, 40)
    expected = pfd.compile_kernel(robot)(q, qd, tau)
    for _ in range(50):
        found = pfd.compile_kernel(robot)(q, qd, tau, threads=4)
        np.testing.assert_array_equal(found, expected)


@pytest.mark.skipif(not hasattr(os, 'fork'), reason='this system does not fork')
@pytest.mark.filterwarnings('ignore:.*fork.*:DeprecationWarning')
def test_a_child_process_starts_threads_of_its_own() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'))
    arrays = states(6, 500)
    expected = kernel(*arrays, threads=2)
    child = os.fork()
    if child == 0:
        same = np.array_equal(kernel(*arrays, threads=2), expected)
        os._exit(0 if same else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
