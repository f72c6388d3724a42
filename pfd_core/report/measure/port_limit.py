# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Port limit: the least time in which this processor can execute the operations of a batch kernel.

It is measured by a loop that holds the kernel's own mix of operations (`kernel.operations`,
'compiled'), one copy of the mix for each vector register of states, in the kernel's number format
and vector width. The operations act on accumulators in registers, in turn, so that few of them
wait for each other, and the kinds of operations are spread evenly. So the loop is limited by the
throughput of the processor's ports that execute them, and by the supply of instructions.

    share of the port limit = time of the loop / time of the kernel

A kernel does more than the loop: it loads states and stores results, checks that inputs are finite
and angles in range, waits for operands, and moves values that do not fit into the registers. A
second loop (`Loop(..., memory=True)`) adds the fewest of these loads and stores
(measure.register_traffic): no order of the kernel's operations can save the time that they add.

All numbers are read from memory when the loop begins and all accumulators are written when it
ends. No flag lets LLVM reassociate: it can neither drop, merge nor fold an operation.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
import ctypes
from functools import partial
import math

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.programs import ITERATIVE
from pfd_core.algorithms.quantities import QUANTITIES
from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.module import module
from pfd_core.kernels.codegen.spelling import Format
from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.passes.schedule import LONGEST
from pfd_core.kernels.runtime.jit import compile_ir, simd_width
from pfd_core.kernels.runtime.processor import current
from pfd_core.report.contenders.work import LeftOutError, Side, Work, named
from pfd_core.report.measure.progress import show_progress
from pfd_core.report.measure.register_traffic import Traffic, traffic
from pfd_core.report.measure.timing import MIDDLE_BATCH, Pace, Row, interleave

WORK = 'port limit'
# Operands that all operations share: one number near one, and one near zero.
SHARED = 2
# Numbers lie this close to one, and small ones to zero: nothing overflows in millions of turns.
NEAR = 2.0**-16
# Registers that the compiler needs besides, and accumulators that are enough for four operations a
# cycle that take four cycles each. With AVX-512 the loop of a UR5 took 17.3 ns a state with 6
# accumulators, and 15.9 ns with 16 to 28.
SCRATCH, ENOUGH = 4, 16
# Copies of each shared operand that are loaded in turn, and places to which accumulators are
# stored in turn. They lie within 4096 bytes: a load waits for a store whose address has the same
# low 12 bits.
SLOTS = 16
# Bytes of a cache line.
LINE = 64
NO_TRAFFIC = Traffic()
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
    return min(ENOUGH, vector_registers() - SHARED - SCRATCH)


def vector_registers() -> int:
    """Return how many vector registers this processor has."""
    target = current()
    return 16 if target.triple.startswith('x86_64') and target.vector_bits < 512 else 32


def mix(operations: Mapping[str, int]) -> list[str]:
    """Return the names of operations, each as often as it is counted, spread evenly."""
    places = [
        ((k + 0.5) / count, name) for name, count in operations.items() for k in range(count)
    ]
    return [name for _, name in sorted(places)]


def loop_ir(
    operations: Mapping[str, int], form: Format, chains: int, memory: Traffic = NO_TRAFFIC
) -> str:
    """
    Return `void @port_limit(i64 count, ptr numbers, ptr results)`: the mix, `count` times.

    Parameters
    ----------
    operations : mapping
        Name to count. A change of sign is part of a multiply-add, as it is in a kernel.
    form : Format
        Number format and width.
    chains : int
        Accumulators.
    memory : Traffic
        Operands that are loaded, and accumulators that are stored, in each turn.

    `numbers` holds SHARED vectors, the first values of the accumulators, and SLOTS copies of the
    shared vectors, from which operands are loaded; `results` receives the accumulators, and then
    has SLOTS vectors for accumulators that are stored.
    """
    counts = {name: count for name, count in operations.items() if name != 'neg'}
    signs = operations.get('neg', 0)
    if signs > counts.get('fma', 0):
        raise LeftOutError(f'{signs} changes of sign are more than its multiply-adds')
    unknown = counts.keys() - {*OPERANDS, 'select'}
    if unknown:
        raise LeftOutError(f'no loop for operations {sorted(unknown)}')
    if memory.loads > SLOTS * memory.stores:
        raise LeftOutError(f'a compiler would keep some of {memory.loads} loads in registers')
    ir = Function('define void @port_limit(i64 %count, ptr %numbers, ptr %results)')
    places = [ir.element(form.type, '%numbers', k) for k in range(SHARED + chains)]
    one, small, *values = [ir.load(form.type, place, form.bytes) for place in places]
    shared = {'one': one, 'small': small}
    totals = [Variable(form.type, value) for value in values]
    names = mix(counts)
    loaded = stored = 0

    def operand_of(name: str, due: int) -> str:
        nonlocal loaded
        if loaded >= due:
            return shared[name]
        # The copies lie in the order of `shared`.
        slot = SHARED + chains + loaded % SLOTS * SHARED + list(shared).index(name)
        loaded += 1
        return ir.load(form.type, ir.element(form.type, '%numbers', slot), form.bytes)

    with ir.loop('%count', *totals):
        for k, op in enumerate(names):
            total = totals[k % chains]
            operand = total.value
            if op == 'fma' and signs:
                operand = form.operation(ir, 'neg', [operand])
                signs -= 1
            due = (k + 1) * memory.loads // len(names)
            operands = (
                [operand, one] if op == 'select' else [operand_of(x, due) for x in OPERANDS[op]]
            )
            total.value = form.operation(ir, op, [operand, *operands])
            if stored < (k + 1) * memory.stores // len(names):
                place = ir.element(form.type, '%results', chains + stored % SLOTS)
                ir.store(form.type, total, place, form.bytes)
                stored += 1
    for k, total in enumerate(totals):
        ir.store(form.type, total, ir.element(form.type, '%results', k), form.bytes)
    ir.ret()
    return str(ir)


