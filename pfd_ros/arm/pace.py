# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the arm may step: pauses, and lockstep with a controller.

The node paces cycles by its clock; this says when there is to be none at all. It follows from
settings, events and cycles, never from wall time.
"""

from __future__ import annotations

from dataclasses import dataclass

from pfd_ros.arm.effects import Request
from pfd_ros.arm.events import Verdict

# A driver that sends NaN until a controller has claimed its joints answers all the same.
ANSWERS = frozenset({Verdict.ACCEPTED, Verdict.ALL_NAN})


@dataclass
class Pace:
    """Pause and lockstep of one arm.

    Attributes
    ----------
    lockstep
        Whether each published state, from the first command on, waits for a command.
    from_start
        Whether, in lockstep, the state before the first command waits too.
    paused
        Whether there are only the steps that are asked for.
    waits
        Whether the last published state has had no answer.
    """

    lockstep: bool = False
    paused: bool = False
    waits: bool = False
    from_start: bool = False
    _left: int = 0
    _commanded: bool = False

    def __post_init__(self) -> None:
        """Wait for the first command, if that is asked for."""
        self.waits = self._commanded = self.lockstep and self.from_start

    @property
    def stands(self) -> bool:
        """Whether the next step needs an event."""
        return self.waits or (self.paused and not self._left)

    def request(self, request: Request) -> None:
        """Pause, go on, or do some steps in a pause."""
        if request.name == 'step':
            self._left += request.count
        else:
            self.paused, self._left = request.name == 'pause', 0

    def answer(self, verdict: Verdict) -> None:
        """Take note of a command."""
        if verdict in ANSWERS:
            self._commanded = self._commanded or verdict is Verdict.ACCEPTED
            self.waits = False

    def stepped(self, *, published: bool) -> None:
        """Take note of a step, and whether its state was published."""
        self._left = max(0, self._left - 1)
        if published:
            self.waits = self.lockstep and self._commanded
