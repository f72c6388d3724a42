# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Functions of LLVM IR: loops, branches, variables, arrays, and lowered programs as functions."""

from __future__ import annotations

from collections.abc import Callable
import ctypes
from typing import Any

from bridge import (
    IrCode,
    ir_body,
    ir_declarations,
    ir_evaluate,
    ir_parameters,
    ir_to_columns,
    ir_to_rows,
    run_program,
)
from native_code import compile_ir
import numpy as np
import pytest

import pfd_core as pfd

KEEP: list[Any] = []


def address(source: str) -> int:
    """Return where the function @f of a module is."""
    KEEP.append(compile_ir(source, ['f']))
    return int(KEEP[-1]['f'])


def native(code: Any) -> Callable[[int], int]:
    """Return the function `i64 @f(i64 %x)`."""
    source = f'{code}\n{ir_declarations("float64", (1,), False)}'
    return ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64)(address(source))


def function() -> Any:
    return IrCode('define i64 @f(i64 %x)')


def test_a_variable_changes_in_each_iteration_of_a_loop() -> None:
    code = function()
    total = code.variable('i64', 0)
    with code.loop('%x') as i:
        total.set(code.integer('add', total.get(), i))
    code.ret('i64', total.get())
    f = native(code)
    assert [f(x) for x in (1, 2, 10)] == [sum(range(x)) for x in (1, 2, 10)]


def test_loops_nest_and_go_from_a_start_in_steps() -> None:
    code = function()
    total = code.variable('i64', 0)
    with code.loop('%x', start=2, step=3), code.loop('%x') as j:
        total.set(code.integer('add', total.get(), j))
    code.ret('i64', total.get())
    assert native(code)(10) == len(range(2, 10, 3)) * sum(range(10))


def test_a_loop_ends_when_its_condition_is_false() -> None:
    code = function()
    power, small = code.variable('i64', 1), code.variable('i1', 'true')
    with code.loop(20, again=small):
        power.set(code.integer('mul', power.get(), 2))
        small.set(code.test('ult', power.get(), '%x'))
    code.ret('i64', power.get())
    f = native(code)
    assert [f(x) for x in (0, 5, 64, 2**40)] == [2, 8, 64, 2**20]


def test_a_branch_changes_a_variable_only_where_it_is_taken() -> None:
    code = function()
    y = code.variable('i64', '%x')
    with code.when(code.test('slt', '%x', 0)):
        y.set(code.integer('sub', 0, '%x'))
        with code.when(code.test('ugt', y.get(), 9)):
            y.set(9)
    code.ret('i64', y.get())
    f = native(code)
    assert [f(x) for x in (3, -3, -30)] == [3, 3, 9]


def test_a_branch_and_a_requirement_may_return_at_once() -> None:
    code = function()
    with code.when(code.test('eq', '%x', 1), rarely=True):
        code.ret('i64', -1)
    code.unless(code.test('sgt', '%x', 0), 'i64', -2)
    code.ret('i64', '%x')
    f = native(code)
    assert [f(x) for x in (1, 0, 7)] == [-1, -2, 7]


def test_an_array_in_a_loop_is_allocated_once() -> None:
    code = function()
    with code.loop('%x') as i:
        place = code.array(1, 'i64')
        code.store('i64', i, place)
    code.ret('i64', code.load('i64', place))
    assert native(code)(10**7) == 10**7 - 1


@pytest.mark.parametrize(
    ('flags', 'both', 'either'),
    [(0b11, 1, 1), (0b10, 0, 1), (0b01, 0, 1), (0b00, 0, 0)],
)
def test_flags_are_joined(flags: int, both: int, either: int) -> None:
    for join, wanted in (('both', both), ('either', either)):
        code = function()
        low, high = (code.test('ne', code.integer('and', '%x', bit), 0) for bit in (1, 2))
        code.ret('i64', code.let(f'zext i1 {getattr(code, join)(low, high)} to i64'))
        assert native(code)(flags) == wanted


@pytest.mark.parametrize('kind', ['void', 'i64'])
def test_a_call_has_a_name_only_if_it_has_a_result(kind: str) -> None:
    assert bool(function().call(kind, 'g', 'i64 1')) == (kind != 'void')


def test_an_operation_without_an_instruction_is_refused() -> None:
    with pytest.raises(ValueError, match='sin'):
        function().op('sin', '%x')


@pytest.mark.parametrize('size', [1, 2, 3, 6, 7])
@pytest.mark.parametrize('dtype', ['float64', 'float32'])
def test_states_become_columns_and_columns_states(dtype: str, size: int) -> None:
    states = np.arange(8 * (size + 1), dtype=dtype).reshape(8, -1)[:, :size]
    back = np.zeros((8, size + 2), dtype)[:, :size]
    columns = np.zeros((size, 8), dtype)
    code = IrCode('define void @f(ptr %from, ptr %near, ptr %to)', dtype, 8)
    ir_to_columns(code, '%from', states.strides[0], '%near', size)
    ir_to_rows(code, '%near', '%to', back.strides[0], size)
    code.ret()
    f = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3)(address(str(code)))
    f(states.ctypes.data, columns.ctypes.data, back.ctypes.data)
    assert np.array_equal(columns, states.T)
    assert np.array_equal(back, states)


@pytest.mark.sweep
@pytest.mark.parametrize('dtype', ['float64', 'float32'])
@pytest.mark.parametrize('width', [1, 4])
@pytest.mark.parametrize('method', ['pcrbm', 'pcgm'])  # pcgm has a loop
@pytest.mark.parametrize('turns', [0, 1e7])
def test_evaluation_gives_the_bits_of_the_emulator(
    dtype: str, width: int, method: str, turns: float
) -> None:
    program = pfd.compile_kernel(pfd.load_robot('planar2'), method=method, dtype=dtype).program
    rng = np.random.default_rng(7)
    q, qd, tau, out = (rng.uniform(-1, 1, (2, width)).astype(dtype) for _ in range(4))
    q[1, -1] += turns
    names = ('q', 'qd', 'tau', 'out')
    source = [
        ir_body(program, dtype, width),
        ir_evaluate(program, dtype, width, range(2)),
        f'define void @f({ir_parameters((*names, "nothing"))}) {{',
        f'%x = call {IrCode("", dtype, width).type} @evaluate{width}({ir_parameters(names)})',
        f'store {IrCode("", dtype, width).type} %x, ptr %nothing, align 4',
        'ret void }',
        ir_declarations(dtype, (1, width), True),
    ]
    f = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p, ctypes.c_int64] * 5)(address('\n'.join(source)))
    nothing = np.empty((1, width), dtype)

    def call() -> list[bool]:
        places = ((x.ctypes.data, x.strides[0]) for x in (q, qd, tau, out, nothing))
        f(*(number for place in places for number in place))
        return np.isnan(nothing[0]).tolist()

    assert not any(call())
    kernel = pfd.compile_kernel(pfd.load_robot('planar2'), method=method, dtype=dtype)
    assert np.array_equal(out, kernel(q.T, qd.T, tau.T).T)
    if not turns:
        inputs = {'q': q.T, 'qd': qd.T, 'tau': tau.T}
        assert np.array_equal(out.T, run_program(program, inputs, dtype)['qdd'])
    qd[0, -1] = np.nan
    assert call() == [False] * (width - 1) + [True]
