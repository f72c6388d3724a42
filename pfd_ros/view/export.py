# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A page in one file, which plays a log without Python and without a network."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pfd_ros.files import new_file
from pfd_ros.view.logged_arm import Content, fill
from pfd_ros.view.server import page

# Frames a second, and at most: a longer log has fewer a second, at the same speed.
RATE = 30.0
MOST_FRAMES = 3000


def export(
    content: Content,
    ghost: Content | None,
    path: Path,
    progress: Callable[[float], None] | None = None,
) -> int:
    """
    Write a log to a page that plays it.

    Parameters
    ----------
    content : Content
        The log.
    ghost : Content or None
        Another log, drawn translucent.
    path : Path
        The file, which must not exist.
    progress : callable, optional
        Called now and then with the finished part, 0 to 1.

    Returns
    -------
    int
        Bytes written.

    Raises
    ------
    OSError
        If the file exists, or cannot be written.

    """
    times = frame_times(content.motion.duration)
    # Before the work, so that a wrong path is told at once.
    with new_file(path, 'x', encoding='utf-8') as stream, page(0, '') as server:
        show = fill(server, content, ghost)
        show(0.0)
        recording = server.get_scene_serializer()
        for before, time in pairwise(times):
            recording.insert_sleep(float(time - before))
            show(min(float(time), content.motion.duration))
            if progress is not None:
                progress(float(time / times[-1]))
        return int(stream.write(recording.as_html()))


def frame_times(duration: float) -> NDArray[np.float64]:
    """Return the times [s] of the frames of a log, from 0 to its end."""
    count = min(int(duration * RATE) + 1, MOST_FRAMES)
    times = np.linspace(0.0, duration, count + 1)
    # The last frame is shown for as long as the others before the page starts again.
    return np.append(times, times[-1] + 1.0 / RATE)
