# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The emulator: n processors in lock-step. It defines the meaning of a program.

Registers are NumPy arrays: the first axis is the lanes, further axes a batch of problems. Lanes
that are switched off hold zero. Numbers are float64, float32, the processor's wider numbers or,
with `digits`, mpmath numbers of that many decimal digits: the same program then gives the
reference for the error of every answer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pfd_core.forking import no_fork
from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.program import Instruction, Program

Carrier = Callable[[Sequence[int | None], Sequence[Any]], Sequence[Any]]


def run(
    program: Program,
    inputs: Mapping[str, ArrayLike],
    dtype: str = 'float64',
    digits: int | None = None,
    route: Carrier | None = None,
    observe: Callable[[list[Any]], None] | None = None,
) -> dict[str, Any]:
    """
    Run a program and return its outputs by name, arrays (..., *shape).

    Parameters
    ----------
    program : Program
        Recorded program.
    inputs : mapping
        For each input of the program an array (..., elements); leading axes are a batch, and
        are the same for all inputs.
    dtype : {'float64', 'float32', 'longdouble'}
        Numbers of the machine. NumPy's longdouble must have at least 64 bits of mantissa, as on
        x86 and on 64-bit ARM under Linux.
    digits : int, optional
        Compute with mpmath numbers, objects of type mpf, of this many decimal digits instead.
    route : callable, optional
        Moves the data of a route: of the lane that each lane reads and the value on each lane, to
        a mapping for each lane, from the lane it reads to its value (pfd_core.paper.networks).
        Default: every lane reads its source at once.
    observe : callable, optional
        Called before a loop and after each iteration, with the rows, (lanes, ...), of the loop's
        state.

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
    machine = _Machine(program, values, batch, arithmetic, route, observe)
    # Infinities and NaN are results here, which the caller looks at.
    with np.errstate(all='ignore'):
        registers = machine.run()
    return {
        name: arithmetic.result(
            np.stack([registers[r][lane] for r, lane in output.places], axis=-1)
        ).reshape((*batch, *output.shape))
        for name, output in program.outputs.items()
    }


@dataclass
class _Machine:
    """Registers of one run, and the state of the loop that is running."""

    program: Program
    inputs: Mapping[str, Any]
    batch: tuple[int, ...]
    arithmetic: Any
    carry: Carrier | None
    observe: Callable[[list[Any]], None] | None

    def run(self) -> list[Any]:
        """Execute the instructions in order, repeating loops; return the registers."""
        instructions = self.program.instructions
        self.registers: list[Any] = [None] * len(instructions)
        self.meanings = {
            op: self.arithmetic.meaning(op) for op, row in OPERATIONS.items() if row.meaning
        }
        at = turn = at_most = 0
        while at < len(instructions):
            one = instructions[at]
            if one.op == 'loop':
                # The state of the loop, its `go` last.
                *self.rows, self.floor = (self.registers[a] for a in one.args)
                self.iterations, turn, at_most = np.zeros(self.batch), 0, one.data
                self._show()
            elif one.op == 'leave':
                if turn + 1 == at_most:
                    while instructions[at + 1].op != 'end':
                        at += 1
            elif one.op == 'end':
                self._iterate([self.registers[a] for a in one.args[1:]])
                turn += 1
                if np.any(self._going()) and turn < at_most:
                    at = one.args[0]
            else:
                self.registers[at] = self._execute(one)
            at += 1
        return self.registers

    def _iterate(self, following: Sequence[Any]) -> None:
        """Write the next state of unfinished problems; a row that was not computed stays."""
        going = self._going()
        pairs = zip(self.rows, following, strict=True)
        self.rows = [x if y is None else np.where(going, y, x) for x, y in pairs]
        self.iterations = self.iterations + going
        self._show()

    def _show(self) -> None:
        if self.observe:
            self.observe(self.rows[:-1])

    def _going(self) -> Any:
        return np.asarray(self.rows[-1][0] > self.floor[0], dtype=bool)

    def _execute(self, instruction: Instruction) -> Any:
        """Return the row that one instruction leaves in its register."""
        op, args, data, active, _ = instruction
        meaning = self.meanings.get(op)
        if meaning is not None:
            # Lanes that are switched off compute too, which costs less than to choose the others.
            row, lanes = meaning(*(self.registers[a] for a in args)), self.program.lanes
            if active != (1 << lanes) - 1:
                row[[lane for lane in range(lanes) if not active >> lane & 1]] = 0
            return row
        number = self.arithmetic.number
        zero = number(0.0)
        if op == 'constant':
            return np.stack([np.full(self.batch, number(value)) for value in data])
        if op == 'input':
            off = np.full(self.batch, zero)
            return np.stack([off if k is None else self.inputs[name][..., k] for name, k in data])
        if op == 'route':
            value, row = self.registers[args[0]], self.registers[args[1]].copy()
            words = [value] * len(data) if self.carry is None else self.carry(data, value)
            for lane, source in enumerate(data):
                if source is not None:
                    row[lane] = words[lane][source]
                elif not active >> lane & 1:
                    row[lane] = zero
            return row
        # A state or a result of the loop.
        if data >= 0:
            return self.rows[data]
        return np.stack([self.arithmetic.array(self.iterations)] * self.program.lanes)


class _Floats:
    """IEEE numbers of one width."""

    def __init__(self, dtype: str) -> None:
        if dtype not in ('float64', 'float32', 'longdouble'):
            raise ValueError(f"dtype must be 'float64', 'float32' or 'longdouble', got {dtype!r}")
        if dtype == 'longdouble' and np.finfo(np.longdouble).nmant < 63:
            raise ValueError('longdouble has no more digits than float64 on this machine')
        self.number = np.dtype(dtype).type

    def array(self, values: ArrayLike) -> Any:
        return np.asarray(values, dtype=self.number)

    def result(self, values: Any) -> Any:
        return values

    def meaning(self, op: str) -> Any:
        return OPERATIONS[op].meaning


class _Mpmath:
    """mpmath numbers of a fixed number of digits, in object arrays."""

    def __init__(self, digits: int) -> None:
        try:
            with no_fork:
                import mpmath
        except ImportError as error:
            raise ImportError(
                f'digits={digits} computes with mpmath, which is not installed: '
                'run `pip install mpmath`'
            ) from error
        if digits < 1:
            raise ValueError(f'digits must be at least 1, got {digits}')
        # All threads share the digits of mpmath's own context; these are of this run alone.
        mp = mpmath.MPContext()
        mp.dps, self.number = digits, mp.mpf
        # Where mpmath raises or leaves the real numbers, the machine has NaN and infinity.
        self._functions = {
            'sqrt': np.frompyfunc(lambda x: mp.sqrt(x) if x >= 0 else mp.nan, 1, 1),
            'div': np.frompyfunc(lambda x, y: x / y if y else x * mp.inf, 2, 1),
            'sin': np.frompyfunc(mp.sin, 1, 1),
            'cos': np.frompyfunc(mp.cos, 1, 1),
            'fma': lambda x, y, z: x * y + z,
        }
        # `convert` takes any type of number, and mpf rounds it.
        self.array = np.vectorize(lambda x: mp.mpf(mp.convert(x)), otypes=[object])
        self.result = np.frompyfunc(lambda x: mpmath.make_mpf(x._mpf_), 1, 1)

    def meaning(self, op: str) -> Any:
        return self._functions.get(op, OPERATIONS[op].meaning)
