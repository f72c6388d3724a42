# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Print the constants of pfd_core/kernels/passes/sincos.py: parts of pi/2 and two polynomials.

    python benchmarks/fit_sine.py

A part is cut where k times it is exact for every k up to 65535, and where zeros follow if it
can be. All parts but the last are positive: -0 would lose its sign. The polynomials are minimax
(Remez exchange in 50 digits) in the relative error of the result. A coefficient that has been
rounded can be compensated by those after it, so they are rounded one at a time, lowest power
first, and the rest is fitted again.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np

DIGITS = 50
GRID = 1500  # points at which the error is evaluated
EXCHANGES = 12  # Remez steps; it has settled after five

# Part i of pi/2 is a multiple of two to the power LAST_BIT[i]; the last one is full width.
LAST_BITS = {'float64': (-36, -73), 'float32': (-7, -19, -24, -33, -41)}
# Largest |r|: pi/4, and the error of x * 2/pi before it is rounded to k.
LARGEST = {'float64': mp.mpf('0.785398164'), 'float32': mp.mpf('0.7916')}
TERMS = {'float64': 6, 'float32': 3}

Function = Callable[[Any], Any]


def parts_of_half_pi(dtype: str) -> list[float]:
    """Return pi/2 as a sum of short numbers, largest first."""
    parts, rest = [], mp.pi / 2
    for last_bit in LAST_BITS[dtype]:
        nearest = mp.nint if last_bit == LAST_BITS[dtype][-1] else mp.floor
        part = mp.ldexp(nearest(mp.ldexp(rest, -last_bit)), last_bit)
        parts.append(float(part))
        rest -= part
    return [*parts, float(np.dtype(dtype).type(rest))]


def polynomial(c: list[Any], h: Any) -> Any:
    value = mp.mpf(0)
    for coefficient in reversed(c):
        value = value * h + coefficient
    return value


def minimax(target: Function, weight: Function, terms: int, largest: Any) -> list[Any]:
    """Return c minimising max |weight(h) (sum c[j] h**j - target(h))| for 0 < h <= largest."""
    grid = [largest * (1 - mp.cos(mp.pi * (i + 1) / GRID)) / 2 for i in range(GRID)]
    wanted, weights = [target(h) for h in grid], [weight(h) for h in grid]
    picked = [round((GRID - 1) * (i + 0.5) / (terms + 1)) for i in range(terms + 1)]
    for _ in range(EXCHANGES):
        rows = [
            [grid[i] ** j for j in range(terms)] + [(-1) ** n / weights[i]]
            for n, i in enumerate(picked)
        ]
        solution = mp.lu_solve(mp.matrix(rows), mp.matrix([wanted[i] for i in picked]))
        c = list(solution)[:terms]
        error = [w * (polynomial(c, h) - t) for h, w, t in zip(grid, weights, wanted, strict=True)]
        picked = extrema(error, terms + 1)
    return c


def extrema(error: list[Any], count: int) -> list[int]:
    """Return the places of the `count` extrema of alternating sign that are largest."""
    places: list[int] = []
    for i, e in enumerate(error):
        if places and (error[places[-1]] > 0) == (e > 0):
            if abs(e) > abs(error[places[-1]]):
                places[-1] = i
        else:
            places.append(i)
    while len(places) > count:
        places.pop(0 if abs(error[places[0]]) < abs(error[places[-1]]) else -1)
    return places


def fit(target: Function, weight: Function, dtype: str) -> tuple[list[float], Any]:
    """Return coefficients rounded to dtype, lowest power first, and the largest error."""
    largest = LARGEST[dtype] ** 2 / 2
    fixed: list[Any] = []
    for terms in range(TERMS[dtype], 0, -1):
        done = len(fixed)

        def rest(h: Any, done: int = done) -> Any:
            return (target(h) - polynomial(fixed, h)) / h**done

        def scaled(h: Any, done: int = done) -> Any:
            return weight(h) * h**done

        c = minimax(rest, scaled, terms, largest)
        fixed.append(mp.mpf(float(np.dtype(dtype).type(c[0]))))
    points = [largest * (i + 1) / GRID for i in range(GRID)]
    error = max(abs(weight(h) * (polynomial(fixed, h) - target(h))) for h in points)
    return [float(c) for c in fixed], error


# With h = r r / 2: sin r = r - r h S(h) and cos r = 1 - h + h h C(h).
def sine(h: Any) -> Any:
    r = mp.sqrt(2 * h)
    return (1 - mp.sin(r) / r) / h


def sine_weight(h: Any) -> Any:
    r = mp.sqrt(2 * h)
    return h * r / mp.sin(r)


def cosine(h: Any) -> Any:
    return (mp.cos(mp.sqrt(2 * h)) - 1 + h) / h**2


def cosine_weight(h: Any) -> Any:
    return h**2 / mp.cos(mp.sqrt(2 * h))


def constants(dtype: str) -> dict[str, Any]:
    """Return the constants of one number format, and the errors of the two polynomials."""
    with mp.workdps(DIGITS):
        sine_fit, sine_error = fit(sine, sine_weight, dtype)
        cosine_fit, cosine_error = fit(cosine, cosine_weight, dtype)
        parts = parts_of_half_pi(dtype)
        return {
            'two_over_pi': float(np.dtype(dtype).type(2 / mp.pi)),
            'parts': tuple(parts),
            'sine': tuple(sine_fit),
            'cosine': tuple(cosine_fit),
            'log2 of what the parts miss': float(mp.log(abs(mp.pi / 2 - mp.fsum(parts)), 2)),
            'log2 of relative error of sine': float(mp.log(sine_error, 2)),
            'log2 of relative error of cosine': float(mp.log(cosine_error, 2)),
        }


def main() -> None:
    for dtype in LAST_BITS:
        print(dtype)
        for name, value in constants(dtype).items():
            print(f'  {name}', *(value if isinstance(value, tuple) else [value]), sep='\n    ')


if __name__ == '__main__':
    main()
