# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
What Lee and Chang (1987) claim: Table 1, the sums of their own parts, and what contradicts them.

Each claim is a formula in n with L = ceil(log2 n), h = ceil((n-1)/2), P6 = ceil((n^2-1)/6) and
P2 = ceil((n^2-1)/2), as printed, with the value printed for n = 6. `parts` is the sum of the
counts that the text derives for the parts of the method, where it derives them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

Formula = Callable[[int], Fraction]


def levels(n: int) -> int:
    """Return ceil(log2 n)."""
    return (n - 1).bit_length()


@dataclass(frozen=True)
class Claim:
    """
    What the paper says of one kind of operation in one system.

    Attributes
    ----------
    text : str
        The formula as printed.
    formula : callable
        Its value at n.
    printed : int or None
        The value printed for n = 6.
    parts : callable or None
        Sum of the parts that the text counts.
    doubt : str
        Why the claim cannot be right as it stands; empty if nothing speaks against it.

    """

    text: str
    formula: Formula
    printed: int | None
    parts: Formula | None = None
    doubt: str = ''


@dataclass(frozen=True)
class System:
    """A row of Table 1: its title, its claims by kind of operation, and its processors."""

    title: str
    multiplications: Claim
    additions: Claim
    square_roots: Claim
    processors: str


