# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Log lines before and after compilation, which takes seconds at a first start."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import logging
import time

from pfd_ros.text import cut

# The logger of pfd_core that has a record for each compiled module.
COMPILE_LOG = logging.getLogger('pfd_core.compile')


@contextmanager
def compile_report(log: Callable[[str], object], robot: str) -> Iterator[None]:
    """Log that native code for a robot is compiled, and how long it took; nothing if cached."""
    begun = time.monotonic()
    report = _First(
        lambda: log(f'Compiling native code for {cut(robot)!r} (first start; cached afterwards)')
    )
    level = COMPILE_LOG.level
    COMPILE_LOG.addHandler(report)
    COMPILE_LOG.setLevel(logging.INFO)
    try:
        yield
    finally:
        COMPILE_LOG.removeHandler(report)
        COMPILE_LOG.setLevel(level)
    if report.count:
        log(f'Compiled native code for {cut(robot)!r} in {time.monotonic() - begun:.1f} s')


class _First(logging.Handler):
    """Calls a function at the first record."""

    def __init__(self, call: Callable[[], object]) -> None:
        super().__init__()
        self.count = 0
        self._call = call

    def emit(self, record: logging.LogRecord) -> None:
        """Count a record."""
        self.count += 1
        if self.count == 1:
            self._call()
