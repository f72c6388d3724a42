# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of control cycles of one arm: its actuators, then a step, over and over.

    @cycles     all cycles, each with its own commanded efforts

Its arguments are addresses in a block of memory: a caller in Python that runs one cycle a call
would spend more time on passing fifteen pointers than the step takes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pfd_core.algorithms.chain.actuators import MOTOR_ROWS, OUTPUT_ROWS
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

# Addresses in the block before the state's: of the number of substeps, the efforts
# (steps, n), the result (steps, 3, n), the motors (7, n), the targets (2, n), the efforts of the
# cycle before (n,), the counts and the peaks (n,).
HEAD = ('substeps', 'efforts', 'out', 'motors', 'targets', 'before', 'counts', 'peaks')
# Of the counts: cycles in which a limit cut an effort, and in which a joint was too fast; and
# whether the last run ended before a step whose effort jumped by more than it may.
COUNTS = ('saturated', 'fast', 'jumped')
NAN = '0x7FF8000000000000'


def block_names(program: Program, dynamics: Program) -> tuple[str, ...]:
    """Return what the addresses in the block are of, in their order."""
    return (*HEAD, *MOTION, *extra_arguments(dynamics), *further_rows(program))


def cycles(program: Program, dynamics: Program, actuators: Program, form: Format) -> str:
    """
    Return `i64 @cycles(i64 steps, ptr block)`.

    Each cycle computes the acting efforts from a row of efforts by @body_actuators, holds them for
    a step, and writes q, qd and the acting efforts. It ends after the first step whose state is
    not finite, and before a step whose effort jumps, which writes the efforts wanted. The result
    is the number of steps before that.
    """
    n, T = program.lanes, form.type
    ir = Function('define i64 @cycles(i64 %steps, ptr %block)')
    arrays = {
        name: ir.load('ptr', ir.element('ptr', '%block', k))
        for k, name in enumerate(block_names(program, dynamics))
    }
    arrays['qdd'] = ir.array(T, n)
    result = Array(ir.array(T, len(OUTPUT_ROWS) * n))
    ir.store('i64', 0, ir.element('i64', arrays['counts'], COUNTS.index('jumped')))
    finite_steps = Variable('i64', '0')
    more = Variable('i1', 'true')
    with ir.loop('%steps', finite_steps, condition=more) as t:
        effort = ir.element(T, arrays['efforts'], ir.let(f'mul i64 {t}, {n}'))
        given = {**arrays, 'tau': effort}
        ir.call(
            'void',
            'body_actuators',
            pointers([*(given[name] for name in arguments(actuators)), result.address]),
        )
        values = [form.read(ir, result, k) for k in range(len(OUTPUT_ROWS) * n)]
        efforts, excess, wanted, jumps = (values[k : k + n] for k in range(0, len(values), n))
        row = Array(ir.element(T, arrays['out'], ir.let(f'mul i64 {t}, {3 * n}')))
        _end_at_jump(ir, form, arrays, jumps, wanted, row, finite_steps)
        _count(ir, form, arrays, (efforts, excess, wanted))
        for k, value in enumerate(efforts):
            form.write(ir, Array(arrays['tau']), k, value)
        if 'free' in arrays:
            close_brakes(ir, arrays)
        take_steps(ir, arrays['substeps'], program, dynamics, arrays)
        motion = count_finite(ir, finite_steps, t, arrays, n, form)
        for k, value in enumerate([*motion['q'], *motion['qd'], *efforts]):
            form.write(ir, row, k, value)
        more.value = ir.let(f'icmp ugt i64 {finite_steps}, {t}')
    ir.ret('i64', finite_steps)
    return str(ir)


def _free(ir: Function, form: Format, arrays: Mapping[str, str], k: int) -> str:
    """Return an i1: whether joint k is free of its brake."""
    if 'free' not in arrays:
        return 'true'
    free = form.read(ir, Array(arrays['free']), k)
    return ir.let(f'fcmp ogt {form.type} {free}, {form.zero}')


def _end_at_jump(
    ir: Function,
    form: Format,
    arrays: Mapping[str, str],
    jumps: Sequence[str],
    wanted: Sequence[str],
    row: Array,
    finite_steps: Variable,
) -> None:
    """Return if the effort of a free joint jumps; keep the efforts wanted for the next cycle."""
    n, T = len(jumps), form.type
    free = [_free(ir, form, arrays, k) for k in range(n)]
    jumped = 'false'
    for k, jump in enumerate(jumps):
        most = form.read(ir, Array(arrays['motors']), MOTOR_ROWS.index('jump') * n + k)
        beyond = ir.let(f'fcmp ogt {T} {jump}, {most}')
        beyond = ir.let(f'and i1 {beyond}, {free[k]}')
        jumped = ir.let(f'or i1 {jumped}, {beyond}')
    with ir.when(jumped, rarely=True):
        for k, value in enumerate(wanted):
            form.write(ir, row, 2 * n + k, value)
        ir.store('i64', 1, ir.element('i64', arrays['counts'], COUNTS.index('jumped')))
        ir.ret('i64', finite_steps)
    for k, value in enumerate(wanted):
        # The first effort of a joint that comes off its brake may be any.
        kept = ir.let(f'select i1 {free[k]}, {T} {value}, {T} {NAN}')
        form.write(ir, Array(arrays['before']), k, kept)


def _count(
    ir: Function, form: Format, arrays: Mapping[str, str], values: Sequence[Sequence[str]]
) -> None:
    """Count a cycle with limited efforts, and one with joints that are too fast; keep peaks."""
    efforts, excess, wanted = values
    T = form.type
    cut = [
        ir.let(f'fcmp une {T} {acting}, {effort}')
        for acting, effort in zip(efforts, wanted, strict=True)
    ]
    fast = [ir.let(f'fcmp ogt {T} {value}, {form.zero}') for value in excess]
    for name, flags in (('saturated', cut), ('fast', fast)):
        flag = flags[0]
        for other in flags[1:]:
            flag = ir.let(f'or i1 {flag}, {other}')
        with ir.when(flag, rarely=True):
            address = ir.element('i64', arrays['counts'], COUNTS.index(name))
            ir.store('i64', ir.let(f'add i64 {ir.load("i64", address)}, 1'), address)
            for k, value in enumerate(excess if name == 'fast' else ()):
                peak = form.read(ir, Array(arrays['peaks']), k)
                higher = ir.let(f'fcmp ogt {T} {value}, {peak}')
                form.write(ir, Array(arrays['peaks']), k, form.select(ir, higher, value, peak))
