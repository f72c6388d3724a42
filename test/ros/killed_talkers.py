# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Peers end while the processes they talk to are killed: `python killed_talkers.py ROUNDS`.

With the argument `talk`, the one that talks.
"""

from __future__ import annotations

from pathlib import Path
import sys
import tempfile

import rclpy
from ros_processes import MILLISECOND, Peer, Processes
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

TALKERS, PEERS = 2, 4


def talk() -> None:
    """Publish as a node does, until killed."""
    rclpy.init()
    node = rclpy.create_node('sim_arm')
    states = node.create_publisher(JointState, 'joint_states', 10)
    clock = node.create_publisher(Clock, '/clock', 10)
    node.create_subscription(JointState, 'joint_commands', lambda _: None, 10)
    node.create_subscription(Float64MultiArray, 'sim_arm/commands', lambda _: None, 10)

    def publish() -> None:
        states.publish(JointState(name=['joint1'], effort=[1.0]))
        clock.publish(Clock())

    node.create_timer(MILLISECOND / 1e9, publish)
    rclpy.spin(node)


def main(rounds: int) -> None:
    """Let peers and talkers meet and end, again and again."""
    for number in range(rounds):
        with tempfile.TemporaryDirectory() as folder:
            processes = Processes(Path(folder))
            for _ in range(TALKERS):
                processes.python(__file__, 'talk')
            peers = [Peer(processes.domain) for _ in range(PEERS)]
            for peer in peers:
                peer.wait(lambda peer=peer: peer.named.get_subscription_count() == TALKERS)
                peer.let_pass()
            for talker in processes.started:
                talker.process.kill()
            for peer in peers:
                peer.close()
            processes.close()
        print(number, flush=True)


if __name__ == '__main__':
    talk() if sys.argv[1] == 'talk' else main(int(sys.argv[1]))
