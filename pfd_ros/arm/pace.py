# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the arm may step: activity, pauses, lockstep with a controller, a followed clock.

The node paces cycles by its clock; this module decides when no cycle runs. It follows from
settings, events and cycles, never from wall time.

A followed clock is the clock of another node. At its first tick, and at the first one after a
pause, a reset or an activation, simulated time is set to the tick without a step. After that the
arm steps up to the newest tick. A tick earlier than a previous one is stale, since simulated time
never goes back. A tick too far ahead is rejected; the arm then waits for a valid tick or a reset.
Without ticks the arm waits; the node reports it after some seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

from pfd_ros.arm.commands import Validation
from pfd_ros.arm.events import ClockTick, Request, Verdict
from pfd_ros.arm.state import PaceState
from pfd_ros.messages.convert import NANOSECONDS

# NaN from a driver whose joints no controller has claimed counts as an answer, and so do commands
# for an arm braked by a reflex.
ANSWERS = frozenset({Verdict.ACCEPTED, Verdict.ALL_NAN, Verdict.REFUSED})
# Requests after which the arm continues at the time of the followed clock, without steps.
JUMPS = frozenset({'resume', 'activate', 'reset'})
# Largest number of steps for one tick: at 1 kHz a hundred seconds.
MOST_STEPS_AHEAD = 100_000


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


def validate_tick(tick_ns: int, stamp_ns: int, until_ns: int | None, step_ns: int) -> Validation:
    """Validate a tick.

    Parameters
    ----------
    tick_ns, stamp_ns
        The simulated times of the tick and of the arm, ns.
    until_ns
        The simulated time of the newest tick, ns; None before the first one.
    step_ns
        Simulated time of a step, ns.
    """
    last = stamp_ns if until_ns is None else until_ns
    if tick_ns < last:
        return Validation(
            Verdict.STALE,
            f'the clock is at {tick_ns / NANOSECONDS} s and was at {last / NANOSECONDS} s: '
            'simulated time never goes back',
        )
    if until_ns is not None and tick_ns - stamp_ns > MOST_STEPS_AHEAD * step_ns:
        return Validation(
            Verdict.REFUSED,
            f'the clock is at {tick_ns / NANOSECONDS} s and the arm at '
            f'{stamp_ns / NANOSECONDS} s, more than {MOST_STEPS_AHEAD} steps behind: '
            'call ~/reset to set its time',
        )
    return Validation(Verdict.ACCEPTED, effect=ClockTick(tick_ns))
