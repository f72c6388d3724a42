# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Start the node `sim_arm` and handle its signals; the entry point `sim_node`.

A second SIGINT (a terminal sends one, a launcher another) would interrupt the clean-up after the
first. So signals are only counted, from before the slow imports until the interpreter ends. The
first stops the node, and the second has no effect. The third ends the process after one second, in
which a clean-up that does not hang finishes.
"""

from __future__ import annotations

from contextlib import suppress
import gc
import os
import select
import signal
import sys
import threading
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pfd_ros.node.process import Companion

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
LAST = 3
# A normal clean-up takes a fraction of this, and signals may come in bursts.
GRACE_SECONDS = 1.0
# A shell adds the number of the signal that ended a process.
STATUS_BASE = 128
# How long the thread that steps the arm may wait for another, as the recorder's; Python's own
# 5 ms are five periods.
SWITCH_SECONDS = 1e-4


class Stop(threading.Event):
    """Set by the first signal, whose number it has; 0 if something else has set it."""

    number = 0


def stop_on_signals() -> Stop:
    """Return an event that the first signal sets; the third ends the process.

    SIGHUP stays ignored where it was, as under nohup. SIGINT does not: a shell starts a process
    in the background with SIGINT ignored, and such a node must end, too. Signals are counted on a
    separate thread: a main thread that hangs in C runs no handler.
    """
    stop = Stop()
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    for number in SIGNALS:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            # The interpreter writes to the pipe only where a signal has a handler.
            signal.signal(number, lambda *_: None)

    def count() -> None:
        received = 0
        while received < LAST:
            number = os.read(reading, 1)[0]
            if number in SIGNALS:
                received += 1
                stop.number = stop.number or number
                stop.set()
        time.sleep(GRACE_SECONDS)
        # A reader of the output that is gone or hangs must not keep the process alive.
        with suppress(OSError):
            if select.select([], [2], [], 0.0)[1]:
                os.write(2, b'ended by a third signal; a recording may not be closed\n')
        os._exit(STATUS_BASE + number)

    threading.Thread(target=count, name='signals', daemon=True).start()
    return stop


def main(
    args: list[str] | None = None,
    stop: threading.Event | None = None,
    companion: Companion | None = None,
) -> int:
    """Run the node until SIGINT, SIGTERM or SIGHUP; return its exit status.

    `args` is the command line without the program's name, by default the one of the process, and
    `stop` comes from `stop_on_signals`, if the caller has called it already. A companion is
    started with the arm, and ends with the node.
    """
    if stop is None:
        stop = stop_on_signals()
    # Collections during imports cost time; `run` enables them after the start.
    gc.disable()
    sys.setswitchinterval(SWITCH_SECONDS)
    try:
        from pfd_ros.node.process import run

        return run(sys.argv[1:] if args is None else args, stop, companion)
    finally:
        # `run` has set an alarm.
        ignore_signals()


def ignore_signals() -> None:
    """Ignore signals from here on: one would turn a clean exit into a killed one."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


if __name__ == '__main__':
    raise SystemExit(main())
