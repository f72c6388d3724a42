# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node's threads, and the order of going down: stop stepping, close the file, close ROS.

rclpy's own signal handlers tear the context down before anything can be closed; `node.py` sets
a flag instead, and what is here waits for it. A thread that ends sets it too: an arm that is
deaf, or does not step, must not look like one that works.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
import gc
import os
import signal
import sys
import threading
import traceback
from typing import Any

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.qos_overriding_options import InvalidQosOverridesError
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args, try_shutdown

from pfd_ros.node.sim_arm import NAME, SimArm
from pfd_ros.text import listed, one_line

REPORT_SECONDS = 1.0
# In these wheels spin() without a timeout never runs a callback; this is three years.
FOREVER_SECONDS = 1e8
# For each thread to end, and for ROS and the interpreter to go down.
END_SECONDS = 10
# Callbacks that may fail before the node gives up: rclpy logs each one at length.
MOST_FAILURES = 1000
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
        print(f'{NAME}: {one_line(error)}', file=sys.stderr)
        return 1
    except Exception:
        traceback.print_exc()
        return 1
    finally:
        _limit_the_rest()
        try_shutdown()


def _limit_the_rest() -> None:
    """Have the kernel end whatever hangs from here on until the process is gone."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(END_SECONDS)


@dataclass
class _Crew:
    """The node's threads: when one ends, by itself or by an error, all are told to stop."""

    stop: threading.Event
    failures: list[str] = field(default_factory=list)

    def start(self, name: str, work: Callable[[], None]) -> threading.Thread:
        """Start a thread."""
        thread = threading.Thread(target=self.guard, args=(name, work), name=name, daemon=True)
        thread.start()
        return thread

    def guard(self, name: str, work: Callable[[], None]) -> None:
        """Do some work that should last until `stop` is set, and note how it ended."""
        try:
            work()
            if not self.stop.is_set():
                self.failures.append(f'{name} ended by itself')
        except BaseException as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            self.failures.append(
                one_line(
                    f'{name} failed: {type(error).__name__}: {error} '
                    f'({os.path.basename(where.filename)}:{where.lineno})'
                )
            )
        finally:
            self.stop.set()

    def join(self, thread: threading.Thread) -> None:
        """Wait for a thread to end, but not for ever."""
        thread.join(END_SECONDS)
        if thread.is_alive():
            self.failures.append(f'{thread.name} did not end within {END_SECONDS} s')


def _run(args: list[str], stop: threading.Event) -> int:
    extra = remove_ros_args([NAME, *args])[1:]
    if extra:
        raise ValueError(f'unknown arguments {listed(extra)}; parameters follow --ros-args -p')
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    node = SimArm()
    crew = _Crew(stop)
    ended: Future = Future()
    executor: Any = EventsExecutor()
    executor.add_node(node)
    spinning = crew.start('the executor', lambda: _spin(executor, ended, node))
    # Start-up garbage is looked at once, not again and again while the arm runs.
    gc.collect()
    gc.freeze()
    stepping = crew.start('stepping', lambda: node.run(stop.is_set))
    crew.guard('reporting', lambda: _report(node, stop))
    crew.join(stepping)
    crew.guard('closing the recording', node.close_recording)
    crew.guard('reporting', lambda: node.report(last=True))
    ended.set_result(None)
    executor.wake()
    crew.join(spinning)
    problems = [*crew.failures, *node.problems()]
    for problem in problems:
        node.get_logger().error(problem)
    node.get_logger().info(f'stopped: {node.totals()}')
    if stepping.is_alive() or spinning.is_alive():
        # ROS cannot be taken down under a thread that may still use it.
        sys.stderr.flush()
        os._exit(1)
    _limit_the_rest()
    node.destroy_node()
    return 1 if problems else 0


def _report(node: SimArm, stop: threading.Event) -> None:
    node.introduce()
    while not stop.wait(REPORT_SECONDS):
        node.report()


def _spin(executor: Any, ended: Future, node: SimArm) -> None:
    """Run callbacks until told to end; one that fails is counted and the next one runs."""
    while not ended.done():
        try:
            executor.spin_until_future_complete(ended, FOREVER_SECONDS)
            return
        except Exception as error:
            node.callback_failed(error)
            if node.callback_failures >= MOST_FAILURES:
                raise RuntimeError(f'{MOST_FAILURES} callbacks failed') from error
