# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Arithmetic limit: the least time in which this processor can execute a batch kernel's operations.

It is measured by a loop that holds the kernel's own mix of operations (`kernel.operations`,
'compiled'), one copy of the mix for each vector register of states, in the kernel's number format
and vector width. The operations act on accumulators in registers, in turn, so that few of them
wait for each other, and the kinds of operations are spread evenly. So the loop is limited by the
throughput of the processor's ports that execute them, and by the supply of instructions.

    share of the limit = time of the loop / time of the kernel

A kernel does more than the loop: it loads states and stores results, checks that inputs are finite
and angles in range, waits for operands, and moves values that do not fit into the registers.

All numbers are read from memory when the loop begins and all accumulators are written when it
ends. No flag lets LLVM reassociate: it can neither drop, merge nor fold an operation.
"""

from __future__ import annotations

from collections.abc import Mapping
import ctypes
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.work import LeftOutError, Side, Work, named
from benchmarks.timing import Pace, Times, interleave
from pfd_core.algorithms.programs import ITERATIVE
from pfd_core.algorithms.quantities import QUANTITIES
from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.module import module
from pfd_core.kernels.codegen.spelling import Format
from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.passes.schedule import LONGEST
from pfd_core.kernels.runtime.jit import compile_ir, simd_width
from pfd_core.kernels.runtime.processor import current

# Operands that all operations share: one number near one, and one near zero.
SHARED = ('one', 'small')
# Numbers lie this close to one, and small ones to zero: nothing overflows in millions of turns.
NEAR = 2.0**-16
# Registers that the compiler needs besides, and accumulators that are enough for four operations a
# cycle that take four cycles each. With AVX-512 the loop of a UR5 took 17.3 ns a state with 6
# accumulators, and 15.9 ns with 16 to 28.
SCRATCH, ENOUGH = 4, 16
# Operations by name that the loop can hold; an accumulator is the first operand of each.
OPERANDS = {
    'add': ('small',),
    'sub': ('small',),
    'mul': ('one',),
    'div': ('one',),
    'fma': ('small', 'one'),
    'sqrt': (),
}


def accumulators() -> int:
    """Return how many accumulators this processor has registers for, with the shared operands."""
    target = current()
    few = target.triple.startswith('x86_64') and target.vector_bits < 512
    return min(ENOUGH, (16 if few else 32) - len(SHARED) - SCRATCH)


def mix(operations: Mapping[str, int]) -> list[str]:
    """Return the names of operations, each as often as it is counted, spread evenly."""
    places = [
        ((k + 0.5) / count, name) for name, count in operations.items() for k in range(count)
    ]
    return [name for _, name in sorted(places)]


def loop_ir(operations: Mapping[str, int], form: Format, chains: int) -> str:
    """
    Return `void @port_limit(i64 count, ptr numbers, ptr results)`: the mix, `count` times.

    A change of sign is part of a multiply-add, as it is in a kernel. `numbers` holds the shared
    vectors and the first values of the accumulators, `chains` many, which `results` receives.
    """
    counts = {name: count for name, count in operations.items() if name != 'neg'}
    signs = operations.get('neg', 0)
    if signs > counts.get('fma', 0):
        raise LeftOutError(f'{signs} changes of sign are more than its multiply-adds')
    unknown = counts.keys() - {*OPERANDS, 'select'}
    if unknown:
        raise LeftOutError(f'no loop for operations {sorted(unknown)}')
    ir = Function('define void @port_limit(i64 %count, ptr %numbers, ptr %results)')
    places = [ir.element(form.type, '%numbers', k) for k in range(len(SHARED) + chains)]
    one, small, *values = [ir.load(form.type, place, form.bytes) for place in places]
    shared = {'one': one, 'small': small}
    totals = [Variable(form.type, value) for value in values]
    with ir.loop('%count', *totals):
        for k, op in enumerate(mix(counts)):
            total = totals[k % chains]
            first = total.value
            if op == 'fma' and signs:
                first = form.operation(ir, 'neg', [first])
                signs -= 1
            others = [first, one] if op == 'select' else [shared[x] for x in OPERANDS[op]]
            total.value = form.operation(ir, op, [first, *others])
    for k, total in enumerate(totals):
        ir.store(form.type, total, ir.element(form.type, '%results', k), form.bytes)
    ir.ret()
    return str(ir)


class Loop:
    """The native loop of a kernel's mix, run once for each vector register of some states."""

    def __init__(self, kernel: Kernel, states: int) -> None:
        if kernel.quantity not in QUANTITIES:
            raise LeftOutError('its operations are in called functions')
        if kernel.method in ITERATIVE:
            raise LeftOutError('it iterates: how often its operations run depends on the state')
        if sum(kernel.operations['compiled'].values()) > LONGEST:
            raise LeftOutError(f'a loop of more than {LONGEST} operations waits for instructions')
        width, chains = simd_width(kernel.dtype), accumulators()
        form = Format(kernel.dtype, width)
        ir = loop_ir(kernel.operations['compiled'], form, chains)
        self._native = compile_ir(module([ir], form, ()))
        self._numbers = numbers(kernel.dtype, width, chains)
        self.results = np.zeros_like(self._numbers[len(SHARED) :])
        kind = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p)
        run = kind(self._native.address('port_limit'))
        arrays = [array.ctypes.data for array in (self._numbers, self.results)]
        self.run = partial(run, -(-states // width), *arrays)


def numbers(dtype: str, width: int, chains: int) -> NDArray[np.floating]:
    """Return the shared operands and the first accumulators, (2 + chains, width)."""
    count = len(SHARED) + chains
    values = NEAR * np.random.default_rng(1).uniform(1, 2, (count, width))
    values[:1] += 1
    values[len(SHARED) :] += 1
    return values.astype(dtype)


def limit_of(kernel: Kernel, work: Work, pace: Pace) -> Times:
    """Return the times of the loop per state, with the share of the limit as `times`."""
    loop = Loop(kernel, work.units)
    given = named(kernel.quantity, work, np.asfortranarray, kernel.dtype)
    out = kernel(**given)
    sides = [
        Side('kernel', partial(kernel, **given, out=out), lambda: out),
        Side('loop', loop.run, partial(np.asarray, loop.results), reference=True),
    ]
    own, limit = interleave(sides, work.units, pace)
    return Times(limit.minimum, limit.median, own.times)
