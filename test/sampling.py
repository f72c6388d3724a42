# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of one fact: one in every run, the others as `slow` as a sweep."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def one_fast(values: Iterable[Any], fast: Any = None) -> list[Any]:
    """
    Return parameters of which one is in the fast suite and the others are `slow`.

    Parameters
    ----------
    values
        The parameters, in the order of the tests; a tuple has the values of several arguments.
    fast
        The fast one; by default the first.
    """
    every = list(values)
    chosen = 0 if fast is None else every.index(fast)
    return [
        value if place == chosen else pytest.param(*_arguments(value), marks=pytest.mark.slow)
        for place, value in enumerate(every)
    ]


def _arguments(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)
