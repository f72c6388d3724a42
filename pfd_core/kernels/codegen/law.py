# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of a law of feedback: what the state adds to the torques of a step, for `width` arms.

    joint by joint    tau + kp (q_ref - q) + kd (qd_ref - qd), summed from the left
    whole state       tau_i + sum over j of gain_ij e_j, summed from the left,
                      e = (q_ref - q, qd_ref - qd)

The gains of a whole state may be another matrix for each arm and each step. They are read where
they are, one number of `width` arms at a time: a copy of them all would not fit on the stack of a
long chain.
"""

from __future__ import annotations

from collections.abc import Iterator

from pfd_core.kernels.codegen.spelling import Format, splat
from pfd_core.kernels.codegen.step import STATE, read, write

REFERENCES = tuple(f'{name}.ref' for name in STATE)
GAINS = ('kp', 'kd')
MATRIX = 'gain'
# What the number of a law stands for.
NONE, JOINTS, WHOLE = range(3)


def errors(n: int, form: Format) -> Iterator[str]:
    """Yield the lines that leave reference minus state in %error, (2 n,)."""
    for part, (name, reference) in enumerate(zip(STATE, REFERENCES, strict=True)):
        for k in range(n):
            e = f'{name}.e{k}'
            yield from read(f'%{name}.x{k}', name, k, form)
            yield from read(f'%{reference}.x{k}', reference, k, form)
            yield f'  %{e} = fsub {form.type} %{reference}.x{k}, %{name}.x{k}'
            yield from write('error', part * n + k, f'%{e}', e, form)


def joint_by_joint(n: int, form: Format) -> Iterator[str]:
    """Yield the lines that add to %tau what each joint's own error asks for."""
    T = form.type
    for k in range(n):
        for name in ('tau', *GAINS):
            yield from read(f'%{name}.x{k}', name, k, form)
        yield f'  %p{k} = fmul {T} %kp.x{k}, %q.e{k}'
        yield f'  %d{k} = fmul {T} %kd.x{k}, %qd.e{k}'
        yield f'  %sum{k} = fadd {T} %tau.x{k}, %p{k}'
        yield f'  %law{k} = fadd {T} %sum{k}, %d{k}'
        yield from write('tau', k, f'%law{k}', f'tau{k}', form)


def whole_state(n: int, form: Format) -> str:
    """
    Return `void @whole_state(tau, error, gain, arm, column, b, last)`.

    It adds to `tau`, (n,), the product of each arm's matrix, (n, 2 n) with `column` bytes from
    number to number, and `error`. Arm k has its matrix k `arm` bytes behind that of arm 0; arms
    beyond `last` use its.
    """
    T, W = form.type, form.width
    lanes = ', '.join(f'i64 {lane}' for lane in range(W))
    suffix = f'{form.suffix}.v{W}p0'
    return f"""declare <{W} x i64> @llvm.umin.v{W}i64(<{W} x i64>, <{W} x i64>)
define internal void @whole_state(ptr %tau, ptr %error, ptr %gain, i64 %arm, i64 %column, i64 %b, \
i64 %last) {{
entry:
  %room = sub i64 %last, %b
{splat('room', W)}
{splat('arm', W)}
  %there = call <{W} x i64> @llvm.umin.v{W}i64(<{W} x i64> <{lanes}>, <{W} x i64> %room.all)
  %offsets = mul <{W} x i64> %there, %arm.all
  %far = mul i64 %b, %arm
  %first = getelementptr i8, ptr %gain, i64 %far
  br label %row
row:
  %i = phi i64 [ 0, %entry ], [ %i.next, %written ]
  %at = phi ptr [ %first, %entry ], [ %at.next, %written ]
  %tau.at = getelementptr {T}, ptr %tau, i64 %i
  %before = load {T}, ptr %tau.at, align {form.bytes}
  br label %number
number:
  %j = phi i64 [ 0, %row ], [ %j.next, %number ]
  %here = phi ptr [ %at, %row ], [ %at.next, %number ]
  %sum = phi {T} [ %before, %row ], [ %sum.next, %number ]
  %places = getelementptr i8, ptr %here, <{W} x i64> %offsets
  %g = call {T} @llvm.masked.gather.{suffix}(<{W} x ptr> align {form.bytes} %places, \
<{W} x i1> splat (i1 true), {T} poison)
  %error.at = getelementptr {T}, ptr %error, i64 %j
  %e = load {T}, ptr %error.at, align {form.bytes}
  %product = fmul {T} %g, %e
  %sum.next = fadd {T} %sum, %product
  %at.next = getelementptr i8, ptr %here, i64 %column
  %j.next = add i64 %j, 1
  %j.more = icmp ult i64 %j.next, {2 * n}
  br i1 %j.more, label %number, label %written
written:
  store {T} %sum.next, ptr %tau.at, align {form.bytes}
  %i.next = add i64 %i, 1
  %i.more = icmp ult i64 %i.next, {n}
  br i1 %i.more, label %row, label %done
done:
  ret void
}}"""
