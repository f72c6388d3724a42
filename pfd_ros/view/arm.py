# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An arm in a page: its links, rings with the loads of its joints, a ghost, a path, the floor.

`Stage` shows one state after another, of a log or of a running arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
import trimesh

import pfd_core as pfd
from pfd_ros.text import listed
from pfd_ros.view.forms import Array, Drawing, pose_of, reach_of
from pfd_ros.view.loads import DrawnPayload, DrawnWrench, Payload, Scale, Wrench, place
from pfd_ros.view.meshes import Colour

GHOST_COLOUR, GHOST_OPACITY = (60, 150, 90), 0.35
FLOOR_COLOUR, FLOOR_LINES = (205, 208, 214), 8
PATH_COLOURS = ((160, 205, 250), (20, 60, 140))
# Radius of a ring and of its wire, as parts of the reach.
RING, RING_WIRE = 0.062, 0.007
# Of a ring, from no torque to the limit; few levels, since each change of colour is a message.
LOAD_COLOURS = np.array([(70, 120, 200), (90, 190, 120), (245, 205, 60), (225, 60, 45)], float)
LEVELS = 33
UNKNOWN, AT_LIMIT = (150, 150, 150), (190, 40, 200)
# Distance from the end of a joint's range that counts as at the end, as a part of the range.
NEAR = 2e-3
# Around the frames of links, as a part of the reach, for what is drawn of them.
MARGIN = 0.1
# Distance of the camera from the middle of what is shown, as a part of its size.
DISTANCE, DIRECTION = 0.9, np.array([0.75, -0.85, 0.4]) / np.linalg.norm([0.75, -0.85, 0.4])
TURNING, SLIDING = ('revolute', 'continuous'), 'prismatic'
MOVING = (*TURNING, SLIDING)
LEGEND = """Rings: joint torque, from blue (none) to red (at its limit); violet: the joint is at
the end of its range; grey: no torque known. Line: path of the tip. Translucent: the ghost.

Red arrow: external force on the last link; yellow, with two heads: external torque, right-handed.
Scale: {}.

Turquoise body: the payload, a box with its mass and inertia, or a ball without inertia; black: its
centre of mass."""


class LinkPoses:
    """
    The frames of all links in the frame of the root, as functions of positions of some joints.

    Joints that mimic these joints follow, others are at 0. ValueError if the joints are no tree.

    Attributes
    ----------
    links : tuple of str
        Names of the links, a parent before its children.
    tip : str
        The link at the end of the longest chain of the given joints, and of links fixed to it.

    """

    def __init__(self, urdf: pfd.Urdf, joints: Sequence[str]) -> None:
        by_child: dict[str, Any] = {}
        for joint in urdf.joints.values():
            if joint.child in by_child:
                raise ValueError(f'link {joint.child!r} of the URDF has two parents')
            by_child[joint.child] = joint
        names = [name for name in urdf.links if name not in by_child]
        for parent in names:  # which grows meanwhile
            names += [child for child, joint in by_child.items() if joint.parent == parent]
        if len(names) < len(urdf.links):
            lost = [name for name in urdf.links if name not in names]
            raise ValueError(f'links {listed(lost)} of the URDF are no tree')
        self.links = tuple(names)
        self._urdf, self._joints = urdf, tuple(joints)
        self._index = {name: k for k, name in enumerate(names)}
        self._ordered = [by_child[name] for name in names if name in by_child]
        # Transform of a joint: origin (1 + sin(x) turn + (1 - cos(x)) turn^2 + x slide).
        count = len(self._ordered)
        self._origins, self._turns, self._slides = np.zeros((3, count, 4, 4))
        depth = dict.fromkeys(names, (0, 0))
        for k, joint in enumerate(self._ordered):
            self._origins[k] = pose_of(*joint.origin)
            axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
            if joint.kind in TURNING:
                self._turns[k, :3, :3] = np.cross(np.eye(3), axis)
            elif joint.kind == SLIDING:
                self._slides[k, :3, 3] = axis
            moving, links = depth[joint.parent]
            depth[joint.child] = moving + (joint.name in joints), links + 1
        self.tip = max(names, key=depth.__getitem__)

    def at(self, positions: ArrayLike) -> Array:
        """Return the frames (links, 4, 4) at positions (joints,) [rad, m]."""
        given = dict(zip(self._joints, np.asarray(positions, float).tolist(), strict=True))
        found = self._urdf.with_followers(given)
        x = np.array([found.get(joint.name, 0.0) for joint in self._ordered])[:, None, None]
        turn = self._turns
        motion = np.eye(4) + np.sin(x) * turn + (1 - np.cos(x)) * (turn @ turn) + x * self._slides
        poses = np.tile(np.eye(4), (len(self.links), 1, 1))
        for joint, local in zip(self._ordered, self._origins @ motion, strict=True):
            poses[self._index[joint.child]] = poses[self._index[joint.parent]] @ local
        return poses

    def index(self, link: str) -> int:
        """Return the place of a link in `links`."""
        return self._index[link]


