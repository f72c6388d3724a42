# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Print the time from the start of the node's process to its first state, and the share of imports.

    python benchmarks/start_up.py [--rounds 5] [--robot ur5]

A start ends when the node hands its first state to ROS; discovery by a subscriber comes on top.
First starts have an empty cache of native code, warm starts the cache of the start before. They
take turns with a bare node of rclpy that publishes one JointState: compare ratios.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from typing import Any

PATIENCE = 120.0  # s
KINDS = ('bare', 'first', 'warm')


def show(imported: float) -> None:
    """Print when imports ended, and now, of wall and processor time, and end this process."""
    now = {'imports': imported, 'cpu': time.process_time(), 'wall': time.time()}
    print(json.dumps(now), flush=True)
    os.kill(os.getpid(), signal.SIGTERM)


def bare() -> None:
    """Publish one message by rclpy alone."""
    import rclpy
    from rclpy.node import Node
    from sensor_msgs.msg import JointState

    imported = time.process_time()
    rclpy.init()
    Node('bare').create_publisher(JointState, 'joint_states', 10).publish(JointState())
    show(imported)


def sim(robot: str) -> None:
    """Run `pfd sim` until its first state."""
    from pfd_ros.cli import main as command
    from pfd_ros.node import main as node

    run: Any = node.main

    def main(*args: Any) -> Any:
        import gc

        gc.disable()  # as `main` does before these imports
        from pfd_ros.node import process
        from pfd_ros.node.stepping import Stepper

        imported, put_out = time.process_time(), Stepper._put_out
        assert process

        def publish(stepper: Any, outputs: Any) -> None:
            put_out(stepper, outputs)
            if outputs:
                show(imported)

        setattr(Stepper, '_put_out', publish)  # noqa: B010
        return run(*args)

    setattr(node, 'main', main)  # noqa: B010
    raise SystemExit(command.main(['sim', '--robot', robot]))


def start(kind: str, robot: str, cache: Path) -> dict[str, float]:
    """Run one process; return wall and processor time until its first state, s."""
    begun = time.time()
    command = [sys.executable, __file__, '--run', kind, '--robot', robot]
    done = subprocess.run(
        command,
        env=os.environ | {'PFD_CACHE': str(cache)},
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE,
    )
    line = next((line for line in done.stdout.splitlines() if line.startswith('{')), None)
    if line is None:
        raise RuntimeError(f'no first state of {kind}: {done.stdout}{done.stderr}')
    found: dict[str, float] = json.loads(line)
    return found | {'wall': found['wall'] - begun}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rounds', type=int, default=5)
    parser.add_argument('--robot', default='ur5')
    parser.add_argument('--run', choices=KINDS, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.run:
        bare() if given.run == 'bare' else sim(given.robot)
        return
    found: dict[str, list[dict[str, float]]] = {kind: [] for kind in KINDS}
    for _ in range(given.rounds):
        with tempfile.TemporaryDirectory() as folder:
            for kind in KINDS:
                found[kind].append(start(kind, given.robot, Path(folder)))
    print('start    wall: least, median   processor: least, median   imports   of bare')
    for kind, runs in found.items():
        walls, cpus, imports = ([run[key] for run in runs] for key in ('wall', 'cpu', 'imports'))
        share = statistics.median(a / b for a, b in zip(imports, cpus, strict=True))
        pairs = zip(cpus, found['bare'], strict=True)
        ratio = statistics.median(cpu / other['cpu'] for cpu, other in pairs)
        print(
            f'{kind:6} {min(walls):9.2f} s {statistics.median(walls):7.2f} s '
            f'{min(cpus):12.2f} s {statistics.median(cpus):7.2f} s {share:10.0%} {ratio:9.2f}'
        )


if __name__ == '__main__':
    main()
