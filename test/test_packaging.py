# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What pip and colcon install is complete."""

from __future__ import annotations

import ast
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


def test_a_wheel_holds_code_robots_parameters_and_the_ament_marker(copy: Path) -> None:
    run([sys.executable, '-m', 'pip', 'wheel', '--no-deps', '-q', '-w', 'dist', '.'], copy)
    (wheel,) = (copy / 'dist').glob('pfd_ros-*.whl')
    names = zipfile.ZipFile(wheel).namelist()
    for part in (
        'pfd_core/kernels/kernel.py',
        'pfd_core/py.typed',
        'pfd_core/config/robots/puma560.yaml',
        'pfd_core/config/sim_arm.yaml',
        'pfd_ros/node/main.py',
        'share/pfd_ros/package.xml',
        'share/pfd_ros/config/sim_arm.yaml',
        'share/ament_index/resource_index/packages/pfd_ros',
    ):
        assert any(name.endswith(part) for name in names), part
    text = zipfile.ZipFile(wheel).read(next(n for n in names if n.endswith('METADATA'))).decode()
    required = [line for line in text.splitlines() if line.startswith('Requires-Dist')]
    # ROS comes only with its extra: it must not lie over a machine's own.
    assert all('extra == "ros"' in line for line in required if 'ros-jazzy' in line)
    assert sum('ros-jazzy' in line for line in required) == 3


def test_package_xml_and_setup_py_tell_the_same() -> None:
    manifest = ET.parse(ROOT / 'package.xml').getroot()
    assert manifest.get('format') == '3'
    assert manifest.findtext('export/build_type') == 'ament_python'
    call = next(
        node
        for node in ast.walk(ast.parse((ROOT / 'setup.py').read_text()))
        if isinstance(node, ast.Call) and getattr(node.func, 'id', '') == 'setup'
    )
    told = {k.arg: k.value.value for k in call.keywords if isinstance(k.value, ast.Constant)}
    assert manifest.findtext('version') == told['version']
    assert manifest.findtext('license') == told['license'] == 'Apache-2.0'
    assert manifest.findtext('name') == 'pfd_ros'


def test_the_readme_has_one_command_to_run_and_one_to_test() -> None:
    text = (ROOT / 'README.md').read_text()
    for mark in ('demo', 'test'):
        block = text.split(f'<!-- {mark} -->\n```sh\n')[1].split('\n```')[0]
        assert block.startswith('python3 -m venv .venv && .venv/bin/pip install')
        assert '\n' not in block


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
    told = run(
        [sys.executable, str(prefix / 'lib/pfd_ros/pfd'), 'robots'],
        workspace,
        PYTHONPATH=str(packages),
    )
    assert 'puma560' in told
