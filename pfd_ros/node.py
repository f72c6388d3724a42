# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Starts the node `sim_arm` and takes its signals; the entry point `sim_node`.

A second SIGINT (a terminal sends one, a launcher another) interrupts whatever cleans up after
the first. So the handlers only set a flag, from before the slow imports until the interpreter
goes down.
"""

from __future__ import annotations

import signal
import sys
import threading

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT, SIGTERM or SIGHUP; return its exit status.

    Parameters
    ----------
    args
        Command line without the program's name; None takes the process's own.
    """
    stop = threading.Event()
    for number in SIGNALS:
        signal.signal(number, lambda *_: stop.set())
    try:
        from pfd_ros.process import run

        return run(sys.argv[1:] if args is None else args, stop)
    finally:
        # A signal from here on would turn a clean exit into a killed one.
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)


if __name__ == '__main__':
    raise SystemExit(main())
