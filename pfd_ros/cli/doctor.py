# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd doctor`: the installed packages, tests of them, and the speed of this machine.

A check is a function of CHECKS that yields findings.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib import metadata
import importlib.util
import os
import platform
import re
import secrets
import subprocess
import sys
import time
import timeit
from typing import NamedTuple

import numpy as np

import pfd_core as pfd
from pfd_core.kernels.runtime import cpu_count, disk_cache, processor
from pfd_ros.demo.bare_timer import bare_timer, missing_share
from pfd_ros.text import one_line

HELP = 'check the installation, and measure the speed of this machine'
EXAMPLE = 'pfd doctor'
PACKAGE = 'pfd_ros'
# The purpose of each extra of setup.py.
EXTRAS = {
    'ros': 'the node (pfd sim, pfd demo) and tests over topics',
    'report': 'the plots of pfd demo and pfd compare, and python -m benchmarks',
    'peers': 'CasADi and MuJoCo in python -m benchmarks',
    'view': 'pfd view: the arm of a log or of a running node in 3D',
    'completion': 'completion of pfd in bash and zsh, see docs/guides/node.md',
    'test': 'the tests of this project',
    'docs': 'the documentation site, see docs/install.md',
}
# Period [s] and length [s] of the test of the clock, and the share of periods it may miss.
PERIOD, LENGTH, MISSED = 1e-3, 1.0, 0.02
# Time [s] for two processes to find each other, on a busy machine.
DISCOVERY = 20.0
ROBOT, BATCH = 'ur5', 1024
# Rounding of forward and inverse dynamics one after the other, relative to the torques.
RESIDUAL = 1e-9
# Rounds of the test of speed, and seconds of a round.
ROUNDS, ROUND_SECONDS = 30, 1e-3


class Finding(NamedTuple):
    """One line: its subject, what was found, and whether it is a failure."""

    subject: str
    text: str
    failed: bool = False


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare nothing."""


def run(given: argparse.Namespace) -> int:
    """Print the findings as they come; 1 if something that is installed does not work."""
    failed = False
    for check in CHECKS:
        for finding in check():
            mark = 'FAILED: ' if finding.failed else ''
            print(one_line(f'{finding.subject:10s} {mark}{finding.text}', 400), flush=True)
            failed |= finding.failed
    return int(failed)


def installation() -> Iterator[Finding]:
    """Yield the versions of the package, of Python and of the system, and the processors."""
    folder = os.path.dirname(os.path.dirname(os.path.abspath(pfd.__file__)))
    yield Finding('pfd', f'{pfd.__version__} in {folder}')
    yield Finding('python', f'{platform.python_version()} on {platform.platform()}')
    count = cpu_count.available()
    yield Finding('processor', f'{processor.current().cpu}, {count} available to this process')


def extras() -> Iterator[Finding]:
    """Yield the installed extras, and the missing ones with their purpose."""
    try:
        found = metadata.metadata(PACKAGE)
        requirements = metadata.requires(PACKAGE) or []
    except metadata.PackageNotFoundError:
        yield Finding(
            'extras', f'unknown: {PACKAGE} is not installed, it runs from its source folder'
        )
        return
    for extra in found.get_all('Provides-Extra') or ():
        names = [
            re.split(r'[^\w.-]', item)[0]
            for item in requirements
            if re.search(rf'extra == .{re.escape(extra)}\b', item)
        ]
        missing = [name for name in names if not _installed(name)]
        if not missing:
            yield Finding('extra', f'{extra}: installed')
        elif extra == 'ros' and importlib.util.find_spec('rclpy'):
            yield Finding('extra', 'ros: the ROS 2 of this machine')
        else:
            use = EXTRAS.get(extra, 'more')
            cure = f"pip install '{PACKAGE}[{extra}]'"
            yield Finding(
                'extra', f'{extra}: {", ".join(missing)} not installed; needed for {use}: {cure}'
            )


def _installed(name: str) -> bool:
    with suppress(metadata.PackageNotFoundError):
        return bool(metadata.version(name))
    return False


def compiler() -> Iterator[Finding]:
    """Yield whether compiled forward dynamics is the inverse of inverse dynamics."""
    robot = pfd.load_robot(ROBOT)
    kernel = pfd.compile_kernel(robot)
    q, qd, tau = _state(robot.n)
    again = pfd.inverse_dynamics(robot, q, qd, kernel(q, qd, tau))
    residual = float(np.abs(again - tau).max() / np.abs(tau).max())
    version = metadata.version('llvmlite')
    text = f'llvmlite {version}, forward dynamics of {ROBOT}: residual {residual:.1e}'
    if kernel.compile_seconds:
        text += f', compiled in {kernel.compile_seconds:.2f} s'
    yield Finding('compiler', text, failed=not residual < RESIDUAL)


def _state(*shape: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions, velocities and torques of one state, or of a batch."""
    q, qd, tau = np.random.default_rng(1).uniform(-1.0, 1.0, (3, *shape))
    return q, qd, 50.0 * tau


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


