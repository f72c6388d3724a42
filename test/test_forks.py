# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A process may be forked at any time: a child never waits for a lock of a thread it lacks."""

from __future__ import annotations

import ast
from collections.abc import Iterator
import json
import os
from pathlib import Path
import subprocess
import sys

from bridge import cached_property
from process_that_forks import WORK
import pytest

import pfd_core as pfd

SCRIPT = Path(__file__).with_name('process_that_forks.py')
PACKAGE = Path(pfd.__file__).parent
# Standard names that hold a lock while they call back or import.
LOCKED = {'cached_property', 'mkstemp', 'Barrier', 'Condition', 'Event', 'Semaphore'}
LOCKED |= {'Lock', 'RLock'}
# Does some work, and prints the modules that it imports: all of them, and those during whose
# import the process could be forked.
IMPORTS = """
import json, sys
import process_that_forks as process
from pfd_core.forking import no_fork
found, open_to_forks = [], []
class Watch:
    def find_spec(self, name, *_):
        found.append(name)
        if not no_fork._is_owned():
            open_to_forks.append(name)
sys.meta_path.insert(0, Watch())
process.WORK[sys.argv[1]]()
print(json.dumps([found, open_to_forks]))
"""
# Far longer than any of the processes takes [s]; one that hangs is killed and fails.
PATIENCE = 1200.0

needs_fork = pytest.mark.skipif(not hasattr(os, 'fork'), reason='needs fork')


def forking_process(work: str, children: int) -> None:
    """Fork children in a fresh process whose threads compile."""
    subprocess.run(
        [sys.executable, '-W', 'ignore::DeprecationWarning', SCRIPT, work, str(children)],
        env=os.environ | {'PFD_CACHE': '', 'PYTHONPATH': os.pathsep.join(sys.path)},
        check=True,
        timeout=PATIENCE,
    )


@needs_fork
@pytest.mark.slow
@pytest.mark.timeout(PATIENCE)
@pytest.mark.parametrize('work', WORK)
def test_a_child_forked_while_threads_compile_computes_too(work: str) -> None:
    forking_process(work, 3)


@needs_fork
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.timeout(12 * PATIENCE)
@pytest.mark.parametrize('work', WORK)
def test_a_dozen_fresh_processes_fork_a_dozen_children_each(work: str) -> None:
    for _ in range(12):
        forking_process(work, 12)


@pytest.mark.parametrize(('work', 'module'), [('kernels', 'llvmlite'), ('digits', 'mpmath')])
def test_computing_imports_modules_only_while_no_process_can_be_forked(
    work: str, module: str
) -> None:
    done = subprocess.run(
        [sys.executable, '-c', IMPORTS, work],
        env=os.environ | {'PYTHONPATH': os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
        timeout=PATIENCE,
    )
    found, open_to_forks = json.loads(done.stdout)
    assert module in found
    assert not open_to_forks


def violations(source: str) -> Iterator[str]:
    """Yield the locks that a module uses and its imports within functions that a fork may meet."""
    tree = ast.parse(source)
    guarded = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.With) and 'no_fork' in ast.unparse(node.items[0])
        for inner in node.body
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in LOCKED:
            yield ast.unparse(node)
        if isinstance(node, ast.ImportFrom) and not str(node.module).startswith('pfd_core'):
            yield from (alias.name for alias in node.names if alias.name in LOCKED)
        if isinstance(node, ast.FunctionDef):
            yield from (
                ast.unparse(inner)
                for inner in ast.walk(node)
                if isinstance(inner, ast.Import | ast.ImportFrom) and inner not in guarded
            )


def test_locks_and_late_imports_are_those_that_are_held_at_a_fork() -> None:
    found = {
        path.relative_to(PACKAGE).as_posix(): list(violations(path.read_text(encoding='utf-8')))
        for path in PACKAGE.rglob('*.py')
        if 'report' not in path.parts  # separate programs, which do not fork
    }
    assert {name: lines for name, lines in found.items() if lines} == {
        'forking.py': ['threading.RLock', 'functools.cached_property', 'functools.cached_property']
    }


@pytest.mark.parametrize(
    'source',
    [
        'from functools import cached_property',
        'import threading\nlock = threading.Lock()',
        'def f():\n    import mpmath',
    ],
)
def test_the_check_finds_a_lock(source: str) -> None:
    assert len(list(violations(source))) == 1


def test_a_property_is_computed_once_and_kept_in_the_instance() -> None:
    class Square:
        side = 3
        computed = 0

        @cached_property
        def area(self) -> int:
            self.computed += 1
            return self.side**2

    square = Square()
    assert (square.area, square.area, square.computed) == (9, 9, 1)
    assert vars(square)['area'] == 9
    assert Square().computed == 0
