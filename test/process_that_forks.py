# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A process that forks while its threads compile; run by test_forks."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
import os
import signal
import sys
import threading
import time

import numpy as np

import pfd_core as pfd

# A child is killed after this time [s], far longer than it takes.
LIFETIME = 120
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


def compute() -> None:
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


WORK: dict[str, Callable[[], None]] = {'kernels': compute, 'digits': exact}


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
                signal.alarm(LIFETIME)
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


if __name__ == '__main__':
    sys.meta_path.insert(0, SlowImports())  # type: ignore[arg-type]
    sys.exit(min(failures(int(sys.argv[2]), sys.argv[1]), 100))
