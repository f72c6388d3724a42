# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shells complete `pfd` through argcomplete."""

from __future__ import annotations

import os
from pathlib import Path
import shlex
import subprocess
import sys
import sysconfig

import pytest
from waiting import PATIENCE

# What bash does at the key TAB, with the function that argcomplete registers for pfd.
SCRIPT = """
eval "$(register-python-argcomplete pfd)"
COMP_LINE=$1 COMP_POINT=${#1} COMP_TYPE=9 COMP_WORDS=($1) COMP_CWORD=1
_python_argcomplete pfd
printf '%s\\n' "${COMPREPLY[@]}"
"""


def completed(line: str, folder: Path) -> list[str]:
    (folder / 'pfd').write_text(
        f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m pfd_ros.cli.main "$@"\n'
    )
    (folder / 'pfd').chmod(0o755)
    path = os.pathsep.join([str(folder), sysconfig.get_path('scripts'), os.environ['PATH']])
    done = subprocess.run(
        ['bash', '-c', SCRIPT, 'bash', line],
        env=os.environ | {'PATH': path},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=True,
    )
    return [word.strip() for word in done.stdout.splitlines()]


@pytest.mark.parametrize(
    ('line', 'words'),
    [
        ('pfd re', {'replay', 'recover', 'report'}),
        ('pfd replay --wh', {'--what-if'}),
        ('pfd sim --v', {'--view'}),
    ],
)
def test_bash_completes_commands_and_options(line: str, words: set[str], tmp_path: Path) -> None:
    assert set(completed(line, tmp_path)) == words
