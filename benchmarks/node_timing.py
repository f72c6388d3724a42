# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The timing of the node: errors of its period, its share of a core, round trips in lockstep.

    python benchmarks/node_timing.py period [--seconds 10] [--rounds 2] [--rate 1000]
    python benchmarks/node_timing.py lockstep [--seconds 10] [--rounds 2]

`period` compares the node, with and without a recording, with a bare loop of `time.sleep` that
runs in turn with it, and prints the share of a core of each. `lockstep` compares the node with
a bare ping-pong of the same messages between two processes of rclpy with the same executor. Both
take turns, so that a load from elsewhere meets all of them; compare ratios, not numbers.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
import json
import os
from pathlib import Path
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from typing import Any

import numpy as np

NODE_SETTLES = 2.0  # s, without a look at it: discovery, first report
PATIENCE = 60.0
NAMES = [f'joint{i}' for i in range(1, 7)]


# In the processes that are measured


def cpu_seconds() -> float:
    """Return the time that this process has spent on all cores, s."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def show(times_ns: np.ndarray, period_ns: float, cpu: float) -> None:
    """Print the errors of a loop's period as JSON."""
    errors = np.abs(np.diff(times_ns) - period_ns) / 1e3
    seconds = (times_ns[-1] - times_ns[0]) / 1e9
    print(
        json.dumps(
            {
                'p50_us': float(np.percentile(errors, 50)),
                'p99_us': float(np.percentile(errors, 99)),
                'max_us': float(errors.max()),
                'mean_rate': (len(times_ns) - 1) / seconds,
                'core': cpu / seconds,
            }
        ),
        flush=True,
    )


def bare_loop(seconds: float, rate: float) -> None:
    """Run an empty loop on the schedule of the node."""
    period_ns = 1e9 / rate
    times = np.zeros(int(seconds * rate), np.int64)
    begun, cpu = time.monotonic_ns(), cpu_seconds()
    for k in range(len(times)):
        left = begun + (k + 1) * period_ns - time.monotonic_ns()
        if left > 0:
            time.sleep(left / 1e9)
        times[k] = time.monotonic_ns()
    show(times, period_ns, cpu_seconds() - cpu)


def node_loop(seconds: float, rate: float, args: Sequence[str]) -> None:
    """Run the node, and note when each of its cycles begins."""
    from pfd_ros.node import main
    from pfd_ros.node.stepping import Stepper

    times = np.zeros(int(2 * seconds * rate), np.int64)
    count, cpu = 0, 0.0
    real = Stepper.run_cycle

    def run_cycle(stepper: Stepper) -> None:
        nonlocal count
        if count < len(times):
            times[count] = time.monotonic_ns()
            count += 1
        real(stepper)

    def measure() -> None:
        nonlocal count, cpu
        while not count:
            time.sleep(0.1)
        time.sleep(NODE_SETTLES)
        cpu, count = -cpu_seconds(), 0
        time.sleep(seconds)
        cpu += cpu_seconds()
        last = count
        show(times[:last], 1e9 / rate, cpu)
        os.kill(os.getpid(), signal.SIGINT)

    Stepper.run_cycle = run_cycle  # type: ignore[method-assign]
    threading.Thread(target=measure, daemon=True).start()
    raise SystemExit(main.main(['--ros-args', '-p', f'step_size:={1 / rate!r}', *args]))


def spin(node: Any, done: Callable[[], bool]) -> None:
    """Run the callbacks of a node until something is done."""
    from rclpy.experimental.events_executor import EventsExecutor
    from rclpy.task import Future

    executor = EventsExecutor()
    executor.add_node(node)
    while not done():
        executor.spin_until_future_complete(Future(), 0.05)


def pinging(seconds: float) -> None:
    """Answer each state, and print how many came in a second."""
    import rclpy
    from sensor_msgs.msg import JointState

    rclpy.init()
    node = rclpy.create_node('pinging')
    publisher = node.create_publisher(JointState, 'joint_commands', 1)
    command = JointState(name=NAMES, effort=[0.0] * 6)
    stamps: list[int] = []

    def on_state(state: JointState) -> None:
        # A state that is sent again counts once.
        stamps.append(state.header.stamp.sec * 1_000_000_000 + state.header.stamp.nanosec)
        command.header.stamp = state.header.stamp
        publisher.publish(command)

    node.create_subscription(JointState, 'joint_states', on_state, 1)
    spin(node, lambda: bool(stamps) and publisher.get_subscription_count() > 0)
    until = time.monotonic() + NODE_SETTLES
    spin(node, lambda: time.monotonic() > until)
    begun, stamps[:] = time.monotonic(), []
    spin(node, lambda: time.monotonic() - begun > seconds)
    print(json.dumps({'rate': len(set(stamps)) / (time.monotonic() - begun)}), flush=True)


