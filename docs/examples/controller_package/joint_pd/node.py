"""The control law as a node: one command for each state."""

from __future__ import annotations

import numpy as np
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from joint_pd.control import DAMPING, STIFFNESS, JointPD


class JointPDNode(Node):
    """Answers each state of the arm with torques, in the order of its joints.

    Time is the time of the states, in simulation and on the real arm.
    """

    def __init__(self, goal, duration: float = 1.5) -> None:
        super().__init__('joint_pd')
        self._law = JointPD(STIFFNESS, DAMPING, goal, duration)
        self._commands = self.create_publisher(
            Float64MultiArray, '/effort_controllers/commands', 1
        )
        self.create_subscription(JointState, '/joint_states', self._on_state, 1)

    def _on_state(self, state: JointState) -> None:
        stamp = state.header.stamp
        t = stamp.sec + 1e-9 * stamp.nanosec
        tau = self._law(t, np.array(state.position), np.array(state.velocity))
        self._commands.publish(Float64MultiArray(data=tau.tolist()))


def main() -> None:
    """Run the node until it is interrupted."""
    rclpy.init()
    rclpy.spin(JointPDNode(goal=[0.5, -1.0, 1.0, -0.5, 0.4, 0.3]))


if __name__ == '__main__':
    main()
