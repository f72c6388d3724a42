# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Send one message from a process to another over DDS, as `pfd doctor` does.

    python -m pfd_ros.node.dds_check publish | subscribe TOPIC SECONDS

The subscriber prints the seconds until the message came, and its status is 0 only if it came.
"""

from __future__ import annotations

from collections.abc import Sequence
import sys
import time

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

# Latched, so that it does not matter which process is faster.
QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def main(arguments: Sequence[str]) -> int:
    """Publish the message, or wait for it, for a number of seconds."""
    role, topic, seconds = arguments
    rclpy.init()
    node = rclpy.create_node(f'pfd_doctor_{role}')
    received: list[String] = []
    if role == 'publish':
        node.create_publisher(String, topic, QOS).publish(String(data=topic))
    else:
        node.create_subscription(String, topic, received.append, QOS)
    start = time.monotonic()
    while not received and time.monotonic() - start < float(seconds):
        rclpy.spin_once(node, timeout_sec=0.05)
    taken = time.monotonic() - start
    rclpy.shutdown()
    if received:
        print(taken)
    return int(not received)


if __name__ == '__main__':
    raise SystemExit(main(sys.argv[1:]))
