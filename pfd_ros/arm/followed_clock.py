# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A clock of another node that the arm follows: each of its ticks lets the arm step up to it.

The first tick, and the first one after a pause, a reset or an activation, is where simulated time
goes on: it leaps there without a step. From then on the arm does each step up to the newest tick.
A tick that is earlier than one before it is stale, since simulated time never goes back, and one
that is too far ahead is refused; the arm then stands until ticks fit again, or until a reset. A
clock that is lost leaves the arm standing too; the node tells so after some seconds.
"""

from __future__ import annotations

from pfd_ros.arm.commands import Judgement
from pfd_ros.arm.effects import ClockTick
from pfd_ros.arm.events import Verdict
from pfd_ros.messages.convert import NANOSECONDS

# Steps that one tick may ask for: at 1 kHz a hundred seconds.
MOST_STEPS_AHEAD = 100_000


def judge_tick(tick_ns: int, stamp_ns: int, until_ns: int | None, step_ns: int) -> Judgement:
    """Judge a tick.

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
        return Judgement(
            Verdict.STALE,
            f'the clock is at {tick_ns / NANOSECONDS} s and was at {last / NANOSECONDS} s: '
            'simulated time never goes back',
        )
    if until_ns is not None and tick_ns - stamp_ns > MOST_STEPS_AHEAD * step_ns:
        return Judgement(
            Verdict.REFUSED,
            f'the clock is at {tick_ns / NANOSECONDS} s and the arm at '
            f'{stamp_ns / NANOSECONDS} s, more than {MOST_STEPS_AHEAD} steps behind: '
            'a reset lets its time leap there',
        )
    return Judgement(Verdict.ACCEPTED, effect=ClockTick(tick_ns))
