# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of a feedback law: torques that depend on the state, added to a step's, for `width` arms.

    joint by joint    tau + kp (q_ref - q) + kd (qd_ref - qd), summed from the left
    whole state       tau_i + sum over j of gain_ij e_j, summed from the left,
                      e = (q_ref - q, qd_ref - qd)

The matrix of a whole state may differ for each arm and each step. It is read in place, one number
of `width` arms at a time: a copy would not fit on the stack of a long chain.
"""

from __future__ import annotations

from collections.abc import Mapping

from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.copies import gather, lane_numbers
from pfd_core.kernels.codegen.spelling import Array, Format
from pfd_core.kernels.codegen.step import MOTION

REFERENCES = tuple(f'{name}.ref' for name in MOTION)
GAINS = ('kp', 'kd')
MATRIX = 'gain'
# Numbers of the laws, a parameter of @ensemble.
NONE, JOINTS, WHOLE = range(3)


def state_errors(ir: Function, arrays: Mapping[str, Array], n: int, form: Format) -> list[str]:
    """Return reference minus state, (2 n,)."""
    values = []
    for name, reference in zip(MOTION, REFERENCES, strict=True):
        for k in range(n):
            state = form.read(ir, arrays[name], k)
            wanted = form.read(ir, arrays[reference], k)
            values.append(ir.let(f'fsub {form.type} {wanted}, {state}'))
    return values


def joint_by_joint(
    ir: Function, arrays: Mapping[str, Array], errors: list[str], n: int, form: Format
) -> None:
    """Add to `tau` the gains of each joint times the errors of that joint."""
    T = form.type
    for k in range(n):
        total, kp, kd = (form.read(ir, arrays[name], k) for name in ('tau', *GAINS))
        for gain, error in ((kp, errors[k]), (kd, errors[n + k])):
            product = ir.let(f'fmul {T} {gain}, {error}')
            total = ir.let(f'fadd {T} {total}, {product}')
        form.write(ir, arrays['tau'], k, total)


def whole_state(n: int, form: Format) -> str:
    """
    Return `void @whole_state(tau, error, gain, arm, column, b, last)`.

    It adds to `tau`, (n,), the product of each arm's matrix, (n, 2 n) with `column` bytes from
    number to number, and `error`. The matrix of arm k lies k `arm` bytes behind the matrix of arm
    0; arms beyond `last` use the matrix of arm `last`.
    """
    T, W = form.type, form.width
    lanes, umin = form.index, f'llvm.umin.v{W}i64'
    ir = Function(
        'define internal void @whole_state(ptr %tau, ptr %error, ptr %gain, i64 %arm, '
        'i64 %column, i64 %b, i64 %last)'
    )
    declared = ''
    if W > 1:
        declared = f'declare {lanes} @{umin}({lanes}, {lanes})\n'
        limit = form.splat(ir, ir.let('sub i64 %last, %b'))
        arm = ir.call(lanes, umin, f'{lanes} {lane_numbers(W)}', f'{lanes} {limit}')
        offsets = ir.let(f'mul {lanes} {arm}, {form.splat(ir, "%arm")}')
    here = Variable('ptr', ir.offset('%gain', '%b', '%arm'))
    with ir.loop(n, here) as i:
        tau = ir.element(T, '%tau', i)
        total = Variable(T, ir.load(T, tau, form.bytes))
        with ir.loop(2 * n, here, total) as j:
            if W > 1:
                places = ir.let(f'getelementptr i8, ptr {here}, {lanes} {offsets}')
                gain = gather(ir, form, places)
            else:
                gain = ir.load(T, here.value, form.bytes)
            error = ir.load(T, ir.element(T, '%error', j), form.bytes)
            product = ir.let(f'fmul {T} {gain}, {error}')
            total.value = ir.let(f'fadd {T} {total}, {product}')
            here.value = ir.offset(here.value, '%column')
        ir.store(T, total, tau, form.bytes)
    ir.ret()
    return f'{declared}{ir}'
