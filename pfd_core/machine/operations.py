# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The closed table of operations: meaning, LLVM spelling and cost column of each.

A program consists of these operations. The emulator reads the column `meaning`, the kernels read
`llvm`, the step counts read `cost`, derivatives read `tangent` and `adjoint`; a new operation is a
new row here and nowhere else.

Every meaning is a correctly rounded IEEE 754 operation, except `sin` and `cos`: a kernel
replaces these two by the other rows before it is compiled (pfd_core.kernels.sines).

Rules of derivatives are formulas on values with `+ - *`: z is the result of the operation, a, b
and c its operands, da, db and dc their tangents, g the adjoint of z. A tangent that is known to be
zero is the number 0.0; z.apply records any other operation (pfd_core.machine.recorder). Equal
expressions are recorded once: all tangents of a quotient share 1 / b. Source: Griewank and
Walther, Evaluating Derivatives, 2nd ed. 2008, chapters 2 and 3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pfd_core.machine.fused import fused


@dataclass(frozen=True)
class Operation:
    """
    One row of the table.

    Attributes
    ----------
    name : str
        Name in a program.
    arity : int
        Number of registers that it reads; -1 if that varies.
    cost : str or None
        Column of the step counts; None is free (data moved within a lane, a lane switched off,
        a sign bit changed).
    meaning : callable or None
        The operation on NumPy arrays; None where the emulator supplies it (data movement).
    llvm : str or None
        LLVM instruction on operands `{0}`, `{1}`, ... of type `{type}`, whose name in intrinsics
        is `{suffix}`; None where the kernel writer supplies it or no kernel has the operation.
    tangent : callable or None
        Tangent of the result from (z, operands, tangents of the operands); None where the
        operation has no rule, and its derivative is refused.
    adjoint : tuple of callable
        For each operand its share of the adjoint, from (z, operands, g).
    conditions : int
        Number of first operands that choose between the others. They have no derivative: the
        rules take no tangent for them and give no adjoint.

    """

    name: str
    arity: int
    cost: str | None = None
    meaning: Callable[..., Any] | None = None
    llvm: str | None = None
    tangent: Callable[..., Any] | None = None
    adjoint: tuple[Callable[..., Any], ...] = ()
    conditions: int = 0


def _product(a: Any, b: Any, da: Any, db: Any, dc: Any = 0.0) -> Any:
    """Return the tangent of a b + c; of a square it is (2 a) da + dc, and tangents share 2 a."""
    return dc + (a + a) * da if a is b else (dc + da * b) + a * db


def _first_factor(z: Any, a: Any, b: Any, g: Any) -> Any:
    """Return the first factor's share of the adjoint of a product; of a square, the whole."""
    return g * (a + a) if a is b else g * b


def _second_factor(z: Any, a: Any, b: Any, g: Any) -> Any:
    """Return the second factor's share of the adjoint of a product; of a square, nothing."""
    return 0.0 if a is b else g * a


def _reciprocal(z: Any, b: Any) -> Any:
    return z.apply('div', 1.0, b)


def _slope_of_root(z: Any) -> Any:
    return z.apply('div', 0.5, z)


OPERATIONS = {
    operation.name: operation
    for operation in (
        Operation('input', 0),
        Operation('constant', 0),
        # Lane i takes the value of a given lane, or lane i of the second operand.
        Operation('route', 2, 'routes'),
        # The second operand where the first is above zero, else the third.
        Operation(
            'select',
            3,
            None,
            lambda condition, chosen, other: np.where(condition > 0, chosen, other),
            tangent=lambda z, c, a, b, da, db: z.apply('select', c, da, db),
            adjoint=(
                lambda z, c, a, b, g: z.apply('select', c, g, 0.0),
                lambda z, c, a, b, g: z.apply('select', c, 0.0, g),
            ),
            conditions=1,
        ),
        Operation(
            'add',
            2,
            'additions',
            np.add,
            'fadd {type} {0}, {1}',
            tangent=lambda z, a, b, da, db: da + db,
            adjoint=(lambda z, a, b, g: g, lambda z, a, b, g: g),
        ),
        Operation(
            'sub',
            2,
            'additions',
            np.subtract,
            'fsub {type} {0}, {1}',
            tangent=lambda z, a, b, da, db: da - db,
            adjoint=(lambda z, a, b, g: g, lambda z, a, b, g: -g),
        ),
        Operation(
            'mul',
            2,
            'multiplications',
            np.multiply,
            'fmul {type} {0}, {1}',
            tangent=lambda z, a, b, da, db: _product(a, b, da, db),
            adjoint=(_first_factor, _second_factor),
        ),
        Operation(
            'div',
            2,
            'divisions',
            np.divide,
            'fdiv {type} {0}, {1}',
            tangent=lambda z, a, b, da, db: da * _reciprocal(z, b) - (z * _reciprocal(z, b)) * db,
            adjoint=(
                lambda z, a, b, g: g * _reciprocal(z, b),
                lambda z, a, b, g: -(g * (z * _reciprocal(z, b))),
            ),
        ),
        Operation(
            'neg',
            1,
            None,
            np.negative,
            'fneg {type} {0}',
            tangent=lambda z, a, da: -da,
            adjoint=(lambda z, a, g: -g,),
        ),
        # One rounding of a b + c. No step counts it: kernels put it in the place of an addition
        # and a multiplication (pfd_core.kernels.simplify).
        Operation(
            'fma',
            3,
            None,
            fused,
            'call {type} @llvm.fma.{suffix}({type} {0}, {type} {1}, {type} {2})',
            tangent=lambda z, a, b, c, da, db, dc: _product(a, b, da, db, dc),
            adjoint=(
                lambda z, a, b, c, g: _first_factor(z, a, b, g),
                lambda z, a, b, c, g: _second_factor(z, a, b, g),
                lambda z, a, b, c, g: g,
            ),
        ),
        Operation(
            'sqrt',
            1,
            'square_roots',
            np.sqrt,
            'call {type} @llvm.sqrt.{suffix}({type} {0})',
            tangent=lambda z, a, da: da * _slope_of_root(z),
            adjoint=(lambda z, a, g: g * _slope_of_root(z),),
        ),
        Operation(
            'sin',
            1,
            'sines',
            np.sin,
            tangent=lambda z, a, da: z.apply('cos', a) * da,
            adjoint=(lambda z, a, g: g * z.apply('cos', a),),
        ),
        Operation(
            'cos',
            1,
            'sines',
            np.cos,
            tangent=lambda z, a, da: -(z.apply('sin', a) * da),
            adjoint=(lambda z, a, g: -(g * z.apply('sin', a)),),
        ),
        # The rows of a function that is recorded elsewhere: accelerations, for an integrator.
        Operation('call', -1),
        # A repeated part: `loop` (its initial rows), `state` (a row as this iteration finds it),
        # `end` (the rows for the next iteration), `result` (a row after the last one).
        Operation('loop', -1),
        Operation('state', 1),
        Operation('end', -1),
        Operation('result', 1),
    )
}

COSTS = ('multiplications', 'additions', 'divisions', 'square_roots', 'routes', 'sines')
