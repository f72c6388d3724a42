# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An arm in a page that follows joint states, wrenches and payloads as they come."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

import pfd_core as pfd
from pfd_ros.messages.convert import decode_joint_state
from pfd_ros.messages.stamped import InertiaMessage, WrenchMessage, decode_inertia, decode_wrench
from pfd_ros.view.loads import Loads
from pfd_ros.view.log_loads import is_nothing
from pfd_ros.view.mesh_files import MeshFolders
from pfd_ros.view.motion import LARGEST_POSITION
from pfd_ros.view.poses import LinkPoses
from pfd_ros.view.running_wrench import RunningWrench
from pfd_ros.view.scene import DrawnArm, JointRings, add_floor
from pfd_ros.view.server import look_at
from pfd_ros.view.shapes import draw
from pfd_ros.view.skeleton import reach_of
from pfd_ros.view.tip_loads import (
    PAYLOAD_LEGEND,
    WRENCH_LEGEND,
    DrawnPayload,
    DrawnWrench,
    scale_of,
)

# Longest message that is decoded.
MOST_BYTES = 1 << 20
MOVING = ('revolute', 'continuous', 'prismatic')
T = TypeVar('T')


class LiveArm:
    """
    An arm that follows messages, which come as bytes.

    Parameters
    ----------
    server : viser.ViserServer
        An empty page.
    urdf : Urdf
        The model.
    folders : MeshFolders
        Where its meshes are.
    newtons : float, optional
        Force [N] of an arrow of 1 m, as `scale_of` takes it.

    Attributes
    ----------
    problems : tuple of str
        What is not drawn as the URDF says, a line each.
    received, malformed : int
        Messages received, and the invalid ones among them.

    """

    def __init__(
        self, server: Any, urdf: pfd.Urdf, folders: MeshFolders, newtons: float | None = None
    ) -> None:
        joints = [j.name for j in urdf.joints.values() if j.kind in MOVING and j.mimic is None]
        self._server, self._places = server, {name: k for k, name in enumerate(joints)}
        drawing, self._poses = draw(urdf, folders), LinkPoses(urdf, joints)
        self.problems = drawing.problems
        reach, scale = reach_of(urdf), scale_of(urdf, newtons)
        self._arm = DrawnArm(server.scene, '/arm', drawing, self._poses)
        self._rings = JointRings(server.scene, urdf, joints, self._poses)
        self._drawn_wrench = DrawnWrench(server.scene, self._poses, reach, scale)
        self._drawn_payload = DrawnPayload(server.scene, self._poses, reach)
        self._loads = Loads(urdf, joints, np.zeros((1, len(joints))))
        self._position = np.zeros(len(joints))
        self._effort = np.full(len(joints), np.nan)
        self._wrench = RunningWrench()
        self._payload: InertiaMessage | None = None
        self._changed = True
        self.received = self.malformed = 0
        add_floor(server.scene, reach)
        look_at(server, [-reach / 2, -reach / 2, 0.0], [reach / 2, reach / 2, reach])
        server.gui.add_markdown(f'{WRENCH_LEGEND.format(scale)} {PAYLOAD_LEGEND}')
        self.draw()

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that can follow a message."""
        return tuple(self._places)

    def take(self, data: bytes) -> None:
        """Take a JointState; joints that it does not name stay where they are."""
        self.received += 1
        state = _decoded(decode_joint_state, data)
        if state is None:
            self.malformed += 1
            return
        for target, values in ((self._position, state.position), (self._effort, state.effort)):
            # A field may be empty, or shorter than the names.
            for name, value in zip(state.names, values, strict=False):
                place = self._places.get(name)
                if place is not None and abs(value) <= LARGEST_POSITION:
                    target[place] = value
        self._wrench.at_state(state.stamp_ns)
        self._changed = True

    def take_sent_wrench(self, data: bytes, seconds: float) -> None:
        """Take a WrenchStamped that was sent to the arm, and came at a steady time [s]."""
        wrench = _decoded(decode_wrench, data)
        if wrench is not None and self._draws(wrench):
            self._wrench.sent(wrench, seconds)
            self._changed = True

    def take_acting_wrench(self, data: bytes) -> None:
        """Take a WrenchStamped of the wrench that acts."""
        wrench = _decoded(decode_wrench, data)
        if wrench is not None and self._draws(wrench):
            self._wrench.measured(wrench)
            self._changed = True

    def take_reported_wrench(self, wrench: WrenchMessage, timeout: float, seconds: float) -> None:
        """Take a wrench of a report, which came at a steady time [s], and its timeout [s]."""
        if self._draws(wrench):
            self._wrench.reported(wrench, timeout, seconds)
            self._changed = True

    def take_payload(self, data: bytes) -> None:
        """Take an InertiaStamped of the payload in use."""
        payload = _decoded(decode_inertia, data)
        if payload is not None and (is_nothing(payload) or self._draws(payload)):
            self._payload = None if is_nothing(payload) else payload
            self._changed = True

    def _draws(self, message: WrenchMessage | InertiaMessage) -> bool:
        return message.frame_id in self._poses.links

    def draw(self) -> None:
        """Show what has come, if it is new."""
        if not self._changed:
            return
        self._changed = False
        with self._server.atomic():
            frames = self._arm.show(self._position)
            self._rings.show(frames, self._loads.colours(self._position, self._effort))
            self._drawn_wrench.show(frames, self._wrench.acting)
            self._drawn_payload.show(frames, self._payload)


def _decoded(decode: Callable[[bytes], T], data: bytes) -> T | None:
    """Return a message, None for bytes that are none."""
    if len(data) > MOST_BYTES:
        return None
    try:
        return decode(data)
    except ValueError:
        return None
