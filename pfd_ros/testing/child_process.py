# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processes that end with their parent, however it ends; controllers as such processes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
import os
from pathlib import Path
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile

from pfd_ros.testing.domains import environment_to_kill

# On Linux the kernel ends the process if the thread that started it is gone (PR_SET_PDEATHSIG), so
# that a killed test runner leaves nothing behind; exec keeps that (prctl(2)).
START = f"""
import ctypes, os, sys
if sys.platform == 'linux':
    ctypes.CDLL(None).prctl(1, {int(signal.SIGTERM)})
os.nice(int(sys.argv[1]))
os.execvp(sys.argv[2], sys.argv[2:])
"""
# Of the output, in the text of an error.
LAST_LINES = 15
# Of a controller, from SIGINT, which ends a node, to SIGKILL.
END_SECONDS = 5.0


class ChildProcess:
    """A running process and its output.

    Parameters
    ----------
    command
        Program and arguments.
    output
        A file for its stdout and stderr; None for those of this process.
    env, cwd
        As for subprocess.Popen.
    niceness
        By how much it gives way to other processes, 0 to 19.
    """

    def __init__(
        self,
        command: Sequence[str | os.PathLike[str]],
        output: Path | None,
        env: Mapping[str, str] | None = None,
        cwd: Path | None = None,
        niceness: int = 0,
    ) -> None:
        self.command = [os.fspath(part) for part in command]
        self.output = output
        with nullcontext() if output is None else output.open('wb') as stream:
            self.process = subprocess.Popen(
                # Without site packages this start takes 10 ms.
                [sys.executable, '-I', '-S', '-c', START, str(niceness), *self.command],
                cwd=cwd,
                env=env,
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=None if output is None else subprocess.STDOUT,
                # An interrupt of a terminal is for the starter, which then ends the process.
                start_new_session=True,
            )

    @property
    def pid(self) -> int:
        """The process id."""
        return self.process.pid

    def text(self) -> str:
        """Return its stdout and stderr so far, '' where it has no file."""
        if self.output is None:
            return ''
        return self.output.read_text(encoding='utf-8', errors='replace')

    def tail(self) -> str:
        """Return the last lines of its stdout and stderr, after a line break; '' without any."""
        lines = self.text().splitlines()[-LAST_LINES:]
        return '\n'.join(['; its output ends:', *lines]) if lines else '; it printed nothing'

    def end(self) -> str:
        """Return how it ended, '' while it runs."""
        status = self.process.poll()
        if status is None:
            return ''
        if status >= 0:
            return f'ended with status {status}'
        # Signals for programs in real time have no names.
        names = {int(number): number.name for number in signal.Signals}
        return f'ended by {names.get(-status, f"signal {-status}")}'

    def stop(self, seconds: float, number: signal.Signals = signal.SIGINT) -> int:
        """End the process by a signal, after so many seconds by force; return its status."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            return self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()


class ControllerProcess(ChildProcess):
    """A controller as a running process, in the ROS domain of the test.

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
