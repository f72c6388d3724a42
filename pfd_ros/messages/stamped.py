# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a header and a fixed count of numbers, such as poses, to arrays and back.

The bytes are serialized messages (CDR), as in `convert`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.messages.old_cdr import STAMP, CdrReader, CdrWriter, time_bytes
from pfd_ros.messages.convert import INERTIA, POSE, WRENCH, headed, read_time

# The names of the numbers of each type, in their order; m, quaternions, N, N m, kg, kg m^2.
NUMBERS = {
    POSE: ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw'),
    WRENCH: ('fx', 'fy', 'fz', 'tx', 'ty', 'tz'),
    INERTIA: ('mass', 'x', 'y', 'z', 'xx', 'xy', 'xz', 'yy', 'yz', 'zz'),
}


@dataclass(frozen=True)
class StampedMessage:
    """A message of a type in NUMBERS."""

    stamp_ns: int
    frame_id: str
    values: NDArray[Any]


def decode_stamped(data: bytes, kind: str) -> StampedMessage:
    """Return the fields of a message of a type in NUMBERS.

    Raises
    ------
    ValueError
        If the bytes are not such a message.
    """
    reader = CdrReader(data)
    stamp_ns, frame_id = read_time(reader), reader.string()
    return StampedMessage(stamp_ns, frame_id, reader.row('f8', len(NUMBERS[kind])))


class StampedEncoder:
    """Writes messages of a header and numbers: all is laid out once, but for stamp and numbers.

    Parameters
    ----------
    writer
        The message, with the stamp at its front.
    start, count
        The place of the first number, and how many there are.
    """

    def __init__(self, writer: CdrWriter, start: int, count: int) -> None:
        self._data = writer.data
        self._numbers = np.frombuffer(self._data, '<f8', count, start)

    def encode(self, stamp_ns: int, values: NDArray[Any]) -> bytes:
        """Return the message; the values are (count,)."""
        self._data[STAMP] = time_bytes(stamp_ns)
        self._numbers[:] = values
        return bytes(self._data)


def stamped_encoder(kind: str, frame_id: str) -> StampedEncoder:
    """Return an encoder of a type in NUMBERS, with its frame."""
    writer, count = headed(frame_id), len(NUMBERS[kind])
    return StampedEncoder(writer, writer.row(np.zeros(count)), count)


def effort_encoder(names: Sequence[str], frame_id: str = '') -> StampedEncoder:
    """Return an encoder of JointState messages with names and efforts alone."""
    writer = headed(frame_id)
    writer.strings(tuple(names))
    for _ in ('position', 'velocity'):
        writer.numbers(np.zeros(0))
    return StampedEncoder(writer, writer.numbers(np.zeros(len(names))), len(names))


@dataclass(frozen=True)
class WrenchMessage:
    """A geometry_msgs/WrenchStamped: force and torque, (3,) in N and N m."""

    stamp_ns: int
    frame_id: str
    force: tuple[float, ...]
    torque: tuple[float, ...]

    @property
    def numbers(self) -> tuple[float, ...]:
        """Force and torque, (6,)."""
        return *self.force, *self.torque


def wrench_message(stamp_ns: int, frame_id: str, numbers: Sequence[float]) -> WrenchMessage:
    """Return a wrench of force and torque, (6,) in N and N m."""
    return WrenchMessage(stamp_ns, frame_id, tuple(numbers[:3]), tuple(numbers[3:]))


def decode_wrench(data: bytes) -> WrenchMessage:
    """Return the fields of a WrenchStamped."""
    found = decode_stamped(data, WRENCH)
    return wrench_message(found.stamp_ns, found.frame_id, found.values.tolist())


@dataclass(frozen=True)
class InertiaMessage:
    """A geometry_msgs/InertiaStamped.

    Mass in kg, centre of mass (3,) in m, and the inertia (xx, xy, xz, yy, yz, zz) about it, in
    kg m^2.
    """

    stamp_ns: int
    frame_id: str
    mass: float
    center: tuple[float, ...]
    inertia: tuple[float, ...]

    @property
    def numbers(self) -> tuple[float, ...]:
        """Mass, centre of mass and inertia, (10,)."""
        return self.mass, *self.center, *self.inertia


def inertia_message(stamp_ns: int, frame_id: str, numbers: Sequence[float]) -> InertiaMessage:
    """Return an inertia of mass, centre of mass and inertia, (10,)."""
    mass, *body = numbers
    return InertiaMessage(stamp_ns, frame_id, mass, tuple(body[:3]), tuple(body[3:]))


def decode_inertia(data: bytes) -> InertiaMessage:
    """Return the fields of an InertiaStamped."""
    found = decode_stamped(data, INERTIA)
    return inertia_message(found.stamp_ns, found.frame_id, found.values.tolist())


def encode_inertia(message: InertiaMessage) -> bytes:
    """Return an InertiaStamped message."""
    encoder = stamped_encoder(INERTIA, message.frame_id)
    return encoder.encode(message.stamp_ns, np.array(message.numbers))
