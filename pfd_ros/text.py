# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Foreign text made fit to be shown: cut, on one line, and never a format string."""

from __future__ import annotations

from collections.abc import Collection
from itertools import islice
import re

NAME_LENGTH = 64
NAME_COUNT = 8
LINE_LENGTH = 500


def cut(text: str, length: int = NAME_LENGTH) -> str:
    """Return at most `length` characters of a text, and how long it is if that is not all."""
    return text if len(text) <= length else f'{text[:length]}... ({len(text)} characters)'


def one_line(value: object, limit: int = LINE_LENGTH) -> str:
    """Return a text for one line; its middle is cut, and control characters are escaped."""
    text = str(value)
    if len(text) > limit:
        text = f'{text[: 2 * limit // 3]}... ({len(text)} characters) ...{text[-limit // 3 :]}'
    line = re.sub(r'\s*[\r\n\t]\s*', ' ', text)
    return ''.join(c if c.isprintable() else repr(c)[1:-1] for c in line)


def listed(names: Collection[str], total: int | None = None) -> str:
    """Return a list of names as one shows it: the first few, each cut.

    Parameters
    ----------
    names
        The names.
    total
        How many there are, if `names` holds only some of them.
    """
    shown = [repr(cut(name)) for name in islice(names, NAME_COUNT)]
    more = (len(names) if total is None else total) - len(shown)
    return f'[{", ".join(shown)}{f", and {more} more" if more > 0 else ""}]'
