# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Models and logs that the tests of `pfd view` show."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
import re
from typing import Any

from bags import STORE, rosbag2
from bridge import LockstepArm, ViewContent, fill_view
import msgspec
import numpy as np
import pinocchio as pin
from ros_processes import example_robot
import zstandard

import pfd_core as pfd
from pfd_ros import read_log

UR5 = 'ur_description/urdf/ur5_robot.urdf'
PANDA = 'panda_description/urdf/panda.urdf'
SO100 = 'so_arm_description/urdf/so100.urdf'
STATE, STRING = 'sensor_msgs/msg/JointState', 'std_msgs/msg/String'
WRENCH = 'geometry_msgs/msg/WrenchStamped'


def urdf(*visuals: str, robot: str = '') -> str:
    """Return the URDF of a pendulum of 0.4 m with these visuals on its arm."""
    body = (
        '<inertial><origin xyz="0 0 -0.2"/><mass value="2"/>'
        '<inertia ixx="0.1" iyy="0.1" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    return (
        f'<robot name="pendulum">{robot}<link name="base"/>'
        f'<link name="arm">{body}{"".join(visuals)}</link><link name="end"/>'
        '<joint name="swing" type="revolute"><parent link="base"/><child link="arm"/>'
        '<origin xyz="0 0 0.5"/><axis xyz="0 1 0"/>'
        '<limit lower="-3" upper="3" velocity="9" effort="10"/></joint>'
        '<joint name="weld" type="fixed"><parent link="arm"/><child link="end"/>'
        '<origin xyz="0 0 -0.4"/></joint></robot>'
    )


def visual(geometry: str, origin: str = '', material: str = '') -> str:
    """Return a <visual>."""
    return f'<visual>{origin}<geometry>{geometry}</geometry>{material}</visual>'


def parsed(text: str) -> pfd.Urdf:
    """Return the record of a URDF."""
    found = pfd.read_urdf(text)
    assert found is not None
    return found


def recorded(path: Path, robot: Any, seconds: float = 0.5, **settings: Any) -> Path:
    """Record an arm that swings."""
    with LockstepArm(robot, recording=path, **settings) as arm:
        swing = np.linspace(3.0, -2.0, len(arm.names))
        arm.run(lambda t, q, qd: swing * np.cos(9.0 * t) - 0.3 * qd, seconds)
    return path


def example_urdf(path: str) -> tuple[pfd.Urdf, Path]:
    """Return a robot of example-robot-data and the folder of its file."""
    source = example_robot(path)
    found = pfd.read_urdf(source)
    assert found is not None
    return found, source.parent


Message = tuple[str, str, int, Any]


def joint_state(
    seconds: float, names: Sequence[str], position: Sequence[float], effort: Sequence[float] = ()
) -> Any:
    """Return a JointState of rosbags."""
    types = STORE.types
    stamp = types['builtin_interfaces/msg/Time'](*divmod(round(seconds * 1e9), 10**9))
    return types[STATE](
        types['std_msgs/msg/Header'](stamp, ''),
        list(names),
        np.array(position, float),
        np.array([]),
        np.array(effort, float),
    )


def write_bag(path: Path, messages: Iterable[Message]) -> Path:
    """Write messages, each with topic, type and log time [ns], by rosbags."""
    with rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, log_ns, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            data = STORE.serialize_cdr(message, kind)
            writer.write(connections[topic], log_ns, data)
    return path


def swinging(
    path: Path, times: Sequence[float], *, text: str | None = None, topic: str = '/joint_states'
) -> Path:
    """Write a bag of the pendulum of `urdf`, at position t at time t [s]; log times are later."""
    described = [] if text is None else [('/robot_description', STRING, 0, text_message(text))]
    states = [
        (topic, STATE, round((t + 0.5) * 1e9), joint_state(t + 100.0, ['swing'], [t], [-10.0 * t]))
        for t in times
    ]
    return write_bag(path, [*described, *states])


def text_message(text: str) -> Any:
    """Return a String of rosbags."""
    return STORE.types[STRING](text)


