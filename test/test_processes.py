# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processes and threads that compute: forked, ended, interrupted; shared work; memory."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import cycle, islice
import os
from pathlib import Path
import subprocess
import sys
import threading
import time

from computing_processes import STATUSES, WAYS, WORK
import numpy as np
import pytest
from zoo import one_fast, random_states

import pfd_core as pfd
from pfd_core.kernels import threads as pool

SCRIPT = Path(__file__).with_name('computing_processes.py')
PACKAGE = Path(pfd.__file__).parent
# Far longer than any of the processes takes [s]; one that hangs is killed and fails.
PATIENCE = 120.0
FORKING_PATIENCE = 1200.0
MANY = (pytest.mark.slow, pytest.mark.long, pytest.mark.timeout(12 * FORKING_PATIENCE))


def command(*arguments: object) -> list[str]:
    return [sys.executable, '-W', 'ignore::DeprecationWarning', *map(str, (SCRIPT, *arguments))]


# ---- forks: a child never waits for a lock of a thread that it lacks --------------------------


@pytest.mark.skipif(not hasattr(os, 'fork'), reason='needs fork')
@pytest.mark.slow
@pytest.mark.timeout(FORKING_PATIENCE)
@pytest.mark.parametrize(('processes', 'children'), [(1, 2), pytest.param(12, 12, marks=MANY)])
@pytest.mark.parametrize('work', WORK)
def test_a_child_forked_while_threads_compile_computes_too(
    work: str, processes: int, children: int
) -> None:
    for _ in range(processes):
        subprocess.run(
            command('fork', work, children),
            env=os.environ | {'PFD_CACHE': '', 'PYTHONPATH': os.pathsep.join(sys.path)},
            check=True,
            timeout=FORKING_PATIENCE,
        )


# Standard names that hold a lock while they call back or import.
LOCKED = {'cached_property', 'mkstemp', 'Barrier', 'Condition', 'Event', 'Semaphore'}
LOCKED |= {'Lock', 'RLock'}


def violations(source: str) -> Iterator[str]:
    """Yield the locks that a module uses and its imports within functions that a fork may meet."""
    tree = ast.parse(source)
    guarded = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.With) and 'no_fork' in ast.unparse(node.items[0])
        for inner in node.body
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in LOCKED:
            yield ast.unparse(node)
        if isinstance(node, ast.ImportFrom) and not str(node.module).startswith('pfd_core'):
            yield from (alias.name for alias in node.names if alias.name in LOCKED)
        if isinstance(node, ast.FunctionDef):
            yield from (
                ast.unparse(inner)
                for inner in ast.walk(node)
                if isinstance(inner, ast.Import | ast.ImportFrom) and inner not in guarded
            )


def test_locks_and_late_imports_are_those_that_are_held_at_a_fork() -> None:
    for source in ('import threading\nlock = threading.Lock()', 'def f():\n    import mpmath'):
        assert len(list(violations(source))) == 1
    found = {
        path.relative_to(PACKAGE).as_posix(): list(violations(path.read_text(encoding='utf-8')))
        for path in PACKAGE.rglob('*.py')
    }
    assert {name: lines for name, lines in found.items() if lines} == {
        'forking.py': ['threading.RLock', 'functools.cached_property', 'functools.cached_property']
    }


# ---- ends: with the expected status, every time -----------------------------------------------

THREADS = (2, 0, 3)


def ending(case: tuple[str, int]) -> str:
    """Return how a process ended that should not have ended so, or nothing."""
    way, count = case
    try:
        run = subprocess.run(
            command('end', way, count), capture_output=True, text=True, timeout=PATIENCE
        )
    except subprocess.TimeoutExpired:
        return f'{way}, {count} threads: hangs'
    errors = run.stderr.strip().splitlines()
    quiet = not errors or (way == 'by SIGINT' and errors[-1] == 'KeyboardInterrupt')
    if run.returncode == STATUSES.get(way, 0) and quiet:
        return ''
    return f'{way}, {count} threads: status {run.returncode}, {errors[-3:]}'


@pytest.mark.slow
@pytest.mark.parametrize('number', [len(WAYS), pytest.param(300, marks=MANY)])
def test_processes_with_any_number_of_threads_end_well(number: int) -> None:
    ways = [way for way in WAYS if way != 'with fork' or hasattr(os, 'fork')]
    rounds = [
        (way, THREADS[(k + start) % len(THREADS)])
        for start in range(len(THREADS))
        for k, way in enumerate(ways)
    ]
    with ThreadPoolExecutor(2) as starters:
        assert [x for x in starters.map(ending, islice(cycle(rounds), number)) if x] == []


# ---- interrupts: state and time stay together ------------------------------------------------

