# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes that refuse to start, each in a process of its own after one import of everything.

    python forked_nodes.py FILE

FILE holds a list of command lines in JSON; the exit status and the output of each are printed.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
import sys

from pfd_ros.node import process  # noqa: F401  imports all that a node needs
from pfd_ros.node.main import main


def ending(args: list[str], output: Path) -> tuple[int, str]:
    """Return the exit status and the output of a node."""
    sys.stdout.flush()
    child = os.fork()
    if not child:
        status = 70
        try:
            with output.open('wb') as stream:
                os.dup2(stream.fileno(), 1)
                os.dup2(stream.fileno(), 2)
            status = main(args)
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
    _, found = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(found), output.read_text(encoding='utf-8')


if __name__ == '__main__':
    chosen = json.loads(Path(sys.argv[1]).read_text(encoding='utf-8'))
    print(json.dumps([ending(args, Path(f'node_{k}.txt')) for k, args in enumerate(chosen)]))
