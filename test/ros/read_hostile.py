# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replays files in this process and prints the outcome of each, one JSON object a line.

    python read_hostile.py OPTION SECONDS FILE ...

OPTION is one of `pfd replay`, such as --verify.

A file that takes more than SECONDS of processor time is given up.
"""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import io
import json
from pathlib import Path
import resource
import signal
import sys
import traceback
from typing import Any

from bridge import pfd_main


class TooLongError(BaseException):
    """Not an Exception: nothing may catch it."""


def give_up(*_: object) -> None:
    raise TooLongError


@contextlib.contextmanager
def bounded(seconds: float) -> Iterator[None]:
    """Raise TooLongError after so much processor time of this process."""
    before = signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def replay(option: str, path: str, seconds: float) -> dict[str, Any]:
    out, err = io.StringIO(), io.StringIO()
    try:
        with (
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
            bounded(seconds),
        ):
            status = pfd_main(['replay', path, option])
    except BaseException:
        status = -1
        err.write(traceback.format_exc())
    return {'status': status, 'out': out.getvalue(), 'err': err.getvalue(), 'peak_mb': peak_mb()}


def verified(path: Path) -> tuple[int, str]:
    """Return status and output of `pfd replay --verify`, above a minute an error."""
    found = replay('--verify', str(path), 60.0)
    return found['status'], found['out'] + found['err']


def peak_mb() -> float:
    """Return the most memory that this process has held; ru_maxrss begins with the parent's."""
    status = Path('/proc/self/status')
    if not status.exists():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    (line,) = (line for line in status.read_text().splitlines() if line.startswith('VmHWM'))
    return int(line.split()[1]) / 1024


if __name__ == '__main__':
    # Pictures of runs with a change take most of the time, and show nothing about a file.
    sys.modules['matplotlib.figure'] = None  # type: ignore[assignment]
    for name in sys.argv[3:]:
        print(json.dumps(replay(sys.argv[1], name, float(sys.argv[2]))), flush=True)
