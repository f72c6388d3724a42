# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
States at which forward dynamics is hard to compute, as two tables (CASES, MECHANISMS).

A case is a robot in a scene and seeded states, with the cause of its difficulty. Mechanisms have
unusual proportions. The tables are data/hard_cases.yaml and data/mechanisms.yaml.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from benchmarks.cases import problems
from benchmarks.cases.problems import Problem
from benchmarks.table import stored_table

# Units of rounding of the number formats.
ROUNDING = {'float64': 2.0**-53, 'float32': 2.0**-24}


@dataclass(frozen=True)
class Case:
    """A named problem: the cause of its difficulty, and a function that returns the problem."""

    name: str
    cause: str
    make: Callable[[], Problem]


def _stored(table: str) -> Iterator[Case]:
    for name, row in stored_table(table).items():
        maker, *given = row['make']
        make = partial(getattr(problems, maker), *given, **row.get('options', {}))
        yield Case(name, row['cause'], make)


CASES: Sequence[Case] = tuple(_stored('hard_cases'))
MECHANISMS: Sequence[Case] = tuple(_stored('mechanisms'))
