# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd view` shows the states of a log at their times, on this computer only."""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
from typing import Any
import urllib.request

import numpy as np
import pytest
from rewriting import GOLDEN, STATES, load
from ros_processes import example_robot
from view_models import (
    STATE,
    UR5,
    Nodes,
    joint_state,
    recorded,
    swinging,
    text_message,
    ur5_poses,
    urdf,
    write_bag,
)
from waiting import PATIENCE

from pfd_ros import read_log
from pfd_ros.cli.main import main
from pfd_ros.view.logged_arm import Content, content_of
from pfd_ros.view.player import Player
from pfd_ros.view.server import HOST, address

TIMES = (0.0, 0.1, 0.2, 0.35, 0.5)


def content(path: Path, robot: str | None = None, topic: str | None = None) -> Content:
    return content_of(path, robot, topic)


@pytest.fixture(scope='module')
def ur5_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp('view') / 'ur5.mcap', example_robot(UR5))


def test_a_recording_of_a_urdf_with_meshes_is_drawn_at_the_poses_of_pinocchio(
    ur5_log: Path, empty: Any
) -> None:
    found = content(ur5_log)
    assert found.lines == ()
    assert not any(shape.stands_in for shape in found.drawing.shapes)
    nodes = Nodes(empty, found)
    pose, states = ur5_poses(ur5_log), read_log(ur5_log)['/joint_states']
    for place in (0, len(states) // 2, len(states) - 1):
        nodes.show(states.time[place] - states.time[0])
        for link in ('base_link', 'forearm_link', 'wrist_3_link'):
            shown = nodes.pose(f'/arm/link_{found.poses.index(link)}')
            np.testing.assert_allclose(
                shown.homogeneous, pose(place, link).homogeneous, atol=1e-12
            )


def test_a_recording_without_a_description_is_drawn_from_its_robot(tmp_path: Path) -> None:
    recorded = load(GOLDEN)
    recorded.keep(lambda sent: sent.topic != '/robot_description')
    found = content(recorded.save(tmp_path / 'bare.mcap'))
    assert found.seen.urdf.name == 'puma560'
    assert len(found.motion.joints) == 6
    times = [sent.log_ns for sent in recorded.on(STATES)]
    assert found.motion.duration == pytest.approx((times[-1] - times[0]) / 1e9)


def test_a_bag_needs_a_description_or_a_named_robot(tmp_path: Path) -> None:
    bag = swinging(tmp_path / 'bag', TIMES)
    with pytest.raises(ValueError, match=r'has no robot_description: name the robot with --robot'):
        content(bag)
    (tmp_path / 'arm.urdf').write_text(urdf())
    named = content(bag, str(tmp_path / 'arm.urdf'))
    assert named.motion.joints == ('swing',)
    described = content(swinging(tmp_path / 'described', TIMES, text=urdf()))
    np.testing.assert_allclose(described.motion.time, TIMES, atol=1e-9)
    np.testing.assert_allclose(described.motion.position[:, 0], TIMES)
    assert content(bag, 'ur5').lines[0].startswith('/joint_states: 1 joints are not in the model')


def test_the_state_shown_is_the_last_one_at_or_before_the_time(tmp_path: Path) -> None:
    motion = content(swinging(tmp_path / 'bag', TIMES, text=urdf())).motion
    for seconds, place in ((-1.0, 0), (0.0, 0), (0.099, 0), (0.1, 1), (0.34, 2), (9.0, 4)):
        assert motion.at(seconds) == place


def test_values_that_a_message_lacks_are_those_before(tmp_path: Path) -> None:
    def states() -> Iterator[Any]:
        for k, position in enumerate(([0.5], [np.nan], [np.inf], [1e300], [0.7])):
            yield '/joint_states', STATE, k, joint_state(k, ['swing'], position)

    described = ('/robot_description', 'std_msgs/msg/String', 0, text_message(urdf()))
    motion = content(write_bag(tmp_path / 'bag', [described, *states()])).motion
    assert motion.position[:, 0].tolist() == [0.5, 0.5, 0.5, 0.5, 0.7]


def test_stamps_that_decrease_are_replaced_by_log_times(tmp_path: Path) -> None:
    described = ('/robot_description', 'std_msgs/msg/String', 0, text_message(urdf()))
    states = [
        ('/joint_states', STATE, 10**9 * k, joint_state(stamp, ['swing'], [float(k)]))
        for k, stamp in enumerate((5.0, 6.0, 2.0))
    ]
    found = content(write_bag(tmp_path / 'bag', [described, *states]))
    assert found.lines[0] == '/joint_states: the stamps do not increase: times are log times'
    assert found.motion.time.tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ('names', 'position', 'line'),
    [
        ((), (), 'no joint of the model'),
        (('swing',), (), 'no positions'),
        (('other',), (1.0,), "1 joints are not in the model: ['other']"),
    ],
)
def test_a_log_without_positions_of_the_model_shows_the_arm_at_zero(
    names: tuple[str, ...], position: tuple[float, ...], line: str, tmp_path: Path, empty: Any
) -> None:
    described = ('/robot_description', 'std_msgs/msg/String', 0, text_message(urdf()))
    state = ('/joint_states', STATE, 0, joint_state(0.0, names, position))
    found = content(write_bag(tmp_path / 'bag', [described, state]))
    assert any(line in problem for problem in found.lines)
    Nodes(empty, found).show(0.0)


