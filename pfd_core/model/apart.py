# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Programs that make a URDF of a robot's file, in another process with bounds on time and memory.

A xacro file is a program, which may not end, and a MuJoCo model may repeat bodies at will. Memory
is bounded on Linux alone: other systems do not enforce a bound, or have none.
"""

from __future__ import annotations

from collections.abc import Sequence
import json
import sys
from typing import Any

from pfd_core.forking import no_fork

# The description of a UR or Panda takes 0.3 to 0.5 s.
SECONDS = 60.0
# Address space of the other process [bytes]. Python with MuJoCo takes 0.2 GB on two cores, more on
# many, where each thread reserves its own; a model that repeats bodies takes all that there is.
MEMORY = 4 * 2**30
# The other process imports from where this one does.
SCRIPT = """
import importlib, json, sys
memory, path, module, *words = sys.argv[1:]
if sys.platform == 'linux':
    import resource
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    most = int(memory) if hard == resource.RLIM_INFINITY else min(int(memory), hard)
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))
sys.path[:] = json.loads(path)
getattr(importlib.import_module(module), 'answer')(*words)
"""


def answer_of(module: str, words: Sequence[str], program: str, label: str) -> dict[str, Any]:
    """Return the JSON that `answer` of a module prints; ValueError, with the label, for none."""
    with no_fork:
        import subprocess
    path = json.dumps([*map(str, sys.path)])
    command = [sys.executable, '-c', SCRIPT, str(MEMORY), path, module, *words]
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
            f'{program} cannot expand {label}: it ended with status {done.returncode} (it may '
            f'take {SECONDS:g} s and, on Linux, {MEMORY / 2**30:g} GiB)'
        )
    result: dict[str, Any] = json.loads(done.stdout)
    return result
