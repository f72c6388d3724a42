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
import time
from typing import Any

from pfd_ros.arm.events import CLOCK, STATES, Output, Source
from pfd_ros.arm.settings import OUTPUTS
from pfd_ros.messages.topics import message_class, topic_of
from pfd_ros.recording.format import CHANNELS, ROLE_OF_SOURCE
from pfd_ros.testing.controller import blocked, raised
from pfd_ros.testing.controllers import Controllers, split
from pfd_ros.testing.patience import BlockedError, Waits, Watch
from pfd_ros.testing.rejections import RejectedError
from pfd_ros.testing.session import executor_with, import_rclpy, spin, take_down
from pfd_ros.testing.topic_run import TopicRun

NAME = 'sim_arm'
COMMAND_ROLES = {source: ROLE_OF_SOURCE[source] for source in (Source.NAMED, Source.ARRAY)}
STATE_DEPTH, COMMAND_DEPTH, CLOCK_DEPTH = 10, 100, 1
# After the answer to a state that was sent again, its repetitions may come for so long, s.
REPEAT_SECONDS = 0.2
# Between two looks at the clock while the executor spins; a signal waits as long.
LOOK_SECONDS = 0.1


class Exchange:
    """A node with the arm's name and topics.

    Parameters
    ----------
    roles
        Roles of the published outputs.
    ros_args
        Arguments of the node as on a command line: remappings, its namespace.
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
        ros_args: Sequence[str],
        topics: Mapping[Source | str, str],
    ) -> None:
        require_rclpy()
        from rclpy.qos import QoSProfile, ReliabilityPolicy

        self.node = bare_node(NAME, ros_args)
        self._publishers = {}
        for role in (STATES, *sorted({CLOCK, *OUTPUTS} & set(roles))):
            kind, own, *_ = CHANNELS[role]
            depth = CLOCK_DEPTH if role == CLOCK else STATE_DEPTH
            topic = topic_of(self.node, own, topics.get(role, ''))
            self._publishers[role] = self.node.create_publisher(message_class(kind), topic, depth)
        # Compatible with best-effort and with reliable publishers.
        served = QoSProfile(depth=COMMAND_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._subscriptions = {
            source: self.node.create_subscription(
                message_class(CHANNELS[role].type),
                topic_of(self.node, CHANNELS[role].topic, topics.get(source, '')),
                partial(self._on_command, source),
                served,
                raw=True,
            )
            for source, role in COMMAND_ROLES.items()
        }
        self._arm: TopicRun | None = None
        # Times: of the beginning of the run, of the first publication of the last state, since
        # which readers can answer it, and of its last publication.
        self._begun = self._published = self._since = self._sent = 0.0
        self._again = False
        self._fault: Exception | None = None
        # The answer to a state that was sent again, and when it came.
        self._first: tuple[Source, bytes, float] | None = None

    def run(self, arm: TopicRun, controllers: Sequence[Any], waits: Waits) -> None:
        """Exchange states for commands until the arm ends the run.

        Parameters
        ----------
        arm
            The arm.
        controllers
            Nodes of the user whose callbacks should run meanwhile, and ControllerProcess objects.
        waits
            How long to wait for them.

        Raises
        ------
        NoAnswerError
            If there is no answer in time, or a process ended.
        ControllerError
            If a node blocks, or the arm rejects a command.
        """
        from rclpy.task import Future

        nodes, processes = split(controllers)
        executor = executor_with([self.node, *nodes])
        self._ended, self._first, self._fault = Future(), None, None
        start = waits.start_of(nodes, processes)
        commands = [end.topic_name for end in self._subscriptions.values()]
        states, own = self._publishers[STATES].topic_name, {self.node.get_fully_qualified_name()}
        self._controllers = Controllers(self.node, states, commands, nodes, processes, own)
        try:
            with Watch(waits.patience) as self._watch:
                self._begun = time.perf_counter()
                while not self._ended.done():
                    if not arm.answers:
                        self._begin(arm, start)
                    self._spin(executor, LOOK_SECONDS if self._arm else LOOK_SECONDS / 10)
                    if self._fault is not None:
                        raise self._fault
                    self._look(arm, waits)
        except BlockedError:
            raise blocked(self._watch, waits.patience, arm.time, arm.answers) from None
        finally:
            self._arm = None

    def _begin(self, arm: TopicRun, start: float) -> None:
        """Publish the first state once there are a subscriber and a publisher of commands."""
        found, now = self._controllers, time.perf_counter()
        heard = any(end.get_subscription_count() for end in self._publishers.values())
        if heard and found.publishers() and self._arm is None:
            self._arm = arm
            self._publish_state(arm.present())
        if not (heard and found.found()):
            self._since = now
            found.check(None, 0)
            if now - self._begun > start:
                raise found.absence(start)

    def _spin(self, executor: Any, seconds: float) -> None:
        self._watch.since = time.perf_counter()
        try:
            spin(executor, seconds, self._ended)
        except Exception as error:
            arm = self._arm
            raise raised(error, *((arm.time, arm.answers) if arm else (0.0, 0))) from error
        self._watch.since = 0.0

    def _look(self, arm: TopicRun, waits: Waits) -> None:
        """Raise NoAnswerError without an answer; before that, publish the state again."""
        if self._arm is None:
            return
        now, answers = time.perf_counter(), arm.answers
        if self._first is not None and now - self._first[2] > REPEAT_SECONDS:
            first, self._first = self._first, None
            self._answer(arm, *first)
        self._controllers.check(arm.time, answers)
        waited = now - self._since
        if waited > waits.patience:
            raise self._controllers.silence(arm.time, answers, waited, arm.rejected)
        if now - self._sent > waits.resend:
            self._sent, self._again = now, True
            arm.repeats += 1
            self._publish(arm.present())

    def _on_command(self, source: Source, data: bytes) -> None:
        arm, now = self._arm, time.perf_counter()
        if arm is None or self._ended.done():
            return
        if not self._again:
            self._answer(arm, source, data, now)
        elif self._first is None:
            # A state that was sent again has more than one answer: the next state comes later.
            self._first = source, data, now
        else:
            arm.repeats -= 1

    def _answer(self, arm: TopicRun, source: Source, data: bytes, now: float) -> None:
        # Meanwhile it is the arm's turn.
        self._watch.since = 0.0
        try:
            self._go_on(arm, source, data, now)
        except Exception as error:
            self._fault = error
            self._ended.set_result(None)
        self._watch.since = time.perf_counter()

    def _go_on(self, arm: TopicRun, source: Source, data: bytes, now: float) -> None:
        try:
            outputs = arm.answer(source, data, now - self._published)
        except RejectedError as error:
            topic = self._subscriptions[source].topic_name
            raise self._controllers.rejected(topic, arm.time, arm.answers, error) from None
        if outputs is None:
            self._ended.set_result(None)
        elif outputs:
            self._publish_state(outputs)

    def _publish_state(self, outputs: Sequence[Output]) -> None:
        self._published = self._since = self._sent = time.perf_counter()
        self._again = False
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


def bare_node(name: str, ros_args: Sequence[str]) -> Any:
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
