# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a page shows: an arm, rings with the loads of its joints, a path, and the floor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
import trimesh

import pfd_core as pfd
from pfd_ros.view.loads import UNKNOWN
from pfd_ros.view.poses import LinkPoses
from pfd_ros.view.shapes import Drawing
from pfd_ros.view.skeleton import reach_of
from pfd_ros.view.visuals import Colour

PATH_COLOURS = ((160, 205, 250), (20, 60, 140))
# Radius of a ring and of its wire, as parts of the reach.
RING, RING_WIRE = 0.062, 0.007
FLOOR_COLOUR = (205, 208, 214)
# Lines of the floor each way.
FLOOR_LINES = 8


class DrawnArm:
    """
    An arm in a page.

    Parameters
    ----------
    scene : viser.SceneApi
        The page's scene.
    root : str
        Name of its node, such as '/arm'.
    drawing : Drawing
        Its shapes.
    poses : LinkPoses
        The frames of its links.
    colour : tuple of int, optional
        One colour for all of it.
    opacity : float, optional
        0 to 1; default opaque.

    """

    def __init__(
        self,
        scene: Any,
        root: str,
        drawing: Drawing,
        poses: LinkPoses,
        colour: Colour | None = None,
        opacity: float | None = None,
    ) -> None:
        self.poses = poses
        self._frames: dict[int, Any] = {}
        for number, shape in enumerate(drawing.shapes):
            link = poses.index(shape.link)
            # Names of links may hold anything; numbers make paths.
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

    def show(self, positions: ArrayLike) -> NDArray[np.float64]:
        """Move the arm to joint positions and return the frames of all links, (links, 4, 4)."""
        frames = self.poses.at(positions)
        for link, node in self._frames.items():
            place(node, frames[link])
        return frames


class JointRings:
    """A ring around the axis of each joint, whose colour is the joint's load.

    Parameters
    ----------
    scene : viser.SceneApi
        The page's scene.
    urdf : Urdf
        The model.
    joints : sequence of str
        Names of the joints.
    poses : LinkPoses
        The frames of its links.

    """

    def __init__(
        self, scene: Any, urdf: pfd.Urdf, joints: Sequence[str], poses: LinkPoses
    ) -> None:
        reach = reach_of(urdf)
        ring = trimesh.creation.torus(RING * reach, RING_WIRE * reach, 32, 12)
        self._links = [poses.index(urdf.joints[name].child) for name in joints]
        self._nodes, self._meshes = [], []
        self._colours: list[Colour] = []
        for number, name in enumerate(joints):
            node = scene.add_frame(f'/joints/{number}', show_axes=False)
            turn = trimesh.geometry.align_vectors([0.0, 0.0, 1.0], urdf.joints[name].axis)
            mesh = scene.add_mesh_simple(
                f'/joints/{number}/ring',
                trimesh.transform_points(ring.vertices, turn).astype(np.float32),
                np.array(ring.faces, np.int32),
                color=UNKNOWN,
                cast_shadow=False,
            )
            self._nodes.append(node)
            self._meshes.append(mesh)
            self._colours.append(UNKNOWN)

    def show(self, frames: NDArray[np.float64], colours: Sequence[Colour]) -> None:
        """Move the rings to frames of all links (links, 4, 4) and give each its colour."""
        for k, (node, link) in enumerate(zip(self._nodes, self._links, strict=True)):
            place(node, frames[link])
            if colours[k] != self._colours[k]:
                self._meshes[k].color = self._colours[k] = colours[k]


def add_path(scene: Any, points: NDArray[np.float64], thickness: float) -> None:
    """Draw a path through points (N, 3), light at its start and dark at its end."""
    if len(points) < 2:
        return
    segments = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
    part = np.linspace(0.0, 1.0, len(segments))[:, None]
    ends = (1 - part) * np.array(PATH_COLOURS[0]) + part * np.array(PATH_COLOURS[1])
    colours = np.repeat(ends[:, None], 2, axis=1).astype(np.uint8)
    scene.add_line_segments('/path', segments, colours, thickness=thickness)


def place(node: Any, frame: NDArray[np.float64]) -> None:
    """Move a node of the page to a frame (4, 4)."""
    node.position = frame[:3, 3]
    node.wxyz = trimesh.transformations.quaternion_from_matrix(frame)


def bounds(drawing: Drawing, frames: NDArray[np.float64], poses: LinkPoses) -> NDArray[np.float64]:
    """Return the least and largest coordinates (2, 3) of an arm at frames of its links."""
    corners = [frames[:, :3, 3]]
    for shape in drawing.shapes:
        box = trimesh.bounds.corners([shape.vertices.min(axis=0), shape.vertices.max(axis=0)])
        frame = frames[poses.index(shape.link)]
        corners.append(box @ frame[:3, :3].T + frame[:3, 3])
    points = np.concatenate(corners)
    found: NDArray[np.float64] = np.array([points.min(axis=0), points.max(axis=0)])
    return found


def add_floor(scene: Any, reach: float) -> None:
    """Draw the plane z = 0 as lines, which cost a browser less than a grid."""
    ticks = np.linspace(-reach, reach, FLOOR_LINES + 1)
    lines = [[[x, -reach, 0.0], [x, reach, 0.0]] for x in ticks]
    lines += [[[-reach, y, 0.0], [reach, y, 0.0]] for y in ticks]
    scene.add_line_segments(
        '/floor', np.array(lines, np.float32), FLOOR_COLOUR, thickness=reach / 400
    )
