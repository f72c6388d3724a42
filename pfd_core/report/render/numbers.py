# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Times and errors as the cells of tables."""

from __future__ import annotations

from collections.abc import Iterable
import math
from typing import Any


def order(error: float | None) -> str:
    """Return an error to one digit, 'lost' if it is None or not finite."""
    return 'lost' if error is None or not math.isfinite(error) else f'{error:.0e}'


def short(value: float) -> str:
    """Return a number with three digits, or all digits before the point; large ones as powers."""
    if value >= 1e6:
        return f'{value:.0e}'
    return f'{value:.0f}' if value >= 99.5 else f'{value:.3g}'


def percent(part: float) -> str:
    """Return a part in percent, with two digits below ten."""
    return f'{100 * part:.2g} %' if part < 0.1 else f'{part:.0%}'.replace('%', ' %')


def least_and_median(times: Any, unit: float = 1e9) -> str:
    """Return minimum / median of a record with these fields, seconds times a unit."""
    return f'{short(times.minimum * unit)} / {short(times.median * unit)}'


def yes(value: bool | None) -> str:
    """Return 'yes' or 'no', '-' for None."""
    return '-' if value is None else ('yes' if value else 'no')


def listed(names: Iterable[str]) -> str:
    """Return names with commas."""
    return ', '.join(names) or 'nothing'
