# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Supervised threads: if one ends unexpectedly, the process is stopped. One line for an error."""

from __future__ import annotations

from collections.abc import Callable
import os
import threading
import traceback

from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.qos_overriding_options import InvalidQosOverridesError

from pfd_ros.text import one_line

# For each thread to end, and for ROS and the interpreter to go down.
END_SECONDS = 10
# Errors of rclpy and this package for a wrong argument, parameter or file.
MISTAKES = (
    ValueError,
    OSError,
    RuntimeError,
    ParameterException,
    NameValidationException,
    InvalidQosOverridesError,
)


class Threads:
    """The threads of one process; `stop` is set by a signal, and when a thread ends."""

    def __init__(self, stop: threading.Event) -> None:
        self.stop = stop
        self.failures: list[str] = []

    def start(
        self, name: str, work: Callable[[], object], stopped: Callable[[], bool] | None = None
    ) -> threading.Thread:
        """Start a thread; `stopped` returns whether this thread alone has been asked to end."""
        thread = threading.Thread(
            target=self.guard, args=(name, work, stopped), name=name, daemon=True
        )
        thread.start()
        return thread

    def guard(
        self, name: str, work: Callable[[], object], stopped: Callable[[], bool] | None = None
    ) -> None:
        """Run work on this thread; it should last until it, or the process, is stopped."""
        try:
            work()
            if stopped is not None and stopped():
                return
            if not self.stop.is_set():
                self.failures.append(f'{name} ended unexpectedly')
        except BaseException as error:
            self.failures.append(f'{name} failed: {described(error)}')
        self.stop.set()

    def join(self, thread: threading.Thread) -> bool:
        """Wait for a thread to end; return whether it has ended in time."""
        thread.join(END_SECONDS)
        if thread.is_alive():
            self.failures.append(f'{thread.name} did not end within {END_SECONDS} s')
        return not thread.is_alive()


def reason(error: Exception) -> str:
    """Return one line about a mistake of the user, which names the file that it is about."""
    if isinstance(error, OSError) and error.filename and error.strerror:
        return one_line(f'{error.filename}: {error.strerror}')
    # Without a home folder that can be written, as in containers.
    hint = '; ROS_LOG_DIR=FOLDER chooses another' if 'initialize logging' in str(error) else ''
    return one_line(f'{error}{hint}')


def described(error: BaseException) -> str:
    """Return one line about an unexpected error, with its location."""
    where = traceback.extract_tb(error.__traceback__)[-1]
    return one_line(
        f'{type(error).__name__}: {error} ({os.path.basename(where.filename)}:{where.lineno})'
    )
