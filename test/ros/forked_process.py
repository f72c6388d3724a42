# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processes that start in a moment: forks of one process that has imported what they need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import ctypes
from dataclasses import dataclass
from importlib import import_module
import multiprocessing
import os
from pathlib import Path
from pkgutil import resolve_name
import signal
import subprocess
import sys
from typing import Any

_FORKS = multiprocessing.get_context('forkserver')
_FORKS.set_forkserver_preload(['pfd_ros.node.process', 'pfd_ros.cli.logs', 'pytest', __name__])
PR_SET_PDEATHSIG = 1


@dataclass(frozen=True)
class Job:
    """What a forked process runs.

    Attributes
    ----------
    module, args
        Whose function `main` returns the exit status, and its arguments.
    output
        A file for its stdout and stderr.
    env, cwd
        As for subprocess.Popen.
    replaced
        Dotted path -> what the process has in its place: a value that can be pickled.
    """

    module: str
    args: Sequence[str]
    output: Path
    env: Mapping[str, str]
    cwd: Path
    replaced: Mapping[str, Any]


class ForkedProcess:
    """A process that runs a job, with the methods of subprocess.Popen."""

    def __init__(self, job: Job) -> None:
        self._process = _FORKS.Process(target=_run, args=(job,))
        self._process.start()
        self.pid = self._process.pid

    @property
    def returncode(self) -> int | None:
        return self._process.exitcode

    def poll(self) -> int | None:
        return self._process.exitcode

    def wait(self, seconds: float) -> int:
        self._process.join(seconds)
        if self.returncode is None:
            raise subprocess.TimeoutExpired(self._process.name, seconds)
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


def failing(error: type[Exception], *_: Any) -> None:
    """Raise an error: what a partial function of it replaces has a bug."""
    raise error('a bug')


def put(path: str, value: object) -> Any:
    """Replace what a dotted path names for the rest of this process; return what was there."""
    owner, _, name = path.rpartition('.')
    place = resolve_name(owner)
    before = getattr(place, name)
    setattr(place, name, value)
    return before


def _run(job: Job) -> None:
    if sys.platform == 'linux':
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGTERM))
    os.setsid()
    os.chdir(job.cwd)
    os.environ.clear()
    os.environ.update(job.env)
    with job.output.open('ab') as stream:
        os.dup2(stream.fileno(), 1)
        os.dup2(stream.fileno(), 2)
    for name, value in job.replaced.items():
        put(name, value)
    sys.exit(import_module(job.module).main(list(job.args)))
