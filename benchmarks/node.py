# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Print control steps per second in lockstep, or the time until simulated time starts.

    python benchmarks/node.py lockstep [seconds]
    python benchmarks/node.py start [rounds]

Lockstep: a UR5 with its rotors, two substeps a step, under the same PD controller. Rounds of all
cases take turns, each after one that is not timed: compare ratios.

    simulator     Simulator.step and the positions and velocities, nothing else
    callback      the whole arm: engine, validation, checks of the answer, rows of the motion
    node          over topics in one process: the arm and a node of rclpy with the controller

Start: processor time of `pfd sim`; discovery by a subscriber comes on top. First starts have an
empty cache of native code, warm starts the cache of the start before.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
import os
from pathlib import Path
import statistics
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.testing.lockstep_arm import LockstepArm

GOAL = np.array([0.3, -0.6, 0.9, 0.2, -0.5, 0.4])
# Control steps of one round.
STEPS = 200
SETTINGS: dict[str, Any] = {'robot': 'ur5', 'armature': True, 'substeps': 2}
SIM = 'from pfd_ros.cli.main import main; raise SystemExit(main(["sim", "--robot", "ur5"]))'
STARTED = 'simulated time starts'


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


def started(cache: str) -> float:
    """Return the processor time of a process until it logs that simulated time starts [s]."""
    how: dict[str, Any] = {'stdout': subprocess.PIPE, 'stderr': subprocess.STDOUT, 'text': True}
    with subprocess.Popen(
        [sys.executable, '-c', SIM], env=os.environ | {'PFD_CACHE': cache}, **how
    ) as process:
        for line in process.stdout or ():
            if STARTED in line:
                # Behind the name in brackets, fields 14 and 15: ticks of user and system.
                fields = Path(f'/proc/{process.pid}/stat').read_text().rpartition(')')[2].split()
                process.terminate()
                return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
    raise RuntimeError(f'no line with {STARTED!r}')


def start(rounds: int) -> None:
    found: dict[str, list[float]] = {'first': [], 'warm': []}
    for _ in range(rounds):
        with TemporaryDirectory() as folder:
            for times in found.values():
                times.append(started(folder))
    print('start    processor: least, median')
    for kind, times in found.items():
        print(f'{kind:6} {min(times):14.2f} s {statistics.median(times):9.2f} s')


def main(arguments: list[str]) -> None:
    name, *number = arguments or ['']
    if name == 'lockstep':
        lockstep(*map(float, number or ['20']))
    elif name == 'start':
        start(*map(int, number or ['5']))
    else:
        raise SystemExit(__doc__)


if __name__ == '__main__':
    main(sys.argv[1:])
