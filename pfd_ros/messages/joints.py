# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of type sensor_msgs/JointState: bytes to arrays and back."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import pfd_core as pfd
from pfd_ros.messages.cdr import Encoder, Reader, Writer

# Units of the arrays, of a joint that turns or slides.
JOINT_UNITS = {
    'position': ('rad', 'm'),
    'velocity': ('rad/s', 'm/s'),
    'effort': ('N m', 'N'),
}
JOINT_FIELDS = tuple(JOINT_UNITS)


def unit_of(item: str, robot: pfd.Robot | None, names: Collection[str]) -> str:
    """Return the unit of an item for joints of a robot; both if they differ or one is unknown."""
    turns, slides = JOINT_UNITS[item]
    kinds: dict[str, str] = {}
    if robot is not None:
        kinds = {x.name: x.kind for x in robot.followers}
        kinds |= zip(robot.joint_names, robot.joint_types, strict=True)
    found = {kinds.get(name, '') for name in names}
    if found == {'prismatic'}:
        return slides
    return turns if found and found <= {'revolute', 'continuous'} else f'{turns} or {slides}'


# Frame and names of the last message that was decoded, as bytes and as values. Senders do not
# change them, and decoding names takes longer than all else. One tuple: threads may share it.
_NO_HEAD: tuple[bytes, str, tuple[str, ...]] = b'\xff', '', ()
_last_head = _NO_HEAD


class Joints(NamedTuple):
    """A JointState: rad, rad/s and N m, or m, m/s and N; the arrays may be ragged."""

    stamp_ns: int
    names: tuple[str, ...]
    position: NDArray[Any]
    velocity: NDArray[Any]
    effort: NDArray[Any]
    frame_id: str = ''


def decode_joints(data: bytes) -> Joints:
    """Return the fields of a JointState; ValueError if the bytes are not such a message."""
    global _last_head
    reader = Reader(data)
    stamp_ns = reader.time()
    head, frame_id, names = _last_head
    # Bytes of the other byte order, in which lengths read otherwise, begin otherwise.
    if reader.order == '<' and data.startswith(head, reader.at):
        reader.at += len(head)
    else:
        start, frame_id, names = reader.at, reader.string(), reader.strings()
        if reader.order == '<':
            _last_head = data[start : reader.at], frame_id, names
    return Joints(stamp_ns, names, reader.numbers(), reader.numbers(), reader.numbers(), frame_id)


def encode_joints(
    names: Sequence[str],
    position: ArrayLike = (),
    velocity: ArrayLike = (),
    effort: ArrayLike = (),
    stamp_ns: int = 0,
    frame_id: str = '',
) -> bytes:
    """Return a JointState; the arrays have one number a name, or none."""
    writer = Writer()
    writer.header(stamp_ns, frame_id)
    writer.strings(names)
    for values in (position, velocity, effort):
        writer.numbers(values)
    return bytes(writer.data)


def joint_encoder(
    names: Sequence[str],
    frame_id: str = '',
    fixed: Mapping[str, float] | None = None,
    fields: Sequence[str] = JOINT_FIELDS,
) -> Encoder:
    """Return an encoder of the JointStates of one arm, for numbers (fields, names).

    Parameters
    ----------
    names, frame_id
        Joint names in the order of the numbers; header.frame_id.
    fixed
        Positions of further joints, which come after the others and do not move.
    fields
        The arrays that are written, of JOINT_FIELDS and in their order; the others are empty.
    """
    at_rest = dict(fixed or {})
    count = len(names) + len(at_rest)
    writer = Writer()
    writer.header(0, frame_id)
    writer.strings((*names, *at_rest))
    starts = []
    for name in JOINT_FIELDS:
        values = np.zeros(count if name in fields else 0)
        if name == 'position' and name in fields:
            values[len(names) :] = list(at_rest.values())
        starts.append(writer.numbers(values))
    start = starts[JOINT_FIELDS.index(fields[0])]
    # From one array to the next are its numbers, its count and four bytes: padding, or the count
    # of an empty array.
    shape, strides = (len(fields), len(names)), (8 * count + 8, 8)
    return Encoder(writer.data, np.ndarray(shape, '<f8', writer.data, start, strides))
