# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd demo`: its motion and disturbances, what it writes, and that it disturbs nobody."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
import re
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

from arm_messages import efforts as commanded
from arm_messages import made, wrench
import numpy as np
import pytest
from ros_processes import PATIENCE, environment
from sampling import one_fast

import pfd_core as pfd
from pfd_ros import read_log
from pfd_ros.demo import run, scenario
from pfd_ros.messages.joints import decode_joints
from pfd_ros.replay.verify import verify as verify_log

# Friction, payload and push move a joint off its motion by some hundredths of a radian.
VISIBLE, LIMIT = 1e-3, 0.1


@pytest.mark.parametrize('name', pfd.known_robots())
@pytest.mark.parametrize('seconds', [0.5, 5.0, 20.0])
def test_the_motion_starts_and_ends_at_rest_and_stays_within_the_limits(
    seconds: float, name: str
) -> None:
    robot = pfd.load_robot(name)
    motion = scenario.motion_of(robot, seconds)
    for t in (0.0, seconds, 2 * seconds):
        # The sine of multiples of pi is rounded, below 1e-13 for tens of them.
        q, qd, qdd = motion.at(t)
        np.testing.assert_allclose(q, motion.start, rtol=0, atol=1e-15)
        np.testing.assert_allclose(qd, 0.0, rtol=0, atol=1e-15)
        np.testing.assert_allclose(qdd, 0.0, rtol=0, atol=1e-11)
    q = motion.at(np.linspace(0, seconds, 20001))[0]
    assert (q >= robot.position_lower).all()
    assert (q <= robot.position_upper).all()
    assert (np.ptp(q, axis=0) > 0).all()


def test_the_motion_has_the_derivatives_it_states() -> None:
    motion, step = scenario.motion_of(pfd.load_robot('puma560'), 5.0), 1e-5
    t = np.linspace(0.1, 4.9, 50)
    (q0, v0, _), (_, v, a), (q1, v1, _) = (motion.at(t + k * step) for k in (-1, 0, 1))
    # Differences err by step^2 / 6 times a derivative of third or fourth order, below 1000 here.
    for low, high, rate in ((q0, q1, v), (v0, v1, a)):
        np.testing.assert_allclose((high - low) / (2 * step), rate, rtol=0, atol=step**2 / 6e-3)


@pytest.mark.parametrize('name', one_fast(pfd.known_robots(), 'planar2'))
def test_the_disturbances_are_visible_and_the_controller_rejects_them(name: str) -> None:
    robot, seconds, push = pfd.load_robot(name), 2.0, 0.5
    motion = scenario.motion_of(robot, seconds)
    parameters = scenario.parameters(robot, seconds)
    settings = {key.replace('.', '_'): value for key, value in parameters.items()}
    settings = {k: tuple(v) if isinstance(v, list) else v for k, v in settings.items()}
    engine = made(robot=name, **{**settings, 'outputs': ()})
    cycles = round(seconds / 1e-3)
    off, messages = np.zeros(cycles), [commanded(*np.zeros(robot.n))]
    for k in range(cycles):
        (data,) = (m.data for m in engine.step(messages)[0] if m.role == 'joint_states')
        state, t = decode_joints(data), (k + 1) * 1e-3
        q, qd = np.array(state.position), np.array(state.velocity)
        off[k] = np.abs(q - motion.at(t)[0]).max()
        messages = [commanded(*scenario.efforts(robot, motion, t, q, qd))]
        if k == round(push * cycles):
            messages.append(wrench(robot.tip, scenario.push_force(robot)))
    before, after = off[: round(push * cycles)], off[round(push * cycles) :]
    assert VISIBLE < before.max() < LIMIT
    assert VISIBLE < after.max() < LIMIT


@pytest.mark.parametrize(
    ('periods', 'slow'),
    [(50 * [0.5, 1.5], False), (100 * [1.005], False), (99 * [1.0] + [10.0], True)],
)
def test_a_rate_below_the_one_of_the_stamps_is_a_machine_that_is_too_slow(
    periods: list[float], slow: bool, capsys
) -> None:
    # States at 1 kHz, by the times [ms] between their messages.
    stamps = np.arange(len(periods) + 1) * 1_000_000
    times = np.cumsum([0, *(round(1e6 * period) for period in periods)])
    log = {'/states': SimpleNamespace(stamp_ns=stamps, log_ns=times)}
    assert run._rate(log, '/states') == slow
    printed = capsys.readouterr().out
    assert 'of 1000 Hz' in printed
    assert ('this machine is too slow' in printed) == slow


@pytest.mark.ros
def test_even_on_one_domain_two_demos_are_apart(tmp_path, monkeypatch) -> None:
    # A domain that looked free to both: their names and clocks still differ.
    started: list[list[str]] = []
    monkeypatch.setattr(
        'pfd_ros.demo.run.ChildProcess', lambda command, *_: started.append(command)
    )
    for _ in range(2):
        with suppress(AttributeError):
            run.run_demo('planar2', 1.0, tmp_path)
    names = [[part for part in command if part.startswith('__ns:=')] for command in started]
    assert len(names) >= 2
    assert all(len(name) == 1 for name in names)
    assert len({name[0] for name in names}) == 2
    assert all('/clock:=clock' in command for command in started)


