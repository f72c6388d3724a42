# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sessions of pytest in separate processes, with the plugin as an installation has it."""

from __future__ import annotations

from collections.abc import Sequence
import os
from pathlib import Path
import subprocess
import sys

import pytest
from ros_processes import PATIENCE, ROOT, ForkedProcess, Job

QUIET = ('-q', '-p', 'no:cacheprovider', '-W', 'error')


def install(folder: Path) -> None:
    """Describe this package in a folder as pip would, entry point included."""
    command = [sys.executable, 'setup.py', '-q', 'egg_info', '--egg-base', str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=PATIENCE)


def session(
    site: Path, folder: Path, code: str = '', options: Sequence[str] = (), status: int = 0
) -> str:
    """Run pytest on a folder, with a test file of this code; return its output.

    The process is a fork, which need not import this package.
    """
    if code:
        (folder / 'test_it.py').write_text(code, encoding='utf-8')
    output = folder / 'output.txt'
    args = [str(site), *options, str(folder)]
    job = Job('plugin_sessions', args, output, _environment(folder), folder, {})
    found, text = ForkedProcess(job).wait(), output.read_text(encoding='utf-8')
    assert found == status, text
    return text


def _environment(folder: Path) -> dict[str, str]:
    # Sessions that end together would tidy the same folder of temporary ones.
    return {**os.environ, 'PYTEST_ADDOPTS': '', 'PYTEST_DEBUG_TEMPROOT': str(folder)}


def main(args: list[str]) -> int:
    """Run pytest in a forked process."""
    site, *rest = args
    sys.path[:0] = [site, str(Path.cwd())]
    # The plugin has been imported, and its assertions are not rewritten.
    return int(pytest.main([*QUIET, '-W', 'ignore::pytest.PytestAssertRewriteWarning', *rest]))


def fresh_session(site: Path, folder: Path, code: str, options: Sequence[str], status: int) -> str:
    """Run pytest as `session` does, in a process that has imported nothing before."""
    (folder / 'test_it.py').write_text(code, encoding='utf-8')
    path = os.pathsep.join([str(site), str(ROOT), str(folder)])
    done = subprocess.run(
        [sys.executable, '-W', 'error', '-m', 'pytest', *QUIET, *options, str(folder)],
        cwd=folder,
        env={**_environment(folder), 'PYTHONPATH': path},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout
