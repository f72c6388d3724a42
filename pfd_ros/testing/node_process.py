# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node as a process of its own, which ends with the test, however the test ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import tempfile
from typing import Any

import yaml

from pfd_ros.arm.setting_fields import parameter_name
from pfd_ros.arm.settings import Settings

# On Linux the kernel ends the node if the thread that started it is gone (PR_SET_PDEATHSIG), so
# that a killed test runner leaves no node behind.
PARENT_DEATH_SIGNAL = 1
START = f"""
import ctypes, sys
if sys.platform == 'linux':
    ctypes.CDLL(None).prctl({PARENT_DEATH_SIGNAL}, {int(signal.SIGTERM)})
from pfd_ros.node.main import main
raise SystemExit(main())
"""
# A close writes the recording; the node itself gives up before.
END_SECONDS = 20.0
# Of the output, in the text of an error.
LAST_LINES = 15


class NodeProcessError(Exception):
    """A node that did not work to its end; the text has the end of its output."""


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
        file.write_text(
            yaml.safe_dump({'/**': {'ros__parameters': dict(parameters)}}), encoding='utf-8'
        )
        self._output = self._folder / 'output.txt'
        with self._output.open('wb') as stream:
            self._process = subprocess.Popen(
                [sys.executable, '-c', START, '--ros-args', '--params-file', file, *ros_args],
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                # An interrupt of a terminal is for the tests, which then end the node.
                start_new_session=True,
            )

    @property
    def pid(self) -> int:
        """The process id of the node."""
        return self._process.pid

    def text(self) -> str:
        """Return the output of the node so far."""
        return self._output.read_text(encoding='utf-8', errors='replace')

    def check(self) -> None:
        """Raise NodeProcessError if the node has ended."""
        status = self._process.poll()
        if status is not None:
            raise NodeProcessError(self._told(f'the node ended with status {status}'))

    def close(self) -> None:
        """End the node as a signal of a terminal does.

        Raises
        ------
        NodeProcessError
            If it had ended before, did not end, or did not work to its end.
        """
        try:
            self.check()
            self._process.send_signal(signal.SIGINT)
            try:
                status = self._process.wait(END_SECONDS)
            except subprocess.TimeoutExpired:
                raise NodeProcessError(
                    self._told(f'the node did not end within {END_SECONDS:g} s')
                ) from None
            if status != 0:
                raise NodeProcessError(self._told(f'the node ended with status {status}'))
        finally:
            if self._process.poll() is None:
                self._process.kill()
                self._process.wait()
            shutil.rmtree(self._folder, ignore_errors=True)

    def _told(self, text: str) -> str:
        return '\n'.join([f'{text}; its output ends:', *self.text().splitlines()[-LAST_LINES:]])
