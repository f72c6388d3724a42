# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Servo, watchdog and reflex of a real node: set by parameters, and logged."""

from __future__ import annotations

from bridge import read_recording
import numpy as np
import pytest
from ros_processes import JOINTS, Processes

pytestmark = pytest.mark.ros


@pytest.mark.slow
def test_a_servo_holds_after_the_last_command_and_a_reflex_is_logged(
    processes: Processes, peer_of
) -> None:
    gains = [
        ('-p', f'servo_{kind}.{joint}:={gain}')
        for joint in JOINTS
        for kind, gain in (('p', '500.0'), ('d', '50.0'))
    ]
    arm = processes.arm(
        *(part for pair in gains for part in pair),
        *('-p', 'armature:=true', '-p', 'torque_speed:=true', '-p', 'recording:=arm.mcap'),
        *('-p', 'command_timeout:=0.2', '-p', 'on_timeout:=hold'),
        *('-p', 'reflex_effort_rate:=50000.0'),
    )
    peer = peer_of(processes)
    peer.connect()
    target = np.full(6, 0.1)
    peer.command(JOINTS, [], position=target.tolist())
    peer.let_pass(100)
    assert np.any(peer.states[-1].effort)
    # It names the parameter of the stock hardware that is silent while nothing changes.
    arm.wait_for_text('no command for 0.2 s (command_timeout): servos hold the position; ')
    arm.wait_for_text('trigger_joint_command_threshold')
    peer.let_pass(1500)
    held = np.array(peer.states[-1].position)
    assert np.abs(peer.states[-1].velocity).max() < 1e-3
    peer.let_pass(200)
    np.testing.assert_allclose(peer.states[-1].position, held, atol=1e-4)
    # 180 N m from one step to the next, where 50 are allowed.
    peer.command(JOINTS, [0.0, -180.0, 0.0, 0.0, 0.0, 0.0])
    arm.wait_for_text("protective stop, all joints braked: the effort of 'joint2' changed by")
    peer.let_pass()
    assert not np.any(peer.states[-1].effort)
    assert not np.any(peer.states[-1].velocity)
    arm.stop()
    assert read_recording(processes.folder / 'arm.mcap', verify=True).complete
