# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An arm in a page: its links, rings with the loads of its joints, a ghost, a path, the floor.

`Stage` shows one state after another, of a log or of a running arm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
import trimesh

import pfd_core as pfd
from pfd_ros.view import loads
from pfd_ros.view.forms import Drawing
from pfd_ros.view.links import SLIDING, TURNING, Array, LinkPoses, reach_of
from pfd_ros.view.loads import DrawnPayload, DrawnWrench, Load, place, scale_of
from pfd_ros.view.meshes import Colour

GHOST_COLOUR, GHOST_OPACITY = (60, 150, 90), 0.35
FLOOR_COLOUR, FLOOR_LINES = (205, 208, 214), 8
PATH_COLOURS = np.array([(120, 180, 250), (20, 60, 140)])
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
# Axes of the camera, whose half field of view has this tangent: viser's 75 degrees.
DIRECTION = np.array([0.75, -0.85, 0.4]) / np.linalg.norm([0.75, -0.85, 0.4])
SIDE, HALF_VIEW = np.array([0.85, 0.75, 0.0]) / np.hypot(0.85, 0.75), np.tan(np.radians(37.5))
AXES = np.array([SIDE, np.cross(DIRECTION, SIDE), DIRECTION])
# Colours from left to right, and what they are.
LEGEND = (
    (LOAD_COLOURS, 'ring: joint torque, from none to its limit'),
    ([AT_LIMIT], 'ring: joint at the end of its range'),
    ([UNKNOWN], 'ring: torque not known'),
    (PATH_COLOURS, 'line: path of the tip, from start to end'),
    ([loads.FORCE_COLOUR], 'arrow: external force, 1 m = {0.force:g} N'),
    ([loads.TORQUE_COLOUR], 'two heads: external torque, 1 m = {0.torque:g} N m'),
    ([loads.PAYLOAD_COLOUR], 'payload; black: its centre of mass'),
    ([GHOST_COLOUR], 'ghost: another log or topic'),
)
MARK = '<span style="display:inline-block;width:2em;height:.6em;margin-right:.6em;background:'


def legend(scale: Any) -> str:
    """Return the meaning of the colours, as HTML."""
    rows = []
    for colours, meaning in LEGEND:
        ends = [f'rgb{tuple(int(x) for x in c)}' for c in [*colours, colours[-1]]]
        bar = f'{MARK}linear-gradient(90deg,{",".join(ends)})"></span>'
        rows.append(f'{bar}{meaning.format(scale)}<br>')
    return f'<div style="padding:.5em 1em;font-size:.85em;line-height:1.6">{"".join(rows)}</div>'


def draw_links(
    scene: Any,
    root: str,
    drawing: Drawing,
    poses: LinkPoses,
    colour: Colour | None = None,
    opacity: float | None = None,
) -> Callable[[Array], None]:
    """Draw the links of an arm below a node, perhaps in one colour; return what moves them.

    That function takes the frames of all links, (links, 4, 4).
    """
    nodes: dict[int, Any] = {}
    for number, shape in enumerate(drawing.shapes):
        link = poses.links.index(shape.link)
        # Names of links may contain anything; numbers make paths.
        name = f'{root}/link_{link}'
        if link not in nodes:
            nodes[link] = scene.add_frame(name, show_axes=False)
        scene.add_mesh_simple(
            f'{name}/{number}',
            *triangles(shape.mesh),
            color=colour or shape.colour,
            opacity=opacity,
            flat_shading=shape.flat,
            side='double',
        )

    def move(frames: Array) -> None:
        for link, node in nodes.items():
            place(node, frames[link])

    return move


def triangles(mesh: trimesh.Trimesh) -> tuple[Array, Array]:
    """Return vertices (V, 3) and faces (F, 3) as a page takes them."""
    return np.array(mesh.vertices, np.float32), np.array(mesh.faces, np.int32)


