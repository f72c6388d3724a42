# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A lowered program as functions of LLVM IR, by one writer for one state and for a register of them.

    @bodyW         the program; element k of an array lies k times its stride [bytes] behind the
                   first one, and holds W states side by side
    @evaluateW     the same, with inputs checked, and angles beyond the sine's range wrapped first
    @batch         @evaluateW on many states, in whole registers, of which the last two may overlap

W is 1, or the states in a register. Where neighbouring states are neighbours in memory (Fortran
order) registers are read in place; elsewhere (C order) states and elements change places first
(`to_columns`, `to_rows`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack
from itertools import chain, zip_longest

from pfd_core.kernels.ir import Code, Variable
from pfd_core.kernels.parts import split
from pfd_core.kernels.sines import WRAP_LIMIT, wrap_angle
from pfd_core.machine.program import Program

# Instructions beyond which a program is written in parts, and the operations of a part.
LONGEST, PART = 6000, 500
# States of a tile of results; the bytes after which addresses have the same low bits and the same
# place in a cache; and how near to each other arrays are in it that evict each other.
TILE, PERIOD, CLOSE = 64, 4096, 128
# Registers of a batch from which results are aligned.
LONG = 32
# Elements of a state up to which copies are straight-line code.
UNROLLED = 16
# An array of @batch: its address, and bytes from state to state and from element to element.
Array = tuple[str, object, object]
# All inputs that a program may have, in the order of a kernel's arguments.
_NAMES = ('q', 'qd', 'qdd', 'tau', 'wrench', 'free', 'p', 'rotor', 'motors', 'targets', 'before')
ORDER = (*_NAMES, *(f'{name}.d' for name in ('q', 'qd', 'qdd', 'tau', 'rotor')))


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


def body(
    program: Program,
    dtype: str,
    width: int,
    suffix: str = '',
    cut: tuple[int, int] | None = None,
    packed: bool = False,
) -> str:
    """
    Return `void @bodyW(inputs..., out)` of a program with one output, which overlaps no input.

    `cut` is the length from which a program becomes several functions (pfd_core.kernels.parts),
    and the operations of each; by default LONGEST and PART. A repeated part is never cut. With
    `packed` the elements of the result follow one another, whatever stride is given.
    """
    longest, part = cut or (LONGEST, PART)
    arrays = parameters([*inputs_of(program), 'out'])
    code = Code(f'define internal void @body{width}{suffix}({arrays})', dtype, width)
    looped = any(instruction.op == 'loop' for instruction in program.instructions)
    if len(program.instructions) <= longest or looped:
        (output,) = program.outputs.values()
        writes = [('out', k, register) for k, (register, _) in enumerate(output.places)]
        return _straight_line(code, program, writes, packed)
    functions = []
    parts = split(program, part)
    frame = code.array(parts[0].program.inputs['frame'])
    for p, (own, writes) in enumerate(parts):
        name = f'part{width}.{p}{suffix}'
        head = f'define internal void @{name}({arrays}, ptr %frame) noinline'
        functions.append(_straight_line(Code(head, dtype, width), own, writes, packed))
        code.call('void', name, arrays, f'ptr {frame}')
    code.ret()
    return '\n'.join([*functions, str(code)])


def _straight_line(
    code: Code, program: Program, writes: Sequence[tuple[str, int, int]], packed: bool
) -> str:
    """Return a function that computes a program, and writes (array, element, register)."""

    def stride(array: str) -> object:
        follow = array == 'frame' or (array == 'out' and packed)
        return code.width * code.bytes if follow else f'%{array}.s'

    values = operations(code, program, lambda name, k: code.read(f'%{name}', k, stride(name)))
    for array, k, register in writes:
        code.write(values[register], f'%{array}', k, stride(array))
    code.ret()
    return str(code)


def operations(code: Code, program: Program, read: Callable[[str, int], str]) -> list[str]:
    """
    Write a lowered program, and return the value of each of its registers.

    `read(name, k)` writes the reading of element k of an input, and returns the value.
    """
    values: list[str] = []
    flags: dict[int, str] = {}
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
        elif op == 'select':
            # One comparison for all choices by a number: LLVM's passes would have to find that.
            if args[0] not in flags:
                flags[args[0]] = code.above(operands[0])
            value = code.choose(flags[args[0]], *operands[1:])
        else:
            value = code.op(op, *operands)
        values.append(value)
    return values


class _Repeat:
    """
    The repeated part of a program while it is written.

    It repeats until the number in its last row is not above a floor in any state, or a given
    number of times; finished states keep their rows. Row -1 is the number of iterations.
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
) -> str:
    """
    Return `@evaluateW(inputs..., out)`, which runs @bodyW with wrapped angles.

    `angles` are the elements of q that are turned, `suffix` ends the names of both functions. With
    `check` the function has a result: zero for each state, or NaN where a sum of products of its
    inputs is not finite, as for an infinite input or NaN; it may also overflow for finite inputs.
    For one state nothing is written then.
    """
    names = inputs_of(program)
    arrays = parameters([*names, 'out'])
    code = Code('', dtype, width)
    kind = code.type if check else 'void'
    code.head = f'define internal {kind} @evaluate{width}{suffix}({arrays})'
    numbers = {
        name: [code.read(f'%{name}', k, f'%{name}.s') for k in range(program.inputs[name])]
        for name in names
    }
    nothing = _nothing(code, [x for values in numbers.values() for x in values]) if check else ''
    if check and width == 1:
        with code.when(code.let(f'fcmp uno {kind} {nothing}, {nothing}'), rarely=True):
            code.ret(kind, nothing)
    places = {name: (f'%{name}', f'%{name}.s') for name in [*names, 'out']}
    if angles and 'q' in names:
        address, stride = code.variable('ptr', '%q'), code.variable('i64', '%q.s')
        _wrap_angles(code, numbers['q'], angles, address, stride)
        places['q'] = address.get(), stride.get()
    code.call('void', f'body{width}{suffix}', *given(places.values()))
    code.ret(kind, nothing)
    return str(code)


def _nothing(code: Code, numbers: Sequence[str]) -> str:
    """Return zero, or NaN where a sum of products of two numbers each is not finite."""
    total = code.constant(0.0)
    for a, b in zip_longest(numbers[::2], numbers[1::2], fillvalue=numbers[-1]):
        total = code.op('fma', a, b, total)
    return code.op('sub', total, total)


def _wrap_angles(
    code: Code, q: Sequence[str], angles: Sequence[int], address: Variable, stride: Variable
) -> None:
    """
    Place a copy of q with wrapped angles if one of them is beyond the limit of @wrap_angle.

    If the sum of their squares is not beyond the square of the limit, none is; NaN takes the
    branch. Such angles are rare: 16 000 turns of a joint.
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
                place = code.at(code.at(copy, k, step), lane, code.bytes)
                x = code.load(code.scalar, place)
                if code.scalar == 'float':
                    x = code.let(f'fpext float {x} to double')
                x = code.call('double', 'wrap_angle', f'double {x}')
                if code.scalar == 'float':
                    x = code.let(f'fptrunc double {x} to float')
                code.store(code.scalar, x, place)
        address.set(copy)
        stride.set(step)


# Many states.


def batch(program: Program, dtype: str, width: int, size: int) -> str:
    """
    Return `i64 @batch(count, table)`, which runs @evaluateW on `count` states.

    `table` holds, for each input and then for the result of `size` elements, a pointer, the bytes
    from state to state, and the bytes from element to element. Of every array either neighbouring
    states or neighbouring elements are neighbours in memory. The function returns 0, or 1 where
    @evaluateW finds an input that may not be finite.

    A processor lets a load wait for a store whose address has the same low bits, and a cache has
    few lines in one place. Columns that are multiples of PERIOD bytes long, of an input and a
    result that begin near each other in this sense, as large arrays of NumPy do, therefore evict
    each other: results then are computed in tiles and copied to their columns.
    """
    code = Code('define i64 @batch(i64 %count, ptr %table)', dtype, width)
    sizes = [*(program.inputs[name] for name in inputs_of(program)), size]
    table = _table(code, len(sizes))
    *inputs, (out, _, column) = table
    end = code.let(f'ptrtoint ptr {out} to i64')
    close = []
    for base, _, _ in inputs:
        apart = code.integer('sub', code.let(f'ptrtoint ptr {base} to i64'), end)
        place = code.integer('and', code.integer('add', apart, CLOSE), PERIOD - 1)
        close.append(code.test('ule', place, 2 * CLOSE))
    beside = [code.test('eq', row, code.bytes) for _, row, _ in table]
    periodic = code.test('eq', code.integer('and', column, PERIOD - 1), 0)
    long = code.test('uge', '%count', 2 * TILE)
    with code.when(code.negated(code.both(long, *beside, periodic, code.either(*close)))):
        code.ret('i64', code.call('i64', 'rows', 'i64 %count', 'ptr %table'))
    step, height = width * code.bytes, TILE * code.bytes
    tile = code.array(size * TILE // width)
    wrong = code.variable('i64', 0)
    final = code.integer('sub', '%count', TILE)
    with code.loop('%count', step=TILE) as begin:
        first = code.least(begin, final)
        here = [(code.at(base, first, code.bytes), row, own) for base, row, own in inputs]
        own = table_of(code, [*here, (tile, code.bytes, height)])
        found = code.call('i64', 'rows', f'i64 {TILE}', f'ptr {own}')
        wrong.set(code.integer('or', wrong.get(), found))
        there = code.at(out, first, code.bytes)
        with code.loop(size) as e:
            for k in range(TILE // width):
                x = code.read(code.at(tile, e, height), k, step)
                code.write(x, code.at(there, e, column), k, step)
    code.ret('i64', wrong.get())
    return f'{_rows(program, dtype, width, size)}\n{code}'


def _table(code: Code, count: int) -> list[Array]:
    kinds = 'ptr', 'i64', 'i64'
    numbers = [code.load(kind, code.at('%table', k, 8)) for k, kind in enumerate(kinds * count)]
    return list(zip(numbers[::3], numbers[1::3], numbers[2::3], strict=True))


def table_of(code: Code, arrays: Sequence[Array]) -> str:
    """Return the address of a table for @batch on the stack."""
    table = code.array(3 * len(arrays), 'i64')
    for k, number in enumerate(chain.from_iterable(arrays)):
        code.store('i64' if k % 3 else 'ptr', number, code.at(table, k, 8))
    return table


def _rows(program: Program, dtype: str, width: int, size: int) -> str:
    """Return `i64 @rows(count, table)`, as @batch, which runs @evaluateW on whole registers."""
    code = Code('define internal i64 @rows(i64 %count, ptr %table) noinline', dtype, width)
    step, bytes_ = code.bytes * width, code.bytes
    sizes = [*(program.inputs[name] for name in inputs_of(program)), size]
    table = _table(code, len(sizes))
    near = [code.array(elements) for elements in sizes] if width > 1 else []
    if near:
        with code.when(code.test('ult', '%count', width), rarely=True):
            _few_states(code, table, sizes, near)
    beside = [code.test('eq', row, bytes_) for _, row, _ in table]
    direct = code.both(*beside)
    final = code.integer('sub', '%count', width)
    # The second register of a long batch is aligned, and repeats states of the first one if need
    # be: then no result lies in two cache lines, if columns are whole numbers of registers.
    end = code.let(f'ptrtoint ptr {table[-1][0]} to i64')
    before = code.integer('and', code.integer('sub', 0, end), step - 1)
    head = code.integer('udiv', before, bytes_)
    long = code.test('uge', '%count', LONG * width)
    late = code.both(direct, long, code.test('ne', head, 0))
    head = code.let(f'select i1 {late}, i64 {head}, i64 {width}')
    back = code.integer('sub', width, head)
    nothing = code.variable(code.type, code.constant(0.0))
    with code.loop(code.integer('add', '%count', back), step=width) as begin:
        ahead = code.let(f'call i64 @llvm.usub.sat.i64(i64 {begin}, i64 {back})')
        first = code.least(ahead, final)
        starts = [code.at(base, first, row) for base, row, _ in table]
        places = [
            (code.variable('ptr', start), code.variable('i64', column))
            for start, (_, _, column) in zip(starts, table, strict=True)
        ]
        if near:
            with code.when(code.negated(direct)):
                for k, (address, column) in enumerate(places):
                    with code.when(code.negated(beside[k])):
                        if k < len(sizes) - 1:
                            to_columns(code, starts[k], table[k][1], near[k], sizes[k])
                        address.set(near[k])
                        column.set(step)
        arrays = given([(address.get(), column.get()) for address, column in places])
        found = code.call(code.type, f'evaluate{width}', *arrays)
        nothing.set(code.op('add', nothing.get(), found))
        if near:
            with code.when(code.negated(beside[-1])):
                to_rows(code, near[-1], starts[-1], table[-1][1], size)
    found = nothing.get()
    wrong = code.any(code.let(f'fcmp uno {code.type} {found}, {found}'))
    code.ret('i64', code.let(f'zext i1 {wrong} to i64'))
    return str(code)


def _few_states(
    code: Code, table: Sequence[Array], sizes: Sequence[int], near: Sequence[str]
) -> None:
    """Evaluate a register of states, which the last state fills up; return from the function."""
    own: list[Array] = [(copy, code.bytes, code.bytes * code.width) for copy in near]
    for source, target, size in zip(table[:-1], own, sizes, strict=False):
        _copy(code, code.width, size, source, target)
    found = code.call('i64', 'rows', f'i64 {code.width}', f'ptr {table_of(code, own)}')
    _copy(code, '%count', sizes[-1], own[-1], table[-1])
    code.ret('i64', found)


def _copy(code: Code, states: object, size: int, source: Array, target: Array) -> None:
    """Copy states of `size` elements one by one; the last one of the function fills the rest."""
    last = code.integer('sub', '%count', 1)
    with code.loop(states) as state:
        (here, row, column), (there, other_row, other_column) = source, target
        here, there = code.at(here, code.least(state, last), row), code.at(there, state, other_row)
        for e in _each(code, size):
            x = code.load(code.scalar, code.at(here, e, column), code.bytes)
            code.store(code.scalar, x, code.at(there, e, other_column), code.bytes)


def _each(code: Code, size: int, group: int = 1) -> Iterator[object]:
    """
    Yield the number of an element, or the first of a group, of which the last two may overlap.

    More than UNROLLED elements are a loop in native code.
    """
    if size <= UNROLLED:
        yield from (min(k, size - group) for k in range(0, size, group))
    else:
        with code.loop(size, step=group) as k:
            yield code.least(k, size - group) if group > 1 else k


# States and elements change places.


def to_columns(code: Code, start: str, row: object, near: str, size: int) -> None:
    """
    Copy a register of states, `row` bytes apart, whose elements are neighbours, to columns.

    Columns of one element each follow one another at `near`.
    """
    S, bytes_, step = code.scalar, code.bytes, code.bytes * code.width
    states = [code.at(start, r, row) for r in range(code.width)]
    if size == 1:
        for r, state in enumerate(states):
            code.store(S, code.load(S, state, bytes_), code.at(near, r, bytes_))
        return
    for k in _each(code, size, 2):
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
            code.write(column, code.at(near, k, step), own, step)


def to_rows(code: Code, near: str, start: str, row: object, size: int) -> None:
    """Copy columns to states: the opposite of `to_columns`."""
    S, bytes_, step = code.scalar, code.bytes, code.bytes * code.width
    states = [code.at(start, r, row) for r in range(code.width)]
    if size == 1:
        for r, state in enumerate(states):
            code.store(S, code.load(S, code.at(near, r, bytes_)), state, bytes_)
        return
    for k in _each(code, size, 2):
        a, b = (code.read(code.at(near, k, step), own, step) for own in range(2))
        for r, state in enumerate(states):
            pair = code.shuffle(code.type, a, b, [r, code.width + r])
            code.store(f'<2 x {S}>', pair, code.at(state, k, bytes_), bytes_)


# Modules.


def declarations(dtype: str, widths: Collection[int], wrapped: bool) -> str:
    """Return the declarations for functions of a module with registers of some `widths`."""
    lines = [f'declare i64 @llvm.{name}.i64(i64, i64)' for name in ('umin', 'usub.sat')]
    for code in (Code('', dtype, width) for width in sorted(set(widths))):
        for name, operands in (('sqrt', 1), ('fma', 3)):
            types = ', '.join([code.type] * operands)
            lines.append(f'declare {code.type} @llvm.{name}.{code.suffix}({types})')
        if code.width > 1:
            lines.append(f'declare i1 @llvm.vector.reduce.or.v{code.width}i1({code.flag})')
    # An angle that has to be wrapped is rare: its branch is laid out of the way.
    lines.append('!0 = !{!"branch_weights", i32 1, i32 10000}')
    return '\n'.join([*lines, *([wrap_angle()] if wrapped else [])])


def kernel_functions(program: Program, dtype: str, width: int, angles: Sequence[int]) -> list[str]:
    """
    Return the functions @evaluate1 and @batch of a module, to which an entry may be added.

    The program is lowered and has one output; `angles` are the elements of q that are turned, and
    `width` the states in a register of @batch.
    """
    functions = []
    (output,) = program.outputs.values()
    for own in sorted({1, width}):
        functions += [body(program, dtype, own), evaluate(program, dtype, own, angles)]
    functions.append(batch(program, dtype, width, len(output.places)))
    return [*functions, declarations(dtype, {1, width}, bool(angles))]
