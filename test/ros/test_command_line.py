# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The command `pfd`: exit statuses, errors, and commands that work without ROS."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys

import bridge
from bridge import CLOSED_PIPE, pfd_main
import pytest
from rewriting import GOLDEN
from ros_processes import Processes, environment
from sampling import one_fast

import pfd_core as pfd

WITHOUT_ROS = (
    'import importlib.util, sys\n'
    'find = importlib.util.find_spec\n'
    "importlib.util.find_spec = lambda name, *a: None if name == 'rclpy' else find(name, *a)\n"
    "sys.modules['rclpy'] = None\n"
    'from bridge import pfd_main\n'
    'raise SystemExit(pfd_main(sys.argv[1:]))\n'
)


def without_ros(tmp_path: Path, *args: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, '-c', WITHOUT_ROS, *args],
        cwd=tmp_path,
        env=environment(1),
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


@pytest.mark.parametrize('words', one_fast([['counts'], ['counts', '--quick'], ['nothing'], []]))
def test_a_report_that_is_no_longer_in_the_product_is_one_line_with_the_other_command(
    words: list[str], tmp_path: Path
) -> None:
    done = without_ros(tmp_path, 'report', *words)
    assert done.returncode == 2
    assert done.stdout == ''
    assert done.stderr.startswith('pfd report: ')
    assert 'python -m benchmarks' in done.stderr
    assert done.stderr.count('\n') == 1


def test_robots_lists_each_robot_with_its_joints(capsys: pytest.CaptureFixture[str]) -> None:
    assert pfd_main(['robots']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(pfd.known_robots())
    assert any('6 joints: joint1, joint2' in line for line in lines)


def test_a_file_that_is_not_there_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert pfd_main(['replay', str(tmp_path / 'nix.mcap')]) == 1
    assert 'nix.mcap' in capsys.readouterr().err


@pytest.mark.parametrize(
    'args', [[], ['dance'], ['replay'], ['replay', 'a', '--ros-args'], ['replay', 'a', '--loop']]
)
def test_a_command_that_makes_no_sense_has_status_2(
    args: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        status = pfd_main(args)
    except SystemExit as error:
        status = error.code
    assert status == 2
    assert capsys.readouterr().err


@pytest.mark.parametrize('command', [['demo'], ['sim'], ['replay', 'a.mcap', '--publish']])
def test_without_ros_the_message_states_how_to_get_it(tmp_path: Path, command: list[str]) -> None:
    done = without_ros(tmp_path, *command)
    assert done.returncode == 1
    assert "pip install 'pfd_ros[ros]'" in done.stderr
    assert 'Traceback' not in done.stderr


@pytest.mark.slow
def test_robots_and_help_work_without_ros(tmp_path: Path) -> None:
    assert 'puma560' in without_ros(tmp_path, 'robots').stdout
    assert 'replay' in without_ros(tmp_path, '--help').stdout


@pytest.mark.ros
def test_pfd_sim_is_the_node(processes: Processes) -> None:
    arm = processes.python(
        '-m', 'pfd_ros.cli.main', 'sim', '--robot', 'planar2', '--ros-args', '-r', '__ns:=/x'
    )
    arm.wait_for_text('planar2: each of the 2 joints is braked until its first command')
    arm.stop()


def test_ctrl_c_is_no_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(*bridge.target('pfd_replay_run'), interrupt)
    assert pfd_main(['replay', 'a.mcap']) == 130
    assert capsys.readouterr() == ('', '')


def test_an_error_of_several_lines_is_printed_in_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise ValueError('not YAML:\n  line 1\n\x1b[2Jand ' + 'x' * 10_000)

    monkeypatch.setattr(*bridge.target('pfd_replay_run'), refuse)
    assert pfd_main(['replay', 'a.mcap']) == 1
    told = capsys.readouterr().err
    assert told.startswith(r'pfd replay: not YAML: line 1 \x1b[2Jand xxx')
    assert told.count('\n') == 1
    assert len(told) < 1000


@pytest.mark.parametrize(
    'words', one_fast([['info', str(GOLDEN)], ['robots'], ['--help'], ['info', '--help']])
)
def test_a_reader_that_ends_first_ends_a_command_quietly(words: list[str]) -> None:
    # argparse ignores errors of output that is not buffered.
    of_shell = {k: v for k, v in environment(1).items() if k != 'PYTHONUNBUFFERED'}
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(
            [sys.executable, '-m', 'pfd_ros.cli.main', *words],
            env=of_shell,
            stdout=writing,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            timeout=120,
        )
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (CLOSED_PIPE, '')


@pytest.mark.parametrize(
    ('command', 'name', 'shown'),
    [
        ('info', 'é☃.mcap', rb'\xe9\u2603'),
        ('recover', os.fsdecode(b'\xff.mcap'), rb'\udcff'),
    ],
)
def test_names_that_a_terminal_cannot_show_are_escaped(
    command: str, name: str, shown: bytes, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_bytes(GOLDEN.read_bytes())
    done = subprocess.run(
        [sys.executable, '-m', 'pfd_ros.cli.main', command, str(path)],
        env=environment(1) | {'PYTHONIOENCODING': 'ascii'},
        capture_output=True,
        check=False,
        timeout=120,
    )
    assert (done.returncode, done.stderr) == (0, b'')
    assert shown in done.stdout
