# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One configured arm on the topics of a node, from configure to cleanup.

This module connects the parts; the package's docstring lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import TimeoutError as LateError
from contextlib import contextmanager
from functools import partial
import logging
import os
import threading
import time
from typing import TYPE_CHECKING, Any

from rclpy.node import Node

from pfd_ros.arm import events
from pfd_ros.arm.advice import estimate_text
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Message
from pfd_ros.arm.other_inputs import encode_request
from pfd_ros.arm.plant import with_scene_text
from pfd_ros.arm.plant_settings import ESTIMATED
from pfd_ros.arm.settings import Settings
from pfd_ros.files import existing
from pfd_ros.messages.values import encode_string
from pfd_ros.node import parameters
from pfd_ros.node.description import load_model
from pfd_ros.node.diagnostics import ArmDiagnostics, MassKernels
from pfd_ros.node.endpoints import chosen_topics, create_endpoints, topic_roles
from pfd_ros.node.graph import GraphCheck
from pfd_ros.node.inbox import Changes, Inbox
from pfd_ros.node.report import Report
from pfd_ros.node.services import create_services, create_standard_services
from pfd_ros.node.stepping import Stepper
from pfd_ros.node.threads import Threads
from pfd_ros.text import cut

if TYPE_CHECKING:
    from pfd_ros.recording.recorder import Recorder

# `ros2 launch` and `docker stop` wait 10 s between the first signal and SIGKILL: the rest is for
# threads to end. One that hangs is waited for first, so such a node may be killed.
CLOSE_SECONDS = 8.0
# Longest wait for a transition; the arm takes inputs at least twenty times a second.
TRANSITION_SECONDS = 5.0
# Has a record for each module that is compiled.
COMPILE_LOG = logging.getLogger('pfd_core.compile')


