# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A log in a page: its model, its motion, the path of its tip, and another log as a ghost."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import pfd_core as pfd
from pfd_ros.view.arm import LinkPoses, Stage
from pfd_ros.view.forms import draw
from pfd_ros.view.logged import logged
from pfd_ros.view.meshes import Meshes

# States of which the bounds of the motion are taken, and points of the path of the tip.
SAMPLES, POINTS = 50, 2000


class ShownLog:
    """
    A log that is shown: everything but the page. Parameters are as `logged` takes them.

    Attributes
    ----------
    log, drawing, poses
        Its motion, what is drawn of its model, and the frames of its links.
    problems : tuple of str
        What the log or its model lacks, a line each.

    """

    def __init__(
        self,
        path: Path,
        robot: str | None = None,
        topic: str | None = None,
        packages: tuple[Path, ...] = (),
        rename: Mapping[str, str] | None = None,
        wrench_topic: str | None = None,
        other: pfd.Urdf | None = None,
    ) -> None:
        self.log = logged(
            path, robot=robot, topic=topic, rename=rename, wrench_topic=wrench_topic, other=other
        )
        self.drawing = draw(self.log.urdf, Meshes(self.log.folder, packages))
        self.poses = LinkPoses(self.log.urdf, self.log.joints)
        self.problems = (*self.log.problems, *self.drawing.problems)

    def fill(self, server: Any, ghost: ShownLog | None = None) -> Callable[[float], None]:
        """Draw the log in an empty page; return a function that shows a time [s]."""
        log = self.log
        largest = np.max(np.abs(np.nan_to_num(log.effort)), axis=0, initial=0.0)
        stage = Stage(server, log.urdf, self.drawing, log.joints, largest)
        shadow = None if ghost is None else stage.ghost(ghost.drawing, ghost.poses)
        offset = 0.0 if ghost is None else self.offset(ghost) or 0.0
        tip = self.poses.index(log.tip)
        rows = np.unique(np.linspace(0, len(log.time) - 1, POINTS).astype(int))
        stage.path(np.array([self.poses.at(q)[tip, :3, 3] for q in log.position[rows]]))
        stage.look(log.position[rows[:: max(len(rows) // SAMPLES, 1)]])

        def show(time: float) -> None:
            with server.atomic():
                k = self.row(time)
                stage.show(log.position[k], log.effort[k], log.wrench[k], log.payload[k])
                if shadow is not None and ghost is not None:
                    shadow.show(ghost.log.position[ghost.row(time - offset)])

        return show

    def row(self, time: float) -> int:
        """Return the row of the last state at or before a time [s], 0 before the first."""
        return max(int(np.searchsorted(self.log.time, time, side='right')) - 1, 0)

    def offset(self, ghost: ShownLog) -> float | None:
        """Return the time [s] at which a ghost starts, None if both have no time in common."""
        offset = ghost.log.start - self.log.start
        common = -float(ghost.log.time[-1]) <= offset <= float(self.log.time[-1])
        return offset if common else None
