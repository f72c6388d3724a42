# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""New files, never over existing ones; a recording ends after a complete flush on any disk."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import errno
import os
from pathlib import Path
from typing import Any

# Longest part of a path in a message.
_SHOWN = 200


# End of the error about a file that another program has changed.
CURE = 'while it was written; keep log rotation and other programs away from recordings'


@contextmanager
def new_file(path: Path, mode: str = 'xb', **options: Any) -> Iterator[Any]:
    """Open a new file, and remove it if the block fails.

    Raises
    ------
    OSError
        If it exists or cannot be written.
    """
    with path.open(mode, **options) as stream:
        try:
            yield stream
        except BaseException:
            path.unlink()
            raise


class FileLostError(OSError):
    """Another program has removed, moved, replaced, truncated or changed the file."""


class Sink:
    """A new file, written in whole flushes.

    Nothing reaches the disk between flushes. A failed flush is removed, so that all flushes before
    it stay readable. An existing file is never overwritten, and bytes are only appended: what is
    left of a file that another program truncates stays readable.

    Raises
    ------
    FileExistsError
        If the file exists; a folder, a FIFO, a device and a dangling link exist too.
    OSError
        If it cannot be created.
    ValueError
        If the name is not valid.
    """

    def __init__(self, path: Path) -> None:
        self._waiting = bytearray()
        self._written = 0
        self._name = _shown(path)
        # With O_APPEND a truncation stays visible in the size; an offset would leave a hole.
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_EXCL | getattr(os, 'O_CLOEXEC', 0)
        try:
            # The process may change its folder.
            self._path = os.path.abspath(path)
            self._file = os.open(self._path, flags, 0o644)
        except FileExistsError as error:
            raise FileExistsError(
                f'{self._name} exists and is not overwritten; choose another name'
            ) from error
        except OSError as error:
            raise self._refusal(error) from error
        except ValueError as error:
            raise ValueError(f'{self._name} is not a valid file name: {error}') from error

    def write(self, data: bytes) -> int:
        """Append bytes to the next flush."""
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        """Return the size of the file after the next flush."""
        return self._written + len(self._waiting)

    def flush(self) -> None:
        """Write everything to the operating system, or nothing.

        Raises
        ------
        FileLostError
            If another program has changed the size of the file.
        OSError
            If the system refuses.
        """
        self._check_size()
        data, self._waiting = self._waiting, bytearray()
        done = 0
        try:
            with memoryview(data) as view:
                while done < len(view):
                    count = os.write(self._file, view[done:])
                    if count == 0:
                        raise OSError(errno.EIO, 'no bytes written')
                    done += count
        except BaseException as error:
            # If this fails too, the file has an incomplete end, which readers ignore.
            with suppress(OSError):
                if os.fstat(self._file).st_size > self._written:
                    os.ftruncate(self._file, self._written)
            if isinstance(error, OSError):
                raise self._refusal(error) from error
            raise
        self._written += done

    def sync(self) -> None:
        """Sync all flushed bytes to the disk, so that a power cut does not lose them.

        Raises
        ------
        FileLostError
            If another program has removed, moved, replaced, truncated or changed the file.
        OSError
            If the disk refuses.
        """
        self._check_size()
        try:
            getattr(os, 'fdatasync', os.fsync)(self._file)
            gone = self._loss()
        except OSError as error:
            raise self._refusal(error) from error
        if gone:
            raise FileLostError(f'{self._name} was {gone} {CURE}')

    def _check_size(self) -> None:
        """Raise FileLostError if the file does not have the bytes that were written to it."""
        try:
            size = os.fstat(self._file).st_size
        except OSError as error:
            raise self._refusal(error) from error
        if size != self._written:
            how = 'truncated' if size < self._written else 'changed'
            raise FileLostError(
                f'{self._name} was {how} from {self._written} to {size} bytes {CURE}'
            )

    def close(self) -> None:
        """Close the file; bytes that were not flushed are lost."""
        file, self._file = self._file, -1
        if file < 0:
            return
        try:
            os.close(file)
        except OSError as error:
            raise self._refusal(error) from error

    def discard(self) -> None:
        """Close and remove the file."""
        with suppress(OSError):
            if not self._loss():
                os.unlink(self._path)
        with suppress(OSError):
            self.close()

    def _loss(self) -> str:
        """Return how the file lost its name, or ''."""
        own = os.fstat(self._file)
        if own.st_nlink == 0:
            return 'removed'
        try:
            found = os.stat(self._path)
        except (FileNotFoundError, NotADirectoryError):
            return 'moved'
        except PermissionError:
            return ''  # the folder is not readable any more
        return '' if os.path.samestat(own, found) else 'replaced'

    def _refusal(self, error: OSError) -> OSError:
        return OSError(f'{self._name} cannot be written: {error.strerror or error}')


def _shown(path: Path) -> str:
    """Return a path shortened to one line."""
    text = str(path)
    text = text if text.isprintable() else repr(text)
    return text if len(text) <= _SHOWN else f'...{text[-_SHOWN:]}'
