# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages about the node: diagnostics, and transitions of its lifecycle, to bytes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import NamedTuple

from pfd_ros.messages.old_cdr import CdrWriter


class Status(NamedTuple):
    """A diagnostic_msgs/DiagnosticStatus; level 0 is OK, 1 WARN, 2 ERROR."""

    level: int
    name: str
    message: str
    hardware_id: str
    values: Sequence[tuple[str, str]]


def encode_diagnostics(stamp_ns: int, statuses: Sequence[Status]) -> bytes:
    """Return a DiagnosticArray."""
    writer = CdrWriter()
    writer.time(stamp_ns)
    writer.string('')
    writer.uint32(len(statuses))
    for status in statuses:
        writer.uint8(status.level)
        for text in (status.name, status.message, status.hardware_id):
            writer.string(text)
        writer.uint32(len(status.values))
        for text in chain.from_iterable(status.values):
            writer.string(text)
    return bytes(writer.data)


def encode_transition(
    stamp_ns: int, transition: tuple[int, str], start: tuple[int, str], goal: tuple[int, str]
) -> bytes:
    """Return a TransitionEvent; transition and states are id and label."""
    writer = CdrWriter()
    writer.uint64(stamp_ns)
    for number, label in (transition, start, goal):
        writer.uint8(number)
        writer.string(label)
    return bytes(writer.data)
