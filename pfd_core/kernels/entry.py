# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A kernel's call as a native function of Python: one state or a batch, with or without `out`.

    @entry(q, qd, tau, wrench, out, brakes=, payload=, threads=)

It takes arguments by position or by name. It evaluates and returns the result if every array is
aligned, of the number format and of one number of states, if `out` overlaps no input, and if all
inputs are finite. Otherwise it calls a function in Python with the same arguments, which converts
them or raises an error. pfd_core.kernels.objects has the layout of the objects.

A batch of MANY states or more runs without the interpreter's lock. Fewer keep it: to release and
to take it takes as long as ten states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math

from pfd_core.kernels.generate import Array, given, table_of
from pfd_core.kernels.ir import Code
from pfd_core.kernels.objects import (
    ALIGNED,
    CONTIGUOUS,
    FORTRAN,
    ITEMS,
    LENGTH,
    OPTIONS,
    SLOTS,
    WRITEABLE,
    ArrayObject,
)

# States from which other threads may run Python meanwhile.
MANY = 256
DECLARATIONS = """\
declare void @pfd.incref(ptr)
declare void @pfd.decref(ptr)
declare ptr @pfd.vectorcall(ptr, ptr, i64, ptr)
declare ptr @pfd.occurred()
declare ptr @pfd.save()
declare void @pfd.restore(ptr)
declare ptr @pfd.new(ptr, ptr, i32, ptr, ptr, ptr, i32, ptr)"""
REFUSAL = ('ptr', 'null')


def entry(inputs: Mapping[str, int], dtype: str, shape: Sequence[int]) -> str:
    """
    Return `ptr @entry(self, args, count, names)` around @evaluate1 and @batch.

    `inputs` has the elements of each input, in the order in which a kernel takes them; `shape` is
    that of the result of one state. Inputs that a call does not have as arrays, brakes and
    payload, are converted in Python.
    """
    names = ['none', 'one', 'ndarray', dtype, *(f'name.{name}' for name in (*SLOTS, *OPTIONS))]
    objects = [f'@pfd.{name} = external global i8' for name in names]
    return '\n'.join([*objects, DECLARATIONS, _run(inputs, dtype, shape), _arguments()])


def _arguments() -> str:
    """Return @entry, which puts its arguments in their slots; None is in the others."""
    code = Code('define ptr @entry(ptr %self, ptr %args, i64 %count, ptr %names)')
    own = code.array(len(SLOTS), 'ptr')
    fits = code.variable('i1', code.test('ule', '%count', len(SLOTS)))
    for k in range(len(SLOTS)):
        place = code.at(own, k, 8)
        code.store('ptr', '@pfd.none', place)
        with code.when(code.test('ult', k, '%count')):
            code.store('ptr', code.load('ptr', code.at('%args', k, 8)), place)
    with code.when(code.test('ne', '%names', 'null', 'ptr')):
        count = code.load('i64', code.at('%names', LENGTH))
        with code.when(code.test('ne', count, 0)), code.loop(count) as i:
            name = code.load('ptr', code.at(code.at('%names', ITEMS), i, 8))
            place = code.at('%args', code.integer('add', '%count', i), 8)
            value = code.load('ptr', place)
            known = code.variable('i1', 'false')
            for k, slot in enumerate(SLOTS):
                with code.when(code.test('eq', name, f'@pfd.name.{slot}', 'ptr')):
                    code.store('ptr', value, code.at(own, k, 8))
                    # An argument that also has a position is given twice.
                    known.set(code.test('ule', '%count', k))
            for option, usual in OPTIONS.items():
                with code.when(code.test('eq', name, f'@pfd.name.{option}', 'ptr')):
                    known.set(code.test('eq', value, f'@pfd.{usual}', 'ptr'))
            fits.set(code.both(fits.get(), known.get()))
    with code.when(fits.get()):
        result = code.call('ptr', 'run', f'ptr {own}')
        with code.when(code.test('ne', result, 'null', 'ptr')):
            code.ret('ptr', result)
        error = code.call('ptr', 'pfd.occurred')
        with code.when(code.test('ne', error, 'null', 'ptr'), rarely=True):
            code.ret(*REFUSAL)
    fallback = code.load('ptr', code.at('%self', ITEMS))
    arguments = f'ptr {fallback}', 'ptr %args', 'i64 %count', 'ptr %names'
    code.ret('ptr', code.call('ptr', 'pfd.vectorcall', *arguments))
    return str(code)