class Stage:
    """An arm with its loads in the empty page of a viser server.

    `joints` are those whose positions will be shown, by default all that move and mimic no other
    one. `largest` is the effort (joints,) at which a joint without an effort limit has the colour
    of the limit.
    """

    def __init__(
        self,
        server: Any,
        urdf: pfd.Urdf,
        drawing: Drawing,
        joints: Sequence[str] | None = None,
        largest: ArrayLike = 0.0,
    ) -> None:
        moving = [j for j in urdf.joints.values() if j.kind in (*TURNING, SLIDING)]
        free = [j.name for j in moving if j.mimic is None]
        self.joints = tuple(free if joints is None else joints)
        self.poses = LinkPoses(urdf, self.joints)
        self.scale, self._server, self._reach = scale_of(urdf), server, reach_of(urdf)
        scene, reach = server.scene, self._reach
        self._move = draw_links(scene, '/arm', drawing, self.poses)
        self._wrench = DrawnWrench(scene, reach, self.scale)
        self._payload = DrawnPayload(scene, reach)
        limits = [urdf.joints[name].limits for name in self.joints]
        ends = np.array([item.get('effort', np.inf) for item in limits])
        ends = np.where(np.isfinite(ends), ends, largest)
        # Without a scale a torque has no colour.
        self._ends = np.where(ends > 0, ends, np.nan)
        self._lower = np.array([item.get('lower', -np.inf) for item in limits])
        self._upper = np.array([item.get('upper', np.inf) for item in limits])
        self._rings = [self._ring(k, urdf.joints[name]) for k, name in enumerate(self.joints)]
        ticks = np.linspace(-reach, reach, FLOOR_LINES + 1)
        lines = [[[x, -reach, 0.0], [x, reach, 0.0]] for x in ticks]
        lines += [[[-reach, y, 0.0], [reach, y, 0.0]] for y in ticks]
        # Lines cost a browser less than a grid.
        floor = np.array(lines, np.float32)
        scene.add_line_segments('/floor', floor, FLOOR_COLOUR, thickness=reach / 600)
        server.gui.add_html(legend(self.scale))

    def show(
        self,
        q: ArrayLike,
        effort: ArrayLike = np.nan,
        wrench: Load | None = None,
        payload: Load | None = None,
    ) -> None:
        """Show positions [rad, m], efforts [N m, N] (NaN: unknown), and loads on links."""
        with self._server.atomic():
            frames = self.poses.at(q)
            self._move(frames)
            colours = self._colours(np.asarray(q, float), np.asarray(effort, float))
            for (node, mesh, link), colour in zip(self._rings, colours, strict=True):
                place(node, frames[link])
                mesh.color = colour

            def frame_of(link: str) -> Array:
                frame: Array = frames[self.poses.links.index(link)]
                return frame

            self._wrench.show(wrench, frame_of)
            self._payload.show(payload, frame_of)

    def ghost(self, drawing: Drawing, poses: LinkPoses) -> Callable[[Array], None]:
        """Draw another arm, translucent; return what moves its links to frames."""
        return draw_links(
            self._server.scene, '/ghost', drawing, poses, GHOST_COLOUR, GHOST_OPACITY
        )

    def path(self, points: Array) -> None:
        """Draw a path through points (N, 3), light at its start and dark at its end."""
        if len(points) < 2:
            return
        segments = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        part = np.linspace(0.0, 1.0, len(segments))[:, None, None]
        colours = np.repeat((1 - part) * PATH_COLOURS[0] + part * PATH_COLOURS[1], 2, axis=1)
        self._server.scene.add_line_segments(
            '/path', segments, colours.astype(np.uint8), thickness=self._reach / 250
        )

    def look(self, positions: ArrayLike = ()) -> None:
        """Place the camera on the arm at positions (N, joints), or on most of its reach."""
        rows, reach = np.asarray(positions, float), self._reach
        points = reach / 3 * np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 2.0]])
        if len(rows):
            points = np.concatenate([self.poses.at(row)[:, :3, 3] for row in rows])
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        across, up, near = AXES @ (points - middle).T
        size = np.maximum(abs(across), abs(up)) + MARGIN * reach
        distance = max(float((near + size / HALF_VIEW).max()), 1e-3)
        camera = self._server.initial_camera
        camera.look_at, camera.position = tuple(middle), tuple(middle + distance * DIRECTION)
        camera.near, camera.far = distance / 200, distance * 200

    def _ring(self, number: int, joint: Any) -> tuple[Any, Any, int]:
        """Return the node of a ring about the axis of a joint, its mesh, and its link."""
        ring = trimesh.creation.torus(RING * self._reach, RING_WIRE * self._reach, 32, 12)
        ring.apply_transform(trimesh.geometry.align_vectors([0.0, 0.0, 1.0], joint.axis))
        scene, name = self._server.scene, f'/joints/{number}'
        node = scene.add_frame(name, show_axes=False)
        look = {'color': UNKNOWN, 'cast_shadow': False}
        mesh = scene.add_mesh_simple(f'{name}/ring', *triangles(ring), **look)
        return node, mesh, self.poses.links.index(joint.child)

    def _colours(self, position: Array, effort: Array) -> list[Colour]:
        """Return the colour of each joint."""
        with np.errstate(invalid='ignore', divide='ignore'):
            parts = np.where(effort == 0, 0.0, np.abs(effort) / self._ends)
            margin = NEAR * (self._upper - self._lower)
            at_limit = (position <= self._lower + margin) | (position >= self._upper - margin)
        # Without a range: unlimited, or both ends equal.
        at_limit &= np.isfinite(margin) & (margin > 0)
        levels = np.round(np.minimum(parts, 1.0) * (LEVELS - 1)) / (LEVELS - 1)
        places = np.linspace(0.0, 1.0, len(LOAD_COLOURS))
        mixed = np.stack([np.interp(levels, places, c) for c in LOAD_COLOURS.T], axis=-1)
        mixed = np.where(np.isnan(levels)[:, None], UNKNOWN, mixed)
        mixed = np.where(at_limit[:, None], AT_LIMIT, mixed)
        return [tuple(row) for row in np.round(mixed).astype(int).tolist()]
