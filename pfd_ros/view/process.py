# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The view of a running arm as a child process, which ends with the arm."""

from __future__ import annotations

from collections.abc import Mapping
import os
from pathlib import Path
import signal
import sys

from pfd_ros.testing.domains import environment_to_kill
from pfd_ros.testing.process import ChildProcess

# The arm comes first where processors are few.
NICENESS = 10
# For the page and ROS to close.
END_SECONDS = 5.0


class ViewProcess:
    """
    `pfd view` of one node, on a port (0: any), of a model (default: the model of the node).

    It prints to the file `output`, default where this process prints.
    """

    def __init__(
        self,
        port: int,
        robot: str | None = None,
        output: Path | None = None,
        env: Mapping[str, str] | None = None,
    ) -> None:
        self.output = output
        self._options = ['--port', str(port), *([] if robot is None else ['--robot', robot])]
        self._env = os.environ if env is None else env
        self._child: ChildProcess | None = None

    def start(self, node: str) -> None:
        """Start it for the node of a full name."""
        command = [sys.executable, '-u', '-m', 'pfd_ros.cli.main', 'view', '--node', node]
        # Fast DDS of the arm would not survive its being killed with shared memory in use.
        env = environment_to_kill(self._env)
        self._child = ChildProcess([*command, *self._options], self.output, env, niceness=NICENESS)

    def ended(self) -> str:
        """Return how it ended, '' before its start and while it runs."""
        how = '' if self._child is None else self._child.end()
        return f'the 3D view {how}' if how else ''

    def text(self) -> str:
        """Return what it has printed to its file."""
        return '' if self._child is None else self._child.text()

    def stop(self) -> None:
        """End it, after some seconds by force."""
        if self._child is not None:
            self._child.stop(END_SECONDS, signal.SIGTERM)
