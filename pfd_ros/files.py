# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""New files, never over existing ones; those with a default name are numbered."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import errno
import os
from pathlib import Path
from typing import Any

# Numbers to try.
MOST = 10_000


def existing(path: Path | str) -> FileExistsError:
    """Return the error about a file that is there."""
    hint = 'the file exists and is not overwritten; choose another name'
    return FileExistsError(errno.EEXIST, hint, str(path))


def free_path(path: Path) -> Path:
    """Return a path, or the first of NAME_2, NAME_3 and so on that does not exist."""
    for number in range(1, MOST):
        found = path if number == 1 else path.with_name(f'{path.stem}_{number}{path.suffix}')
        if not os.path.lexists(found):
            return found
    raise existing(path)


@contextmanager
def new_file(path: Path, mode: str = 'xb', **options: Any) -> Iterator[Any]:
    """Open a new file, and remove it if the block fails.

    Raises
    ------
    OSError
        If it exists or cannot be written.
    """
    # Names of files need not be Unicode.
    stream = path.open(mode, errors=None if 'b' in mode else 'backslashreplace', **options)
    try:
        with stream:  # closing writes, too
            yield stream
    except BaseException as error:
        path.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename is None and error.strerror:
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
