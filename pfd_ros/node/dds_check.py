# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Send one message from a process to another over DDS, as `pfd doctor` does.

    python -m pfd_ros.node.dds_check SECONDS

It prints the seconds until the message came, and its status is 0 only if it came. The message is
from a second process of this module, which has the topic as another argument.
"""

from __future__ import annotations

from collections.abc import Sequence
import os
import subprocess
import sys
import time

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

# Latched, so that it does not matter which process is faster.
QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def main(arguments: Sequence[str]) -> int:
    """Wait for the message of another process, or publish it, for a number of seconds."""
    seconds, *given = arguments
    topic = given[0] if given else f'/pfd_doctor_{os.getpid()}'
    rclpy.init()
    node = rclpy.create_node('pfd_doctor_publisher' if given else 'pfd_doctor_subscriber')
    received: list[String] = []
    if given:
        node.create_publisher(String, topic, QOS).publish(String(data=topic))
    else:
        node.create_subscription(String, topic, received.append, QOS)
        publisher = subprocess.Popen(
            [sys.executable, '-m', 'pfd_ros.node.dds_check', seconds, topic],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    start = time.monotonic()
    while not received and time.monotonic() - start < float(seconds):
        rclpy.spin_once(node, timeout_sec=0.05)
    taken = time.monotonic() - start
    rclpy.shutdown()
    if not given:
        publisher.kill()
        publisher.wait()
    if received:
        print(taken)
    return int(not received)


if __name__ == '__main__':
    raise SystemExit(main(sys.argv[1:]))
