# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The port limit: its loop holds the operations of a kernel, no more, no fewer, and all run."""

from __future__ import annotations

from collections import Counter
import re

import numpy as np
import pytest
from sampling import one_fast

import pfd_core as pfd
from pfd_core.kernels.codegen.spelling import Format
from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.runtime import jit
from pfd_core.kernels.runtime.jit import Target
from pfd_core.machine.fused import fused
from pfd_core.machine.program import Instruction, Output
from pfd_core.report.contenders.work import LeftOutError, Work
from pfd_core.report.measure import port_limit
from pfd_core.report.measure.port_limit import Loop, loop_ir, mix, numbers
from pfd_core.report.measure.register_traffic import Traffic, traffic
from pfd_core.report.measure.timing import Pace, Times

# The text of each operation.
WRITTEN = {
    'fadd': 'add',
    'fsub': 'sub',
    'fmul': 'mul',
    'fdiv': 'div',
    'fneg': 'neg',
    'llvm.fma': 'fma',
    'llvm.sqrt': 'sqrt',
    'fcmp': 'select',
}
# Flags of LLVM IR that let it change a result.
FAST_MATH = {'fast', 'nnan', 'ninf', 'nsz', 'arcp', 'contract', 'afn', 'reassoc'}
X86 = 'x86_64-unknown-linux-gnu'
AVX512 = Target(X86, 'skylake-avx512', '+avx512f,+avx512dq,+avx512vl,+fma,-prefer-256-bit')
AVX2 = Target(X86, 'haswell', '+avx,+avx2,+fma')

# One with square roots, one with selections, the default, and one that is refined.
KERNELS = [
    ('ur5', 'composite_body', 0),
    ('ur5', 'composite_body', 1),
    ('planar2', 'pcrbm_array', 0),
    ('planar2', 'divide_and_conquer', 0),
]


def kernel_of(robot: str, method: str, refine: int, dtype: str = 'float64') -> Kernel:
    return pfd.compile_kernel(pfd.load_robot(robot), method=method, refine=refine, dtype=dtype)


def written(text: str) -> Counter[str]:
    """Return the operations in a text of LLVM IR, declarations left out."""
    lines = [line for line in text.splitlines() if ' = ' in line and 'icmp' not in line]
    names = re.compile('|'.join(map(re.escape, WRITTEN)))
    return Counter(WRITTEN[found.group()] for line in lines if (found := names.search(line)))


@pytest.mark.parametrize('dtype', one_fast(['float64', 'float32']))
@pytest.mark.parametrize(('robot', 'method', 'refine'), KERNELS)
def test_the_text_of_the_loop_holds_exactly_the_operations_of_the_kernel(
    robot: str, method: str, refine: int, dtype: str
) -> None:
    counts = kernel_of(robot, method, refine, dtype).operations['compiled']
    text = loop_ir(counts, Format(dtype, 4), 16)
    body = text[text.index('loop') : text.index('done')]
    assert written(body) == counts
    assert written(text) == counts


