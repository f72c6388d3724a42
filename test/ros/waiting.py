# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Wait for what another thread or process does."""

from __future__ import annotations

from collections.abc import Callable
import threading
import time
from typing import Any

# Longest wait for anything a process should do [s]: discovery alone may take three seconds, and
# compiling a robot on a machine with twenty times its load some minutes. Nothing is measured
# against it.
PATIENCE = 240.0


def _late() -> str:
    threads = ', '.join(thread.name for thread in threading.enumerate())
    return f'not within {PATIENCE:g} s; threads alive: {threads}'


def wait_until(
    done: Callable[[], Any], told: Callable[[], Any] = _late, pause: float = 1e-3
) -> None:
    """Poll every `pause` s until `done` is true; fail with the text of `told` after PATIENCE."""
    deadline = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < deadline, told()
        time.sleep(pause)


def threads_named(name: str) -> list[threading.Thread]:
    """Return the threads of this process with a name."""
    return [thread for thread in threading.enumerate() if thread.name == name]
