# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd doctor` tests what is installed, and names what is missing; each command has an example."""

from __future__ import annotations

from array import array
from contextlib import nullcontext
from pathlib import Path
import shlex
import subprocess
import sys
import time

import bridge
from bridge import (
    PFD_COMMANDS,
    doctor_cache,
    doctor_clock,
    doctor_compiler,
    doctor_dds,
    doctor_extras,
    pfd_commands_of,
    pfd_main,
    pfd_parser,
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


def printed(domain: int, **variables: str) -> tuple[int, dict[str, str]]:
    """Run the command in another process; return its status, and its lines by subject."""
    done = subprocess.run(
        [sys.executable, '-m', 'pfd_ros.cli.main', 'doctor'],
        env=environment(domain) | variables,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.stderr == ''
    return done.returncode, dict(line.split(maxsplit=1) for line in done.stdout.splitlines())


@pytest.mark.ros
@pytest.mark.slow
def test_a_machine_in_order_has_a_line_for_each_subject_and_status_0(processes: Processes) -> None:
    status, lines = printed(processes.domain)
    assert status == 0
    assert {*lines} >= {'pfd', 'python', 'processor', 'compiler', 'cache', 'clock', 'speed'}
    assert 'message received by another process after' in lines['dds']
    assert 'residual' in lines['compiler']


@pytest.mark.ros
def test_a_middleware_that_does_not_load_is_a_failure(processes: Processes) -> None:
    status, lines = printed(processes.domain, RMW_IMPLEMENTATION='rmw_absent')
    assert status == 1
    assert 'FAILED' in lines['dds']


@pytest.mark.ros
def test_an_invalid_domain_is_named_and_no_firewall(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', '500')
    (found,) = doctor_dds()
    assert found.failed
    assert 'domainId is over 232' in found.text


def test_a_folder_that_others_can_write_is_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tmp_path.chmod(0o777)
    monkeypatch.setenv('PFD_CACHE', str(tmp_path))
    (found,) = doctor_cache()
    assert found.failed
    assert str(tmp_path) in found.text


def test_a_file_in_the_place_of_the_folder_is_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / 'file').write_text('', encoding='utf-8')
    monkeypatch.setenv('PFD_CACHE', str(tmp_path / 'file'))
    (found,) = doctor_cache()
    assert found.failed


def test_without_a_cache_the_line_states_its_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('PFD_CACHE', '')
    (found,) = doctor_cache()
    assert not found.failed
    assert 'compiles its kernels again' in found.text


@pytest.mark.parametrize('times', [(), (1,)])
def test_a_timer_that_does_not_get_to_run_is_a_finding(
    monkeypatch: pytest.MonkeyPatch, times: tuple[int, ...]
) -> None:
    monkeypatch.setattr(
        *bridge.target('doctor_bare_timer'), lambda period: nullcontext(array('q', times))
    )
    monkeypatch.setattr(time, 'sleep', lambda seconds: None)
    (found,) = doctor_clock()
    assert found.subject == 'clock'
    assert f'woke {len(times)} times in 1 s, expected 1000' in found.text


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


@pytest.mark.parametrize('name', PFD_COMMANDS)
def test_the_help_of_a_command_has_an_example_that_its_parser_accepts(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        pfd_main([name, '--help'])
    assert ended.value.code == 0
    last = capsys.readouterr().out.rstrip().splitlines()[-1]
    assert last.startswith('example: pfd ')
    words = shlex.split(last.removeprefix('example: pfd '))
    words = words[: words.index('--ros-args')] if '--ros-args' in words else words
    found = pfd_parser(pfd_commands_of(words)).parse_args(words)
    assert found.command == name
