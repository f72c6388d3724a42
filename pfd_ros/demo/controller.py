# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A controller under test: computed torque, as for a real arm.

Subscribes to `joint_states` and answers each with efforts on `joint_commands`. Prints one line of
JSON with its counts when its motion is over.
"""

from __future__ import annotations

import argparse
import json
import sys

import numpy as np
import rclpy
from rclpy.duration import Duration
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.task import Future
from rclpy.utilities import remove_ros_args, try_shutdown
from sensor_msgs.msg import JointState

import pfd_core as pfd
from pfd_ros.demo.motion import motion_of
from pfd_ros.messages.convert import NANOSECONDS

# Critically damped, 20 rad/s: slow enough for delays of a millisecond.
STIFFNESS, DAMPING = 400.0, 40.0
# Simulated time between discovery of the arm and the motion.
SETTLE_NS = NANOSECONDS // 2
LONGEST_SECONDS = 1e8


class Controller(Node):
    """Follows the demo's motion for some seconds; `ended` is done when they are over."""

    def __init__(self, robot_name: str, seconds: float) -> None:
        super().__init__('demo_controller')
        self.robot = pfd.load_robot(robot_name)
        self.motion = motion_of(self.robot)
        # The first call compiles the robot, which takes too long during control.
        pfd.inverse_dynamics(self.robot, *self.motion.at(0.0))
        self.length_ns = round(seconds * NANOSECONDS)
        self.ended: Future = Future()
        self.sent = 0
        self.found_ns: int | None = None
        self.publisher = self.create_publisher(JointState, 'joint_commands', 10)
        self.create_subscription(JointState, 'joint_states', self.on_state, 1)

    def on_state(self, state: JointState) -> None:
        """Answer a state with efforts."""
        now = state.header.stamp.sec * NANOSECONDS + state.header.stamp.nanosec
        if self.found_ns is None:
            if self.publisher.get_subscription_count():
                self.found_ns = now
            return
        passed = now - self.found_ns - SETTLE_NS
        if passed < 0 or self.ended.done():
            return
        if passed >= self.length_ns:
            self.ended.set_result(None)
            return
        place = [state.name.index(name) for name in self.robot.joint_names]
        q, qd = np.array(state.position)[place], np.array(state.velocity)[place]
        wanted, wanted_qd, wanted_qdd = self.motion.at(passed / NANOSECONDS)
        qdd = wanted_qdd + STIFFNESS * (wanted - q) + DAMPING * (wanted_qd - qd)
        effort = pfd.inverse_dynamics(self.robot, q, qd, qdd)
        command = JointState(name=list(self.robot.joint_names), effort=effort.tolist())
        command.header.stamp = state.header.stamp
        self.publisher.publish(command)
        self.sent += 1


def main(args: list[str] | None = None) -> int:
    """Run the controller to the end of its motion."""
    given = sys.argv[1:] if args is None else args
    parser = argparse.ArgumentParser(description='Computed torque for the demo.')
    parser.add_argument('--robot', default='puma560')
    parser.add_argument('--seconds', type=float, default=5.0)
    chosen = parser.parse_args(remove_ros_args(['', *given])[1:])
    rclpy.init(args=given)
    node = Controller(chosen.robot, chosen.seconds)
    executor = EventsExecutor()
    executor.add_node(node)
    executor.spin_until_future_complete(node.ended, LONGEST_SECONDS)
    node.publisher.wait_for_all_acked(Duration(seconds=1))
    assert node.found_ns is not None
    start_ns = node.found_ns + SETTLE_NS
    counts = {'sent': node.sent, 'start_ns': start_ns, 'end_ns': start_ns + node.length_ns}
    node.destroy_node()
    try_shutdown()
    print(json.dumps(counts), flush=True)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
