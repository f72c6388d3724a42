# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One configured arm on the topics of a node, from configure to cleanup.

This module only connects the parts; the package's docstring lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import threading
import time
from typing import Any

from rclpy.node import Node

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Request, Source, Verdict
from pfd_ros.arm.outputs import roles_of
from pfd_ros.arm.plant_settings import ESTIMATED
from pfd_ros.arm.requests import encode_request
from pfd_ros.arm.scene import with_scene_text
from pfd_ros.arm.settings import Settings
from pfd_ros.arm.speeding import estimate_text
from pfd_ros.node import parameters
from pfd_ros.node.changing import Changes
from pfd_ros.node.command_counts import CommandCounts
from pfd_ros.node.compile_report import compile_report
from pfd_ros.node.description import load_model, publish_description
from pfd_ros.node.diagnostics import ArmDiagnostics, MassKernels
from pfd_ros.node.endpoints import NonblockingPublisher, create_endpoints
from pfd_ros.node.graph_check import GraphCheck
from pfd_ros.node.log_session import open_session
from pfd_ros.node.receiving import EventQueue, Receiver
from pfd_ros.node.reporting import Reporter
from pfd_ros.node.services import create_services
from pfd_ros.node.stepping import Stepper
from pfd_ros.node.throttled_log import ThrottledLog
from pfd_ros.node.workers import Workers

# Longest wait for a transition; the arm takes events at least twenty times a second.
TRANSITION_SECONDS = 5.0


class SimArm:
    """An arm, its topics, services and recording, and the thread that steps it.

    `stopped` ends the wait for a model from a topic. `reached_ns` is the simulated time of the
    previous arm, from which this one continues.

    Attributes
    ----------
    stepper
        For the stepping thread.
    thread
        The stepping thread, once started.
    reporter, diagnostics
        For the main thread.

    Raises
    ------
    ValueError, OSError, rclpy.exceptions.ParameterException
        If a parameter cannot be used; the node is unchanged then, and nothing has been recorded.
    """

    def __init__(
        self,
        node: Node,
        settings: Settings,
        log: ThrottledLog,
        stopped: Callable[[], bool],
        reached_ns: int = 0,
    ) -> None:
        self._node = node
        self._stop = threading.Event()
        self.thread: threading.Thread | None = None
        self._subscriptions: Mapping[Source, Any] = {}
        before = set(_entities(node))
        try:
            timed = settings.at_time_of_day(time.time()).continued_from(reached_ns)
            self._build(with_scene_text(timed), log, stopped)
        finally:
            self._entities = [entity for entity in _entities(node) if entity not in before]
            if not hasattr(self, 'stepper'):
                self.destroy_entities()

    def _build(self, settings: Settings, log: ThrottledLog, stopped: Callable[[], bool]) -> None:
        node = self._node
        model = load_model(node, settings, stopped)
        robot = model.described.robot
        settings = parameters.declare_joints(node, model.described.settings, robot)
        with compile_report(node.get_logger().info, robot.name):
            frames = model.described.recorded_frames(settings, node.get_logger().warning)
            engine = Engine(settings, robot, rows=bool(settings.recording), frames=frames)
            kernels = MassKernels(engine.arm)
        endpoints = create_endpoints(
            node,
            roles=roles_of(settings),
            follow_clock=settings.follows_clock,
            on_message=self._receive,
            topics=model.topics,
        )
        self._subscriptions = endpoints.subscriptions
        if settings.publish_description:
            publish_description(node, model.described)
        counts = CommandCounts()
        graph = GraphCheck(node, endpoints, log, counts=counts)
        # Last, so that a rejected parameter leaves no file.
        session = open_session(node, engine, endpoints)
        publishers = {
            role: NonblockingPublisher(publisher)
            for role, publisher in endpoints.publishers.items()
        }
        self._receiver = Receiver(EventQueue(), session.record, counts)
        create_services(node, self._receiver, engine)
        stepper = Stepper(engine, self._receiver, session, publishers)
        self.reporter = Reporter(log, endpoints, stepper, graph)
        self.diagnostics = ArmDiagnostics(stepper, graph, kernels)
        if vars(settings)['armature'] == ESTIMATED:
            log.info(estimate_text(robot))
        self._changes = Changes(self._receiver, engine)
        self._set_parameters = parameters.ParameterChanges(self._changes).set
        node.add_on_set_parameters_callback(self._set_parameters)
        self.stepper = stepper

    def _receive(self, source: Source, data: bytes) -> None:
        # The endpoints exist before the receiver; messages arrive once an executor spins.
        if source is Source.PAYLOAD:
            self._changes.take_payload(data)
        else:
            self._receiver.receive(source, data)

    def start(self, workers: Workers) -> None:
        """Start the stepping thread."""

        def stopped() -> bool:
            return self._stop.is_set() or workers.stop.is_set()

        self.thread = workers.start(
            'stepping', lambda: self.stepper.run(stopped), self._stop.is_set
        )

    def request(self, name: str) -> None:
        """Pass a request to the arm, and return when it has been executed.

        Raises
        ------
        ValueError
            If the arm rejects it, or does not answer in time: then the request is executed
            later.
        """
        request = encode_request(Request(name))
        validation = self._receiver.validation_of(Source.REQUEST, request, TRANSITION_SECONDS)
        if validation is None:
            if name == 'activate':
                # An arm that does not answer now must not start to move later.
                self._receiver.ask(Source.REQUEST, encode_request(Request('deactivate')))
            raise ValueError(f'the arm did not answer within {TRANSITION_SECONDS:g} s')
        if validation.verdict is not Verdict.ACCEPTED:
            raise ValueError(validation.detail)

    def stop_stepping(self) -> None:
        """Signal the stepping thread to end."""
        self._stop.set()

    def close_recording(self) -> None:
        """Write the queue and the totals, and close the file."""
        self.stepper.session.close(self.reporter.totals)

    def destroy_entities(self) -> None:
        """Remove its topics, services and callback from the node."""
        if hasattr(self, 'stepper'):
            self._node.remove_on_set_parameters_callback(self._set_parameters)
        destroy: dict[str, Callable[[Any], bool]] = {
            'publishers': self._node.destroy_publisher,
            'subscriptions': self._node.destroy_subscription,
            'services': self._node.destroy_service,
        }
        for kind, entity in self._entities:
            destroy[kind](entity)
        # Replaced subscriptions; destroying one twice has no effect.
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription.end)


def _entities(node: Node) -> Iterator[tuple[str, Any]]:
    """Yield the entities of a node that an arm may add."""
    for kind in ('publishers', 'subscriptions', 'services'):
        for entity in getattr(node, kind):
            yield kind, entity