INTERRUPTED_ROLLOUT = """
import os, random, signal, sys, threading
import numpy as np
import pfd_core as pfd
signal.signal(signal.SIGINT, signal.default_int_handler)
rng, times, kind = random.Random(1), 3, sys.argv[1]
taus = np.random.default_rng(1).normal(size=(400_000, 2)) / 10
robot, done, integrator = pfd.load_robot('planar2'), 0, rng.choice(['rk4', 'velocity_verlet'])
make = getattr(pfd, kind)
of = (robot, 9) if kind == 'Ensemble' else (robot,)
sim, other = (make(*of, substeps=50, integrator=integrator) for _ in range(2))
facts = lambda s: (s.q.tobytes(), s.qd.tobytes(), s.qdd.tobytes(), s.time, s.status)
for _ in range(times):
    timer = threading.Timer(rng.random() * 0.1, os.kill, (os.getpid(), signal.SIGINT))
    try:
        timer.start()
        if kind == 'Simulator' and rng.random() < 0.3:
            for tau in taus[done:]:
                sim.step(tau)
        sim.rollout(taus[done:])
        timer.join()
    except KeyboardInterrupt:
        pass
    now = round(sim.time / sim.step_size)
    assert now < len(taus), 'it was not interrupted'
    other.rollout(taus[done:now])
    assert facts(sim) == facts(other), now
    done = now
print('went on')
"""
INTERRUPTED_INTEGRATION = """
import os, signal, sys, threading, time
import numpy as np
import pfd_core as pfd

signal.signal(signal.SIGINT, signal.default_int_handler)
robot = pfd.load_robot('planar2')
kind = sys.argv[1]
scene = pfd.Scene(friction=[1e-3, 1e-3]) if kind == 'friction' else pfd.Scene()
tau = (lambda t, q, qd: [0.0, 0.0]) if kind == 'law' else [0.0, 0.0]
settings = dict(scene=scene, q=[0.5, 0.5], dense=False)
pfd.integrate(robot, tau, 0.1, **settings)
for _ in range(3):
    begun = time.perf_counter()
    try:
        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
        pfd.integrate(robot, tau, 1e6, max_steps=10**9, max_step=1e-3, **settings)
        sys.exit('it was not interrupted')
    except KeyboardInterrupt:
        pass
wanted = pfd.integrate(robot, tau, 1.0, **settings)
assert wanted.status == 'ok'
print('went on')
"""
INTERRUPTED = [
    *((INTERRUPTED_ROLLOUT, kind) for kind in ('Simulator', 'Ensemble')),
    *one_fast((INTERRUPTED_INTEGRATION, kind) for kind in ('friction', 'smooth', 'law')),
]


@pytest.mark.parametrize(('script', 'argument'), INTERRUPTED)
def test_a_simulation_continues_where_it_was_interrupted(script: str, argument: str) -> None:
    done = subprocess.run(
        [sys.executable, '-c', script, argument],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert (done.stdout, done.stderr) == ('went on\n', '')


# ---- threads of a batch ----


@pytest.mark.usefixtures('small_blocks')
def test_a_number_that_is_not_finite_is_found_in_any_block() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
    for row in (0, 100, 199):
        q, qd, tau = random_states(2, 200)
        tau[row, 1] = np.inf
        with pytest.raises(
            ValueError, match=rf'tau must be finite, got inf at index \[{row}, 1\]'
        ):
            kernel(q, qd, tau, threads=2)


@pytest.mark.usefixtures('small_blocks')
def test_an_absurd_number_of_threads_is_cut_to_the_cores() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
    arrays = random_states(2, 300)
    np.testing.assert_array_equal(kernel(*arrays, threads=10**400), kernel(*arrays))
    assert pool.thread_count(np.int64(10**8)) == pool.cores()


@pytest.mark.usefixtures('small_blocks')
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
        pool.run(work, 1000, 1, pool.MAX_BLOCK_WORK, 3)
    assert 1 <= len(begun) < 1000
    assert sorted(begun) == sorted(ended)


@pytest.mark.usefixtures('small_blocks')
@pytest.mark.parametrize('stage', ['ended', 'thread'])
def test_the_caller_works_alone_where_no_worker_can_be_had(
    stage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if stage == 'ended':
        pool._pool.shutdown()
    else:

        def refuse(self: threading.Thread) -> None:
            raise RuntimeError("can't start new thread")

        monkeypatch.setattr(threading.Thread, 'start', refuse)
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
    arrays = random_states(2, 300)
    np.testing.assert_array_equal(kernel(*arrays, threads=4), kernel(*arrays))


@pytest.mark.usefixtures('small_blocks')
def test_many_callers_share_the_workers() -> None:
    kernel = pfd.compile_kernel(pfd.load_robot('ur5'))
    arrays = random_states(6, 3000)
    expected = kernel(*arrays)
    with ThreadPoolExecutor(4) as callers:
        found = list(callers.map(lambda _: kernel(*arrays, threads=3), range(80)))
    for out in found:
        np.testing.assert_array_equal(out, expected)


@pytest.mark.usefixtures('small_blocks')
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

    monkeypatch.setattr(os, 'sched_getaffinity', lambda _: set(range(8)), raising=False)
    monkeypatch.setattr(Path, 'read_text', read_text)
    assert pool.cores.__wrapped__() == expected


# ---- memory ----


# Compilations before memory is measured: caches of Python, NumPy and the allocator are full then.
WARM_UP = 10
# Growth of the resident memory for each compilation [B]: pages that the allocator has fragmented.
# The pipeline of LLVM's passes alone takes 45 kB, and passes over a kernel four times as much.
GROWTH = 15_000
# Far longer than any of the processes takes [s].
LONGEST_GROWTH = 3000.0
# The C library neither returns the end of the heap to the system nor takes it in small pieces:
# else one piece of 660 kB, kept or not, decides.
STEADY = {
    'MALLOC_TRIM_THRESHOLD_': '4000000',
    'MALLOC_TOP_PAD_': '1000000',
    'MALLOC_MMAP_THRESHOLD_': '100000000',
}


COMPILATIONS = """
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


@pytest.mark.skipif(not Path('/proc/self/statm').exists(), reason='needs /proc')
@pytest.mark.timeout(LONGEST_GROWTH)
@pytest.mark.parametrize('count', [15, pytest.param(1000, marks=pytest.mark.long)])
def test_a_compilation_keeps_no_memory(count: int) -> None:
    found = subprocess.run(
        [sys.executable, '-c', COMPILATIONS, str(WARM_UP), str(count)],
        env=os.environ | STEADY | {'PFD_CACHE': '', 'PYTHONPATH': os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
        timeout=LONGEST_GROWTH,
    )
    assert float(found.stdout) <= GROWTH
