# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node `sim_arm` as a process: threads, signals and the order of going down.

rclpy's own signal handlers tear the context down before anything can be closed, and a second
SIGINT (a terminal sends one, a launcher another) interrupts whatever cleans up. So the
handlers here only set a flag, and the way down is always: stop stepping, close the file, close
ROS.
"""

from __future__ import annotations

import gc
import signal
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

SIGNALS = tuple(getattr(signal, name) for name in ('SIGINT', 'SIGTERM', 'SIGHUP'))
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


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT, SIGTERM or SIGHUP; return its exit status.

    Parameters
    ----------
    args
        Command line without the program's name; None takes the process's own.
    """
    stop = threading.Event()
    for number in SIGNALS:
        signal.signal(number, lambda *_: stop.set())
    given = sys.argv[1:] if args is None else args
    try:
        status = _run(given, stop)
    except MISTAKES as error:
        print(f'{NAME}: {error}', file=sys.stderr)
        status = 1
    finally:
        rclpy.try_shutdown()
        # A signal while the interpreter goes down would turn a clean exit into a killed one.
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)
    return status


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


if __name__ == '__main__':
    raise SystemExit(main())
