# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Programs run one state at a time on Python's decimal numbers: references, and long motions.

Python's decimal numbers are written in C: an evaluation takes a twentieth of the emulator's time
with mpmath, a quarter where the emulator runs a hundred states at once. Products with zero and
one and sums with zero, which a recording has many of, are skipped; everything else is executed as
recorded. Sine and cosine are Taylor series of an angle that is first reduced to half a turn, if
it is large, and halved.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal, getcontext, localcontext
from functools import cache
import operator
from typing import Any

import numpy as np

from pfd_core.machine.program import Program

Inputs = Mapping[str, Sequence[Decimal]]
ZERO, ONE, TWO = Decimal(0), Decimal(1), Decimal(2)
# Digits in addition to the digits of mpmath numbers, whose roundings are binary.
MORE = 10
# Halvings of an angle before its series, and digits beyond the context's that they cost.
HALVINGS, GUARD = 6, 5


def cos_sin(angle: Decimal) -> tuple[Decimal, Decimal]:
    """Return cosine and sine of an angle [rad]."""
    context = getcontext()
    context.prec += GUARD
    if abs(angle) > 2**HALVINGS:
        angle = _within_half_a_turn(angle)
    x = angle / 2**HALVINGS
    square, term, k = x * x, x, 1
    sine, smallest = x, abs(x) * Decimal(10) ** -context.prec
    while abs(term) > smallest:
        k += 2
        term = -term * square / (k * (k - 1))
        sine += term
    # versine = 1 - cos, which keeps its digits for small angles.
    versine = sine * sine / (ONE + (ONE - sine * sine).sqrt())
    for _ in range(HALVINGS):
        sine, versine = 2 * sine * (ONE - versine), 2 * sine * sine
    context.prec -= GUARD
    return ONE - versine, +sine


def _within_half_a_turn(angle: Decimal) -> Decimal:
    with localcontext() as context:
        # The part that remains keeps all digits.
        context.prec += angle.adjusted() + 1
        turn = 2 * _pi(context.prec)
        return angle - (angle / turn).to_integral_value() * turn


@cache
def _pi(digits: int) -> Decimal:
    """Return pi by Machin's formula, 16 atan(1/5) - 4 atan(1/239)."""
    with localcontext() as context:
        context.prec = digits + GUARD
        return 16 * _arctangent_of_inverse(5) - 4 * _arctangent_of_inverse(239)


def _arctangent_of_inverse(number: int) -> Decimal:
    power = ONE / number
    total, k, smallest = power, 1, Decimal(10) ** -getcontext().prec
    while abs(power) > smallest:
        power = -power / number**2
        k += 2
        total += power / k
    return total


MEANING: dict[str, Callable[..., Any]] = {
    'add': operator.add,
    'sub': operator.sub,
    'mul': operator.mul,
    'div': operator.truediv,
    'neg': operator.neg,
    'sqrt': Decimal.sqrt,
    'select': lambda condition, chosen, other: chosen if condition > 0 else other,
    'sin': lambda x: cos_sin(x)[1],
    'cos': lambda x: cos_sin(x)[0],
}


def evaluator(program: Program) -> Callable[[Inputs], dict[str, list[Decimal]]]:
    """
    Return a function from inputs to outputs, each a list of elements, for a sequential program.

    The context of the decimal module sets the digits when the function is called.

    Raises
    ------
    ValueError
        If the program is not sequential, or an operation is not in MEANING.

    """
    if program.lanes != 1:
        raise ValueError('decimal numbers run sequential programs only')
    steps: list[tuple[Any, int, tuple[int, ...]]] = []
    known: dict[int, Decimal] = {}  # registers that hold a constant
    same = list(range(len(program.instructions)))  # register that holds the value of another
    places: list[tuple[int, str, int]] = []
    for register, (op, args, data, _, _) in enumerate(program.instructions):
        operands = tuple(same[a] for a in args)
        if op == 'constant':
            known[register] = Decimal(data[0])
        elif op == 'input':
            places.append((register, *data[0]))
        elif op not in MEANING:
            raise ValueError(f'decimal numbers have no operation {op!r}')
        elif (alias := _alias(op, operands, known)) is not None:
            same[register] = alias
        else:
            steps.append((MEANING[op], register, operands))

    def evaluate(inputs: Inputs) -> dict[str, list[Decimal]]:
        values: list[Any] = [None] * len(same)
        for register, value in known.items():
            values[register] = value
        for register, name, k in places:
            values[register] = inputs[name][k]
        for function, register, operands in steps:
            values[register] = function(*[values[a] for a in operands])
        return {
            name: [values[same[register]] for register, _ in output.places]
            for name, output in program.outputs.items()
        }

    return evaluate


def on_mpmath_numbers(program: Program, output: str) -> Callable[[Mapping[str, Any]], Any]:
    """
    Return a function that runs a sequential program on states of mpmath numbers, MORE digits wide.

    Parameters
    ----------
    program : Program
        A program that `evaluator` takes.
    output : str
        Its output.

    Returns
    -------
    callable
        Of inputs by name, (..., elements) of floats or mpmath.mpf, to (..., size) of mpmath.mpf
        with the digits that mpmath is set to.

    """
    import mpmath

    evaluate = evaluator(program)

    def run(inputs: Mapping[str, Any]) -> Any:
        batch = next(iter(inputs.values())).shape[:-1]
        rows = {name: inputs[name].reshape(-1, inputs[name].shape[-1]) for name in program.inputs}
        with localcontext() as context:
            context.prec = mpmath.mp.dps + MORE
            found = [
                [
                    mpmath.mpf(str(number))
                    for number in evaluate(dict(zip(rows, map(_decimals, state), strict=True)))[
                        output
                    ]
                ]
                for state in zip(*rows.values(), strict=True)
            ]
        return np.array(found, object).reshape(*batch, -1)

    return run


def _decimals(numbers: Sequence[Any]) -> list[Decimal]:
    """Return mpmath numbers, or others that float64 holds, as decimal ones."""
    return [_decimal(x) if hasattr(x, 'man') else Decimal(float(x)) for x in numbers]


def _decimal(number: Any) -> Decimal:
    # The mantissa has no sign.
    size = Decimal(int(number.man)) * TWO ** int(number.exp)
    return -size if number < 0 else size


def _alias(op: str, operands: Sequence[int], known: Mapping[int, Decimal]) -> int | None:
    """Return the operand that a result is equal to exactly, if it is known to be one."""
    if op not in ('add', 'sub', 'mul'):
        return None
    a, b = operands
    x, y = known.get(a), known.get(b)
    if op == 'mul':
        if ZERO in (x, y):
            return a if x == ZERO else b
        return b if x == ONE else (a if y == ONE else None)
    if op == 'add' and x == ZERO:
        return b
    return a if y == ZERO else None
