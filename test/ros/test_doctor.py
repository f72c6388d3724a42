# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd doctor` tests what is installed, and names what is missing."""

from __future__ import annotations

from pathlib import Path
import subprocess
import sys

import bridge
from bridge import (
    doctor_cache,
    doctor_clock,
    doctor_compiler,
    doctor_dds,
    doctor_extras,
)
import numpy as np
import pytest
from ros_processes import Processes, environment

import pfd_core as pfd

METADATA = """\
Metadata-Version: 2.1
Name: pfd_ros
Version: 0.1.0
Provides-Extra: plots
Provides-Extra: test
Requires-Dist: numpy
Requires-Dist: a-package-that-nobody-has>=1; extra == "plots"
Requires-Dist: pytest; extra == "test"
"""


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize('middleware', ['', 'rmw_absent'])
def test_a_machine_has_a_line_for_each_subject_and_a_failure_is_status_1(
    processes: Processes, middleware: str
) -> None:
    absent = {'RMW_IMPLEMENTATION': middleware} if middleware else {}
    done = subprocess.run(
        [sys.executable, '-m', 'pfd_ros.cli.main', 'doctor'],
        env=environment(processes.domain) | absent,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    lines = dict(line.split(maxsplit=1) for line in done.stdout.splitlines())
    assert {*lines} >= {'pfd', 'python', 'processor', 'compiler', 'cache', 'clock', 'speed'}
    assert (done.returncode, done.stderr) == (int(bool(middleware)), '')
    assert ('FAILED' if middleware else 'message received by another process') in lines['dds']
    assert 'residual' in lines['compiler']


@pytest.mark.ros
def test_an_invalid_domain_is_named_and_no_firewall(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', '500')
    (found,) = doctor_dds()
    assert found.failed
    assert 'domainId is over 232' in found.text


@pytest.mark.parametrize(
    ('cache', 'failed', 'text'),
    [
        ('writable by all', True, 'writable by this user only'),
        ('', False, 'compiles its kernels again'),
        ('own', False, 'has 1 files'),
    ],
)
def test_a_cache_that_cannot_be_used_is_a_failure(
    cache: str, failed: bool, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / 'cache'
    if cache:
        folder.mkdir(mode=0o700)
        folder.chmod(0o777 if cache == 'writable by all' else 0o700)
    monkeypatch.setenv('PFD_CACHE', str(folder) if cache else '')
    (found,) = doctor_cache()
    assert found.failed == failed
    assert text in found.text
    assert str(folder) in found.text or not cache


@pytest.mark.parametrize(('count', 'busy'), [(985, False), (500, True)])
def test_a_timer_that_misses_periods_is_a_finding(
    monkeypatch: pytest.MonkeyPatch, count: int, busy: bool
) -> None:
    monkeypatch.setattr(
        *bridge.target('doctor_bare_timer'), lambda period, length: np.full(count, length / count)
    )
    (found,) = doctor_clock()
    assert found.subject == 'clock'
    assert f'woke {count} times in 1 s, expected 1000' in found.text
    assert ('a busy machine' in found.text) == busy


def test_a_kernel_with_a_wrong_answer_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    right = pfd.compile_kernel

    class Wrong:
        compile_seconds = 0.0

        def __init__(self, robot: pfd.Robot) -> None:
            self.kernel = right(robot)

        def __call__(self, *given: np.ndarray) -> np.ndarray:
            return 1.001 * self.kernel(*given)

    monkeypatch.setattr(pfd, 'compile_kernel', Wrong)
    (found,) = doctor_compiler()
    assert found.failed


def test_a_missing_extra_is_named_with_the_command_that_installs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / 'pfd_ros-0.1.0.dist-info'
    folder.mkdir()
    (folder / 'METADATA').write_text(METADATA, encoding='utf-8')
    monkeypatch.syspath_prepend(str(tmp_path))
    texts = [found.text for found in doctor_extras()]
    assert texts[0].startswith('plots: a-package-that-nobody-has not installed; needed for ')
    assert texts[0].endswith("pip install 'pfd_ros[plots]'")
    assert texts[1] == 'test: installed'
