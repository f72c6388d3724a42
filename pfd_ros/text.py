# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Texts from outside shortened and printable on one line; known names for misspelt ones."""

from __future__ import annotations

from collections.abc import Collection
from difflib import get_close_matches
from itertools import islice
import re

NAME_LENGTH = 64
NAME_COUNT = 8
LINE_LENGTH = 500
# Of names that are taken for a misspelling of each other, of 1; 'scene' is 0.62 like 'nonsense'.
ALIKE = 0.7


def cut(text: str, length: int = NAME_LENGTH) -> str:
    """Return the first `length` characters of a text, with its length if it is longer."""
    return text if len(text) <= length else f'{text[:length]}... ({len(text)} characters)'


def one_line(value: object, limit: int = LINE_LENGTH) -> str:
    """Return a text on one line, shortened in the middle, with control characters escaped."""
    text = str(value)
    if len(text) > limit:
        text = f'{text[: 2 * limit // 3]}... ({len(text)} characters) ...{text[-limit // 3 :]}'
    line = re.sub(r'\s*[\r\n\t]\s*', ' ', text)
    return ''.join(c if c.isprintable() else repr(c)[1:-1] for c in line)


def listed(names: Collection[str]) -> str:
    """Return a list of names for a message: the first few, each shortened."""
    shown = [repr(cut(name)) for name in islice(names, NAME_COUNT)]
    more = len(names) - len(shown)
    return f'[{", ".join(shown)}{f", and {more} more" if more > 0 else ""}]'


def similar(name: str, known: Collection[str]) -> list[str]:
    """Return the known name that a misspelt one resembles most, or nothing."""
    return get_close_matches(cut(name), known, n=1, cutoff=ALIKE)


def did_you_mean(name: str, known: Collection[str], otherwise: str) -> str:
    """Return the question about the known name that a misspelt one resembles, or another hint."""
    near = similar(name, known)
    return f'did you mean {near[0]!r}?' if near else otherwise
