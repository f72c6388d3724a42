# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Where the factor over Pinocchio comes from: the same states in the same process, step by step.

    Pinocchio from Python    pinocchio.aba called from Python for each state
    Pinocchio in C++         the loop in C++, for this processor: without the overhead of calls
    CasADi C                 code for one robot, of another generator
    pfd, state by state      our code for one robot, scalar: @evaluate of the kernel for one state
                             in a native loop, not inlined
    pfd, vectors of states   the batch of the same kernel
    pfd from Python          the bound kernel called from Python for each state

All ways take turns, so that the product of the factors between neighbours is the whole factor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
import ctypes
from dataclasses import replace
from functools import partial

import numpy as np

from pfd_core.kernels.codegen.builder import Function
from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.runtime.jit import compile_ir
from pfd_core.report.cases.robots import Array
from pfd_core.report.contenders.casadi import Casadi
from pfd_core.report.contenders.ours import BATCH, BOUND, CODE, Ours
from pfd_core.report.contenders.pinocchio import PYTHON_LOOP, Pinocchio
from pfd_core.report.contenders.pinocchio_cpp import FUNCTIONS, PinocchioCpp
from pfd_core.report.contenders.work import (
    Contender,
    Contents,
    Side,
    Work,
    named,
    one_by_one,
    valid_sides,
)
from pfd_core.report.measure.progress import show_progress
from pfd_core.report.measure.timing import MIDDLE_BATCH, Pace, Row, take_turns

WORK = 'decomposition'
PYTHON, CPP, CASADI = 'Pinocchio from Python', 'Pinocchio in C++', 'CasADi C'
SCALAR, VECTOR = 'pfd, state by state', 'pfd, vectors of states'
FROM_PYTHON = 'pfd from Python'
# Most joints of a chain that is decomposed: beyond, the code of one state is large.
LARGEST = 12


def state_by_state(kernel: Kernel, work: Work) -> Side:
    """Return a side that evaluates the states of a batch one after the other in native code."""
    given = named(kernel.quantity, work, np.ascontiguousarray, kernel.dtype)
    out: Array = np.empty_like(given['q'])
    native = compile_ir('\n'.join([kernel.ir, _loop_ir(kernel, tuple(given))]))
    kind = ctypes.CFUNCTYPE(None, ctypes.c_int64, *[ctypes.c_void_p] * (len(given) + 1))
    addresses = [array.ctypes.data for array in (*given.values(), out)]
    run = partial(kind(native.address('each')), work.units, *addresses)
    kept = (native, given)

    def result() -> Array:
        assert kept
        return out

    return Side(SCALAR, run, result, contents=Contents(CODE, 'ctypes, once', 'native, scalar'))


def _loop_ir(kernel: Kernel, names: Sequence[str]) -> str:
    """Return `void @each(i64 count, ptr inputs..., ptr out)`."""
    arrays = (*names, 'out')
    ir = Function(f'define void @each(i64 %count, {", ".join(f"ptr %{x}" for x in arrays)})')
    row = kernel.robot.n * np.dtype(kernel.dtype).itemsize
    with ir.loop('%count') as k:
        places = [f'ptr {ir.offset(f"%{name}", k, row)}' for name in arrays]
        ir.do(f'call void @evaluate({", ".join(places)}) noinline')
    ir.ret()
    return str(ir)


def measure(
    contenders: Iterable[Contender],
    works: Iterable[Work],
    rows: Sequence[Row],
    pace: Pace,
    reasons: dict[str, str],
) -> list[Row]:
    """
    Return the rows of the decomposition, in the batch whose size is nearest MIDDLE_BATCH.

    `rows` are the times measured before, from which the fastest kernel is taken. The result is
    empty without Pinocchio, for more than LARGEST joints, and without batches.
    """
    batches = [work for work in works if work.kind == 'batch']
    found = list(contenders)
    peer = next((one for one in found if isinstance(one, Pinocchio)), None)
    if not batches or peer is None or batches[0].q.shape[1] > LARGEST:
        return []
    work = min(batches, key=lambda work: abs(work.units - MIDDLE_BATCH))
    ours = _fastest(found, work, rows)
    if ours is None:
        return []
    name = ours.kernel.robot.name
    show_progress(f'{name}: decomposition')
    sides = valid_sides(_sides(found, peer, ours.kernel, work), reasons)
    return [replace(row, work=WORK) for row in take_turns(name, work, sides, pace)]


def _fastest(contenders: Iterable[Contender], work: Work, rows: Sequence[Row]) -> Ours | None:
    """Return our contender in float64 that takes the least time of a batch."""
    ours = [one for one in contenders if isinstance(one, Ours) and one.kernel.dtype == 'float64']
    times = {(row.robot, row.work, row.way): row.minimum for row in rows}

    def seconds(one: Ours) -> float:
        key = one.kernel.robot.name, work.title, f'{one.name}, F order'
        return times.get(key, np.inf)

    return min(ours, key=seconds, default=None)


def _sides(
    contenders: Sequence[Contender], peer: Pinocchio, kernel: Kernel, work: Work
) -> Iterator[Side]:
    rows = list(zip(*(x.copy() for x in work.arrays), strict=True))
    aba = partial(peer.pin.aba, peer.model, peer.data)
    run, result = partial(one_by_one, aba, rows), partial(peer.one_by_one, work)
    yield Side(PYTHON, run, result, reference=True, contents=PYTHON_LOOP)
    for one in contenders:
        if isinstance(one, PinocchioCpp):
            yield replace(one.side(work, FUNCTIONS['aba']), way=CPP)
        elif isinstance(one, Casadi):
            yield replace(one.side(work), way=CASADI)
    yield state_by_state(kernel, work)
    given = named(kernel.quantity, work, np.asfortranarray, kernel.dtype)
    out = kernel(**given)
    yield Side(VECTOR, partial(kernel, **given, out=out), lambda: out, contents=BATCH)
    first = np.empty(kernel.robot.n, kernel.dtype)
    states = named(kernel.quantity, work, np.ascontiguousarray, kernel.dtype)
    bound = kernel.bind(**{key: x[0] for key, x in states.items()}, out=first)
    contents = replace(BOUND, loop='Python')
    yield Side(
        FROM_PYTHON, partial(_repeat, bound, work.units), lambda: np.array(out), contents=contents
    )


def _repeat(call: Callable[[], object], times: int) -> None:
    """Call a function again and again: the time of one state does not depend on the state."""
    for _ in range(times):
        call()
