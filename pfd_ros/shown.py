# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Foreign text on a terminal: one line, no control characters, not too long."""

from __future__ import annotations

import re

LIMIT = 600


def one_line(value: object, limit: int = LIMIT) -> str:
    """Return a text for one line of a terminal; what would move the cursor is escaped."""
    text = str(value)
    if len(text) > limit:
        text = f'{text[: 2 * limit // 3]}...{text[-limit // 3 :]}'
    line = re.sub(r'\s*[\r\n\t]\s*', ' ', text)
    return ''.join(c if c.isprintable() else repr(c)[1:-1] for c in line)
