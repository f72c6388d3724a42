# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Xacro files -> URDF text, by the package `xacro` where it is installed.

A xacro file is a program: its macros may call each other and grow without bound. It is expanded in
a separate process with bounds on time, memory and result. Warnings of xacro go to stderr.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
import subprocess
import sys

from pfd_core.model.urdf import MOST_CHARACTERS
from pfd_core.model.values import quote

# The description of a UR or Panda takes 0.1 to 0.3 s and 30 MB.
MOST_SECONDS = 60.0
MOST_MEMORY = 2**30
# Windows has no module `resource`, and so no bound on memory.
SCRIPT = f"""
import sys
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, ({MOST_MEMORY}, {MOST_MEMORY}))
except (ImportError, ValueError, OSError):
    pass
import xacro
try:
    text = xacro.process_file(sys.argv[1]).toxml()
    if len(text) > {MOST_CHARACTERS}:
        raise ValueError('the expanded text has more than {MOST_CHARACTERS} characters')
except Exception as error:
    cause = getattr(error, 'exc', None) or error
    text = f'{{type(cause).__name__}}: {{error}}'
    status = 1
else:
    status = 0
sys.stdout.buffer.write(text.encode('utf-8', 'backslashreplace'))
sys.exit(status)
"""


def expanded(path: Path) -> str:
    """
    Return the URDF that a xacro file expands to, with the defaults of its arguments.

    Parameters
    ----------
    path : Path
        A file that exists.

    Raises
    ------
    ValueError
        If xacro is not installed or cannot expand the file.

    """
    label = quote(str(path))
    xacro = find_spec('xacro')
    if xacro is None or xacro.origin is None:  # None: a folder of that name
        raise ValueError(
            f'{label} needs the package xacro, which is not installed: run `pip install xacro` '
            'or `apt install ros-jazzy-xacro`'
        )
    try:
        done = subprocess.run(
            [sys.executable, '-c', SCRIPT, str(path.absolute())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            timeout=MOST_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise ValueError(
            f'xacro did not expand {label} within {MOST_SECONDS:g} s; it was stopped'
        ) from error
    text = done.stdout.decode('utf-8')
    if done.returncode:
        reason = quote(text)[1:-1] or f'it ended with status {done.returncode}'
        raise ValueError(f'xacro cannot expand {label}: {reason}')
    return text
