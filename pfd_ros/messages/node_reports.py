# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages about the node: diagnostics, and transitions of its lifecycle, to bytes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from pfd_ros.messages.cdr import CdrWriter
from pfd_ros.messages.convert import NANOSECONDS


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
    _time(writer, stamp_ns)
    writer.string('')
    writer.uint32(len(statuses))
    for status in statuses:
        writer.uint8(status.level)
        _strings(writer, (status.name, status.message, status.hardware_id))
        writer.uint32(len(status.values))
        for pair in status.values:
            _strings(writer, pair)
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


def _time(writer: CdrWriter, stamp_ns: int) -> None:
    seconds, nanoseconds = divmod(stamp_ns, NANOSECONDS)
    writer.int32(seconds)
    writer.uint32(nanoseconds)


def _strings(writer: CdrWriter, values: Iterable[str]) -> None:
    for value in values:
        writer.string(value)
