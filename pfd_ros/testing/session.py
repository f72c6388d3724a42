# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""rclpy for the duration of a test, in a separate domain, on this host only."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
import importlib
import os
from typing import Any
import warnings

from pfd_ros.testing.domains import environment, own_domain

# The last one otherwise comes with a user's first publisher.
_MODULES = ('rclpy', 'rclpy.signals', 'rosidl_generator_py')
# By rclpy's context; one at most.
_EXECUTOR: dict[Any, Any] = {}


def import_rclpy() -> Any:
    """Return the module rclpy; the parser of its messages warns of a module that Python renamed.

    Raises
    ------
    ImportError
        If ROS 2 is not installed.
    """
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', DeprecationWarning)
        modules = [importlib.import_module(name) for name in _MODULES]
    return modules[0]


def executor_with(nodes: Sequence[Any]) -> Any:
    """Return the one executor of this process's tests, with nodes that are not in it yet.

    Nodes stay in it until they are destroyed: an executor from which a node is removed loses
    messages of the node that it had not delivered.
    """
    from rclpy.experimental.events_executor import EventsExecutor

    context = import_rclpy().get_default_context()
    if context not in _EXECUTOR:
        _EXECUTOR.clear()
        _EXECUTOR[context] = EventsExecutor()
    executor = _EXECUTOR[context]
    for node in nodes:
        executor.add_node(node)
    return executor


def spin(executor: Any, seconds: float, ended: Any = None) -> None:
    """Run callbacks for so long, or until a future is done.

    A destroyed node may be called once more for received messages and cannot publish then, which
    is no error of the test.
    """
    from rclpy._rclpy_pybind11 import InvalidHandle

    try:
        if ended is None:
            executor.spin_once(timeout_sec=seconds)
        else:
            executor.spin_until_future_complete(ended, seconds)
    except InvalidHandle:
        if all(_exists(node) for node in executor.get_nodes()):
            raise


def _exists(node: Any) -> bool:
    from rclpy._rclpy_pybind11 import InvalidHandle

    try:
        with node.handle:
            return True
    except InvalidHandle:
        return False


def take_down(node: Any) -> None:
    """Destroy a node that may be in the executor."""
    for executor in _EXECUTOR.values():
        executor.remove_node(node)
    node.destroy_node()


def current_domain() -> int | None:
    """Return the domain of rclpy's default context, None if it is not initialised."""
    rclpy = import_rclpy()
    return int(rclpy.get_default_context().get_domain_id()) if rclpy.ok() else None


@contextmanager
def claimed_domain() -> Iterator[int]:
    """Claim a domain, and set it in the environment of child processes."""
    with own_domain() as domain:
        before, chosen = dict(os.environ), environment(os.environ, domain)
        changed = {name for name, _ in before.items() ^ chosen.items()}
        _take_over(chosen, changed)
        try:
            yield domain
        finally:
            _take_over(before, changed)


def _take_over(variables: Mapping[str, str], names: Collection[str]) -> None:
    """Give some variables of the environment the values that they have among others, or none."""
    for name in names:
        if name in variables:
            os.environ[name] = variables[name]
        else:
            os.environ.pop(name, None)


@contextmanager
def initialised(domain: int) -> Iterator[None]:
    """Initialise rclpy's default context, in which the nodes of users are, and shut it down."""
    rclpy = import_rclpy()
    # Signals are the test runner's.
    options = rclpy.signals.SignalHandlerOptions.NO
    rclpy.init(args=[], signal_handler_options=options, domain_id=domain)
    try:
        yield
    finally:
        for executor in _EXECUTOR.values():
            executor.shutdown()
        _EXECUTOR.clear()
        rclpy.try_shutdown()
