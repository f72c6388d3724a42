# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A kernel's call as a native function of Python: one state or a batch, with or without `out`.

    @entry(q, qd, tau, wrench, out, brakes=, payload=, threads=)

It takes arguments by position or by name, and reads arrays through the fields that NumPy's C API
publishes. It evaluates and returns the result if every array is aligned, of the number format and
of one number of states, if `out` overlaps no input, and if all inputs are finite. Otherwise it
calls a function in Python with the same arguments, which converts them or raises an error.

A batch of MANY states or more runs without the interpreter's lock. Fewer keep it: to release and
to take it takes as long as ten states.

Before the first such function is made, the layout of objects in this Python and this NumPy is
checked. If it differs, each call of a kernel is checked and converted in Python.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import ctypes
from functools import cache
import logging
import math
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.kernels.generate import given as arguments_of
from pfd_core.kernels.ir import Code
from pfd_core.kernels.native import add_symbol

# Arguments of a call by position; q, qd and tau are a program's inputs of a state in their order.
SLOTS = ('q', 'qd', 'tau', 'wrench', 'out')
# Further arguments, by name, and the one value of each that a native call takes.
OPTIONS = {'brakes': 'none', 'payload': 'none', 'threads': 'one'}
SIGNATURE = (
    'kernel(q, qd=None, tau=None, wrench=None, out=None, *, brakes=None, payload=None, threads=1)'
)
# States from which other threads may run Python meanwhile.
MANY = 256

# Fields of a NumPy array (PyArrayObject_fields of its C API): offsets in bytes, the first behind
# Python's header; and the first item of a tuple.
HEADER: int = getattr(object, '__basicsize__', 16)
TYPE, DATA, DIMENSIONS, STRIDES = HEADER - 8, HEADER, HEADER + 16, HEADER + 24
NDIM, DESCR, FLAGS = HEADER + 8, HEADER + 40, HEADER + 48
ITEMS: int = getattr(tuple, '__basicsize__', HEADER + 8)
CONTIGUOUS, FORTRAN, ALIGNED, WRITEABLE = 0x3, 0x2, 0x100, 0x400
METH_FASTCALL_KEYWORDS = 0x82
# PyArray_NewFromDescr in the table of NumPy's C API.
NEW = 94
# Functions of Python's C API, by their names in modules of LLVM IR (with the prefix pfd.); of
# several names the first one that this Python has.
FUNCTIONS = {
    'incref': ('Py_IncRef',),
    'decref': ('Py_DecRef',),
    'call': ('PyObject_CallNoArgs',),
    'vectorcall': ('PyObject_Vectorcall', '_PyFunction_Vectorcall'),
    'occurred': ('PyErr_Occurred',),
    'save': ('PyEval_SaveThread',),
    'restore': ('PyEval_RestoreThread',),
}
DECLARATIONS = """\
declare void @pfd.incref(ptr)
declare void @pfd.decref(ptr)
declare ptr @pfd.vectorcall(ptr, ptr, i64, ptr)
declare ptr @pfd.occurred()
declare ptr @pfd.save()
declare void @pfd.restore(ptr)
declare ptr @pfd.new(ptr, ptr, i32, ptr, ptr, ptr, i32, ptr)"""
REFUSAL = ('ptr', 'null')

LOG = logging.getLogger('pfd_core')
# Stands for a function that this Python lacks, and that is therefore never called.
_nowhere = ctypes.c_int64()


