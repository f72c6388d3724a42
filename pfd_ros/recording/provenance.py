# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What may change the bits of a run: versions of the software, the processor, the robot."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
import platform
import re
import subprocess

import pfd_core as pfd
from pfd_ros.text import cut

# The commit of the software, and the digest of the compiled program, beside the versions.
COMMIT, PROGRAM, PROCESSOR = 'commit', 'program', 'cpu'
# The software whose versions may change the bits.
DECISIVE = ('pfd', 'numpy', 'llvmlite')


def versions() -> dict[str, str]:
    """Return the software versions that may change the bits, and the processor."""
    found = {'pfd': pfd.__version__, 'python': platform.python_version()}
    found |= {name: version(name) for name in ('numpy', 'llvmlite', 'mcap')}
    return {**found, 'platform': platform.platform(), PROCESSOR: _processor(), COMMIT: commit()}


def _processor() -> str:
    with suppress(OSError):
        text = Path('/proc/cpuinfo').read_text(encoding='utf-8', errors='replace')
        if name := re.search(r'^model name\s*:(.*)', text, re.MULTILINE):
            return name[1].strip()
    return platform.processor()


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


def robot_text(robot: pfd.Robot) -> str:
    """Return a robot as YAML, with the frames for wrenches and payloads: its file may change."""
    frames = {name: frame for name, frame in robot.frames.items() if frame.link == robot.links}
    return pfd.robot_to_yaml(replace(robot, frames=frames), frames=True)


def cause(recorded: Mapping[str, str], program: str, altered: bool | None) -> str:
    """Return why a recording with these versions and its replay by a program differ.

    `altered` says whether the messages are others than those recorded; None if that is unknown.
    """
    here = versions() | {PROGRAM: program}

    def both(name: str) -> str:
        there = cut(recorded.get(name) or 'unknown')
        return f'{name} {there}, here {cut(here[name] or "unknown")}'

    if altered:
        return 'cause: other data, the messages are not the recorded ones'
    if recorded.get(PROGRAM) != program:
        named = [n for n in ('pfd', COMMIT, 'llvmlite', 'numpy') if recorded.get(n) != here[n]]
        return f'cause: another program, {"; ".join(map(both, [PROGRAM, *named]))}'
    if altered is None:
        return f'cause: not the program; other data, or {both(PROCESSOR)}'
    return f'cause: not the program, the settings or the data; {both(PROCESSOR)}'
