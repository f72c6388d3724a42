# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The test in README.md passes, and the example repository's own tests, from a copy of it."""

from __future__ import annotations

import os
from pathlib import Path
import re
import shutil
from typing import Any

from plugin_sessions import install, run
import pytest
from ros_processes import ROOT

EXAMPLE = ROOT / 'docs' / 'examples' / 'controller_package'


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    return Path(shutil.copytree(EXAMPLE, tmp_path / 'controller_package'))


def test_the_test_in_the_readme_passes(sim_arm) -> None:
    (code,) = re.findall('```py\n(.*?)```', (ROOT / 'README.md').read_text(encoding='utf-8'), re.S)
    names: dict[str, Any] = {}
    exec(code, names)
    names['test_controller_settles'](sim_arm)


@pytest.mark.ros
@pytest.mark.slow
def test_the_example_repository_passes_its_tests(copied: Path, tmp_path: Path) -> None:
    install(tmp_path)
    assert '9 passed' in run(tmp_path, copied)


@pytest.mark.slow
def test_the_control_law_of_the_example_is_tested_without_ros(
    copied: Path, tmp_path: Path
) -> None:
    install(tmp_path)
    (copied / 'conftest.py').write_text("import sys\nsys.modules['rclpy'] = None\n")
    assert '7 passed, 1 skipped' in run(tmp_path, copied)


@pytest.fixture
def guide(copied: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return the names of the blocks with fixtures in the guide about tests."""
    text = (ROOT / 'docs/guides/testing-a-controller.md').read_text(encoding='utf-8')
    # The settings and the goal of the first block, which test_guides.py runs.
    names: dict[str, Any] = {}
    for line in re.findall(r'^(?:import numpy|goal = |ur5 = ).*$', text, re.MULTILINE):
        exec(line, names)
    monkeypatch.syspath_prepend(copied)
    monkeypatch.setenv('PYTHONPATH', os.pathsep.join([str(copied), str(ROOT)]))
    for code in re.findall('```py\n(.*?)```', text, re.S):
        exec(code, names)
    return names


@pytest.mark.ros
def test_the_test_of_a_node_in_the_guide_passes(
    guide: dict[str, Any], sim_arm, ros_domain: int
) -> None:
    guide['test_node'](sim_arm, ros_domain)


@pytest.mark.ros
@pytest.mark.long
def test_the_test_of_a_process_in_the_guide_passes(
    guide: dict[str, Any], sim_arm, controller_process
) -> None:
    guide['test_process'](sim_arm, controller_process)


def test_the_readme_of_the_example_names_its_files(copied: Path) -> None:
    page = (copied / 'README.md').read_text(encoding='utf-8')
    for path in copied.rglob('*.py'):
        name = str(path.relative_to(copied))
        assert name in page or path.name == '__init__.py'