def entry(inputs: Mapping[str, int], dtype: str, shape: Sequence[int]) -> str:
    """
    Return `ptr @entry(self, args, count, names)` around @evaluate1 and @batch.

    Parameters
    ----------
    inputs : mapping
        Elements of each input of the program, in the order in which a kernel takes them. Where
        other inputs than of a state and `wrench` are among them, which a call does not have as
        arrays, every call is handed on.
    dtype : str
        Number format.
    shape : sequence of int
        Of the result of one state.

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
        count = code.load('i64', code.at('%names', HEADER))
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
    ndim = _field(code, arrays[0], NDIM, 'i32')
    single = code.test('eq', ndim, 1, 'i32')
    code.unless(code.either(single, code.test('eq', ndim, 2, 'i32')), *REFUSAL)
    count = code.variable('i64', 1)
    with code.when(code.negated(single)):
        count.set(code.load('i64', _field(code, arrays[0], DIMENSIONS, 'ptr')))
    states = count.get()
    code.unless(code.test('ne', states, 0), *REFUSAL)
    table = code.array(3 * len(sizes) + 3, 'i64')
    rows = [code.at(table, 3 * k, 8) for k in range(len(sizes) + 1)]
    batch = _Batch(code, single, states)
    places = [
        batch.place(array, ndim, (sizes[name],), row)
        for array, name, row in zip(arrays, sizes, rows, strict=False)
    ]
    axes = code.let(f'add i32 {ndim}, {len(shape) - 1}')
    result = code.variable('ptr', values['out'])
    fresh = code.test('eq', values['out'], '@pfd.none', 'ptr')
    given = code.negated(fresh)
    with code.when(fresh):
        result.set(batch.new(dtype, shape, axes, arrays[0]))
    with code.when(given):
        _require_array(code, dtype, result.get(), ALIGNED | WRITEABLE)
    out = result.get()
    begin, end = batch.place(out, axes, shape, rows[-1])
    with code.when(given):
        for other_begin, other_end in places:
            before = code.test('ule', other_end, begin, 'ptr')
            code.unless(code.either(before, code.test('ule', end, other_begin, 'ptr')), *REFUSAL)
    wrong = code.variable('i1', 'true')
    with code.when(batch.alone):
        one = arguments_of([(code.load('ptr', row), code.bytes) for row in rows])
        nothing = code.call(code.type, 'evaluate1', *one)
        wrong.set(code.let(f'fcmp uno {code.type} {nothing}, {nothing}'))
    with code.when(code.negated(batch.alone)):
        many = code.test('uge', states, MANY)
        thread = code.variable('ptr', 'null')
        with code.when(many):
            thread.set(code.call('ptr', 'pfd.save'))
        found = code.call('i64', 'batch', f'i64 {states}', f'ptr {table}')
        wrong.set(code.test('ne', found, 0))
        with code.when(many):
            code.call('void', 'pfd.restore', f'ptr {thread.get()}')
    with code.when(wrong.get(), rarely=True):
        with code.when(fresh):
            code.call('void', 'pfd.decref', f'ptr {out}')
        code.ret(*REFUSAL)
    with code.when(given):
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
        contiguous = code.let(f'and i32 {_field(code, like, FLAGS, "i32")}, {CONTIGUOUS}')
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

    def place(self, array: str, axes: str, shape: Sequence[int], row: str) -> tuple[str, str]:
        """
        Write the row of an array in the table of @batch; return where the array begins and ends.

        The function returns unless the array has the axes and the shape, its elements and states
        follow one another as @batch expects it, and elements of one state are neighbours.
        """
        code = self._code
        code.unless(code.test('eq', _field(code, array, NDIM, 'i32'), axes, 'i32'), *REFUSAL)
        lengths, strides = (_field(code, array, k, 'ptr') for k in (DIMENSIONS, STRIDES))
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
        fits += [code.either(*adjacent), forward]
        code.unless(code.both(*fits), *REFUSAL)
        base = _field(code, array, DATA, 'ptr')
        for k, (kind, x) in enumerate((('ptr', base), ('i64', distance), ('i64', column))):
            code.store(kind, x, code.at(row, k, 8))
        last = code.integer('mul', code.integer('sub', self._states, 1), distance)
        size = code.integer('add', code.integer('mul', column, elements - 1), code.bytes)
        return base, code.at(base, code.integer('add', last, size))


def _field(code: Code, array: str, offset: int, kind: str) -> str:
    """Return a field of an array, or of another object."""
    return code.load(kind, code.at(array, offset))


def _require_array(code: Code, dtype: str, array: str, flags: int) -> None:
    """Return from the function unless an object is an array of a number format with flags."""
    code.unless(code.test('eq', _field(code, array, TYPE, 'ptr'), '@pfd.ndarray', 'ptr'), *REFUSAL)
    own = code.let(f'and i32 {_field(code, array, FLAGS, "i32")}, {flags}')
    same = code.test('eq', _field(code, array, DESCR, 'ptr'), f'@pfd.{dtype}', 'ptr')
    code.unless(code.both(code.test('eq', own, flags, 'i32'), same), *REFUSAL)


# The function as an object of Python.


class _MethodDef(ctypes.Structure):
    _fields_ = (
        ('name', ctypes.c_char_p),
        ('meth', ctypes.c_void_p),
        ('flags', ctypes.c_int),
        ('doc', ctypes.c_char_p),
    )


def python_function(
    address: int, fallback: Callable[..., Any], owner: object
) -> Callable[..., Any]:
    """
    Return @entry at an address as a function of Python; `fallback` where it is not `supported`.

    `fallback`, a function written in Python with SIGNATURE and the docstring, gets the arguments
    that @entry does not take; `owner` owns the code.
    """
    if not supported():
        return fallback
    doc = f'{SIGNATURE}\n--\n\n{fallback.__doc__}'.encode()
    definition = _MethodDef(b'kernel', address, METH_FASTCALL_KEYWORDS, doc)
    make = ctypes.pythonapi.PyCFunction_NewEx
    make.argtypes = [ctypes.c_void_p, ctypes.py_object, ctypes.py_object]
    make.restype = ctypes.py_object
    # The function holds its definition and code as its `self`, so that they outlive it.
    keep = (fallback, owner, definition)
    function: Callable[..., Any] = make(ctypes.addressof(definition), keep, __name__)
    return function


def register_symbols() -> None:
    """Give the compiler the addresses of the objects and functions that modules refer to."""
    for name in FUNCTIONS:
        add_symbol(f'pfd.{name}', _address(name) or ctypes.addressof(_nowhere))
    add_symbol('pfd.new', _new() or ctypes.addressof(_nowhere))
    objects: dict[str, Any] = {'none': None, 'one': 1, 'ndarray': np.ndarray}
    objects |= {dtype: np.dtype(dtype) for dtype in ('float64', 'float32')}
    objects |= {f'name.{name}': interned for name, interned in _NAMES.items()}
    for name, value in objects.items():
        add_symbol(f'pfd.{name}', id(value))


# A name in a call is the same object wherever it is written; this keeps it.
_NAMES = {name: sys.intern(name) for name in (*SLOTS, *OPTIONS)}


@cache
def supported() -> bool:
    """Return whether Python can call native code that reads its arrays; log once why not."""
    try:
        obstacle = _obstacle()
    except Exception as error:  # reading an object of another layout may raise anything
        obstacle = repr(error)
    if obstacle:
        LOG.warning(
            'each call of a kernel takes a longer way, because native code cannot read the '
            'arrays of Python %s with NumPy %s: %s',
            *(sys.version.split()[0], np.__version__, obstacle),
        )
    return not obstacle


def _obstacle() -> str:
    """Return how this Python or NumPy differs from the expected layout; empty if it does not."""
    if sys.implementation.name != 'cpython' or ctypes.sizeof(ctypes.c_void_p) != 8:
        bits = 8 * ctypes.sizeof(ctypes.c_void_p)
        return f'expected 64-bit CPython, found {sys.implementation.name} of {bits} bits'
    absent = [' or '.join(names) for name, names in FUNCTIONS.items() if not _address(name)]
    if not hasattr(ctypes.pythonapi, 'PyCFunction_NewEx'):
        absent.append('PyCFunction_NewEx')
    if absent:
        return f'its C API lacks {", ".join(absent)}'
    if not _new():
        return 'NumPy has no table of its C API'
    fixed = np.zeros(3)
    fixed.flags.writeable = False
    probes = (np.zeros(3), fixed, np.zeros((4, 3), np.float32)[::2, ::-1])
    differences = (_difference(probe) for probe in (*probes, np.zeros((2, 3), order='F')))
    return next(filter(None, differences), _difference_of_tuples())


def _address(name: str) -> int | None:
    """Return the address of a row of FUNCTIONS, or None."""
    for function in FUNCTIONS[name]:
        found = getattr(getattr(ctypes, 'pythonapi', None), function, None)
        if found is not None:
            return ctypes.cast(found, ctypes.c_void_p).value
    return None


def _new() -> int | None:
    """Return the address of PyArray_NewFromDescr, or None."""
    core: Any = getattr(np, '_core', None) or np.core
    table = getattr(core._multiarray_umath, '_ARRAY_API', None)
    find = getattr(getattr(ctypes, 'pythonapi', None), 'PyCapsule_GetPointer', None)
    if table is None or find is None:
        return None
    find.restype, find.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return ctypes.c_void_p.from_address(find(table, None) + 8 * NEW).value


def _difference_of_tuples() -> str:
    """Return how a tuple's fields differ from its items; empty if they do not."""
    probe = ('q', 'qd')
    if sys.getsizeof(probe) < ITEMS + 16:
        return f'a tuple of two holds {sys.getsizeof(probe)} bytes'
    count = ctypes.c_int64.from_address(id(probe) + HEADER).value
    items = [ctypes.c_void_p.from_address(id(probe) + ITEMS + 8 * k).value for k in range(2)]
    same = (count, items) == (2, [id(item) for item in probe])
    return '' if same else f'a tuple of two has {count} items at {ITEMS} bytes'


