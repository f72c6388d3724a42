# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arm in the page: a node for each link that is drawn, moved to the link's frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
import trimesh

from pfd_ros.view.poses import LinkPoses
from pfd_ros.view.shapes import Drawing
from pfd_ros.view.visuals import Colour

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
                flat_shading=shape.stands_in,
                side='double',
            )

    def show(self, positions: ArrayLike) -> NDArray[np.float64]:
        """Move the arm to joint positions and return the frames of all links, (links, 4, 4)."""
        frames = self.poses.at(positions)
        for link, node in self._frames.items():
            place(node, frames[link])
        return frames


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
