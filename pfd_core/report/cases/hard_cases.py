# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
States at which forward dynamics is hard to compute, as two tables (CASES, MECHANISMS).

A case is a robot in a scene and seeded states, with the cause of its difficulty. The bounds of all
cases follow from one formula (pfd_core.report.measure.predictions). Mechanisms are compared with a
peer (pfd_core.report.mechanism_pages).

The tables are data/hard_cases.yaml and data/mechanisms.yaml.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from pfd_core.report.cases import problems
from pfd_core.report.cases.problems import Problem
from pfd_core.report.cases.stored import table

ROUNDING = {'float64': 2.0**-53, 'float32': 2.0**-24}


@dataclass(frozen=True)
class Case:
    """
    A named problem.

    Attributes
    ----------
    name, cause : str
        Name, and the reason why the problem is hard.
    make : callable
        Returns the problem.
    fast : bool
        Whether the case takes less than about a second.

    """

    name: str
    cause: str
    make: Callable[[], Problem]
    fast: bool = False


def _cases(name: str) -> Iterator[Case]:
    for case, row in table(name).items():
        maker, *given = row.pop('make')
        make = partial(getattr(problems, maker), *given, **row.pop('options', {}))
        unknown = sorted(row.keys() - READ.keys())
        if unknown:
            raise ValueError(f'case {case} of {name} has unknown keys {unknown}')
        read = {key: READ[key](value) for key, value in row.items()}
        yield Case(case, make=make, **read)


def _switch(value: object) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f'a switch is {value!r}, expected true or false')
    return value


READ: dict[str, Callable[[Any], Any]] = {'cause': str, 'fast': _switch}
CASES: Sequence[Case] = tuple(_cases('hard_cases'))
# Of quick runs: three joints.
QUICK = tuple(case for case in CASES if case.name == 'collinear_axes_1e-12')
MECHANISMS: Sequence[Case] = tuple(_cases('mechanisms'))

# Cases of other lists that are not in the report, by the reason.
LATER = {
    'inputs, repeated runs and iterations of pcgm (see the tests)': (
        'bad_inputs',
        'determinism',
        'cg_baseline',
    ),
}
