# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Print the errors of the node's period and its share of a core.

    python benchmarks/node_timing.py [--seconds 10] [--rounds 2] [--rate 1000]

The node, with and without a recording, takes turns with a bare loop of `time.sleep`, so that a
load from elsewhere meets all of them: compare ratios.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import threading
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Seconds before the measurement: discovery, first report.
SETTLES, PATIENCE = 2.0, 60.0


def show(times_ns: NDArray[Any], period_ns: float, cpu: float) -> None:
    """Print the errors of a loop's period as JSON."""
    errors = np.abs(np.diff(times_ns) - period_ns) / 1e3
    seconds = (times_ns[-1] - times_ns[0]) / 1e9
    found = {f'p{k}': float(np.percentile(errors, k)) for k in (50, 99, 100)}
    rate = (len(times_ns) - 1) / seconds
    print(json.dumps(found | {'rate': rate, 'core': cpu / seconds}), flush=True)


def bare_loop(seconds: float, rate: float) -> None:
    """Run an empty loop on the schedule of the node."""
    times = np.zeros(int(seconds * rate), np.int64)
    begun, cpu = time.monotonic_ns(), time.process_time()
    for k in range(len(times)):
        left = begun + (k + 1) * 1e9 / rate - time.monotonic_ns()
        if left > 0:
            time.sleep(left / 1e9)
        times[k] = time.monotonic_ns()
    show(times, 1e9 / rate, time.process_time() - cpu)


def node_loop(seconds: float, rate: float, args: Sequence[str]) -> None:
    """Run the node, and note when each of its cycles begins."""
    from pfd_ros.node import main
    from pfd_ros.node.stepping import Stepper

    times: list[int] = []
    real: Any = Stepper.run_cycle

    def run_cycle(stepper: Any) -> None:
        times.append(time.monotonic_ns())
        real(stepper)

    def measure() -> None:
        while not times:
            time.sleep(0.1)
        time.sleep(SETTLES)
        cpu, first = time.process_time(), len(times)
        time.sleep(seconds)
        cpu, last = time.process_time() - cpu, len(times)
        show(np.array(times[first:last]), 1e9 / rate, cpu)
        os.kill(os.getpid(), signal.SIGINT)

    setattr(Stepper, 'run_cycle', run_cycle)  # noqa: B010
    threading.Thread(target=measure, daemon=True).start()
    raise SystemExit(main.main(['--ros-args', '-p', f'step_size:={1 / rate!r}', *args]))


def measured(kind: str, given: argparse.Namespace, *args: str) -> dict[str, float]:
    """Run a loop in a process of its own, and return the numbers that it prints."""
    size = ['--seconds', str(given.seconds), '--rate', str(given.rate)]
    command = [sys.executable, __file__, *size, '--run', kind, '--', *args]
    patience = given.seconds + PATIENCE
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=patience)
    lines = [line for line in done.stdout.splitlines() if line.startswith('{')]
    if not lines:
        raise RuntimeError(f'no result of {kind}: {done.stdout}{done.stderr}')
    found: dict[str, float] = json.loads(lines[0])
    return found


def compare(given: argparse.Namespace, folder: Path) -> None:
    """Print the period errors of a bare loop and of the node, in turns."""
    for k in range(given.rounds):
        recording = '-p', f'recording:={folder}/arm_{k}.mcap'
        runs = {'bare': measured('bare', given), 'node': measured('node', given)}
        runs['recording'] = measured('node', given, *recording)
        for name, found in runs.items():
            print(
                f'{name:10} error p50 {found["p50"]:7.1f} us, p99 {found["p99"]:7.1f} us '
                f'({found["p99"] / runs["bare"]["p99"]:5.2f} of bare), max {found["p100"]:8.1f} '
                f'us; {found["rate"]:8.2f} Hz; {100 * found["core"]:5.1f} % of a core',
                flush=True,
            )


def main() -> None:
    parser = argparse.ArgumentParser(description='Measure the timing of the node.')
    parser.add_argument('--seconds', type=float, default=10.0)
    parser.add_argument('--rounds', type=int, default=2)
    parser.add_argument('--rate', type=float, default=1000.0)
    parser.add_argument('--run', choices=['bare', 'node'], help=argparse.SUPPRESS)
    parser.add_argument('args', nargs='*', help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.run == 'bare':
        bare_loop(given.seconds, given.rate)
    elif given.run == 'node':
        node_loop(given.seconds, given.rate, given.args)
    else:
        from pfd_ros.testing.session import claimed_domain

        with claimed_domain(), tempfile.TemporaryDirectory() as folder:
            compare(given, Path(folder))


if __name__ == '__main__':
    main()
