# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a page needs: its port, installed packages (none is imported here); its process."""

from __future__ import annotations

from collections.abc import Mapping
import importlib.util
import os
from pathlib import Path
import socket
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pfd_ros.testing.process import ChildProcess

from pfd_ros.extras import install

HOST, PORT = '127.0.0.1', 8080
# What a view of a running arm prints once a browser shows it.
OPENED = 'a browser has opened the page'
NEEDED = ('viser', 'trimesh', 'collada')
# The arm comes first where processors are few.
NICENESS = 10


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
            raise ValueError(f'port {port} is in use: --port 0 takes a free one') from error


def view_process(
    node: str,
    port: int,
    robot: str | None = None,
    output: Path | None = None,
    env: Mapping[str, str] | None = None,
) -> ChildProcess:
    """Start `pfd view` of the node of a full name as a child process, which ends with this one.

    It shows a model (default: that of the node) on a port (0: any), and prints to the file
    `output`, default where this process prints.
    """
    from pfd_ros.testing.domains import environment_to_kill
    from pfd_ros.testing.process import ChildProcess

    command = [sys.executable, '-u', '-m', 'pfd_ros.cli.main', 'view', '--node', node]
    command += ['--port', str(port), *([] if robot is None else ['--robot', robot])]
    # Fast DDS of the arm would not survive its being killed with shared memory in use.
    env = environment_to_kill(os.environ if env is None else env)
    return ChildProcess(command, output, env, niceness=NICENESS)
