# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bytes of commands, wrenches, and states to jump to."""

from __future__ import annotations

from collections.abc import Sequence
import struct

import numpy as np

from pfd_ros.messages.cdr import HEADER, CdrWriter
from pfd_ros.messages.convert import NANOSECONDS

_TIME = struct.Struct('<iI')


class EffortArray:
    """Writes std_msgs/Float64MultiArray messages of `count` numbers, without a layout."""

    def __init__(self, count: int) -> None:
        writer = CdrWriter()
        writer.uint32(0)
        writer.uint32(0)
        start = writer.numbers(np.zeros(count))
        self._data = writer.data
        self._efforts = np.frombuffer(self._data, '<f8', count, start)

    def encode(self, efforts: np.ndarray) -> bytes:
        """Return the message with these numbers (n,)."""
        self._efforts[:] = efforts
        return bytes(self._data)


class StampedEfforts:
    """Writes sensor_msgs/JointState messages of names and efforts, and nothing else."""

    def __init__(self, names: Sequence[str]) -> None:
        writer = joint_state(names)
        writer.numbers(np.zeros(0))
        writer.numbers(np.zeros(0))
        start = writer.numbers(np.zeros(len(names)))
        self._data = writer.data
        self._efforts = np.frombuffer(self._data, '<f8', len(names), start)

    def encode(self, stamp_ns: int, efforts: np.ndarray) -> bytes:
        """Return the message with this stamp and these numbers (n,)."""
        _TIME.pack_into(self._data, len(HEADER), *divmod(stamp_ns, NANOSECONDS))
        self._efforts[:] = efforts
        return bytes(self._data)


def joint_state(names: Sequence[str]) -> CdrWriter:
    """Return a JointState without a stamp, up to its positions."""
    writer = CdrWriter()
    writer.int32(0)
    writer.uint32(0)
    writer.string('')
    writer.strings(tuple(names))
    return writer


def wrench_bytes(frame_id: str, force: Sequence[float], torque: Sequence[float]) -> bytes:
    """Return a geometry_msgs/WrenchStamped without a stamp; force and torque are (3,), N, N m."""
    writer = CdrWriter()
    writer.int32(0)
    writer.uint32(0)
    writer.string(frame_id)
    padding = bytes((len(HEADER) - len(writer.data)) % 8)
    return bytes(writer.data) + padding + struct.pack('<6d', *force, *torque)


def state_bytes(names: Sequence[str], q: np.ndarray, qd: np.ndarray) -> bytes:
    """Return a JointState of positions and velocities (n,), without a stamp."""
    writer = joint_state(names)
    writer.numbers(q)
    writer.numbers(qd)
    writer.numbers(np.zeros(0))
    return bytes(writer.data)
