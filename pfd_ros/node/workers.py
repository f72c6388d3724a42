# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Threads that are watched: the end of one, by itself or by an error, stops all of them.

An arm that is deaf, or does not step, must not look like an arm that works.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
import os
import threading
import traceback

from pfd_ros.text import one_line


@dataclass
class Workers:
    """The threads of one process.

    Parameters
    ----------
    stop
        Set by a signal, and here when a worker ends.

    Attributes
    ----------
    failures
        How workers ended before they were told to.
    """

    stop: threading.Event
    failures: list[str] = field(default_factory=list)

    def start(
        self, name: str, work: Callable[[], None], told: Callable[[], bool] | None = None
    ) -> threading.Thread:
        """Start a thread; `told` says whether it alone has been told to end."""
        thread = threading.Thread(
            target=self.guard, args=(name, work, told), name=name, daemon=True
        )
        thread.start()
        return thread

    def guard(
        self, name: str, work: Callable[[], None], told: Callable[[], bool] | None = None
    ) -> None:
        """Do some work on this thread that should last until it is told to end, or all are."""
        try:
            work()
            if told is not None and told():
                return
            if not self.stop.is_set():
                self.failures.append(f'{name} ended by itself')
        except BaseException as error:
            self.failures.append(f'{name} failed: {described(error)}')
        self.stop.set()

    def join(self, thread: threading.Thread, seconds: float) -> bool:
        """Wait for a thread to end, but not for ever; return whether it has ended."""
        thread.join(seconds)
        if thread.is_alive():
            self.failures.append(f'{thread.name} did not end within {seconds} s')
        return not thread.is_alive()


def described(error: BaseException) -> str:
    """Return one line about an error that nobody expected, with its place."""
    where = traceback.extract_tb(error.__traceback__)[-1]
    return one_line(
        f'{type(error).__name__}: {error} ({os.path.basename(where.filename)}:{where.lineno})'
    )
