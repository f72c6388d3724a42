# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The fused multiply-add is rounded once, whatever the numbers are."""

from __future__ import annotations

from fractions import Fraction
import math

from bridge import FUSED_REACH, Instruction, ProgramOutput, fused_multiply_add, run_program
from fused_products import Triple, cancelling, everywhere, native, rounded
import mpmath
import numpy as np
import pytest

import pfd_core as pfd

FORMATS = ('float64', 'float32')


def midways(dtype: str, count: int, rng: np.random.Generator) -> Triple:
    """Return sums that lie in the middle of two numbers but for a far smaller part."""
    digits = np.finfo(dtype).nmant
    i = rng.integers(2, digits, count)
    # (1 + 2^-i) (1 + 2^-j) ends with half of the last digit of a number near one.
    a, b = 1 + 2.0**-i, 1 + 2.0 ** (i - digits - 1)
    c = rng.choice([-1, 1], count) * 2.0 ** -rng.integers(digits + 3, 3 * digits, count)
    return a.astype(dtype), b.astype(dtype), c.astype(dtype)


@pytest.mark.parametrize('kind', [cancelling, midways, everywhere])
@pytest.mark.parametrize('dtype', FORMATS)
def test_a_fused_product_rounds_once_as_exact_fractions_do(dtype: str, kind) -> None:  # type: ignore[no-untyped-def]
    with np.errstate(under='ignore'):
        a, b, c = kind(dtype, 1500, np.random.default_rng(1))
    found = fused_multiply_add(a, b, c)
    assert found.dtype == dtype
    for x, y, z, value in zip(*(v.tolist() for v in (a, b, c, found)), strict=True):
        wanted = rounded(Fraction(x) * Fraction(y) + Fraction(z), dtype)
        assert value == wanted, (x, y, z)
        assert math.copysign(1, value) == math.copysign(1, wanted) or value == 0


def test_most_of_these_are_wrong_when_rounded_twice() -> None:
    # Otherwise the test above would not distinguish one rounding from two.
    for kind in (cancelling, midways):
        a, b, c = kind('float64', 1500, np.random.default_rng(1))
        assert np.mean(fused_multiply_add(a, b, c) != a * b + c) > 0.1
    a, b, c = midways('float32', 1500, np.random.default_rng(1))
    twice = (a.astype(float) * b + c).astype('float32')
    assert np.any(fused_multiply_add(a, b, c) != twice)


@pytest.mark.parametrize('dtype', FORMATS)
def test_native_code_gives_the_same_bits(dtype: str) -> None:
    function = native(dtype)
    info = np.finfo(dtype)
    tiny, large = float(info.smallest_subnormal), float(info.max)
    special = [0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, math.nan, tiny, -tiny, large, -large]
    special += [float(info.tiny), 0.5, 3.0, FUSED_REACH if dtype == 'float64' else 2.0**64]
    grid = [axis.ravel() for axis in np.meshgrid(special, special, special)]
    triples = [tuple(axis.astype(dtype) for axis in grid)]
    with np.errstate(under='ignore'):
        triples += [
            kind(dtype, 1000, np.random.default_rng(2))
            for kind in (cancelling, midways, everywhere)
        ]
    for a, b, c in triples:
        wanted = np.array([function(*abc) for abc in zip(a, b, c, strict=True)], dtype)
        found = fused_multiply_add(a, b, c)
        np.testing.assert_array_equal(found, wanted)
        known = ~np.isnan(wanted)
        np.testing.assert_array_equal(np.signbit(found[known]), np.signbit(wanted[known]))


def test_operands_are_broadcast() -> None:
    a = np.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(
        fused_multiply_add(a, np.array(2.0), np.arange(3.0)), 2 * a + np.arange(3)
    )
    assert fused_multiply_add(np.array(2.0), np.array(3.0), np.array(4.0)) == 10


def test_other_formats_and_mixtures_are_refused() -> None:
    one = np.ones(1)
    with pytest.raises(ValueError, match='got float64, float32 and float64: convert'):
        fused_multiply_add(one, one.astype('float32'), one)
    with pytest.raises(ValueError, match='got int64, int64 and int64: convert them first'):
        fused_multiply_add(*[np.ones(1, 'int64')] * 3)


@pytest.mark.parametrize('digits', [None, 50])
def test_the_emulator_has_it_in_every_format(digits: int | None) -> None:
    inputs = [Instruction('input', (), ((name, 0),)) for name in 'abc']
    program = pfd.Program(
        1,
        (*inputs, Instruction('fma', (0, 1, 2))),
        dict.fromkeys('abc', 1),
        {'out': ProgramOutput((1,), ((3, 0),))},
    )
    a = 1 + 2.0**-30
    values = {'a': [a], 'b': [a], 'c': [-1 - 2.0**-29]}
    # The square of 2^-30 is all that is left, and is gone where a product is rounded first.
    assert run_program(program, values, digits=digits)['out'][0] == mpmath.mpf(2) ** -60
    assert a * a - 1 - 2.0**-29 == 0
