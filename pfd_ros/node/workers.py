# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Supervised threads: if one ends unexpectedly, all of them are stopped.

An arm that receives nothing or does not step must not look like an arm that works.
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
        Descriptions of workers that ended unexpectedly.
    """

    stop: threading.Event
    failures: list[str] = field(default_factory=list)

    def start(
        self, name: str, work: Callable[[], None], stopped: Callable[[], bool] | None = None
    ) -> threading.Thread:
        """Start a thread; `stopped` returns whether this thread alone has been asked to end."""
        thread = threading.Thread(
            target=self.guard, args=(name, work, stopped), name=name, daemon=True
        )
        thread.start()
        return thread

    def guard(
        self, name: str, work: Callable[[], None], stopped: Callable[[], bool] | None = None
    ) -> None:
        """Run work on this thread; it should last until it, or every worker, is stopped."""
        try:
            work()
            if stopped is not None and stopped():
                return
            if not self.stop.is_set():
                self.failures.append(f'{name} ended unexpectedly')
        except BaseException as error:
            self.failures.append(f'{name} failed: {described(error)}')
        self.stop.set()

    def join(self, thread: threading.Thread, seconds: float) -> bool:
        """Wait for a thread to end; return whether it has ended in time."""
        thread.join(seconds)
        if thread.is_alive():
            self.failures.append(f'{thread.name} did not end within {seconds} s')
        return not thread.is_alive()


def described(error: BaseException) -> str:
    """Return one line about an unexpected error, with its location."""
    where = traceback.extract_tb(error.__traceback__)[-1]
    return one_line(
        f'{type(error).__name__}: {error} ({os.path.basename(where.filename)}:{where.lineno})'
    )
