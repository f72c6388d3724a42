# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A sequential program with the rounding error of each of its values, to first order.

    a + b     s = fl(a + b),  error of s from two more differences (Knuth)
    a b       p = fl(a b),    error of p = fma(a, b, -p)
    a / b     c = fl(a / b),  error of c = fma(-c, b, a) / b
    sqrt a    s = fl(sqrt a), error of s = fma(-s, s, a) / (2 s)

The error of a value is carried through the operations that read it. Value plus error is as
accurate as arithmetic with nearly twice the digits. Sines and cosines are evaluated here, by
Taylor's series after Cody and Waite's reduction, because a kernel evaluates them within 1.5 units
only.

Every product is recorded as fma(a, b, 0). It therefore shares no register with products that are
recorded elsewhere, so that lowering fuses those as it does without this part.

Knuth, The Art of Computer Programming 2, 4.2.2; Langlois, Graillat and Louvet 2006, Compensated
Horner scheme, for the errors of products and sums carried along.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
import math
from typing import Any, NamedTuple

import numpy as np

from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder

# pi / 2 to 60 digits.
HALF_PI = Fraction('1.57079632679489661923132169163975144209858469968755291048747')
# Terms of the series that are smaller than this, in units of rounding, are ignored.
SMALLEST_TERM = 1e-3
# Coefficients of each series whose rounding matters, for angles of at most pi / 4.
WITH_ERRORS = 2


class Approximate(NamedTuple):
    """A value, and its exact value less this value."""

    value: Lanes
    error: Any = 0.0  # a value, or the number zero
    exact: Fraction | None = None  # of a number that is known while recording


