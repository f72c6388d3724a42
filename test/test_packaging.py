# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Installations by pip and colcon are complete."""

from __future__ import annotations

import ast
from collections.abc import Callable
import os
from pathlib import Path
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile

import pytest

ROOT = Path(__file__).resolve().parent.parent
TIMEOUT = 240.0
COLCON = shutil.which(
    'colcon', path=os.pathsep.join([str(Path(sys.executable).parent), os.environ['PATH']])
)
CLEAN = ('.git', '.venv', 'build', 'install', 'log', '__pycache__', '*.egg-info', '.*_cache')


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """Return a copy of the sources, which a build may write into."""
    target = tmp_path / 'src' / 'pfd_ros'
    shutil.copytree(ROOT, target, ignore=shutil.ignore_patterns(*CLEAN))
    return target


def run(command: list[str], folder: Path, **environment: str) -> str:
    done = subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=TIMEOUT,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def installed(sources: Path) -> dict[str, str]:
    """Return the text of each file that setup.py installs, by path; it takes half a second."""
    root = sources / 'dist'
    options = ('--root', str(root), '--single-version-externally-managed', '--no-compile')
    run([sys.executable, 'setup.py', '-q', 'install', *options], sources)
    files = [path for path in root.rglob('*') if path.is_file()]
    return {str(path): path.read_text(encoding='utf-8') for path in files}


def wheel(sources: Path) -> dict[str, str]:
    """Return the text of each file in the wheel, by path; pip fetches its tools for that."""
    run([sys.executable, '-m', 'pip', 'wheel', '--no-deps', '-q', '-w', 'dist', '.'], sources)
    (path,) = (sources / 'dist').glob('pfd_ros-*.whl')
    with zipfile.ZipFile(path) as found:
        return {name: found.read(name).decode() for name in found.namelist()}


@pytest.mark.parametrize('build', [installed, pytest.param(wheel, marks=pytest.mark.slow)])
def test_an_installation_holds_code_robots_parameters_and_the_ament_marker(
    copy: Path, build: Callable[[Path], dict[str, str]]
) -> None:
    files = build(copy)
    for part in (
        'pfd_core/kernels/kernel.py',
        'pfd_core/py.typed',
        'pfd_ros/py.typed',
        'pfd_core/config/robots/puma560.yaml',
        'pfd_core/config/sim_arm.yaml',
        'pfd_ros/node/main.py',
        'pfd_ros/testing/loopback.xml',
        *(f'pfd_ros/page/assets/{path.name}' for path in (ROOT / 'pfd_ros/page/assets').iterdir()),
        'share/pfd_ros/package.xml',
        'share/pfd_ros/config/sim_arm.yaml',
        'share/pfd_ros/launch/two_arms.launch.py',
        'share/ament_index/resource_index/packages/pfd_ros',
    ):
        assert any(name.endswith(part) for name in files), part


@pytest.mark.slow
def test_ros_comes_only_with_its_extra(copy: Path) -> None:
    # Otherwise it would lie over a machine's own.
    files = installed(copy)
    (text,) = (text for name, text in files.items() if name.endswith('egg-info/requires.txt'))
    needed, _, ros = text.partition('\n[ros]\n')
    assert 'ros-jazzy' not in needed
    assert ros.split('\n\n')[0].count('ros-jazzy') == 3
    assert 'ros-jazzy' not in ros.split('\n\n')[1]


def test_package_xml_and_setup_py_agree() -> None:
    manifest = ET.parse(ROOT / 'package.xml').getroot()
    assert manifest.get('format') == '3'
    assert manifest.findtext('export/build_type') == 'ament_python'
    call = next(
        node
        for node in ast.walk(ast.parse((ROOT / 'setup.py').read_text()))
        if isinstance(node, ast.Call) and getattr(node.func, 'id', '') == 'setup'
    )
    stated = {k.arg: k.value.value for k in call.keywords if isinstance(k.value, ast.Constant)}
    assert manifest.findtext('version') == stated['version']
    assert manifest.findtext('license') == stated['license'] == 'Apache-2.0'
    assert manifest.findtext('name') == 'pfd_ros'


@pytest.mark.slow
@pytest.mark.skipif(COLCON is None, reason='colcon is not installed')
def test_colcon_builds_a_node_that_runs(copy: Path) -> None:
    workspace = copy.parent.parent
    # A warning of setuptools on stderr is no failure; the exit status is.
    run([str(COLCON), 'build'], workspace)
    prefix = workspace / 'install' / 'pfd_ros'
    for part in ('lib/pfd_ros/sim_node', 'lib/pfd_ros/pfd', 'share/pfd_ros/package.xml'):
        assert (prefix / part).exists(), part
    (packages,) = prefix.glob('lib/python*/site-packages')
    stated = run(
        [sys.executable, str(prefix / 'lib/pfd_ros/pfd'), 'robots'],
        workspace,
        PYTHONPATH=str(packages),
    )
    assert 'puma560' in stated
