# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Imports point one way, and the tools that read the source find nothing."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
import shutil
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parent.parent
LAYERS = ('model', 'machine', 'algorithms', 'kernels', 'simulation', 'report')
# What each layer may import of the others; `machine` knows no robots.
ALLOWED = {
    'model': {'model'},
    'machine': {'machine'},
    'algorithms': {'model', 'machine', 'algorithms'},
    'kernels': {'model', 'machine', 'algorithms', 'kernels'},
    'simulation': {'model', 'machine', 'algorithms', 'kernels', 'simulation'},
    'report': set(LAYERS),
}
# Outside packages that only some layers may know.
RESERVED = {
    'llvmlite': {'kernels'},
    'pinocchio': {'model', 'report'},
    'yaml': {'model'},
    'rclpy': set(),
}


def imports_of(path: Path) -> Iterator[tuple[str, int]]:
    """Yield the full name of every module that a file imports, and the line."""
    package = path.relative_to(ROOT).with_suffix('').parts[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, node.lineno
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            stem = '.'.join([*base, *([node.module] if node.module else [])])
            for alias in node.names:
                yield f'{stem}.{alias.name}', node.lineno


def violations(path: Path) -> Iterator[str]:
    """Yield one line for each import of a file that points the wrong way."""
    layer = path.relative_to(ROOT).parts[1]
    for name, line in imports_of(path):
        parts = name.split('.')
        where = f'{path.relative_to(ROOT)}:{line}'
        if parts[0] == 'pfd_ros':
            yield f'{where}: pfd_core imports {name}'
        if layer not in LAYERS:
            continue
        if parts[0] == 'pfd_core' and parts[1] not in ALLOWED[layer] | {'_types'}:
            yield f'{where}: {layer} imports {name}'
        if parts[0] in RESERVED and layer not in RESERVED[parts[0]]:
            yield f'{where}: {layer} imports {name}'


def test_imports_point_one_way() -> None:
    found = [v for path in (ROOT / 'pfd_core').rglob('*.py') for v in violations(path)]
    assert not found, '\n'.join(found)


def test_pfd_ros_uses_only_the_public_names_and_the_reports_of_pfd_core() -> None:
    found = [
        f'{path.name}:{line}: {name}'
        for path in (ROOT / 'pfd_ros').rglob('*.py')
        for name, line in imports_of(path)
        if name.startswith('pfd_core.') and name.split('.')[1] in set(LAYERS) - {'report'}
    ]
    assert not found, '\n'.join(found)


def test_the_check_sees_an_import_that_points_backwards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.modules[__name__], 'ROOT', tmp_path)
    wrong = tmp_path / 'pfd_core' / 'machine' / 'wrong.py'
    wrong.parent.mkdir(parents=True)
    wrong.write_text('from pfd_core.kernels import lower\nimport rclpy\n')
    assert len(list(violations(wrong))) == 2


@pytest.mark.parametrize(
    'command',
    [
        ('ruff', 'check', 'pfd_core', 'pfd_ros', 'test', 'benchmarks', 'setup.py'),
        ('ruff', 'format', '--check', 'pfd_core', 'pfd_ros', 'test', 'benchmarks', 'setup.py'),
        ('mypy',),
    ],
    ids=['lint', 'format', 'types'],
)
def test_the_source_passes(command: tuple[str, ...]) -> None:
    tool = shutil.which(command[0], path=str(Path(sys.executable).parent)) or command[0]
    done = subprocess.run(
        [tool, *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr
