# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The closed table of operations: meaning, LLVM spelling and cost column of each.

A program consists of these operations. The emulator reads the column `meaning`, the kernels read
`llvm`, the step counts read `cost`, derivatives read `partials`; a new operation is a new row here
and nowhere else.

Every meaning is a correctly rounded IEEE 754 operation, except `sin` and `cos`: a kernel
replaces these two by the other rows before it is compiled (pfd_core.kernels.sines).

Partial derivatives are a sign and a formula on values with `+ - *`: z is the result of the
operation, a, b and c its operands; z.recorder records any other operation. Equal expressions are
recorded once: all derivatives of a quotient share 1 / b. Source: Griewank and Walther, Evaluating
Derivatives, 2nd ed. 2008.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

# A sign, and a function of the result and the operands.
Partial = tuple[float, Callable[..., Any]]


@dataclass(frozen=True)
class Operation:
    """One row of the table."""

    name: str  # in a program
    arity: int  # number of registers that it reads; -1 if that varies
    # Column of the step counts; None is free (data moved within a lane, a lane switched off, a
    # sign bit changed).
    cost: str | None = None
    # The operation on NumPy arrays; None where the emulator supplies it (data movement).
    meaning: Callable[..., Any] | None = None
    # LLVM instruction on operands `{0}`, `{1}`, ... of type `{type}`, whose name in intrinsics is
    # `{suffix}`; None where the kernel writer supplies it or no kernel has the operation.
    llvm: str | None = None
    # For each operand the partial derivative of the result; empty where the operation has none,
    # and its derivative is refused.
    partials: tuple[Partial, ...] = ()


def fused(a: NDArray[Any], b: NDArray[Any], c: NDArray[Any]) -> NDArray[Any]:
    """
    Return a b + c with one rounding, to nearest, ties to even, which NumPy lacks.

    Arrays that broadcast, all of float64 or all of float32 (else ValueError), give the bits of
    IEEE 754, signs of zeros and infinities included, and NaN for any NaN result.
    """
    a, b, c = np.broadcast_arrays(a, b, c)
    if a.dtype not in (np.float64, np.float32) or not a.dtype == b.dtype == c.dtype:
        raise ValueError(
            'a, b and c must all be float64 or all float32, '
            f'got {a.dtype}, {b.dtype} and {c.dtype}: convert them first'
        )
    with np.errstate(all='ignore'):
        # A product that is an exact zero, infinite or NaN leaves the sum nothing to lose.
        result = np.array(a * b + c)
        rounded = np.isfinite(a) & np.isfinite(b) & (a != 0) & (b != 0)
        for at in map(tuple, np.argwhere(rounded)):
            x, y, z = (float(number[at]) for number in (a, b, c))
            result[at] = _rounded_once(x, y, z, a.dtype == np.float32)
    return result


def _rounded_once(a: float, b: float, c: float, again: bool) -> float:
    """Return a b + c of finite a and b, to nearest, or to odd if it is rounded `again`."""
    if not math.isfinite(c):
        return c
    (p, q), (r, s), (t, u) = (x.as_integer_ratio() for x in (a, b, c))
    above, below = p * r * u + t * q * s, q * s * u
    try:
        near = above / below  # integers in Python, so that the quotient is rounded once
    except OverflowError:
        return math.inf if above > 0 else -math.inf
    x, y = near.as_integer_ratio()
    rest = above * y - x * below
    if again and rest and not np.float64(near).view(np.int64) & 1:
        # A number whose last bit is one is no tie when it is rounded to fewer digits: Boldo and
        # Melquiond, IEEE Transactions on Computers 57(4), 2008.
        return math.nextafter(near, math.inf if rest > 0 else -math.inf)
    return near


def _reciprocal(z: Any, a: Any, b: Any) -> Any:
    return z.recorder.apply('div', 1.0, b)


ONE: Partial = (1.0, lambda z, *operands: 1.0)
MINUS_ONE: Partial = (-1.0, ONE[1])
FIRST: Partial = (1.0, lambda z, a, *operands: a)
SECOND: Partial = (1.0, lambda z, a, b, *operands: b)
QUOTIENT: tuple[Partial, ...] = (
    (1.0, _reciprocal),
    (-1.0, lambda z, a, b: z * _reciprocal(z, a, b)),
)
ROOT: Partial = (1.0, lambda z, a: z.recorder.apply('div', 0.5, z))
SINE: Partial = (1.0, lambda z, a: z.recorder.apply('cos', a))
COSINE: Partial = (-1.0, lambda z, a: z.recorder.apply('sin', a))
ADD, SUB, MUL, DIV = (f'f{name} {{type}} {{0}}, {{1}}' for name in ('add', 'sub', 'mul', 'div'))
FMA = 'call {type} @llvm.fma.{suffix}({type} {0}, {type} {1}, {type} {2})'
SQRT = 'call {type} @llvm.sqrt.{suffix}({type} {0})'

OPERATIONS = {
    operation.name: operation
    for operation in (
        Operation('input', 0),
        Operation('constant', 0),
        # Lane i takes the value of a given lane, or lane i of the second operand.
        Operation('route', 2, 'routes'),
        # The second operand where the first is above zero, else the third. Its derivative is that
        # of the operand that is selected (pfd_core.machine.derivative).
        Operation('select', 3, None, lambda c, chosen, other: np.where(c > 0, chosen, other)),
        Operation('add', 2, 'additions', np.add, ADD, (ONE, ONE)),
        Operation('sub', 2, 'additions', np.subtract, SUB, (ONE, MINUS_ONE)),
        Operation('mul', 2, 'multiplications', np.multiply, MUL, (SECOND, FIRST)),
        Operation('div', 2, 'divisions', np.divide, DIV, QUOTIENT),
        Operation('neg', 1, None, np.negative, 'fneg {type} {0}', (MINUS_ONE,)),
        # One rounding of a b + c. No step counts it: kernels put it in the place of an addition
        # and a multiplication (pfd_core.kernels.simplify).
        Operation('fma', 3, None, fused, FMA, (SECOND, FIRST, ONE)),
        Operation('sqrt', 1, 'square_roots', np.sqrt, SQRT, (ROOT,)),
        Operation('sin', 1, 'sines', np.sin, None, (SINE,)),
        Operation('cos', 1, 'sines', np.cos, None, (COSINE,)),
        # A repeated part: `loop` (its initial rows), `state` (a row as this iteration finds it),
        # `leave` (of the last iteration that is allowed nothing more is run), `end` (the rows for
        # the next iteration), `result` (a row after the last one).
        Operation('loop', -1),
        Operation('state', 1),
        Operation('leave', 0),
        Operation('end', -1),
        Operation('result', 1),
    )
}

COSTS = ('multiplications', 'additions', 'divisions', 'square_roots', 'routes', 'sines')
