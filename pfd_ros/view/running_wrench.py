# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The external wrench on a running arm, from what its topics say.

`~/tip_wrench` is exact, with each state, where `outputs` has it; the others do not count then.
`~/external_wrench` has a wrench that is sent; it acts for `external_wrench_timeout`.
`/diagnostics` has, once a second, the wrench that acts, and that timeout. It ends a wrench that
was rejected, cleared or reset, and begins one from before the view.
"""

from __future__ import annotations

import math

from pfd_ros.arm.wrench import LARGEST_WRENCH
from pfd_ros.messages.convert import NANOSECONDS
from pfd_ros.messages.stamped import WrenchMessage
from pfd_ros.view.log_loads import is_nothing

# A report this long [s] after a wrench is about that wrench: both travel on separate topics.
LATER = 0.3
# Reports have six digits.
ROUNDED = 1e-4


class RunningWrench:
    """The external wrench on a running arm.

    Attributes
    ----------
    acting : WrenchMessage or None
        The wrench to show.

    """

    def __init__(self) -> None:
        self.acting: WrenchMessage | None = None
        self._exact = False
        self._timeout = 0.0
        self._now_ns = self._begin_ns = 0
        self._sent = -float('inf')

    def measured(self, wrench: WrenchMessage) -> None:
        """Take a message of ~/tip_wrench."""
        self._exact = True
        self.acting = None if is_nothing(wrench) else wrench

    def sent(self, wrench: WrenchMessage, seconds: float) -> None:
        """Take a message of ~/external_wrench that came at a steady time [s]."""
        # As the arm rejects them.
        if self._exact or not all(abs(number) <= LARGEST_WRENCH for number in wrench.numbers):
            return
        self.acting = None if is_nothing(wrench) else wrench
        self._begin_ns, self._sent = self._now_ns, seconds

    def at_state(self, stamp_ns: int) -> None:
        """Let simulated time reach a state."""
        self._now_ns = stamp_ns
        over = self._timeout and stamp_ns - self._begin_ns > self._timeout * NANOSECONDS
        if over and not self._exact:
            self.acting = None

    def reported(self, wrench: WrenchMessage, timeout: float, seconds: float) -> None:
        """Take the wrench and the timeout [s] of a report that came at a steady time [s]."""
        self._timeout = timeout
        if self._exact or seconds - self._sent < LATER:
            return
        if is_nothing(wrench):
            self.acting = None
        elif self.acting is None or not _same(self.acting, wrench):
            self.acting, self._begin_ns = wrench, self._now_ns


def _same(one: WrenchMessage, other: WrenchMessage) -> bool:
    """Return whether two wrenches in different frames of a link may be the same."""
    forces = math.hypot(*one.force), math.hypot(*other.force)
    if max(forces) > 0:
        return math.isclose(*forces, rel_tol=ROUNDED)
    # A torque alone is the same about each point.
    return math.isclose(math.hypot(*one.torque), math.hypot(*other.torque), rel_tol=ROUNDED)
