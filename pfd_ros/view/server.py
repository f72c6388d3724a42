# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page's server: on this computer only, without its program's banner and share button."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
import io
from typing import Any

import numpy as np
import viser

from pfd_ros.view.ports import HOST, check_port, in_use

# Distance of the camera from the middle of what is shown, as a part of its size.
DISTANCE = 0.9
DIRECTION = (0.75, -0.85, 0.4)


@contextmanager
def page(port: int, title: str) -> Iterator[viser.ViserServer]:
    """
    Serve an empty page until the block ends.

    Parameters
    ----------
    port : int
        The port on 127.0.0.1; 0 takes a free one.
    title : str
        Shown on top of its controls.

    Raises
    ------
    ValueError
        If another program listens on the port.

    """
    # The server itself would take the next port.
    check_port(port)
    with redirect_stdout(io.StringIO()):
        server = viser.ViserServer(HOST, port, label=title, verbose=False)
    try:
        if port not in (0, server.get_port()):
            raise ValueError(in_use(port))
        # The share button would send the scene to a server on the internet.
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.main_panel.dock_right()
        server.scene.set_up_direction('+z')
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


def address(server: viser.ViserServer) -> str:
    """Return the URL of a page."""
    return f'http://{HOST}:{server.get_port()}'


def look_at(server: viser.ViserServer, low: Any, high: Any) -> None:
    """Place the camera so that a box from `low` to `high`, (3,) each [m], is in view."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    size = max(float(np.linalg.norm(high - low)), 1e-3)
    middle = (low + high) / 2
    direction = np.array(DIRECTION) / np.linalg.norm(DIRECTION)
    camera = server.initial_camera
    camera.look_at = tuple(middle)
    camera.position = tuple(middle + DISTANCE * size * direction)
    camera.near, camera.far = size / 200, size * 200
