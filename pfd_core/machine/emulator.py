# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The emulator: n processors in lock-step. This is the definition of what a program means.

Registers are NumPy arrays, first axis the lanes, further axes a batch of problems that the
program does not know of. Lanes that are switched off hold zero. Numbers are float64, float32
or, with `digits`, mpmath numbers of that many decimal digits: the same program then gives the
reference that every other answer is measured against.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.program import Instruction, Program


def run(
    program: Program,
    inputs: Mapping[str, ArrayLike],
    dtype: str = 'float64',
    digits: int | None = None,
    functions: Mapping[str, Callable[[Any, Any], Any]] | None = None,
) -> dict[str, Any]:
    """
    Run a program and return its outputs.

    Parameters
    ----------
    program : Program
        What to run.
    inputs : mapping
        For each input of the program an array (..., elements); leading axes are a batch, and
        are the same for all inputs.
    dtype : {'float64', 'float32'}
        Numbers of the machine.
    digits : int, optional
        Compute with mpmath numbers of this many decimal digits instead.
    functions : mapping, optional
        What the program calls: functions of two rows, (lanes, ...), that return one.

    Returns
    -------
    dict
        Name of each output to an array (..., *shape) of the machine's numbers; objects of
        type mpmath.mpf when `digits` is given.

    """
    arithmetic: Any = _Mpmath(digits) if digits is not None else _Floats(dtype)
    missing = program.inputs.keys() - inputs.keys()
    if missing:
        raise ValueError(f'the program needs the inputs {sorted(missing)}')
    values = {name: arithmetic.array(inputs[name]) for name in program.inputs}
    for name, size in program.inputs.items():
        if values[name].shape[-1:] != (size,):
            raise ValueError(
                f'input {name} must have shape (..., {size}), got {values[name].shape}'
            )
    batch = next(iter(values.values())).shape[:-1]
    registers: list[Any] = []
    with arithmetic.context():
        for instruction in program.instructions:
            if instruction.op == 'call':
                rows = (registers[a] for a in instruction.args)
                registers.append((functions or {})[instruction.data](*rows))
            else:
                registers.append(_execute(instruction, registers, values, batch, arithmetic))
    return {
        name: np.stack([registers[r][lane] for r, lane in output.places], axis=-1).reshape(
            (*batch, *output.shape)
        )
        for name, output in program.outputs.items()
    }


def _execute(
    instruction: Instruction,
    registers: list[Any],
    inputs: Mapping[str, Any],
    batch: tuple[int, ...],
    arithmetic: Any,
) -> Any:
    """Return the row that one instruction leaves in its register."""
    op, args, data, active, _ = instruction
    if op == 'constant':
        return _row([np.full(batch, arithmetic.number(value)) for value in data])
    if op == 'input':
        zero = np.full(batch, arithmetic.number(0.0))
        return _row([zero if k is None else inputs[name][..., k] for name, k in data])
    if op == 'route':
        value, fill = registers[args[0]], registers[args[1]]
        row = fill.copy()
        for lane, source in enumerate(data):
            if source is not None:
                row[lane] = value[source]
            elif not active >> lane & 1:
                row[lane] = arithmetic.number(0.0)
        return row
    meaning = arithmetic.meaning(op)
    operands = [registers[a] for a in args]
    lanes = len(operands[0])
    if active == (1 << lanes) - 1:
        return meaning(*operands)
    on = [lane for lane in range(lanes) if active >> lane & 1]
    row = np.zeros_like(operands[0])
    row[on] = meaning(*(operand[on] for operand in operands))
    return row


def _row(values: list[Any]) -> Any:
    return np.stack(values)


class _Floats:
    """IEEE numbers of one width."""

    def __init__(self, dtype: str) -> None:
        if dtype not in ('float64', 'float32'):
            raise ValueError(f"dtype must be 'float64' or 'float32', got {dtype!r}")
        self.number = np.dtype(dtype).type

    def array(self, values: ArrayLike) -> Any:
        return np.asarray(values, dtype=self.number)

    def meaning(self, op: str) -> Any:
        return OPERATIONS[op].meaning

    def context(self) -> AbstractContextManager[Any]:
        # Infinities and NaN are results here, which the caller looks at.
        return np.errstate(all='ignore')


class _Mpmath:
    """mpmath numbers of a fixed number of digits, in object arrays."""

    def __init__(self, digits: int) -> None:
        try:
            import mpmath
        except ImportError as error:
            raise ImportError(
                f'digits={digits} computes with mpmath, which is not installed: '
                "pip install 'pfd_ros[report]'"
            ) from error
        if digits < 1:
            raise ValueError(f'digits must be at least 1, got {digits}')
        self.mp = mpmath
        self.digits = digits
        self.number = mpmath.mpf
        self._functions = {
            name: np.frompyfunc(getattr(mpmath, name), 1, 1) for name in ('sqrt', 'sin', 'cos')
        }

    def array(self, values: ArrayLike) -> Any:
        return np.vectorize(self.mp.mpf, otypes=[object])(np.asarray(values))

    def meaning(self, op: str) -> Any:
        return self._functions.get(op, OPERATIONS[op].meaning)

    def context(self) -> AbstractContextManager[Any]:
        context: AbstractContextManager[Any] = self.mp.workdps(self.digits)
        return context
