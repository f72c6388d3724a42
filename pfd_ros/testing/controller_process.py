# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A controller as a separate process, which ends with the test, and its output."""

from __future__ import annotations

from collections.abc import Sequence
import os
from pathlib import Path
import shlex
import shutil
import tempfile

from pfd_ros.testing.child_process import ChildProcess
from pfd_ros.testing.domains import environment_to_kill

# From SIGINT, which ends a node, to SIGKILL.
END_SECONDS = 5.0


class ControllerProcess(ChildProcess):
    """A running process, in the ROS domain of the test.

    Parameters
    ----------
    command
        Program and arguments.
    """

    def __init__(self, command: Sequence[str | os.PathLike[str]]) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix='pfd_ros_'))
        env = environment_to_kill(os.environ)
        super().__init__(command, self._folder / 'output.txt', env)

    def __enter__(self) -> ControllerProcess:
        """Return the process."""
        return self

    def __exit__(self, *error: object) -> None:
        """End the process."""
        self.close()

    def __str__(self) -> str:
        return f'the process {shlex.join(self.command)!r} (pid {self.pid})'

    def close(self) -> None:
        """End the process, as Ctrl-C does or else by force."""
        self.stop(END_SECONDS)
        shutil.rmtree(self._folder, ignore_errors=True)
