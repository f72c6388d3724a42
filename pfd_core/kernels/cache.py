# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Results on disk: what was recorded, lowered or compiled once is found again by its key.

    <folder>/<SHA-256 of everything that decides the result>.pfd

The folder is `pfd_ros` in the user's cache folder (XDG_CACHE_HOME, or ~/.cache). The environment
variable PFD_CACHE names another one, or, set to nothing, switches the cache off. A file is written
beside its place and moved there whole, so that several processes may write at once; it begins
with a checksum, and one that is damaged counts as absent. Once the files hold more than LIMIT
bytes, those that were not used for longest are removed.

The cache never decides a result: without it, everything is computed again.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cache
import hashlib
from itertools import chain
import json
import logging
import os
from pathlib import Path
import re
import stat
import sys
import tempfile
import time
from typing import TypeVar

import numpy as np

VARIABLE = 'PFD_CACHE'
LIMIT = 512 * 2**20
# Removing goes on to here, so that it is not done again at once.
TRIMMED = LIMIT * 3 // 4
HEAD = b'pfd_ros cache 1\n'
CHECKSUM = hashlib.sha256().digest_size
SUFFIX = '.pfd'
UNFINISHED = 'unfinished-'
# The folder may be any; only what the cache wrote itself is ever removed.
OWN = re.compile(rf'[0-9a-f]{{64}}{re.escape(SUFFIX)}|{UNFINISHED}.*{re.escape(SUFFIX)}')
PACKAGE = Path(__file__).resolve().parent.parent
# A source file changed since then, or while this package was imported, may not be what runs.
IMPORTED = time.time()
IMPORTING = 1.0  # [s]

LOG = logging.getLogger('pfd_core')
T = TypeVar('T')
# Bytes in each folder as far as this process knows.
_held: dict[Path, int] = {}


def folder() -> Path | None:
    """Return the folder of the cache, which need not exist, or None if it is switched off."""
    given = os.environ.get(VARIABLE)
    if given is not None:
        return Path(given) if given else None
    base = Path(os.environ.get('XDG_CACHE_HOME', ''))
    try:
        # A relative XDG_CACHE_HOME is to be ignored (XDG base directory specification).
        return (base if base.is_absolute() else Path.home() / '.cache') / 'pfd_ros'
    except RuntimeError:  # nobody's home
        return None


def digest(*parts: str) -> str:
    """Return the SHA-256 of some texts, each kept apart from the next, in hexadecimal."""
    state = hashlib.sha256()
    for part in parts:
        data = part.encode()
        state.update(f'{len(data)}:'.encode())
        state.update(data)
    return state.hexdigest()


@cache
def sources() -> str | None:
    """Return the digest of the source files that run, or None if they may have changed since."""
    files = sorted(PACKAGE.rglob('*.py'))
    if max(file.stat().st_mtime for file in files) > IMPORTED - IMPORTING:
        return None
    texts = ((str(file.relative_to(PACKAGE)), file.read_text('utf-8')) for file in files)
    return digest(*chain.from_iterable(texts))


def remember(key: tuple[str, ...], make: Callable[[], T]) -> T:
    """
    Return `make()`, or what it returned when it was called for the same key before.

    Parameters
    ----------
    key : tuple of str
        All that the result depends on, besides the source of this package and the versions of
        Python and NumPy.
    make : callable
        Returns what JSON can hold: dict with str for keys, list, str, int, float, bool, None.

    """
    source = None if folder() is None else sources()
    if source is None:
        return make()
    # Python also because kernels know how it lays out its objects.
    python = f'{sys.version} {object.__basicsize__}'
    name = digest('made', source, python, np.__version__, *key)
    found = read(name)
    if found is None:
        found = json.dumps(make()).encode()
        write(name, found)
    value: T = json.loads(found)
    return value


def read(name: str) -> bytes | None:
    """Return what was written under a name (64 hexadecimal digits), or None."""
    where = folder()
    if where is None:
        return None
    path = where / f'{name}{SUFFIX}'
    try:
        if not _trusted(where):
            return None
        data = path.read_bytes()
    except OSError:
        return None
    start = len(HEAD) + CHECKSUM
    payload = data[start:]
    if data[:start] != HEAD + hashlib.sha256(payload).digest():
        LOG.info('%s is damaged: what it held is made again', path)
        return None
    with suppress(OSError):
        os.utime(path)  # the last to be removed
    return payload


def write(name: str, payload: bytes) -> None:
    """Keep some bytes under a name; where that is impossible, say so once and go on."""
    where = folder()
    if where is None:
        return
    data = HEAD + hashlib.sha256(payload).digest() + payload
    try:
        where.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _trusted(where):
            return
        _put(where / f'{name}{SUFFIX}', data)
        _bound(where, len(data))
    except OSError as error:
        _warn(
            f'compiled kernels cannot be kept in {str(where)!r} ({error.strerror}), so each '
            f'process compiles its own: set {VARIABLE} to a folder that can be written, or to '
            'nothing'
        )


def _put(path: Path, data: bytes) -> None:
    """Write a file that nobody ever sees half written."""
    handle, unfinished = tempfile.mkstemp(SUFFIX, UNFINISHED, path.parent)
    try:
        with os.fdopen(handle, 'wb') as file:
            file.write(data)
        os.replace(unfinished, path)
    except BaseException:
        with suppress(OSError):
            os.unlink(unfinished)
        raise


def _trusted(where: Path) -> bool:
    """Return whether nobody else can have put native code there for this user to run."""
    if sys.platform == 'win32':
        return True
    state = where.stat()
    if state.st_uid in (0, os.geteuid()) and not state.st_mode & stat.S_IWOTH:
        return True
    _warn(
        f'the cache folder {str(where)!r} belongs to user {state.st_uid} or is writable by '
        f'everybody (mode {stat.filemode(state.st_mode)}), so it is not used: set {VARIABLE} to '
        'a folder of your own, or to nothing'
    )
    return False


@cache
def _warn(text: str) -> None:
    """Say something once."""
    LOG.warning(text)


def _bound(where: Path, added: int) -> None:
    """Remove what was not used for longest, once a folder holds more than the limit."""
    if where in _held:
        _held[where] += added
        if _held[where] <= LIMIT:
            return
    files = []
    for entry in os.scandir(where):
        with suppress(FileNotFoundError):  # another process removes, too
            if OWN.fullmatch(entry.name):
                state = entry.stat()
                files.append((state.st_mtime_ns, state.st_size, entry.path))
    total = sum(size for _, size, _ in files)
    if total > LIMIT:
        for _, size, path in sorted(files):
            if total <= TRIMMED:
                break
            with suppress(FileNotFoundError):
                os.unlink(path)
            total -= size
    _held[where] = total
