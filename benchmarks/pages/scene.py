# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An example of the product's advice on a scene: the file that `pfd report scene` writes."""

from __future__ import annotations

from contextlib import redirect_stdout
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.table import page
from pfd_ros.cli.main import main

COMMAND = 'report scene --robot {} --trajectory sine --tolerance 0.001'


def measure(quick: bool) -> dict[str, Any]:
    """Return the advice on a PUMA 560 that follows sines, or quickly on an arm of two joints."""
    robot = 'planar2' if quick else 'puma560'
    with TemporaryDirectory() as folder, redirect_stdout(sys.stderr):
        path = Path(folder) / 'scene.yaml'
        if main([*COMMAND.format(robot).split(), '--out', str(path)]):
            raise RuntimeError('pfd report scene failed')
        return {'robot': robot, 'file': path.read_text(encoding='utf-8').splitlines()}


def text(data: dict[str, Any]) -> str:
    """Return the page as Markdown."""
    robot, lines = data['robot'], (f'    {line}' for line in data['file'])
    return page('scene', robot=robot, command=COMMAND.format(robot), file='\n'.join(lines))
