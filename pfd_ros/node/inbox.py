# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs for the next cycle: any thread puts them, the stepping thread takes them.

Nothing is numbered here. An input is recorded once the engine has taken it, by the thread that
steps, so a recording has the order of the run.

Changes of settings and payloads come through another thread. A first payload needs native code,
which takes some tenths of a second to compile, with many outputs some seconds, and is logged.
Preparing runs the rule of the change once, without effect: what it compiles, the engine finds. So
neither the stepping thread nor the executor waits for the compiler.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, wait
from concurrent.futures import TimeoutError as LateError
from contextlib import AbstractContextManager, suppress
import threading

from pfd_ros.arm.engine import LARGEST, Engine
from pfd_ros.arm.events import PARAMETERS, REQUESTS, Message, Verdict

# Inputs that may wait for one cycle; the newest commands matter, so the oldest are dropped.
MOST_WAITING = 1000
# Somebody waits for the result of these; a flood of commands does not displace them.
KEPT = frozenset({REQUESTS, PARAMETERS})
# Between two looks of a waiting thread for the end of the run.
LOOK_SECONDS = 0.5
# Held while native code is compiled: two compilations at once take more time from the steps.
COMPILATION = threading.Lock()
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
        message, waiting = Message(role, data[: LARGEST + 1]), self._waiting
        dropped = None
        with self._ready:
            waiting.append((message, found))
            if len(waiting) > MOST_WAITING:
                # Almost always the first one.
                place = next((k for k, (one, _) in enumerate(waiting) if one.role not in KEPT), 0)
                dropped = waiting[place]
                del waiting[place]
            self._ready.notify()
        if dropped is not None:
            self._refuse(dropped[0].role, OVERFLOWED)
            dropped[1].set_result(OVERFLOWED)
        return found

    def take(self, seconds: float = 0.0) -> list[tuple[Message, Future[Verdict]]]:
        """Return the inputs since the last call; wait for the first one for some seconds."""
        with self._ready:
            if seconds and not self._waiting:
                self._ready.wait(seconds)
            taken = list(self._waiting)
            self._waiting.clear()
        return taken

    def wake(self) -> None:
        """End the wait of `take`."""
        with self._ready:
            self._ready.notify()


class Changes:
    """Passes changes on to the arm; any thread puts them.

    While one change is compiled, in a context `compiling()`, the oldest of very many others are
    dropped, see Inbox.
    """

    def __init__(
        self,
        engine: Engine,
        inbox: Inbox,
        refuse: Callable[[str, Verdict], None],
        compiling: Callable[[], AbstractContextManager[None]],
    ) -> None:
        self._engine, self._inbox, self._compiling = engine, inbox, compiling
        self._waiting = Inbox(refuse)
        self.wake = self._waiting.wake
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
                with COMPILATION, self._compiling():
                    self._engine.prepare(role, data)
                self._inbox.put(role, data, verdict)
                # The next one is prepared for the arm that this one changes.
                while not (verdict.done() or stopped()):
                    wait([verdict], LOOK_SECONDS)
