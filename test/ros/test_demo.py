# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd demo` and the motion it follows."""

from __future__ import annotations

from array import array
from contextlib import ExitStack, suppress
from pathlib import Path
import re
import subprocess
import sys
import tempfile
from typing import Any

import numpy as np
import pytest
from ros_processes import HAS_ROS, Processes, environment
from sampling import one_fast
from waiting import PATIENCE

import pfd_core as pfd
from pfd_ros.cli.main import main
from pfd_ros.demo import processes as demo
from pfd_ros.demo.bare_timer import missing_share
from pfd_ros.demo.results import TRACKING_LIMIT, unless_busy
from pfd_ros.demo.scenario import PUSH_BEGIN, disturbances, efforts, motion_of, push_force
from pfd_ros.replay.verify import read
from pfd_ros.testing.domains import FIRST, LAST, own_domain
from pfd_ros.testing.lockstep_arm import LockstepArm

if HAS_ROS:
    from sensor_msgs.msg import JointState

# Central differences with step h err by h^2 / 6 times a derivative of third or fourth order,
# which stays below 1000 for this motion; rounding over h is a hundred times less.
STEP = 1e-5
DIFFERENCE_TOLERANCE = STEP**2 / 6 * 1000


@pytest.mark.parametrize('name', pfd.known_robots())
def test_the_motion_starts_at_rest_and_stays_within_the_limits(name: str) -> None:
    robot = pfd.load_robot(name)
    motion = motion_of(robot)
    q, qd, qdd = motion.at(0.0)
    np.testing.assert_array_equal(q, motion.start)
    assert not qd.any()
    assert not qdd.any()
    q = motion.at(np.linspace(0, 20, 20001))[0]
    assert (q >= robot.position_lower).all()
    assert (q <= robot.position_upper).all()
    assert (np.ptp(q, axis=0) > 0).all()


def test_the_motion_has_the_derivatives_it_states() -> None:
    motion = motion_of(pfd.load_robot('puma560'))
    t = np.linspace(0.1, 5, 50)
    (q0, v0, _), (_, v, a), (q1, v1, _) = (motion.at(t + k * STEP) for k in (-1, 0, 1))
    np.testing.assert_allclose((q1 - q0) / (2 * STEP), v, rtol=0, atol=DIFFERENCE_TOLERANCE)
    np.testing.assert_allclose((v1 - v0) / (2 * STEP), a, rtol=0, atol=DIFFERENCE_TOLERANCE)


# Friction, payload and push move a joint off its motion by some hundredths of a radian.
VISIBLE = 1e-3


@pytest.mark.parametrize('name', one_fast(pfd.known_robots(), 'planar2'))
def test_the_disturbances_are_visible_and_the_controller_rejects_them(name: str) -> None:
    robot, seconds = pfd.load_robot(name), 2.0
    motion = motion_of(robot)
    settings = disturbances(robot, seconds)
    with LockstepArm(robot=name, initial_positions=motion.start.tolist(), **settings) as arm:

        def control(t: float, q: Any, qd: Any) -> Any:
            return efforts(robot, motion, t, q, qd)

        before = arm.run(control, PUSH_BEGIN * seconds)
        arm.push(push_force(robot), (0.0, 0.0, 0.0))
        after = arm.run(control, (1.0 - PUSH_BEGIN) * seconds)
    off = [np.abs(part.q - motion.at(part.time)[0]).max() for part in (before, after)]
    assert min(off) > VISIBLE
    assert max(off) < TRACKING_LIMIT


def test_a_run_is_recorded_under_a_new_name(tmp_path: Path) -> None:
    assert demo.free_name(tmp_path) == tmp_path / 'arm_0'
    (tmp_path / 'arm_0.mcap').touch()
    assert demo.free_name(tmp_path) == tmp_path / 'arm_1'


@pytest.mark.parametrize('seconds', [0.0, -1.0, float('nan'), float('inf')])
def test_an_invalid_duration_is_refused(tmp_path: Path, seconds: float) -> None:
    with pytest.raises(ValueError, match='--seconds is'):
        demo.run_demo('puma560', seconds, tmp_path)


def test_an_unknown_robot_is_named_before_anything_starts(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match='r2d2'):
        demo.run_demo('r2d2', 1.0, tmp_path / 'out')
    assert not (tmp_path / 'out').exists()


LATE = ['the rate is 45.9% off', 'the arm was 0.401 off its motion, expected 0.1 at most']


def test_late_messages_where_a_bare_timer_is_late_too_are_a_remark_and_no_failure() -> None:
    remarks, problems = unless_busy(LATE, 0.2)
    lost = 'a bare timer loop lost 20.0% of its periods at the same time'
    assert remarks == [f'{item}, but this machine is too busy: {lost}' for item in LATE]
    assert problems == []


def test_late_messages_where_a_bare_timer_keeps_its_periods_are_a_failure() -> None:
    remarks, problems = unless_busy(LATE, 0.004)
    lost = 'a bare timer loop lost 0.4% of its periods at the same time'
    assert remarks == []
    assert problems == [f'{item}; {lost}' for item in LATE]


