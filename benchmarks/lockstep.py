# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Print control steps per second of an arm in lockstep, compared with bare loops of the same work.

    python benchmarks/lockstep.py [seconds]

A UR5 with its rotors, two substeps a step, under the same PD controller. Rounds of all cases take
turns within one run, each after one that is not timed: compare ratios.

    simulator     Simulator.step and the positions and velocities, nothing else
    callback      the whole arm: engine, validation, checks of the answer, rows of the motion
    recorded      the same, each message written to an MCAP file
    echo          over topics in one process: states of zeros for commands, no arm at all
    node          over topics in one process: the arm and the same node
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
from time import perf_counter, sleep
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.testing.lockstep_arm import LockstepArm

GOAL = np.array([0.3, -0.6, 0.9, 0.2, -0.5, 0.4])
# Control steps of one round.
STEPS = 200
# Longest time after a round until the last of its messages is in the file.
WRITING_SECONDS = 0.3
SETTINGS: dict[str, Any] = {'robot': 'ur5', 'armature': True, 'substeps': 2}
Loop = Callable[[], None]


def pd(q: NDArray[Any], qd: NDArray[Any]) -> NDArray[Any]:
    efforts: NDArray[Any] = 100.0 * (GOAL - q) - 10.0 * qd
    return efforts


def simulator_loop(robot: pfd.Robot) -> Loop:
    sim = pfd.Simulator(robot, pfd.Scene(armature='model'), substeps=2)

    def run() -> None:
        sim.reset()
        for _ in range(STEPS):
            sim.step(pd(sim.q, sim.qd))

    return run


def callback_loop(arm: LockstepArm) -> Loop:
    def run() -> None:
        arm.reset()
        arm.run(lambda t, q, qd: pd(q, qd), STEPS * arm.period)

    return run


def node_loop(arm: LockstepArm) -> Loop:
    node = controller('node')

    def run() -> None:
        arm.reset()
        arm.spin(STEPS * arm.period, node)

    return run


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


def echo_loop() -> Loop:
    """Return a loop that sends the same state for each command, as the middleware allows."""
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    from pfd_ros.testing.session import executor_with

    end, node = Node('echo', namespace='echo'), controller('echo')
    states = end.create_publisher(JointState, 'joint_states', 10)
    zeros, left = np.zeros(6), [0]
    names = [f'joint{i}' for i in range(6)]
    state = JointState(name=names, position=zeros, velocity=zeros, effort=zeros)

    def on_command(_: Any) -> None:
        left[0] -= 1
        if left[0]:
            states.publish(state)

    end.create_subscription(Float64MultiArray, 'sim_arm/commands', on_command, 10)

    def run() -> None:
        left[0] = STEPS
        executor = executor_with([end, node])
        states.publish(state)
        while left[0]:
            executor.spin_once(1.0)

    return run


def cases(stack: ExitStack) -> dict[str, Loop]:
    folder = Path(stack.enter_context(TemporaryDirectory()))
    arm = stack.enter_context(LockstepArm(**SETTINGS))
    recorded = stack.enter_context(LockstepArm(**SETTINGS, recording=folder / 'run.mcap'))
    found = {'simulator': simulator_loop(arm.robot)}
    found |= {'callback': callback_loop(arm), 'recorded': callback_loop(recorded)}
    try:
        from pfd_ros.testing.session import claimed_domain, initialised

        stack.enter_context(initialised(stack.enter_context(claimed_domain())))
    except ImportError:
        return found
    arm = stack.enter_context(LockstepArm(**SETTINGS, ros_args=['-r', '__ns:=/node']))
    return found | {'echo': echo_loop(), 'node': node_loop(arm)}


def main(seconds: float) -> None:
    with ExitStack() as stack:
        loops = cases(stack)
        times: dict[str, list[float]] = {name: [] for name in loops}
        begun = perf_counter()
        while perf_counter() - begun < seconds:
            for name, loop in loops.items():
                # The case before has left nothing of this one in the caches.
                loop()
                before = perf_counter()
                loop()
                times[name].append((perf_counter() - before) / STEPS)
                if name == 'recorded':
                    # Its writer's thread would take its time from the next case.
                    sleep(WRITING_SECONDS)
    print(f'{"":10} best [1/s]  median [1/s]  of the bare loop')
    for name, found in times.items():
        bare = 'echo' if name == 'node' else 'simulator'
        share = '' if name == 'echo' else f'{min(times[bare]) / min(found):.2f} of {bare}'
        print(f'{name:10} {1 / min(found):10.0f}  {1 / np.median(found):12.0f}  {share}')


if __name__ == '__main__':
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 20.0)
