# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rclpy node `sim_arm`: torques in, joint states and the clock out.

It only puts the parts together; the package's docstring has a map of them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Source
from pfd_ros.arm.scene import with_scene_text
from pfd_ros.arm.settings import Settings
from pfd_ros.node import parameters
from pfd_ros.node.command_counts import CommandCounts
from pfd_ros.node.description import load_model, publish_description
from pfd_ros.node.endpoints import NonblockingPublisher, create_endpoints
from pfd_ros.node.graph_check import GraphCheck
from pfd_ros.node.log_session import open_session
from pfd_ros.node.receiving import EventQueue, Receiver
from pfd_ros.node.reporting import Reporter
from pfd_ros.node.services import create_services
from pfd_ros.node.stepping import Stepper
from pfd_ros.node.throttled_log import ThrottledLog
from pfd_ros.text import cut

NAME = 'sim_arm'


class SimArm(Node):
    """The arm on its topics; `stopped` ends the wait for a model.

    Attributes
    ----------
    stepper
        For the stepping thread.
    reporter
        For the main thread.

    Raises
    ------
    ValueError, OSError, rclpy.exceptions.ParameterException
        If a parameter cannot be used; nothing has been recorded then.
    """

    def __init__(self, stopped: Callable[[], bool] = lambda: False) -> None:
        super().__init__(NAME, start_parameter_services=False)
        parameters.StrictParameterService(self)
        model = load_model(self, with_scene_text(parameters.declare(self)), stopped)
        robot = model.robot
        settings = parameters.declare_joints(self, model.settings, robot)
        engine = Engine(settings, robot)
        endpoints = create_endpoints(
            self,
            publish_clock=settings.publish_clock,
            on_message=self._receive,
            topics=model.topics,
        )
        if settings.publish_description:
            publish_description(self, model)
        # After everything that a parameter can make fail: a refused parameter leaves no file.
        session = open_session(self, engine.settings, robot, endpoints)
        counts = CommandCounts()
        publishers = {
            role: NonblockingPublisher(publisher)
            for role, publisher in endpoints.publishers.items()
        }
        self._receiver = Receiver(EventQueue(), session.record, counts)
        self.stepper = Stepper(engine, self._receiver, session, publishers, counts)
        create_services(self, self._receiver, engine)
        changes = parameters.ParameterChanges(self._receiver, engine.settings, robot)
        self.add_on_set_parameters_callback(changes.set)
        log = ThrottledLog(self.get_logger())
        graph = GraphCheck(self, endpoints, log)
        self.reporter = Reporter(log, endpoints, self.stepper, graph)
        self._warn_about(settings, robot, log)

    def _receive(self, source: Source, data: bytes) -> None:
        # The endpoints are there before the receiver; messages come once an executor spins.
        self._receiver.receive(source, data)

    def _warn_about(self, settings: Settings, robot: Any, log: ThrottledLog) -> None:
        misspelt = parameters.misspelt(self)
        if misspelt:
            log.once('misspelt', f'not parameters of this node: {misspelt}; misspelt?')
        for name in ('armature', 'damping'):
            if getattr(settings, name) and not getattr(robot, name).any():
                log.once(name, f'{name} is true, but the model of {cut(robot.name)!r} states none')

    def close_recording(self) -> None:
        """Write the queue and the totals, and close the file."""
        self.stepper.session.close(self.reporter.totals)
