# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of @batch for arrays whose columns evict each other from the processor's first cache.

In Fortran order each element of a state has a separate column, and a block of states reads or
writes one register of each. Where columns are a multiple of 4096 bytes long, as those of 4096
states are, all these registers lie in the same few places of a cache, which are fewer than the
columns. If a register and its neighbour in a column also share a cache line, most lines are
fetched twice. This happens for arrays that do not begin on a cache line, as NumPy allocates them,
and for registers that are shorter than a line. Besides, a processor lets a load wait for a store
whose address has the same low 12 bits. So the inputs of a block may wait for the results of the
block before. Both together took a third of the time of a batch
(docs/decisions/0047-order-of-native-code.md).

Two remedies, where strides and addresses say that this happens:

    head      the first states are computed apart, so that results begin on a cache line
    chunks    pieces of some columns are copied side by side before they are used: the results
              and as many inputs as leave few columns in the same place

For arms of many joints all columns are copied in chunks whatever their stride, since they are
more streams than a processor prefetches. With few elements that takes longer than it saves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import combinations

from pfd_core.kernels.codegen.batch import batch, table_row
from pfd_core.kernels.codegen.builder import Function, Variable
from pfd_core.kernels.codegen.copies import Rows
from pfd_core.kernels.codegen.spelling import Format, arguments
from pfd_core.machine.program import Program

# Up to so many elements, of a state and its result, columns are copied only where they evict each
# other.
FEW = 100
# Bytes of a column that are copied at once. Fewer, if all elements would take more than MOST bytes
# of the stack.
CHUNK = 512
MOST = 1 << 19
# Chunks of a batch from which these remedies are worth their time.
LONG = 8
# Bytes of a cache line; bytes after which addresses have the same place in the first cache, and
# the same low bits in a comparison of loads with stores; lines in one place. They are those of
# x86-64 processors of the last ten years, a few of which have more lines in one place.
LINE, PERIOD, WAYS = 64, 4096, 8
COPY_PARAMETERS = (
    'i1 %wanted, i64 %elements, ptr %source, i64 %source.column, ptr %target, i64 %target.column'
)


@dataclass(frozen=True)
class Plan:
    """How a batch is cut into chunks."""

    first: str  # number of the state with which the first chunk begins
    step: str  # states of a chunk
    copied: Sequence[str]  # i1 for each array: whole chunks of its columns are copied


