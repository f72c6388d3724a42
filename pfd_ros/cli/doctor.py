# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd doctor`: the installed packages, tests of them, and the speed of this machine.

A check is a function of CHECKS that yields findings.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from importlib import metadata
import importlib.util
import os
from pathlib import Path
import platform
import re
import secrets
import subprocess
import sys
import time
import timeit
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_core.kernels import cache as disk_cache
from pfd_core.kernels import native, threads
from pfd_ros.cli.terminal import Command
from pfd_ros.extras import PACKAGE, install, requirements
from pfd_ros.text import one_line

# The purpose of an extra of setup.py whose name does not say it.
EXTRAS = {
    'ros': 'the node (pfd sim, pfd demo) and tests over topics',
    'report': 'pfd compare --plot, and python -m benchmarks',
    'peers': 'CasADi and MuJoCo in python -m benchmarks',
    'view': 'pfd view: the arm of a log or of a running node in 3D',
    'completion': 'completion of pfd in bash and zsh',
}
# Period [s] and length [s] of the test of the clock, and the share of periods it may miss.
PERIOD, LENGTH, MISSED = 1e-3, 1.0, 0.02
# Time [s] for two processes to find each other, on a busy machine.
DISCOVERY = 20.0
# Rounds of the test of speed, and the states of a batch.
ROBOT, ROUNDS, BATCH = 'ur5', 30, 1024
# Characters of a line; the command that installs an extra names its packages.
LONGEST = 1000
# Rounding of forward and inverse dynamics one after the other, relative to the torques.
RESIDUAL = 1e-9


class Finding(NamedTuple):
    """One line: its subject, what was found, and whether it is a failure."""

    subject: str
    text: str
    failed: bool = False


def _run(_: argparse.Namespace) -> int:
    """Print the findings as they come; 1 if something that is installed does not work."""
    failed = False
    for check in CHECKS:
        for finding in check():
            mark = 'FAILED: ' if finding.failed else ''
            print(one_line(f'{finding.subject:10s} {mark}{finding.text}', LONGEST), flush=True)
            failed |= finding.failed
    return int(failed)


def installation() -> Iterator[Finding]:
    """Yield the versions of the package, of Python and of the system, and the processors."""
    yield Finding('pfd', f'{pfd.__version__} in {Path(pfd.__file__).resolve().parents[1]}')
    yield Finding('python', f'{platform.python_version()} on {platform.platform()}')
    count = threads.cores()
    yield Finding('processor', f'{native.current().cpu}, {count} available to this process')


def extras() -> Iterator[Finding]:
    """Yield the installed extras, and the missing ones with their purpose."""
    found = requirements()
    if not found:
        yield Finding('extras', f'unknown: {PACKAGE} runs from its source folder')
    for extra, packages in found.items():
        text, bare = 'installed', [re.split('[^\\w.-]', package)[0] for package in packages]
        names = [name for name in bare if not any(metadata.distributions(name=name))]
        if names and extra == 'ros' and importlib.util.find_spec('rclpy'):
            text = 'the ROS 2 of this machine'
        elif names:
            use, cure = EXTRAS.get(extra, extra), install(extra)
            text = f'{", ".join(names)} not installed; needed for {use}: {cure}'
        yield Finding('extra', f'{extra}: {text}')


def compiler() -> Iterator[Finding]:
    """Yield whether compiled forward dynamics is the inverse of inverse dynamics."""
    robot = pfd.load_robot(ROBOT)
    kernel = pfd.compile_kernel(robot)
    q, qd, tau = np.random.default_rng(1).uniform(-1.0, 1.0, (3, robot.n))
    again = pfd.inverse_dynamics(robot, q, qd, kernel(q, qd, tau))
    residual = float(np.abs(again - tau).max() / np.abs(tau).max())
    version = metadata.version('llvmlite')
    text = f'llvmlite {version}, forward dynamics of {ROBOT}: residual {residual:.1e}'
    if kernel.compile_seconds:
        text += f', compiled in {kernel.compile_seconds:.2f} s'
    yield Finding('compiler', text, failed=not residual < RESIDUAL)