def _difference(probe: NDArray[Any]) -> str:
    """Return how the fields of an array differ from its attributes; empty if they do not."""
    if FLAGS + ctypes.sizeof(ctypes.c_int) > type(probe).__basicsize__:
        return f'an array holds {type(probe).__basicsize__} bytes'

    def field(offset: int, kind: Any) -> Any:
        return kind.from_address(id(probe) + offset).value

    flags = ALIGNED * probe.flags.aligned | WRITEABLE * probe.flags.writeable
    flags |= probe.flags.c_contiguous | FORTRAN * probe.flags.f_contiguous
    wanted: tuple[Any, ...] = (
        id(type(probe)),
        probe.ctypes.data,
        probe.ndim,
        id(probe.dtype),
        flags,
    )
    found: tuple[Any, ...] = (
        field(TYPE, ctypes.c_void_p),
        field(DATA, ctypes.c_void_p),
        field(NDIM, ctypes.c_int),
        field(DESCR, ctypes.c_void_p),
        field(FLAGS, ctypes.c_int) & (ALIGNED | WRITEABLE | CONTIGUOUS),
    )
    # Shape and strides are behind pointers, which are followed only if all else is as expected.
    if found == wanted:
        numbers = ctypes.c_int64 * probe.ndim
        wanted = (*probe.shape, *probe.strides)
        found = tuple(
            number
            for offset in (DIMENSIONS, STRIDES)
            for number in numbers.from_address(field(offset, ctypes.c_void_p))
        )
    return '' if found == wanted else f'an array has fields {found}, expected {wanted}'


register_symbols()
