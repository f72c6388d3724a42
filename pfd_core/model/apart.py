# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Programs that make a URDF of a robot's file, in another process with a bound on time.

A xacro file is a program, which may not end, and a MuJoCo model may repeat bodies at will.
"""

from __future__ import annotations

from collections.abc import Sequence
import json
import sys
from typing import Any

from pfd_core.forking import no_fork

# The description of a UR or Panda takes 0.3 to 0.5 s.
SECONDS = 60.0
# The other process imports from where this one does.
SCRIPT = """
import importlib, json, sys
path, module, *words = sys.argv[1:]
sys.path[:] = json.loads(path)
getattr(importlib.import_module(module), 'answer')(*words)
"""


def answer_of(module: str, words: Sequence[str], program: str, label: str) -> dict[str, Any]:
    """Return the JSON that `answer` of a module prints; ValueError, with the label, for none."""
    with no_fork:
        import subprocess
    path = json.dumps([*map(str, sys.path)])
    command = [sys.executable, '-c', SCRIPT, path, module, *words]
    try:
        # Warnings of the program go to stderr.
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            timeout=SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise ValueError(
            f'{program} did not expand {label} within {SECONDS:g} s; it was stopped'
        ) from error
    if done.returncode:
        raise ValueError(
            f'{program} cannot expand {label}: it ended with status {done.returncode}'
        )
    result: dict[str, Any] = json.loads(done.stdout)
    return result