class RoundingErrors:
    """Records operations with their rounding errors on one lane, to be run in a number format."""

    def __init__(self, recorder: Recorder, dtype: str) -> None:
        self.recorder = recorder
        self.number = np.dtype(dtype).type
        self.digits = np.finfo(dtype).nmant
        self._sines: dict[tuple[int, ...], tuple[Approximate, Approximate]] = {}
        self._rules: Mapping[str, Callable[..., Approximate]] = {
            'neg': self.negative,
            'add': self.sum,
            'sub': lambda a, b: self.sum(a, self.negative(b)),
            'mul': self.product,
            'div': self._quotient,
            'sqrt': self._root,
            'select': self._selected,
            'sin': lambda x: self._sine_and_cosine(x)[0],
            'cos': lambda x: self._sine_and_cosine(x)[1],
        }

    def record(self, program: Program) -> dict[str, list[Approximate]]:
        """Record a sequential program without loops and return its outputs by name."""
        found: list[Approximate] = []
        for op, args, data, *_ in program.instructions:
            if op == 'input':
                name, k = data[0]
                found.append(Approximate(self.recorder.input(name, [k])))
            elif op == 'constant':
                x = data[0]
                found.append(self.constant(Fraction(x) if math.isfinite(x) else x))
            elif op in self._rules:
                found.append(self._rules[op](*(found[a] for a in args)))
            else:
                raise ValueError(f'the rounding error of {op} is not known')
        return {
            name: [found[register] for register, _ in output.places]
            for name, output in program.outputs.items()
        }

    def constant(self, exact: Fraction | float) -> Approximate:
        """Return a number with the rounding to the number format as its error."""
        value = float(self.number(float(exact)))
        row = self.recorder.constant(value)
        if not isinstance(exact, Fraction):
            return Approximate(row)
        rest = float(self.number(float(exact - Fraction(value))))
        return Approximate(row, self.recorder.constant(rest) if rest else 0.0, exact)

    def negative(self, a: Approximate) -> Approximate:
        """Return -a."""
        if a.exact is not None:
            return self.constant(-a.exact)
        return Approximate(-a.value, 0.0 - a.error)

    def sum(self, a: Approximate, b: Approximate) -> Approximate:
        """Return a + b."""
        if a.exact is not None and b.exact is not None:
            # Not by operations: lowering folds those of constants in float64.
            return self.constant(a.exact + b.exact)
        if a.exact == 0 or b.exact == 0:
            return b if a.exact == 0 else a
        s = a.value + b.value
        part = s - a.value
        rounding: Lanes = (a.value - (s - part)) + (b.value - part)
        return Approximate(s, a.error + b.error + rounding)

    def product(self, a: Approximate, b: Approximate) -> Approximate:
        """Return a b."""
        if a.exact is not None and b.exact is not None:
            return self.constant(a.exact * b.exact)
        for factor, other in ((a, b), (b, a)):
            if factor.exact == 0:
                return factor
            if factor.exact is not None and abs(factor.exact) == 1:
                return other if factor.exact == 1 else self.negative(other)
        p = self._fma(a.value, b.value, 0.0)
        error = self._fma(a.value, b.value, -p)
        for factor, other in ((a, b), (b, a)):
            if other.error != 0.0:
                error = self._fma(factor.value, other.error, error)
        return Approximate(p, error)

    def _fma(self, a: Lanes, b: Lanes, c: Lanes | float) -> Lanes:
        return self.recorder.apply('fma', a, b, c)

    def _quotient(self, a: Approximate, b: Approximate) -> Approximate:
        c = a.value / b.value
        rest = self._fma(-c, b.value, a.value) + a.error
        if b.error != 0.0:
            rest = self._fma(-c, b.error, rest)
        return Approximate(c, rest / b.value)

    def _root(self, a: Approximate) -> Approximate:
        s = self.recorder.apply('sqrt', a.value)
        rest = self._fma(-s, s, a.value) + a.error
        return Approximate(s, where(s, rest / (s + s), 0.0))

    def _selected(self, c: Approximate, a: Approximate, b: Approximate) -> Approximate:
        value = where(c.value, a.value, b.value)
        exact = a.error == b.error == 0.0
        return Approximate(value, 0.0 if exact else where(c.value, a.error, b.error))

    def _sine_and_cosine(self, x: Approximate) -> tuple[Approximate, Approximate]:
        key = x.value.registers
        if key not in self._sines:
            self._sines[key] = self._turned(*self._reduced(x))
        return self._sines[key]

    def _reduced(self, x: Approximate) -> tuple[Lanes, Approximate]:
        """Return the nearest whole number k of quarter turns, and r = x - k pi / 2."""
        # Numbers of this size are whole: adding and subtracting one rounds.
        whole = self.recorder.constant(1.5 * 2.0**self.digits)
        turns = self.constant(1 / HALF_PI).value
        k = self._fma(x.value, turns, whole) - whole
        angle = self.product(Approximate(k), self.constant(HALF_PI))
        r = self.sum(x, self.negative(angle))
        # The reduction may leave an error that is not small compared with r.
        return k, self.sum(Approximate(r.value), Approximate(r.error))

    def _turned(self, k: Lanes, r: Approximate) -> tuple[Approximate, Approximate]:
        """Return sine and cosine of r + k pi / 2."""
        z = self.product(r, r)
        sine = self.sum(r, self.product(r, self.product(z, self._series(z, 3))))
        cosine = self.sum(self.constant(Fraction(1)), self.product(z, self._series(z, 2)))
        # Cosine and minus sine of k quarter turns: each 1, 0 or -1.
        even = 3.0 * 2.0**self.digits
        turned = k + 1.0
        along = turned - ((turned + even) - even)
        down = ((k + even) - even) - k
        return (
            self._combined(along, sine, -down, cosine),
            self._combined(along, cosine, down, sine),
        )

    def _combined(self, c: Lanes, a: Approximate, s: Lanes, b: Approximate) -> Approximate:
        """Return c a + s b, where one of c and s is zero and the other 1 or -1."""
        value = self._fma(c, a.value, self._fma(s, b.value, 0.0))
        return Approximate(value, self._fma(c, a.error, self._fma(s, b.error, 0.0)))

    def _series(self, z: Approximate, power: int) -> Approximate:
        """Return -1/power! + z/(power + 2)! - ..., for z up to (pi / 4)^2."""
        coefficients: list[Fraction] = []
        size, m = 1.0, power
        while size > SMALLEST_TERM * 2.0**-self.digits:
            sign = -1 if len(coefficients) % 2 == 0 else 1
            coefficients.append(Fraction(sign, math.factorial(m)))
            m += 2
            size = (math.pi / 4) ** m / math.factorial(m)
        rest = self.constant(coefficients[-1]).value
        for coefficient in reversed(coefficients[WITH_ERRORS:-1]):
            rest = self._fma(rest, z.value, self.constant(coefficient).value)
        result = Approximate(rest)
        for coefficient in reversed(coefficients[:WITH_ERRORS]):
            result = self.sum(self.product(result, z), self.constant(coefficient))
        return result
