# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of the simulation of one arm: an integrator's step in two loops.

    @step             an integrator's step (pfd_core.kernels.codegen.step)
    @rollout          all steps, each under its own torque
    @accelerations    qdd of states that were written before

A step computes no more than the next state needs. The accelerations at the ends of steps are
computed by @accelerations, only when a caller reads them.
"""

from __future__ import annotations

from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.spelling import Array, Format
from pfd_core.kernels.codegen.step import (
    MOTION,
    close_brakes,
    count_finite,
    evaluate_at,
    extra_arguments,
    further_rows,
    pointers,
    take_steps,
    torque_row,
)
from pfd_core.machine.program import Program


def rollout(program: Program, dynamics: Program, form: Format) -> str:
    """
    Return `i64 @rollout(steps, substeps, q, qd, taus, extra..., further..., out...)`.

    Each of `steps` steps takes one row of `taus` for as many calls of @step as `substeps` points
    to, and writes the motion that it ends with, and the torque, if it is a separate row.
    `further` are the other rows of the state. Braked joints are brought to rest first. The result
    is the number of steps after which the state was finite.
    """
    n, T = program.lanes, form.type
    names = (*MOTION, *extra_arguments(dynamics), *further_rows(program))
    arrays = {name: f'%{name}' for name in names}
    given = [*({**arrays, 'tau': '%taus'}).values()]
    given += [f'%out.{name}' for name in written(program)]
    ir = Function(f'define i64 @rollout(i64 %steps, ptr %substeps, {pointers(given)})')
    arrays['qdd'] = ir.array(T, n)
    finite_steps = Variable(form.index, 'zeroinitializer')
    with ir.loop('%steps', finite_steps) as t:
        row = ir.let(f'mul i64 {t}, {n}')
        arrays['tau'] = ir.element(T, '%taus', row)
        if 'free' in arrays:
            close_brakes(ir, arrays)
        take_steps(ir, '%substeps', program, dynamics, arrays)
        motion = count_finite(ir, finite_steps, t, arrays, n, form)
        for name in written(program):
            out = Array(ir.element(T, f'%out.{name}', row))
            values = motion.get(name) or [form.read(ir, Array(arrays[name]), k) for k in range(n)]
            for k, value in enumerate(values):
                form.write(ir, out, k, value)
    ir.ret('i64', finite_steps)
    return str(ir)


def written(program: Program) -> tuple[str, ...]:
    """Return the rows that @rollout writes after each step: those from which qdd follows."""
    return tuple(name for name in (*MOTION, torque_row(program)) if name in program.outputs)


def accelerations(dynamics: Program, form: Format) -> str:
    """Return `void @accelerations(steps, qs, qds, taus, extra..., qdds)` of states in rows."""
    n = dynamics.inputs['q']
    arrays = {name: f'%{name}' for name in (*MOTION, *extra_arguments(dynamics), 'qdd')}
    moving = {name: f'%{name}s' for name in (*MOTION, 'tau', 'qdd')}
    given = pointers((arrays | moving).values())
    ir = Function(f'define void @accelerations(i64 %steps, {given})')
    with ir.loop('%steps') as t:
        row = ir.let(f'mul i64 {t}, {n}')
        rows = {name: ir.element(form.type, array, row) for name, array in moving.items()}
        evaluate_at(ir, dynamics, arrays | rows)
    ir.ret()
    return str(ir)
