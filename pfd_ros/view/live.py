# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm of a running node in the page: the only module of this package that imports rclpy.

The arm is the node that publishes the joint states, or a node by its name. Its other topics are
found in the graph by their types, so that namespaces and remappings do not matter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
import os
import time
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import InertiaStamped, WrenchStamped
from rcl_interfaces.srv import GetParameters
import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.exceptions import NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.qos import (
    DurabilityPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_sensor_data,
)
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from rclpy.validate_full_topic_name import validate_full_topic_name
from rclpy.validate_node_name import validate_node_name
from sensor_msgs.msg import JointState

import pfd_core as pfd
from pfd_ros.arm.events import DESCRIPTION
from pfd_ros.arm.settings import OUTPUTS
from pfd_ros.messages.convert import INERTIA, JOINT_STATE, WRENCH
from pfd_ros.messages.stamped import WrenchMessage, wrench_message
from pfd_ros.messages.topics import UNKNOWN_NODE
from pfd_ros.node.description import wait_for_description
from pfd_ros.text import cut
from pfd_ros.view.live_arm import LiveArm

TOPIC = 'joint_states'
# Time [s] for a model to come, for a parameter to be answered, and without joint states until a
# line says so.
MODEL_SECONDS, ANSWER_SECONDS, QUIET_SECONDS = 20.0, 5.0, 5.0
# Updates of the page a second, and the time [s] between two looks at the graph.
RATE, LOOK_SECONDS = 30.0, 0.5
# Callbacks between two updates, at most: a state, wrenches, a payload, a report.
CALLBACKS = 6
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class ArmNode(NamedTuple):
    """The name and the namespace of the node of an arm."""

    name: str
    namespace: str

    @property
    def full(self) -> str:
        """The full name."""
        return f'{self.namespace.rstrip("/")}/{self.name}'


def arm_node(full: str) -> ArmNode:
    """Return a node by its full name, such as /left/sim_arm."""
    namespace, _, name = full.rpartition('/')
    return ArmNode(name, f'/{namespace.strip("/")}')


@contextmanager
def view_node(namespace: str = '/') -> Iterator[Node]:
    """
    Make the node of the view, which leaves signals to this program.

    Raises
    ------
    ValueError
        If the namespace is invalid, or ROS cannot start, such as in an invalid domain.

    """
    try:
        try:
            rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
            node = rclpy.create_node(
                'pfd_view',
                namespace=namespace,
                start_parameter_services=False,
                enable_rosout=False,
            )
        except NameValidationException as error:
            raise ValueError(f'{namespace!r} is not a valid node namespace') from error
        except RCLError as error:
            raise ValueError(f'ROS: {error}') from error
        yield node
    finally:
        try_shutdown()


@dataclass
class LiveTopics:
    """
    The topics of an arm, as far as the graph has them.

    Parameters
    ----------
    node : Node
        The node of the view, in the namespace of the arm.
    topic : str or None
        The topic of joint states; default: the one of the named arm, or `joint_states`.
    named : ArmNode or None
        The arm; default: the publisher of the joint states.
    wrench_topic : str or None
        A topic of wrenches that replaces the arm's.

    Raises
    ------
    ValueError
        If a name is invalid.

    """

    node: Node
    topic: str | None = None
    named: ArmNode | None = None
    wrench_topic: str | None = None

    def __post_init__(self) -> None:
        """Check the names here: rclpy would raise errors of other types later."""
        for topic in (self.topic, self.wrench_topic):
            if topic is not None:
                try:
                    validate_full_topic_name(self.node.resolve_topic_name(topic))
                except (NameValidationException, RCLError) as error:
                    raise ValueError(f'{cut(topic)!r} is not a valid topic name') from error
        if self.named is not None:
            try:
                validate_node_name(self.named.name)
            except NameValidationException as error:
                raise ValueError(f'{cut(self.named.name)!r} is not a valid node name') from error

    @property
    def states(self) -> str:
        """The topic of joint states, '' if it is not known yet."""
        if self.topic is None and self.named is not None:
            names = self._of_arm(self.named, 'publisher', JOINT_STATE)
            own = [name for name in names if name.rpartition('/')[2] not in OUTPUTS]
            return min(own, key=lambda name: name.rpartition('/')[2] != TOPIC, default='')
        return self.node.resolve_topic_name(self.topic or TOPIC)

    @property
    def arm(self) -> ArmNode | None:
        """The node of the arm, None if it is not known yet."""
        if self.named is not None:
            return self.named if self._of_arm(self.named, 'publisher', JOINT_STATE) else None
        for end in self.node.get_publishers_info_by_topic(self.states):
            if end.node_name != UNKNOWN_NODE:
                return ArmNode(end.node_name, end.node_namespace)
        return None

    def found(self) -> Iterator[tuple[str, str]]:
        """Yield purpose and name of each topic that the arm has."""
        if self.states:
            yield 'states', self.states
        arm = self.arm
        if arm is not None:
            ends = [('payload', 'publisher', INERTIA)]
            if self.wrench_topic is None:
                ends += [('acting', 'publisher', WRENCH), ('sent', 'subscriber', WRENCH)]
            for purpose, kind, message in ends:
                for name in self._of_arm(arm, kind, message):
                    yield purpose, name
        if self.wrench_topic is not None:
            yield 'acting', self.node.resolve_topic_name(self.wrench_topic)

    def _of_arm(self, arm: ArmNode, kind: str, message: str) -> list[str]:
        """Return the topics of a type of which the arm has a publisher or a subscriber."""
        look = getattr(self.node, f'get_{kind}_names_and_types_by_node')
        try:
            return [name for name, kinds in look(*arm) if message in kinds]
        except NodeNameNonExistentError:
            return []

    def model(self) -> pfd.Urdf | str:
        """
        Return the model on robot_description, or the name or path in the arm's parameter `robot`.

        Raises
        ------
        ValueError
            If neither is found within MODEL_SECONDS, or the text is not a URDF.

        """
        end = time.monotonic() + MODEL_SECONDS
        topic = self.node.resolve_topic_name(DESCRIPTION)
        cure = 'or name the robot with --robot'
        while time.monotonic() < end:
            if self.node.count_publishers(topic):
                try:
                    return wait_for_description(self.node, MODEL_SECONDS, lambda: False)
                except ValueError as error:
                    raise ValueError(f'{error}; {cure}') from error
            arm = self.arm
            robot = '' if arm is None else self._robot_of(arm)
            if robot and robot != DESCRIPTION:
                return robot
            time.sleep(LOOK_SECONDS)
        raise ValueError(
            f'no model within {MODEL_SECONDS:g} s: nothing on {topic}, and no arm with the '
            f'parameter `robot` on {self.states or TOPIC} in ROS_DOMAIN_ID {_domain()}: is the '
            f'arm running? {cure[3:].capitalize()}'
        )

    def _robot_of(self, arm: ArmNode) -> str:
        """Return the parameter `robot` of an arm, '' if it has none or does not answer."""
        client = self.node.create_client(GetParameters, f'{arm.full}/get_parameters')
        executor = SingleThreadedExecutor(context=self.node.context)
        try:
            if not client.wait_for_service(ANSWER_SECONDS):
                return ''
            executor.add_node(self.node)
            answer = client.call_async(GetParameters.Request(names=['robot']))
            executor.spin_until_future_complete(answer, ANSWER_SECONDS)
            values = answer.result().values if answer.done() else []
            return str(values[0].string_value) if values else ''
        finally:
            executor.shutdown()
            self.node.destroy_client(client)


