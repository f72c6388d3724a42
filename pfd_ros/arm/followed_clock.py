# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A clock of another node that the arm follows: at each tick the arm steps up to its time.

At the first tick, and at the first one after a pause, a reset or an activation, simulated time is
set to the tick without a step. After that the arm steps up to the newest tick. A tick earlier than
a previous one is stale, since simulated time never goes back. A tick too far ahead is rejected;
the arm then waits for a valid tick or a reset. Without ticks the arm waits; the node reports it
after some seconds.
"""

from __future__ import annotations

from pfd_ros.arm.commands import Validation
from pfd_ros.arm.effects import ClockTick
from pfd_ros.arm.events import Verdict
from pfd_ros.messages.convert import NANOSECONDS

# Largest number of steps for one tick: at 1 kHz a hundred seconds.
MOST_STEPS_AHEAD = 100_000


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
