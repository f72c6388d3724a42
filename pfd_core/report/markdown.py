# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Paragraphs, tables and errors as Markdown."""

from __future__ import annotations

import math
from textwrap import fill


def paragraph(text: str) -> str:
    """Return text in lines of a page's width, and an empty line."""
    return fill(text, 99, break_on_hyphens=False, break_long_words=False) + '\n'


def header(titles: str) -> list[str]:
    """Return the first two lines of a table; titles are separated by ' | '."""
    return [f'| {titles} |', '|---' * (titles.count('|') + 1) + '|']


def cells(*values: object) -> str:
    """Return a line of a table."""
    return '| ' + ' | '.join(map(str, values)) + ' |'


def order(error: float) -> str:
    """Return an error to one digit, 'lost' if it is not finite."""
    return f'{error:.0e}' if math.isfinite(error) else 'lost'
