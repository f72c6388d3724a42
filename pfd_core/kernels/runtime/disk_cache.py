# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Bytes on disk: a cache of results, each under a digest of everything that decides it.

    <folder>/<SHA-256 of everything that decides the result>.pfd

The folder is `pfd_ros` in the user's cache folder (XDG_CACHE_HOME, or ~/.cache). The environment
variable PFD_CACHE names another one (`~` is expanded, a relative path begins at the current
folder), or, if empty, disables the cache. A file is written under a temporary name and moved
there whole, so that several processes may write at once; it begins with a checksum of its name
and contents, and a damaged file counts as absent. Once the files hold more than LIMIT bytes, the
least recently used ones are removed.

Native code from disk is run, so folder and files must belong to the user (or root) and must not
be writable by others, and a file must be a regular one. Otherwise they are not used.

The cache never decides a result: without it, everything is computed again.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
import errno
import hashlib
from itertools import takewhile
import logging
import os
from pathlib import Path
import re
import stat
import sys
import time

VARIABLE = 'PFD_CACHE'
LIMIT = 512 * 2**20
# Eviction removes files until this size is reached, so that it is not needed again at once.
TRIMMED = LIMIT * 3 // 4
# A process measures the folder again after it has written so many bytes.
SLICE = LIMIT // 16
# Bytes of the largest result that is written.
LARGEST = LIMIT // 8
# A write is tried so often while other processes remove the folder.
ATTEMPTS = 10
HEAD = b'pfd_ros cache 2\n'
CHECKSUM = hashlib.sha256().digest_size
SUFFIX = '.pfd'
UNFINISHED = 'unfinished-'
# Names of files that the cache wrote itself; no other file is ever removed.
OWN = re.compile(rf'[0-9a-f]{{64}}{re.escape(SUFFIX)}|{UNFINISHED}.*{re.escape(SUFFIX)}')
# A FIFO, whose opening would block, and a link, which may lead anywhere, are not opened.
PLAIN = sum(getattr(os, name, 0) for name in ('O_NOFOLLOW', 'O_NONBLOCK', 'O_CLOEXEC', 'O_BINARY'))
READING = os.O_RDONLY | PLAIN
WRITING = os.O_WRONLY | os.O_CREAT | os.O_EXCL | PLAIN
# Largest difference between the clocks of a disk and of this machine; also the age at which
# an unfinished file must be a remainder of a killed process.
HOUR = 3600 * 10**9  # [ns]

LOG = logging.getLogger('pfd_core')
# Bytes that this process has written to each folder since it measured the folder.
_written: dict[Path, int] = {}
# The warning that was given about each folder.
_warned: dict[str, str] = {}


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
        home = base if base.is_absolute() else Path.home() / '.cache'
        return home.absolute() / 'pfd_ros'
    except (RuntimeError, OSError) as error:  # no home folder, or a deleted current folder
        named = 'the user has no home' if given is None else f'{VARIABLE} is {given!r}'
        _warn(
            named,
            f'compiled kernels are not kept, because {named} ({error}): set {VARIABLE} to a '
            'folder of your own, or to nothing',
        )
        return None


def digest(*parts: str) -> str:
    """Return the SHA-256 of some strings, separated from each other, in hexadecimal."""
    state = hashlib.sha256()
    for part in parts:
        data = part.encode()
        state.update(f'{len(data)}:'.encode())
        state.update(data)
    return state.hexdigest()


def read(name: str) -> bytes | None:
    """Return the bytes written under a name (64 hexadecimal digits), or None."""
    where = folder()
    if where is None:
        return None
    path = where / f'{name}{SUFFIX}'
    try:
        data = _contents(path) if _trusted(where) else None
    except FileNotFoundError:
        return None
    except OSError as error:
        LOG.info('%r cannot be read (%s)', str(path), error.strerror)
        return None
    if data is None:
        return None
    start = len(HEAD) + CHECKSUM
    payload = data[start:]
    if data[:start] != _head(name, payload):
        LOG.info('%r is damaged and is compiled again', str(path))
        return None
    return payload


def write(name: str, payload: bytes) -> None:
    """Write some bytes under a name; warn once if that is impossible."""
    where = folder()
    if where is None or len(payload) > LARGEST:
        return
    data = _head(name, payload) + payload
    for last in (*[False] * ATTEMPTS, True):
        try:
            _create(where)
            if _trusted(where):
                _write_whole(where / f'{name}{SUFFIX}', data)
                _evict(where, len(data))
            return
        except OSError as error:
            # Another process may remove the folder meanwhile, also between the `mkdir` that finds
            # it and the look at what it found.
            if last or not isinstance(error, (FileNotFoundError, FileExistsError)):
                _warn(
                    str(where),
                    f'compiled kernels cannot be kept in {str(where)!r} ({error.strerror}), so '
                    f'each process compiles its own: set {VARIABLE} to a folder that can be '
                    'written, or to nothing',
                )
                return