# Variables that lead to other systems.
HOSTILE = {
    'ROS_LOCALHOST_ONLY': '0',
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET',
    'ROS_STATIC_PEERS': '127.0.0.1;192.0.2.1',
    'ROS_DISCOVERY_SERVER': '127.0.0.1:11811',
    'ROS_SUPER_CLIENT': 'TRUE',
    'ROS_SECURITY_ENABLE': 'true',
    'ROS_SECURITY_STRATEGY': 'Enforce',
    'FASTRTPS_DEFAULT_PROFILES_FILE': '/nowhere/profiles.xml',
    'FASTDDS_DEFAULT_PROFILES_FILE': '/nowhere/profiles.xml',
    'RMW_FASTRTPS_USE_QOS_FROM_XML': '1',
    'CYCLONEDDS_URI': '<CycloneDDS/>',
    'ZENOH_ROUTER_CONFIG_URI': '/nowhere',
}


def start_demo(folder: Path, domain: int) -> subprocess.Popen[str]:
    command = ['-m', 'pfd_ros.cli.main', 'demo', '--seconds', '1', '--out', 'here']
    return subprocess.Popen(
        [sys.executable, *command],
        cwd=folder,
        env=environment(domain) | HOSTILE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def check_demo(folder: Path, process: subprocess.Popen[str]) -> str:
    printed = process.communicate(timeout=3 * PATIENCE)[0]
    # On a busy machine commands may be lost, periods missed and the motion left, and nothing else.
    failures = re.findall('FAILED: (.*)', printed)
    assert all(failure.startswith('the arm was') for failure in failures), printed
    assert process.returncode == (1 if failures else 0), printed
    base = folder / 'here' / 'arm_0'
    assert re.search(r'replay +\d+ cycles simulated again: every bit equal', printed)
    assert re.search(r'rate +[\d.]+ Hz of 1000 Hz', printed)
    assert re.search(r'^ +[\d.]+ s: 1 s of motion, at rest before and after it$', printed, re.M)
    assert '<html' in base.with_suffix('.html').read_text(encoding='utf-8')
    assert verify_log(base.with_suffix('.mcap')).complete
    # The terminal and the page have one line on each joint.
    lines = re.findall(r'^(?:tracking)? +(joint\d: .*)$', printed, re.MULTILINE)
    shown = base.with_suffix('.html').read_text(encoding='utf-8')
    assert lines == re.findall('<li>(joint.*?)</li>', shown)
    assert len(lines) == 6
    if not failures:
        assert all(' rad, farthest at t = ' in line for line in lines)
        assert re.search('^page +here/arm_0.html: nothing went wrong', printed, re.MULTILINE)
        assert printed.endswith('everything worked\n')
    return printed


@pytest.mark.slow
@pytest.mark.ros
def test_the_demo_verifies_itself_and_sends_nothing_to_a_live_arm(
    processes, peer_of, tmp_path
) -> None:
    from sensor_msgs.msg import JointState

    (tmp_path / 'DEFAULT_FASTRTPS_PROFILES.xml').write_text('<no profile')
    # An arm on the domain, and by the names, that the demo's environment would lead to.
    peer = peer_of(processes)
    commands: list[Any] = []
    seen: set[str] = set()
    peer.node.create_subscription(JointState, '/joint_commands', commands.append, 10)
    process = start_demo(tmp_path, processes.domain)
    try:
        while process.poll() is None:
            peer.executor.spin_once(timeout_sec=0.05)
            seen |= set(peer.node.get_node_names())
        check_demo(tmp_path, process)
    finally:
        process.kill()
    assert commands == peer.states == peer.clocks == []
    assert seen == {'peer'}
    printed = (tmp_path / 'here' / 'arm_0.sim_arm.txt').read_text()
    assert re.search(r'subscribed to /pfd_demo_[0-9a-f]{8}/joint_commands', printed)
    log = read_log(tmp_path / 'here' / 'arm_0.mcap')
    assert all(
        topic.startswith('/pfd_demo_') for topic, role in log.roles.items() if role == 'clock'
    )


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.long
def test_the_demo_shows_the_arm_while_it_runs(tmp_path, monkeypatch, capsys) -> None:
    # Nobody opens the page.
    monkeypatch.setattr('pfd_ros.demo.run.PAGE_SECONDS', 0.5)
    assert run.run_demo('planar2', 1.0, tmp_path, 0) == 0, capsys.readouterr()
    printed = capsys.readouterr().out
    assert re.search(
        r'^view +http://127\.0\.0\.1:\d+: the arm starts when a browser', printed, re.MULTILINE
    )
    seen = (tmp_path / 'arm_0.view.txt').read_text()
    assert re.search(r'^receiving /pfd_demo_[0-9a-f]{8}/joint_states$', seen, re.MULTILINE)
    assert 'Traceback' not in seen
