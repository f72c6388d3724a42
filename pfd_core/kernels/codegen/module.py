# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Module of LLVM IR of the linearised steps of an integrator."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from pfd_core.kernels.codegen.evaluate import wrap_row
from pfd_core.kernels.codegen.linear_step import ANGLE_LIMIT, linear_step, linearisation
from pfd_core.kernels.codegen.product import factors_body, jacobian, vector_widths
from pfd_core.kernels.codegen.spelling import Format
from pfd_core.kernels.sines import WRAP_LIMIT, wrap_angle
from pfd_core.machine.program import Program

INTRINSICS = {'sqrt': 1, 'fabs': 1, 'fma': 3}  # and their operands


def linear_module(
    step_program: Program,
    dynamics: Mapping[str, Program],
    substeps: int,
    dtype: str,
    angles: Sequence[int],
    periodic: bool,
) -> str:
    """
    Return the module with @evaluate of the linearised steps of an integrator.

    `dynamics` are programs of factors, of the derivatives of the functions that the step calls;
    `periodic` states whether the angles enter only by sine and cosine.
    """
    inner, form = Format(dtype, 1), Format(dtype, 1, strided=True)
    limit = ANGLE_LIMIT if periodic else WRAP_LIMIT
    functions = [wrap_row(inner, limit)] if angles else []
    for name, program in dynamics.items():
        functions += [factors_body(program, inner, f'_{name}')]
        functions += [jacobian(program, inner, angles, f'_{name}')]
    functions.append(linear_step(step_program, dynamics, inner))
    turning = angles if periodic else ()
    functions.append(linearisation(step_program, dynamics, form, substeps, turning))
    functions.append('declare i64 @llvm.usub.sat.i64(i64, i64)')
    return module(functions, form, angles, vector_widths(inner), limit)


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
