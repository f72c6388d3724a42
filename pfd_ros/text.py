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
    """Return the first `length` characters of a text; a longer text is followed by its length."""
    return text if len(text) <= length else f'{text[:length]}... ({len(text)} characters)'


def one_line(value: object, limit: int = LINE_LENGTH) -> str:
    """Return a text on one line, with its middle cut and control characters escaped."""
    text = str(value)
    if len(text) > limit:
        text = f'{text[: 2 * limit // 3]}... ({len(text)} characters) ...{text[-limit // 3 :]}'
    line = re.sub(r'\s*[\r\n\t]\s*', ' ', text)
    return ''.join(c if c.isprintable() else repr(c)[1:-1] for c in line)


def listed(names: Collection[str]) -> str:
    """Return the text of a list of names: the first few, each cut."""
    shown = [repr(cut(name)) for name in islice(names, NAME_COUNT)]
    more = len(names) - len(shown)
    return f'[{", ".join(shown)}{f", and {more} more" if more > 0 else ""}]'
