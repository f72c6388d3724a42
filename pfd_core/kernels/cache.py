# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Results on disk, each under a digest of everything that determines it.

    <folder>/<SHA-256>.pfd        SHA-256 of name and contents, JSON, a zero byte, other bytes

The folder is `pfd_ros` in the user's cache folder (XDG_CACHE_HOME, or ~/.cache). The environment
variable PFD_CACHE names another one, or, if empty, disables the cache. Native code from disk is
run, so the folder must belong to the user (or root) and must not be writable by others. A file is
moved there whole, so that several processes may write at once. Above LIMIT bytes (and 1/256 of it
for each process that writes) the least recently used files are removed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
import hashlib
import json
import logging
import os
from pathlib import Path
import sys
from typing import Any

import numpy as np

VARIABLE = 'PFD_CACHE'
REMEDY = f'set {VARIABLE} to a folder of your own, or to nothing'
LIMIT = 512 * 2**20
SUFFIX = '.pfd'
CHECKSUM = hashlib.sha256().digest_size
PACKAGE = Path(__file__).parents[1]

LOG = logging.getLogger('pfd_core')
# Bytes that this process has written since it last looked for files to remove.
_unchecked = LIMIT


def kept(
    key: Sequence[str], make: Callable[[], tuple[dict[str, Any], bytes]]
) -> tuple[dict[str, Any], bytes]:
    """
    Return the JSON object and the bytes of an entry, which `make` returns if there is none.

    The key is everything that determines them, except the source of this package and the versions
    of Python and NumPy. An entry that is damaged, or of another name, is as good as none.
    """
    if SOURCE is None or folder() is None:
        return make()
    # Compiled code depends on how Python lays out its objects.
    python = sys.version, str(object.__basicsize__), np.__version__
    name = digest(SOURCE, *python, *key)
    entry = read(name)
    if entry is None:
        made, payload = make()
        entry = json.dumps(made).encode() + b'\0' + payload
        # Modules are imported at their first use: one of them may be of a later edit.
        if _files() == FILES:
            write(name, entry)
    head, _, payload = entry.partition(b'\0')
    return json.loads(head), payload


def digest(*parts: str) -> str:
    """Return the SHA-256 of some strings, separated from each other, in hexadecimal."""
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def folder() -> Path | None:
    """Return the folder of the cache, which need not exist, or None if the cache is off."""
    given = os.environ.get(VARIABLE)
    if given is not None and not given.strip():
        return None
    try:
        if given is not None:
            return Path(given).expanduser().absolute()
        base = Path(os.environ.get('XDG_CACHE_HOME', ''))
        # A relative XDG_CACHE_HOME is to be ignored (XDG base directory specification).
        return (base if base.is_absolute() else Path.home() / '.cache').absolute() / 'pfd_ros'
    except (RuntimeError, OSError) as error:  # no home folder, or a deleted current folder
        _warn(f'compiled kernels are not kept, as there is no cache folder ({error}): {REMEDY}')
        return None


def read(name: str) -> bytes | None:
    """Return the bytes written under a name (64 hexadecimal digits), or None."""
    where = folder()
    if where is None:
        return None
    path = where / f'{name}{SUFFIX}'
    try:
        # A file of another kind may block its reader.
        if not path.is_file() or path.stat().st_size > LIMIT or not _ours(where):
            return None
        data = path.read_bytes()
        with suppress(OSError):  # a file system that is read-only
            os.utime(path)  # marks the file as recently used
    except OSError as error:
        LOG.info('%r cannot be read (%s)', str(path), error)
        return None
    if data[:CHECKSUM] != _checksum(name, data[CHECKSUM:]):
        LOG.info('%r is damaged', str(path))
        return None
    return data[CHECKSUM:]


def write(name: str, payload: bytes) -> None:
    """Write some bytes under a name; warn if that is impossible."""
    global _unchecked
    where = folder()
    if where is None:
        return
    unfinished = where / f'{os.urandom(8).hex()}.unfinished{SUFFIX}'
    try:
        where.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _ours(where):
            return
        try:
            with open(os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), 'wb') as f:
                f.write(_checksum(name, payload) + payload)
            os.replace(unfinished, where / f'{name}{SUFFIX}')
        finally:
            unfinished.unlink(missing_ok=True)
        _unchecked += len(payload)
        if _unchecked > LIMIT // 256:  # to look at each file takes longer than to write one
            _unchecked = 0
            _evict(where)
    except OSError as error:
        _warn(
            f'compiled kernels cannot be kept in {str(where)!r} ({error.strerror}), so each '
            f'process compiles its own: {REMEDY}'
        )


def _checksum(name: str, payload: bytes) -> bytes:
    return hashlib.sha256(name.encode() + payload).digest()


def _ours(where: Path) -> bool:
    """Return whether only the user and root can have put native code into a folder."""
    if sys.platform == 'win32':
        return True
    state = where.stat()
    if state.st_uid in (0, os.geteuid()) and not state.st_mode & 0o022:
        return True
    _warn(
        f'the cache folder {str(where)!r} is not used, because others could put code there: make '
        f'it your own and take group and others the right to write (chmod go-w), or {REMEDY}'
    )
    return False


def _evict(where: Path) -> None:
    """Remove the least recently used files, once a folder holds more than the limit."""
    files = []
    with os.scandir(where) as entries:
        for entry in entries:
            with suppress(OSError):  # another process may have removed it
                if entry.name.endswith(SUFFIX):
                    state = entry.stat()
                    files.append((state.st_mtime_ns, state.st_size, entry.path))
    total = sum(size for _, size, _ in files)
    # Down to less than the limit, so that files need not be removed again at once.
    least = LIMIT * 3 // 4 if total > LIMIT else total
    for _, size, path in sorted(files):
        with suppress(OSError):
            if total > least:
                os.unlink(path)
                total -= size


@cache
def _warn(text: str) -> None:
    LOG.warning('%s', text)


def _files() -> list[tuple[str, int, int]]:
    """Return path, time of the last change and size of each source file; none if one has gone."""
    paths = (os.path.join(where, name) for where, _, names in os.walk(PACKAGE) for name in names)
    with suppress(OSError):
        states = ((path, os.stat(path)) for path in paths if path.endswith('.py'))
        return sorted((path, state.st_mtime_ns, state.st_size) for path, state in states)
    return []


def _source() -> str | None:
    """Return the digest of the source files of this package; None if they cannot be read."""
    found = hashlib.sha256()
    with suppress(OSError):
        for path, _, _ in FILES:
            data = Path(path).read_bytes()
            found.update(f'{path.removeprefix(str(PACKAGE))} {len(data)} '.encode() + data)
        return found.hexdigest() if FILES else None
    return None


# At once, because source files may be edited while this process runs, or while they are read.
FILES = _files()
SOURCE = _source()
