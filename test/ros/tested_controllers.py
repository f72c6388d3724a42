# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Controllers of a UR5 for tests of the fixtures: by states and by timers, with faults.

python tested_controllers.py KIND [FAULT]       be one, as a process
"""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import signal
import sys
import threading
import time
from typing import Any

import numpy as np

GOAL = np.array([0.3, -1.0, 0.8, -0.5, 0.4, 0.3])
# Commands before a fault.
BEFORE = 20


def pd(q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    return 40.0 * (GOAL - q) - 6.0 * qd


def block(tau: np.ndarray) -> Any:
    time.sleep(1e6)


def stubborn(tau: np.ndarray) -> Any:
    """Block, and answer although it is interrupted."""
    try:
        time.sleep(1e6)
    except BaseException:
        return tau


def die(tau: np.ndarray) -> Any:
    os.kill(os.getpid(), signal.SIGSEGV)


# Fault -> what it makes of the efforts; None is no command.
FAULTS: dict[str, Callable[[np.ndarray], Any]] = {
    '': lambda tau: tau,
    'nan': lambda tau: np.where(np.arange(6) == 2, np.nan, tau),
    'short': lambda tau: tau[:5],
    'raises': lambda tau: {'gains': tau}['gain'],
    'blocks': block,
    'stubborn': stubborn,
    'stops': lambda tau: None,
    'never': lambda tau: None,
    'dies': die,
}


def faulty(fault: str = '') -> Callable[[np.ndarray], Any]:
    """Return a function that passes efforts on, and has a fault after some calls."""
    calls, change = 0, FAULTS[fault]

    def passed(tau: np.ndarray) -> Any:
        nonlocal calls
        calls += 1
        return change(tau) if calls > BEFORE or fault == 'never' else tau

    return passed


# Periods of the timers of each kind, ms; kinds without a timer answer states.
TIMERS = {
    **dict.fromkeys(('states', 'twice', 'pairs', 'back', 'lazy', 'stamps'), ()),
    **dict.fromkeys(('timer', 'wall', 'steady', 'threads'), (2,)),
    **dict.fromkeys(('filter', 'reads', 'flag', 'both', 'front', 'cpp'), (5,)),
    'two': (2, 10),
    'uneven': (3,),
}
# Kinds that do not take the time of the arm.
OWN_TIME = ('states', 'twice', 'pairs', 'wall', 'stamps')


def node_of(kind: str, fault: str = '') -> Any:
    """Return a node with a controller: it filters every state, and keeps the last one."""
    from rclpy.callback_groups import ReentrantCallbackGroup
    from rclpy.clock import Clock, ClockType
    from rclpy.node import Node
    from rclpy.parameter import Parameter
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    class Controller(Node):
        def __init__(self) -> None:
            name = kind if kind in ('front', 'back', 'stamps') else 'pd'
            sim_time = Parameter('use_sim_time', value=kind not in OWN_TIME)
            super().__init__(name, parameter_overrides=[sim_time])
            self.passed, self.last, self.late, self.count = faulty(fault), None, 0, 0
            self.slow, self.push, self.read = np.zeros(6), np.zeros(6), 0.0
            self.group = ReentrantCallbackGroup() if kind == 'threads' else None
            # `front` filters for `back`: a chain of two nodes.
            topic = 'filtered' if kind == 'front' else 'sim_arm/commands'
            self.out = self.create_publisher(Float64MultiArray, topic, 1)
            if kind == 'back':
                self.create_subscription(Float64MultiArray, 'filtered', self.on_filtered, 1)
            group = self.group
            self.create_subscription(JointState, 'joint_states', self.on, 1, callback_group=group)
            for period in TIMERS[kind]:
                self.start(period)

        def start(self, period: int) -> None:
            clock = Clock(clock_type=ClockType.STEADY_TIME) if kind == 'steady' else None
            call, group = (lambda: self.tick(period)), self.group
            self.create_timer(period * 1e-3, call, callback_group=group, clock=clock)

        def send(self, efforts: Any) -> None:
            tau = efforts if kind == 'front' else self.passed(efforts)
            if tau is not None:
                self.out.publish(Float64MultiArray(data=tau.tolist()))

        def on(self, state: Any) -> None:
            self.count += 1
            q, qd = np.array(state.position), np.array(state.velocity)
            stamp = state.header.stamp
            self.last = q, qd, stamp.sec * 10**9 + stamp.nanosec
            if kind == 'stamps':
                # The time of the stamp, as most nodes compute it.
                t = stamp.sec + 1e-9 * stamp.nanosec
                self.send(pd(q, qd) + np.sin(50.0 * t))
                return
            self.slow = 0.9 * self.slow + 0.1 * qd
            if kind == 'reads':
                # The tick of this state comes after it: the clock is at the state before.
                self.slow *= 1.0 + 1e-9 * self.get_clock().now().nanoseconds % 0.01
            if kind in ('states', 'twice', 'pairs', 'both'):
                self.send(pd(q, self.slow))
            if kind == 'pairs':
                # The barrier must wait for the end of the callback, not for a command.
                time.sleep(0.002)
            if kind == 'pairs' or (kind == 'twice' and self.count == 60):
                self.send(pd(q, 2.0 * self.slow))
            if kind == 'lazy' and self.count == 3:
                self.start(5)

        def on_filtered(self, message: Any) -> None:
            self.push = 0.9 * self.push - np.array(message.data)
            # The barrier must wait for the end of the chain.
            time.sleep(0.002)
            self.send(pd(self.last[0], self.slow) + self.push)

        def tick(self, period: int) -> None:
            if self.last is None:
                return
            q, qd, stamp_ns = self.last
            if kind == 'threads':
                time.sleep(0.003)
            now = self.get_clock().now().nanoseconds
            self.late += stamp_ns != now
            if kind == 'timer':
                self.send(pd(q, qd))
            elif kind == 'front':
                self.send(self.slow)
            elif kind == 'two' and period == 10:
                self.push = 0.5 * self.push + 2.0 * (GOAL - q) + self.slow
            elif kind != 'flag' or np.abs(self.slow).sum() > 0.5 or now % 50_000_000 == 0:
                self.send(pd(q, self.slow) + self.push)

    return Controller()


def like_rclcpp(node: Any) -> Any:
    """Give a node what rclcpp has: a thread for the clock, and a reader of parameter events."""
    from rcl_interfaces.msg import ParameterEvent
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.parameter import Parameter
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from rosgraph_msgs.msg import Clock

    source = node._time_source
    node.destroy_subscription(source._clock_sub)
    bare = [Parameter('start_type_description_service', value=False)]
    helper = Node(
        'pd', enable_rosout=False, start_parameter_services=False, parameter_overrides=bare
    )
    qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    helper.create_subscription(Clock, '/clock', source.clock_callback, qos)
    helper.create_subscription(ParameterEvent, '/parameter_events', lambda event: None, 10)
    executor = SingleThreadedExecutor()
    executor.add_node(helper)
    threading.Thread(target=executor.spin, daemon=True).start()
    return helper


def command_of(kind: str, fault: str = '') -> list[str]:
    """Return the command line of a controller as a process."""
    return [sys.executable, str(Path(__file__).resolve()), kind, fault]


def main(kind: str, fault: str = '') -> None:
    """Be a controller until a signal."""
    import rclpy
    from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor

    rclpy.init()
    node = node_of(kind, fault)
    helper = like_rclcpp(node) if kind == 'cpp' else None
    executor = MultiThreadedExecutor(4) if kind == 'threads' else SingleThreadedExecutor()
    executor.add_node(node)
    try:
        executor.spin()
    except KeyboardInterrupt:
        os._exit(0)  # the helper's thread still spins
    del helper


if __name__ == '__main__':
    main(*sys.argv[1:])
