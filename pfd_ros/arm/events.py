# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The inputs and outputs of the arm: events come in, take effect, and messages go out.

Wall time and thread order reach the arm only as events. Everything else follows from the
settings, the events and the number of the cycle, so a recording of the events proves a run.

A new kind of input is a new `Source`, with its rule in `validation.py`. It needs no queue, no
separate numbering and no separate row: an `Arrival` and a `ValidationRow` hold every kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple, TypeAlias

# Most steps of one request; a request that lasts for ever is `resume`.
MOST_STEPS = 1_000_000
# Farther and faster than any joint goes, rad or m, rad/s or m/s; a simulation from there, or a
# servo to it, would not stay finite.
LARGEST_POSITION, LARGEST_VELOCITY = 1e6, 1e4


class Source(IntEnum):
    """The topic or service an event came from; the numbers are in recordings and stay."""

    NAMED = 0
    ARRAY = 1
    SET_STATE = 2
    REQUEST = 3
    PARAMETERS = 4
    WRENCH = 5
    PAYLOAD = 6
    TICK = 7


# The sources whose messages are commands for the joints.
COMMANDS = frozenset({Source.NAMED, Source.ARRAY})
# The sources that an inactive arm refuses.
MOVING = COMMANDS | {Source.SET_STATE}


class Verdict(IntEnum):
    """Validation results; the numbers are written into recordings and do not change."""

    ACCEPTED = 0
    MALFORMED = 1
    NO_NAMES = 2
    RAGGED = 3
    INFINITE = 4
    STALE = 5
    DUPLICATE_NAMES = 6
    NO_EFFORT = 7
    UNKNOWN_NAMES = 8
    ALL_NAN = 9
    WRONG_SIZE = 10
    NOT_FINITE = 11
    # Not validated: dropped for newer events before the next cycle.
    OVERFLOWED = 12
    # Understood, but not possible now.
    REFUSED = 13

    @property
    def label(self) -> str:
        """The name in log lines, diagnostics and tests."""
        return self.name.lower()


class Arrival(NamedTuple):
    """A message that came in: its topic, its number there from 1, its bytes as they travelled."""

    source: Source
    sequence: int
    payload: bytes


class Overflow(NamedTuple):
    """Messages of one source that were dropped before the arm saw them, by sequence number."""

    source: Source
    sequences: Sequence[int]


Event: TypeAlias = Arrival | Overflow


@dataclass(frozen=True)
class Request:
    """A request for the arm as a whole.

    Attributes
    ----------
    name
        One of pfd_ros.arm.requests.REQUESTS.
    count
        Steps, of a request to step.
    """

    name: str
    count: int = 1


@dataclass(frozen=True)
class SettingsChange:
    """The `Settings` from the next cycle on, and the `Plant` if they need another one."""

    settings: Any
    plant: Any = None


@dataclass(frozen=True)
class WrenchChange:
    """Force and moment on the last link, (6,) in N and N m, in its frame, about its origin."""

    wrench: tuple[float, ...]


@dataclass(frozen=True)
class StateChange:
    """The joints that jump, by index in the model, where to, rad or m, and with which velocity."""

    joints: tuple[int, ...]
    positions: tuple[float, ...]
    velocities: tuple[float, ...]


@dataclass(frozen=True)
class ClockTick:
    """The time of a followed clock, ns."""

    stamp_ns: int


class ValidationRow(NamedTuple):
    """The cycle in which a message was validated or dropped, the result, and its CRC-32.

    The checksum of a message that was dropped is 0.
    """

    cycle: int
    source: Source
    sequence: int
    verdict: Verdict
    crc32: int = 0


# The fields of a ValidationRow as they are labelled in recordings.
TAKEN_COLUMNS = ('step', 'source', 'sequence', 'verdict', 'crc32')

# Roles of the outputs: validation rows, the arm's state, the clock tick, a new payload.
TAKEN, STATES, CLOCK = 'taken', 'joint_states', 'clock'
PAYLOAD_IN_USE = 'payload_in_use'
# Everything that changes while the arm runs, as bytes: only in recordings.
ARM_STATE = 'arm_state'
# A state that the sensors drop: recorded, not published; it is numbered with the others.
DROPPED_STATES = 'dropped_states'
NUMBERED_AS_STATES = frozenset({STATES, DROPPED_STATES})
# For viewers, recorded and not published: the URDF, and the frames of its links.
DESCRIPTION, TF_STATIC, TF = 'robot_description', 'tf_static', 'tf'


class Output(NamedTuple):
    """A message of the arm: its role, its number among the messages of that role, its bytes."""

    role: str
    number: int
    data: bytes
