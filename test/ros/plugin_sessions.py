# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sessions of pytest in separate processes, with the plugin as an installation has it."""

from __future__ import annotations

from collections.abc import Sequence
import os
from pathlib import Path
import subprocess
import sys

from ros_processes import ROOT


def install(folder: Path) -> None:
    """Describe this package in a folder as pip would, entry point included."""
    command = [sys.executable, 'setup.py', '-q', 'egg_info', '--egg-base', str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=120)


def session(
    site: Path, folder: Path, code: str, options: Sequence[str] = (), status: int = 0
) -> str:
    """Run pytest on the code of one test file; return its output."""
    (folder / 'test_it.py').write_text(code, encoding='utf-8')
    return run(site, folder, options, status)


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
