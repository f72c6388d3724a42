# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Paragraphs, tables and errors as Markdown, and the data of a page as JSON."""

from __future__ import annotations

import json
import math
from textwrap import fill
from typing import Any


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


def json_text(data: Any) -> str:
    """Return data as JSON; null for infinities and NaN, which JSON does not have."""

    def finite(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: finite(item) for key, item in value.items()}
        if isinstance(value, (list, tuple)):
            return [finite(item) for item in value]
        return None if isinstance(value, float) and not math.isfinite(value) else value

    return json.dumps(finite(data), indent=1) + '\n'
