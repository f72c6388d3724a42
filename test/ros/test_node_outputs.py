# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A real node with sensors and with all outputs: the topics, their readers, the recording."""

from __future__ import annotations

from typing import Any

from bridge import (
    ARM_OUTPUTS,
    FLOAT_ARRAY_TYPE,
    JOINT_STATE_TYPE,
    POSE_TYPE,
    WRENCH_TYPE,
    read_recording,
)
import pytest
from ros_processes import JOINTS, Processes, stamp_ns

pytestmark = pytest.mark.ros


@pytest.mark.slow
def test_readers_get_every_output_and_the_recording_verifies(
    processes: Processes, peer_of
) -> None:
    from geometry_msgs.msg import PoseStamped, WrenchStamped
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    types = {
        JOINT_STATE_TYPE: JointState,
        FLOAT_ARRAY_TYPE: Float64MultiArray,
        POSE_TYPE: PoseStamped,
        WRENCH_TYPE: WrenchStamped,
    }
    chosen = {
        'outputs': f'[{", ".join(ARM_OUTPUTS)}]',
        'noise.position': '0.001',
        f'bias.position.{JOINTS[0]}': '0.5',
        'drop.state': '0.25',
        'seed': '7',
        'publish_rate': '200.0',
        'recording': 'arm.mcap',
    }
    given = [part for name, value in chosen.items() for part in ('-p', f'{name}:={value}')]
    arm = processes.arm(*given)
    peer = peer_of(processes)
    got: dict[str, list[Any]] = {name: [] for name in ARM_OUTPUTS}
    for name, kind in ARM_OUTPUTS.items():
        peer.node.create_subscription(types[kind.type], f'sim_arm/{name}', got[name].append, 10)
    peer.connect()
    peer.wait(lambda: all(got.values()) and len(got['true_states']) > 40)
    arm.stop()

    for name in ('external_torques', 'bias_torques', 'gravity_torques', 'true_states'):
        assert tuple(got[name][0].name) == JOINTS
    assert [d.size for d in got['inertia_matrix'][0].layout.dim] == [6, 6]
    assert len(got['tip_jacobian'][0].data) == 36
    # A brake holds the joints: values in joint_states other than 0 are sensor errors.
    assert not any(got['true_states'][-1].position)
    assert all(abs(state.position[0] - 0.5) < 0.01 for state in peer.states)
    assert any(state.position[0] != 0.5 for state in peer.states)
    true = {stamp_ns(message) for message in got['true_states']}
    measured = {stamp_ns(message) for message in peer.states}
    assert len(true & measured) < len(true)

    summary = read_recording(processes.folder / 'arm.mcap', verify=True)
    assert summary.complete
    assert summary.unpublished > 0
    assert not summary.lost
