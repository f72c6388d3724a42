# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd view` of logs and of running arms: what is shown, the command, and pages in a browser."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import os
from pathlib import Path
import re
import signal
import socket
import subprocess
import sys
from time import sleep
from typing import Any
import urllib.request

from arm_messages import efforts, payload, placed, wrench
from devtools import needs_browser, red
from logs import STATES, STRING, Row, joint_state, string, write_mcap
import numpy as np
import pytest
from recordings import simulate
from ros_processes import PATIENCE, Process, Processes, call, wait_until
from test_view import SINGLE, visible
from view_models import (
    KINDS,
    WRENCH,
    Nodes,
    described,
    pendulum_end,
    swinging,
    urdf,
    visual,
)

import pfd_core as pfd
from pfd_ros import read_log
from pfd_ros.cli.main import commands_of as pfd_commands_of
from pfd_ros.cli.main import main as pfd_main
from pfd_ros.cli.main import parser as pfd_parser
from pfd_ros.messages.joints import encode_joints
from pfd_ros.messages.values import encode_numbers
from pfd_ros.view.logged import ShownLog
from pfd_ros.view.page import export as export_view

# Logs.

TIP = pfd.load_robot('planar2').tip
JOINTS = ('shoulder', 'elbow')
SKELETON = ('the URDF has no visuals: the arm is drawn as a skeleton',)


def state(
    time: float, names: Iterable[str] = JOINTS, stamp: float | None = None, **values: Any
) -> Row:
    """Return a message on /joint_states, stamped with its log time unless another is given."""
    values = {'position': [0.1 * time] * len(list(names)), **values}
    stamp_ns = round(1e9 * (time if stamp is None else stamp))
    return Row(STATES, time, encode_joints(names, stamp_ns=stamp_ns, **values))


STATES_AT = (0.0, 0.1, 0.2, 0.35, 0.5)


def test_a_log_is_shown_at_its_states_with_the_path_of_its_tip(tmp_path, empty):
    log = ShownLog(swinging(tmp_path / 'bag', STATES_AT, described()))
    assert log.problems == ('the URDF has no visuals: the arm is drawn as a skeleton',)
    show, nodes = log.fill(empty), Nodes(empty)
    node = nodes[f'/arm/link_{log.poses.links.index("end")}']
    for time, q in ((0.0, 0.0), (0.099, 0.0), (0.1, 0.1), (0.34, 0.2), (0.35, 0.35), (9.0, 0.5)):
        show(time)
        np.testing.assert_allclose(node.position, pendulum_end(q).translation, atol=1e-12)
    points = np.concatenate([nodes['/path'].points[:, 0], nodes['/path'].points[-1:, 1]])
    expected = [pendulum_end(q).translation for q in STATES_AT]
    np.testing.assert_allclose(points, expected, atol=SINGLE)


