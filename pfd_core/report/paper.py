# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Claims of Lee and Chang (1987): Table 1, the sums of their own parts, and contradictions.

Each claim is a formula in n with L = ceil(log2 n), h = ceil((n-1)/2), P6 = ceil((n^2-1)/6) and
P2 = ceil((n^2-1)/2), as printed, with the value printed for n = 6. `parts` is the sum of the
counts that the paper derives for the parts of the method: items (a) to (f) of section 2.5 for
PCRBM, (d) and (e) of section 3 for PCGM. The serial methods and the array have no `parts`.

The available copy is a scan. Of the multiplications of PCRBM in Table 1 it shows P6, 10 h and 4 n;
31 L + 170 is from the formula of section 2.5, which prints 2 n instead of 4 n.
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
    formula: Formula
    printed: int | None
    parts: Formula | None = None
    remark: str = ''


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


def _roots(count: int = 0, parts: Formula | None = None, remark: str = '') -> Claim:
    return Claim(str(count), lambda n: Fraction(count), count, parts, remark)


ONE_ROOT = (
    "one root is enough for L of H = L L' through L D L' (one_square_root in "
    'pfd_core.algorithms.paper.cholesky); (11) and (12) as printed take all roots in one step and '
    "give a wrong matrix; a solve by L D L', which is counted here, needs none"
)
ROOTS_OF_THE_ARRAY = (
    'each of the n circular cells takes one root, in n different cycles, also in the design as '
    'printed (literal_array); 1 is the count of a cell'
)

TABLE = {
    'walker_orin_1': System(
        "Walker and Orin's method 1",
        Claim(
            'n^3/6 + 75 1/2 n^2 + 114 1/2 n - 22',
            _polynomial('1/6', '151/2', '229/2', -22),
            3418,
            None,
            'the formula gives 3419 at n = 6, and no whole number at n = 2; with 114 1/3 it gives '
            'the printed 3418 and whole numbers for every n',
        ),
        Claim(
            'n^3/6 + 55 n^2 + 82 5/6 n - 11',
            _polynomial('1/6', 55, '497/6', -11),
            2502,
        ),
        _roots(),
        '1',
    ),
    'walker_orin_2': System(
        "Walker and Orin's method 2",
        Claim(
            'n^3/6 + 38 1/2 n^2 + 151 1/2 n - 22',
            _polynomial('1/6', '77/2', '303/2', -22),
            2308,
            None,
            'the formula gives 2309 at n = 6; with 151 1/3 it gives the printed 2308 and whole '
            'numbers for every n',
        ),
        Claim(
            'n^3/6 + 28 n^2 + 109 5/6 n - 11',
            _polynomial('1/6', 28, '659/6', -11),
            1692,
        ),
        _roots(),
        '1',
    ),
    'walker_orin_3': System(
        "Walker and Orin's method 3",
        Claim(
            'n^3/6 + 13 1/2 n^2 + 192 1/3 n - 49',
            _polynomial('1/6', '27/2', '577/3', -49),
            1627,
            None,
            'the introduction prints 1629',
        ),
        Claim(
            'n^3/6 + 8 n^2 + 165 5/6 n - 64',
            _polynomial('1/6', 8, '995/6', -64),
            1255,
        ),
        _roots(),
        '1',
    ),
    'walker_orin_4': System(
        "Walker and Orin's method 4",
        Claim(
            '76 1/2 n^2 + 12 n - 21',
            _polynomial(0, '153/2', 12, -21),
            3435,
            None,
            'the formula gives 2805 at n = 6; 117 n instead of 12 n gives the printed 3435',
        ),
        Claim('56 n^2 + 87 n - 6', _polynomial(0, 56, 87, -6), 2532),
        _roots(),
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
        _roots(),
        '1',
    ),
    'pcrbm': System(
        'Parallel composite rigid bodies',
        Claim(
            'P6 + 4 n + 10 h + 31 L + 170',
            _mixed(n_terms=4, h=10, L=31, P6=1, constant=170),
            334,
            _mixed(n_terms=4, h=10, L=31, P6=1, constant=110),
            'the formula gives 323 at n = 6, that of section 2.5 gives 311, its parts (a) to (f) '
            'sum to 263',
        ),
        Claim(
            'P2 + 5 n + 5 h + 45 L + 125',
            _mixed(n_terms=5, h=5, L=45, P2=1, constant=125),
            328,
            _mixed(n_terms=8, h=5, L=46, P2=1, constant=86),
            'the formula gives 323 at n = 6, its parts (a) to (f) sum to 305',
        ),
        _roots(1, lambda n: Fraction(1), ONE_ROOT),
        'n',
    ),
    'pcrbm_array': System(
        'Parallel composite rigid bodies with the triangular array',
        Claim(
            '7 n + 9 h + 31 L + 169',
            _mixed(n_terms=7, h=9, L=31, constant=169),
            331,
            None,
            'the formula is that of PCRBM with 3 n - 1 cycles for P6 + h, in which equations (29) '
            'to (31) as printed give a wrong matrix; measured are the 5 n - 2 cycles of the '
            'corrected array, with both substitutions',
        ),
        Claim(
            '8 n + 5 h + 45 L + 124',
            _mixed(n_terms=8, h=5, L=45, constant=124),
            322,
            None,
            'the formula is that of PCRBM with 3 n - 1 cycles for P2',
        ),
        _roots(1, None, ROOTS_OF_THE_ARRAY),
        'n and n(n+1)/2 cells',
    ),
    'pcgm': System(
        'Parallel conjugate gradients',
        Claim(
            '49 n + 27 L + 124',
            _mixed(n_terms=49, L=27, constant=124),
            499,
            _mixed(n_terms=49, L=27, constant=124),
        ),
        Claim(
            '14 n L + 30 n + 34 L + 87',
            _mixed(n_terms=30, L=34, nL=14, constant=87),
            621,
            _mixed(n_terms=30, L=34, nL=14, constant=87),
            'steps 7 to 15 as listed have 14 L + 29 an iteration',
        ),
        _roots(),
        'n',
    ),
}
