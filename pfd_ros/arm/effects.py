# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The effects of events other than commands: requests, jumps, settings, wrenches, ticks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

# Most steps of one request; a request that lasts for ever is `resume`.
MOST_STEPS = 1_000_000
# Farther and faster than any joint goes, rad or m, rad/s or m/s; a simulation from there, or a
# servo to it, would not stay finite.
LARGEST_POSITION, LARGEST_VELOCITY = 1e6, 1e4


@dataclass(frozen=True)
class Request:
    """A request for the arm as a whole.

    Attributes
    ----------
    name
        One of REQUESTS.
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
