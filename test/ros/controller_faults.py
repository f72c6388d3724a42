# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Ten faults of a controller, in three ways: how long a test takes to fail, and what it says.

    python test/ros/controller_faults.py            print the table of docs/guides
    python test/ros/controller_faults.py FAULT      be the controller with a fault, as a process

A controller of a UR5 has the fault as a callback of the test, as a node of its process, and as a
process of its own. Each runs 3 s of simulated time, then must settle.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
import os
from pathlib import Path
import re
import signal
import sys
import time
from typing import Any

from bridge import ControllerProcess, LockstepArm
import numpy as np

GOAL = np.array([0.5, -1.0, 1.0, -0.5, 0.4, 0.3])
STIFFNESS = np.array([600.0, 600.0, 400.0, 100.0, 100.0, 100.0])
DAMPING = np.array([150.0, 150.0, 80.0, 20.0, 20.0, 20.0])
WITHIN = 0.003
SECONDS = 3.0
# Commands before a fault that comes at once.
BEFORE = 100
LATE_STEPS = 5
# Of a message, in the table.
MOST = 200
UR5: dict[str, Any] = {'robot': 'ur5', 'armature': True, 'gravity_compensation': True}
# t, q, qd -> efforts, None for no answer.
Law = Callable[[float, np.ndarray, np.ndarray], Any]


def pd(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    return STIFFNESS * (GOAL * min(t / 1.5, 1.0) - q) - DAMPING * qd


def wrong_sign(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    return -STIFFNESS * (GOAL * min(t / 1.5, 1.0) - q) - DAMPING * qd


def high_gain(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    return 10.0 * pd(t, q, qd)


def late() -> Law:
    seen: list[Any] = []

    def law(*state: Any) -> np.ndarray:
        seen.append(state)
        return pd(*seen[max(0, len(seen) - 1 - LATE_STEPS)])

    return law


def after(fault: Callable[[np.ndarray], Any]) -> Callable[[], Law]:
    """Return a maker of laws that work for some commands, and have a fault from then on."""

    def make() -> Law:
        calls = 0

        def law(t: float, q: np.ndarray, qd: np.ndarray) -> Any:
            nonlocal calls
            calls += 1
            tau = pd(t, q, qd)
            return tau if calls <= BEFORE else fault(tau)

        return law

    return make


def block(tau: np.ndarray) -> np.ndarray:
    time.sleep(1e6)
    return tau


def crash(tau: np.ndarray) -> np.ndarray:
    """End the process that is the controller; elsewhere raise."""
    if '--process' in sys.argv:
        os.kill(os.getpid(), signal.SIGSEGV)
    return {'gains': tau}['gain']


# Fault -> a maker of its law, and settings of the arm.
FAULTS: dict[str, tuple[Callable[[], Law], dict[str, Any]]] = {
    'sign error': (lambda: wrong_sign, UR5),
    'gain too high': (lambda: high_gain, UR5),
    'no gravity compensation': (lambda: pd, UR5 | {'gravity_compensation': False}),
    '5 ms late': (late, UR5),
    'NaN': (after(lambda tau: np.where(np.arange(6) == 2, np.nan, tau)), UR5),
    'wrong length': (after(lambda tau: tau[:5]), UR5),
    'blocks': (after(block), UR5),
    'crashes': (after(crash), UR5),
    'never publishes': (lambda: lambda t, q, qd: None, UR5),
    'stops after 100 commands': (after(lambda tau: None), UR5),
}
WAYS = ('callback', 'topics', 'process')


def callback(make: Callable[[], Law]) -> Law:
    """Return a law as a callback."""
    return make()


def node_of(make: Callable[[], Law]) -> Any:
    """Return a node that answers each state by a law, with a Float64MultiArray."""
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    node, law = Node('joint_pd'), make()
    commands = node.create_publisher(Float64MultiArray, 'sim_arm/commands', 1)

    def on_state(state: Any) -> None:
        t = state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec
        tau = law(t, np.array(state.position), np.array(state.velocity))
        if tau is not None:
            commands.publish(Float64MultiArray(data=tau.tolist()))

    node.create_subscription(JointState, 'joint_states', on_state, 1)
    return node


def command_of(fault: str) -> list[str]:
    """Return the command line of the controller with a fault."""
    return [sys.executable, str(Path(__file__).resolve()), fault, '--process']


def motion_of(fault: str, way: str) -> Any:
    """Return the motion under a controller with a fault; rclpy is initialised for two ways."""
    make, settings = FAULTS[fault]
    with ExitStack() as stack:
        arm = stack.enter_context(LockstepArm(**settings))
        if way == 'callback':
            return arm.run(callback(make), SECONDS)
        if way == 'process':
            return arm.spin(SECONDS, stack.enter_context(ControllerProcess(command_of(fault))))
        node = node_of(make)
        stack.callback(node.destroy_node)
        return arm.spin(SECONDS, node)


def failure_of(fault: str, way: str) -> tuple[float, str]:
    """Return after how much wall time a test with a fault fails, s, and its text."""
    begun = time.perf_counter()
    try:
        motion_of(fault, way).assert_settles(GOAL, within=WITHIN, by=2.5)
    except Exception as error:
        return time.perf_counter() - begun, f'{type(error).__name__}: {error}'
    return time.perf_counter() - begun, ''


def told(text: str) -> str:
    """Return the text of a failure for a table: without paths, on one line."""
    lines = [line.strip() for line in text.splitlines()]
    shown = [line for line in lines if 'elbow_joint:' in line] or lines[:1]
    if 'it is here' in text or 'ends:' in text:
        shown.append(lines[-1])
    line = (
        re.sub(r' \(pid \d+\)', '', ' '.join(shown))
        .replace(sys.executable, 'python')
        .replace(str(Path(__file__).resolve().parent) + os.sep, '')
        .replace('|', r'\|')
    )
    return line if len(line) <= MOST else f'{line[:MOST]}...'


def main() -> None:
    from bridge import claimed_domain, initialised

    print('| fault | runs as | fails after [s] | message |\n|---|---|---|---|')
    with claimed_domain() as domain, initialised(domain):
        for fault in FAULTS:
            for way in WAYS:
                seconds, text = failure_of(fault, way)
                print(f'| {fault} | {way} | {seconds:.1f} | {told(text)} |', flush=True)


def be_controller(fault: str) -> None:
    import rclpy

    rclpy.init()
    rclpy.spin(node_of(FAULTS[fault][0]))


if __name__ == '__main__':
    if len(sys.argv) > 1:
        be_controller(sys.argv[1])
    else:
        main()
