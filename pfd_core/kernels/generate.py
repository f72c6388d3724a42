# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A lowered program as functions of LLVM IR, by one writer for one state and for a register of them.

    @bodyW         the program; element k of an array lies k times its stride [bytes] behind the
                   first one, and holds W states side by side
    @evaluateW     the same, with inputs checked, and angles beyond the sine's range wrapped first

W is 1, or the states in a register. Where neighbouring states are neighbours in memory (Fortran
order) registers are read in place; elsewhere (C order) states and elements change places first
(`to_columns`, `to_rows`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack
from itertools import zip_longest

from pfd_core.kernels.ir import Code, Variable
from pfd_core.kernels.sines import WRAP_LIMIT, wrap_angle
from pfd_core.machine.program import Program

# All inputs that a program may have, in the order of a kernel's arguments.
ORDER = ('q', 'qd', 'qdd', 'tau', 'wrench', 'free', 'payload', 'motors', 'targets', 'before')


def inputs_of(program: Program) -> list[str]:
    """Return the names of a program's inputs in the order in which a kernel takes them."""
    unknown = program.inputs.keys() - set(ORDER)
    if unknown:
        raise ValueError(f'a kernel takes the inputs {ORDER}, the program has {unknown}')
    return [name for name in ORDER if name in program.inputs]


def parameters(names: Collection[str]) -> str:
    """Return arrays as parameters of a function: `ptr %q, i64 %q.s, ...`."""
    return ', '.join(f'ptr %{name}, i64 %{name}.s' for name in names)


def given(places: Collection[tuple[str, object]]) -> list[str]:
    """Return addresses and strides as arguments of a function with such parameters."""
    return [f'ptr {address}, i64 {stride}' for address, stride in places]


def body(program: Program, dtype: str, width: int, suffix: str = '') -> str:
    """Return `void @bodyW(inputs..., out)`, whose result overlaps no input."""
    head = f'define internal void @body{width}{suffix}'
    code = Code(f'{head}({parameters([*inputs_of(program), "out"])})', dtype, width)
    (output,) = program.outputs.values()
    values = operations(code, program, lambda name, k: code.read(f'%{name}', k, f'%{name}.s'))
    for k, (register, _) in enumerate(output.places):
        code.write(values[register], '%out', k, '%out.s')
    code.ret()
    return str(code)


def operations(code: Code, program: Program, read: Callable[[str, int], str]) -> list[str]:
    """
    Write a lowered program, and return the value of each of its registers.

    Parameters
    ----------
    code : Code
        The function that it becomes part of.
    program : Program
        A lowered program of one lane.
    read : callable
        (name, k) -> value: writes the reading of element k of an input.

    """
    values: list[str] = []
    repeats: dict[int, _Repeat] = {}
    for register, (op, args, data, *_) in enumerate(program.instructions):
        operands = [values[a] for a in args]
        if op == 'constant':
            value = code.constant(data[0])
        elif op == 'input':
            value = read(*data[0])
        elif op == 'loop':
            repeats[register], value = _Repeat(code, operands, data), ''
        elif op == 'state':
            value = repeats[args[0]].begun[data]
        elif op == 'end':
            repeats[register], value = repeats[args[0]], ''
            repeats[register].end(operands[1:])
        elif op == 'result':
            value = repeats[args[0]].rows[data].get()
        else:
            value = code.op(op, *operands)
        values.append(value)
    return values


class _Repeat:
    """
    The repeated part of a program (pfd_core.machine.recorder) while it is written.

    It repeats until the number in its last row is not above a floor in any state, or a given
    number of times; finished states keep their rows. A program reads the number of iterations as
    row -1.
    """

    def __init__(self, code: Code, operands: Sequence[str], at_most: int) -> None:
        *initial, self._floor = operands
        self._code = code
        self.rows = [code.variable(code.type, x) for x in (*initial, code.constant(0.0))]
        self._again = code.variable('i1', 'true')
        self._stack = ExitStack()
        self._stack.enter_context(code.loop(at_most, again=self._again))
        self.begun = [row.get() for row in self.rows]

    def end(self, following: Sequence[str]) -> None:
        """Finish an iteration with the rows for the next one."""
        code = self._code
        *begun, iterations = self.begun
        on = code.above(begun[-1], self._floor)
        for row, old, new in zip(self.rows, begun, following, strict=False):
            row.set(code.choose(on, new, old))
        one = code.choose(on, code.constant(1.0), code.constant(0.0))
        self.rows[-1].set(code.op('add', iterations, one))
        self._again.set(code.any(code.above(self.rows[-2].get(), self._floor)))
        self._stack.close()


def evaluate(
    program: Program,
    dtype: str,
    width: int,
    angles: Sequence[int],
    suffix: str = '',
    check: bool = True,
    inline: bool = True,
) -> str:
    """
    Return `i1 @evaluateW(inputs..., out)`, which runs @bodyW with wrapped angles.

    Parameters
    ----------
    program : Program
        A lowered program with one output.
    dtype, width
        As of Code.
    angles : sequence of int
        Elements of q that are turned; without any, no angle is wrapped.
    suffix : str
        End of the names of both functions.
    check : bool
        Whether inputs are checked. The result is then true, and nothing is written, where an
        input may be infinite or NaN: where a sum of products of inputs is. That sum may also
        overflow for finite inputs. Without a check the result is false.
    inline : bool
        Whether LLVM inlines both where they are called; not if that is in several places.

    """
    names = inputs_of(program)
    head = f'define internal i1 @evaluate{width}{suffix}({parameters([*names, "out"])})'
    code = Code(head if inline else f'{head} noinline', dtype, width)
    numbers = {
        name: [code.read(f'%{name}', k, f'%{name}.s') for k in range(program.inputs[name])]
        for name in names
    }
    if check:
        _check_finite(code, [x for values in numbers.values() for x in values])
    places = {name: (f'%{name}', f'%{name}.s') for name in [*names, 'out']}
    if angles and 'q' in names:
        address, stride = code.variable('ptr', '%q'), code.variable('i64', '%q.s')
        _wrap_angles(code, numbers['q'], angles, address, stride)
        places['q'] = address.get(), stride.get()
    code.call('void', f'body{width}{suffix}', *given(places.values()))
    code.ret('i1', 'false')
    return str(code)


def _check_finite(code: Code, numbers: Sequence[str]) -> None:
    """Return true if a sum of products of two numbers each is not finite."""
    total = code.constant(0.0)
    for a, b in zip_longest(numbers[::2], numbers[1::2], fillvalue=numbers[-1]):
        total = code.op('fma', a, b, total)
    nothing = code.op('sub', total, total)
    wrong = code.any(code.let(f'fcmp uno {code.type} {nothing}, {nothing}'))
    with code.when(wrong, rarely=True):
        code.ret('i1', 'true')


def _wrap_angles(
    code: Code, q: Sequence[str], angles: Sequence[int], address: Variable, stride: Variable
) -> None:
    """
    Place a copy of q with wrapped angles if one of them is beyond the limit of @wrap_angle.

    No angle is beyond it if no sum of their squares is; NaN takes the branch. Such angles are
    rare: 16 000 turns of a joint.
    """
    squares = code.constant(0.0)
    for k in angles:
        squares = code.op('fma', q[k], q[k], squares)
    beyond = code.let(f'fcmp ugt {code.type} {squares}, {code.constant(WRAP_LIMIT**2)}')
    with code.when(code.any(beyond), rarely=True):
        step = code.width * code.bytes
        copy = code.array(len(q))
        for k, x in enumerate(q):
            code.write(x, copy, k, step)
        for k in angles:
            with code.loop(code.width) as lane:
                _wrap_number(code, code.at(code.at(copy, k, step), lane, code.bytes))
        address.set(copy)
        stride.set(step)


def _wrap_number(code: Code, address: str) -> None:
    x = code.load(code.scalar, address)
    wide = x if code.scalar == 'double' else code.let(f'fpext float {x} to double')
    y = code.call('double', 'wrap_angle', f'double {wide}')
    if code.scalar == 'float':
        y = code.let(f'fptrunc double {y} to float')
    code.store(code.scalar, y, address)


# States and elements change places.


def to_columns(code: Code, start: str, row: object, near: str, size: int) -> None:
    """
    Copy a register of states whose elements are neighbours, to columns of one element each.

    Parameters
    ----------
    code : Code
        Of more than one number in a register.
    start : str
        Address of the first state.
    row : str or int
        Bytes from state to state.
    near : str
        Address of the columns, which follow one another.
    size : int
        Elements of a state.

    """
    S, bytes_ = code.scalar, code.bytes
    states = [code.at(start, r, row) for r in range(code.width)]
    if size == 1:
        for r, state in enumerate(states):
            code.store(S, code.load(S, state, bytes_), code.at(near, r, bytes_))
    for k in _pairs(size):
        length = 2
        pieces = [code.load(f'<2 x {S}>', code.at(state, k, bytes_), bytes_) for state in states]
        while len(pieces) > 1:
            kind, order = f'<{length} x {S}>', range(2 * length)
            pairs = zip(pieces[::2], pieces[1::2], strict=True)
            pieces = [code.shuffle(kind, a, b, order) for a, b in pairs]
            length *= 2
        for own in range(2):
            order = range(own, length, 2)
            column = code.shuffle(f'<{length} x {S}>', pieces[0], 'poison', order)
            code.write(column, near, k + own, code.width * bytes_)


def to_rows(code: Code, near: str, start: str, row: object, size: int) -> None:
    """Copy columns to states: the opposite of `to_columns`."""
    S, bytes_ = code.scalar, code.bytes
    states = [code.at(start, r, row) for r in range(code.width)]
    if size == 1:
        for r, state in enumerate(states):
            code.store(S, code.load(S, code.at(near, r, bytes_)), state, bytes_)
    for k in _pairs(size):
        a, b = (code.read(near, k + own, code.width * bytes_) for own in range(2))
        for r, state in enumerate(states):
            pair = code.shuffle(code.type, a, b, [r, code.width + r])
            code.store(f'<2 x {S}>', pair, code.at(state, k, bytes_), bytes_)


def _pairs(size: int) -> list[int]:
    """Return the first of two elements that are copied at once; the last two pairs may overlap."""
    return [min(k, size - 2) for k in range(0, size, 2)] if size > 1 else []


# Modules.


def declarations(dtype: str, widths: Collection[int], wrapped: bool) -> str:
    """
    Return what functions of a module refer to.

    Parameters
    ----------
    dtype : str
        Number format.
    widths : collection of int
        Numbers in the registers of all functions.
    wrapped : bool
        Whether angles are wrapped.

    """
    lines = ['declare i64 @llvm.umin.i64(i64, i64)']
    for code in (Code('', dtype, width) for width in sorted(set(widths))):
        for name, operands in (('sqrt', 1), ('fabs', 1), ('fma', 3)):
            types = ', '.join([code.type] * operands)
            lines.append(f'declare {code.type} @llvm.{name}.{code.suffix}({types})')
        if code.width > 1:
            lines.append(f'declare i1 @llvm.vector.reduce.or.v{code.width}i1({code.flag})')
    # An angle that has to be wrapped is rare: its branch is laid out of the way.
    lines.append('!0 = !{!"branch_weights", i32 1, i32 10000}')
    return '\n'.join([*lines, *([wrap_angle()] if wrapped else [])])