def batch_of(program: Program, form: Format, size: int) -> str:
    """Return `i64 @batch(count, table)` as `batch`, in chunks of columns where that is faster."""
    sizes = [*(program.inputs[name] for name in arguments(program)), size]
    if sum(sizes) <= WAYS:
        return batch(program, form, size)
    register = form.width * form.bytes
    length = max(min(CHUNK // register, MOST // (sum(sizes) * register)), 1)
    states = length * form.width
    ir = Function('define i64 @batch(i64 %count, ptr %table)')
    table = [Rows(*table_row(ir, slot, 3)) for slot in range(len(sizes))]
    adjacent = [ir.let(f'icmp eq i64 {rows.row}, {form.bytes}') for rows in table]
    wrong = Variable('i64', '0')
    plan = Plan('0', str(states), adjacent)
    if sum(sizes) <= FEW:
        plan = _plan(ir, form, table, sizes, adjacent, states, wrong)
    own = ir.array('i64', 3 * len(sizes))
    near = [ir.array(form.type, elements * length) for elements in sizes]
    for slot, rows in enumerate(table):
        ir.store('i64', rows.row, ir.element('i64', own, 3 * slot + 1))
    with ir.loop('%count', wrong, start=plan.first, step=plan.step) as c:
        left = ir.let(f'sub i64 %count, {c}')
        whole = ir.let(f'icmp uge i64 {left}, {plan.step}')
        count = ir.call('i64', 'llvm.umin.i64', f'i64 {left}', f'i64 {plan.step}')
        places = []
        for slot, rows in enumerate(table):
            copied = ir.let(f'and i1 {plan.copied[slot]}, {whole}')
            there = ir.offset(rows.base, c, rows.row)
            place = ir.let(f'select i1 {copied}, ptr {near[slot]}, ptr {there}')
            column = ir.let(f'select i1 {copied}, i64 {length * register}, i64 {rows.column}')
            ir.store('ptr', place, ir.element('i64', own, 3 * slot))
            ir.store('i64', column, ir.element('i64', own, 3 * slot + 2))
            far, copy = f'ptr {there}, i64 {rows.column}', f'ptr {place}, i64 {column}'
            places.append((f'i1 {copied}, i64 {sizes[slot]}', far, copy))
        *inputs, (flag, far, copy) = places
        for given in inputs:
            ir.call('void', 'copy_columns', *given)
        failed = ir.call('i64', 'rows', f'i64 {count}', f'ptr {own}')
        ir.call('void', 'copy_columns', flag, copy, far)
        wrong.value = ir.let(f'or i64 {wrong}, {failed}')
    ir.ret('i64', wrong)
    return '\n'.join([batch(program, form, size, 'rows'), _copy_columns(form, length), str(ir)])


def _plan(
    ir: Function,
    form: Format,
    table: Sequence[Rows],
    sizes: Sequence[int],
    adjacent: Sequence[str],
    states: int,
    wrong: Variable,
) -> Plan:
    """
    Write the computation of the first states, and the choice of the columns that are copied.

    The function returns here with all states computed if no columns evict each other. All arrays
    are assumed to have columns of the length that results have.
    """
    stride = table[-1].column
    lowest = ir.let(f'and i64 {stride}, {ir.let(f"sub i64 0, {stride}")}')
    # Columns begin at multiples of this in their places of the cache.
    period = ir.call('i64', 'llvm.umin.i64', f'i64 {lowest}', f'i64 {PERIOD}')

    def more_than(lines: int, columns: object) -> str:
        """Return whether columns that begin near each other have more lines in one place."""
        product = ir.let(f'mul i64 {period}, {columns}')
        return ir.let(f'icmp ugt i64 {product}, {lines * PERIOD}')

    long = ir.let(f'icmp uge i64 %count, {LONG * states}')
    _or_without_chunks(ir, _all(ir, [*adjacent, long, more_than(WAYS, sum(sizes))]))
    starts = [ir.let(f'ptrtoint ptr {rows.base} to i64') for rows in table]
    mask = ir.let(f'sub i64 {period}, 1')

    def apart(one: str, other: str, least: int, most: int) -> str:
        """Return whether one address is so many bytes after another one's place."""
        distance = ir.let(f'sub i64 {ir.let(f"sub i64 {one}, {other}")}, {least}')
        return ir.let(f'icmp ule i64 {ir.let(f"and i64 {distance}, {mask}")}, {most - least}')

    # Columns of each array, and of arrays whose registers may have lines in the same place.
    columns = [str(elements) for elements in sizes]
    for one, other in combinations(range(len(sizes)), 2):
        near = apart(starts[one], starts[other], 1 - 2 * LINE, 2 * LINE - 1)
        for k, elements in ((one, sizes[other]), (other, sizes[one])):
            added = ir.let(f'select i1 {near}, i64 {elements}, i64 0')
            columns[k] = ir.let(f'add i64 {columns[k]}, {added}')
    crowded = [more_than(WAYS, own) for own in columns]
    _or_without_chunks(ir, _any(ir, crowded))
    first = _compute_head(ir, form, starts[-1], wrong)
    done = ir.let(f'mul i64 {first}, {form.bytes}')
    if form.width * form.bytes >= LINE:
        for k, start in enumerate(starts):
            off = ir.let(f'and i64 {ir.let(f"add i64 {start}, {done}")}, {LINE - 1}')
            crowded[k] = _all(ir, [crowded[k], ir.let(f'icmp ne i64 {off}, 0')])
    # The next registers of an input that have low bits of results.
    waits = [apart(starts[-1], start, 1, 2 * LINE - 1) for start in starts[:-1]]
    slow = _any(ir, [*crowded, *waits])
    copied, left = [], sum(sizes) - sizes[-1]
    for elements in sizes[:-1]:
        copied.append(_all(ir, [slow, more_than(2 * WAYS, left)]))
        left -= elements
    step = ir.let(f'select i1 {slow}, i64 {states}, i64 %count')
    return Plan(first, step, [*copied, slow])


def _or_without_chunks(ir: Function, flag: str) -> None:
    """Compute all states and return, unless `flag`."""
    with ir.when(ir.let(f'xor i1 {flag}, true')):
        ir.ret('i64', ir.call('i64', 'rows', 'i64 %count', 'ptr %table'))


def _compute_head(ir: Function, form: Format, results: str, wrong: Variable) -> str:
    """Compute the states before the first line that has only results; return their number."""
    before = ir.let(f'and i64 {ir.let(f"sub i64 0, {results}")}, {LINE - 1}')
    first = ir.let(f'udiv i64 {before}, {form.bytes}')
    with ir.when(ir.let(f'icmp ne i64 {first}, 0'), wrong):
        wrong.value = ir.call('i64', 'rows', f'i64 {first}', 'ptr %table')
    return first


def _all(ir: Function, flags: Sequence[str]) -> str:
    return reduce(lambda x, y: ir.let(f'and i1 {x}, {y}'), flags)


def _any(ir: Function, flags: Sequence[str]) -> str:
    return reduce(lambda x, y: ir.let(f'or i1 {x}, {y}'), flags)


def _copy_columns(form: Format, length: int) -> str:
    """Return the function that copies `length` registers of each column, if it is called for."""
    ir = Function(f'define internal void @copy_columns({COPY_PARAMETERS})')
    with ir.when('%wanted'), ir.loop('%elements') as e:
        source = ir.offset('%source', e, '%source.column')
        target = ir.offset('%target', e, '%target.column')
        for k in range(length):
            x = ir.load(form.type, ir.element(form.type, source, k), form.bytes)
            ir.store(form.type, x, ir.element(form.type, target, k), form.bytes)
    ir.ret()
    return str(ir)
