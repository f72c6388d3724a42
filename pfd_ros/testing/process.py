# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processes that end with their parent, however it ends: controllers, and the node itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext, suppress
import os
from pathlib import Path
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np
import yaml

import pfd_core as pfd
from pfd_ros.arm.settings import FIELDS
from pfd_ros.testing.domains import environment_to_kill

# On Linux the kernel ends the process if the thread that started it is gone (PR_SET_PDEATHSIG):
# a killed test runner leaves nothing behind; exec keeps that (prctl(2)). It also keeps signals
# ignored, as a shell ignores SIGINT of what it starts in the background: these end the process.
START = f"""
import ctypes, os, signal, sys
for number in {int(signal.SIGINT), int(signal.SIGTERM)}:
    signal.signal(number, signal.SIG_DFL)
niceness, parent, *command = sys.argv[1:]
if sys.platform == 'linux':
    ctypes.CDLL(None).prctl(1, {int(signal.SIGTERM)})
if os.getppid() != int(parent):
    sys.exit('its parent has ended')
os.nice(int(niceness))
try:
    os.execvp(command[0], command)
except OSError as error:
    sys.exit(f'{{command[0]}}: {{error.strerror}}')
"""
# Of the output, in the text of an error.
LAST_LINES = 15
# Between two looks at whether the node has started, and until it is asked again, s.
LOOK_SECONDS, AGAIN_SECONDS = 0.02, 0.5
# From SIGINT, which ends a node, to SIGKILL: of a controller, and of the node with its recording.
END_SECONDS, NODE_END_SECONDS = 5.0, 20.0
# Until a node answers, longer than it may wait for its description by default, s.
NODE_START_SECONDS = 60.0


class ChildProcess:
    """A running process with its own process group, and its output; `pid` is the id of both.

    `output` is a file for its stdout and stderr, None for those of this process; `niceness`, 0 to
    19, is by how much it gives way to other processes; the rest is as for subprocess.Popen.
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
        start = [sys.executable, '-I', '-S', '-c', START]
        with nullcontext() if output is None else output.open('wb') as stream:
            self.process = subprocess.Popen(
                # Without site packages this start takes 10 ms.
                [*start, str(niceness), str(os.getpid()), *self.command],
                cwd=cwd,
                env=env,
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=None if output is None else subprocess.STDOUT,
                # An interrupt of a terminal is for the starter, which then ends the process.
                start_new_session=True,
            )
        self.pid = self.process.pid

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

    def stop(self, seconds: float = END_SECONDS) -> int:
        """End the process and its group as Ctrl-C does, later by force; return its status."""
        if self.process.poll() is None:
            self._signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(seconds)
        # What it started may still run.
        self._signal(signal.SIGKILL)
        return self.process.wait()

    def _signal(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, number)


def check_words(label: str, words: Any) -> None:
    """Raise ValueError for a line in place of its words."""
    if isinstance(words, str):
        raise ValueError(f'{label} is {words!r}, expected a list such as {words.split()}')


def node_named(ros_args: Sequence[str], **options: Any) -> Any:
    """Return a node `sim_arm` without log topic; ValueError for `ros_args` that ROS refuses."""
    from rclpy.node import Node

    try:
        words = ['--ros-args', *ros_args]
        return Node('sim_arm', cli_args=words, enable_rosout=False, **options)
    except (RuntimeError, TypeError) as error:
        # Some of these errors have nothing but the words.
        text = f"words that follow --ros-args, such as ['-r', '__ns:=/left']: {error}"
        raise ValueError(f'ros_args is {ros_args!r}, expected {text}') from error


class ControllerProcess(ChildProcess):
    """A controller as a running process, in the ROS domain of the test; program and arguments."""

    def __init__(self, command: Sequence[str | os.PathLike[str]], folder: str = '') -> None:
        check_words('command', command)
        self.folder = Path(folder or tempfile.mkdtemp(prefix='pfd_ros_'))
        super().__init__(command, self.folder / 'output.txt', environment_to_kill(os.environ))

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
        self.stop()
        shutil.rmtree(self.folder, ignore_errors=True)


def plain(value: Any) -> Any:
    """Return a value of a setting as JSON has it: paths and scenes as text, arrays as lists."""
    if isinstance(value, pfd.Scene):
        return pfd.scene_to_yaml(value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return {joint: plain(number) for joint, number in value.items()}
    if isinstance(value, list | tuple):
        return [plain(number) for number in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


class NodeProcessError(Exception):
    """The node failed; the message has the end of its output."""


class NodeProcess(ControllerProcess):
    """The node `sim_arm` as a running process, which is to end with status 0.

    `parameters` are by name, or by field of the settings: `noise.velocity` or `noise_velocity`;
    those of single joints may be a mapping, and values paths, arrays or a Scene. `ros_args` are as
    on a command line after --ros-args.
    """

    def __init__(self, parameters: Mapping[str, Any], ros_args: Sequence[str] = ()) -> None:
        check_words('ros_args', ros_args)
        names = {row.field: row.name for row in FIELDS}
        chosen = {names.get(name, name): plain(value) for name, value in parameters.items()}
        self._ros_args = ros_args
        # Whether `wait` has raised its error.
        self._failed = False
        folder = tempfile.mkdtemp(prefix='pfd_ros_')
        file = Path(folder, 'parameters.yaml')
        if isinstance(parameters.get('scene'), pfd.Scene):  # the node reads a file
            chosen['scene'] = os.path.join(folder, 'scene.yaml')
            parameters['scene'].save(chosen['scene'])
        file.write_text(yaml.safe_dump({'/**': {'ros__parameters': chosen}}), encoding='utf-8')
        command = [sys.executable, '-m', 'pfd_ros.node.main', '--ros-args', *ros_args]
        super().__init__([*command, '--params-file', file], folder)

    def wait(self) -> None:
        """Return when the arm is active, or the node answers if its autostart is false.

        rclpy must be initialised. NodeProcessError if the node ends before, or does not start.
        """
        from lifecycle_msgs.srv import GetState
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        deadline, self._failed = time.monotonic() + NODE_START_SECONDS, True
        named = node_named(self._ros_args)
        service = named.resolve_service_name('~/get_state')
        named.destroy_node()
        asking = Node('_sim_node_starts', enable_rosout=False)
        client, executor = asking.create_client(GetState, service), SingleThreadedExecutor()
        executor.add_node(asking)
        while self._failed and not self.end() and time.monotonic() < deadline:
            if client.service_is_ready():
                # The node answers once it has configured and activated itself.
                answer = client.call_async(GetState.Request())
                executor.spin_until_future_complete(answer, AGAIN_SECONDS)
                self._failed = not answer.done()
            else:
                time.sleep(LOOK_SECONDS)
        executor.shutdown()
        asking.destroy_node()
        if self._failed:
            late = f'does not answer on {service} within {NODE_START_SECONDS:g} s'
            raise NodeProcessError(f'the node {self.end() or late}{self.tail()}')

    def close(self) -> None:
        """End the node as Ctrl-C does; NodeProcessError if it failed and `wait` did not say so."""
        if not self.folder.exists():  # it has been closed
            return
        ended, status = self.end(), self.stop(NODE_END_SECONDS)
        if not ended and status == -signal.SIGKILL:
            ended = f'did not end within {NODE_END_SECONDS:g} s'
        ended = ended or (self.end() if status else '')
        text = f'the node {ended}{self.tail()}'
        super().close()
        if ended and not self._failed:
            raise NodeProcessError(text)