def _head(name: str, payload: bytes) -> bytes:
    """Return the head of a file: format, and checksum of name and payload."""
    return HEAD + hashlib.sha256(name.encode() + payload).digest()


def _create(where: Path) -> None:
    """Make a folder and those above it that are missing, for this user alone."""
    missing = list(takewhile(lambda path: not path.exists(), (where, *where.parents)))
    for path in reversed(missing):
        path.mkdir(mode=0o700, exist_ok=True)


def _contents(path: Path) -> bytes | None:
    """Return the contents of a file, or None if others could have written it."""
    handle = os.open(path, READING)
    try:
        state = os.fstat(handle)
        if not (stat.S_ISREG(state.st_mode) and _ours(state) and state.st_size <= 2 * LARGEST):
            LOG.info(
                '%r is not a file of the cache (user %d, mode %s, %d bytes): it is not used',
                *(str(path), state.st_uid, stat.filemode(state.st_mode), state.st_size),
            )
            return None
        with suppress(OSError):  # marks the file as recently used
            os.utime(handle if os.utime in os.supports_fd else path)
        with open(handle, 'rb', closefd=False) as file:
            return file.read(state.st_size)
    finally:
        os.close(handle)


def _write_whole(path: Path, data: bytes) -> None:
    """Write a file so that no process ever sees it half written."""
    unfinished = path.parent / f'{UNFINISHED}{os.urandom(8).hex()}{SUFFIX}'
    handle = os.open(unfinished, WRITING, 0o600)
    try:
        with os.fdopen(handle, 'wb') as file:
            file.write(data)
        os.replace(unfinished, path)
    except BaseException:
        with suppress(OSError):
            os.unlink(unfinished)
        raise


def _ours(state: os.stat_result) -> bool:
    """Return whether only the user and root can write a file or folder."""
    if sys.platform == 'win32':
        return True
    return state.st_uid in (0, os.geteuid()) and not state.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _trusted(where: Path) -> bool:
    """Return whether only the user and root can have put native code into a folder."""
    state = where.stat()
    if not stat.S_ISDIR(state.st_mode):
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(where))
    if _ours(state):
        return True
    _warn(
        str(where),
        f'the cache folder {str(where)!r} belongs to user {state.st_uid} and has mode '
        f'{stat.filemode(state.st_mode)}, so others could put code there: it is not used. Make it '
        f'your own and take group and others the right to write (chmod go-w), or set {VARIABLE} '
        'to a folder of your own, or to nothing',
    )
    return False


def _warn(about: str, text: str) -> None:
    """Log a warning about a folder or variable, once, also if several threads come at once."""
    if _warned.setdefault(about, text) is text:
        LOG.warning('%s', text)


def _evict(where: Path, added: int) -> None:
    """Remove the least recently used files, once a folder holds more than the limit."""
    written = _written.get(where)
    if written is not None and written + added <= SLICE:
        _written[where] = written + added
        return
    _written[where] = 0
    kept = []
    soon = time.time_ns() + HOUR
    for path, state in _own_files(where):
        # A time in the future comes from a wrong clock: it does not make a file young.
        young = state.st_mtime_ns <= soon
        if path.name.startswith(UNFINISHED) and (not young or state.st_mtime_ns < soon - 2 * HOUR):
            _remove(path)
        else:
            kept.append((young, state.st_mtime_ns, state.st_size, path))
    total = sum(size for _, _, size, _ in kept)
    if total > LIMIT:
        for _, _, size, path in sorted(kept):
            if total <= TRIMMED:
                break
            total -= size if _remove(path) else 0


def _own_files(where: Path) -> Iterator[tuple[Path, os.stat_result]]:
    """Yield the regular files that the cache wrote, with their state."""
    with suppress(OSError), os.scandir(where) as entries:
        for entry in entries:
            with suppress(OSError):  # another process may have removed it
                if OWN.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                    yield Path(entry.path), entry.stat(follow_symlinks=False)


def _remove(path: Path) -> bool:
    """Remove a file and return whether it is gone."""
    try:
        path.unlink(missing_ok=True)
    except OSError:
        return False
    return True
