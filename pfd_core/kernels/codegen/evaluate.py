# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of @evaluate: @body, with angles beyond the range of the sine brought back first.

That an arm has turned a joint 16 000 times is rare: it costs a kernel a multiplication per joint
and one comparison, and the way back is kept out of the way.
"""

from __future__ import annotations

from collections.abc import Sequence

from pfd_core.kernels.codegen.spelling import SUFFIX, Format, arguments
from pfd_core.kernels.passes.sincos import WRAP_LIMIT
from pfd_core.machine.program import Program


def evaluate(program: Program, form: Format, angles: Sequence[int]) -> str:
    """Return `void @evaluate(inputs..., out)`; `angles` are the elements of q that are turned."""
    names = (*arguments(program), 'out')
    parameters = form.pointers(names)
    head = f'define void @evaluate({parameters}) {{\nentry:'
    if not angles:
        return f'{head}\n  call void @body({parameters})\n  ret void\n}}'
    n, T = program.inputs['q'], form.type
    lines = [head, f'  %copy = alloca [{n} x {T}], align 64']
    # Where no sum of squares is beyond the limit, no angle is; one that is no number is looked at.
    total = form.constant(0.0)
    for k in angles:
        lines += [
            *form.element('%p', 'q', k),
            f'  %x{k} = load {T}, ptr %p{k}, align {form.bytes}',
            f'  %s{k} = call {T} @llvm.fma.{form.suffix}({T} %x{k}, {T} %x{k}, {T} {total})',
        ]
        total = f'%s{k}'
    limit = form.constant(WRAP_LIMIT**2)
    lines.append(f'  %beyond = fcmp ugt {T} {total}, {limit}')
    far = '%beyond'
    if form.width > 1:
        reduce = f'@llvm.vector.reduce.or.v{form.width}i1'
        lines.append(f'  %far = call i1 {reduce}({form.flag} %beyond)')
        far = '%far'
    lines += [f'  br i1 {far}, label %wrap, label %go, !prof !0', 'wrap:']
    for k in range(n):
        lines += [
            *form.element('%w', 'q', k),
            f'  %y{k} = load {T}, ptr %w{k}, align {form.bytes}',
            f'  %r{k} = getelementptr {T}, ptr %copy, i64 {k}',
            f'  store {T} %y{k}, ptr %r{k}, align {form.bytes}',
        ]
        if k in angles:
            lines.append(f'  call void @wrap_row(ptr %r{k})')
    lines += [
        '  br label %go',
        'go:',
        '  %use = phi ptr [ %q, %entry ], [ %copy, %wrap ]',
    ]
    if form.strided:
        beside = form.bytes * form.width
        lines.append(f'  %use.stride = phi i64 [ %q.stride, %entry ], [ {beside}, %wrap ]')
    used = form.pointers(['use' if name == 'q' else name for name in names])
    lines += [f'  call void @body({used})', '  ret void', '}']
    return '\n'.join([*lines, _wrap_row(form)])


def _wrap_row(form: Format) -> str:
    """Return `void @wrap_row(ptr)`: bring back those of `width` angles that are beyond range."""
    S = form.scalar
    widen, narrow = '%x', '%y'
    extra = ['', '']
    if S == 'float':
        widen, narrow = '%wide', '%narrow'
        extra = [
            '  %wide = fpext float %x to double\n',
            '  %narrow = fptrunc double %y to float\n',
        ]
    return f"""define internal void @wrap_row(ptr %row) cold noinline {{
entry:
  br label %loop
loop:
  %i = phi i64 [ 0, %entry ], [ %next, %tail ]
  %p = getelementptr {S}, ptr %row, i64 %i
  %x = load {S}, ptr %p
  %a = call {S} @llvm.fabs.{SUFFIX[form.dtype]}({S} %x)
  %far = fcmp ogt {S} %a, {form.number(WRAP_LIMIT)}
  br i1 %far, label %wrap, label %tail
wrap:
{extra[0]}  %y = call double @wrap_angle(double {widen})
{extra[1]}  store {S} {narrow}, ptr %p
  br label %tail
tail:
  %next = add i64 %i, 1
  %more = icmp ult i64 %next, {form.width}
  br i1 %more, label %loop, label %done
done:
  ret void
}}"""
