# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs for the next cycle: any thread puts them, the stepping thread takes them.

Nothing is numbered here. An input is recorded once the engine has taken it, by the thread that
steps, so a recording has the order of the run.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
import threading

from pfd_ros.arm.engine import LARGEST
from pfd_ros.arm.events import PARAMETERS, REQUESTS, Message, Verdict

# Inputs that may wait for one cycle; the newest commands matter, so the oldest are dropped.
MOST_WAITING = 1000
# Somebody waits for the result of these; a flood of commands does not displace them.
KEPT = frozenset({REQUESTS, PARAMETERS})
OVERFLOWED = Verdict('overflowed', 'newer messages were received before the next step')


class Inbox:
    """A queue of inputs, each with the future verdict of the engine.

    `refuse` is called with role and verdict of each input that is dropped.
    """

    def __init__(self, refuse: Callable[[str, Verdict], None]) -> None:
        self._refuse = refuse
        self._ready = threading.Condition()
        self._waiting: deque[tuple[Message, Future[Verdict]]] = deque()

    def put(
        self, role: str, data: bytes, verdict: Future[Verdict] | None = None
    ) -> Future[Verdict]:
        """Queue an input and return its future verdict, which may be given."""
        found: Future[Verdict] = Future() if verdict is None else verdict
        # Enough of a long message for the engine to reject it, and a bound on memory.
        message = Message(role, data[: LARGEST + 1])
        with self._ready:
            self._waiting.append((message, found))
            dropped = self._drop_oldest() if len(self._waiting) > MOST_WAITING else None
            self._ready.notify()
        if dropped is not None:
            self._refuse(dropped[0].role, OVERFLOWED)
            dropped[1].set_result(OVERFLOWED)
        return found

    def _drop_oldest(self) -> tuple[Message, Future[Verdict]]:
        # Almost always the first one.
        place = next((k for k, (one, _) in enumerate(self._waiting) if one.role not in KEPT), 0)
        dropped = self._waiting[place]
        del self._waiting[place]
        return dropped

    def take(self, seconds: float = 0.0) -> list[tuple[Message, Future[Verdict]]]:
        """Return the inputs since the last call; wait for the first one for some seconds."""
        with self._ready:
            if seconds and not self._waiting:
                self._ready.wait(seconds)
            taken = list(self._waiting)
            self._waiting.clear()
        return taken
