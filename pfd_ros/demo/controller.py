# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A controller under test: computed torque, as for a real arm.

Subscribes to `joint_states` and answers each with efforts on `joint_commands`. It knows links and
rotors of the arm, not its friction and payload. In the middle of the motion the process pushes the
tip: one message on `sim_arm/external_wrench`.
"""

from __future__ import annotations

import argparse
import sys

from geometry_msgs.msg import WrenchStamped
import numpy as np
import rclpy
from rclpy.duration import Duration
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.task import Future
from rclpy.utilities import remove_ros_args, try_shutdown
from sensor_msgs.msg import JointState

import pfd_core as pfd
from pfd_ros.demo.scenario import PUSH_BEGIN, efforts, motion_of, push_force
from pfd_ros.messages.cdr import NANOSECONDS

# Simulated time at rest between discovery of the arm and the motion, and after the motion.
SETTLE_NS = NANOSECONDS // 2
LONGEST_SECONDS = 1e8


class Controller(Node):
    """Follows the demo's motion of some seconds; `ended` is done when the arm is at rest again."""

    def __init__(self, robot_name: str, seconds: float) -> None:
        super().__init__('demo_controller')
        self.robot = pfd.load_robot(robot_name)
        self.motion = motion_of(self.robot, seconds)
        # The first call compiles the robot, which takes too long during control.
        efforts(self.robot, self.motion, 0.0, *self.motion.at(0.0)[:2])
        self.length_ns = round(seconds * NANOSECONDS)
        self.ended: Future = Future()
        self.found_ns: int | None = None
        self.pushed = False
        self.publisher = self.create_publisher(JointState, 'joint_commands', 10)
        self.hand = self.create_publisher(WrenchStamped, 'sim_arm/external_wrench', 1)
        self.create_subscription(JointState, 'joint_states', self.on_state, 1)

    def on_state(self, state: JointState) -> None:
        """Answer a state with efforts."""
        now = state.header.stamp.sec * NANOSECONDS + state.header.stamp.nanosec
        if self.found_ns is None:
            if self.publisher.get_subscription_count() and self.hand.get_subscription_count():
                self.found_ns = now
            return
        passed = now - self.found_ns - SETTLE_NS
        if passed < 0 or self.ended.done():
            return
        if passed >= self.length_ns + SETTLE_NS:
            self.ended.set_result(None)
            return
        if not self.pushed and passed >= PUSH_BEGIN * self.length_ns:
            self.push()
        place = [state.name.index(name) for name in self.robot.joint_names]
        q, qd = np.array(state.position)[place], np.array(state.velocity)[place]
        t = passed / NANOSECONDS
        effort = efforts(self.robot, self.motion, t, q, qd)
        # Without servo gains the arm ignores positions; they are the reference, for the page.
        wanted = self.motion.at(t)[0].tolist()
        names = list(self.robot.joint_names)
        command = JointState(name=names, position=wanted, effort=effort.tolist())
        command.header.stamp = state.header.stamp
        self.publisher.publish(command)

    def push(self) -> None:
        """Push the tip, for the time that the arm's parameter `external_wrench_timeout` states."""
        self.pushed = True
        wrench = WrenchStamped()
        wrench.header.frame_id = self.robot.tip
        force = wrench.wrench.force
        force.x, force.y, force.z = push_force(self.robot).tolist()
        self.hand.publish(wrench)


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
    node.destroy_node()
    try_shutdown()
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
