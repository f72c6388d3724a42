# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm of a running node in the page; the only module of this package that imports rclpy.

Topics have the names of the node's roles, resolved in its namespace: joint states, the wrench in
effect (`outputs` with `tip_wrench`), the payload in use and the model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
import math
import os
from pathlib import Path
import time
from typing import Any

from geometry_msgs.msg import InertiaStamped, WrenchStamped
import numpy as np
from rcl_interfaces.srv import GetParameters
from rclpy.exceptions import NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.validate_node_name import validate_node_name
from sensor_msgs.msg import JointState
from std_msgs.msg import String

import pfd_core as pfd
from pfd_ros.arm.events import ROLES
from pfd_ros.node.visitor import resolved, visitor
from pfd_ros.text import cut, listed, one_line
from pfd_ros.view.arm import Stage
from pfd_ros.view.forms import named_model, parsed_urdf
from pfd_ros.view.loads import Payload, Wrench

NODE = '/sim_arm'
STATES, WRENCH, PAYLOAD = 'joint_states', 'tip_wrench', 'payload_in_use'
DESCRIPTION = 'robot_description'
# Time [s] for a model to come, and without joint states until a line reports it.
MODEL_SECONDS, QUIET_SECONDS = 20.0, 5.0
# Updates of the page a second, and callbacks between two of them at most.
RATE, CALLBACKS = 30.0, 6
# Positions beyond this [rad, m] are not drawn.
LARGEST_POSITION = 1e6
# Of states only the last one counts, whatever the publisher's reliability is.
NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def view_node(arm: str) -> AbstractContextManager[Node]:
    """Make the node of the view in the namespace of an arm, such as `/left/sim_arm`."""
    namespace, _, name = arm.rpartition('/')
    try:
        validate_node_name(name)
    except NameValidationException as error:
        raise ValueError(f'{cut(name)!r} is not a valid node name') from error
    return visitor('pfd_view', f'/{namespace.strip("/")}')


class Topics:
    """
    The topics of an arm by role, resolved as its node does; some may be given instead.

    ValueError if a name is invalid.
    """

    def __init__(
        self, node: Node, arm: str, states: str | None = None, wrench: str | None = None
    ) -> None:
        self.node, self.arm = node, arm
        given = {STATES: states, WRENCH: wrench}
        self._names = {
            role: self._resolved(ROLES[role].topic if given.get(role) is None else given[role])
            for role in (STATES, WRENCH, PAYLOAD, DESCRIPTION)
        }

    def __getitem__(self, role: str) -> str:
        """Return the name of a role's topic."""
        return self._names[role]

    def _resolved(self, topic: str | None) -> str:
        name = str(topic)
        return resolved(self.node, f'{self.arm}{name[1:]}' if name.startswith('~/') else name)

    def model(self) -> tuple[pfd.Urdf, Path | None]:
        """
        Return the model on the topic of the description, or of the arm's parameter `robot`.

        With it the folder of its file, if it is known. ValueError if neither comes within
        MODEL_SECONDS, or the text is no URDF.
        """
        texts: list[str] = []

        def take(message: Any) -> None:
            texts.append(message.data)

        topic = self[DESCRIPTION]
        end = self.node.create_subscription(String, topic, take, LATCHED)
        client = self.node.create_client(GetParameters, f'{self.arm}/get_parameters')
        executor = SingleThreadedExecutor(context=self.node.context)
        executor.add_node(self.node)
        answer = None
        deadline = time.monotonic() + MODEL_SECONDS
        try:
            while time.monotonic() < deadline:
                executor.spin_once(timeout_sec=0.1)
                if texts:
                    return parsed_urdf(texts[-1], topic), None
                if answer is None and client.service_is_ready():
                    answer = client.call_async(GetParameters.Request(names=['robot']))
                if answer is not None and answer.done() and not self.node.count_publishers(topic):
                    robot = ''.join(value.string_value for value in answer.result().values)
                    if robot and robot != DESCRIPTION:
                        return named_model(robot)
        finally:
            executor.shutdown()
            self.node.destroy_client(client)
            self.node.destroy_subscription(end)
        raise ValueError(
            f'no model within {MODEL_SECONDS:g} s: nothing on {topic}, and no node {self.arm} '
            f'with the parameter `robot` in ROS_DOMAIN_ID {_domain()}{self.others()}; start '
            'the arm, or name the robot with --robot'
        )

    def others(self) -> str:
        """Return a hint at other topics of joint states, '' without any."""
        found = [
            name
            for name, kinds in self.node.get_topic_names_and_types()
            if 'sensor_msgs/msg/JointState' in kinds
            and name.endswith(f'/{STATES}')
            and name != self[STATES]
            and self.node.count_publishers(name)
        ]
        return f' (joint states are on {listed(found)}: --node names an arm)' if found else ''


def follow(topics: Topics, stage: Stage, report: Callable[[str], None]) -> None:
    """Show the messages of an arm until an exception ends it; `report` takes lines for people."""
    node, shown = topics.node, Shown(stage, report)
    for role, kind, take, qos in (
        (STATES, JointState, shown.state, NEWEST),
        (WRENCH, WrenchStamped, shown.wrench, NEWEST),
        (PAYLOAD, InertiaStamped, shown.payload, LATCHED),
    ):
        node.create_subscription(kind, topics[role], take, qos)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    start = time.monotonic()
    receiving = quiet = False
    try:
        while True:
            # A state that nobody will see costs no Python: the reader keeps the last one.
            time.sleep(1.0 / RATE)
            for _ in range(CALLBACKS):
                executor.spin_once(timeout_sec=0.0)
            shown.draw()
            if shown.received and not receiving:
                receiving = True
                report(f'receiving {topics[STATES]}')
            elif not receiving and not quiet and time.monotonic() - start > QUIET_SECONDS:
                quiet = True
                report(
                    f'no message on {topics[STATES]} for {QUIET_SECONDS:g} s: is the arm running, '
                    f'and in ROS_DOMAIN_ID {_domain()}?{topics.others()}'
                )
    finally:
        executor.shutdown()


class Shown:
    """The last state, wrench and payload that came; `report` takes each line once."""

    def __init__(self, stage: Stage, report: Callable[[str], None]) -> None:
        self._stage, self._report = stage, report
        self._place = {name: k for k, name in enumerate(stage.joints)}
        self._position = np.zeros(len(stage.joints))
        self._effort = np.full(len(stage.joints), np.nan)
        self._wrench: Wrench | None = None
        self._payload: Payload | None = None
        self._reported: set[str] = set()
        self._changed = True
        self.received = 0

    def state(self, message: Any) -> None:
        """Take a JointState; joints that it does not name stay where they are."""
        self.received += 1
        unknown = [name for name in message.name if name not in self._place]
        if len(unknown) == len(message.name):
            self._say(f'no joint of the model in joint states of {listed(unknown)}')
        for target, values in (
            (self._position, message.position),
            (self._effort, message.effort),
        ):
            # A field may be empty, or shorter than the names.
            for name, value in zip(message.name, values, strict=False):
                place = self._place.get(name)
                if place is not None and abs(value) <= LARGEST_POSITION:
                    target[place] = value
        self._changed = True

    def wrench(self, message: Any) -> None:
        """Take a WrenchStamped of the wrench in effect."""
        force, torque = message.wrench.force, message.wrench.torque
        taken = Wrench(message.header.frame_id, _xyz(force), _xyz(torque))
        shows = self._shows('wrench', taken.frame, (*taken.force, *taken.torque))
        self._wrench = taken if shows and any((*taken.force, *taken.torque)) else None
        self._changed = True

    def payload(self, message: Any) -> None:
        """Take an InertiaStamped of the payload in use."""
        body = message.inertia
        inertia = (body.ixx, body.ixy, body.ixz, body.iyy, body.iyz, body.izz)
        taken = Payload(message.header.frame_id, body.m, _xyz(body.com), inertia)
        numbers = (body.m, *taken.center, *inertia)
        there = body.m > 0 and self._shows('payload', taken.frame, numbers)
        self._payload = taken if there else None
        self._changed = True

    def draw(self) -> None:
        """Show what has come, if it is new."""
        if self._changed:
            self._changed = False
            self._stage.show(self._position, self._effort, self._wrench, self._payload)

    def _shows(self, what: str, frame: str, numbers: Iterable[float]) -> bool:
        if not all(map(math.isfinite, numbers)):
            return False
        if frame not in self._stage.poses.links:
            self._say(f'a {what} is not shown: its frame {cut(frame)!r} is no link of the model')
        return frame in self._stage.poses.links

    def _say(self, line: str) -> None:
        if line not in self._reported and len(self._reported) < CALLBACKS:
            self._reported.add(line)
            self._report(one_line(line))


def _xyz(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _domain() -> str:
    return os.environ.get('ROS_DOMAIN_ID', '0')
