# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Interrupt a controller that blocks: a thread watches it and sends a signal to the main thread.

The controller runs in the thread of the test. A signal whose handler raises interrupts Python code
there: a sleep, a lock, a socket, a loop. C code that ignores signals is not interrupted.
"""

from __future__ import annotations

from collections.abc import Callable
import signal
import sys
import threading
import time
import traceback
from types import FrameType
from typing import Any

from pfd_ros.testing.trajectory import checked_numbers

# Longest time for the answer to a message, and until a controller of another process is found, s
# of wall time, by default.
PATIENCE_SECONDS, START_PATIENCE_SECONDS = 5.0, 20.0
# Period of looks at the main thread, s.
LOOK_SECONDS = 0.05
# Share of the patience in which the watching thread must have run, too: otherwise the machine was
# suspended or overloaded.
WATCHED = 0.4
# Ignored by default, so that one that comes late does no harm, and used by few.
SIGNAL = signal.SIGURG
# Of a stack, in the text of an error.
MOST_FRAMES = 12
# The frames of these modules call the controller: first ours, then perhaps an executor's.
OURS, EXECUTOR = 'pfd_ros.testing.', 'rclpy.'


class BlockedError(BaseException):
    """Raised in a controller that blocks; no `except Exception` there catches it."""


class Watch:
    """A context in which a turn of the controller may take `patience` s of wall time.

    It works in the main thread alone: Python runs no handler of a signal elsewhere. `wake` is
    called if no signal has helped for as long again: it is to end a wait in C code. `since` is the
    time.perf_counter() at which a turn began, 0.0 between turns. `stack` is where the controller
    blocked, '' if it did not; it stays, even if the controller caught what interrupted it.
    """

    # Slots are faster: `since` is set twice for each state.
    __slots__ = ('_before', '_blocked', '_ended', '_wake', 'patience', 'since', 'stack')

    def __init__(self, patience: float, wake: Callable[[], object] = lambda: None) -> None:
        checked_numbers('patience', patience, ((),), 'one number above 0', lambda x: x > 0.0)
        self.patience, self._wake = patience, wake
        self.since = self._blocked = 0.0
        self.stack = ''
        self._ended: threading.Event | None = None
        self._before: Any = None

    def __enter__(self) -> Watch:
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(SIGNAL, self._interrupt)
            self._ended = threading.Event()
            watching = threading.Thread(
                target=self._run, args=(self._ended,), name='patience', daemon=True
            )
            watching.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.since = 0.0
        if self._ended is not None:
            signal.signal(SIGNAL, self._before or signal.SIG_DFL)
            self._ended.set()

    def report(self, time: float, answers: int) -> str:
        """Return the error about the state at which the controller blocks, `answers` before it."""
        return (
            f'the controller blocks: no answer for {self.patience:g} s to the state at '
            f't = {time:.6g} s, after {answers} answers; it is here:\n{self.stack}'
        )

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        # The main thread alone sets `since`: if it is still the same, so is the turn.
        if self._blocked and self.since == self._blocked:
            raise BlockedError
        if callable(self._before):
            self._before(number, frame)

    def _run(self, ended: threading.Event) -> None:
        main, looked, looks = threading.main_thread().ident, 0.0, 0
        assert main is not None
        while not ended.wait(LOOK_SECONDS):
            since = self.since
            looks, looked = (looks + 1 if since == looked else 0), since
            waited = time.perf_counter() - since
            seen = looks * LOOK_SECONDS > WATCHED * self.patience
            if not (since and waited > self.patience and seen):
                continue
            stack = stack_of(sys._current_frames().get(main))
            # Without a frame of the controller it is an executor that waits.
            if stack and self.since == since:
                self.stack, self._blocked = self.stack or stack, since
                # Again with each look: a controller may have caught the last one.
                signal.pthread_kill(main, SIGNAL)
            if waited > 2.0 * self.patience and self.stack:
                self._wake()


def stack_of(frame: FrameType | None) -> str:
    """Return the stack of a controller, innermost call last, without the frames of its caller."""
    frames: list[FrameType] = []
    while frame is not None and not frame.f_globals.get('__name__', '').startswith(OURS):
        frames.insert(0, frame)
        frame = frame.f_back
    while frames and frames[0].f_globals.get('__name__', '').startswith(EXECUTOR):
        del frames[0]
    summary = traceback.StackSummary.extract((f, f.f_lineno) for f in frames[-MOST_FRAMES:])
    return ''.join(summary.format()).rstrip()
