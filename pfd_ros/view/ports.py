# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a page needs: its port, and installed packages. Nothing of them is imported here."""

from __future__ import annotations

import importlib.util
import socket

from pfd_ros.extras import install

HOST, PORT = '127.0.0.1', 8080
# What a view of a running arm prints once a browser shows it.
OPENED = 'a browser has opened the page'
NEEDED = ('viser', 'trimesh', 'collada')
IN_USE = 'port {} is in use: --port 0 takes a free one'


def check_page(port: int) -> None:
    """Raise ValueError, with the cure, if a page cannot be served here, or not on a port."""
    if any(importlib.util.find_spec(name) is None for name in NEEDED):
        raise ValueError(f'the 3D view needs {", ".join(NEEDED)}: {install("view")}')
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        # As servers do: a port whose last connections are closing is free.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except PermissionError as error:
            raise ValueError(f'port {port} needs privileges: --port 0 takes a free one') from error
        except OSError as error:
            raise ValueError(IN_USE.format(port)) from error
