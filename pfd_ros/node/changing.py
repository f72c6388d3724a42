# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of settings and payloads: prepared on one thread, then queued for the arm, in order.

A first payload needs native code, which takes some tenths of a second to compile. Preparing runs
the rule of the change once, without effect: what it compiles, the engine finds. So neither the
stepping thread nor the executor waits for the compiler.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as LateError
from contextlib import suppress

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Verdict
from pfd_ros.node.inbox import Inbox

# Between two looks for the end of the run.
LOOK_SECONDS = 0.5


class Changes:
    """Passes changes on to the arm; any thread puts them.

    While one change is compiled, the oldest of very many others are dropped, see Inbox.
    """

    def __init__(
        self, engine: Engine, inbox: Inbox, refuse: Callable[[str, Verdict], None]
    ) -> None:
        self._engine, self._inbox = engine, inbox
        self._waiting = Inbox(refuse)
        self._last: Future[Verdict] | None = None

    def put(self, role: str, data: bytes) -> Future[Verdict]:
        """Queue a change and return its future verdict."""
        self._last = self._waiting.put(role, data)
        return self._last

    def settle(self, seconds: float) -> None:
        """Wait for the verdict about the newest change, some seconds at most."""
        if self._last is not None:
            with suppress(LateError):
                self._last.result(seconds)

    def run(self, stopped: Callable[[], bool]) -> None:
        """Prepare changes until `stopped` returns True."""
        while not stopped():
            for (role, data, _), verdict in self._waiting.take(LOOK_SECONDS):
                self._engine.prepare(role, data)
                self._inbox.put(role, data, verdict)
