# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Build the head of a recording: settings, robot, program, topics and clocks of the run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
import json
from pathlib import Path
import platform
import subprocess
import time

from mcap.records import Attachment

import pfd_core as pfd
from pfd_ros.arm import settings as settings_file
from pfd_ros.arm.settings import SIMULATED, Settings
from pfd_ros.recording.format import FORMAT, ROBOT, HeadKey
from pfd_ros.recording.mcap_file import FileHead, TimeBase

# Keys of the versions: the commit of the software, and the digest of the compiled program.
COMMIT, PROGRAM = 'commit', 'program'
# How the times of messages are to be read; for people.
WALL_TIME = 'wall_ns + steady clock since steady_ns'
SIMULATED_TIME = 'simulated time of the last state'


def _installed(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ''


def _processor() -> str:
    try:
        lines = Path('/proc/cpuinfo').read_text(encoding='utf-8', errors='replace').splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(':')[2].strip() for line in lines if line.startswith('model name')]
    return names[0] if names else platform.processor()


@cache
def commit() -> str:
    """Return the commit of a checkout, with `-dirty` for changed files; '' for a package."""
    checkout = Path(pfd.__file__).resolve().parents[1]
    if not (checkout / '.git').exists():
        return ''
    command = ['git', '-C', str(checkout), 'describe', '--always', '--dirty', '--abbrev=12']
    try:
        done = subprocess.run(
            [*command, '--exclude=*'], capture_output=True, text=True, check=True, timeout=5.0
        )
    except (OSError, subprocess.SubprocessError):
        return ''
    return done.stdout.strip()


def versions() -> dict[str, str]:
    """Return the software versions that may change the bits, and the processor."""
    found = {name: _installed(name) for name in ('numpy', 'llvmlite', 'mcap')}
    return {
        'pfd': pfd.__version__,
        'python': platform.python_version(),
        **found,
        'platform': platform.platform(),
        'cpu': _processor(),
    }


def _robot_yaml(robot: pfd.Robot) -> str:
    """Return a robot as YAML, with the frames for wrenches and payloads."""
    frames = {name: frame for name, frame in robot.frames.items() if frame.link == robot.n}
    return pfd.robot_to_yaml(replace(robot, frames=frames), frames=True)


def time_base(settings: Settings) -> TimeBase:
    """Return the clocks of a recording that begins now."""
    return TimeBase(simulated=settings.log_time == SIMULATED, start_ns=settings.start_ns)


def file_head(
    settings: Settings,
    robot: pfd.Robot,
    topics: Mapping[str, str],
    base: TimeBase,
    program: str,
) -> FileHead:
    """Return the head of a recording.

    Parameters
    ----------
    settings
        Settings of the node, with 'auto' resolved.
    robot
        The robot, stored completely, since its file may change.
    topics
        Full name of the topic of each role.
    base
        The recording's clock.
    program
        Digest of the compiled program.
    """
    values = {
        HeadKey.FORMAT: FORMAT,
        HeadKey.SETTINGS: settings_file.to_json(settings),
        HeadKey.TOPICS: json.dumps(dict(topics)),
        HeadKey.VERSIONS: json.dumps({**versions(), COMMIT: commit(), PROGRAM: program}),
        HeadKey.CLOCK: json.dumps(
            {
                'wall_ns': base.wall_ns,
                'steady_ns': base.steady_ns,
                'log_time': SIMULATED_TIME if base.simulated else WALL_TIME,
                'publish_time': WALL_TIME if base.simulated else SIMULATED_TIME,
                'header.stamp': 'simulated time: start_time + step * step_size',
            }
        ),
    }
    text = _robot_yaml(robot).encode()
    return FileHead(
        library=f'pfd_ros/{pfd.__version__} mcap-python/{_installed("mcap")}',
        values=values,
        attachments=[Attachment(0, base.at(time.monotonic_ns()), ROBOT, 'application/yaml', text)],
        base=base,
    )
