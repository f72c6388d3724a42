# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A controller as a process of its own: its output, its end, and that it ends with the test."""

from __future__ import annotations

from collections.abc import Sequence
import os
from pathlib import Path
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile

from pfd_ros.testing.domains import environment_to_kill
from pfd_ros.testing.node_process import LAST_LINES, PARENT_DEATH_SIGNAL

# The kernel ends the process if the test runner is gone; exec keeps that (prctl(2)).
START = f"""
import ctypes, os, sys
if sys.platform == 'linux':
    ctypes.CDLL(None).prctl({PARENT_DEATH_SIGNAL}, {int(signal.SIGTERM)})
os.execvp(sys.argv[1], sys.argv[1:])
"""
# From SIGINT, which ends a node, to SIGKILL.
END_SECONDS = 5.0


class ControllerProcess:
    """A running process, in the ROS domain of the test.

    Parameters
    ----------
    command
        Program and arguments.
    """

    def __init__(self, command: Sequence[str | os.PathLike[str]]) -> None:
        self.command = [os.fspath(part) for part in command]
        self._folder = Path(tempfile.mkdtemp(prefix='pfd_ros_'))
        self._output = self._folder / 'output.txt'
        with self._output.open('wb') as stream:
            self._process = subprocess.Popen(
                [sys.executable, '-c', START, *self.command],
                env=environment_to_kill(os.environ),
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def __enter__(self) -> ControllerProcess:
        """Return the process."""
        return self

    def __exit__(self, *error: object) -> None:
        """End the process."""
        self.close()

    @property
    def pid(self) -> int:
        """The process id."""
        return self._process.pid

    def __str__(self) -> str:
        return f'the process {shlex.join(self.command)!r} (pid {self.pid})'

    def text(self) -> str:
        """Return its stdout and stderr so far."""
        return self._output.read_text(encoding='utf-8', errors='replace')

    def tail(self) -> str:
        """Return the last lines of its stdout and stderr, after a line break; '' without any."""
        lines = self.text().splitlines()[-LAST_LINES:]
        return '\n'.join(['; its output ends:', *lines]) if lines else '; it printed nothing'

    def end(self) -> str:
        """Return how it ended, '' while it runs."""
        status = self._process.poll()
        if status is None:
            return ''
        if status < 0:
            return f'ended by {signal.Signals(-status).name}'
        return f'ended with status {status}'

    def close(self) -> None:
        """End the process, as Ctrl-C does or else by force."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(END_SECONDS)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)
