# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether compiler and cache work on this machine; times of a call, a batch and a step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib.metadata import version
import secrets
from typing import NamedTuple

import numpy as np

from pfd_core.kernels.compile import compile_kernel
from pfd_core.kernels.functions import inverse_dynamics
from pfd_core.kernels.runtime import cpu_count, disk_cache, processor
from pfd_core.model import Robot, load_robot
from pfd_core.model.geometry import Array
from pfd_core.report.contenders.work import Side
from pfd_core.report.measure.timing import Pace, interleave
from pfd_core.simulation.simulator import Simulator

ROBOT = 'ur5'
BATCH = 1024
# Rounding of forward and inverse dynamics one after the other, relative to the torques.
RESIDUAL = 1e-9
ROUNDS = 30


class Finding(NamedTuple):
    """One line: its subject, what was found, and whether it is a failure."""

    subject: str
    text: str
    failed: bool = False


def processors() -> Iterator[Finding]:
    """Yield the processor that is compiled for, and how many a process may use."""
    count = cpu_count.available()
    yield Finding('processor', f'{processor.current().cpu}, {count} available to this process')


def compiler() -> Iterator[Finding]:
    """Yield whether compiled forward dynamics is the inverse of inverse dynamics."""
    robot = load_robot(ROBOT)
    kernel = compile_kernel(robot)
    q, qd, tau = _state(robot, 1)
    again = inverse_dynamics(robot, q, qd, kernel(q, qd, tau))
    residual = float(np.abs(again - tau).max() / np.abs(tau).max())
    text = f'llvmlite {version("llvmlite")}, forward dynamics of {ROBOT}: residual {residual:.1e}'
    if kernel.compile_seconds:
        text += f', compiled in {kernel.compile_seconds:.2f} s'
    yield Finding('compiler', text, failed=not residual < RESIDUAL)


def _state(robot: Robot, count: int) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(1)
    q, qd, tau = rng.uniform(-1.0, 1.0, (3, count, robot.n))
    return (q, qd, 50.0 * tau) if count > 1 else (q[0], qd[0], 50.0 * tau[0])


def cache() -> Iterator[Finding]:
    """Yield whether compiled code can be kept."""
    folder = disk_cache.folder()
    if folder is None:
        yield Finding('cache', 'off: each process compiles its kernels again')
        return
    name, payload = disk_cache.digest('doctor', secrets.token_hex(8)), b'doctor'
    disk_cache.write(name, payload)
    works = disk_cache.read(name) == payload
    with suppress(OSError):  # the folder may be a file
        (folder / f'{name}{disk_cache.SUFFIX}').unlink()
    if not works:
        cure = 'it must be writable by this user only'
        yield Finding('cache', f'{folder} is not used: {cure}', failed=True)
        return
    sizes = []
    for path in folder.glob(f'*{disk_cache.SUFFIX}'):
        with suppress(OSError):  # another process removes old ones
            sizes.append(path.stat().st_size)
    yield Finding('cache', f'{folder}: {len(sizes)} files, {sum(sizes) / 1e6:.1f} MB')


def speed() -> Iterator[Finding]:
    """Yield the best times of a call, of a batch and of a step, without other work."""
    robot = load_robot(ROBOT)
    kernel = compile_kernel(robot)
    one, many = _state(robot, 1), _state(robot, BATCH)
    out, still = np.empty((BATCH, robot.n)), np.zeros(robot.n)
    sim = Simulator(robot)
    calls: tuple[Callable[[], object], ...] = (
        kernel.bind(*one, np.empty(robot.n)),
        lambda: kernel(*many, out=out),
        lambda: sim.step(still),
    )
    sides = [Side('', call, lambda: out) for call in calls]
    pace = Pace(turns=ROUNDS, fewest=ROUNDS)
    call, batch, step = (times.minimum for times in interleave(sides, 1, pace))
    yield Finding(
        'speed',
        f'{ROBOT}, best of {ROUNDS} rounds: one state {1e6 * call:.2f} us, {BATCH} states '
        f'{1e9 * batch / BATCH:.0f} ns each, a simulated step {1e6 * step:.2f} us',
    )