def cache() -> Iterator[Finding]:
    """Yield whether compiled code can be kept."""
    folder = disk_cache.folder()
    if folder is None:
        yield Finding('cache', 'off: each process compiles its kernels again')
        return
    name, payload = disk_cache.digest('doctor'), secrets.token_bytes(8)
    disk_cache.write(name, payload)
    works = disk_cache.read(name) == payload
    count = len([*folder.glob(f'*{disk_cache.SUFFIX}')]) if works else 0
    text = f'has {count} files' if works else 'is not used: it must be writable by this user only'
    yield Finding('cache', f'{folder} {text}', failed=not works)


def bare_timer(period: float, length: float) -> NDArray[np.float64]:
    """Return the periods [s] of a loop that skips those that have passed at a wake-up."""
    woke = [time.monotonic()]
    due = woke[0]
    while woke[-1] < woke[0] + length:
        due += period * max(1.0, np.ceil((woke[-1] - due) / period))
        time.sleep(max(due - time.monotonic(), 0.0))
        woke.append(time.monotonic())
    return np.diff(woke)


def clock() -> Iterator[Finding]:
    """Yield how punctual a loop of 1 kHz is, which bounds the real-time rate of the node."""
    periods = bare_timer(PERIOD, LENGTH) * 1e3
    due = round(LENGTH / PERIOD)
    middle, most, longest = np.quantile(periods, (0.5, 0.99, 1.0))
    text = (
        f'a loop of {1 / PERIOD:.0f} Hz woke {len(periods)} times in {LENGTH:g} s, expected {due};'
        f' periods of {middle:.3f} ms, 99 % up to {most:.3f} ms, longest {longest:.3f} ms'
    )
    if len(periods) < (1 - MISSED) * due:
        text += ': a busy machine; lockstep runs are not affected'
    yield Finding('clock', text)


def dds() -> Iterator[Finding]:
    """Yield whether a message gets from one process to another."""
    if importlib.util.find_spec('rclpy') is None:
        yield Finding('dds', f'no ROS 2 here: {install("ros")}')
        return
    command = [sys.executable, '-m', 'pfd_ros.node.dds_check', str(DISCOVERY)]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=2 * DISCOVERY, check=False
        )
        works = done.returncode == 0
        # Fast DDS says on standard output that a domain is invalid.
        why = done.stdout if works else (done.stdout + done.stderr).strip().split('\n')[-1]
    except subprocess.TimeoutExpired as error:
        works, why = False, str(error)
    text = why or f'nothing within {DISCOVERY:g} s: firewall? ROS_AUTOMATIC_DISCOVERY_RANGE=OFF?'
    text = (
        f'message received by another process after {float(why.split()[-1]):.2f} s'
        if works
        else text
    )
    domain = os.environ.get('ROS_DOMAIN_ID', '0')
    yield Finding('dds', f'domain {domain}: {text}', failed=not works)


def speed() -> Iterator[Finding]:
    """Yield the least times of a call, of a batch and of a step, without other work."""
    robot = pfd.load_robot(ROBOT)
    kernel, sim = pfd.compile_kernel(robot), pfd.Simulator(robot)
    q, qd, tau = np.random.default_rng(1).uniform(-1.0, 1.0, (3, BATCH, robot.n))
    out, still = np.empty((BATCH, robot.n)), np.zeros(robot.n)
    calls: tuple[tuple[Callable[[], object], int], ...] = (
        (kernel.bind(q[0], qd[0], tau[0], out[0]), 1000),
        (lambda: kernel(q, qd, tau, out=out), 10),
        (lambda: sim.step(still), 100),
    )
    call, batch, step = (
        min(timeit.repeat(each, number=count, repeat=ROUNDS)) / count for each, count in calls
    )
    yield Finding(
        'speed',
        f'{ROBOT}, best of {ROUNDS} rounds: one state {1e6 * call:.2f} us, {BATCH} states '
        f'{1e9 * batch / BATCH:.0f} ns each, a simulated step {1e6 * step:.2f} us',
    )


CHECKS = (installation, extras, compiler, cache, clock, dds, speed)
COMMANDS = {
    'doctor': Command(
        'check the installation, and measure the speed of this machine',
        'pfd doctor',
        lambda _: None,
        _run,
    )
}
