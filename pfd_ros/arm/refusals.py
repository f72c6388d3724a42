# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is recorded of an input that was refused: itself and its rejection, but not a flood.

A refused input is recorded while those of its kind, role and label, are below REFUSED_BYTES in a
simulated second; beyond that it is counted, so that no flood fills the disk. A refusal that
changes the arm, since lockstep goes on after it, is always recorded: a replay needs it.
"""

from __future__ import annotations

from pfd_ros.arm.events import ALL_NAN, REJECTED, REJECTED_COUNTS, Message, Verdict
from pfd_ros.arm.state import State
from pfd_ros.messages.text_and_arrays import encode_string

# Bytes of a kind in a simulated second, and those that each message has besides its own.
REFUSED_BYTES, OVERHEAD = 1 << 16, 100


def refusal(state: State, event: Message, verdict: Verdict, *, changed: bool) -> list[Message]:
    """Return the messages to record about an event, and count it.

    Parameters
    ----------
    state
        Of the arm.
    event, verdict
        What was refused, and why.
    changed
        Whether the arm goes on after it.
    """
    kind = f'{event.role} {verdict.label}'
    used, more = state.refused.get(kind, (0, 0))
    if used > REFUSED_BYTES and not changed:
        state.refused[kind] = used, more + 1
        return []
    state.refused[kind] = used + len(event.data) + OVERHEAD, more
    if verdict.label == ALL_NAN.label:
        return [event]
    # The first line is verified; the rest has words of libraries, which change.
    rejection = encode_string(f'{kind}\n{verdict.detail}')
    return [event, Message(REJECTED, rejection, event.cycle)]


def counts(state: State) -> list[Message]:
    """Return asides about what was refused in this second and not recorded; count anew."""
    found = [
        Message(REJECTED_COUNTS, encode_string(f'{kind}\n{more} more in this second'))
        for kind, (_, more) in state.refused.items()
        if more
    ]
    state.refused.clear()
    return found
