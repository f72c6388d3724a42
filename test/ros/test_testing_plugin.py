# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pytest plugin in separate sessions: what it imports, its domains, its errors."""

from __future__ import annotations

from contextlib import ExitStack
import os
from pathlib import Path
import shutil
import socket
import subprocess
import sys

from bridge import DDS_PARTICIPANT_PORT, DDS_PORT_BASE, DDS_PORT_GAIN, claimed_domain, own_domain
from plugin_sessions import forked_session, session
import pytest
from ros_processes import ROOT


@pytest.fixture(scope='module')
def output(site: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return what a session prints whose tests run in this order, the last of which fails."""
    code = """
import sys
def test_modules(pytestconfig):
    assert pytestconfig.pluginmanager.hasplugin('pfd_ros')
    for name in ('rclpy', 'pfd_core', 'numpy', 'pfd_ros.arm', 'pfd_ros.messages'):
        assert name not in sys.modules, name

def test_hold(sim_arm):
    arm = sim_arm(robot='planar2', gravity=[0.0, 0.0, 0.0])
    assert not arm.run(lambda t, q, qd: 0 * q, 0.01).q.any()
    assert 'rclpy' not in sys.modules

def test_falls(sim_arm):
    arm = sim_arm(robot='planar2')
    arm.run(lambda t, q, qd: 0 * q, 0.5).assert_settles(0.0, within=0.01, by=0.4)
"""
    return session(site, tmp_path_factory.mktemp('session'), code, ['-rA'], status=1)


def test_a_session_that_does_not_use_the_plugin_imports_neither_ros_nor_the_library(
    output: str,
) -> None:
    assert 'PASSED test_it.py::test_modules' in output


def test_a_callback_needs_no_ros(output: str) -> None:
    assert 'PASSED test_it.py::test_hold' in output


def test_a_failed_assertion_shows_the_line_of_the_test_and_none_of_the_helper(output: str) -> None:
    assert "AssertionError: joint 'shoulder' is" in output
    assert 'test_it.py:15: AssertionError' in output
    assert 'trajectory.py' not in output


@pytest.mark.ros
def test_rclpy_is_initialised_for_a_test_and_shut_down_after_it(
    site: Path, tmp_path: Path
) -> None:
    code = """
import os
import rclpy
from rclpy.node import Node

def test_own(ros_domain):
    assert rclpy.ok()
    assert os.environ['ROS_DOMAIN_ID'] == str(ros_domain)
    Node('one').destroy_node()

def test_none():
    assert not rclpy.ok()
    # A test may do it all by itself.
    rclpy.init(domain_id=5)
    Node('two').destroy_node()

def test_that_of_the_user(ros_domain):
    assert ros_domain == 5

def test_left_alone():
    assert rclpy.ok()
    rclpy.shutdown()
"""
    assert '4 passed' in forked_session(site, tmp_path, code)


@pytest.mark.ros
@pytest.mark.slow
def test_workers_have_separate_domains(site: Path, tmp_path: Path) -> None:
    code = """
import pathlib, time
import pytest

@pytest.mark.parametrize('number', range(2))
def test_domain(ros_domain, number, worker_id):
    here = pathlib.Path(__file__).parent
    (here / f'{worker_id}.txt').write_text(str(ros_domain))
    for _ in range(1000):
        found = list(here.glob('gw*.txt'))
        if len(found) == 2 and all(path.read_text() for path in found):
            break
        time.sleep(0.02)
    assert len({path.read_text() for path in found}) == 2
"""
    assert '2 passed' in forked_session(site, tmp_path, code, ['-n', '2', '-p', 'xdist'])


def test_a_claimed_domain_leads_to_no_other_system_and_leaves_the_environment_as_it_was(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hostile = {'ROS_DISCOVERY_SERVER': 'x', 'ROS_STATIC_PEERS': 'x', 'FASTDDS_STATISTICS': 'x'}
    for name, value in {**hostile, 'ROS_DOMAIN_ID': '7', 'ROS_LOG_DIR': 'logs'}.items():
        monkeypatch.setenv(name, value)
    before = dict(os.environ)
    with claimed_domain() as domain:
        assert os.environ['ROS_DOMAIN_ID'] == str(domain)
        assert os.environ['ROS_LOG_DIR'] == 'logs'
        assert hostile.keys().isdisjoint(os.environ)
        monkeypatch.setenv('ANOTHER', 'set meanwhile')
    assert dict(os.environ) == before | {'ANOTHER': 'set meanwhile'}


def test_a_claimed_domain_is_passed_over_and_free_again_after_its_process(tmp_path: Path) -> None:
    with own_domain(tmp_path) as one, own_domain(tmp_path) as other:
        assert one != other
        assert 1 <= min(one, other) <= max(one, other) <= 101
    with own_domain(tmp_path) as again:
        assert again == one
    # A process that is killed keeps no lock.
    code = (
        'import os, sys, pathlib; from bridge import own_domain\n'
        f'claim = own_domain(pathlib.Path({str(tmp_path)!r})); claim.__enter__(); os._exit(1)'
    )
    subprocess.run([sys.executable, '-c', code], check=False, timeout=60, cwd=ROOT)
    with ExitStack() as claims:
        found: list[int] = []

        def claim_all() -> None:
            while True:
                found.append(claims.enter_context(own_domain(tmp_path)))

        # Participants of others may be in some.
        with pytest.raises(OSError, match='all ROS domains from 1 to 101 are taken'):
            claim_all()
    assert len(set(found)) == len(found) > 50


def test_a_domain_in_which_a_participant_runs_is_passed_over(tmp_path: Path) -> None:
    with own_domain(tmp_path) as first:
        pass
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(('', DDS_PORT_BASE + DDS_PORT_GAIN * first + DDS_PARTICIPANT_PORT))
        with own_domain(tmp_path) as found:
            assert found != first


def test_lock_files_that_cannot_be_opened_are_passed_over(tmp_path: Path) -> None:
    with own_domain(tmp_path) as first:
        pass
    path = tmp_path / f'pfd_ros_domain_{first}.lock'
    path.unlink()
    path.symlink_to(tmp_path / 'elsewhere')
    with own_domain(tmp_path) as found:
        assert found != first
    assert not (tmp_path / 'elsewhere').exists()
    shutil.rmtree(tmp_path)
    with pytest.raises(OSError, match='taken'), own_domain(tmp_path):
        pass