def _run(sizes: Mapping[str, int], dtype: str, shape: Sequence[int]) -> str:
    """Return `ptr @run(args)`: the result, or null where @evaluate1 and @batch cannot give it."""
    code = Code('define internal ptr @run(ptr %args)', dtype)
    if sizes.keys() & {'free', 'p'}:
        code.ret(*REFUSAL)
        return str(code)
    state = [name for name in sizes if name != 'wrench']
    inputs = dict(zip(SLOTS, state, strict=False))
    inputs |= {'wrench': 'wrench'} if 'wrench' in sizes else {}
    values = {slot: code.load('ptr', code.at('%args', k, 8)) for k, slot in enumerate(SLOTS)}
    for slot in SLOTS[:-1]:
        if slot not in inputs:
            code.unless(code.test('eq', values[slot], '@pfd.none', 'ptr'), *REFUSAL)
    arrays = [values[slot] for slot in inputs]
    for array in arrays:
        _require_array(code, dtype, array, ALIGNED)
    ndim = _field(code, arrays[0], 'ndim')
    single = code.test('eq', ndim, 1, 'i32')
    code.unless(code.either(single, code.test('eq', ndim, 2, 'i32')), *REFUSAL)
    count = code.variable('i64', 1)
    with code.when(code.negated(single)):
        count.set(code.load('i64', _field(code, arrays[0], 'dimensions')))
    states = count.get()
    code.unless(code.test('ne', states, 0), *REFUSAL)
    batch = _Batch(code, single, states)
    rows, ends = [], []
    for array, name in zip(arrays, inputs.values(), strict=True):
        row, end = batch.place(array, ndim, (sizes[name],))
        rows.append(row)
        ends.append(end)
    axes = code.let(f'add i32 {ndim}, {len(shape) - 1}')
    result = code.variable('ptr', values['out'])
    fresh = code.test('eq', values['out'], '@pfd.none', 'ptr')
    own = code.negated(fresh)
    with code.when(fresh):
        result.set(batch.new(dtype, shape, axes, arrays[0]))
    with code.when(own):
        _require_array(code, dtype, result.get(), ALIGNED | WRITEABLE)
    out = result.get()
    last, end = batch.place(out, axes, shape)
    with code.when(own):
        for (begin, *_), its_end in zip(rows, ends, strict=True):
            before = code.test('ule', its_end, last[0], 'ptr')
            code.unless(code.either(before, code.test('ule', end, begin, 'ptr')), *REFUSAL)
    rows.append(last)
    wrong = code.variable('i1', 'true')
    with code.when(batch.alone):
        one = given([(address, code.bytes) for address, *_ in rows])
        nothing = code.call(code.type, 'evaluate1', *one)
        wrong.set(code.let(f'fcmp uno {code.type} {nothing}, {nothing}'))
    with code.when(code.negated(batch.alone)):
        many = code.test('uge', states, MANY)
        thread = code.variable('ptr', 'null')
        with code.when(many):
            thread.set(code.call('ptr', 'pfd.save'))
        found = code.call('i64', 'batch', f'i64 {states}', f'ptr {table_of(code, rows)}')
        wrong.set(code.test('ne', found, 0))
        with code.when(many):
            code.call('void', 'pfd.restore', f'ptr {thread.get()}')
    with code.when(wrong.get(), rarely=True):
        with code.when(fresh):
            code.call('void', 'pfd.decref', f'ptr {out}')
        code.ret(*REFUSAL)
    with code.when(own):
        code.call('void', 'pfd.incref', f'ptr {out}')
    code.ret('ptr', out)
    return str(code)


