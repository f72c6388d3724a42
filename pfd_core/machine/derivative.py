# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Derivatives of a program, exact up to rounding: program -> program (algorithmic differentiation).

    derivative       Jacobians   d y/d x, of some outputs y with respect to some inputs x
    directional      d y = (d y/d x) d x        for given directions d x

The tangent mode carries derivatives from the inputs on, one for each element of the inputs; the
adjoint mode carries them from the outputs back, one sweep for each element of the outputs. The
rules of each operation are columns of the table (pfd_core.machine.operations).

The new program is the old one with the derivatives' instructions after it, register by register
the same, so that its outputs keep their bits. A derivative that is zero for all inputs costs
nothing, nor does a factor 1 or -1; an expression that exists already is not recorded again. No
number is rounded here: the program on 50 digits has 50 correct digits. The result is a program
like any other: it can be differentiated again, which gives second derivatives.

Differentiate a program before its sines are written out in other operations: these round to the
nearest integer by adding and subtracting a large number, which looks like the identity to the
rules (pfd_core.kernels.sines). Adjoints of a program whose equal expressions are shared
already (pfd_core.kernels.simplify) are shorter: the adjoint of an expression that is recorded
twice goes back twice.

A quotient and a square root have no derivative at zero, which gives infinity or NaN. An entry that
is zero for all inputs stays zero also where the output itself is infinite or NaN. At the
switch of a `select` the derivative is taken of the operand that is selected there.

Source: Griewank and Walther, Evaluating Derivatives, 2nd ed. 2008, chapter 3.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, TypeVar

from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder

MODES = ('tangent', 'adjoint')
T = TypeVar('T')
Element = tuple[str, int]  # name of an input and flat index of one of its elements
# The only direction of directional tangents, in the place of an element.
GIVEN: Element = ('', 0)


def derivative(
    program: Program, outputs: Sequence[str], inputs: Sequence[str], mode: str = 'tangent'
) -> Program:
    """
    Return a sequential program with the Jacobians of outputs with respect to inputs.

    Its outputs are those named, and for each output y and each input x `d {y}/d {x}`, of shape
    (*y.shape, elements of x), with elements that are zero for all inputs. The modes are equal but
    for rounding; tangents are cheaper for few inputs, adjoints for few outputs.

    Raises
    ------
    ValueError
        If the program has several lanes or lacks a name, if the mode is unknown, or if an output
        depends on an input by an operation without rules: a loop, a route.

    """
    _check(program, outputs, inputs, mode)
    active, extension = _active(program, outputs, inputs), _Extension(program)
    places = dict.fromkeys(r for y in outputs for r, _ in program.outputs[y].places)
    rows: dict[int, Mapping[Element, Any]]  # register of an element of y -> derivatives
    if mode == 'tangent':
        seeds = {r: {x: 1.0} for r, x in _read(program) if x[0] in inputs}
        tangents = _tangents(extension, active, seeds)
        rows = {r: tangents.get(r, {}) for r in places}
    else:
        rows = {r: _adjoints(extension, active, {r: 1.0}) for r in places}
    for y in outputs:
        shape, elements = program.outputs[y]
        for x in inputs:
            size = program.inputs[x]
            values = [rows[r].get((x, k), 0.0) for r, _ in elements for k in range(size)]
            extension.output(f'd {y}/d {x}', (*shape, size), [(v, 0) for v in values])
    return extension.extended(outputs)


def directional(
    program: Program,
    outputs: Sequence[str],
    inputs: Sequence[str],
    name: Callable[[str], str] = 'd {}'.format,
) -> Program:
    """
    Return a sequential program with the derivative of outputs in one direction.

    Each input x has a further input `name(x)`, d x, and each output y a further output
    `name(y)`, d y = sum over x of (d y/d x) d x. ValueError as for `derivative`, and if the
    program has one of the further names already.
    """
    _check(program, outputs, inputs, MODES[0])
    taken = {name(x) for x in (*inputs, *outputs)} & {*program.inputs, *outputs}
    if taken:
        raise ValueError(f'the program has {sorted(taken)} already: rename inputs and outputs')
    active, extension = _active(program, outputs, inputs), _Extension(program)
    seeds = {
        r: {GIVEN: extension.further_input(name(x), k, program.inputs[x])}
        for r, (x, k) in _read(program)
        if x in inputs
    }
    tangents = _tangents(extension, active, seeds)
    for y in outputs:
        shape, elements = program.outputs[y]
        values = [tangents.get(r, {}).get(GIVEN, 0.0) for r, _ in elements]
        extension.output(name(y), shape, [(v, 0) for v in values])
    return extension.extended(outputs)


