# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bytes of commands without names, and of states to jump to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.messages.cdr import CdrWriter
from pfd_ros.messages.convert import headed


class EffortArray:
    """Writes std_msgs/Float64MultiArray messages of `count` numbers, without a layout."""

    def __init__(self, count: int) -> None:
        writer = CdrWriter()
        writer.uint32(0)
        writer.uint32(0)
        start = writer.numbers(np.zeros(count))
        self._data = writer.data
        self._efforts = np.frombuffer(self._data, '<f8', count, start)

    def encode(self, efforts: NDArray[Any]) -> bytes:
        """Return the message with these numbers (n,)."""
        self._efforts[:] = efforts
        return bytes(self._data)


def state_bytes(names: Sequence[str], q: NDArray[Any], qd: NDArray[Any]) -> bytes:
    """Return a JointState of positions and velocities (n,), without a stamp."""
    writer = headed('')
    writer.strings(tuple(names))
    writer.numbers(q)
    writer.numbers(qd)
    writer.numbers(np.zeros(0))
    return bytes(writer.data)
