# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One configured arm on the topics of a node, from configure to cleanup.

This module connects the parts; the package's docstring lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import TimeoutError as LateError
from contextlib import contextmanager
import logging
import threading
import time
from typing import TYPE_CHECKING, Any

from rclpy.node import Node

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import (
    ASIDES,
    CLOCK,
    CLOCK_TICKS,
    DESCRIPTION,
    INPUTS,
    PAYLOAD,
    PAYLOAD_IN_USE,
    REJECTED,
    REQUESTS,
    ROLES,
    STATES,
    TF,
    TF_STATIC,
    Message,
)
from pfd_ros.arm.other_inputs import encode_request
from pfd_ros.arm.settings import Settings
from pfd_ros.node import parameters
from pfd_ros.node.changing import Changes
from pfd_ros.node.description import load_model, publish_description
from pfd_ros.node.diagnostics import ArmDiagnostics, MassKernels
from pfd_ros.node.endpoints import create_endpoints
from pfd_ros.node.graph import GraphCheck
from pfd_ros.node.inbox import Inbox
from pfd_ros.node.report import Report
from pfd_ros.node.services import create_services
from pfd_ros.node.stepping import Stepper
from pfd_ros.node.threads import Threads
from pfd_ros.text import cut

if TYPE_CHECKING:
    from pfd_ros.recording.recorder import Recorder

# Longest wait for a transition; the arm takes inputs at least twenty times a second.
TRANSITION_SECONDS = 5.0


COMPILE_LOG = logging.getLogger('pfd_core.compile')