def test_a_recording_shows_its_states_and_the_loads_that_acted(tmp_path, empty):
    path = tmp_path / 'a.mcap'
    body = payload(TIP, 2.0, (0.0, 0.1, 0.0), (0.02, 0.0, 0.0, 0.02, 0.0, 0.02))
    events = {
        1: [efforts(0.5, 0.2)],
        50: [wrench(TIP, (5.0, 0.0, 0.0), (0.0, 0.0, 1.0))],
        100: [body],
        150: [payload(TIP, 0.0)],
        160: [placed(JOINTS, (0.3, -0.2))],
    }
    settings = {'external_wrench': True, 'external_wrench_timeout': 0.03}
    roles = ['external_wrench', 'tip_wrench', 'payload', 'payload_in_use']
    simulate(path, 200, events, roles, **settings)
    found, states = ShownLog(path), read_log(path)['/joint_states']
    assert (found.joints, found.tip, found.problems) == (JOINTS, TIP, SKELETON)
    np.testing.assert_allclose(found.time, states.time - states.time[0], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.position, states.position)
    np.testing.assert_array_equal(found.effort, states.effort)
    show, nodes = found.fill(empty), Nodes(empty)
    acting = {50: '/wrench/force /wrench/torque', 79: '/wrench/force /wrench/torque'}
    acting |= {49: '', 80: '', 99: '', 100: '/payload', 149: '/payload', 150: ''}
    for cycle, names in acting.items():
        # The first state is that of cycle 1.
        show(found.time[cycle - 1])
        assert visible(nodes) == names.split(), cycle
    assert found.wrench[50] == (TIP, (5.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    assert found.payload[120].numbers[:4] == (2.0, 0.0, 0.1, 0.0)


def test_a_ghost_is_shown_at_the_same_stamps_and_another_topic_may_be_one(tmp_path, empty):
    references = [
        Row('/wanted', 0.01 * k, joint_state(['swing'], [1 + k], stamp=100.2 + 0.1 * k))
        for k in range(3)
    ]
    bag = swinging(tmp_path / 'bag', STATES_AT, described(), *references)
    arm, ghost = ShownLog(bag), ShownLog(bag, topic='/wanted')
    assert arm.offset(ghost) == pytest.approx(0.2)
    show, nodes = arm.fill(empty, ghost), Nodes(empty)
    for time, q in ((0.0, 1.0), (0.25, 1.0), (0.35, 2.0), (0.5, 3.0)):
        show(time)
        node = nodes[f'/ghost/link_{ghost.poses.links.index("end")}']
        np.testing.assert_allclose(node.position, pendulum_end(q).translation, atol=1e-12)
    # A log without a model has the model of the arm.
    for name, topic, start, common in (
        ('other', '/wanted', 100.2, True),
        ('late', '/x', 7.0, False),
    ):
        row = Row(topic, 0.0, joint_state(['swing'], [1.0], stamp=start))
        other = ShownLog(write_mcap(tmp_path / name, [row]), other=arm.urdf)
        assert other.joints == ('swing',)
        assert (arm.offset(other) is not None) == common
    with pytest.raises(ValueError, match='no robot_description: name the robot with --robot'):
        ShownLog(tmp_path / 'late')


def test_wrenches_of_another_log_act_from_the_state_that_was_logged_after_them(tmp_path):
    def push(time, newtons, frame=TIP):
        data = encode_numbers(WRENCH, 0, frame, [newtons, 0, 0, 0, 0, 0])
        return Row('/ft/external_wrench', time, data)

    rows = [
        *(state(0.1 * k) for k in range(1, 11)),
        push(0.35, 3.0),
        push(0.75, 0.0),
        push(0.95, 9.0, 'x'),
    ]
    path = write_mcap(tmp_path / 'a.mcap', sorted(rows, key=lambda row: row.at), KINDS)
    for topic in (None, '/ft/external_wrench'):
        found = ShownLog(path, robot='planar2', wrench_topic=topic)
        shown = [value is not None for value in found.wrench]
        assert shown == [3 <= k < 7 for k in range(10)]
        assert found.wrench[3].numbers[:3] == (3.0, 0.0, 0.0)
        assert found.problems[1:] == SKELETON
        assert "its frame 'x' is no link of the model" in found.problems[0]
    with pytest.raises(ValueError, match="topic '/nix' is not in the log, expected geometry"):
        ShownLog(path, robot='planar2', wrench_topic='/nix')
    # What cannot be read is a line, and the rest is shown.
    states, pushes = rows[:10], [row._replace(data=row.data[:20]) for row in rows[10:]]
    path = write_mcap(tmp_path / 'b.mcap', [*states, *pushes], KINDS)
    found = ShownLog(path, robot='planar2')
    assert found.wrench == [None] * 10
    assert "'/ft/external_wrench': 3 of 3 messages cannot be read" in found.unreadable[0]


def test_joints_of_several_publishers_hold_their_values_between_messages(tmp_path):
    rows = []
    for k in range(1, 11):
        rows.append(state(0.1 * k, ['shoulder'], position=[k], effort=[k]))
        rows.append(state(0.1 * k + 0.03, ['elbow', 'finger'], position=[-k, 7.0]))
    found = ShownLog(write_mcap(tmp_path / 'a.mcap', rows), robot='planar2')
    assert found.joints == JOINTS
    assert found.position.tolist()[:4] == [[1, 0], [1, -1], [2, -1], [2, -2]]
    assert found.effort[:3, 0].tolist() == [1, 1, 2]
    assert np.isnan(found.effort[:, 1]).all()
    assert "1 joints of the log are not in the model: ['finger']" in found.problems[0]


def test_states_are_shown_in_the_order_of_their_stamps(tmp_path):
    rows = [state(0.1 * k, stamp=t, position=[t, t]) for k, t in enumerate((1.0, 3.0, 2.0), 1)]
    found = ShownLog(write_mcap(tmp_path / 'a.mcap', rows), robot='planar2')
    assert found.time.tolist() == [0.0, 1.0, 2.0]
    assert found.position[:, 0].tolist() == [1.0, 2.0, 3.0]


def test_joints_with_other_names_are_an_error_and_can_be_renamed(tmp_path):
    names = ['left_shoulder', 'left_elbow']
    path = write_mcap(tmp_path / 'a.mcap', [state(0.1 * k, names) for k in range(1, 11)])
    with pytest.raises(ValueError, match=r"'left_shoulder'.*'shoulder'.*--rename OLD=NEW"):
        ShownLog(path, robot='planar2')
    assert ShownLog(path, robot='planar2', rename={'left_': ''}).joints == JOINTS


LACKING: Mapping[str, tuple[list[Any], str]] = {
    'stamps of zero': ([state(0.1 * k, stamp=0.0) for k in range(1, 11)], 'times are log times'),
    'no positions': ([state(0.1 * k, position=[]) for k in range(1, 11)], 'shown at zero'),
    'a cut message': (
        [state(0.1), Row(STATES, 0.2, state(0.2).data[:30]), state(0.3)],
        "topic '/joint_states': 1 of",
    ),
}


@pytest.mark.parametrize('name', LACKING)
def test_what_a_log_lacks_is_a_line(name, tmp_path):
    rows, words = LACKING[name]
    found = ShownLog(write_mcap(tmp_path / 'a.mcap', rows), robot='planar2')
    assert any(words in line for line in (*found.problems, *found.unreadable))
    assert (np.diff(found.time) > 0.0).all()


@pytest.mark.parametrize('same', [True, False])
def test_of_several_robots_and_joint_states_those_shown_are_named(tmp_path, same):
    models = [urdf(), urdf() if same else urdf(visual('<sphere radius="0.1"/>'))]
    sides = {'/right': models[0], '/left': models[1]}
    rows = [Row(f'{side}/robot_description', 0.0, string(text)) for side, text in sides.items()]
    for side in ('/left', '/right')[: 1 + (not same)]:
        rows += [Row(f'{side}/joint_states', t, joint_state(['swing'], [t])) for t in (1.0, 2.0)]
    kinds = {f'{side}/robot_description': STRING for side in sides}
    found = ShownLog(write_mcap(tmp_path / 'a.mcap', rows, kinds))
    told = [line for line in found.problems if line.startswith('several')]
    assert len(told) == (0 if same else 2)
    assert same or 'shown is the last of /right/robot_description; --robot' in told[0]
    assert same or 'shown is /left/joint_states; --topic' in told[1]
    assert found.urdf.text == models[0]


def test_joint_states_that_cannot_be_read_are_an_error(tmp_path):
    garbage = [Row(STATES, 0.1 * k, b'\0\7\0\0garbage') for k in range(1, 5)]
    for rows, words in (([], 'no messages of .*JointState'), (garbage, '4 of 4 .* cannot be')):
        with pytest.raises(ValueError, match=words):
            ShownLog(write_mcap(tmp_path / f'{len(rows)}.mcap', rows), robot='planar2')


# The command.


@pytest.mark.parametrize(
    ('number', 'browser', 'line'),
    [
        (signal.SIGINT, {'BROWSER': '/nowhere/browser'}, 'no browser was found for --open'),
        pytest.param(signal.SIGTERM, {}, 'no display for --open', marks=pytest.mark.long),
    ],
)
def test_the_command_prints_the_address_without_rclpy_and_ends_by_signals(
    number, browser, line, tmp_path
):
    bag = swinging(tmp_path / 'bag', STATES_AT, described(visual('<sphere radius="0.1"/>')))
    program = (
        'import signal, sys, threading\n'
        # A shell that runs the tests in the background ignores the signal.
        'signal.signal(signal.SIGINT, signal.default_int_handler)\n'
        'from pfd_ros.cli.main import main\n'
        'status = main(sys.argv[1:])\n'
        "print('rclpy' in sys.modules, threading.active_count())\n"
        'raise SystemExit(status)\n'
    )
    displays = ('DISPLAY', 'WAYLAND_DISPLAY', 'BROWSER')
    others = {name: value for name, value in os.environ.items() if name not in displays}
    viewer = subprocess.Popen(
        [sys.executable, '-c', program, 'view', str(bag), '--port=0', '--open'],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**others, 'PATH': '', **browser},
    )
    try:
        assert viewer.stdout is not None
        first, second = viewer.stdout.readline(), viewer.stdout.readline()
        assert re.fullmatch(r'http://127\.0\.0\.1:\d+ shows bag; Ctrl-C ends it\n', first)
        assert second.startswith(f'{line}: open http://127.0.0.1:')
        viewer.send_signal(number)
        assert viewer.communicate(timeout=PATIENCE)[0] == 'False 1\n'
        assert viewer.returncode == 0
    finally:
        viewer.kill()
        viewer.communicate()


@pytest.mark.parametrize(
    ('words', 'domain', 'error'),
    [
        ((), 'many', 'ROS_DOMAIN_ID is not an integral number'),
        (('--topic', 'a b'), '0', "'a b' is not a valid topic name"),
        (('--wrench-topic', 'a//b'), '0', "'a//b' is not a valid topic name"),
        (('--node', 'x y'), '0', "'x y' is not a valid node name"),
        (('--node', '/x y/arm'), '0', "'/x y' is not a valid node namespace"),
    ],
)
def test_an_invalid_domain_or_name_is_one_line(words, domain, error, monkeypatch, capsys):
    monkeypatch.setenv('ROS_DOMAIN_ID', domain)
    assert pfd_main(['view', '--port', '0', *words]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert error in line


@pytest.mark.parametrize('command', ['sim', 'demo'])
@pytest.mark.ros
def test_a_view_that_cannot_start_is_one_line_before_the_arm(
    command, tmp_path, monkeypatch, capsys
):
    def never(*_):
        raise AssertionError('the arm was started')

    monkeypatch.chdir(tmp_path)
    for name in ('pfd_ros.node.main.main', 'pfd_ros.demo.run.ChildProcess'):
        monkeypatch.setattr(name, never)
    monkeypatch.setattr('pfd_ros.view.ports.NEEDED', ('viser_which_nobody_has',))
    words = pfd_commands_of([command])[command], [command, '--view']
    given = pfd_parser({command: words[0]}).parse_args(words[1])
    given.ros_args, given.stop = [], None
    with pytest.raises(ValueError, match=r'viser_which_nobody_has: .* -m pip install '):
        words[0].run(given)
    assert not any(tmp_path.iterdir())


class Viewed:
    """A node with a view, and the processes that belong to it."""

    def __init__(self, processes: Processes, *ros_args: str) -> None:
        self.arm = processes.python(
            *('-m', 'pfd_ros.cli.main', 'sim', '--robot', 'planar2', '--view', '--port', '0'),
            *(['--ros-args', *ros_args] if ros_args else []),
        )
        self.arm.wait_for_text('; Ctrl-C ends it')
        self.arm.wait_for_text('receiving ')
        (self.url,) = re.findall(r'^(http://\S+) shows ', self.arm.text(), re.MULTILINE)
        self.view = child_of(self.arm)

    def wait_for_the_end(self) -> None:
        """Wait until the view is gone, and its port."""
        wait_until(lambda: not Path(f'/proc/{self.view}').exists())
        with socket.socket() as probe:
            assert probe.connect_ex(('127.0.0.1', int(self.url.rpartition(':')[2]))) != 0


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


def test_an_arm_continues_without_its_view_and_logs_it_once(processes):
    viewed = Viewed(processes, '-r', '__ns:=/left')
    assert 'receiving /left/joint_states' in viewed.arm.text()
    with urllib.request.urlopen(viewed.url, timeout=PATIENCE) as answer:
        assert b'<html' in answer.read()
    nicer = min(os.getpriority(os.PRIO_PROCESS, 0) + 10, 19)
    assert os.getpriority(os.PRIO_PROCESS, viewed.view) == nicer
    os.kill(viewed.view, signal.SIGKILL)
    viewed.arm.wait_for_text('the 3D view ended by SIGKILL; the arm continues')
    # It logs once a second.
    sleep(1.5)
    assert viewed.arm.end(signal.SIGINT) == 0
    assert viewed.arm.text().count('the 3D view') == 1
    viewed.wait_for_the_end()


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_the_view_ends_with_the_arm_however_that_ends(processes, number):
    viewed = Viewed(processes)
    status = viewed.arm.end(number)
    assert status == (-number if number is signal.SIGKILL else 0)
    viewed.wait_for_the_end()
    assert 'Traceback' not in viewed.arm.text()
    assert 'the 3D view' not in viewed.arm.text()


# In a browser.

# The arm hangs down for this time [s], and points up as long.
HANGING = 1.0
# Parts of a picture: an arm, and an arrow.
LEAST, ARROW = 0.005, 0.0005
# Swiftshader draws each pixel on a processor.
SIZE = 1200, 750


@pytest.fixture
def pushed(tmp_path: Path) -> ShownLog:
    """Return a log of a magenta pendulum that is pushed while it points up."""
    magenta = '<material name="m"><color rgba="1 0 1 1"/></material>'
    box = visual('<box size="0.1 0.1 0.4"/>', '<origin xyz="0 0 -0.2"/>', magenta)
    rows = [described(box)]
    for k, position in enumerate((0.0, 2.9, 2.9)):
        rows.append(Row(STATES, k + 1, joint_state(['swing'], [position], stamp=k * HANGING)))
        push = encode_numbers(WRENCH, 0, 'end', [9.0 if k == 1 else 0.0, 0, 0, 0, 0, 0])
        rows.append(Row('/external_wrench', k + 1, push))
    log = write_mcap(tmp_path / 'log.mcap', rows, KINDS)
    return ShownLog(log, wrench_topic='/external_wrench')


def arm_of(pixels: np.ndarray) -> np.ndarray:
    """Return where a picture is magenta, lit or in the shade."""
    red, green, blue = np.moveaxis(pixels.astype(int), 2, 0)
    return (np.minimum(red, blue) - green > 60) & (np.abs(red - blue) < 60)


@pytest.mark.slow
@needs_browser
def test_the_exported_page_plays_from_disk_without_network(pushed, tmp_path, browser):
    target = tmp_path / 'arm.html'
    export_view(target, float(pushed.time[-1]), pushed.fill)
    assert not re.findall(r'(?:src|href)="(?:https?:)?//', target.read_text(encoding='utf-8'))
    hanging: list[np.ndarray] = []
    up: list[np.ndarray] = []

    def played() -> bool:
        """Return whether the arm was seen at two places, with its push and without."""
        pixels = shown.pixels()
        arm = arm_of(pixels)
        if arm.mean() > LEAST:
            (up if red(pixels) > ARROW else hanging).append(arm)
        return any((low ^ high).mean() > LEAST for low in hanging for high in up)

    with browser.shows(target.as_uri(), SIZE) as shown:
        # It plays by itself, from its start and again and again.
        wait_until(played, lambda: f'{len(hanging)}, {len(up)}; {shown.console}', pause=0.2)


@pytest.mark.long
@needs_browser
def test_the_page_of_a_running_arm_shows_a_force_until_it_is_cleared(processes, peer_of, browser):
    from geometry_msgs.msg import WrenchStamped
    from std_srvs.srv import Trigger

    arm = processes.python(
        *('-m', 'pfd_ros.cli.main', 'sim', '--robot', 'ur5', '--view', '--port', '0'),
        *('--ros-args', '-p', 'external_wrench:=true', '-p', 'outputs:=[tip_wrench]'),
    )
    arm.wait_for_text('receiving /joint_states')
    (url,) = re.findall(r'^(http://\S+) shows ', arm.text(), re.MULTILINE)
    peer = peer_of(processes)
    with browser.shows(url, SIZE) as shown:
        wait_until(lambda: '1 m = ' in (shown.value('document.body.innerText') or ''))
        assert red(shown.pixels()) < ARROW
        message = WrenchStamped()
        message.header.frame_id = 'tool0'
        message.wrench.force.z = 60.0
        peer.send('/sim_arm/external_wrench', message)
        wait_until(lambda: red(shown.pixels()) > ARROW)
        assert call(peer, Trigger, 'clear_external_wrench').success
        wait_until(lambda: red(shown.pixels()) < ARROW)
    assert arm.end(signal.SIGINT) == 0
