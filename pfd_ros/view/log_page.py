# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a log: the arm, its controls, and what is said about it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pfd_ros.view.mesh_files import MeshFolders
from pfd_ros.view.motion import Motion, Seen, read
from pfd_ros.view.poses import LinkPoses
from pfd_ros.view.scene import DrawnArm, add_floor, bounds
from pfd_ros.view.server import look_at
from pfd_ros.view.shapes import Drawing, draw
from pfd_ros.view.skeleton import reach_of

# States of which the bounds of the motion are taken.
SAMPLES = 50


class Content(NamedTuple):
    """What a page shows of a log, before there is a page."""

    seen: Seen
    drawing: Drawing
    poses: LinkPoses

    @property
    def motion(self) -> Motion:
        """The joint states."""
        return self.seen.motion

    @property
    def lines(self) -> tuple[str, ...]:
        """What the log or its model lacks, a line each."""
        return (*self.seen.problems, *self.drawing.problems)


def content_of(
    path: Path, robot: str | None, topic: str | None, packages: tuple[Path, ...] = ()
) -> Content:
    """
    Return what a page shows of a log.

    Parameters
    ----------
    path, robot, topic
        As for `motion.read`.
    packages : tuple of Path
        As `MeshFolders` has them.

    Raises
    ------
    ValueError, OSError
        As `motion.read`.

    """
    seen = read(path, robot, topic)
    drawing = draw(seen.urdf, MeshFolders(seen.folder, packages))
    return Content(seen, drawing, LinkPoses(seen.urdf, seen.motion.joints))


def fill(server: Any, content: Content) -> Callable[[float], None]:
    """Draw a log in an empty page, and return the function that shows a time of it [s]."""
    arm = DrawnArm(server.scene, '/arm', content.drawing, content.poses)
    motion = content.motion
    add_floor(server.scene, reach_of(content.seen.urdf))
    places = np.unique(np.linspace(0, len(motion.time) - 1, SAMPLES).astype(int))
    boxes = [
        bounds(content.drawing, content.poses.at(motion.position[k]), content.poses)
        for k in places
    ]
    look_at(server, np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1])

    def show(time: float) -> None:
        with server.atomic():
            arm.show(motion.position[motion.at(time)])

    return show
