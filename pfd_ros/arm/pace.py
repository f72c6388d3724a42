# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the arm may step: activity, pauses, lockstep with a controller, a followed clock.

The node paces cycles by its clock; this says when there is to be none at all. It follows from
settings, events and cycles, never from wall time.
"""

from __future__ import annotations

from dataclasses import dataclass

from pfd_ros.arm.commands import Judgement
from pfd_ros.arm.effects import Request
from pfd_ros.arm.events import Verdict
from pfd_ros.arm.followed_clock import FollowedClock

# A driver that sends NaN until a controller has claimed its joints answers all the same, and so
# does a controller whose commands are of no use to an arm that a reflex has braked.
ANSWERS = frozenset({Verdict.ACCEPTED, Verdict.ALL_NAN, Verdict.REFUSED})
# Requests after which the time of a followed clock is where the arm goes on, without steps.
LEAPS = frozenset({'resume', 'activate', 'reset'})


@dataclass
class Pace:
    """Activity, pause, lockstep and followed clock of one arm.

    Attributes
    ----------
    lockstep
        Whether each published state, from the first command on, waits for a command.
    active
        Whether there are steps at all; an inactive arm has its brakes on and takes no commands.
    clock
        The clock of another node, if the arm follows one.
    from_start
        Whether, in lockstep, the state before the first command waits too.
    paused
        Whether there are only the steps that are asked for.
    waits
        Whether the last published state has had no answer.
    """

    lockstep: bool = False
    active: bool = True
    clock: FollowedClock | None = None
    from_start: bool = False
    paused: bool = False
    waits: bool = False
    _left: int = 0
    _commanded: bool = False

    def __post_init__(self) -> None:
        """Begin."""
        self._begin()

    def _begin(self) -> None:
        # There is a controller to wait for from the start, or else once one commands.
        self.waits = self._commanded = self.lockstep and self.from_start

    @property
    def stands(self) -> bool:
        """Whether the next step needs an event; a jump goes through a pause, and needs none."""
        return self.waits or (self.paused and not self._left)

    def forbids(self, stamp_ns: int) -> bool:
        """Return whether there may be no step, not even a jump, that ends at this time."""
        return not self.active or (self.clock is not None and not self.clock.reaches(stamp_ns))

    def judge_tick(self, tick_ns: int, stamp_ns: int) -> Judgement:
        """Judge a tick of the followed clock; ValueError if there is none."""
        if self.clock is None:
            raise ValueError('no clock is followed')
        return self.clock.judge(tick_ns, stamp_ns)

    def request(self, request: Request) -> None:
        """Take note of a request."""
        if self.clock is not None and request.name in LEAPS:
            self.clock.until_ns = None
        if request.name == 'step':
            self._left += request.count
        elif request.name in ('pause', 'resume'):
            self.paused, self._left = request.name == 'pause', 0
        elif request.name in ('activate', 'deactivate'):
            self.active = request.name == 'activate'
            self._begin()

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
