# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""New files, never over existing ones."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


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