def test_a_log_without_joint_states_shows_the_arm_at_zero(tmp_path: Path, empty: Any) -> None:
    described = ('/robot_description', 'std_msgs/msg/String', 0, text_message(urdf()))
    found = content(write_bag(tmp_path / 'bag', [described]))
    assert 'has no sensor_msgs/msg/JointState: the arm is shown at zero' in found.lines[0]
    Nodes(empty, found).show(0.0)
    Player(empty.gui, found.motion, lambda _: None).advance(1.0)


def test_a_cut_log_is_shown_up_to_the_cut(tmp_path: Path) -> None:
    cut = load(GOLDEN).save(tmp_path / 'cut.mcap', chunk_size=2000)
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    found = content(cut)
    assert 'was cut off or not closed' in found.lines[0]
    assert 0 < found.motion.duration < content(GOLDEN).motion.duration


def test_the_topic_is_joint_states_or_the_named_one(tmp_path: Path) -> None:
    described = ('/robot_description', 'std_msgs/msg/String', 0, text_message(urdf()))
    states = [
        (topic, STATE, 0, joint_state(0.0, ['swing'], [value]))
        for topic, value in (('/a', 1.0), ('/joint_states', 2.0), ('/z', 3.0))
    ]
    bag = write_bag(tmp_path / 'bag', [described, *states])
    assert content(bag).motion.position[0, 0] == 2.0
    assert content(bag, topic='/z').motion.position[0, 0] == 3.0
    with pytest.raises(ValueError, match=r"has no topic '/y' of .*; it has \['/a', "):
        content(bag, topic='/y')


def test_the_player_plays_pauses_steps_and_ends(tmp_path: Path, empty: Any) -> None:
    motion = content(swinging(tmp_path / 'bag', TIMES, text=urdf())).motion
    shown: list[float] = []
    player = Player(empty.gui, motion, shown.append)
    player.advance(1.0)
    player.advance(1.0)
    assert shown == [0.0]  # only changes
    player.step(1)
    player.step(1)
    player.advance(0.0)
    assert shown[-1] == pytest.approx(0.2)
    player.toggle()
    player.advance(0.05)
    assert player.playing
    assert shown[-1] == pytest.approx(0.25)
    player.step(-1)
    player.advance(5.0)
    assert not player.playing
    assert shown[-1] == pytest.approx(0.1)
    player.toggle()
    player.advance(9.0)
    assert shown[-1] == pytest.approx(0.5)
    assert not player.playing
    player.toggle()
    player.advance(0.0)
    assert shown[-1] == 0.0
    player.seek(0.3)
    player.advance(0.0)
    assert shown[-1] == pytest.approx(0.3)


def test_the_page_is_served_on_this_computer_only(empty: Any) -> None:
    url = address(empty)
    assert url.startswith('http://127.0.0.1:')
    with urllib.request.urlopen(url, timeout=PATIENCE) as answer:
        assert b'<html' in answer.read()
    port = empty.get_port()
    listening = [
        line.split()[1]
        for line in Path('/proc/net/tcp').read_text().splitlines()[1:]
        if line.split()[1].endswith(f':{port:04X}') and line.split()[3] == '0A'
    ]
    assert listening == [f'0100007F:{port:04X}']


def test_a_port_in_use_is_one_line_with_the_cure(
    ur5_log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket() as other:
        other.bind((HOST, 0))
        other.listen()
        port = other.getsockname()[1]
        assert main(['view', str(ur5_log), '--port', str(port)]) == 1
    assert capsys.readouterr().err == (
        f'pfd view: port {port} is in use: --port 0 takes a free one\n'
    )


def test_without_the_extra_the_error_names_it(
    ur5_log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr('pfd_ros.view.ports.NEEDED', ('viser_which_nobody_has',))
    assert main(['view', str(ur5_log)]) == 1
    assert "pip install 'pfd_ros[view]'" in capsys.readouterr().err


@pytest.mark.parametrize('port', ['-1', '65536', 'x', '٣'])
def test_a_port_that_is_none_is_an_error(port: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(['view', 'run.mcap', f'--port={port}'])
    assert 'port must be in [0, 65535]' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('number', 'browser', 'line'),
    [
        (signal.SIGINT, {'BROWSER': '/nowhere/browser'}, 'no browser was found for --open'),
        pytest.param(signal.SIGTERM, {}, 'no display for --open', marks=pytest.mark.long),
    ],
)
def test_the_command_prints_the_address_without_rclpy_and_ends_by_signals(
    ur5_log: Path, number: signal.Signals, browser: dict[str, str], line: str
) -> None:
    program = (
        'import signal, sys, threading\n'
        # A shell that runs the tests in the background ignores the signal.
        'signal.signal(signal.SIGINT, signal.default_int_handler)\n'
        'from pfd_ros.cli.main import main\n'
        'status = main(sys.argv[1:])\n'
        "print('rclpy' in sys.modules, threading.active_count())\n"
        'raise SystemExit(status)\n'
    )
    command = [sys.executable, '-c', program, 'view', str(ur5_log), '--port=0', '--open']
    displays = ('DISPLAY', 'WAYLAND_DISPLAY', 'BROWSER')
    others = {name: value for name, value in os.environ.items() if name not in displays}
    environment = {**others, 'PATH': '', **browser}
    viewer = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment,
    )
    try:
        assert viewer.stdout is not None
        first, second = viewer.stdout.readline(), viewer.stdout.readline()
        assert first.startswith('http://127.0.0.1:')
        assert first.endswith('shows ur5.mcap; Ctrl-C ends it\n')
        assert second.startswith(f'{line}: open http://127.0.0.1:')
        viewer.send_signal(number)
        rest, _ = viewer.communicate(timeout=PATIENCE)
        assert rest == 'False 1\n'
        assert viewer.returncode == 0
    finally:
        viewer.kill()
        viewer.communicate()
