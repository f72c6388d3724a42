# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Fork safety: a process may be forked at any time, also while its threads compile.

A child has only the thread that forked. A lock that another thread held then is never released
in the child, which hangs at its first use of the lock. So no lock of this package or of a library
is held at a fork: values computed once need no lock (`cached_property`), and the few locks that
are needed (`no_fork`, and locks given to `hold_at_fork`) are acquired before each fork.

Python holds a lock for each module that it imports. Modules of this package are imported at their
first use, so tables import them by `load`, and functions in a block of `with no_fork`.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
import functools
from importlib import import_module
import os
import threading
from typing import Any, TypeVar

T = TypeVar('T')

# For work during which the process must not be forked, such as the import of a module.
no_fork = threading.RLock()
# Locks that are held at a fork, in the order in which a thread acquires them.
_held: list[AbstractContextManager[Any]] = [no_fork]


def hold_at_fork(lock: AbstractContextManager[Any]) -> None:
    """Acquire a lock before each fork; no thread may hold it when it acquires `no_fork`."""
    _held.append(lock)


def load(path: str) -> Any:
    """Return 'module.attribute' of this package; the module is imported at its first use."""
    module, _, name = f'{__package__}.{path}'.rpartition('.')
    with no_fork:
        return getattr(import_module(module), name)


def cached_property(method: Callable[[Any], T]) -> functools.cached_property[T]:
    """
    Return a property whose value is computed at its first use and kept in the instance.

    It has no lock, which functools has for each class before Python 3.12: threads that come first
    together may each compute the value, and one of the values is kept.
    """
    found = functools.cached_property(method)
    vars(found)['lock'] = nullcontext()
    return found


def _acquire() -> None:
    for lock in _held:
        lock.__enter__()


def _release() -> None:
    for lock in reversed(_held):
        lock.__exit__(None, None, None)


if hasattr(os, 'register_at_fork'):
    os.register_at_fork(before=_acquire, after_in_parent=_release, after_in_child=_release)
