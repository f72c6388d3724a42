# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
What an expert does with CasADi's C: eight states at a time, as a peer.

`double` in the C of one state becomes a vector type of gcc and clang, and its sines and cosines
become polynomials on vectors (data/vector_casadi.c). The algorithm is composite bodies, and
articulated bodies for long chains: the one of fewer operations. Each compiler that is installed
is a peer, with the options of -ffast-math and, for gcc, an earlier scheduling of instructions,
which were the fastest of a dozen tried. States lie in columns; in rows, C order, they are
transposed on the way, eight at a time.
"""

from __future__ import annotations

from collections.abc import Iterator
import ctypes
from functools import partial
import re

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.robots import Array
from benchmarks.peers.casadi import ARTICULATED, COMPOSITE, LONGEST, function_of, source_of
from benchmarks.peers.native import OPTIMISED, address, built
from benchmarks.peers.work import LeftOutError, Side, Work
from benchmarks.table import stored_text
from pfd_core.model import Robot

# -ffast-math itself links code that makes this whole process flush small numbers to zero.
FAST = (
    '-fassociative-math',
    '-fno-signed-zeros',
    '-fno-trapping-math',
    '-freciprocal-math',
    '-fno-math-errno',
    '-ffinite-math-only',
    '-ffp-contract=fast',
)
COMPILERS = {
    'gcc': (*FAST, '-fschedule-insns', '-fsched-pressure'),
    'clang': (*FAST, '-fapprox-func'),
}
# Most joints by compiler, which takes minutes beyond.
MOST = {'gcc': LONGEST, 'clang': 30}
# Largest angle [rad] and error of sine and cosine [units in the last place], which a test holds.
LARGEST_ANGLE, ULPS = 1e5, 2.0
NUMBERS = f'float64, sine and cosine by polynomials: {ULPS:g} ulp, up to {LARGEST_ANGLE:g} rad'
# Statements of CasADi's function, and what each becomes.
BODY = re.compile(r'static int casadi_f0\(.*?\)\s*\{(.*?)return 0;', re.DOTALL)
STATEMENTS = (
    (r'casadi_real ', 'Vector '),
    (r'arg\[(\d)\]\s*\?\s*arg\[\d\]\[(\d+)\]\s*:\s*0', r'*(const Unaligned *)(A\1 + \2 * stride)'),
    (r'if \(res\[0\]!=0\) res\[0\]\[(\d+)\]=(\w+);', r'*(Unaligned *)(qdd + \1 * stride) = \2;'),
    (r'=\s*(-?[\d.]+(?:e[+-]?\d+)?)\s*;', r' = \1 + (Vector){0};'),
    (r'\b(?:casadi_)?(sin|cos|sq)\(', r'vector_\1('),
)
ARGUMENTS = '#define A0 q\n#define A1 qd\n#define A2 tau\n'


def vector_source(robot: Robot) -> str:
    """Return the C of forward dynamics of eight states at a time."""
    method = COMPOSITE if robot.n <= LONGEST else ARTICULATED
    found = BODY.search(source_of(function_of(robot, method=method)))
    assert found is not None
    body = found[1]
    for pattern, text in STATEMENTS:
        body = re.sub(pattern, text, body)
    code = stored_text('vector_casadi.c').replace('@BODY@', body)
    return f'enum {{ N = {robot.n} }};\n{ARGUMENTS}{code}'


class VectorCasadi:
    """CasADi's C on vectors of eight states, by one compiler of COMPILERS; batches only."""

    def __init__(self, robot: Robot, compiler: str = 'gcc') -> None:
        if robot.n > MOST[compiler]:
            raise LeftOutError(f'not measured beyond {MOST[compiler]} joints: slow to compile')
        self.name = f'CasADi C on vectors, {compiler}'
        with built(compiler, '.c', vector_source(robot), *COMPILERS[compiler]) as path:
            self.library = ctypes.CDLL(path)
        self.contents = (
            f'C for this robot, {compiler} {" ".join(OPTIMISED)} and parts of -ffast-math; called '
            f'by ctypes once, loop in C, eight states at a time; {NUMBERS}'
        )

    def sines(self, angles: Array) -> tuple[Array, Array]:
        """Return sine and cosine of angles, (8k,)."""
        sine, cosine = np.empty_like(angles), np.empty_like(angles)
        self.library.sines(ctypes.c_longlong(len(angles)), *map(address, (angles, sine, cosine)))
        return sine, cosine

    def sides(self, work: Work) -> Iterator[Side]:
        """Yield the ways of a batch, in Fortran and in C order."""
        orders = ('F', np.asfortranarray, 'columns'), ('C', np.ascontiguousarray, 'rows')
        for order, laid, function in orders if work.kind == 'batch' else ():
            given = [laid(x) for x in work.arrays]
            out: NDArray[np.float64] = np.empty_like(given[0])
            native = getattr(self.library, function)
            run = partial(native, ctypes.c_longlong(work.units), *map(address, (*given, out)))
            yield Side(f'{self.name}, {order} order', run, partial(np.asarray, out), self.contents)


def sine_error(peer: VectorCasadi, count: int = 1 << 17) -> float:
    """Return the largest error of sine and cosine up to LARGEST_ANGLE, in ulp of the result."""
    angles = np.random.default_rng(1).uniform(-1, 1, count) * np.geomspace(1, LARGEST_ANGLE, count)
    wide = angles.astype(np.longdouble)
    errors = (
        np.abs(found - exact) / np.spacing(np.abs(exact.astype(np.float64)))
        for found, exact in zip(peer.sines(angles), (np.sin(wide), np.cos(wide)), strict=True)
    )
    return float(max(error.max() for error in errors))
