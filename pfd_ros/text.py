# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Foreign text made fit to be shown: cut, on one line, and never a format string."""

from __future__ import annotations

from collections.abc import Collection
from itertools import islice

NAME_LENGTH = 64
NAME_COUNT = 8
LINE_LENGTH = 500


def cut(text: str, length: int = NAME_LENGTH) -> str:
    """Return at most `length` characters of a text, and how long it is if that is not all."""
    return text if len(text) <= length else f'{text[:length]}... ({len(text)} characters)'


def one_line(text: object) -> str:
    """Return the text of an error or a foreign text on one line, cut."""
    # Slices first: a text may have a million lines.
    whole = str(text)
    line = ' '.join(''.join(c if c.isprintable() else ' ' for c in whole[:LINE_LENGTH]).split())
    return line if len(whole) <= LINE_LENGTH else f'{line}... ({len(whole)} characters)'


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