class DrawnArm:
    """The links of an arm in a page, below a node such as '/arm'; perhaps in one colour."""

    def __init__(
        self,
        scene: Any,
        root: str,
        drawing: Drawing,
        poses: LinkPoses,
        colour: Colour | None = None,
        opacity: float | None = None,
    ) -> None:
        self._poses = poses
        self._frames: dict[int, Any] = {}
        for number, shape in enumerate(drawing.shapes):
            link = poses.index(shape.link)
            # Names of links may contain anything; numbers make paths.
            name = f'{root}/link_{link}'
            if link not in self._frames:
                self._frames[link] = scene.add_frame(name, show_axes=False)
            scene.add_mesh_simple(
                f'{name}/{number}',
                shape.vertices,
                shape.faces,
                color=colour or shape.colour,
                opacity=opacity,
                flat_shading=shape.flat,
                side='double',
            )

    def show(self, positions: ArrayLike) -> Array:
        """Move the arm to joint positions and return the frames of all links, (links, 4, 4)."""
        frames = self._poses.at(positions)
        for link, node in self._frames.items():
            place(node, frames[link])
        return frames


class Stage:
    """
    An arm with its loads in an empty page.

    Parameters
    ----------
    server : viser.ViserServer
        The page.
    urdf, drawing
        The model, and what is drawn of it.
    joints : sequence of str, optional
        The joints whose positions will be shown; default all that move and mimic no other one.
    largest : ndarray, (joints,), optional
        Effort at which a joint without an effort limit has the colour of the limit.

    """

    def __init__(
        self,
        server: Any,
        urdf: pfd.Urdf,
        drawing: Drawing,
        joints: Sequence[str] | None = None,
        largest: NDArray[np.float64] | None = None,
    ) -> None:
        free = [j.name for j in urdf.joints.values() if j.kind in MOVING and j.mimic is None]
        self.joints = tuple(free if joints is None else joints)
        self.poses = LinkPoses(urdf, self.joints)
        self.scale = Scale.of(urdf)
        self._server, self._reach = server, reach_of(urdf)
        scene = server.scene
        self._arm = DrawnArm(scene, '/arm', drawing, self.poses)
        self._wrench = DrawnWrench(scene, self._reach, self.scale)
        self._payload = DrawnPayload(scene, self._reach)
        limits = [urdf.joints[name].limits for name in self.joints]
        ends = np.array([item.get('effort', np.inf) for item in limits])
        other = np.zeros(len(limits)) if largest is None else largest
        # Without a scale a torque has no colour.
        self._ends = np.where(
            np.isfinite(ends) & (ends > 0), ends, np.where(other > 0, other, np.nan)
        )
        self._lower = np.array([item.get('lower', -np.inf) for item in limits])
        self._upper = np.array([item.get('upper', np.inf) for item in limits])
        self._rings = [self._ring(k, urdf.joints[name]) for k, name in enumerate(self.joints)]
        self._colours: list[Colour] = [UNKNOWN] * len(self.joints)
        reach = self._reach
        ticks = np.linspace(-reach, reach, FLOOR_LINES + 1)
        lines = [[[x, -reach, 0.0], [x, reach, 0.0]] for x in ticks]
        lines += [[[-reach, y, 0.0], [reach, y, 0.0]] for y in ticks]
        # Lines cost a browser less than a grid.
        floor = np.array(lines, np.float32)
        scene.add_line_segments('/floor', floor, FLOOR_COLOUR, thickness=reach / 400)
        server.gui.add_markdown(LEGEND.format(self.scale))

    def show(
        self,
        q: ArrayLike,
        effort: ArrayLike | None = None,
        wrench: Wrench | None = None,
        payload: Payload | None = None,
    ) -> None:
        """
        Show positions and efforts (joints,), NaN for an unknown one, and the loads on a link.

        Units are rad, m and N m, N.
        """
        position = np.asarray(q, float)
        unknown = np.full(len(self.joints), np.nan)
        with self._server.atomic():
            frames = self._arm.show(position)
            colours = self._loads(position, unknown if effort is None else np.asarray(effort))
            for k, ((node, mesh, link), colour) in enumerate(
                zip(self._rings, colours, strict=True)
            ):
                place(node, frames[link])
                if colour != self._colours[k]:
                    mesh.color = self._colours[k] = colour
            at = self.poses.index
            self._wrench.show(None if wrench is None else frames[at(wrench.frame)], wrench)
            self._payload.show(None if payload is None else frames[at(payload.frame)], payload)

    def ghost(self, drawing: Drawing, poses: LinkPoses) -> DrawnArm:
        """Return another arm in the page, drawn translucent."""
        return DrawnArm(self._server.scene, '/ghost', drawing, poses, GHOST_COLOUR, GHOST_OPACITY)

    def path(self, points: Array) -> None:
        """Draw a path through points (N, 3), light at its start and dark at its end."""
        if len(points) < 2:
            return
        segments = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        part = np.linspace(0.0, 1.0, len(segments))[:, None]
        ends = (1 - part) * np.array(PATH_COLOURS[0]) + part * np.array(PATH_COLOURS[1])
        colours = np.repeat(ends[:, None], 2, axis=1).astype(np.uint8)
        thickness = self._reach / 250
        self._server.scene.add_line_segments('/path', segments, colours, thickness=thickness)

    def look(self, positions: ArrayLike = ()) -> None:
        """Place the camera so that the arm at positions (N, joints) is in view, or its reach."""
        rows, reach = np.asarray(positions, float), self._reach
        points = np.array([[-reach / 2, -reach / 2, 0.0], [reach / 2, reach / 2, reach]])
        if len(rows):
            points = np.concatenate([self.poses.at(row)[:, :3, 3] for row in rows])
        low, high = points.min(axis=0) - MARGIN * reach, points.max(axis=0) + MARGIN * reach
        size = max(float(np.linalg.norm(high - low)), 1e-3)
        camera = self._server.initial_camera
        camera.look_at = tuple((low + high) / 2)
        camera.position = tuple((low + high) / 2 + DISTANCE * size * DIRECTION)
        camera.near, camera.far = size / 200, size * 200

    def _ring(self, number: int, joint: Any) -> tuple[Any, Any, int]:
        """Return the node of a ring about the axis of a joint, its mesh, and its link."""
        ring = trimesh.creation.torus(RING * self._reach, RING_WIRE * self._reach, 32, 12)
        ring.apply_transform(trimesh.geometry.align_vectors([0.0, 0.0, 1.0], joint.axis))
        scene, name = self._server.scene, f'/joints/{number}'
        node = scene.add_frame(name, show_axes=False)
        vertices, faces = np.array(ring.vertices, np.float32), np.array(ring.faces, np.int32)
        mesh = scene.add_mesh_simple(
            f'{name}/ring', vertices, faces, color=UNKNOWN, cast_shadow=False
        )
        return node, mesh, self.poses.index(joint.child)

    def _loads(self, position: Array, effort: Array) -> list[Colour]:
        """Return the colour of each joint."""
        with np.errstate(invalid='ignore', divide='ignore'):
            parts = np.where(effort == 0, 0.0, np.abs(effort) / self._ends)
            margin = NEAR * (self._upper - self._lower)
            at_limit = (position <= self._lower + margin) | (position >= self._upper - margin)
        # Without a range: unlimited, or both ends equal.
        at_limit &= np.isfinite(margin) & (margin > 0)
        return [
            AT_LIMIT if stuck else _load_colour(part)
            for part, stuck in zip(parts.tolist(), at_limit.tolist(), strict=True)
        ]


def _load_colour(part: float) -> Colour:
    if np.isnan(part):
        return UNKNOWN
    level = round(min(max(part, 0.0), 1.0) * (LEVELS - 1)) / (LEVELS - 1)
    places = np.linspace(0.0, 1.0, len(LOAD_COLOURS))
    red, green, blue = (round(float(np.interp(level, places, c))) for c in LOAD_COLOURS.T)
    return red, green, blue
