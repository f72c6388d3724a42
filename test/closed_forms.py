# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of the closed forms of step counts on n lanes, and chains to count on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from zoo import random_chain

import pfd_core as pfd
from pfd_core.paper.networks import by_section as counted

# Lengths around powers of two, where a level is added, and between.
LENGTHS = (*range(1, 10), 12, 15, 16, 17, 24, 31, 32)
# Short programs, and the longest after which a level is added. The others are slow.
SHORT = (*range(1, 10), 16, 17)
SIZES, EVERY_SIZE = (
    [pytest.param(n, marks=[] if n in SHORT else [pytest.mark.slow]) for n in lengths]
    for lengths in (LENGTHS, range(1, 33))
)


def chain(n: int, prismatic: bool = False) -> pfd.Robot:
    """Return a skew chain; with `prismatic`, the last joint slides."""
    types = ['revolute'] * n
    if prismatic:
        types[-1] = 'prismatic'
    return random_chain(np.random.default_rng(n), n, joint_types=types)


def levels(n: int) -> int:
    """Return ceil(log2 n), the number of levels of recursive doubling."""
    return math.ceil(math.log2(n))


def rounds(n: int) -> int:
    """Return the rounds that the nine elements of the recurrence's matrices take."""
    return sum(math.ceil(9 * (n - 2**k) / n) for k in range(levels(n)))


def elimination(n: int) -> int:
    """Return w + ceil(C/n), the fewest steps of an elimination with a right-hand side."""
    elements = [r * (r + 3) // 2 for r in range(1, n)]
    return sum(c < n for c in elements) + math.ceil(sum(c for c in elements if c >= n) / n)


Counts = tuple[int, int, int, int]


def by_section(program: pfd.Program) -> dict[str, Counts]:
    """Return the arithmetic of each section that has any."""
    counts = {section: arithmetic(steps) for section, steps in counted(program).items()}
    return {section: row for section, row in counts.items() if any(row)}


def routes_by_section(program: pfd.Program) -> dict[str, int]:
    """Return the routes of each section that has any."""
    found = counted(program).items()
    return {section: steps.routes for section, steps in found if steps.routes}


def arithmetic(steps: pfd.Steps) -> Counts:
    return steps.multiplications, steps.additions, steps.divisions, steps.square_roots
