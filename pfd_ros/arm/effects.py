# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The effects of events that are no commands: requests, states to jump to, new settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

# Most steps of one request; a request that lasts for ever is `resume`.
MOST_STEPS = 1_000_000


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
    """The `Settings` from the next cycle on."""

    settings: Any


@dataclass(frozen=True)
class StateChange:
    """The joints that jump, by index in the model, where to, rad or m, and with which velocity."""

    joints: tuple[int, ...]
    positions: tuple[float, ...]
    velocities: tuple[float, ...]
