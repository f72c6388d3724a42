# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node as a separate process, which ends with the test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
from pathlib import Path
import shutil
import signal
import sys
import tempfile
from typing import Any

import yaml

from pfd_ros.arm.setting_fields import parameter_name
from pfd_ros.arm.settings import Settings
from pfd_ros.testing.child_process import ChildProcess

# A close writes the recording; the node itself gives up before.
END_SECONDS = 20.0


class NodeProcessError(Exception):
    """The node failed; the message has the end of its output."""


def parameters_of(settings: Settings, names: Sequence[str]) -> dict[str, Any]:
    """Return the parameters that differ from their defaults; one for each joint where a group."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(settings):
        value, name = getattr(settings, field.name), parameter_name(field)
        if value == field.default:
            continue
        if field.metadata['per_joint']:
            found |= {f'{name}.{joint}': x for joint, x in zip(names, value, strict=True)}
        else:
            found[name] = list(value) if isinstance(value, tuple) else value
    return found


def write_parameters(parameters: Mapping[str, Any], path: Path) -> None:
    """Write parameters by name to a file for nodes of any name."""
    text = yaml.safe_dump({'/**': {'ros__parameters': dict(parameters)}})
    path.write_text(text, encoding='utf-8')


class NodeProcess:
    """A running node.

    Parameters
    ----------
    parameters
        By name.
    ros_args
        More arguments, as on a command line after --ros-args.
    """

    def __init__(self, parameters: Mapping[str, Any], ros_args: Sequence[str]) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix='pfd_ros_'))
        file = self._folder / 'parameters.yaml'
        write_parameters(parameters, file)
        command = [sys.executable, '-m', 'pfd_ros.node.main', '--ros-args', *ros_args]
        command += ['--params-file', str(file)]
        self._child = ChildProcess(command, self._folder / 'output.txt')

    @property
    def pid(self) -> int:
        """The process id of the node."""
        return self._child.pid

    def text(self) -> str:
        """Return the output of the node so far."""
        return self._child.text()

    def check(self) -> None:
        """Raise NodeProcessError if the node has ended."""
        ended = self._child.end()
        if ended:
            raise NodeProcessError(f'the node {ended}{self._child.tail()}')

    def close(self) -> None:
        """End the node as a signal of a terminal does.

        Raises
        ------
        NodeProcessError
            If it had ended before, did not end, or failed.
        """
        try:
            self.check()
            status = self._child.stop(END_SECONDS)
            if status == -signal.SIGKILL:
                raise NodeProcessError(
                    f'the node did not end within {END_SECONDS:g} s{self._child.tail()}'
                )
            if status != 0:
                self.check()
        finally:
            self._child.stop(0.0)
            shutil.rmtree(self._folder, ignore_errors=True)