def follow(topics: LiveTopics, arm: LiveArm, report: Callable[[str], None]) -> None:
    """
    Show the messages of an arm until an exception, such as KeyboardInterrupt, ends it.

    Parameters
    ----------
    topics : LiveTopics
        Its topics.
    arm : LiveArm
        The arm in the page.
    report : callable
        Takes lines for the user.

    """
    node = topics.node
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    ends = _Ends(topics, arm)
    start = time.monotonic()
    looked = -LOOK_SECONDS
    receiving = quiet = malformed = False
    try:
        while True:
            # A state that nobody will see costs no Python: the reader keeps the last one.
            time.sleep(1.0 / RATE)
            for _ in range(CALLBACKS):
                executor.spin_once(timeout_sec=0.0)
            arm.draw()
            now = time.monotonic()
            if now - looked >= LOOK_SECONDS:
                looked = now
                ends.look()
            if arm.received and not receiving:
                receiving = True
                report(f'receiving {topics.states}')
            elif not receiving and not quiet and now - start > QUIET_SECONDS:
                quiet = True
                what = topics.states or f'the joint states of {getattr(topics.named, "full", "")}'
                report(
                    f'no message on {what} for {QUIET_SECONDS:g} s: is the arm running, and in '
                    f'ROS_DOMAIN_ID {_domain()}? --topic or --node name others'
                )
            if arm.malformed and not malformed:
                malformed = True
                report(f'{topics.states} has invalid joint states; they are not shown')
    finally:
        executor.shutdown()


def _domain() -> str:
    return os.environ.get('ROS_DOMAIN_ID', '0')


@dataclass
class _Ends:
    """The subscriptions of the view; each is made when the graph has the topic."""

    topics: LiveTopics
    arm: LiveArm
    _made: set[tuple[str, str]] = field(default_factory=set)

    def look(self) -> None:
        """Subscribe to the topics that were found since."""
        for end in self.topics.found():
            if end not in self._made:
                self._made.add(end)
                self._subscribe(*end)

    def _subscribe(self, purpose: str, name: str) -> None:
        node, arm = self.topics.node, self.arm
        # Whatever the publisher's reliability is, and of states only the last one counts.
        plain = qos_profile_sensor_data
        if purpose == 'states':
            node.create_subscription(JointState, name, arm.take, NEWEST, raw=True)
        elif purpose == 'payload':
            node.create_subscription(InertiaStamped, name, arm.take_payload, LATCHED, raw=True)
        elif purpose == 'acting':
            take = arm.take_acting_wrench
            node.create_subscription(WrenchStamped, name, take, NEWEST, raw=True)
        else:
            node.create_subscription(WrenchStamped, name, self._take_sent, plain, raw=True)
            node.create_subscription(DiagnosticArray, '/diagnostics', self._take_report, plain)

    def _take_sent(self, data: bytes) -> None:
        self.arm.take_sent_wrench(data, time.monotonic())

    def _take_report(self, message: Any) -> None:
        arm = self.topics.arm
        if arm is None:
            return
        for status in message.status:
            if status.name != f'{arm.full.lstrip("/")}: simulation':
                continue
            values = {item.key: item.value for item in status.values}
            found = _reported(values)
            if found is not None:
                self.arm.take_reported_wrench(*found, time.monotonic())


def _reported(values: dict[str, str]) -> tuple[WrenchMessage, float] | None:
    """Return the wrench and the timeout in values of diagnostics, None without."""
    try:
        numbers = [*map(float, values['external_wrench'].split())]
        timeout = float(values['external_wrench_timeout_s'])
        frame = values['external_wrench_frame']
    except (KeyError, ValueError):
        return None
    return wrench_message(0, frame, numbers), timeout
