# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Programs of multiply-adds, and their results with one rounding."""

from __future__ import annotations

import ctypes
from fractions import Fraction
import math

from native_code import compile_ir
import numpy as np

Triple = tuple[np.ndarray, np.ndarray, np.ndarray]


def rounded(exact: Fraction, dtype: str) -> float:
    """Return an exact number rounded to nearest, ties to even, by the definition."""
    info = np.finfo(dtype)
    if exact == 0:
        return 0.0
    size = abs(exact)
    # The exponent e with 2^e <= size < 2^(e+1), and the spacing of numbers there.
    e = size.numerator.bit_length() - size.denominator.bit_length()
    e -= size < Fraction(2) ** e
    spacing = Fraction(2) ** (max(e, info.minexp) - info.nmant)
    result = round(size / spacing) * spacing  # a Fraction rounds ties to even
    number = math.inf if result > Fraction(float(info.max)) else float(result)
    return math.copysign(number, exact)


def cancelling(dtype: str, count: int, rng: np.random.Generator) -> Triple:
    """Return numbers whose product is all but taken away again, at every distance."""
    info = np.finfo(dtype)
    a, b = (rng.uniform(1, 2, count).astype(dtype) for _ in range(2))
    off = rng.integers(-3, 4, count) * info.eps * 2.0 ** rng.integers(-4, 60, count)
    return a, b, (-(a.astype(float) * b) * (1 + off)).astype(dtype)


def everywhere(dtype: str, count: int, rng: np.random.Generator) -> Triple:
    """Return numbers of all sizes, so that sums overflow and end below the normal ones."""
    info = np.finfo(dtype)
    low, high = info.minexp - info.nmant, info.maxexp
    sign = rng.choice([-1.0, 1.0], (3, count))
    e = rng.integers(low, high, (3, count))
    e[1] = np.clip(rng.integers(low, high, count) - e[0], low, high - 1)
    e[2] = np.clip(e[0] + e[1] + rng.integers(-60, 60, count), low, high - 1)
    a, b, c = np.ldexp(sign * rng.uniform(1, 2, (3, count)), e).astype(dtype)
    return a, b, c


def native(dtype: str) -> ctypes._FuncPointer:
    """Return what LLVM makes of a fused multiply-add."""
    t, suffix = {'float64': ('double', 'f64'), 'float32': ('float', 'f32')}[dtype]
    ir = (
        f'declare {t} @llvm.fma.{suffix}({t}, {t}, {t})\n'
        f'define {t} @f({t} %a, {t} %b, {t} %c) {{\n'
        f'%r = call {t} @llvm.fma.{suffix}({t} %a, {t} %b, {t} %c)\nret {t} %r }}'
    )
    code = compile_ir(ir, ['f'])
    number = {'double': ctypes.c_double, 'float': ctypes.c_float}[t]
    function = ctypes.CFUNCTYPE(number, number, number, number)(code['f'])
    function.code = code
    return function
