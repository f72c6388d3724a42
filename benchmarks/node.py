# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Print control steps per second in lockstep, or the time until the node's first state.

    python benchmarks/node.py lockstep [seconds]
    python benchmarks/node.py start [rounds]

Lockstep: a UR5 with its rotors, two substeps a step, under the same PD controller. Rounds of all
cases take turns, each after one that is not timed: compare ratios.

    simulator     Simulator.step and the positions and velocities, nothing else
    callback      the whole arm: engine, validation, checks of the answer, rows of the motion
    node          over topics in one process: the arm and a node of rclpy with the controller

Start: processor time of a process until the node hands its first state to ROS; discovery by a
subscriber comes on top. First starts have an empty cache of native code, warm starts the cache of
the start before.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
import json
import os
import signal
import statistics
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

GOAL = np.array([0.3, -0.6, 0.9, 0.2, -0.5, 0.4])
# Control steps of one round.
STEPS = 200
SETTINGS: dict[str, Any] = {'robot': 'ur5', 'armature': True, 'substeps': 2}
KINDS = ('first', 'warm')
PATIENCE = 120.0  # s


def pd(q: NDArray[Any], qd: NDArray[Any]) -> NDArray[Any]:
    efforts: NDArray[Any] = 100.0 * (GOAL - q) - 10.0 * qd
    return efforts


def controller(namespace: str) -> Any:
    """Return a node that answers states."""
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    node = Node('controller', namespace=namespace)
    commands = node.create_publisher(Float64MultiArray, 'sim_arm/commands', 10)

    def on_state(state: Any) -> None:
        efforts = pd(np.frombuffer(state.position), np.frombuffer(state.velocity))
        commands.publish(Float64MultiArray(data=efforts))

    node.create_subscription(JointState, 'joint_states', on_state, 10)
    return node


def loops(stack: ExitStack) -> dict[str, Callable[[], None]]:
    """Return a round of each case; without ROS only the first two."""
    import pfd_core as pfd
    from pfd_ros.testing.lockstep_arm import LockstepArm

    arm = stack.enter_context(LockstepArm(**SETTINGS))
    bare = pfd.Simulator(arm.robot, pfd.Scene(armature='model'), substeps=2)

    def simulator() -> None:
        bare.reset()
        for _ in range(STEPS):
            bare.step(pd(bare.q, bare.qd))

    def callback() -> None:
        arm.reset()
        arm.run(lambda t, q, qd: pd(q, qd), STEPS * arm.period)

    found: dict[str, Callable[[], None]] = {'simulator': simulator, 'callback': callback}
    try:
        from pfd_ros.testing.session import claimed_domain, initialised

        stack.enter_context(initialised(stack.enter_context(claimed_domain())))
    except ImportError:
        return found
    named = stack.enter_context(LockstepArm(**SETTINGS, ros_args=['-r', '__ns:=/node']))
    node = controller('node')

    def spin() -> None:
        named.reset()
        named.spin(STEPS * named.period, node)

    return found | {'node': spin}


def lockstep(seconds: float) -> None:
    with ExitStack() as stack:
        runs = loops(stack)
        times: dict[str, list[float]] = {name: [] for name in runs}
        begun = time.perf_counter()
        while time.perf_counter() - begun < seconds:
            for name, run in runs.items():
                # The case before has left nothing of this one in the caches.
                run()
                before = time.perf_counter()
                run()
                times[name].append((time.perf_counter() - before) / STEPS)
    print(f'{"":10} best [1/s]  median [1/s]  over simulator')
    for name, found in times.items():
        share = min(times['simulator']) / min(found)
        print(f'{name:10} {1 / min(found):10.0f}  {1 / np.median(found):12.0f}  {share:.2f}')


def process() -> None:
    """Run `pfd sim` until its first state."""
    from pfd_ros.cli import main as command
    from pfd_ros.node import main as node

    run: Any = node.main

    def main(*args: Any) -> Any:
        import gc

        gc.disable()  # as `main` does before these imports
        from pfd_ros.node import process  # noqa: F401
        from pfd_ros.node.stepping import Stepper

        imported, put_out = time.process_time(), Stepper._put_out

        def publish(stepper: Any, outputs: Any) -> None:
            put_out(stepper, outputs)
            if outputs:
                print(json.dumps([imported, time.process_time()]), flush=True)
                os.kill(os.getpid(), signal.SIGTERM)

        setattr(Stepper, '_put_out', publish)  # noqa: B010
        return run(*args)

    setattr(node, 'main', main)  # noqa: B010
    raise SystemExit(command.main(['sim', '--robot', 'ur5']))


def start(rounds: int) -> None:
    found: dict[str, list[list[float]]] = {kind: [] for kind in KINDS}
    for _ in range(rounds):
        with TemporaryDirectory() as folder:
            for kind in KINDS:
                done = subprocess.run(
                    [sys.executable, __file__, kind],
                    env=os.environ | {'PFD_CACHE': folder},
                    capture_output=True,
                    text=True,
                    check=False,
                    timeout=PATIENCE,
                )
                lines = [line for line in done.stdout.splitlines() if line.startswith('[')]
                if not lines:
                    raise RuntimeError(f'no first state of {kind}: {done.stdout}{done.stderr}')
                found[kind].append(json.loads(lines[0]))
    print('start    processor: least, median   imports')
    for kind, runs in found.items():
        times = [cpu for _, cpu in runs]
        share = statistics.median(imports / cpu for imports, cpu in runs)
        print(f'{kind:6} {min(times):14.2f} s {statistics.median(times):9.2f} s {share:8.0%}')


def main(arguments: list[str]) -> None:
    name, *number = arguments or ['']
    if name in KINDS:
        process()
    elif name == 'lockstep':
        lockstep(*map(float, number or ['20']))
    elif name == 'start':
        start(*map(int, number or ['5']))
    else:
        raise SystemExit(__doc__)


if __name__ == '__main__':
    main(sys.argv[1:])
