# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two arms in namespaces: one clock, separate topics, QoS by their full names."""

from __future__ import annotations

import signal

import gripper_arm
import pytest
from ros_processes import JOINTS, Processes

pytestmark = pytest.mark.ros


@pytest.mark.slow
def test_two_arms_in_two_namespaces_receive_nothing_from_each_other(
    processes: Processes, peer_of
) -> None:
    processes.arm('-r', '__ns:=/left', ready=False)
    right = processes.arm('-r', '__ns:=/right', '-p', 'publish_clock:=false')
    peers = [peer_of(processes, name) for name in ('left', 'right')]
    for peer in peers:
        peer.connect()
    peers[0].command(JOINTS, [1.0] * 6)
    peers[0].wait(lambda: any(peers[0].states[-1].effort))
    peers[1].let_pass()
    assert peers[1].states[-1].effort.tolist() == [0] * 6
    peers[1].plain_command([2.0] * 6)
    peers[1].wait(lambda: peers[1].states[-1].effort.tolist() == [2.0] * 6)
    peers[0].let_pass()
    assert peers[0].states[-1].effort.tolist() == [1.0] * 6
    # One clock: it belongs to the left arm and continues without the right one.
    assert right.end(signal.SIGINT) == 0
    count = len(peers[0].clocks)
    peers[0].wait(lambda: len(peers[0].clocks) > count + 10)


@pytest.mark.slow
def test_topics_of_a_urdf_follow_the_namespace_unless_they_are_absolute(
    processes: Processes, peer_of
) -> None:
    text = gripper_arm.urdf(joint_commands_topic='commands', joint_states_topic='/shared/states')
    (processes.folder / 'arm.urdf').write_text(text)
    override = 'qos_overrides./right/commands.subscription.reliability:=best_effort'
    args = ('-p', 'robot:=arm.urdf', '-p', 'locked:=[finger]')
    left = processes.faulty('reports_often', *args, '-r', '__ns:=/left', ready=False)
    right = processes.faulty(
        'reports_often',
        *(*args, '-r', '__ns:=/right', '-p', 'publish_clock:=false', '-p', override),
    )
    left.wait_for_text('until its first command')
    assert 'subscribed to /left/commands (' in left.text()
    assert 'subscribed to /right/commands (' in right.text()
    # A mistake: one absolute topic for the states of both.
    right.wait_for_text(
        "node '/left/sim_arm' publishes /shared/states too: subscribers receive both"
    )
    peer = peer_of(processes, 'right')
    for side, reliability in (('left', 'RELIABLE'), ('right', 'BEST_EFFORT')):
        topic = f'/{side}/commands'
        peer.wait(lambda topic=topic: peer.node.get_subscriptions_info_by_topic(topic))
        (info,) = peer.node.get_subscriptions_info_by_topic(topic)
        assert info.qos_profile.reliability.name == reliability
    assert left.end(signal.SIGINT) == right.end(signal.SIGINT) == 0
