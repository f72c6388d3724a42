# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An arm in a page that follows joint states as they come."""

from __future__ import annotations

from typing import Any

import numpy as np

import pfd_core as pfd
from pfd_ros.messages.convert import decode_joint_state
from pfd_ros.view.loads import Loads
from pfd_ros.view.mesh_files import MeshFolders
from pfd_ros.view.motion import LARGEST_POSITION
from pfd_ros.view.poses import LinkPoses
from pfd_ros.view.scene import DrawnArm, JointRings, add_floor
from pfd_ros.view.server import look_at
from pfd_ros.view.shapes import draw
from pfd_ros.view.skeleton import reach_of

# Longest message that is decoded.
MOST_BYTES = 1 << 20
MOVING = ('revolute', 'continuous', 'prismatic')


class LiveArm:
    """
    An arm that follows joint states.

    Parameters
    ----------
    server : viser.ViserServer
        An empty page.
    urdf : Urdf
        The model.
    folders : MeshFolders
        Where its meshes are.

    Attributes
    ----------
    problems : tuple of str
        What is not drawn as the URDF says, a line each.
    received, malformed : int
        Messages taken, and those of them that are no joint states.

    """

    def __init__(self, server: Any, urdf: pfd.Urdf, folders: MeshFolders) -> None:
        joints = [j.name for j in urdf.joints.values() if j.kind in MOVING and j.mimic is None]
        self._server, self._places = server, {name: k for k, name in enumerate(joints)}
        drawing, poses = draw(urdf, folders), LinkPoses(urdf, joints)
        self.problems = drawing.problems
        self._arm = DrawnArm(server.scene, '/arm', drawing, poses)
        self._rings = JointRings(server.scene, urdf, joints, poses)
        self._loads = Loads(urdf, joints, np.zeros((1, len(joints))))
        self._position = np.zeros(len(joints))
        self._effort = np.full(len(joints), np.nan)
        self._changed = True
        self.received = self.malformed = 0
        reach = reach_of(urdf)
        add_floor(server.scene, reach)
        look_at(server, [-reach / 2, -reach / 2, 0.0], [reach / 2, reach / 2, reach])
        self.draw()

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that can follow a message."""
        return tuple(self._places)

    def take(self, data: bytes) -> None:
        """Take the bytes of a JointState; joints that it does not name stay where they are."""
        self.received += 1
        try:
            if len(data) > MOST_BYTES:
                raise ValueError('too long')
            state = decode_joint_state(data)
        except ValueError:
            self.malformed += 1
            return
        for target, values in ((self._position, state.position), (self._effort, state.effort)):
            # A field may be empty, or shorter than the names.
            for name, value in zip(state.names, values, strict=False):
                place = self._places.get(name)
                if place is not None and abs(value) <= LARGEST_POSITION:
                    target[place] = value
        self._changed = True

    def draw(self) -> None:
        """Show the last state, if it is new."""
        if not self._changed:
            return
        self._changed = False
        with self._server.atomic():
            frames = self._arm.show(self._position)
            self._rings.show(frames, self._loads.colours(self._position, self._effort))
