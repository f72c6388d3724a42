# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node's threads, and the order of going down: stop stepping, close the file, close ROS.

rclpy's own signal handlers tear the context down before anything can be closed; `node.py` sets
a flag instead, and what is here waits for it.
"""

from __future__ import annotations

import gc
import sys
import threading

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.qos_overriding_options import InvalidQosOverridesError
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args

from pfd_ros.sim_arm import NAME, SimArm

REPORT_SECONDS = 1.0
# In these wheels spin() without a timeout never runs a callback; this is three years.
FOREVER_SECONDS = 1e8
# What a wrong argument, parameter or file makes rclpy and this package raise.
MISTAKES = (
    ValueError,
    OSError,
    RuntimeError,
    ParameterException,
    NameValidationException,
    InvalidQosOverridesError,
)


def run(args: list[str], stop: threading.Event) -> int:
    """Run the node until `stop` is set; return its exit status.

    Parameters
    ----------
    args
        Command line without the program's name.
    stop
        Set by a signal, and by the node itself when it cannot go on.
    """
    try:
        return _run(args, stop)
    except MISTAKES as error:
        print(f'{NAME}: {error}', file=sys.stderr)
        return 1
    finally:
        rclpy.try_shutdown()


def _run(args: list[str], stop: threading.Event) -> int:
    extra = remove_ros_args([NAME, *args])[1:]
    if extra:
        raise ValueError(f'unknown arguments {extra}; parameters come after --ros-args -p')
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    node = SimArm()
    executor = EventsExecutor()
    executor.add_node(node)
    ended: Future = Future()
    spinning = threading.Thread(
        target=executor.spin_until_future_complete, args=(ended, FOREVER_SECONDS), name='spinning'
    )
    spinning.daemon = True
    spinning.start()
    failures: list[BaseException] = []
    stepping = threading.Thread(target=_step, args=(node, stop, failures), name='stepping')
    # Start-up garbage is looked at once, not again and again while the arm runs.
    gc.collect()
    gc.freeze()
    stepping.start()
    node.get_logger().info(f'{node.settings.robot}: {len(node.plant.names)} joints, held')
    try:
        while not stop.wait(REPORT_SECONDS):
            node.report()
    finally:
        stop.set()
        stepping.join()
        node.close_recording()
    node.report()
    node.get_logger().info(f'stopped: {node.totals()}')
    ended.set_result(None)
    executor.wake()
    spinning.join()
    node.destroy_node()
    for failure in failures:
        print(f'{NAME}: {type(failure).__name__}: {failure}', file=sys.stderr)
    return 1 if failures else 0


def _step(node: SimArm, stop: threading.Event, failures: list[BaseException]) -> None:
    """Step until told to stop; whatever goes wrong stops the process too, file closed."""
    try:
        node.run(stop.is_set)
    except Exception as error:
        failures.append(error)
    finally:
        stop.set()