def clock() -> Iterator[Finding]:
    """Yield how punctual a loop of 1 kHz is, which bounds the real-time rate of the node."""
    with bare_timer(PERIOD) as woke:
        time.sleep(LENGTH)
    busy = 'a busy machine; lockstep runs are not affected'
    loop = f'a loop of {1 / PERIOD:.0f} Hz'
    if len(woke) < 2:
        counts = f'woke {len(woke)} times in {LENGTH:g} s, expected {LENGTH / PERIOD:.0f}'
        yield Finding('clock', f'{loop} {counts}: {busy}')
        return
    periods = 1e3 * np.diff(np.array(woke)) * 1e-9
    missed = missing_share(woke, woke[0], woke[-1], PERIOD)
    text = (
        f'{loop} has periods of {np.median(periods):.3f} ms, 99 % up to '
        f'{np.quantile(periods, 0.99):.3f} ms, longest {np.max(periods):.3f} ms'
    )
    yield Finding('clock', f'{text}; {missed:.0%} missed: {busy}' if missed > MISSED else text)


def dds() -> Iterator[Finding]:
    """Yield whether a message gets from one process to another."""
    if importlib.util.find_spec('rclpy') is None:
        yield Finding('dds', f"no ROS 2 here: pip install '{PACKAGE}[ros]'")
        return
    topic = f'/pfd_doctor_{secrets.token_hex(4)}'
    command = [sys.executable, '-m', 'pfd_ros.node.dds_check']
    rest = [topic, str(DISCOVERY)]
    label = f'domain {os.environ.get("ROS_DOMAIN_ID", "0")}'
    publisher = subprocess.Popen(
        [*command, 'publish', *rest], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    try:
        subscriber = subprocess.run(
            [*command, 'subscribe', *rest],
            capture_output=True,
            text=True,
            timeout=2 * DISCOVERY,
            check=False,
        )
    except subprocess.TimeoutExpired:
        yield Finding(
            'dds', f'{label}: the test node did not exit within {2 * DISCOVERY:g} s', failed=True
        )
        return
    finally:
        publisher.kill()
        _, error = publisher.communicate()
    if subscriber.returncode == 0:
        seconds = float(subscriber.stdout.split()[-1])
        yield Finding('dds', f'{label}: message received by another process after {seconds:.2f} s')
        return
    # Fast DDS says on standard output that a domain is invalid.
    lines = (subscriber.stdout + error + subscriber.stderr).strip().splitlines()
    why = lines[-1] if lines else f'no message within {DISCOVERY:g} s; is a firewall on?'
    yield Finding('dds', f'{label}: {why}', failed=True)


def speed() -> Iterator[Finding]:
    """Yield the least times of a call, of a batch and of a step, without other work."""
    robot = pfd.load_robot(ROBOT)
    kernel, sim = pfd.compile_kernel(robot), pfd.Simulator(robot)
    many, out, still = _state(BATCH, robot.n), np.empty((BATCH, robot.n)), np.zeros(robot.n)
    call = _least(kernel.bind(*_state(robot.n), np.empty(robot.n)))
    batch = _least(lambda: kernel(*many, out=out)) / BATCH
    step = _least(lambda: sim.step(still))
    yield Finding(
        'speed',
        f'{ROBOT}, best of {ROUNDS} rounds: one state {1e6 * call:.2f} us, {BATCH} states '
        f'{1e9 * batch:.0f} ns each, a simulated step {1e6 * step:.2f} us',
    )


def _least(call: Callable[[], object]) -> float:
    """Return the least mean time of a call in a round, s."""
    once = min(timeit.repeat(call, number=1, repeat=3))
    count = max(1, int(ROUND_SECONDS / max(once, 1e-9)))
    return min(timeit.repeat(call, number=count, repeat=ROUNDS)) / count


CHECKS: tuple[Callable[[], Iterator[Finding]], ...] = (
    installation,
    extras,
    compiler,
    cache,
    clock,
    dds,
    speed,
)