class _Extension(Recorder):
    """
    Appends instructions, written as formulas on its values, to a sequential program.

    Its own instructions keep their registers. Equal expressions share a register, also with the
    program, and its zeros, ones and signs are known numbers in `values`, which cost no operation.
    """

    def __init__(self, program: Program) -> None:
        super().__init__(1, 'sequential')
        self.old = program
        self._instructions = list(program.instructions)
        self._inputs = dict(program.inputs)
        self._written: dict[tuple[Any, ...], int] = {}
        self.values: list[Any] = []
        for register, (op, args, data, *_) in enumerate(program.instructions):
            known = op == 'constant' and data[0] in (0.0, 1.0, -1.0)
            self.values.append(float(data[0]) if known else Lanes(self, (register,), 1))
            self._written.setdefault(_key(op, args, data), register)

    def write(self, op: str, args: tuple[int, ...], data: Any, active: int) -> int:
        """Return the register of an expression, appended now or there before."""
        key = _key(op, args, data)
        if key not in self._written:
            self._written[key] = super().write(op, args, data, active)
        return self._written[key]

    def lift(self, value: object) -> Lanes:
        """Return a value as it is, and a number as a constant; there is only one zero."""
        return super().lift(value + 0.0 if isinstance(value, (int, float)) else value)

    def further_input(self, name: str, element: int, size: int) -> Lanes:
        """Return one element of a further input, whose size is given."""
        self._inputs[name] = size
        return self.input(name, [element])

    def extended(self, outputs: Sequence[str]) -> Program:
        """Return the program with these of its outputs and the further ones."""
        kept = {name: self.old.outputs[name] for name in outputs}
        return Program(1, tuple(self._instructions), self._inputs, kept | self._outputs)


def _key(op: str, args: tuple[int, ...], data: Any) -> tuple[Any, ...]:
    # As strings, because 0.0 == -0.0.
    return op, args, str(data) if op == 'constant' else data


def _tangents(
    extension: _Extension, active: Sequence[int], seeds: Mapping[int, Mapping[Element, Any]]
) -> dict[int, Mapping[Element, Any]]:
    """Return the tangents of active registers by direction, without zeros."""
    tangents = dict(seeds)
    sums = dict(_sums(extension.old))
    products = {product for product, _ in sums.values()}
    for register in active:
        if register in seeds or register in products:
            continue
        op, args, _, _, section = extension.old.instructions[register]
        terms = [(1.0, a) for a in args]
        if register in sums:
            op, terms = 'fma', sums[register][1]
        z, *operands = (sign * extension.values[r] for sign, r in ((1.0, register), *terms))
        known = [(sign, tangents.get(r, {})) for sign, r in _varied(op, terms)]
        found = {}
        with extension.section(section):
            for direction in dict.fromkeys(d for _, operand in known for d in operand):
                each = [sign * operand.get(direction, 0.0) for sign, operand in known]
                if (value := _tangent(op, z, operands, each)) != 0.0:
                    found[direction] = value
        tangents[register] = found
    return tangents


def _tangent(op: str, z: Any, operands: Sequence[Any], tangents: Sequence[Any]) -> Any:
    """Return the tangent of the result of an operation."""
    if op == 'select':
        return z.recorder.apply('select', operands[0], *tangents)
    if op == 'mul' and operands[0] is operands[1]:  # tangents of a square share 2 a
        return (operands[0] + operands[0]) * tangents[0]
    total: Any = 0.0
    # As the product rule is written, (dc + da b) + a db: what a kernel fuses depends on it.
    for k in (2, 0, 1) if op == 'fma' else range(len(operands)):
        if tangents[k] != 0.0:
            sign, partial = OPERATIONS[op].partials[k]
            size = partial(z, *operands)
            term = size * tangents[k] if k else tangents[k] * size
            total = total + term if sign > 0 else total - term
    return total