class SimArm:
    """An arm, its topics, services, threads and recording.

    If a parameter cannot be used (ValueError, OSError, ParameterException), there is no new file,
    topic, service or callback; declared parameters of joints stay until the next arm. Simulated
    time continues from `reached_ns`, of the arm before.
    """

    def __init__(self, node: Node, settings: Settings, threads: Threads, reached_ns: int) -> None:
        self._node, self._threads = node, threads
        self.report = Report(node.get_logger())
        self._ended = threading.Event()
        self._running: list[threading.Thread] = []
        self._recorder: Recorder | None = None
        before = set(_entities(node))
        built = False
        try:
            self._build(settings.started(time.time(), reached_ns))
            built = True
        finally:
            self._entities = [entity for entity in _entities(node) if entity not in before]
            if not built:
                self.destroy_endpoints()

    def _build(self, settings: Settings) -> None:
        node, report, log = self._node, self.report, self._node.get_logger()
        if settings.recording and os.path.lexists(settings.recording):
            raise existing(settings.recording)  # before a compilation, which takes seconds
        model = load_model(node, settings, self._threads.stop.is_set)
        settings = parameters.declare_joints(node, model.settings, model.robot)
        settings = with_scene_text(settings)
        compiling = partial(compile_report, log.info, model.robot.name)
        with compiling():
            frames = model.recorded_frames(settings, log.warning)
            roles = topic_roles(settings) | {events.REQUESTS, events.PARAMETERS}
            if settings.recording:
                roles |= {events.REJECTED_COUNTS, events.DIAGNOSTICS, events.TRANSITIONS}
                # Pages and views show it.
                roles |= {events.TIP_WRENCH, *(frames.roles if frames is not None else ())}
            self.engine = Engine(settings, model.robot, roles, frames)
            kernels = MassKernels(self.engine)
        inbox = self.inbox = Inbox(report.count)
        changes = self._changes = Changes(self.engine, inbox, report.count, compiling)

        def receive(role: str, data: bytes) -> None:
            if role == events.PAYLOAD:
                changes.put(role, data)
            else:
                inbox.put(role, data)

        topics = chosen_topics(node, settings, model.topics, log.info)
        ends = self.endpoints = create_endpoints(node, topic_roles(settings), topics, receive)
        create_services(node, self.engine, inbox)
        create_standard_services(node, self.engine, inbox, self._threads, self._ended.is_set)
        if settings.publish_description:
            ends.publishers[events.DESCRIPTION].publish(encode_string(model.text))
        if vars(settings)['armature'] == ESTIMATED:
            log.info(estimate_text(model.robot))
        ignored = parameters.refuse_unknown(node)
        if ignored:
            report.log(ignored)
        self.stepper = Stepper(self.engine, inbox, self.endpoints.publishers, report.count)
        self.graph = GraphCheck(self.endpoints, report)
        self.diagnostics = ArmDiagnostics(self.stepper, self.graph, report, kernels)
        self._set_parameters = parameters.setter(self.engine, changes)
        node.add_on_set_parameters_callback(self._set_parameters)
        # Last, so that an arm that fails leaves no file.
        if settings.recording:
            # Imported here: a node without a recording starts faster.
            from pfd_ros.recording.recorder import Recorder

            own = {x: node.resolve_topic_name(events.ROLES[x].topic) for x in self.engine.roles}
            own |= {role: end.topic_name for role, end in ends.all.items()}
            self._recorder = Recorder(settings.recording, self.engine, own, log.error)
            self.stepper.recorder = self._recorder

    def start(self) -> None:
        """Start the threads that step, and that prepare changes."""

        def stopped() -> bool:
            return self._ended.is_set() or self._threads.stop.is_set()

        for name, work, ended in (
            ('stepping', self.stepper.run, self._ended.is_set),
            ('changing', self._changes.run, stopped),
        ):
            self._running.append(self._threads.start(name, partial(work, stopped), ended))

    def request(self, name: str) -> None:
        """Pass a request to the arm, and return when it has been executed; else ValueError."""
        asked = self.inbox.put(events.REQUESTS, encode_request(name))
        try:
            verdict = asked.result(TRANSITION_SECONDS)
        except LateError:
            if name == 'activate':
                # An arm that does not answer now must not start to move later.
                self.inbox.put(events.REQUESTS, encode_request('deactivate'))
            raise ValueError(f'the arm did not answer within {TRANSITION_SECONDS:g} s') from None
        if not verdict.accepted:
            raise ValueError(verdict.detail)

    def record(self, role: str, data: bytes) -> None:
        """Record a message of the node itself."""
        if self._recorder is not None:
            self._recorder.put([Message(role, data)], self.engine.stamp_ns)

    def stop(self) -> bool:
        """Stop the steps and changes; return whether their threads have ended."""
        self._ended.set()
        self._changes.wake()
        return all(self._threads.join(thread) for thread in self._running)

    def close_recording(self) -> None:
        """Write the queue and the end of the run, and close the file.

        After a fault in a cycle, or while one hangs, the state of the engine is not one that a
        replay reaches: the end is left out.
        """
        if self._recorder is not None:
            whole = not self._running or self.stepper.whole
            self._recorder.close(whole=whole, seconds=CLOSE_SECONDS)

    def problems(self) -> list[str]:
        """Return why the run of this arm failed."""
        found = ['the simulation failed before the end'] if self.engine.state.failure else []
        if self._recorder is not None and self._recorder.error:
            found.append('the recording is incomplete')
        return found

    def destroy_endpoints(self) -> None:
        """Remove its topics, services and callback from the node."""
        if hasattr(self, '_set_parameters'):
            self._node.remove_on_set_parameters_callback(self._set_parameters)
        for kind, entity in self._entities:
            getattr(self._node, f'destroy_{kind}')(entity)


def _entities(node: Node) -> Iterator[tuple[str, Any]]:
    """Yield the entities of a node that an arm may add."""
    for kind in ('publisher', 'subscription', 'service'):
        for entity in getattr(node, f'{kind}s'):
            yield kind, entity


@contextmanager
def compile_report(log: Callable[[str], object], robot: str) -> Iterator[None]:
    """Log that native code for a robot is compiled, and how long it took; nothing if cached."""
    begun, compiled, level = time.monotonic(), list[str](), COMPILE_LOG.level

    def seen(record: logging.LogRecord) -> bool:
        if not compiled:
            log(f'Compiling native code for {cut(robot)!r}, kept for these effects')
        compiled.append(record.name)
        return True

    COMPILE_LOG.addFilter(seen)
    COMPILE_LOG.setLevel(logging.INFO)
    try:
        yield
    finally:
        COMPILE_LOG.removeFilter(seen)
        COMPILE_LOG.setLevel(level)
    if compiled:
        log(f'Compiled native code for {cut(robot)!r} in {time.monotonic() - begun:.1f} s')