def test_the_periods_that_a_bare_timer_lost_are_those_between_two_times() -> None:
    # Each millisecond for half a second, then each other one.
    woke = array('q', [*range(0, 500_000_000, 10**6), *range(500_000_000, 10**9, 2 * 10**6)])
    assert missing_share(woke, 0, 10**9, 0.001) == pytest.approx(0.25)
    assert missing_share(woke, 100_000_000, 399_999_999, 0.001) == pytest.approx(0.0)
    assert missing_share(woke, 600_000_000, 799_999_999, 0.001) == pytest.approx(0.5)
    assert missing_share(array('q'), 0, 10**9, 0.001) == 1.0
    assert missing_share(array('q'), 5, 5, 0.001) == 0.0


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


def test_a_domain_to_avoid_is_not_claimed(tmp_path: Path) -> None:
    for start in range(FIRST, LAST + 1):
        with own_domain(tmp_path, start=start, avoided='7') as domain:
            assert domain != 7
    with own_domain(tmp_path, start=3, avoided='{') as domain:
        assert FIRST <= domain <= LAST


@pytest.mark.ros
def test_without_a_free_domain_the_demo_ends_with_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    with ExitStack() as claims:
        with suppress(OSError):
            while True:
                claims.enter_context(own_domain(start=0))
        assert main(['demo', '--out', str(tmp_path)]) == 1
    printed = capsys.readouterr().err
    assert printed.count('\n') == 1
    assert 'all ROS domains from 1 to 101 are taken' in printed


@pytest.mark.ros
def test_a_domain_with_a_node_on_it_is_not_claimed(processes: Processes, tmp_path: Path) -> None:
    # In a separate process: participants are numbered by process, and their ports by number.
    processes.arm('-p', 'robot:=planar2')
    with own_domain(tmp_path, start=processes.domain - FIRST) as domain:
        assert domain != processes.domain


def start_demo(folder: Path, domain: int) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, '-m', 'pfd_ros.cli.main', 'demo', '--seconds', '1', '--out', 'here'],
        cwd=folder,
        env=environment(domain) | HOSTILE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def check_demo(folder: Path, process: subprocess.Popen[str]) -> str:
    printed = process.communicate(timeout=3 * PATIENCE)[0]
    # A busy machine may miss the rate, and where commands are lost the tracking, and nothing else.
    failures = re.findall('FAILED: (.*)', printed)
    late = ('the rate is',) if ', lost 0\n' in printed else ('the rate is', 'the arm was')
    assert all(failure.startswith(late) for failure in failures), printed
    assert process.returncode == (1 if failures else 0), printed
    assert re.search(r'replay +\d+ states, \d+ steps: every bit equal', printed)
    assert re.search(r'commands +sent \d+, recorded \d+, lost \d+', printed)
    assert failures or 'pfd report log here/arm_0.mcap; pfd view here/arm_0.mcap\n' in printed
    assert re.search(r'joint6 +\d\.\d+e-\d+ +\d\.\d+e-\d+', printed)
    assert (folder / 'here' / 'arm_0.png').read_bytes().startswith(b'\x89PNG')
    assert read(folder / 'here' / 'arm_0.mcap', verify=True).complete
    return printed


@pytest.mark.slow
@pytest.mark.ros
def test_the_demo_verifies_itself_and_sends_nothing_to_a_live_arm(
    processes: Processes, peer_of, tmp_path: Path
) -> None:
    (tmp_path / 'DEFAULT_FASTRTPS_PROFILES.xml').write_text('<no profile')
    # An arm on the domain, and by the names, that the demo's environment would lead to.
    peer = peer_of(processes)
    commands, seen = [], set()
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
    assert re.search(r'/pfd_demo_[0-9a-f]{8}/clock \(', printed)


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.long
def test_demos_side_by_side_do_not_disturb_each_other(tmp_path: Path) -> None:
    folders = [tmp_path / str(k) for k in range(3)]
    for folder in folders:
        folder.mkdir()
    running = [start_demo(folder, 1) for folder in folders]
    try:
        for folder, process in zip(folders, running, strict=True):
            check_demo(folder, process)
    finally:
        for process in running:
            process.kill()


@pytest.mark.ros
def test_even_on_one_domain_two_demos_are_apart(tmp_path: Path, monkeypatch) -> None:
    # A domain that looked free to both: their names and clocks still differ.
    started = []
    monkeypatch.setattr(demo, 'ChildProcess', lambda command, *_: started.append(command))
    for _ in range(2):
        with suppress(AttributeError):
            demo.run_demo('planar2', 1.0, tmp_path)
    names = [[part for part in command if part.startswith('__ns:=')] for command in started]
    assert all(len(name) == 1 for name in names)
    assert len({name[0] for name in names}) == 2
    assert all('/clock:=clock' in command for command in started)
