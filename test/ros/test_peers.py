# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tests outlive the processes they talk to, however those end: ours, and those of a user."""

from __future__ import annotations

from pathlib import Path
import sys

import pytest
from ros_processes import Processes
from waiting import wait_until

from pfd_ros.testing import ControllerProcess
from pfd_ros.testing.domains import LOOPBACK as DDS_LOOPBACK
from pfd_ros.testing.domains import claimed_domain
from pfd_ros.testing.domains import environment_to_kill as domain_environment_to_kill


def shared() -> set[str]:
    """Return the files of Fast DDS's shared memory that this process has mapped."""
    lines = Path('/proc/self/maps').read_text(encoding='utf-8').splitlines()
    return {line.split()[-1] for line in lines if '/dev/shm/fast' in line}


@pytest.mark.ros
def test_a_peer_shares_no_memory_with_a_process_that_may_be_killed(
    processes: Processes, peer_of
) -> None:
    before = shared()
    processes.arm('-p', 'robot:=planar2')
    peer_of(processes).connect()
    assert shared() <= before


CONTROLLER = """
from pathlib import Path
import rclpy
rclpy.init()
rclpy.create_node('controller')
print('shares memory:', '/dev/shm/fast' in Path('/proc/self/maps').read_text())
"""


@pytest.mark.ros
def test_a_controller_process_that_may_be_killed_shares_no_memory() -> None:
    with claimed_domain(), ControllerProcess([sys.executable, '-c', CONTROLLER]) as controller:
        wait_until(controller.end, controller.text, pause=0.05)
        assert controller.end() == 'ended with status 0', controller.text()
        assert 'shares memory: False' in controller.text()


HERE = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'PATH': '/bin'}


@pytest.mark.parametrize('rmw', [{}, {'RMW_IMPLEMENTATION': 'rmw_fastrtps_cpp'}])
def test_a_process_to_kill_gets_the_profile_and_keeps_its_other_variables(
    rmw: dict[str, str],
) -> None:
    assert domain_environment_to_kill(HERE | rmw) == HERE | rmw | DDS_LOOPBACK
    assert Path(DDS_LOOPBACK['FASTRTPS_DEFAULT_PROFILES_FILE']).is_file()


@pytest.mark.parametrize(
    'chosen',
    [
        {'FASTDDS_DEFAULT_PROFILES_FILE': 'mine.xml'},
        {'FASTRTPS_DEFAULT_PROFILES_FILE': 'mine.xml'},
        {'RMW_IMPLEMENTATION': 'rmw_cyclonedds_cpp'},
        {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'},
    ],
    ids=str,
)
def test_a_profile_a_middleware_or_a_range_of_the_user_stays(chosen: dict[str, str]) -> None:
    assert domain_environment_to_kill(HERE | chosen) == HERE | chosen
