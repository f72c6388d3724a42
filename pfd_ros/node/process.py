# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Start ROS, the node and its threads, and shut them down: stepping, then the file, then ROS.

The signal handlers of rclpy shut the context down before anything can be closed. So `main.py` sets
an event instead, and the main thread waits for it here. If one thread ends unexpectedly, all of
them are stopped: an arm that receives nothing or does not step must not look like one that works.
See docs/decisions/0003-executor-and-stepping-thread.md and 0009-faults-and-exit-status.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import gc
import os
import re
import signal
import sys
import threading
import traceback
from typing import Any, TypeAlias

import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args, try_shutdown

from pfd_ros.node.lifecycle import NAME, SimArmNode
from pfd_ros.node.threads import END_SECONDS, MISTAKES, Threads, reason
from pfd_ros.text import cut, listed

REPORT_SECONDS = 1.0
# In these wheels spin() without a timeout never runs a callback; this is three years.
FOREVER_SECONDS = 1e8
# Number of failed callbacks after which the node ends: rclpy logs each one at length.
MOST_FAILURES = 1000
# A parameter, a remapping or a log level, and the options that take one.
RULE = re.compile(r'[^-\s=]\S*?:=')
TAKE_RULES = frozenset({'-p', '--param', '-r', '--remap', '--log-level'})
# Starts the 3D view of a node, by the node's name, as a process with the methods end() -> how it
# ended, '' while it runs, and stop().
Companion: TypeAlias = Callable[[str], Any]


def run(args: list[str], stop: threading.Event, companion: Companion | None = None) -> int:
    """Run the node until `stop` is set; return its exit status.

    `args` is the command line without the program's name. A signal may have set `stop` before the
    node starts, and the node sets it when it cannot continue. The companion starts with the arm
    and ends with the node; its end is logged and changes nothing.
    """
    started = list[Any]()
    try:
        return 0 if stop.is_set() else _run(args, stop, companion, started)
    except MISTAKES as error:
        print(f'{NAME}: {reason(error)}', file=sys.stderr)
        return 1
    except Exception:
        traceback.print_exc()
        return 1
    finally:
        for process in started:
            process.stop()
        _limit_the_rest()
        try_shutdown()


def _limit_the_rest() -> None:
    """Have the kernel end the process if it hangs from here on."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(END_SECONDS)


def _run(
    args: list[str], stop: threading.Event, companion: Companion | None, started: list[Any]
) -> int:
    _check_arguments(args)
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    threads = Threads(stop)
    node = SimArmNode(threads, args)
    node.start()
    if companion is not None:
        # A fault here ends the node, and closes its recording.
        name, start = node.get_fully_qualified_name(), companion
        threads.guard('starting the companion', lambda: started.append(start(name)), lambda: True)
    # `main.py` disables it.
    gc.enable()
    ended: Future = Future()
    executor: Any = EventsExecutor()
    executor.add_node(node)
    spinning = threads.start('the executor', lambda: _spin(executor, ended, node.callback_failed))
    threads.guard('reporting', lambda: _report(node, stop, started))
    node.close()
    ended.set_result(None)
    executor.wake()
    spun = threads.join(spinning)
    problems = node.problems()
    for problem in problems:
        node.get_logger().error(problem)
    if node.hung or not spun:
        # ROS cannot be shut down under a thread that may still use it.
        sys.stderr.flush()
        os._exit(1)
    _limit_the_rest()
    # The middleware must not call an executor for a node that is being destroyed.
    executor.remove_node(node)
    node.destroy_node()
    return 1 if problems else 0


def _check_arguments(args: list[str]) -> None:
    """Raise ValueError for unknown arguments, and for rules without an option.

    rcl treats `robot:=ur5` as a remapping of a topic, and the robot would stay the default.
    """
    for before, argument in zip(['', *args], args, strict=False):
        if RULE.match(argument) and before not in TAKE_RULES:
            prefix = '-p' if '--ros-args' in args else '--ros-args -p'
            raise ValueError(f'{cut(argument)!r} needs {prefix} before it')
    extra = remove_ros_args([NAME, *args])[1:]
    if extra:
        raise ValueError(f'unknown arguments {listed(extra)}; parameters follow --ros-args -p')


def _report(node: SimArmNode, stop: threading.Event, started: Sequence[Any]) -> None:
    running = list(started)
    while not stop.wait(REPORT_SECONDS):
        node.report()
        for process in [x for x in running if x.end()]:
            running.remove(process)
            node.get_logger().warning(f'the 3D view {process.end()}; the arm continues')


def _spin(executor: Any, ended: Future, failed: Callable[[Exception], None]) -> None:
    """Run callbacks until `ended` is done; count failed callbacks and continue."""
    failures = 0
    while not ended.done():
        try:
            executor.spin_until_future_complete(ended, FOREVER_SECONDS)
            return
        except Exception as error:
            failed(error)
            failures += 1
            if failures >= MOST_FAILURES:
                raise RuntimeError(f'{MOST_FAILURES} callbacks failed') from error
