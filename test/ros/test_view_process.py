# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd sim --view` and `pfd demo --view`: the view is a process that ends with the arm."""

from __future__ import annotations

import argparse
from collections.abc import Callable
import os
from pathlib import Path
import re
import signal
import socket
import time
import urllib.request

from browser import needs_browser
from devtools import opened, red
import pytest
from ros_processes import Peer, Process, Processes, call
from waiting import PATIENCE, wait_until

from pfd_ros.cli.main import commands_of, parser
from pfd_ros.demo.processes import run_demo
from pfd_ros.view.ports import HOST

# Parts of a page whose colour is that of a force.
LEAST = 0.0005


def parsed(*words: str) -> argparse.Namespace:
    given = parser(commands_of(words)).parse_args(words)
    given.ros_args, given.stop = [], None
    return given


def run(*words: str) -> int:
    """Run a command in this process, without its handlers of signals."""
    return int(commands_of(words)[words[0]].run(parsed(*words)))


@pytest.mark.parametrize('command', ['sim', 'demo'])
def test_a_view_that_cannot_start_is_one_line_before_the_arm(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object) -> None:
        raise AssertionError('the arm was started')

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr('pfd_ros.node.main.main', never)
    monkeypatch.setattr('pfd_ros.demo.processes.ChildProcess', never)
    with socket.socket() as other:
        other.bind((HOST, 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(ValueError, match=f'^port {port} is in use: --port 0 takes a free one'):
            run(command, '--view', '--port', str(port))
    monkeypatch.setattr('pfd_ros.view.ports.NEEDED', ('viser_which_nobody_has',))
    with pytest.raises(
        ValueError, match=r"needs viser and trimesh: pip install 'pfd_ros\[view\]'"
    ):
        run(command, '--view')
    assert not any(tmp_path.iterdir())


class Viewed:
    """A node with a view, and the processes that belong to it."""

    def __init__(self, processes: Processes, *ros_args: str) -> None:
        self.arm = processes.python(
            *('-m', 'pfd_ros.cli.main', 'sim', '--robot', 'ur5', '--view', '--port', '0'),
            *(['--ros-args', *ros_args] if ros_args else []),
        )
        self.arm.wait_for_text('; Ctrl-C ends it')
        self.arm.wait_for_text('receiving ')
        self.url = re.findall(r'^(http://\S+) shows ', self.arm.text(), re.MULTILINE)
        self.view = child_of(self.arm)

    def wait_for_the_end(self) -> None:
        """Wait until the view is gone, and its port."""
        wait_until(lambda: not Path(f'/proc/{self.view}').exists())
        with socket.socket() as probe:
            assert probe.connect_ex((HOST, int(self.url[0].rpartition(':')[2]))) != 0


def child_of(process: Process) -> int:
    """Return the only child of a process."""
    found = []
    for stat in Path('/proc').glob('[0-9]*/stat'):
        try:
            fields = stat.read_text().rpartition(')')[2].split()
        except OSError:  # which has ended meanwhile
            continue
        if int(fields[1]) == process.process.pid:
            found.append(int(stat.parent.name))
    (child,) = found
    return child


@pytest.mark.ros
def test_an_arm_continues_without_its_view_and_logs_it_once(processes: Processes) -> None:
    viewed = Viewed(processes, '-r', '__ns:=/left', '-r', 'joint_states:=states')
    assert len(viewed.url) == 1
    assert 'receiving /left/states' in viewed.arm.text()
    with urllib.request.urlopen(viewed.url[0], timeout=PATIENCE) as answer:
        assert b'<html' in answer.read()
    nicer = min(os.getpriority(os.PRIO_PROCESS, 0) + 10, 19)
    assert os.getpriority(os.PRIO_PROCESS, viewed.view) == nicer
    os.kill(viewed.view, signal.SIGKILL)
    viewed.arm.wait_for_text('the 3D view ended by SIGKILL; the arm continues')
    # It logs once a second.
    time.sleep(2.5)
    assert viewed.arm.end(signal.SIGINT) == 0
    assert viewed.arm.text().count('the 3D view') == 1
    viewed.wait_for_the_end()


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_the_view_ends_with_the_arm_however_that_ends(
    processes: Processes, number: signal.Signals
) -> None:
    viewed = Viewed(processes)
    status = viewed.arm.end(number)
    assert status == (-number if number is signal.SIGKILL else 0)
    viewed.wait_for_the_end()
    assert 'Traceback' not in viewed.arm.text()
    assert 'the 3D view' not in viewed.arm.text()


@needs_browser
@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.long
def test_the_page_of_a_running_arm_shows_a_force_until_it_is_cleared(
    processes: Processes, peer_of: Callable[..., Peer], tmp_path: Path
) -> None:
    from geometry_msgs.msg import WrenchStamped
    from std_srvs.srv import Trigger

    viewed, peer = Viewed(processes, '-p', 'external_wrench:=true'), peer_of(processes)
    hand = peer.node.create_publisher(WrenchStamped, '/sim_arm/external_wrench', 1)
    # The arm and the view.
    peer.wait(lambda: hand.get_subscription_count() == 2)
    with opened(viewed.url[0], tmp_path / 'profile') as shown:
        wait_until(lambda: '1 m = 50 N' in (shown.value('document.body.innerText') or ''))
        assert red(shown) < LEAST
        message = WrenchStamped()
        message.header.frame_id = 'tool0'
        message.wrench.force.z = 60.0
        hand.publish(message)
        wait_until(lambda: red(shown) > LEAST)
        # A report comes each second; the wrench acts, and stays.
        peer.let_pass(1500)
        assert red(shown) > LEAST
        assert call(peer, Trigger, 'clear_external_wrench').success
        wait_until(lambda: red(shown) < LEAST)
        assert shown.console == []
    assert viewed.arm.end(signal.SIGINT) == 0
    viewed.wait_for_the_end()


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.long
def test_the_demo_shows_the_arm_while_it_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # Nobody opens the page.
    monkeypatch.setattr('pfd_ros.demo.processes.PAGE_SECONDS', 0.5)
    assert run_demo('planar2', 1.0, tmp_path, 0) == 0, capsys.readouterr()
    printed = capsys.readouterr().out
    assert re.search(
        r'^view +http://127\.0\.0\.1:\d+: the arm starts when a browser', printed, re.M
    )
    log = tmp_path / 'arm_0.mcap'
    assert f'pfd report log {log}; pfd view {log}\n' in printed
    seen = (tmp_path / 'arm_0.view.txt').read_text()
    assert re.search(r'^receiving /pfd_demo_[0-9a-f]{8}/joint_states$', seen, re.MULTILINE)
    assert 'Traceback' not in seen