def wrench_message(frame: str, force: tuple[float, ...], torque: tuple[float, ...]) -> Any:
    """Return a WrenchStamped of rosbags with the stamp 0."""
    types = STORE.types
    vector = types['geometry_msgs/msg/Vector3']
    header = types['std_msgs/msg/Header'](types['builtin_interfaces/msg/Time'](0, 0), frame)
    body = types['geometry_msgs/msg/Wrench'](vector(*force), vector(*torque))
    return types[WRENCH](header, body)


def pushed_bag(path: Path, frame: str = 'end') -> Path:
    """Write a bag of the pendulum with wrenches at 0.15 s and 0.35 s, log times from 10 s on."""
    messages: list[Any] = [('/robot_description', STRING, 0, text_message(urdf()))]
    for k in range(5):
        state = joint_state(100.0 + 0.1 * k, ['swing'], [0.3 * k])
        messages.append(('/joint_states', STATE, round((10 + 0.1 * k) * 1e9), state))
        if k in (1, 3):
            force = (4.0, 0.0, 0.0) if k == 1 else (0.0, 0.0, 0.0)
            sent = wrench_message(frame, force, (0.0, 0.0, 0.0))
            for topic in ('/arm/external_wrench', '/sensor/wrench'):
                messages.append((topic, WRENCH, round((10.05 + 0.1 * k) * 1e9), sent))
    return write_bag(path, messages)


def ur5_poses(log: Path) -> Callable[[int, str], pin.SE3]:
    """Return a function from a state of a log and a link of the UR5 to its pose, by Pinocchio."""
    model = pin.buildModelFromUrdf(str(example_robot(UR5)))
    data, states = model.createData(), read_log(log)['/joint_states']

    def pose(place: int, link: str) -> pin.SE3:
        q = pin.neutral(model)
        for name, value in zip(states.names, states.position[place], strict=True):
            q[model.joints[model.getJointId(name)].idx_q] = value
        pin.framesForwardKinematics(model, data, q)
        return data.oMf[model.getFrameId(link, pin.FrameType.BODY)].copy()

    return pose


def pendulum_end(q: float) -> pin.SE3:
    """Return the pose of the link `end` of the pendulum of `urdf`, by Pinocchio."""
    model = pin.buildModelFromXML(urdf())
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array([q]))
    return data.oMf[model.getFrameId('end', pin.FrameType.BODY)].copy()


class Nodes:
    """The nodes of a page that shows a log."""

    def __init__(self, server: Any, content: ViewContent) -> None:
        self._scene = server.scene
        self.show = fill_view(server, content)

    def __getitem__(self, name: str) -> Any:
        return self._scene.get_handle_by_name(name)

    def pose(self, name: str) -> pin.SE3:
        """Return the pose of a node in the world, from those of its parents."""
        found = pin.SE3.Identity()
        parts = name.strip('/').split('/')
        for k in range(len(parts)):
            node = self[f'/{"/".join(parts[: k + 1])}']
            w, x, y, z = node.wxyz
            found = found * pin.SE3(pin.Quaternion(w, x, y, z).matrix(), np.array(node.position))
        return found

    def points(self, name: str) -> np.ndarray:
        """Return the vertices of a mesh in the world, as a browser places them."""
        node, pose = self[name], self.pose(name)
        return (node.vertices * np.array(node.scale)) @ pose.rotation.T + pose.translation


class Exported:
    """The messages in an exported page, by their time."""

    def __init__(self, path: Path) -> None:
        found = re.search(r'__VISER_EMBED_DATA__="([^"]*)"', path.read_text(encoding='utf-8'))
        assert found is not None
        data = base64.b64decode(found[1])
        size = int.from_bytes(data[:8], 'little')
        raw = zstandard.ZstdDecompressor().decompress(data[8:], max_output_size=size)
        header = 8 + int.from_bytes(raw[:8], 'little')
        decoded = msgspec.msgpack.decode(raw[8:header])
        self.duration = decoded['durationSeconds']
        self.messages = decoded['messages']

    def positions(self, node: str) -> list[tuple[float, list[float]]]:
        """Return the times [s] and positions of a node."""
        return [
            (time, message['position'])
            for time, message in self.messages
            if message.get('name') == node and message['type'] == 'SetPositionMessage'
        ]
