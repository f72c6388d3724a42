# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Commands and files of the guide "First ten minutes" work as printed."""

from __future__ import annotations

import os
from pathlib import Path
import re
import shlex
import subprocess
import sys

from plugin_sessions import install
import pytest
from ros_processes import ROOT, Processes, environment
from waiting import PATIENCE, wait_until

from pfd_ros import read_log

TEXT = (ROOT / 'docs' / 'guides' / 'first-ten-minutes.md').read_text(encoding='utf-8')
# Kind and name of each block, and what is in it.
BLOCKS = re.findall(r'^```(\w+) ?(.*)\n((?s:.*?))^```$', TEXT, re.MULTILINE)
FILES = {name: body for _, name, body in BLOCKS if '.' in name}
COMMANDS = [(name, body) for kind, name, body in BLOCKS if kind == 'sh']


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with the files of the guide, from which a test imports."""
    for name, body in FILES.items():
        (tmp_path / name).write_text(body, encoding='utf-8')
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, 'law', raising=False)
    return tmp_path


def test_the_guide_has_these_files_and_one_installation() -> None:
    assert list(FILES) == ['arm.urdf', 'law.py', 'test_law.py', 'node.py']
    assert [name for name, _ in COMMANDS if name] == ['setup', 'fails', 'terminal 1', 'terminal 2']
    assert len(BLOCKS) == TEXT.count('```') // 2


def test_the_controller_passes_its_test_and_fails_with_an_unknown_load(
    folder: Path, sim_arm
) -> None:
    names: dict = {}
    exec(FILES['test_law.py'], names)
    names['test_the_arm_settles'](sim_arm)
    (change,) = re.findall(r"sed 's/(.*)/(.*)/' test_law.py", TEXT)
    assert change[0] in FILES['test_law.py']
    exec(FILES['test_law.py'].replace(*change), names)
    with pytest.raises(AssertionError, match='shoulder: rests'):
        names['test_the_arm_settles'](sim_arm)


@pytest.mark.long
@pytest.mark.ros
def test_every_command_of_the_guide_works_as_printed(
    folder: Path, processes: Processes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    site = tmp_path_factory.mktemp('site')
    install(site)
    (site / 'pfd').write_text(f'#!/bin/sh\nexec {sys.executable} -m pfd_ros.cli.main "$@"\n')
    (site / 'pytest').write_text(f'#!/bin/sh\nexec {sys.executable} -m pytest "$@"\n')
    for name in ('pfd', 'pytest'):
        (site / name).chmod(0o755)
    env = environment(processes.domain)
    env |= {
        'PATH': f'{site}:{os.environ["PATH"]}',
        'PYTHONPATH': f'{site}:{env["PYTHONPATH"]}',
        'PYTEST_ADDOPTS': '-p no:cacheprovider',
    }
    outputs = []
    for name, body in COMMANDS:
        if name == 'terminal 1':
            arm = processes.python('-m', 'pfd_ros.cli.main', *shlex.split(body)[1:])
        elif name == 'terminal 2':
            controller = processes.python(*shlex.split(body)[1:])
            wait_for_commands(folder / 'run.mcap')
            controller.stop()
            arm.stop()
        elif name != 'setup':
            done = subprocess.run(
                ['bash', '-ec', body],
                cwd=folder,
                env=env,
                capture_output=True,
                text=True,
                timeout=PATIENCE,
                check=False,
            )
            assert (done.returncode == 0) == (name != 'fails'), done.stdout + done.stderr
            outputs.append(done.stdout)
    assert (folder / 'arm_0.html').exists()
    assert (folder / 'run.html').exists()
    assert '1 passed' in outputs[3]
    assert 'shoulder: rests' in outputs[4]
    assert re.search(r'^page +/', outputs[4], re.MULTILINE)
    assert 'every bit equal' in outputs[5]


def wait_for_commands(recording: Path) -> None:
    """Return once the arm has recorded commands."""
    wait_until(
        lambda: recording.exists() and len(read_log(recording)['/joint_commands']) >= 100,
        pause=0.5,
    )
