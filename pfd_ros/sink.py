# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A file that ends after a whole flush, even when the disk is full."""

from __future__ import annotations

import os
from pathlib import Path


class Sink:
    """A new file, written in whole flushes.

    Nothing reaches the disk between flushes; a flush that fails is taken back, so that what
    was written before stays readable. Never writes over a file.

    Raises
    ------
    FileExistsError
        If the file exists.
    OSError
        If it cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self._waiting = bytearray()
        self._written = 0
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, 'O_CLOEXEC', 0)
        try:
            self._file = os.open(path, flags, 0o644)
        except FileExistsError as error:
            raise FileExistsError(
                f'{path} exists and is never written over; name another'
            ) from error
        except OSError as error:
            raise OSError(f'{path} cannot be written: {error.strerror}') from error

    def write(self, data: bytes) -> int:
        """Take bytes for the next flush."""
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        """Return how many bytes the file will hold after the next flush."""
        return self._written + len(self._waiting)

    def flush(self) -> None:
        """Hand everything to the operating system, or nothing; OSError if it refuses."""
        view = memoryview(self._waiting)
        done = 0
        try:
            while done < len(view):
                done += os.write(self._file, view[done:])
        except OSError:
            os.ftruncate(self._file, self._written)
            raise
        self._written += done
        self._waiting = bytearray()

    def sync(self) -> None:
        """Have the disk hold what was flushed; a kill needs no such thing, a power cut does."""
        getattr(os, 'fdatasync', os.fsync)(self._file)

    def close(self) -> None:
        """Close the file; what was not flushed is gone."""
        os.close(self._file)
