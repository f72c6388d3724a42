# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd view --live` follows the joint states of a running arm."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from typing import Any
import urllib.request

from bridge import LinkPoses, LiveArm, MeshFolders, pfd_main
import numpy as np
import pytest
from ros_processes import Processes, environment
from view_models import STATE, STORE, joint_state, parsed, pendulum_end, urdf
from waiting import PATIENCE


def encoded(*state: Any) -> bytes:
    return bytes(STORE.serialize_cdr(joint_state(0.0, *state), STATE))


def test_the_arm_follows_joint_states_by_name_and_skips_invalid_messages(empty: Any) -> None:
    model = parsed(urdf())
    arm = LiveArm(empty, model, MeshFolders())
    assert arm.joints == ('swing',)
    end = LinkPoses(model, ['swing']).index('end')
    node = empty.scene.get_handle_by_name(f'/arm/link_{end}')

    def check(q: float) -> None:
        arm.draw()
        np.testing.assert_allclose(node.position, pendulum_end(q).translation, atol=1e-12)

    check(0.0)
    arm.take(encoded(['other', 'swing'], [9.0, 0.7], [1.0, 2.0]))
    check(0.7)
    # Shorter fields, numbers that are none, and bytes that are no message move nothing.
    for message in (
        encoded(['other'], [3.0]),
        encoded(['other', 'swing'], [3.0]),
        encoded(['swing'], []),
        encoded(['swing'], [np.nan]),
        encoded(['swing'], [np.inf]),
        encoded(['swing'], [1e300]),
        b'',
        b'\x00\x01\x00\x00\xff\xff\xff\xff',
        bytes(1 << 21),
    ):
        arm.take(message)
        check(0.7)
    assert (arm.received, arm.malformed) == (10, 3)
    arm.take(encoded(['swing'], [-1.2]))
    check(-1.2)


@pytest.mark.parametrize(
    ('arguments', 'error'),
    [
        ((), 'name a log, or show a running arm with --live'),
        (('--live', 'run.mcap', '--ghost', 'b.mcap'), "it takes no ['log', 'ghost']"),
        (('--live', '--export', 'a.html'), "it takes no ['export']"),
    ],
)
def test_a_log_and_live_exclude_each_other(
    arguments: tuple[str, ...], error: str, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip('rclpy')
    assert pfd_main(['view', *arguments]) == 1
    assert error in capsys.readouterr().err


@pytest.mark.ros
@pytest.mark.parametrize(
    ('words', 'domain', 'error'),
    [
        ((), 'many', 'ROS_DOMAIN_ID is not an integral number'),
        (('--topic', 'a b'), '0', "'a b' is not a valid topic name"),
        (('--topic', ''), '0', "'' is not a valid topic name"),
        (('--wrench-topic', 'a//b'), '0', "'a//b' is not a valid topic name"),
        (('--node', 'x y'), '0', "'x y' is not a valid node name"),
        (('--node', '/'), '0', "'' is not a valid node name"),
        (('--node', '/x y/arm'), '0', "'/x y' is not a valid node namespace"),
    ],
)
def test_an_invalid_domain_or_name_is_one_line(
    words: tuple[str, ...],
    domain: str,
    error: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', domain)
    assert pfd_main(['view', '--live', '--port', '0', *words]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert error in line


# The run of each day follows an arm in test_view_process.py.
@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.long
def test_a_running_arm_is_followed_until_ctrl_c(processes: Processes) -> None:
    processes.arm('-p', 'robot:=ur5', '-p', 'publish_description:=true')
    command = [sys.executable, '-m', 'pfd_ros.cli.main', 'view', '--live', '--port', '0']
    viewer = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment(processes.domain),
    )
    deadline = threading.Timer(PATIENCE, viewer.kill)
    deadline.start()
    try:
        assert viewer.stdout is not None
        lines: list[str] = []
        # On a busy machine lines on missing messages may come first.
        for line in viewer.stdout:
            lines.append(line)
            if line == 'receiving /joint_states\n':
                break
        deadline.cancel()
        assert lines[-1] == 'receiving /joint_states\n', lines
        (announced,) = (line for line in lines if line.startswith('http://127.0.0.1:'))
        with urllib.request.urlopen(announced.split()[0], timeout=PATIENCE) as answer:
            assert b'<html' in answer.read()
        viewer.send_signal(signal.SIGINT)
        rest, _ = viewer.communicate(timeout=PATIENCE)
        assert (rest, viewer.returncode) == ('', 0)
    finally:
        deadline.cancel()
        viewer.kill()
        viewer.communicate()
