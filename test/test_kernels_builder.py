# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The builder of LLVM functions: loops, branches and the values that they change."""

from __future__ import annotations

from collections.abc import Callable
import ctypes

import pytest

from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.native import Native, compile_ir

KEEP: list[Native] = []


def native(ir: Function) -> Callable[[int], int]:
    """Return the function `i64 @f(i64 %x)`."""
    KEEP.append(compile_ir(str(ir), ['f']))
    return ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64)(KEEP[-1]['f'])


def test_a_loop_carries_its_variables_from_pass_to_pass() -> None:
    ir = Function('define i64 @f(i64 %x)')
    total = Variable('i64', '0')
    with ir.loop('%x', total) as i:
        total.value = ir.let(f'add i64 {total}, {i}')
    ir.ret('i64', total)
    f = native(ir)
    assert [f(x) for x in (1, 2, 10)] == [sum(range(x)) for x in (1, 2, 10)]


def test_loops_nest_and_go_from_a_start_in_steps() -> None:
    ir = Function('define i64 @f(i64 %x)')
    total = Variable('i64', '0')
    with ir.loop('%x', total, start='2', step=3), ir.loop('%x', total) as j:
        total.value = ir.let(f'add i64 {total}, {j}')
    ir.ret('i64', total)
    assert native(ir)(10) == len(range(2, 10, 3)) * sum(range(10))


def test_a_loop_ends_when_its_condition_is_false() -> None:
    ir = Function('define i64 @f(i64 %x)')
    power, small = Variable('i64', '1'), Variable('i1', 'true')
    with ir.loop(20, power, condition=small):
        power.value = ir.let(f'mul i64 {power}, 2')
        small.value = ir.let(f'icmp ult i64 {power}, %x')
    ir.ret('i64', power)
    f = native(ir)
    assert [f(x) for x in (0, 5, 64, 2**40)] == [2, 8, 64, 2**20]


def test_a_branch_changes_a_variable_only_where_it_is_taken() -> None:
    ir = Function('define i64 @f(i64 %x)')
    y = Variable('i64', '%x')
    with ir.when(ir.let('icmp slt i64 %x, 0'), y):
        y.value = ir.let('sub i64 0, %x')
        with ir.when(ir.let(f'icmp ugt i64 {y}, 9'), y):
            y.value = '9'
    ir.ret('i64', y)
    f = native(ir)
    assert [f(x) for x in (3, -3, -30)] == [3, 3, 9]


def test_a_branch_and_a_requirement_may_return_at_once() -> None:
    ir = Function('define i64 @f(i64 %x)')
    y = Variable('i64', '%x')
    with ir.when(ir.let('icmp eq i64 %x, 1'), y):
        ir.ret('i64', '-1')
    ir.require(ir.let('icmp sgt i64 %x, 0'), 'i64 -2')
    ir.ret('i64', y)
    f = native(ir)
    assert [f(x) for x in (1, 0, 7)] == [-1, -2, 7]


def test_an_array_in_a_loop_is_allocated_once() -> None:
    ir = Function('define i64 @f(i64 %x)')
    with ir.loop('%x') as i:
        place = ir.array('i64', 1)
        ir.store('i64', i, place)
    ir.ret('i64', ir.load('i64', place))
    assert native(ir)(10**7) == 10**7 - 1


def test_an_address_is_so_many_elements_or_bytes_behind_another() -> None:
    ir = Function('define i64 @f(i64 %x)')
    array = ir.array('i64', 3)
    for k in range(3):
        ir.store('i64', 10 * k, ir.element('i64', array, k))
    ir.ret('i64', ir.load('i64', ir.offset(array, '%x', 8)))
    f = native(ir)
    assert [f(x) for x in range(3)] == [0, 10, 20]


@pytest.mark.parametrize('kind', ['void', 'i64'])
def test_a_call_has_a_name_only_if_it_has_a_result(kind: str) -> None:
    result = Function('define void @f()').call(kind, 'g', 'i64 1')
    assert bool(result) == (kind != 'void')
