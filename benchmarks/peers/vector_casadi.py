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

from benchmarks.peers.casadi import LONGEST, function_of, source_of
from benchmarks.peers.native import OPTIMISED, address, built
from benchmarks.peers.work import Arguments, LeftOutError, Peer, Side, is_batch
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
    found = BODY.search(source_of(function_of(robot)))
    assert found is not None
    body = found[1]
    for pattern, text in STATEMENTS:
        body = re.sub(pattern, text, body)
    code = stored_text('vector_casadi.c').replace('@BODY@', body)
    return f'enum {{ N = {robot.n} }};\n{ARGUMENTS}{code}'


def vector_library(robot: Robot, compiler: str) -> ctypes.CDLL:
    """Return the C compiled by one of COMPILERS: `columns`, `rows`, and `sines` for its test."""
    if robot.n > MOST[compiler]:
        raise LeftOutError(f'not measured beyond {MOST[compiler]} joints: slow to compile')
    with built(compiler, '.c', vector_source(robot), *COMPILERS[compiler]) as path:
        return ctypes.CDLL(path)


def vector_casadi(robot: Robot, compiler: str = 'gcc') -> Peer:
    """Return the peer of one compiler: a batch in Fortran and in C order."""
    library = vector_library(robot, compiler)
    contents = (
        f'C for this robot, {compiler} {" ".join(OPTIMISED)} and parts of -ffast-math; called '
        f'by ctypes once, loop in C, eight states at a time; {NUMBERS}'
    )

    def sides(given: Arguments) -> Iterator[Side]:
        orders = ('F', np.asfortranarray, 'columns'), ('C', np.ascontiguousarray, 'rows')
        for order, laid, function in orders if is_batch(given) else ():
            arrays = [laid(x) for x in given]
            out: NDArray[np.float64] = np.empty_like(arrays[0])
            native, count = getattr(library, function), ctypes.c_longlong(len(out))
            run = partial(native, count, *map(address, (*arrays, out)))
            way = f'CasADi C on vectors, {compiler}, {order} order'
            yield Side(way, run, partial(np.asarray, out), contents)

    return sides
