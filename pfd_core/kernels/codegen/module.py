# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Whole modules of LLVM IR: the functions of a kernel, and their declarations.

    kernel_module      one state or a batch, called from Python
    product_module     the same, of a result that is a product of a program's outputs
    linear_module      the same, of the linearised steps of an integrator

What only one kind of module has is imported when such a module is first written.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
import math

from pfd_core.forking import no_fork
from pfd_core.kernels.codegen.body import body
from pfd_core.kernels.codegen.evaluate import evaluate, wrap_row
from pfd_core.kernels.codegen.python_entry import batch_entry_ir, entry_ir
from pfd_core.kernels.codegen.spelling import Format
from pfd_core.kernels.sines import WRAP_LIMIT, wrap_angle
from pfd_core.machine.program import Program

INTRINSICS = {'sqrt': 1, 'fabs': 1, 'fma': 3}  # and their operands


def kernel_module(program: Program, dtype: str, width: int, angles: Sequence[int]) -> str:
    """
    Return the module of a kernel: of one state for width 1, of a batch for larger ones.

    Parameters
    ----------
    program : Program
        A lowered program with one output.
    dtype : str
        Number format.
    width : int
        States in a vector register.
    angles : sequence of int
        Elements of q that are turned; without any, no angle is wrapped.

    """
    form = Format(dtype, width, strided=width > 1)
    (output,) = program.outputs.values()
    functions = [body(program, form), evaluate(program, form, angles)]
    return module([*functions, *_entries(program, form, output.shape)], form, angles)


def product_module(program: Program, dtype: str, width: int, angles: Sequence[int]) -> str:
    """Return the module of a kernel whose result is the product of its program's outputs."""
    with no_fork:
        from pfd_core.kernels.codegen.product import product, vector_widths

    form, n = Format(dtype, width, strided=width > 1), program.inputs['q']
    functions = product(program, form, angles)
    entries = _entries(program, form, (n, 3 * n))
    return module([functions, *entries], form, angles, vector_widths(form))


def linear_module(
    step_program: Program,
    dynamics: Mapping[str, Program],
    substeps: int,
    dtype: str,
    width: int,
    angles: Sequence[int],
    periodic: bool,
) -> str:
    """
    Return the module of a kernel of the linearised steps of an integrator.

    `dynamics` are programs of factors, of the derivatives of the functions that the step calls;
    `periodic` states whether the angles enter only by sine and cosine.
    """
    with no_fork:
        from pfd_core.kernels.codegen.linear_step import (
            ANGLE_LIMIT,
            linear_step,
            linearisation,
            state_rows,
        )
        from pfd_core.kernels.codegen.product import factors_body, jacobian, vector_widths

    inner, form = Format(dtype, width), Format(dtype, width, strided=width > 1)
    limit = ANGLE_LIMIT if periodic else WRAP_LIMIT
    functions = [wrap_row(inner, limit)] if angles else []
    inputs: dict[str, int] = {}
    for name, program in dynamics.items():
        functions += [factors_body(program, inner, f'_{name}')]
        functions += [jacobian(program, inner, angles, f'_{name}')]
        inputs |= program.inputs
    functions.append(linear_step(step_program, dynamics, inner))
    turning = angles if periodic else ()
    functions.append(linearisation(step_program, dynamics, form, substeps, turning))
    n, rows = step_program.lanes, len(state_rows(step_program))
    signature = Program(1, (), inputs, {})
    entries = _entries(signature, form, (n * rows, n * (rows + 1) + 1))
    return module([*functions, *entries], form, angles, vector_widths(inner), limit)


def _entries(program: Program, form: Format, shape: Sequence[int]) -> list[str]:
    """Return the functions that Python calls, around @evaluate with a result of a shape."""
    size = math.prod(shape)
    if form.width == 1:
        return [entry_ir(program, form.dtype, shape)]
    with no_fork:
        from pfd_core.kernels.codegen.chunks import batch_of

    return [batch_of(program, form, size), batch_entry_ir(program, form.dtype, size)]


def module(
    parts: Sequence[str],
    form: Format,
    angles: Sequence[int],
    widths: Collection[int] = (),
    limit: float = WRAP_LIMIT,
) -> str:
    """
    Return functions of one format with the declarations they need; `angles` as above.

    `widths` are the widths of further registers that the functions compute with, `limit` is the
    angle that @wrap_angle returns as it is [rad].
    """
    declarations = ['declare i64 @llvm.umin.i64(i64, i64)']
    for own in (Format(form.dtype, width) for width in {1, form.width, *widths}):
        declarations += _intrinsics(own)
    # An angle that has to be wrapped is rare: its branch is laid out of the way.
    metadata = '!0 = !{!"branch_weights", i32 1, i32 10000}'
    wrap = [wrap_angle(limit)] if angles else []
    return '\n\n'.join([*parts, *wrap, *sorted(set(declarations)), metadata])


def _intrinsics(form: Format) -> list[str]:
    """Return the declarations of the intrinsics that functions of one width may call."""
    declarations = [
        f'declare {form.type} @llvm.{name}.{form.suffix}({", ".join([form.type] * operands)})'
        for name, operands in INTRINSICS.items()
    ]
    if form.width == 1:
        return declarations
    places, on = f'<{form.width} x ptr>', f'<{form.width} x i1>'
    gather = f'{form.suffix}.v{form.width}p0'
    return [
        *declarations,
        f'declare i1 @llvm.vector.reduce.or.v{form.width}i1({form.flag})',
        f'declare {form.type} @llvm.masked.gather.{gather}({places}, {on}, {form.type})',
        f'declare void @llvm.masked.scatter.{gather}({form.type}, {places}, {on})',
    ]