def ponging() -> None:
    """Answer each command with a state: an arm without an arm in it."""
    import rclpy
    from sensor_msgs.msg import JointState

    rclpy.init()
    node = rclpy.create_node('ponging')
    publisher = node.create_publisher(JointState, 'joint_states', 10)
    state = JointState(name=NAMES, position=[0.0] * 6, velocity=[0.0] * 6, effort=[0.0] * 6)
    count = newest = 0

    def on_command(command: JointState) -> None:
        nonlocal count, newest
        newest = time.monotonic_ns()
        count += 1
        state.header.stamp.sec, state.header.stamp.nanosec = divmod(count, 1_000_000_000)
        publisher.publish(state)

    def on_timer() -> None:
        if time.monotonic_ns() - newest > 100_000_000:
            publisher.publish(state)

    node.create_subscription(JointState, 'joint_commands', on_command, 1)
    node.create_timer(0.1, on_timer)
    spin(node, lambda: False)


# In the process that measures


def start(*args: str) -> subprocess.Popen[str]:
    """Start this script in another role."""
    command = [sys.executable, __file__, *args]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def result(process: subprocess.Popen[str]) -> dict[str, float]:
    """Return the numbers that a process prints, and end it."""
    assert process.stdout is not None
    line = next(line for line in process.stdout if line.startswith('{'))
    process.wait(PATIENCE)
    found: dict[str, float] = json.loads(line)
    return found


def compare_periods(seconds: float, rounds: int, rate: float) -> None:
    """Print the period errors of a bare loop and of the node, in turns."""
    size = str(seconds), str(rate)
    with tempfile.TemporaryDirectory() as folder:
        for k in range(rounds):
            recording = Path(folder) / f'arm_{k}.mcap'
            runs = {
                'bare': result(start('bare', *size)),
                'node': result(start('node', *size)),
                'recording': result(start('node', *size, '-p', f'recording:={recording}')),
            }
            for name, found in runs.items():
                ratio = found['p99_us'] / runs['bare']['p99_us']
                print(
                    f'{name:10} error p50 {found["p50_us"]:7.1f} us, '
                    f'p99 {found["p99_us"]:7.1f} us ({ratio:5.2f} of bare), '
                    f'max {found["max_us"]:8.1f} us; '
                    f'{found["mean_rate"]:8.2f} Hz; {100 * found["core"]:5.1f} % of a core',
                    flush=True,
                )


def compare_round_trips(seconds: float, rounds: int) -> None:
    """Print the round trips per second of a bare ping-pong and of the node in lockstep."""
    arms = {
        'bare': ('pong',),
        'node': ('arm',),
        'no clock': ('arm', '-p', 'publish_clock:=false'),
    }
    with tempfile.TemporaryDirectory() as folder:
        for k in range(rounds):
            rates = {}
            arms['recording'] = ('arm', '-p', f'recording:={folder}/arm_{k}.mcap')
            for name, command in arms.items():
                arm = start(*command)
                try:
                    rates[name] = result(start('ping', str(seconds)))['rate']
                finally:
                    arm.send_signal(signal.SIGINT if command[0] == 'arm' else signal.SIGKILL)
                    arm.wait(PATIENCE)
                print(
                    f'{name:10} {rates[name]:8.0f} round trips/s, '
                    f'{rates[name] / rates["bare"]:5.2f} of bare',
                    flush=True,
                )


def main() -> None:
    """Run the benchmark, or a process of it."""
    role, rest = (sys.argv[1], sys.argv[2:]) if len(sys.argv) > 1 else ('', [])
    if role == 'bare':
        bare_loop(float(rest[0]), float(rest[1]))
    elif role == 'node':
        node_loop(float(rest[0]), float(rest[1]), rest[2:])
    elif role == 'arm':
        from pfd_ros.node import main as node

        lockstep = ['-p', 'lockstep:=true', '-p', 'real_time_factor:=0.0']
        raise SystemExit(node.main(['--ros-args', *lockstep, *rest]))
    elif role == 'ping':
        pinging(float(rest[0]))
    elif role == 'pong':
        ponging()
    else:
        parser = argparse.ArgumentParser(description='Measure the timing of the node.')
        parser.add_argument('what', choices=['period', 'lockstep'])
        parser.add_argument('--seconds', type=float, default=10.0)
        parser.add_argument('--rounds', type=int, default=2)
        parser.add_argument('--rate', type=float, default=1000.0)
        chosen = parser.parse_args()
        from pfd_ros.testing.session import claimed_domain

        with claimed_domain():
            if chosen.what == 'period':
                compare_periods(chosen.seconds, chosen.rounds, chosen.rate)
            else:
                compare_round_trips(chosen.seconds, chosen.rounds)


if __name__ == '__main__':
    main()
