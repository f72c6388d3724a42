# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processes that compute with threads and fork, or end in some way; run by test_processes."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
import gc
import multiprocessing
import os
import signal
import sys
import threading
import time

import numpy as np

import pfd_core as pfd

# A child is killed after this time [s], far longer than it takes.
CHILD_LIFETIME = 120
# How much longer modules take to be imported [s]; pfd_core has a hundred of them.
IMPORTED_LATE = {'mpmath': 0.2, 'pfd_core': 0.005}
ARM = """
<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="1 0 0"/><mass value="1"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint>
</robot>
"""


def use_everything() -> None:
    """Use all that is computed once: of a robot, a kernel, a simulation and a trajectory."""
    robot = pfd.load_robot(ARM)
    kernel = pfd.compile_kernel(robot, refine=1)
    x = np.zeros((20, 1))
    kernel(x, x, x, threads=2)
    kernel.error_estimate(x, x, x)
    pfd.compile_kernel(robot, quantity='derivatives')(x, x, x)
    sim = pfd.Simulator(robot)
    sim.linearize(*x[:3])
    assert sim.rollout(x).qdd.all()


def exact() -> None:
    """Compute with mpmath."""
    assert pfd.emulate(pfd.load_robot('planar2'), *np.zeros((3, 2)), digits=20).status == 'ok'


WORK: dict[str, Callable[[], None]] = {'kernels': use_everything, 'digits': exact}


class SlowImports:
    """Modules that are imported when they are first needed take so long that a fork meets them."""

    def find_spec(self, name: str, *_: object) -> None:
        time.sleep(IMPORTED_LATE.get(name.partition('.')[0], 0.0))


def failures(children: int, work: str) -> int:
    """Return how many children fail or hang that are forked while threads do their work."""
    over = threading.Event()

    def busy() -> None:
        while not over.is_set():
            WORK[work]()

    failed = 0
    with ThreadPoolExecutor(2) as pool:
        threads = [pool.submit(busy) for _ in range(2)]
        for k in range(children):
            # The first ones while modules are being imported, the others at any time.
            time.sleep(0.02 * (k % 5))
            child = os.fork()
            if not child:
                signal.alarm(CHILD_LIFETIME)
                try:
                    WORK[work]()
                except BaseException as error:
                    print(repr(error), file=sys.stderr)
                    os._exit(1)
                os._exit(0)
            failed += os.waitpid(child, 0)[1] != 0
        over.set()
        for thread in threads:
            thread.result()
    return failed


STATUS = 7
# Nothing is computed for longer, should whoever waits for this process be gone [s].
LIFETIME = 60.0


def compute(count: int, kernel: pfd.Kernel | None = None) -> None:
    """Compute with some threads, and see that the bits are those of one."""
    kernel = kernel or pfd.compile_kernel(pfd.load_robot('planar2'))
    # So many states that their work is shared among threads.
    x = np.linspace(-1, 1, 400_000).reshape(200_000, 2)
    np.testing.assert_array_equal(kernel(x, x, x, threads=count), kernel(x, x, x))


def compute_for_ever(count: int) -> None:
    """Compute until the process ends."""
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
    _compute_on(count, kernel)


def _compute_on(count: int, kernel: pfd.Kernel) -> None:
    end = time.monotonic() + LIFETIME
    while time.monotonic() < end:
        compute(count, kernel)
    raise TimeoutError('nobody ended this process')


def nap(count: int) -> None:
    """End when the workers are idle again."""
    compute(count)
    time.sleep(0.05)


def leave(count: int) -> None:
    """End by an exit status."""
    compute(count)
    raise SystemExit(STATUS)


def interrupted(count: int) -> None:
    """End by SIGINT in the middle of a call."""
    # A shell starts what it puts into the background with SIGINT ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'))
    compute(count, kernel)
    # Not earlier: Python drops a KeyboardInterrupt within a `__del__`, and the compiler's
    # objects have one.
    threading.Timer(0.02, os.kill, (os.getpid(), signal.SIGINT)).start()
    _compute_on(count, kernel)


def forked(count: int) -> None:
    """Fork while workers run; the child uses its own threads, and ends in each way."""
    compute(count)
    child = os.fork()
    compute(count)
    if child == 0:
        return
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    _by_multiprocessing('fork', count)


def spawned(count: int) -> None:
    """Start processes that know nothing of this one."""
    compute(count)
    _by_multiprocessing('spawn', count)


def _by_multiprocessing(method: str, count: int) -> None:
    process = multiprocessing.get_context(method).Process(target=compute, args=(count,))
    process.start()
    compute(count)
    process.join()
    assert process.exitcode == 0


def collected(count: int) -> None:
    """Forget kernels while other threads compute, and end while they do."""
    for _ in range(2):
        threading.Thread(target=compute_for_ever, args=(count,), daemon=True).start()
    for _ in range(5):
        compute(count)
        gc.collect()


def outlived(count: int) -> None:
    """End the main thread before one that computes."""

    def late() -> None:
        threading.main_thread().join()
        for _ in range(5):
            compute(count)

    threading.Thread(target=late).start()
    compute(count)


WAYS: dict[str, Callable[[int], None]] = {
    'at once': compute,
    'after a nap': nap,
    'by SystemExit': leave,
    'by SIGINT': interrupted,
    'with fork': forked,
    'with spawn': spawned,
    'with kernels collected': collected,
    'before a thread': outlived,
}
STATUSES = {'by SystemExit': STATUS, 'by SIGINT': -signal.SIGINT}


if __name__ == '__main__':
    what, way, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
    if what == 'fork':
        sys.meta_path.insert(0, SlowImports())  # type: ignore[arg-type]
        sys.exit(min(failures(count, way), 100))
    WAYS[way](count)
