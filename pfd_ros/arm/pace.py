# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the arm may step: activity, pauses, lockstep with a controller, a followed clock.

The node paces cycles by its clock; this module decides when no cycle runs. It follows from
settings, events and cycles, never from wall time.
"""

from __future__ import annotations

from dataclasses import dataclass

from pfd_ros.arm.effects import Request
from pfd_ros.arm.events import Verdict
from pfd_ros.arm.state import PaceState

# NaN from a driver whose joints no controller has claimed counts as an answer, and so do commands
# for an arm braked by a reflex.
ANSWERS = frozenset({Verdict.ACCEPTED, Verdict.ALL_NAN, Verdict.REFUSED})
# Requests after which the arm continues at the time of the followed clock, without steps.
JUMPS = frozenset({'resume', 'activate', 'reset'})


@dataclass(frozen=True)
class Pace:
    """The rules for activity, pauses, lockstep and a followed clock; their state is a PaceState.

    Attributes
    ----------
    lockstep
        Whether each published state, from the first command on, waits for a command.
    from_start
        Whether, in lockstep, the state before the first command waits too.
    follows_clock
        Whether the arm follows the clock of another node.
    """

    lockstep: bool = False
    from_start: bool = False
    follows_clock: bool = False

    def begin(self, state: PaceState) -> None:
        """Begin: there is a controller to wait for from the start, or else once one commands."""
        state.waits = state.commanded = self.lockstep and self.from_start

    def forbids(self, state: PaceState, stamp_ns: int) -> bool:
        """Return whether there may be no step, not even a jump, that ends at this time."""
        if not state.active:
            return True
        return self.follows_clock and (state.until_ns is None or stamp_ns > state.until_ns)

    def request(self, state: PaceState, request: Request) -> None:
        """Apply a request."""
        if request.name in JUMPS:
            state.until_ns = None
        if request.name == 'step':
            state.left += request.count
        elif request.name in ('pause', 'resume'):
            state.paused, state.left = request.name == 'pause', 0
        elif request.name in ('activate', 'deactivate'):
            state.active = request.name == 'activate'
            self.begin(state)

    def answer(self, state: PaceState, verdict: Verdict) -> None:
        """Apply the validation result of a command, in lockstep."""
        if self.lockstep and verdict in ANSWERS:
            state.commanded = state.commanded or verdict is Verdict.ACCEPTED
            state.waits = False

    def stepped(self, state: PaceState, *, published: bool) -> None:
        """Apply a step, and whether its state was published."""
        if state.left:
            state.left -= 1
        if published:
            state.waits = self.lockstep and state.commanded


def needs_event(state: PaceState) -> bool:
    """Return whether the next step needs an event; a jump runs in a pause and needs none."""
    return state.waits or (state.paused and not state.left)
