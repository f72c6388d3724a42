# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The closed table of operations: meaning, LLVM spelling and cost column of each.

A program consists of these operations. The emulator reads the column `meaning`, the kernels read
`llvm`, the step counts read `cost`; a new operation is a new row here and nowhere else.

Every meaning is a correctly rounded IEEE 754 operation, except `sin` and `cos`: a kernel
replaces these two by the other rows before it is compiled (pfd_core.kernels.passes.sincos).
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

    """

    name: str
    arity: int
    cost: str | None = None
    meaning: Callable[..., Any] | None = None
    llvm: str | None = None


def _select(condition: Any, chosen: Any, other: Any) -> Any:
    return np.where(condition > 0, chosen, other)


OPERATIONS = {
    operation.name: operation
    for operation in (
        Operation('input', 0),
        Operation('constant', 0),
        # Lane i takes the value of a given lane, or of its own lane of the second operand.
        Operation('route', 2, 'routes'),
        # The second operand where the first is above zero, else the third.
        Operation('select', 3, None, _select),
        Operation('add', 2, 'additions', np.add, 'fadd {type} {0}, {1}'),
        Operation('sub', 2, 'additions', np.subtract, 'fsub {type} {0}, {1}'),
        Operation('mul', 2, 'multiplications', np.multiply, 'fmul {type} {0}, {1}'),
        Operation('div', 2, 'divisions', np.divide, 'fdiv {type} {0}, {1}'),
        Operation('neg', 1, None, np.negative, 'fneg {type} {0}'),
        # One rounding of a b + c. No text has it and no step counts it: kernels put it in the
        # place of an addition and a multiplication (pfd_core.kernels.passes.fuse).
        Operation(
            'fma',
            3,
            None,
            fused,
            'call {type} @llvm.fma.{suffix}({type} {0}, {type} {1}, {type} {2})',
        ),
        Operation(
            'sqrt', 1, 'square_roots', np.sqrt, 'call {type} @llvm.sqrt.{suffix}({type} {0})'
        ),
        Operation('sin', 1, 'sines', np.sin),
        Operation('cos', 1, 'sines', np.cos),
        # The rows of a function that is recorded elsewhere: accelerations, for an integrator.
        Operation('call', -1),
        # A repeated part: `loop` (its initial rows), `state` (a row as this trip finds it),
        # `end` (the rows for the next trip), `result` (a row after the last one).
        Operation('loop', -1),
        Operation('state', 1),
        Operation('end', -1),
        Operation('result', 1),
    )
}

COSTS = ('multiplications', 'additions', 'divisions', 'square_roots', 'routes', 'sines')
