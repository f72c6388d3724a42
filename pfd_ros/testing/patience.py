# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Interrupt a controller that blocks: a thread monitors it and sends a signal to the main thread.

The controller runs in the thread of the test. A signal whose handler raises interrupts Python code
there: a sleep, a lock, a socket, a loop. C code that ignores signals is not interrupted.
"""

from __future__ import annotations

from collections.abc import Sequence
import signal
import sys
import threading
import time
import traceback
from types import FrameType
from typing import Any, NamedTuple

# Longest wait for an answer, s of wall time, by default.
PATIENCE_SECONDS = 2.0
# For a process to start and to be found, s.
START_PATIENCE_SECONDS = 20.0
# Most seconds until a state is sent again.
RESEND_SECONDS = 1.0
# Period of checks of the main thread, s.
LOOK_SECONDS = 0.05
# Share of the patience in which the watching thread must have run, too.
WATCHED = 0.4
# Ignored by default, so that one that comes late does no harm, and used by few.
SIGNAL = signal.SIGURG
# Of a stack, in the text of an error.
MOST_FRAMES = 12
# The modules that call a controller; frames up to them are not the controller's.
OURS = 'pfd_ros.testing.'


class Waits(NamedTuple):
    """Longest waits for controllers over topics, s of wall time.

    Attributes
    ----------
    patience
        For the answer to a state.
    start
        Until a controller of another process is found.
    """

    patience: float = PATIENCE_SECONDS
    start: float = START_PATIENCE_SECONDS

    def start_of(self, nodes: Sequence[Any], processes: Sequence[Any]) -> float:
        """Return how long to wait for controllers."""
        return self.patience if nodes and not processes else self.start

    @property
    def resend(self) -> float:
        """Until a state without an answer is sent again; its reader may not have been ready."""
        return min(RESEND_SECONDS, self.patience / 2)


class BlockedError(BaseException):
    """Raised in a controller that blocks; no `except Exception` there catches it."""


class Watch:
    """A context in which a turn of the controller may take `patience` s of wall time.

    It works in the main thread alone: Python runs no handler of a signal elsewhere.

    Attributes
    ----------
    since
        The time.perf_counter() at which a turn of the controller began; 0.0 between its turns.
    stack
        Where the controller blocked, as a traceback has it; '' if it did not.
    """

    __slots__ = ('_before', '_blocked', '_looked', '_looks', '_patience', 'since', 'stack')

    def __init__(self, patience: float) -> None:
        if not patience > 0.0:
            raise ValueError(f'patience is {patience!r}, expected above zero, s')
        self._patience = patience
        self.since = self._blocked = self._looked = 0.0
        self._looks = 0
        self.stack = ''
        self._before: Any = None

    def __enter__(self) -> Watch:
        """Begin to watch."""
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(SIGNAL, self._interrupt)
            _WATCHER.add(self)
        return self

    def __exit__(self, *error: object) -> None:
        """Watch no longer."""
        self.since = 0.0
        if self in _WATCHER.watches:
            _WATCHER.watches.remove(self)
            signal.signal(SIGNAL, self._before or signal.SIG_DFL)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        # The main thread alone sets `since`: if it is still the same, so is the turn.
        if self._blocked and self.since == self._blocked:
            raise BlockedError
        if callable(self._before):
            self._before(number, frame)

    def look(self) -> None:
        """Interrupt a controller that takes too long; the thread that watches calls it."""
        since = self.since
        self._looks = self._looks + 1 if since == self._looked else 0
        self._looked = since
        waited = time.perf_counter() - since
        if not since or waited <= self._patience:
            return
        # If this thread did not run either, the machine was suspended or overloaded.
        if self._looks * LOOK_SECONDS < WATCHED * self._patience:
            return
        main = threading.main_thread().ident
        assert main is not None
        stack = stack_of(sys._current_frames().get(main))
        # Without a frame of the controller it is an executor that waits.
        if stack and self.since == since:
            self.stack, self._blocked = self.stack or stack, since
            # Again with each look: a controller may have caught the last one.
            signal.pthread_kill(main, SIGNAL)


class _Watcher:
    """The watching thread; the first watch starts it, and it sleeps without a watch."""

    def __init__(self) -> None:
        self.watches: list[Watch] = []
        self._begun = threading.Event()
        self._thread: threading.Thread | None = None

    def add(self, watch: Watch) -> None:
        self.watches.append(watch)
        self._begun.set()
        # In a forked process the thread is gone.
        if self._thread is None or not self._thread.is_alive():
            self._thread = threading.Thread(target=self._run, name='patience', daemon=True)
            self._thread.start()

    def _run(self) -> None:
        while self._begun.wait():
            self._begun.clear()
            while self.watches:
                for watch in list(self.watches):
                    watch.look()
                time.sleep(LOOK_SECONDS)


_WATCHER = _Watcher()


def stack_of(frame: FrameType | None) -> str:
    """Return the stack of a controller, innermost call last, without the frames of its caller."""
    frames: list[FrameType] = []
    while frame is not None and not frame.f_globals.get('__name__', '').startswith(OURS):
        frames.insert(0, frame)
        frame = frame.f_back
    summary = traceback.StackSummary.extract((f, f.f_lineno) for f in frames[-MOST_FRAMES:])
    return ''.join(summary.format()).rstrip()
