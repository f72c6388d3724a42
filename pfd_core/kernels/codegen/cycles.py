# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of control cycles of one arm: the limits of its motors, then a step, over and over.

    @cycles     all cycles, each with its own commanded efforts

Its arguments are addresses in a block of memory: a caller in Python that runs one cycle a call
would spend more time on handing over fifteen pointers than the arm takes to move.
"""

from __future__ import annotations

from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.spelling import Array, Format, arguments
from pfd_core.kernels.codegen.step import (
    MOTION,
    close_brakes,
    count_finite,
    extra_arguments,
    further_rows,
    pointers,
    take_steps,
)
from pfd_core.machine.program import Program

# Addresses in the block before those of the state: of the number of substeps, the efforts
# (steps, n), the result (steps, 3, n), the motors (4, n), the counts and the peaks (n,).
HEAD = ('substeps', 'efforts', 'out', 'motors', 'counts', 'peaks')
# Of the counts: cycles in which a limit cut an effort, and in which a joint was too fast.
COUNTS = ('saturated', 'fast')


def block_names(program: Program, dynamics: Program) -> tuple[str, ...]:
    """Return what the addresses in the block are of, in their order."""
    return (*HEAD, *MOTION, *extra_arguments(dynamics), *further_rows(program))


def cycles(program: Program, dynamics: Program, limits: Program, form: Format) -> str:
    """
    Return `i64 @cycles(i64 steps, ptr block)`.

    Each cycle limits a row of efforts by @body_limits at the velocities of the state, holds the
    result for a step, and writes q, qd and the limited efforts. It ends after the first step
    whose state is not finite; the result is the number of steps before that.
    """
    n, T = program.lanes, form.type
    ir = Function('define i64 @cycles(i64 %steps, ptr %block)')
    arrays = {
        name: ir.load('ptr', ir.element('ptr', '%block', k))
        for k, name in enumerate(block_names(program, dynamics))
    }
    arrays['qdd'] = ir.array(T, n)
    limited = Array(ir.array(T, 2 * n))
    finite_steps = Variable('i64', '0')
    more = Variable('i1', 'true')
    with ir.loop('%steps', finite_steps, condition=more) as t:
        wanted = Array(ir.element(T, arrays['efforts'], ir.let(f'mul i64 {t}, {n}')))
        given = {**arrays, 'tau': wanted.address}
        ir.call(
            'void',
            'body_limits',
            pointers([*(given[name] for name in arguments(limits)), limited.address]),
        )
        _count(ir, form, n, wanted, limited, arrays)
        efforts = [form.read(ir, limited, k) for k in range(n)]
        for k, effort in enumerate(efforts):
            form.write(ir, Array(arrays['tau']), k, effort)
        if 'free' in arrays:
            close_brakes(ir, arrays)
        take_steps(ir, arrays['substeps'], program, dynamics, arrays)
        motion = count_finite(ir, finite_steps, t, arrays, n, form)
        row = Array(ir.element(T, arrays['out'], ir.let(f'mul i64 {t}, {3 * n}')))
        for k, value in enumerate([*motion['q'], *motion['qd'], *efforts]):
            form.write(ir, row, k, value)
        more.value = ir.let(f'icmp ugt i64 {finite_steps}, {t}')
    ir.ret('i64', finite_steps)
    return str(ir)


def _count(
    ir: Function, form: Format, n: int, wanted: Array, limited: Array, arrays: dict[str, str]
) -> None:
    """Count a cycle with limited efforts, and one with joints that are too fast; keep peaks."""
    cut, fast = [], []
    for k in range(n):
        effort, acting = (form.read(ir, x, k) for x in (wanted, limited))
        cut.append(ir.let(f'fcmp une {form.type} {effort}, {acting}'))
        excess = form.read(ir, limited, n + k)
        fast.append(ir.let(f'fcmp ogt {form.type} {excess}, {form.zero}'))
    for place, flags in enumerate((cut, fast)):
        flag = flags[0]
        for other in flags[1:]:
            flag = ir.let(f'or i1 {flag}, {other}')
        with ir.when(flag, rarely=True):
            address = ir.element('i64', arrays['counts'], place)
            count = ir.load('i64', address)
            ir.store('i64', ir.let(f'add i64 {count}, 1'), address)
            for k in range(n if flags is fast else 0):
                excess = form.read(ir, limited, n + k)
                peak = form.read(ir, Array(arrays['peaks']), k)
                higher = ir.let(f'fcmp ogt {form.type} {excess}, {peak}')
                highest = form.select(ir, higher, excess, peak)
                form.write(ir, Array(arrays['peaks']), k, highest)
