# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
JSON values on disk, valid for this source of the package: computed once for each key.

Modules of the package are imported at their first use, and source files may be edited while a
process runs. Nothing is kept of a process whose running code may differ from the source that it
reads here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from importlib.resources import files
from itertools import chain
import json
import os
from pathlib import Path
import sys
import time
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pfd_core.forking import IMPORTED
from pfd_core.kernels.codegen.python_entry import HEADER
from pfd_core.kernels.runtime.disk_cache import LOG, digest, folder, read, write

if TYPE_CHECKING:
    from importlib.abc import Traversable

NAME = __name__.partition('.')[0]
PACKAGE: Traversable = files(NAME)
IMPORTING = 1.0  # the longest time from an edit of a source file to the import of the package [s]

T = TypeVar('T')


@cache
def sources() -> str | None:
    """
    Return the digest of the source files of this package as it was imported, or None.

    None is for a package without source files, and for files so new that they may have been
    written after the package was imported. Times in the future are ignored.
    """
    return _digest()


@cache
def _are_sources(source: str, modules: int) -> bool:
    """Return whether a digest is that of the files, now that so many modules are imported."""
    return _digest() == source


def _digest() -> str | None:
    try:
        found = sorted(_sources(PACKAGE, getattr(sys.modules[__name__].__loader__, 'archive', '')))
    except Exception:  # loaders of packages raise exceptions of many kinds
        return None
    times = [changed for _, _, changed in found]
    now = time.time()
    if not found or any(IMPORTED - IMPORTING < changed <= now for changed in times):
        return None
    return digest(*chain.from_iterable((name, text) for name, text, _ in found))


def _sources(where: Traversable, archive: str, at: str = '') -> Iterator[tuple[str, str, float]]:
    """Yield name, text and time of each source file; in an archive, the time of the archive."""
    for entry in where.iterdir():
        name = f'{at}/{entry.name}'
        if entry.is_dir():
            yield from _sources(entry, archive, name)
        elif name.endswith('.py'):
            changed = os.stat(archive or Path(str(entry))).st_mtime
            yield name, entry.read_text('utf-8'), changed


def get_or_compute(
    key: tuple[str, ...], compute: Callable[[], T], valid: Callable[[Any], bool]
) -> T:
    """
    Return `compute()`, from disk if it was computed for the same key before.

    Parameters
    ----------
    key : tuple of str
        Everything that the result depends on, except the source of this package and the versions
        of Python and NumPy.
    compute : callable
        Returns a JSON value: dict with str for keys, list, str, int, float, bool, None.
    valid : callable
        Tells of any JSON value whether `compute` may have returned it; an entry that is not
        valid counts as absent.

    """
    source = None if folder() is None else sources()
    if source is None:
        return compute()
    # Python's version also because a kernel depends on how Python lays out its objects.
    python = f'{sys.version} {HEADER}'
    name = digest('made', source, python, np.__version__, *key)
    entry = read(name)
    if entry is not None:
        with suppress(ValueError, RecursionError):
            value: T = json.loads(entry)
            if valid(value):
                return value
        LOG.info('the cache entry of %r is not valid: it is computed again', key)
    computed = json.dumps(compute()).encode()
    # A module that was imported only now may be of a later edit.
    if _are_sources(source, sum(module.startswith(NAME) for module in list(sys.modules))):
        write(name, computed)
    return json.loads(computed)  # type: ignore[no-any-return]


# At once, because source files may be edited while this process runs.
sources()
