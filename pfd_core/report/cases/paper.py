# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Lee and Chang (1987): claims of Table 1, sums of the parts, contradictions, index of equations.

Each claim is a formula in n with L = ceil(log2 n), h = ceil((n-1)/2), P6 = ceil((n^2-1)/6) and
P2 = ceil((n^2-1)/2), as printed, with the value printed for n = 6. `parts` is the sum of the
counts that the paper derives for the parts of the method: items (a) to (f) of section 2.5 for
PCRBM, (d) and (e) of section 3 for PCGM. The serial methods and the array have no `parts`.

The available copy is a scan. Of the multiplications of PCRBM in Table 1 it shows P6, 10 h and 4 n;
31 L + 170 is from the formula of section 2.5, which prints 2 n instead of 4 n.

The claims are stored in data/paper.yaml, the counts of parts in data/paper_parts.yaml.

EQUATIONS and PROCEDURES, stored in data/equations.yaml, are an index: where each equation and
procedure is implemented, and what tests it. A test checks that every equation of the paper is in
the index, that the functions and tests exist, that the function's module cites the equation, and
that the test's file uses this module or a method that contains it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
import re

from pfd_core.report.cases.stored import table


@dataclass(frozen=True)
class Claim:
    """
    The paper's count of one kind of operation in one system.

    Attributes
    ----------
    text : str
        The formula as printed.
    formula : callable
        Its value at n.
    printed : int or None
        The value printed for n = 6.
    parts : callable or None
        Sum of the parts that the paper counts.
    remark : str
        Contradictions in the paper, or omissions of a comparison; or empty.

    """

    text: str
    formula: Callable[[int], Fraction]
    printed: int | None
    parts: Callable[[int], Fraction] | None = None
    remark: str = ''


@dataclass(frozen=True)
class System:
    """A row of Table 1: its title, its claims by kind of operation, and its processors."""

    title: str
    multiplications: Claim
    additions: Claim
    square_roots: Claim
    processors: str


@dataclass(frozen=True)
class Part:
    """
    A part of a system of the paper, with the sections of the recorded procedure that it is.

    Attributes
    ----------
    system : str
        Name in TABLE.
    item : str
        Item of section 2.5 or section 3, or the item or total that contains it.
    text : str
        What it is.
    derived : bool
        Whether the paper gives its count; otherwise the count is decomposed from the total.
    sections : tuple of str
        Sections of the recorded procedure, as printed and corrected.
    multiplications, additions : str
        Formulas.
    remark : str
        Why the count differs; or empty.

    """

    system: str
    item: str
    text: str
    derived: bool
    sections: tuple[str, ...]
    multiplications: str
    additions: str
    remark: str = ''


def levels(n: int) -> int:
    """Return ceil(log2 n)."""
    return (n - 1).bit_length()


SYMBOLS: dict[str, Callable[[int], Fraction | int]] = {
    '': lambda n: 1,
    'n': lambda n: n,
    'n^2': lambda n: n**2,
    'n^3/6': lambda n: Fraction(n**3, 6),
    'h': lambda n: n // 2,
    'L': levels,
    'n L': lambda n: n * levels(n),
    'P6': lambda n: -((1 - n * n) // 6),
    'P2': lambda n: -((1 - n * n) // 2),
}
# Sign, number, which may be mixed as 75 1/2, and symbol of a term.
TERM = re.compile(r'([+-]?) ?((?:\d+(?: \d+/\d+)?)?) ?((?:[nhLP][\w^/]*(?: L)?)?)(?: |$)')


def value(text: str, n: int) -> Fraction:
    """Return the value of a printed formula at n."""
    total = Fraction(0)
    for sign, number, symbol in TERM.findall(text):
        if number or symbol:
            factor = sum(map(Fraction, number.split())) if number else 1
            total += (-1 if sign == '-' else 1) * factor * SYMBOLS[symbol](n)
    return total


def _claim(formula: str, printed: int, parts: str | None = None, remark: str = '') -> Claim:
    summed = None if parts is None else partial(value, parts)
    return Claim(formula, partial(value, formula), printed, summed, remark)


KINDS = ('multiplications', 'additions', 'square_roots')
TABLE = {
    name: System(
        row['title'],
        _claim(**row['multiplications']),
        _claim(**row['additions']),
        _claim(**row['square_roots']),
        row['processors'],
    )
    for name, row in table('paper').items()
}
PARTS = tuple(
    Part(system=system, **{**row, 'sections': tuple(row['sections'])})
    for system, rows in table('paper_parts').items()
    for row in rows
)


@dataclass(frozen=True)
class Implemented:
    """
    An equation or procedure of the paper.

    Attributes
    ----------
    names : tuple of str
        Numbers of equations, without brackets, or the name of a procedure.
    text : str
        What it computes.
    function : str
        module:function.
    test : str
        File and function of the test.

    """

    names: tuple[str, ...]
    text: str
    function: str
    test: str


def _index(kind: str) -> tuple[Implemented, ...]:
    rows = table('equations')[kind]
    return tuple(Implemented(**row | {'names': tuple(row['names'])}) for row in rows)


EQUATIONS, PROCEDURES = _index('equations'), _index('procedures')
