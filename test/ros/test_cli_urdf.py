# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd urdf`: prints or writes the URDF of a robot."""

from __future__ import annotations

from pathlib import Path
import sys

import pytest

import pfd_core as pfd
from pfd_ros.cli.main import main


def test_pfd_urdf_prints_and_writes_the_urdf_of_a_robot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['urdf', 'planar2']) == 0
    printed = capsys.readouterr().out
    assert pfd.load_robot(printed).joint_names == pfd.load_robot('planar2').joint_names
    path = tmp_path / 'arm.urdf'
    assert main(['urdf', 'planar2', '--out', str(path)]) == 0
    assert path.read_text(encoding='utf-8') == printed


def test_pfd_urdf_of_an_unknown_robot_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['urdf', 'ur55']) == 1
    assert capsys.readouterr().err.startswith("pfd urdf: unknown robot 'ur55': known are panda")


def test_pfd_urdf_without_an_output_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, 'stdout', None)
    assert main(['urdf', 'ur5']) == 1
    assert capsys.readouterr().err == 'pfd urdf: no standard output; use --out\n'