class _Batch:
    """The states of a call: one, in arrays without an axis of states, or some with that axis."""

    def __init__(self, code: Code, single: str, states: str) -> None:
        self._code, self._single, self._states = code, single, states
        self.alone = code.test('eq', states, 1)

    def new(self, dtype: str, shape: Sequence[int], axes: str, like: str) -> str:
        """
        Return a new array for the result.

        Neighbouring states are neighbours in memory if those of another array are, and the
        columns of elements follow each other. The function returns if there is no memory.
        """
        code, bytes_ = self._code, self._code.bytes
        lengths, strides = (code.array(1 + len(shape), 'i64') for _ in range(2))
        column = code.integer('mul', self._states, bytes_)
        code.store('i64', self._states, lengths)
        code.store('i64', bytes_, strides)
        for k, length in enumerate(shape, 1):
            code.store('i64', length, code.at(lengths, k, 8))
            distance = code.integer('mul', column, math.prod(shape[k:]))
            code.store('i64', distance, code.at(strides, k, 8))
        own = code.let(f'select i1 {self._single}, ptr {code.at(lengths, 1, 8)}, ptr {lengths}')
        contiguous = code.let(f'and i32 {_field(code, like, "flags")}, {CONTIGUOUS}')
        columns = code.test('eq', contiguous, FORTRAN, 'i32')
        # Without strides the array is in C order.
        order = code.let(f'select i1 {columns}, ptr {strides}, ptr null')
        # NumPy takes over a reference to the format.
        code.call('void', 'pfd.incref', f'ptr @pfd.{dtype}')
        array = code.call(
            'ptr',
            'pfd.new',
            *('ptr @pfd.ndarray', f'ptr @pfd.{dtype}', f'i32 {axes}', f'ptr {own}'),
            *(f'ptr {order}', 'ptr null', 'i32 0', 'ptr null'),
        )
        code.unless(code.test('ne', array, 'null', 'ptr'), *REFUSAL)
        return array

    def place(self, array: str, axes: str, shape: Sequence[int]) -> tuple[Array, str]:
        """
        Return the row of an array in the table of @batch, and where the array ends.

        The function returns unless the array has the axes and the shape, its elements and states
        follow one another as @batch expects it, and elements of one state are neighbours.
        """
        code = self._code
        code.unless(code.test('eq', _field(code, array, 'ndim'), axes, 'i32'), *REFUSAL)
        lengths, strides = (_field(code, array, name) for name in ('dimensions', 'strides'))
        first = code.let(f'select i1 {self._single}, i64 0, i64 8')
        own_lengths, own_strides = (code.at(axis, first) for axis in (lengths, strides))
        count = code.let(f'select i1 {self._single}, i64 1, i64 {code.load("i64", lengths)}')
        fits = [code.test('eq', count, self._states)]
        column = ''
        for axis in reversed(range(len(shape))):
            length = code.load('i64', code.at(own_lengths, axis, 8))
            fits.append(code.test('eq', length, shape[axis]))
            stride = code.load('i64', code.at(own_strides, axis, 8))
            if column:
                behind = math.prod(shape[axis + 1 :])
                fits.append(code.test('eq', stride, code.integer('mul', column, behind)))
            column = column or stride
        elements = math.prod(shape)
        if elements == 1:
            column = str(code.bytes)
        distance = code.let(f'select i1 {self.alone}, i64 0, i64 {code.load("i64", strides)}')
        adjacent = [code.test('eq', stride, code.bytes) for stride in (column, distance)]
        forward = code.test('sge', code.integer('or', column, distance), 0)
        code.unless(code.both(*fits, code.either(*adjacent), forward), *REFUSAL)
        base = _field(code, array, 'data')
        last = code.integer('mul', code.integer('sub', self._states, 1), distance)
        size = code.integer('add', code.integer('mul', column, elements - 1), code.bytes)
        return (base, distance, column), code.at(base, code.integer('add', last, size))


def _field(code: Code, array: str, name: str) -> str:
    field = getattr(ArrayObject, name)
    return code.load('i32' if field.size == 4 else 'ptr', code.at(array, field.offset))


def _require_array(code: Code, dtype: str, array: str, flags: int) -> None:
    """Return from the function unless an object is an array of a number format with flags."""
    code.unless(code.test('eq', _field(code, array, 'type'), '@pfd.ndarray', 'ptr'), *REFUSAL)
    own = code.let(f'and i32 {_field(code, array, "flags")}, {flags}')
    same = code.test('eq', _field(code, array, 'descr'), f'@pfd.{dtype}', 'ptr')
    code.unless(code.both(code.test('eq', own, flags, 'i32'), same), *REFUSAL)
