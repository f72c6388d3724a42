# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a log: the arm, its controls, and what is said about it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.view.loads import Loads
from pfd_ros.view.log_loads import TipLoads, tip_loads
from pfd_ros.view.mesh_files import MeshFolders
from pfd_ros.view.motion import Motion, Seen, read
from pfd_ros.view.poses import LinkPoses
from pfd_ros.view.scene import DrawnArm, JointRings, add_floor, add_path, bounds
from pfd_ros.view.server import look_at
from pfd_ros.view.shapes import Drawing, draw
from pfd_ros.view.skeleton import reach_of
from pfd_ros.view.tip_loads import (
    PAYLOAD_LEGEND,
    WRENCH_LEGEND,
    DrawnPayload,
    DrawnWrench,
    Scale,
    scale_of,
)

# States of which the bounds of the motion are taken.
SAMPLES = 50
# Of the path of the tip.
POINTS = 2000
GHOST_COLOUR, GHOST_OPACITY = (60, 150, 90), 0.35
LEGEND = (
    'Rings: joint torque, from blue (none) to red (at its limit); violet: the joint is at the end '
    'of its range; grey: no torque in the log. Line: path of the tip. Translucent: the ghost.'
)


class Content(NamedTuple):
    """What a page shows of a log, before there is a page."""

    seen: Seen
    drawing: Drawing
    poses: LinkPoses
    loads: TipLoads
    scale: Scale

    @property
    def motion(self) -> Motion:
        """The joint states."""
        return self.seen.motion

    @property
    def tip(self) -> str:
        """The link whose path is drawn: the tip of a recording's arm, or of the model."""
        named = str((self.seen.log.settings or {}).get('tip_link', ''))
        return named if named in self.poses.links else self.poses.tip

    @property
    def lines(self) -> tuple[str, ...]:
        """What the log or its model lacks, a line each."""
        return (*self.seen.problems, *self.drawing.problems, *self.loads.problems)


def content_of(
    path: Path,
    robot: str | None = None,
    topic: str | None = None,
    packages: tuple[Path, ...] = (),
    other: pfd.Urdf | None = None,
    wrench_topic: str | None = None,
    newtons: float | None = None,
) -> Content:
    """
    Return what a page shows of a log.

    Parameters
    ----------
    path, robot, topic, other
        As for `motion.read`.
    packages : tuple of Path
        As `MeshFolders` has them.
    wrench_topic : str, optional
        As `tip_loads` takes it.
    newtons : float, optional
        As `scale_of` takes it.

    Raises
    ------
    ValueError, OSError
        As `motion.read` and `tip_loads`.

    """
    seen = read(path, robot, topic, other)
    drawing = draw(seen.urdf, MeshFolders(seen.folder, packages))
    poses = LinkPoses(seen.urdf, seen.motion.joints)
    loads = tip_loads(seen.log, seen.motion, poses.links, wrench_topic)
    return Content(seen, drawing, poses, loads, scale_of(seen.urdf, newtons))


def tip_path(content: Content) -> NDArray[np.float64]:
    """Return the places (M, 3) of the tip over the whole motion [m], POINTS at most."""
    places = np.unique(np.linspace(0, len(content.motion.time) - 1, POINTS).astype(int))
    tip = content.poses.index(content.tip)
    return np.array([content.poses.at(content.motion.position[k])[tip, :3, 3] for k in places])


def fill(server: Any, content: Content, ghost: Content | None = None) -> Callable[[float], None]:
    """
    Draw a log in an empty page.

    Parameters
    ----------
    server : viser.ViserServer
        The page.
    content : Content
        The log.
    ghost : Content, optional
        Another log, drawn translucent.

    Returns
    -------
    callable
        Shows a time [s] after the first state.

    """
    motion, poses, reach = content.motion, content.poses, reach_of(content.seen.urdf)
    arm = DrawnArm(server.scene, '/arm', content.drawing, poses)
    rings = JointRings(server.scene, content.seen.urdf, motion.joints, poses)
    loads = Loads(content.seen.urdf, motion.joints, motion.effort)
    shadow = None if ghost is None else _Ghost(server.scene, ghost, motion)
    first = content.loads.wrench.first
    wrench = DrawnWrench(server.scene, poses, reach, content.scale, first)
    payload = DrawnPayload(server.scene, poses, reach)
    add_path(server.scene, tip_path(content), reach / 250)
    add_floor(server.scene, reach)
    places = np.unique(np.linspace(0, len(motion.time) - 1, SAMPLES).astype(int))
    boxes = [
        bounds(content.drawing, content.poses.at(motion.position[k]), content.poses)
        for k in places
    ]
    server.gui.add_markdown(LEGEND)
    if content.loads.wrench:
        server.gui.add_markdown(WRENCH_LEGEND.format(content.scale))
    if content.loads.payload:
        server.gui.add_markdown(PAYLOAD_LEGEND)
    look_at(server, np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1])

    def show(time: float) -> None:
        with server.atomic():
            place = motion.at(time)
            position = motion.position[place]
            frames = arm.show(position)
            rings.show(frames, loads.colours(position, motion.effort[place]))
            wrench.show(frames, content.loads.wrench.at(motion.time[place]))
            payload.show(frames, content.loads.payload.at(motion.time[place]))
            if shadow is not None:
                shadow.show(time)

    return show


def offset_of(motion: Motion, ghost: Motion) -> float | None:
    """Return the time [s] at which a ghost starts, None if the logs have no time in common."""
    offset = ghost.start - motion.start
    return offset if -ghost.duration <= offset <= motion.duration else None


class _Ghost:
    """Another log in the same page."""

    def __init__(self, scene: Any, content: Content, motion: Motion) -> None:
        self._arm = DrawnArm(
            scene, '/ghost', content.drawing, content.poses, GHOST_COLOUR, GHOST_OPACITY
        )
        self._motion = content.motion
        # Logs without a time in common start together.
        self._offset = offset_of(motion, content.motion) or 0.0

    def show(self, time: float) -> None:
        """Show the state at a time [s] of the other log."""
        self._arm.show(self._motion.position[self._motion.at(time - self._offset)])
