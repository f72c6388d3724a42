# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
States at which forward dynamics is hard to compute, as two tables (CASES, MECHANISMS).

A case is a robot in a scene and seeded states, with the cause of its difficulty and bounds of the
relative error of qdd. The bounds hold for the kernel of method 'auto' with one step of refinement.
They were set before this table was measured, except for static_hold; a case that misses its
bound is reported as missed. Mechanisms have no bounds: they are compared with a peer
(pfd_core.report.mechanism_pages).

The tables are data/hard_cases.yaml and data/mechanisms.yaml.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from pfd_core.report.cases import problems
from pfd_core.report.cases.problems import Problem
from pfd_core.report.cases.robots import Array
from pfd_core.report.cases.stored import table

ROUNDING = {'float64': 2.0**-53, 'float32': 2.0**-24}


@dataclass(frozen=True)
class Bound:
    """
    A bound of the relative error: value, times u, or times u and kappa_s of the state.

    Attributes
    ----------
    value : float
        The factor.
    unit : {'', 'u', 'kappa_s u'}
        u is the unit of rounding of the number format, ROUNDING.

    """

    value: float
    unit: str = ''

    def at(self, dtype: str, kappa_s: Array) -> Array:
        """Return the bound for states whose structured condition numbers are kappa_s, (S,)."""
        scale = ROUNDING[dtype] if self.unit else 1.0
        return self.value * scale * (kappa_s if 'kappa_s' in self.unit else np.ones_like(kappa_s))

    def __str__(self) -> str:
        return f'{self.value:g} {self.unit}'.strip()


# The rule for every case: at most 100 kappa_s u after a step of refinement.
LAW = Bound(100, 'kappa_s u')


@dataclass(frozen=True)
class Case:
    """
    A named problem.

    Attributes
    ----------
    name, cause : str
        Name, and the reason why the problem is hard.
    make : callable
        Makes the problem.
    float64, float32 : Bound
        Bounds of the kernel's error with one step of refinement.
    plain : Bound, optional
        Bound in float64 without refinement.
    wide : bool
        Whether the float32 bound was set for residuals in float64, which no kernel here has.
    fast : bool
        Whether the case takes less than about a second.

    """

    name: str
    cause: str
    make: Callable[[], Problem]
    float64: Bound = LAW
    float32: Bound | None = None
    plain: Bound | None = None
    wide: bool = False
    fast: bool = False

    def bound(self, dtype: str, refine: int) -> Bound | None:
        """Return the bound of the kernel in a number format, where there is one."""
        if refine == 0:
            return self.plain if dtype == 'float64' else None
        return self.float64 if dtype == 'float64' else self.float32


def _cases(name: str) -> Iterator[Case]:
    for case, row in table(name).items():
        maker, *given = row.pop('make')
        make = partial(getattr(problems, maker), *given, **row.pop('options', {}))
        unknown = sorted(row.keys() - READ.keys())
        if unknown:
            raise ValueError(f'case {case} of {name} has unknown keys {unknown}')
        read = {key: READ[key](value) for key, value in row.items()}
        yield Case(case, make=make, **read)


def _bound(text: object) -> Bound:
    value, _, unit = str(text).partition(' ')
    return Bound(float(value), unit)


def _switch(value: object) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f'a switch is {value!r}, expected true or false')
    return value


READ: dict[str, Callable[[Any], Any]] = {
    'cause': str,
    **dict.fromkeys(('float64', 'float32', 'plain'), _bound),
    **dict.fromkeys(('wide', 'fast'), _switch),
}
CASES: Sequence[Case] = tuple(_cases('hard_cases'))
MECHANISMS: Sequence[Case] = tuple(_cases('mechanisms'))

# Cases of other lists that are not in the report, by the reason.
LATER = {
    'inputs, repeated runs and iterations of pcgm (see the tests)': (
        'bad_inputs',
        'determinism',
        'cg_baseline',
    ),
    'arms not included in config/robots': ('seven of the eleven ordinary arms',),
}