def _sums(program: Program) -> Iterator[tuple[int, tuple[int, list[tuple[float, int]]]]]:
    """
    Yield the sums a b + c, and differences, whose product nothing else reads.

    For each: its register, the register of the product, and the signed registers of a, b and c.
    The tangent (dc + da b) + a db is two fused multiply-adds. By way of the product's tangent it
    would be a multiplication, one fused multiply-add and an addition.
    """
    instructions = program.instructions
    reads = Counter(a for instruction in instructions for a in instruction.args)
    reads.update(register for output in program.outputs.values() for register, _ in output.places)
    for register, (op, args, *_) in enumerate(instructions):
        if op not in ('add', 'sub'):
            continue
        for product, c in (args, args[::-1]):
            if instructions[product].op != 'mul' or reads[product] > 1:
                continue
            a, b = instructions[product].args
            if a == b:  # (2 a) da is a single product
                continue
            of_product = -1.0 if op == 'sub' and product == args[1] else 1.0
            of_c = -1.0 if op == 'sub' and product == args[0] else 1.0
            yield register, (product, [(of_product, a), (1.0, b), (of_c, c)])
            break


def _adjoints(
    extension: _Extension, active: Sequence[int], weights: Mapping[int, Any]
) -> dict[Element, Any]:
    """Return the adjoints of the elements of the inputs for given ones of some registers."""
    adjoints = dict.fromkeys(active, 0.0)
    adjoints |= {register: g for register, g in weights.items() if register in adjoints}
    elements: dict[Element, Any] = {}
    for register in reversed(active):
        op, args, data, _, section = extension.old.instructions[register]
        g = adjoints[register]
        if g == 0.0:
            continue
        with extension.section(section):
            if op == 'input':
                elements[data[0]] = elements.get(data[0], 0.0) + g
                continue
            z, *operands = (extension.values[r] for r in (register, *args))
            for k, a in enumerate(_varied(op, args)):
                if a in adjoints:
                    adjoints[a] = adjoints[a] + _share(op, z, operands, k, g)
    return elements


def _share(op: str, z: Any, operands: Sequence[Any], k: int, g: Any) -> Any:
    """Return the share of an operand in the adjoint g of the result of an operation."""
    if op == 'select':
        return z.recorder.apply('select', operands[0], *((g, 0.0), (0.0, g))[k])
    if op == 'mul' and operands[0] is operands[1]:
        return 0.0 if k else g * (operands[0] + operands[0])
    sign, partial = OPERATIONS[op].partials[k]
    return sign * (g * partial(z, *operands))


def _varied(op: str, operands: Sequence[T]) -> Sequence[T]:
    """Return the operands that a result varies with: the condition of a select is none."""
    return operands[1:] if op == 'select' else operands


def _read(program: Program) -> Iterator[tuple[int, Element]]:
    """Yield each register that reads an input, and the element that it reads."""
    for register, instruction in enumerate(program.instructions):
        if instruction.op == 'input':
            yield register, instruction.data[0]


def _active(program: Program, outputs: Sequence[str], inputs: Collection[str]) -> list[int]:
    """
    Return the registers that depend on an input and that an output depends on, in order.

    ValueError if one of them has no rules.
    """
    arguments = [_varied(op, args) for op, args, *_ in program.instructions]
    varies = {register for register, (x, _) in _read(program) if x in inputs}
    for register, args in enumerate(arguments):
        if any(a in varies for a in args):
            varies.add(register)
    reaches = {register for y in outputs for register, _ in program.outputs[y].places}
    for register in range(len(arguments) - 1, -1, -1):
        if register in reaches:
            reaches.update(arguments[register])
    active = sorted(varies & reaches)
    for register in active:
        op, _, _, _, section = program.instructions[register]
        if op not in ('input', 'select') and not OPERATIONS[op].partials:
            raise ValueError(
                f'no derivative of {list(outputs)} with respect to {list(inputs)}: the operation '
                f'{op!r} between them has no rule (register {register}, section {section!r})'
            )
    return active


def _check(program: Program, outputs: Sequence[str], inputs: Sequence[str], mode: str) -> None:
    if program.lanes != 1:
        raise ValueError(f'only a sequential program is differentiated, got {program.lanes} lanes')
    if mode not in MODES:
        raise ValueError(f'mode must be one of {MODES}, got {mode!r}')
    for kind, names, known in (
        ('output', outputs, program.outputs),
        ('input', inputs, program.inputs),
    ):
        for name in names:
            if name not in known:
                raise ValueError(f'the program has no {kind} {name!r}: it has {sorted(known)}')