def _p(n: int, divisor: int) -> int:
    return -((1 - n * n) // divisor)


def _h(n: int) -> int:
    return n // 2


def _polynomial(cubic: object, square: object, linear: object, constant: int) -> Formula:
    a, b, c = (Fraction(str(x)) for x in (cubic, square, linear))
    return lambda n: a * n**3 + b * n**2 + c * n + constant


def _mixed(
    n_terms: int = 0,
    h: int = 0,
    L: int = 0,
    nL: int = 0,
    P6: int = 0,
    P2: int = 0,
    constant: int = 0,
) -> Formula:
    return lambda n: Fraction(
        n_terms * n
        + h * _h(n)
        + L * levels(n)
        + nL * n * levels(n)
        + P6 * _p(n, 6)
        + P2 * _p(n, 2)
        + constant
    )


def _none(printed: int = 0, doubt: str = '') -> Claim:
    return Claim(str(printed), lambda n: Fraction(printed), printed, None, doubt)


ONE_ROOT = (
    "one root cannot yield L of H = L L': column i needs column i - 1 first, so n roots follow "
    'one another; no root at all is needed for a solve'
)

# The parts of methods 1 to 3: the bias (137n-22, 101n-11), the solution of the linear system, and
# n calls of the Newton-Euler method without velocity and gravity for H, or their shorter forms.
TABLE = {
    'walker_orin_1': System(
        "Walker and Orin's method 1",
        Claim(
            'n^3/6 + 75 1/2 n^2 + 114 1/2 n - 22',
            _polynomial('1/6', '151/2', '229/2', -22),
            3418,
            _polynomial('1/6', '151/2', '343/3', -22),
            'the formula gives 3419 at n = 6; with 114 1/3, the sum of the parts, it gives the '
            'printed 3418 and whole numbers for every n',
        ),
        Claim(
            'n^3/6 + 55 n^2 + 82 5/6 n - 11',
            _polynomial('1/6', 55, '497/6', -11),
            2502,
            _polynomial('1/6', 55, '497/6', -11),
        ),
        _none(),
        '1',
    ),
    'walker_orin_2': System(
        "Walker and Orin's method 2",
        Claim(
            'n^3/6 + 38 1/2 n^2 + 151 1/2 n - 22',
            _polynomial('1/6', '77/2', '303/2', -22),
            2308,
            _polynomial('1/6', '77/2', '454/3', -22),
            'the formula gives 2309 at n = 6; with 151 1/3 it gives the printed 2308',
        ),
        Claim(
            'n^3/6 + 28 n^2 + 109 5/6 n - 11',
            _polynomial('1/6', 28, '659/6', -11),
            1692,
            _polynomial('1/6', 28, '659/6', -11),
        ),
        _none(),
        '1',
    ),
    'walker_orin_3': System(
        "Walker and Orin's method 3",
        Claim(
            'n^3/6 + 13 1/2 n^2 + 192 1/3 n - 49',
            _polynomial('1/6', '27/2', '577/3', -49),
            1627,
            _polynomial('1/6', '27/2', '577/3', -49),
        ),
        Claim(
            'n^3/6 + 8 n^2 + 165 5/6 n - 64',
            _polynomial('1/6', 8, '995/6', -64),
            1255,
            _polynomial('1/6', 8, '995/6', -64),
        ),
        _none(),
        '1',
    ),
    'walker_orin_4': System(
        "Walker and Orin's method 4",
        Claim(
            '76 1/2 n^2 + 12 n - 21',
            _polynomial(0, '153/2', 12, -21),
            3435,
            None,
            'the formula gives 2805 at n = 6; 117 n in place of 12 n gives the printed 3435',
        ),
        Claim('56 n^2 + 87 n - 6', _polynomial(0, 56, 87, -6), 2532),
        _none(),
        '1',
    ),
    'articulated_body': System(
        "Featherstone's articulated-body method",
        Claim(
            '380 n - 198',
            _polynomial(0, 0, 380, -198),
            2280,
            None,
            'the formula gives 2082 at n = 6, printed is 380 * 6, and the introduction has 2250',
        ),
        Claim(
            '302 n - 173',
            _polynomial(0, 0, 302, -173),
            1816,
            None,
            'the formula gives 1639 at n = 6, and 302 * 6 is 1812',
        ),
        _none(),
        '1',
    ),
    'pcrbm': System(
        'Parallel composite rigid bodies',
        Claim(
            'P6 + 4 n + 10 h + 31 L + 170',
            _mixed(n_terms=4, h=10, L=31, P6=1, constant=170),
            334,
            _mixed(n_terms=4, h=10, L=31, P6=1, constant=110),
            'the formula gives 323 at n = 6, that of section 2.5 gives 311, its parts sum to 263',
        ),
        Claim(
            'P2 + 5 n + 5 h + 45 L + 125',
            _mixed(n_terms=5, h=5, L=45, P2=1, constant=125),
            328,
            _mixed(n_terms=8, h=5, L=46, P2=1, constant=86),
            'the formula gives 323 at n = 6, its parts sum to 305',
        ),
        _none(1, ONE_ROOT),
        'n',
    ),
    'pcrbm_array': System(
        'Parallel composite rigid bodies with the triangular array',
        Claim(
            '7 n + 9 h + 31 L + 169',
            _mixed(n_terms=7, h=9, L=31, constant=169),
            331,
            _mixed(n_terms=7, h=9, L=31, constant=109),
            'the array of equations (29) to (31) takes 3n - 1 cycles and yields another matrix; '
            'the parts sum to 271 at n = 6',
        ),
        Claim(
            '8 n + 5 h + 45 L + 124',
            _mixed(n_terms=8, h=5, L=45, constant=124),
            322,
            _mixed(n_terms=11, h=5, L=46, constant=85),
            'the parts sum to 304 at n = 6',
        ),
        _none(1, ONE_ROOT),
        'n and n(n+1)/2 cells',
    ),
    'pcgm': System(
        'Parallel conjugate gradients',
        Claim(
            '49 n + 27 L + 124',
            _mixed(n_terms=49, L=27, constant=124),
            499,
            None,
            'n iterations do not suffice in floating point beyond n = 6',
        ),
        Claim(
            '14 n L + 30 n + 34 L + 87',
            _mixed(n_terms=30, L=34, nL=14, constant=87),
            621,
            None,
            'n iterations do not suffice in floating point beyond n = 6',
        ),
        _none(),
        'n',
    ),
}
