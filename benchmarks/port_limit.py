# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Arithmetic limit: the least time in which this processor can execute a batch kernel's operations.

It is measured by a loop that holds the kernel's own mix of operations (`kernel.operations`,
'compiled'), one copy of the mix for each vector register of states. The operations act on
accumulators in registers, in turn, so that few of them wait for each other, and the kinds of
operations are spread evenly. So the loop is limited by the throughput of the processor's ports
that execute them, and by the supply of instructions.

    share of the limit = time of the loop / time of the kernel

A kernel does more than the loop: it loads states and stores results, checks that inputs are finite
and angles in range, waits for operands, and moves values that do not fit into the registers.

All numbers are read from memory when the loop begins and all accumulators are written when it
ends. No flag lets LLVM reassociate: it can neither drop, merge nor fold an operation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import ctypes
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.ours import arguments
from benchmarks.peers.work import LeftOutError, Side, Work
from benchmarks.timing import Pace, Times, interleave
from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.module import module
from pfd_core.kernels.codegen.spelling import Format
from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.native import compile_ir, current, simd_width
from pfd_core.kernels.schedule import LONGEST

# Operations that the loop can hold; an accumulator is the first operand of each. The others are
# one number near one, and one near zero.
OPERANDS = {
    'add': ('small',),
    'sub': ('small',),
    'mul': ('one',),
    'div': ('one',),
    'fma': ('small', 'one'),
    'sqrt': (),
}
# Numbers lie this close to one, and small ones to zero: nothing overflows in millions of turns.
NEAR = 2.0**-16


def accumulators() -> int:
    """Return how many accumulators leave registers for two operands and the compiler's own."""
    target = current()
    # Four operations a cycle that take four cycles each need 16. With AVX-512 the loop of a UR5
    # took 17.3 ns a state with 6 accumulators, and 15.9 ns with 16 to 28.
    return 10 if target.triple.startswith('x86_64') and target.vector_bits < 512 else 16


def loop_ir(operations: Mapping[str, int], form: Format, chains: int) -> str:
    """
    Return `void @port_limit(i64 count, ptr numbers, ptr results)`: the mix, `count` times.

    A change of sign is part of a multiply-add, as it is in a kernel. `numbers` holds the two
    operands and the first values of the accumulators, `chains` many, which `results` receives.
    """
    counts = {name: count for name, count in operations.items() if name != 'neg'}
    signs = operations.get('neg', 0)
    unknown = counts.keys() - OPERANDS.keys()
    if unknown or signs > counts.get('fma', 0):
        raise LeftOutError(f'no loop for operations {sorted(unknown) or "neg"}')
    ir = Function('define void @port_limit(i64 %count, ptr %numbers, ptr %results)')
    places = [ir.element(form.type, '%numbers', k) for k in range(2 + chains)]
    one, small, *values = [ir.load(form.type, place, form.bytes) for place in places]
    shared = {'one': one, 'small': small}
    totals = [Variable(form.type, value) for value in values]
    spread = sorted(((k + 0.5) / count, op) for op, count in counts.items() for k in range(count))
    with ir.loop('%count', *totals):
        for k, (_, op) in enumerate(spread):
            total = totals[k % chains]
            first = total.value
            if op == 'fma' and signs:
                first = form.operation(ir, 'neg', [first])
                signs -= 1
            total.value = form.operation(ir, op, [first, *(shared[x] for x in OPERANDS[op])])
    for k, total in enumerate(totals):
        ir.store(form.type, total, ir.element(form.type, '%results', k), form.bytes)
    ir.ret()
    return str(ir)


def loop(kernel: Kernel, states: int) -> tuple[Callable[[], object], NDArray[np.floating]]:
    """Return a run of the loop for some states, and its accumulators, (chains, width)."""
    counts, width, chains = kernel.operations['compiled'], simd_width(kernel.dtype), accumulators()
    if sum(counts.values()) > LONGEST:
        raise LeftOutError(f'a loop of more than {LONGEST} operations waits for instructions')
    form = Format(kernel.dtype, width)
    native = compile_ir(module([loop_ir(counts, form, chains)], form, ()), ['port_limit'])
    values = 1 + NEAR * np.random.default_rng(1).uniform(1, 2, (2 + chains, width))
    values[1] -= 1
    numbers = values.astype(kernel.dtype)
    results = numbers[2:].copy()
    kind = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p)
    run = kind(native['port_limit'])
    given = -(-states // width), numbers.ctypes.data_as(ctypes.c_void_p)

    # `native` and the arrays live as long as this function.
    def turn(held: object = native) -> None:
        run(*given, results.ctypes.data)

    return turn, results


def limit_of(kernel: Kernel, work: Work, pace: Pace) -> Times:
    """Return the times of the loop per state, with the share of the limit as `times`."""
    turn, results = loop(kernel, work.units)
    given = arguments(kernel, work, 'F')
    out = kernel(**given)
    sides = [
        Side('kernel', partial(kernel, **given, out=out), lambda: out),
        Side('loop', turn, lambda: results, reference=True),
    ]
    own, limit = interleave(sides, work.units, pace)
    return Times(limit.minimum, limit.median, own.times)