@pytest.mark.parametrize(('target', 'chains'), [(AVX512, 16), (AVX2, 10)], ids=['avx512', 'avx2'])
def test_there_are_as_many_accumulators_as_registers_are_left(
    target: Target, chains: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(port_limit, 'current', lambda: target)
    assert port_limit.accumulators() == chains


def test_the_loop_gives_a_compiler_no_operation_to_drop_merge_or_reorder() -> None:
    counts = kernel_of('ur5', 'composite_body', 0).operations['compiled']
    lines = loop_ir(counts, Format('float64', 4), 16).splitlines()
    assert not FAST_MATH.intersection(word for line in lines for word in line.split())
    named = [line.strip().split(' = ') for line in lines if ' = ' in line]
    operands = {name: set(re.findall(r'%v\d+', text)) for name, text in named}
    texts = dict(named)
    used = {name for line in lines if 'store' in line for name in re.findall(r'%v\d+', line)}
    waiting = list(used)
    while waiting:
        found = operands[waiting.pop()] - used
        used |= found
        waiting += found
    operations = [name for name, text in texts.items() if written(f' = {text}')]
    assert len(operations) == sum(counts.values())
    # Each reaches a result, and no two are the same.
    assert used.issuperset(operations)
    assert len({texts[name] for name in operations}) == len(operations)


def test_no_operation_waits_for_more_than_its_share_of_the_others() -> None:
    counts = kernel_of('ur5', 'composite_body', 0).operations['compiled']
    chains = 16
    depth: dict[str, int] = {}
    for line in loop_ir(counts, Format('float64', 8), chains).splitlines():
        name, _, text = line.strip().partition(' = ')
        if text and 'phi' not in text and written(line):
            operands = re.findall(r'%v\d+', text)
            # A change of sign is part of its multiply-add.
            depth[name] = max(depth.get(x, 0) for x in operands) + ('fneg' not in text)
    operations = sum(count for op, count in counts.items() if op != 'neg')
    assert max(depth.values()) == -(-operations // chains)


def test_the_kinds_of_operations_are_spread_evenly() -> None:
    # Middles of equal parts: 1/8, 3/8, 5/8, 7/8 of four, 1/4 and 3/4 of two.
    assert mix({'mul': 4, 'add': 2}) == ['mul', 'add', 'mul', 'mul', 'add', 'mul']


@pytest.mark.parametrize('dtype', ['float64', 'float32'])
def test_the_loop_computes_what_its_mix_says(dtype: str) -> None:
    kernel = kernel_of('planar2', 'pcrbm_array', 0, dtype)
    width, chains = jit.simd_width(dtype), port_limit.accumulators()
    loop = Loop(kernel, 3 * width)
    loop.run()
    one, small, *values = numbers(dtype, width, chains)
    counts = dict(kernel.operations['compiled'])
    for _ in range(3):
        signs = counts['neg']
        for k, op in enumerate(mix({name: n for name, n in counts.items() if name != 'neg'})):
            x = values[k % chains]
            sign = -1 if op == 'fma' and signs else 1
            signs -= sign < 0
            values[k % chains] = {
                'add': lambda x=x: x + small,
                'sub': lambda x=x: x - small,
                'mul': lambda x=x: x * one,
                'div': lambda x=x: x / one,
                'sqrt': lambda x=x: np.sqrt(x),
                'fma': lambda x=x, sign=sign: fused(sign * x, small, one),
            }[op]()
    np.testing.assert_array_equal(loop.results, values)


@pytest.mark.parametrize('dtype', ['float64', 'float32'])
def test_operands_in_memory_leave_the_bits_of_the_loop_alone(dtype: str) -> None:
    kernel = kernel_of('ur5', 'composite_body', 0, dtype)
    in_registers, with_memory = (Loop(kernel, 64, memory) for memory in (False, True))
    for loop in (in_registers, with_memory):
        loop.run()
    np.testing.assert_array_equal(with_memory.results, in_registers.results)


def test_the_loop_loads_and_stores_as_often_as_requested() -> None:
    counts, memory = {'fma': 30, 'select': 3, 'mul': 40}, Traffic(50, 9)
    text = loop_ir(counts, Format('float64', 4), 8, memory)
    body = text[text.index('loop') : text.index('done')]
    assert written(body) == counts
    assert body.count(' load ') == memory.loads
    assert body.count(' store ') == memory.stores
    # Between two stores no place is read twice, or a compiler would keep what it has read.
    for part in body.split(' store '):
        places = re.findall(r'getelementptr .*%numbers, i64 (\d+)', part)
        assert len(places) == len(set(places))
    with pytest.raises(LeftOutError, match='keep some of 50 loads'):
        loop_ir(counts, Format('float64', 4), 8, Traffic(50, 1))


@pytest.mark.parametrize(
    ('registers', 'expected'),
    [(8, Traffic(4, 1)), (3, Traffic(4, 1)), (2, Traffic(5, 2))],
    ids=['enough', 'just enough', 'one too few'],
)
def test_a_value_without_a_register_is_stored_and_loaded_again(
    registers: int, expected: Traffic
) -> None:
    # x = a b, y = -c d, x - y: with two registers x leaves its own to c or d.
    inputs = [Instruction('input', (), (('q', k),), 1, '') for k in range(4)]
    operations = [('mul', (0, 1)), ('neg', (2,)), ('mul', (5, 3)), ('sub', (4, 6))]
    written_out = [Instruction(op, args, None, 1, '') for op, args in operations]
    outputs = {'x': Output((1,), ((7, 0),))}
    program = pfd.Program(1, (*inputs, *written_out), {'q': 4}, outputs)
    assert traffic(program, registers) == expected


def test_fewer_registers_never_need_less_traffic() -> None:
    program = kernel_of('ur5', 'composite_body', 0).program
    found = [traffic(program, registers) for registers in (1000, 32, 16, 8)]
    assert found == sorted(found, key=lambda memory: (memory.loads, memory.stores))
    read = {i.data for i in program.instructions if i.op in ('input', 'constant')}
    # With a register for each value: what is read is loaded once, six results are stored.
    assert found[0] == Traffic(len(read), 6)


def test_a_kernel_that_iterates_or_is_cut_into_parts_has_no_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(LeftOutError, match='iterates'):
        Loop(kernel_of('planar2', 'pcgm', 0), 64)
    monkeypatch.setattr(port_limit, 'LONGEST', 10)
    with pytest.raises(LeftOutError, match='more than 10 operations'):
        Loop(kernel_of('planar2', 'composite_body', 0), 64)


@pytest.mark.parametrize('counts', [{'neg': 2, 'fma': 1}, {'route': 1}])
def test_operations_without_a_place_in_the_loop_are_refused(counts: dict[str, int]) -> None:
    with pytest.raises(LeftOutError):
        loop_ir(counts, Format('float64', 4), 8)


def test_the_share_is_the_time_of_the_loop_over_that_of_the_kernel(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kernel = kernel_of('planar2', 'composite_body', 0)
    times = [Times(5.0, 6.0, 1.0), Times(4.0, 5.0, 1.25)]
    monkeypatch.setattr(port_limit, 'interleave', lambda sides, units, pace: times)
    work = Work('batch', *np.zeros((3, 64, 2)))
    row = port_limit.measure(kernel, 'composite_body float64', work, Pace())
    assert (row.work, row.way) == (port_limit.WORK, 'composite_body float64')
    assert (row.minimum, row.median, row.times) == (4.0, 5.0, 0.8)


def test_all_numbers_of_the_loop_are_normal_and_near_one() -> None:
    for dtype in ('float64', 'float32'):
        one, small, *values = numbers(dtype, 8, 16)
        assert (small > 1e-6).all()
        assert (np.array([one, *values]) > 1).all()
        assert np.abs(np.array([one, *values]) - 1).max() < 1e-4