class SimArm:
    """An arm, its topics, services, threads and recording.

    Parameters
    ----------
    node
        Gets the topics and services.
    settings
        From the parameters.
    report
        The table of counts and the log.
    threads
        Of the process; the arm ends with them.
    reached_ns
        Simulated time of the previous arm, from which this one continues.

    Attributes
    ----------
    engine, endpoints, stepper, diagnostics
        The parts that reports are about.
    started
        Steady time, s.

    Raises
    ------
    ValueError, OSError, rclpy.exceptions.ParameterException
        If a parameter cannot be used; the node is unchanged then, and nothing has been recorded.
    """

    def __init__(
        self, node: Node, settings: Settings, report: Report, threads: Threads, reached_ns: int
    ) -> None:
        self._node, self._report, self._threads = node, report, threads
        self.started = time.monotonic()
        self._ended = threading.Event()
        self._stepping: threading.Thread | None = None
        self._recorder: Recorder | None = None
        before = set(_entities(node))
        built = False
        try:
            self._build(settings.at_time_of_day(time.time()).continued_from(reached_ns))
            built = True
        finally:
            self._entities = [entity for entity in _entities(node) if entity not in before]
            if not built:
                self.destroy_endpoints()

    def _build(self, settings: Settings) -> None:
        node, report = self._node, self._report
        model = load_model(node, settings, self._threads.stop.is_set)
        settings = parameters.declare_joints(node, model.settings, model.robot)
        followed = {CLOCK_TICKS} if settings.follows_clock else set()
        received = {role for role in INPUTS if not ROLES[role].service} - {CLOCK_TICKS} | followed
        published = {REJECTED, PAYLOAD_IN_USE, STATES, *settings.outputs}
        if settings.publish_clock:
            published.add(CLOCK)
        recorded = {*INPUTS, *ASIDES, TF} if settings.recording else set()
        with compile_report(node.get_logger().info, model.robot.name):
            self.engine = Engine(settings, model.robot, published | recorded, model.text)
            kernels = MassKernels(self.engine)
        self.inbox = Inbox(report.count)
        changes = Changes(self.engine, self.inbox, report.count)

        def receive(role: str, data: bytes) -> None:
            (changes if role == PAYLOAD else self.inbox).put(role, data)

        self.endpoints = create_endpoints(node, received | published, model.topics, receive)
        create_services(node, self.engine, self.inbox)
        if settings.publish_description:
            publish_description(node, model.text)
        parameters.refuse_unknown(node)
        # Last, so that a rejected parameter leaves no file.
        self._recorder = self._opened(settings)
        self.stepper = Stepper(
            self.engine, self.inbox, self._recorder, self.endpoints.publishers, report.count
        )
        self.graph = GraphCheck(node, self.endpoints, report)
        self.diagnostics = ArmDiagnostics(self.stepper, self.graph, report, kernels)
        self._changes = changes
        self._set_parameters = parameters.setter(self.engine, changes)
        node.add_on_set_parameters_callback(self._set_parameters)

    def _opened(self, settings: Settings) -> Recorder | None:
        """Return the recording, with a topic for each role of the run."""
        if not settings.recording:
            return None
        # Imported here: a node without a recording starts faster.
        from pfd_ros.recording.recorder import Recorder

        ends = {**self.endpoints.subscriptions, **self.endpoints.publishers}
        topics = {role: end.topic_name for role, end in ends.items()}
        for role in self.engine.roles - ends.keys() - {CLOCK_TICKS, *(OPTIONAL)}:
            topics[role] = self._node.resolve_topic_name(ROLES[role].topic)
        log = self._node.get_logger().error
        return Recorder(settings.recording, self.engine, topics, log)

    def start(self) -> None:
        """Start the threads that step, and that prepare changes."""

        def stopped() -> bool:
            return self._ended.is_set() or self._threads.stop.is_set()

        self._threads.start('changing', lambda: self._changes.run(stopped), stopped)
        self._stepping = self._threads.start(
            'stepping', lambda: self.stepper.run(stopped), self._ended.is_set
        )

    def request(self, name: str) -> None:
        """Pass a request to the arm, and return when it has been executed.

        Raises
        ------
        ValueError
            If the arm rejects it, or does not answer in time: then the request is executed
            later.
        """
        asked = self.inbox.put(REQUESTS, encode_request(name))
        try:
            verdict = asked.result(TRANSITION_SECONDS)
        except LateError:
            if name == 'activate':
                # An arm that does not answer now must not start to move later.
                self.inbox.put(REQUESTS, encode_request('deactivate'))
            raise ValueError(f'the arm did not answer within {TRANSITION_SECONDS:g} s') from None
        if not verdict.accepted:
            raise ValueError(verdict.detail)

    def record(self, role: str, data: bytes) -> None:
        """Record a message of the node itself."""
        if self._recorder is not None:
            self._recorder.put([Message(role, data)], self.engine.stamp_ns)

    def stop(self) -> bool:
        """Stop the steps; return whether the thread has ended."""
        self._ended.set()
        return self._stepping is None or self._threads.join(self._stepping)

    def close_recording(self) -> None:
        """Write the queue and the totals, and close the file."""
        if self._recorder is not None:
            self._recorder.put(self.engine.counts(), self.engine.stamp_ns)
            self._recorder.close(self.totals())

    def problems(self) -> list[str]:
        """Return why the run of this arm failed."""
        found = ['the simulation failed before the end'] if self.engine.state.failure else []
        if self._recorder is not None and self._recorder.error:
            found.append('the recording is incomplete')
        return found

    def totals(self) -> dict[str, Any]:
        """Return the totals of the run, for the log and the end of the recording."""
        state, stepper = self.engine.state, self.stepper
        counts = self._report.counts()
        inputs = {key: count for key, (count, _) in counts.items() if key[0] in INPUTS}
        accepted = sum(count for (_, label), count in inputs.items() if label == ACCEPTED.label)
        rejected = sum(count for (_, label), count in inputs.items() if label not in UNCOUNTED)
        return {
            'cycles': state.cycle,
            'steps': state.step,
            'states': stepper.states,
            'accepted': accepted,
            'rejected': rejected,
            'late_steps': stepper.late,
            'missed_periods': stepper.missed,
            'failure': state.failure,
            'reflex': state.tripped,
            'trips': state.trips,
            'timeouts': state.timeouts,
        }

    def destroy_endpoints(self) -> None:
        """Remove its topics, services and callback from the node."""
        if hasattr(self, '_set_parameters'):
            self._node.remove_on_set_parameters_callback(self._set_parameters)
        destroy: dict[str, Callable[[Any], bool]] = {
            'publishers': self._node.destroy_publisher,
            'subscriptions': self._node.destroy_subscription,
            'services': self._node.destroy_service,
        }
        for kind, entity in self._entities:
            destroy[kind](entity)


def _entities(node: Node) -> Iterator[tuple[str, Any]]:
    """Yield the entities of a node that an arm may add."""
    for kind in ('publishers', 'subscriptions', 'services'):
        for entity in getattr(node, kind):
            yield kind, entity


@contextmanager
def compile_report(log: Callable[[str], object], robot: str) -> Iterator[None]:
    """Log that native code for a robot is compiled, and how long it took; nothing if cached."""
    begun, compiled = time.monotonic(), list[logging.LogRecord]()

    class First(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if not compiled:
                log(f'Compiling native code for {cut(robot)!r} (first start; cached afterwards)')
            compiled.append(record)

    handler, level = First(), COMPILE_LOG.level
    COMPILE_LOG.addHandler(handler)
    COMPILE_LOG.setLevel(logging.INFO)
    try:
        yield
    finally:
        COMPILE_LOG.removeHandler(handler)
        COMPILE_LOG.setLevel(level)
    if compiled:
        log(f'Compiled native code for {cut(robot)!r} in {time.monotonic() - begun:.1f} s')
