# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The packages of the extras of setup.py, and the command that installs those of one."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path
import re
import shlex
import sys

PACKAGE = 'pfd_ros'


def requirements() -> dict[str, list[str]]:
    """Return what pip installs for each extra, by the installed metadata; {} without metadata."""
    found: dict[str, list[str]] = {}
    try:
        lines = metadata.requires(PACKAGE) or []
    except metadata.PackageNotFoundError:
        lines = []
    for line in lines:
        requirement, _, marker = line.partition(';')
        for extra in re.findall(r'\bextra == .([\w-]+)', marker):
            found.setdefault(extra, []).append(requirement.strip())
    return found


def install(extra: str) -> str:
    """Return the command that installs an extra for this Python.

    It names the packages of the extra: an index has no pfd_ros, or another one of this name.
    Without metadata the package runs from the folder with its sources, which pip can install.
    """
    sources = Path(__file__).resolve().parents[1]
    packages = requirements().get(extra) or [f'{sources}[{extra}]']
    return shlex.join([sys.executable, '-m', 'pip', 'install', *packages])
