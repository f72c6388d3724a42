# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm on its topics in this process: each command is answered with the next state.

The subscription's callback runs the engine itself: no other thread, no queue and no clock, so a
run follows from the commands alone. Messages of the arm travel as bytes; nodes in the same
executor get them without a system call.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import partial
import importlib
import time
from typing import Any

from pfd_ros.arm.events import CLOCK, STATES, Output, Source
from pfd_ros.arm.output_settings import OUTPUTS
from pfd_ros.messages.topics import topic_of
from pfd_ros.testing.session import executor_with, import_rclpy, spin, take_down
from pfd_ros.testing.topic_run import TopicRun

NAME = 'sim_arm'
# As those of the node.
STATE_TOPIC = 'joint_states'
COMMAND_TOPICS = {Source.NAMED: 'joint_commands', Source.ARRAY: '~/commands'}
STATE_DEPTH, COMMAND_DEPTH, CLOCK_DEPTH = 10, 100, 1
# Longest wait for an answer, s of wall time, unless the caller says otherwise.
PATIENCE_SECONDS = 10.0
# Without an answer the state is sent again after so long. A controller that takes longer over one
# command and does not stamp it would answer twice.
RESEND_SECONDS = 2.0
# Between two looks at the clock while the executor spins; a signal waits as long.
LOOK_SECONDS = 0.1


class NoAnswerError(Exception):
    """Nobody answered a state."""


class Exchange:
    """A node of the arm's name and topics.

    Parameters
    ----------
    roles
        Of the outputs that are published.
    ros_args
        Of the node, as on a command line: remappings, its namespace.
    topics
        Topic of each source and output to which a description gives a name.

    Raises
    ------
    RuntimeError
        If rclpy is not initialised.
    """

    def __init__(
        self,
        roles: Collection[str],
        ros_args: Sequence[str] = (),
        topics: Mapping[Source | str, str] | None = None,
    ) -> None:
        require_rclpy()
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray

        self.node = bare_node(NAME, ros_args)
        named = {} if topics is None else topics
        states = topic_of(self.node, STATE_TOPIC, named.get(STATES, ''))
        self._publishers = {STATES: self.node.create_publisher(JointState, states, STATE_DEPTH)}
        if CLOCK in roles:
            self._publishers[CLOCK] = self.node.create_publisher(Clock, '/clock', CLOCK_DEPTH)
        for role in sorted(OUTPUTS.keys() & set(roles)):
            package, folder, name = OUTPUTS[role].split('/')
            kind = getattr(importlib.import_module(f'{package}.{folder}'), name)
            self._publishers[role] = self.node.create_publisher(kind, f'~/{role}', STATE_DEPTH)
        # Serves publishers that are best effort, and reliable ones.
        served = QoSProfile(depth=COMMAND_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        kinds = {Source.NAMED: JointState, Source.ARRAY: Float64MultiArray}
        self._subscriptions = [
            self.node.create_subscription(
                kinds[source],
                topic_of(self.node, own, named.get(source, '')),
                partial(self._on_command, source),
                served,
                raw=True,
            )
            for source, own in COMMAND_TOPICS.items()
        ]
        self._arm: TopicRun | None = None
        self._ended: Any = None
        self._heard = 0.0

    def run(self, arm: TopicRun, nodes: Sequence[Any], patience: float) -> None:
        """Exchange states for commands until the arm ends the run.

        Parameters
        ----------
        arm
            The arm.
        nodes
            Nodes of the user whose callbacks should run meanwhile.
        patience
            Longest wait for an answer, s of wall time.

        Raises
        ------
        NoAnswerError
            If nobody answers for so long.
        """
        from rclpy.task import Future

        executor = executor_with([self.node, *nodes])
        self._wait_for_controller(executor, patience)
        self._arm, self._ended = arm, Future()
        try:
            self._publish(arm.present())
            self._heard = sent = time.monotonic()
            while not self._ended.done():
                spin(executor, LOOK_SECONDS, self._ended)
                now = time.monotonic()
                if now - self._heard > patience:
                    raise NoAnswerError(f'no answer to a state for {patience:g} s')
                if now - max(self._heard, sent) > RESEND_SECONDS:
                    sent = now
                    self._publish(arm.present())
        finally:
            self._arm = None

    def _wait_for_controller(self, executor: Any, patience: float) -> None:
        """Wait until somebody hears the arm and somebody publishes commands."""
        deadline = time.monotonic() + patience
        node = self.node
        while True:
            heard = any(end.get_subscription_count() for end in self._publishers.values())
            topics = [end.topic_name for end in self._subscriptions]
            if heard and any(node.count_publishers(topic) for topic in topics):
                return
            if time.monotonic() > deadline:
                missing = (
                    f'publishes commands on {" or ".join(topics)}'
                    if heard
                    else f'subscribes to {self._publishers[STATES].topic_name}'
                )
                raise NoAnswerError(f'after {patience:g} s nobody {missing}')
            spin(executor, LOOK_SECONDS / 10)

    def _on_command(self, source: Source, data: bytes) -> None:
        arm = self._arm
        if arm is None or self._ended.done():
            return
        outputs = arm.answer(source, data)
        if outputs is None:
            self._ended.set_result(None)
        elif outputs:
            self._heard = time.monotonic()
            self._publish(outputs)

    def _publish(self, outputs: Sequence[Output]) -> None:
        for role, _, data in outputs:
            publisher = self._publishers.get(role)
            if publisher is not None:
                publisher.publish(data)

    def close(self) -> None:
        """Take the node down."""
        take_down(self.node)


def require_rclpy() -> None:
    """Raise RuntimeError if rclpy is not initialised."""
    if not import_rclpy().ok():
        raise RuntimeError('rclpy is not initialised: let the test take the fixture ros_domain')


def bare_node(name: str, ros_args: Sequence[str] = ()) -> Any:
    """Return a node without services and log topic: each is an endpoint to be discovered."""
    from rclpy.node import Node
    from rclpy.parameter import Parameter

    return Node(
        name,
        cli_args=['--ros-args', *ros_args],
        enable_rosout=False,
        start_parameter_services=False,
        parameter_overrides=[Parameter('start_type_description_service', value=False)],
    )
