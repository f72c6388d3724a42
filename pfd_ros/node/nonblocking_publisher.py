# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A publisher that no reader can stop, nor slow down for long."""

from __future__ import annotations

import time
from typing import Any

from rclpy._rclpy_pybind11 import RCLError
from rclpy.duration import Duration
from rclpy.qos import HistoryPolicy

AT_ONCE = Duration()
# The step timer makes up for delays this long.
LONGEST_SECONDS = 0.05


class NonblockingPublisher:
    """Publishes bytes, and leaves messages out while the middleware refuses them.

    With the history `keep_all`, a reader that is alive and takes nothing fills the
    publisher's memory; from then on every call blocks for 0.1 s and fails. So after the first
    such call nothing is published on the topic until every reader has acknowledged its messages
    or is gone; the messages left out are counted.

    Attributes
    ----------
    refused
        Number of messages that were left out.
    detail
        The middleware's newest reason.
    """

    def __init__(self, publisher: Any) -> None:
        self.topic: str = publisher.topic_name
        self.refused = 0
        self.detail = ''
        self._publisher = publisher
        self._full = False
        self._can_block = publisher.qos_profile.history is HistoryPolicy.KEEP_ALL

    def publish(self, data: bytes) -> None:
        """Publish a serialized message if the middleware takes it."""
        try:
            if not self._full or self._publisher.wait_for_all_acked(AT_ONCE):
                begun = time.monotonic()
                self._publisher.publish(data)
                self._full = self._can_block and time.monotonic() - begun > LONGEST_SECONDS
                return
        except RCLError as error:
            self._full = True
            self.detail = str(error)
        self.refused += 1
