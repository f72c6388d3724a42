# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The end of any thread is noticed: the node says so, closes its file and exits with 1."""

from __future__ import annotations

import signal

from bridge import read_recording
import pytest
from ros_processes import JOINTS, Processes
from waiting import PATIENCE

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ('fault', 'text'),
    [
        ('executor_returns', 'the executor ended unexpectedly'),
        ('executor_fails', 'the executor failed: RuntimeError: 3 callbacks failed'),
        ('executor_exits', 'the executor failed: SystemExit: 0'),
        ('stepping_fails', "stepping failed: KeyError: '{0}'"),
        ('reporting_fails', "reporting failed: KeyError: '{}'"),
    ],
)
@pytest.mark.slow
def test_a_thread_that_ends_ends_the_node_with_a_closed_file(
    processes: Processes, fault: str, text: str
) -> None:
    arm = processes.faulty(fault, '-p', 'recording:=arm.mcap', ready=False)
    assert arm.process.wait(PATIENCE) == 1, arm.text()
    assert text in arm.text()
    assert read_recording(processes.folder / 'arm.mcap', verify=True).complete


@pytest.mark.slow
def test_a_step_that_never_ends_is_logged_and_the_file_is_closed(processes: Processes) -> None:
    arm = processes.faulty('stepping_hangs', '-p', 'recording:=arm.mcap')
    arm.wait_for_text('hangs')
    assert arm.end(signal.SIGINT) == 1
    assert 'stepping did not end within 1 s' in arm.text()
    assert read_recording(processes.folder / 'arm.mcap', verify=True).complete


def test_a_callback_that_fails_is_counted_and_the_arm_still_receives(
    processes: Processes, peer_of
) -> None:
    from std_srvs.srv import Trigger

    arm = processes.faulty('requests_fail')
    peer = peer_of(processes)
    peer.connect()
    client = peer.node.create_client(Trigger, '/sim_arm/reset')
    peer.wait(client.service_is_ready)
    for _ in range(3):
        client.call_async(Trigger.Request())
    arm.wait_for_text('callbacks failed, most recently by KeyError')
    peer.command(JOINTS, [1.0] * 6)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [1.0] * 6)
    arm.stop()
