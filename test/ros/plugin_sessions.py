# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sessions of pytest in separate processes, with the plugin as an installation has it."""

from __future__ import annotations

from collections.abc import Sequence
import os
from pathlib import Path
import subprocess
import sys

from forked_process import ForkedProcess, Job
import pytest
from ros_processes import PATIENCE, ROOT


def install(folder: Path) -> None:
    """Describe this package in a folder as pip would, entry point included."""
    command = [sys.executable, 'setup.py', '-q', 'egg_info', '--egg-base', str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=120)


def session(
    site: Path, folder: Path, code: str, options: Sequence[str] = (), status: int = 0
) -> str:
    """Run pytest on the code of one test file in a new process; return its output."""
    (folder / 'test_it.py').write_text(code, encoding='utf-8')
    return run(site, folder, options, status)


def forked_session(
    site: Path, folder: Path, code: str, options: Sequence[str] = (), status: int = 0
) -> str:
    """Run pytest as `session` does, in a process that need not import this package."""
    (folder / 'test_it.py').write_text(code, encoding='utf-8')
    output = folder / 'output.txt'
    env = {**os.environ, 'PYTEST_ADDOPTS': ''}
    job = Job('plugin_sessions', [str(site), *options, str(folder)], output, env, folder, {})
    found = ForkedProcess(job).wait(PATIENCE)
    text = output.read_text(encoding='utf-8')
    assert found == status, text
    return text


def main(args: list[str]) -> int:
    """Run pytest in a forked process."""
    site, *rest = args
    sys.path.insert(0, site)
    # The plugin has been imported, and its assertions are not rewritten.
    imported = 'ignore::pytest.PytestAssertRewriteWarning'
    return int(pytest.main(['-q', '-p', 'no:cacheprovider', '-W', 'error', '-W', imported, *rest]))


def run(site: Path, folder: Path, options: Sequence[str] = (), status: int = 0) -> str:
    """Run pytest on a folder where the package is installed, warnings as errors."""
    path = os.pathsep.join([str(site), str(ROOT), str(folder)])
    command = (sys.executable, '-W', 'error', '-m', 'pytest', '-q', '-p', 'no:cacheprovider')
    done = subprocess.run(
        [*command, *options, str(folder)],
        cwd=folder,
        env={**os.environ, 'PYTHONPATH': path, 'PYTEST_ADDOPTS': ''},
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout
