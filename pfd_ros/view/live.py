# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm of a running node in the page; the only module of this package that imports rclpy.

Topics have the names of the node's roles, resolved in its namespace: joint states, the wrench in
effect (`outputs` with `tip_wrench`), the payload in use and the model.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from operator import attrgetter
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
from pfd_ros.arm.description import parsed_urdf
from pfd_ros.arm.events import DESCRIPTION, PAYLOAD_IN_USE, REQUESTS, STATES, TIP_WRENCH
from pfd_ros.node.visitor import resolved, visitor
from pfd_ros.recording.recorder import topic_names
from pfd_ros.text import cut, listed, one_line
from pfd_ros.view.arm import Stage
from pfd_ros.view.links import named_model, with_meshes
from pfd_ros.view.loads import PAYLOADS, WRENCHES, Load, Source
from pfd_ros.view.logged import LARGEST_POSITION

NODE = '/sim_arm'
# Time [s] for a model to come, and without joint states until a line reports it.
MODEL_SECONDS, QUIET_SECONDS = 20.0, 5.0
# Updates of the page a second, callbacks between two of them, and lines about wrong messages.
RATE, CALLBACKS, MOST_LINES = 30.0, 6, 6
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


def topics_of(
    node: Node, arm: str, states: str | None = None, wrench: str | None = None
) -> dict[str, str]:
    """Return the topics of an arm by role; some may be given instead, resolved as its node does.

    ValueError if a name is invalid.
    """
    roles = STATES, TIP_WRENCH, PAYLOAD_IN_USE, DESCRIPTION
    names = topic_names(roles, {REQUESTS: f'{arm}/requests'})
    names |= {STATES: states or names[STATES], TIP_WRENCH: wrench or names[TIP_WRENCH]}
    return {role: resolved(node, name) for role, name in names.items()}


def model_of(node: Node, arm: str, topics: dict[str, str]) -> tuple[pfd.Urdf, Path | None]:
    """
    Return the model on the topic of the description, or of the arm's parameter `robot`.

    With it the folder of its file, if it is known. ValueError if neither comes within
    MODEL_SECONDS, or the text is no URDF.
    """
    texts: list[str] = []
    topic = topics[DESCRIPTION]

    def take(message: Any) -> None:
        texts.append(message.data)

    node.create_subscription(String, topic, take, LATCHED)
    client = node.create_client(GetParameters, f'{arm}/get_parameters')
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    answer = None
    deadline = time.monotonic() + MODEL_SECONDS
    try:
        while time.monotonic() < deadline:
            executor.spin_once(timeout_sec=0.1)
            if texts:
                return with_meshes(parsed_urdf(texts[-1], topic), None)
            if answer is None and client.service_is_ready():
                answer = client.call_async(GetParameters.Request(names=['robot']))
            if answer is not None and answer.done() and not node.count_publishers(topic):
                robot = ''.join(value.string_value for value in answer.result().values)
                if robot and robot != DESCRIPTION:
                    return named_model(robot)
    finally:
        executor.shutdown()
    raise ValueError(
        f'no model within {MODEL_SECONDS:g} s: nothing on {topic}, and no node {arm} with the '
        f'parameter `robot` {_domain()}; start the arm, name another one with --node, or its '
        'robot with --robot'
    )


def _domain() -> str:
    return f'in ROS_DOMAIN_ID {os.environ.get("ROS_DOMAIN_ID", "0")}'


def follow(
    node: Node, topics: dict[str, str], stage: Stage, report: Callable[[str], None]
) -> None:
    """Show the messages of an arm until an exception ends it; `report` takes lines for people."""
    shown, states = Shown(stage, report), topics[STATES]
    for role, kind, take, qos in (
        (STATES, JointState, shown.state, NEWEST),
        (TIP_WRENCH, WrenchStamped, partial(shown.load, WRENCHES), NEWEST),
        (PAYLOAD_IN_USE, InertiaStamped, partial(shown.load, PAYLOADS), LATCHED),
    ):
        node.create_subscription(kind, topics[role], take, qos)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    quiet_after: float | None = time.monotonic() + QUIET_SECONDS
    try:
        while True:
            # A state that nobody will see costs no Python: the reader keeps the last one.
            time.sleep(1.0 / RATE)
            before = shown.received
            for _ in range(CALLBACKS):
                executor.spin_once(timeout_sec=0.0)
            shown.draw()
            if shown.received and not before:
                report(f'receiving {states}')
            elif not shown.received and quiet_after and time.monotonic() > quiet_after:
                quiet_after = None
                report(
                    f'no message on {states} for {QUIET_SECONDS:g} s: is the arm running '
                    f'{_domain()}? --node names another one'
                )
    finally:
        executor.shutdown()


class Shown:
    """The last state, wrench and payload that came; `report` takes each line once."""

    def __init__(self, stage: Stage, report: Callable[[str], None]) -> None:
        self._stage, self._report = stage, report
        self._values = np.zeros(len(stage.joints)), np.full(len(stage.joints), np.nan)
        self._loads: dict[str, Load | None] = {WRENCHES.what: None, PAYLOADS.what: None}
        self._reported: set[str] = set()
        self._changed = True
        self.received = 0

    def state(self, message: Any) -> None:
        """Take a JointState; joints that it does not name stay where they are."""
        self.received += 1
        self._changed = True
        joints = self._stage.joints
        if not set(message.name) & set(joints):
            self._say(f'no joint of the model in joint states of {listed(message.name)}')
        for target, values in zip(self._values, (message.position, message.effort), strict=True):
            # A field may be empty, or shorter than the names.
            for name, value in zip(message.name, values, strict=False):
                if name in joints and abs(value) <= LARGEST_POSITION:
                    target[joints.index(name)] = value

    def load(self, source: Source, message: Any) -> None:
        """Take a message about a load in effect."""
        frame, numbers = message.header.frame_id, attrgetter(*source.paths)(message)
        links = self._stage.poses.links
        self._loads[source.what] = source.load(frame, numbers, links, self._say)
        self._changed = True

    def draw(self) -> None:
        """Show what has come, if it is new."""
        if self._changed:
            self._changed = False
            self._stage.show(*self._values, *self._loads.values())

    def _say(self, line: str) -> None:
        if line not in self._reported and len(self._reported) < MOST_LINES:
            self._reported.add(line)
            self._report(one_line(line))
