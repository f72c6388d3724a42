# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd urdf`: prints or writes the URDF of a robot."""

from __future__ import annotations

import os
from pathlib import Path
import re
import subprocess
import sys

from bridge import pfd_main
import pytest

import pfd_core as pfd


def test_pfd_urdf_prints_and_writes_the_urdf_of_a_robot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert pfd_main(['urdf', 'planar2']) == 0
    printed = capsys.readouterr().out
    assert pfd.load_robot(printed).joint_names == pfd.load_robot('planar2').joint_names
    path = tmp_path / 'arm.urdf'
    assert pfd_main(['urdf', 'planar2', '--out', str(path)]) == 0
    assert path.read_text(encoding='utf-8') == printed


def test_pfd_urdf_prints_the_bytes_that_it_writes_also_where_stdout_is_ascii(
    tmp_path: Path,
) -> None:
    arm, path = tmp_path / 'arm.urdf', tmp_path / 'written.urdf'
    assert pfd_main(['urdf', 'planar2', '--out', str(arm)]) == 0
    text = arm.read_text(encoding='utf-8')
    arm.write_text(re.sub('<robot name="[^"]*"', '<robot name="é"', text), encoding='utf-8')
    assert pfd_main(['urdf', str(arm), '--out', str(path)]) == 0
    done = subprocess.run(
        [sys.executable, '-m', 'pfd_ros.cli.main', 'urdf', str(arm)],
        capture_output=True,
        env=os.environ | {'PYTHONIOENCODING': 'ascii'},
        check=True,
    )
    assert 'name="é"'.encode() in done.stdout
    assert done.stdout == path.read_bytes()


def test_pfd_urdf_of_an_unknown_robot_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert pfd_main(['urdf', 'ur55']) == 1
    assert capsys.readouterr().err.startswith("pfd urdf: unknown robot 'ur55': known are panda")


def test_pfd_urdf_without_an_output_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, 'stdout', None)
    assert pfd_main(['urdf', 'ur5']) == 1
    assert capsys.readouterr().err == 'pfd urdf: no standard output; use --out\n'
