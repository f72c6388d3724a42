# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The start of the node: from its process to its first state, and where the time goes.

    python benchmarks/start_up.py [--rounds 5] [--robot ur5]

A start ends when the node hands its first state to ROS; discovery by a subscriber comes on top.
First starts have an empty cache of native code, warm starts the cache of the start before. They
take turns with a bare node of rclpy that publishes one JointState, so that a load from elsewhere
meets all of them: compare ratios. Processor time (user and system, of all threads) depends less
on such a load than wall time does. Stage times are from the warm start whose wall time is
the least.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import resource
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from typing import Any

PATIENCE = 120.0  # s
KINDS = ('bare', 'first', 'warm')
# The stages of a start, each from the end of the stage before.
STAGES = ('interpreter', 'imports', 'rclpy.init', 'node', 'model, kernels, topics', 'first state')


# In the processes that are measured


def spent() -> tuple[float, float]:
    """Return wall time [s since the epoch] and the processor time of this process, s."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return time.time(), used.ru_utime + used.ru_stime


def show(marks: dict[str, tuple[float, float]]) -> None:
    """Print the ends of stages as JSON, and end this process."""
    print(json.dumps(marks), flush=True)
    os.kill(os.getpid(), signal.SIGTERM)


def bare() -> None:
    """Publish one message by rclpy alone."""
    marks = {'interpreter': spent()}
    import rclpy
    from rclpy.node import Node
    from sensor_msgs.msg import JointState

    marks['imports'] = spent()
    rclpy.init()
    marks['rclpy.init'] = spent()
    node = Node('bare')
    publisher = node.create_publisher(JointState, 'joint_states', 10)
    marks['node'] = spent()
    publisher.publish(JointState())
    marks['first state'] = spent()
    show(marks)


def sim(robot: str) -> None:
    """Run `pfd sim`, and note when its stages end."""
    marks = {'interpreter': spent()}
    from pfd_ros.cli import main as command
    from pfd_ros.node import main as node_main

    run_main = node_main.main

    def main(*args: Any) -> int:
        import gc

        gc.disable()  # as `main` does before these imports
        from pfd_ros.node import process
        from pfd_ros.node.stepping import Stepper

        marks['imports'] = spent()
        init, node, put_out = process.rclpy.init, process.SimArmNode.__init__, Stepper._put_out
        loop = Stepper.run

        def initialise(*a: Any, **k: Any) -> None:
            init(*a, **k)
            marks['rclpy.init'] = spent()

        def make(*a: Any, **k: Any) -> None:
            node(*a, **k)
            marks['node'] = spent()

        def run(self: Any, *a: Any) -> None:
            marks['model, kernels, topics'] = spent()
            loop(self, *a)

        def publish(self: Any, outputs: Any) -> None:
            put_out(self, outputs)
            if outputs and 'first state' not in marks:
                marks['first state'] = spent()
                show(marks)

        process.rclpy.init, process.SimArmNode.__init__ = initialise, make
        Stepper.run, Stepper._put_out = run, publish
        return run_main(*args)

    node_main.main = main
    raise SystemExit(command.main(['sim', '--robot', robot]))


# In the process that measures


def start(kind: str, robot: str, cache: Path) -> dict[str, tuple[float, float]]:
    """Run one process; return wall and processor time at the ends of its stages, s."""
    begun = time.time()
    done = subprocess.run(
        [sys.executable, __file__, '--run', kind, '--robot', robot],
        env=os.environ | {'PFD_CACHE': str(cache)},
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE,
    )
    line = next((line for line in done.stdout.splitlines() if line.startswith('{')), None)
    if line is None:
        raise RuntimeError(f'no first state of {kind}: {done.stdout}{done.stderr}')
    return {name: (wall - begun, cpu) for name, (wall, cpu) in json.loads(line).items()}


def report(found: dict[str, list[dict[str, tuple[float, float]]]]) -> None:
    """Print the times of the starts, and the stages of the quickest warm one."""
    ends = {kind: [run['first state'] for run in runs] for kind, runs in found.items()}
    print('start   wall min  median   processor min  median   median of ratios to bare')
    for kind in KINDS:
        walls, cpus = zip(*ends[kind], strict=True)
        pairs = list(zip(ends[kind], ends['bare'], strict=True))
        ratios = [statistics.median(mine[k] / other[k] for mine, other in pairs) for k in (0, 1)]
        print(
            f'{kind:6} {min(walls):8.2f} s {statistics.median(walls):5.2f} s '
            f'{min(cpus):13.2f} s {statistics.median(cpus):5.2f} s   '
            f'wall {ratios[0]:.2f}, processor {ratios[1]:.2f}'
        )
    quickest = min(found['warm'], key=lambda run: run['first state'][0])
    print('\nstage of the quickest warm start   wall   processor')
    before = (0.0, 0.0)
    for stage in STAGES:
        now = quickest[stage]
        print(f'{stage:32} {now[0] - before[0]:5.2f} s {now[1] - before[1]:9.2f} s')
        before = now


def main() -> None:
    """Measure, or be one of the processes that are measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rounds', type=int, default=5)
    parser.add_argument('--robot', default='ur5')
    parser.add_argument('--run', choices=KINDS, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.run:
        bare() if given.run == 'bare' else sim(given.robot)
        return
    found: dict[str, list[dict[str, tuple[float, float]]]] = {kind: [] for kind in KINDS}
    for _ in range(given.rounds):
        with tempfile.TemporaryDirectory() as folder:
            for kind in KINDS:
                found[kind].append(start(kind, given.robot, Path(folder)))
    report(found)


if __name__ == '__main__':
    main()
