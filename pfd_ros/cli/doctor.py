# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd doctor`: the installed packages, tests of them, and the speed of this machine."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from importlib import metadata
import importlib.util
import os
import platform
import re
import secrets
import subprocess
import sys
import time

import numpy as np

import pfd_core as pfd
from pfd_core.report.measure.installation import Finding, cache, compiler, processors, speed
from pfd_ros.demo.bare_timer import bare_timer, missing_share
from pfd_ros.text import one_line

HELP = 'check the installation, and measure the speed of this machine'
EXAMPLE = 'pfd doctor'
PACKAGE = 'pfd_ros'
# The purpose of each extra of setup.py.
EXTRAS = {
    'ros': 'the node (pfd sim, pfd demo) and tests over topics',
    'report': 'the plots of pfd demo, pfd compare and pfd report',
    'peers': 'CasADi and MuJoCo in pfd report speed',
    'view': 'pfd view: the arm of a log or of a running node in 3D',
    'completion': 'completion of pfd in bash and zsh, see docs/guides/node.md',
    'test': 'the tests of this project',
    'docs': 'the documentation site, see docs/install.md',
}
# Period [s] and length [s] of the test of the clock, and the share of periods it may miss.
PERIOD, LENGTH, MISSED = 1e-3, 1.0, 0.02
# Time [s] for two processes to find each other, on a busy machine.
DISCOVERY = 20.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare nothing."""


def run(given: argparse.Namespace) -> int:
    """Print the findings as they come; 1 if something that is installed does not work."""
    failed = False
    for check in (installation, processors, extras, compiler, cache, clock, dds, speed):
        for finding in check():
            mark = 'FAILED: ' if finding.failed else ''
            print(one_line(f'{finding.subject:10s} {mark}{finding.text}', 400), flush=True)
            failed |= finding.failed
    return int(failed)


def installation() -> Iterator[Finding]:
    """Yield the versions of the package, of Python and of the system."""
    folder = os.path.dirname(os.path.dirname(os.path.abspath(pfd.__file__)))
    yield Finding('pfd', f'{pfd.__version__} in {folder}')
    yield Finding('python', f'{platform.python_version()} on {platform.platform()}')


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
        missing = [name for name in names if not _version(name)]
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


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ''


def clock() -> Iterator[Finding]:
    """Yield how punctual a loop of 1 kHz is, which bounds the real-time rate of the node."""
    with bare_timer(PERIOD) as woke:
        time.sleep(LENGTH)
    if len(woke) < 2:
        yield Finding(
            'clock',
            f'a loop of {1 / PERIOD:.0f} Hz woke {len(woke)} times in {LENGTH:g} s, expected '
            f'{LENGTH / PERIOD:.0f}: a busy machine; lockstep runs are not affected',
        )
        return
    periods = 1e3 * np.diff(np.array(woke)) * 1e-9
    missed = missing_share(woke, woke[0], woke[-1], PERIOD)
    text = (
        f'a loop of {1 / PERIOD:.0f} Hz has periods of {np.median(periods):.3f} ms, 99 % up to '
        f'{np.quantile(periods, 0.99):.3f} ms, longest {np.max(periods):.3f} ms'
    )
    if missed > MISSED:
        text += f'; {100 * missed:.0f} % missed: a busy machine; lockstep runs are not affected'
    yield Finding('clock', text)


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