class Loop:
    """
    The native loop of a kernel's mix, run once for each vector register of some states.

    With `memory` it also has the loads and stores that the kernel needs, since it has more values,
    inputs and constants than registers.
    """

    def __init__(self, kernel: Kernel, states: int, memory: bool = False) -> None:
        if kernel.quantity not in QUANTITIES:
            raise LeftOutError('its operations are in called functions')
        if kernel.method in ITERATIVE:
            raise LeftOutError('it iterates: how often its operations run depends on the state')
        if sum(kernel.operations['compiled'].values()) > LONGEST:
            raise LeftOutError(f'a loop of more than {LONGEST} operations waits for instructions')
        width, chains = simd_width(kernel.dtype), accumulators()
        form = Format(kernel.dtype, width)
        self.memory = traffic(kernel.program, vector_registers()) if memory else NO_TRAFFIC
        ir = loop_ir(kernel.operations['compiled'], form, chains, self.memory)
        self._native = compile_ir(module([ir], form, ()))
        first = numbers(kernel.dtype, width, chains)
        read = np.concatenate([first, np.tile(first[:SHARED], (SLOTS, 1))])
        self._numbers = _on_whole_lines((len(read) + chains + SLOTS, width), kernel.dtype)
        self._numbers[: len(read)] = read
        self.results = self._numbers[len(read) : len(read) + chains]
        kind = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p)
        run = kind(self._native.address('port_limit'))
        arrays = [array.ctypes.data for array in (self._numbers, self.results)]
        self.run = partial(run, -(-states // width), *arrays)


def _on_whole_lines(shape: tuple[int, int], dtype: str) -> NDArray[np.floating]:
    """Return an array that begins on a cache line, as the stack of a kernel does."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    raw = np.zeros(size + LINE, np.uint8)
    start = -raw.ctypes.data % LINE
    return raw[start : start + size].view(dtype).reshape(shape)


def numbers(dtype: str, width: int, chains: int) -> NDArray[np.floating]:
    """Return the shared operands and the first accumulators, (SHARED + chains, width)."""
    values = NEAR * np.random.default_rng(1).uniform(1, 2, (SHARED + chains, width))
    values[:1] += 1
    values[SHARED:] += 1
    return values.astype(dtype)


def of_kernels(
    kernels: Iterable[tuple[str, Kernel]],
    works: Iterable[Work],
    pace: Pace,
    reasons: dict[str, str],
) -> Iterator[Row]:
    """
    Yield the port limit of named kernels, in the batch whose size is nearest MIDDLE_BATCH.

    Exclusions are added to `reasons`.
    """
    batches = [work for work in works if work.kind == 'batch']
    if not batches:
        return
    work = min(batches, key=lambda work: abs(work.units - MIDDLE_BATCH))
    for name, kernel in kernels:
        show_progress(f'{kernel.robot.name}: port limit of {name}')
        try:
            yield measure(kernel, name, work, pace)
        except LeftOutError as reason:
            reasons[f'port limit of {name}'] = str(reason)


def measure(kernel: Kernel, name: str, work: Work, pace: Pace) -> Row:
    """Return the time of the loop per state of a batch, with the share of the limit as `times`."""
    loop = Loop(kernel, work.units)
    given = named(kernel.quantity, work, np.asfortranarray, kernel.dtype)
    out = kernel(**given)
    sides = [
        Side('kernel', partial(kernel, **given, out=out), lambda: out, reference=True),
        Side('loop', loop.run, partial(np.asarray, loop.results)),
    ]
    _, limit = interleave(sides, work.units, pace)
    # `times` is kernel over loop.
    share = None if limit.times is None else 1 / limit.times
    return Row(kernel.robot.name, kernel.robot.n, WORK, name, limit.minimum, limit.median, share)
