# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of a simulation in native code: an integrator's step around @evaluate, in two loops.

    @step             an integrator's step (pfd_core.kernels.codegen.step)
    @rollout          all steps, with the torque that each is given
    @accelerations    qdd of states that were written before

A step computes no more than the next state needs. What an acceleration was at its end is found by
@accelerations when somebody asks.
"""

from __future__ import annotations

from collections.abc import Iterator

from pfd_core.kernels.codegen.spelling import Format
from pfd_core.kernels.codegen.step import (
    REPORT,
    STATE,
    finite,
    goes_on,
    held,
    pointers,
    stop,
    write,
)
from pfd_core.machine.program import Program


def rollout(program: Program, dynamics: Program, form: Format) -> str:
    """
    Return `i64 @rollout(steps, substeps, q, qd, taus, held..., out.q, out.qd)`.

    Each of `steps` steps holds one row of `taus` for `substeps` calls of @step, and writes the
    state it reaches. Joints whose element of `free` is zero are stopped first. The result is
    the number of steps after which the state was finite.
    """
    n = program.lanes
    parameters = ', '.join(
        [
            f'i64 %steps, i64 %substeps, {pointers(STATE)}',
            f'ptr %taus{held(dynamics, tau=False)}',
            pointers(tuple(f'out.{name}' for name in STATE)),
        ]
    )
    lines = [
        f'define i64 @rollout({parameters}) {{',
        'entry:',
        f'  %qdd = alloca [{n} x {form.type}], align 64',
        '  br label %outer',
        'outer:',
        '  %t = phi i64 [ 0, %entry ], [ %t.next, %finished ]',
        '  %sound = phi i64 [ 0, %entry ], [ %sound.next, %finished ]',
        f'  %offset = mul i64 %t, {n}',
        f'  %tau = getelementptr {form.type}, ptr %taus, i64 %offset',
        *(line for k in range(n) if 'free' in dynamics.inputs for line in stop(k, form)),
    ]
    if goes_on(program):
        lines.append(f'  call void @evaluate({pointers(STATE)}{held(dynamics)}, ptr %qdd)')
    lines += [
        '  br label %inner',
        'inner:',
        '  %s = phi i64 [ 0, %outer ], [ %s.next, %inner ]',
        f'  call void @step({pointers(REPORT)}{held(dynamics)})',
        '  %s.next = add i64 %s, 1',
        '  %s.more = icmp ult i64 %s.next, %substeps',
        '  br i1 %s.more, label %inner, label %finished',
        'finished:',
        *finite(n, form),
        *(line for name in STATE for line in _kept(name, n, form)),
        '  %in.order = icmp eq i64 %sound, %t',
        '  %counts = and i1 %in.order, %finite',
        '  %one = zext i1 %counts to i64',
        '  %sound.next = add i64 %sound, %one',
        '  %t.next = add i64 %t, 1',
        '  %t.more = icmp ult i64 %t.next, %steps',
        '  br i1 %t.more, label %outer, label %done',
        'done:',
        '  ret i64 %sound.next',
        '}',
    ]
    return '\n'.join(lines)


def _kept(name: str, n: int, form: Format) -> Iterator[str]:
    """Yield the lines that write a part of the state, which `finite` has read."""
    yield f'  %{name}.row = getelementptr {form.type}, ptr %out.{name}, i64 %offset'
    for k in range(n):
        yield from write(f'{name}.row', k, f'%{name}.w{k}', f'{name}.row{k}', form)


def accelerations(dynamics: Program, form: Format) -> str:
    """Return `void @accelerations(steps, q, qd, taus, held..., out)` of states in rows."""
    n = dynamics.inputs['q']
    moved = (*STATE, 'tau', 'out')
    lines = [
        f'define void @accelerations(i64 %steps, {pointers(("qs", "qds", "taus"))}'
        f'{held(dynamics, tau=False)}, ptr %outs) {{',
        'entry:',
        '  br label %loop',
        'loop:',
        '  %t = phi i64 [ 0, %entry ], [ %t.next, %loop ]',
        f'  %offset = mul i64 %t, {n}',
        *(f'  %{name} = getelementptr {form.type}, ptr %{name}s, i64 %offset' for name in moved),
        f'  call void @evaluate({pointers(STATE)}{held(dynamics)}, ptr %out)',
        '  %t.next = add i64 %t, 1',
        '  %t.more = icmp ult i64 %t.next, %steps',
        '  br i1 %t.more, label %loop, label %done',
        'done:',
        '  ret void',
        '}',
    ]
    return '\n'.join(lines)
