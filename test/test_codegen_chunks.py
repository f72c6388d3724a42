# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches whose columns evict each other: bits of single states, and which columns are copied."""

from __future__ import annotations

from collections.abc import Sequence
import ctypes
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
import pytest
from sampling import one_fast
from zoo import random_chain

import pfd_core as pfd
from pfd_core.kernels.codegen import chunks
from pfd_core.kernels.codegen.module import module
from pfd_core.kernels.codegen.spelling import Format
from pfd_core.kernels.runtime.jit import compile_ir
from pfd_core.kernels.runtime.threads import BATCH, address
from pfd_core.machine.program import Program

PAGE = 4096
# Bytes from column to column.
STRIDE = 2 * PAGE


def columns(
    rows: int, elements: int, offset: int, dtype: str = 'float64', stride: int = STRIDE
) -> NDArray[np.floating]:
    """Return (rows, elements), whose columns are `stride` bytes apart and begin at an offset."""
    raw = np.zeros(stride * (elements + 1) + 2 * PAGE, np.uint8)
    start = -raw.ctypes.data % PAGE + offset
    table = raw[start : start + stride * elements].view(dtype)
    found: NDArray[np.floating] = table.reshape(elements, -1).T[:rows]
    return found


# Bytes after the begin of a page of three inputs and the result.
PLACES = [
    (0, 0, 0, 0),
    (16, 16, 16, 16),
    (0, 0, 0, 64),
    (16, 32, 48, 64),
    (48, 16, 0, 3056),
    (8, 1040, 2048, 24),
]


@pytest.mark.parametrize('dtype', one_fast(['float64', 'float32']))
@pytest.mark.parametrize('offsets', PLACES, ids=str)
def test_crowded_columns_give_the_bits_of_single_states(
    offsets: Sequence[int], dtype: str
) -> None:
    rng = np.random.default_rng(71)
    kernel = pfd.compile_kernel(random_chain(rng, 4), dtype=dtype)
    size = STRIDE // np.dtype(dtype).itemsize - 3
    q, qd, tau, out = (columns(size, 4, offset, dtype) for offset in offsets)
    for array in (q, qd, tau):
        array[:] = rng.normal(size=array.shape)
    alone = np.array([kernel(q[k], qd[k], tau[k]) for k in range(size)])
    for first, count in ((0, size), (1, size - 1), (5, size // 2 + 5), (0, size // 2 - 1)):
        out[:] = np.nan
        own = slice(first, first + count)
        kernel(q[own], qd[own], tau[own], out=out[own])
        np.testing.assert_array_equal(out[own], alone[own])
        assert np.isnan(out[:first]).all()
        assert np.isnan(out[first + count :]).all()
    # The result may replace an input.
    np.testing.assert_array_equal(kernel(q, qd, tau, out=tau), alone)


@pytest.mark.parametrize('state', [0, 3, 77, 600, 1020], ids='state {}'.format)
@pytest.mark.parametrize('offsets', [(16, 16, 16, 16), (16, 32, 48, 64)], ids=str)
def test_a_number_that_is_not_finite_is_found_in_each_chunk(
    offsets: Sequence[int], state: int
) -> None:
    rng = np.random.default_rng(72)
    kernel = pfd.compile_kernel(random_chain(rng, 4))
    q, qd, tau, out = (columns(1021, 4, offset) for offset in offsets)
    qd[state, 2] = np.inf
    with pytest.raises(ValueError, match=rf'qd must be finite, got inf at index \[{state}, 2\]'):
        kernel(q, qd, tau, out=out)


@dataclass(frozen=True)
class Run:
    """Blocks that are computed in one go."""

    count: int
    addresses: list[int]  # of the first state, by array
    strides: list[int]  # from element to element


def runs(
    arrays: Sequence[NDArray[np.floating]], monkeypatch: pytest.MonkeyPatch, width: int = 8
) -> list[Run]:
    """Return how @batch divides a batch of three inputs and a result."""
    found: list[Run] = []

    def rows(count: int, place: int) -> int:
        table = np.ctypeslib.as_array((ctypes.c_int64 * 12).from_address(place)).reshape(4, 3)
        assert (table[:, 1] == arrays[0].strides[0]).all()
        found.append(Run(count, table[:, 0].tolist(), table[:, 2].tolist()))
        return 0

    callback = BATCH(rows)
    pointer = ctypes.cast(callback, ctypes.c_void_p).value
    stub = (
        'define i64 @rows(i64 %count, ptr %table) {\n'
        f'  %r = call i64 inttoptr (i64 {pointer} to ptr)(i64 %count, ptr %table)\n'
        '  ret i64 %r\n}'
    )
    monkeypatch.setenv('PFD_CACHE', '')
    monkeypatch.setattr(chunks, 'batch', lambda *given: stub)
    inputs = {name: x.shape[1] for name, x in zip(('q', 'qd', 'tau'), arrays, strict=False)}
    form = Format('float64', width, strided=True)
    ir = chunks.batch_of(Program(1, (), inputs, {}), form, arrays[-1].shape[1])
    code = compile_ir(module([ir], form, ()))
    table = np.array([(address(x), *x.strides) for x in arrays])
    assert BATCH(code.address('batch'))(len(arrays[0]), address(table)) == 0
    return found


def starts(arrays: Sequence[NDArray[np.floating]], state: int = 0) -> list[int]:
    return [address(x[state:]) for x in arrays]


@pytest.mark.parametrize(
    ('offsets', 'stride', 'count'),
    [
        ((0, 0, 0, 0), STRIDE, 1024),
        ((0, 64, 128, 192), PAGE + 64, 512),
        ((16, 32, 48, 64), PAGE + 64, 512),
        ((16, 32, 48, 64), STRIDE, 511),
        ((16, 1040, 2064, 3088), STRIDE, 1024),
    ],
    ids=['whole lines', 'another stride', 'between lines', 'few states', 'arrays far apart'],
)
def test_a_batch_is_computed_in_one_go_where_no_columns_evict_each_other(
    offsets: Sequence[int], stride: int, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    arrays = [columns(count, 6, offset, stride=stride) for offset in offsets]
    (run,) = runs(arrays, monkeypatch)
    assert (run.count, run.addresses, run.strides) == (count, starts(arrays), [stride] * 4)


def test_states_in_rows_are_computed_in_one_go(monkeypatch: pytest.MonkeyPatch) -> None:
    arrays = [np.zeros((1024, 1024))[:, :6] for _ in range(4)]
    (run,) = runs(arrays, monkeypatch)
    assert (run.count, run.addresses) == (1024, starts(arrays))


def test_a_head_lets_all_arrays_begin_on_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    arrays = [columns(1022, 6, 16) for _ in range(4)]
    head, rest = runs(arrays, monkeypatch)
    assert (head.count, head.addresses) == (6, starts(arrays))
    assert (rest.count, rest.addresses) == (1016, starts(arrays, 6))
    assert all(start % chunks.LINE == 0 for start in rest.addresses)
    assert head.strides == rest.strides == [STRIDE] * 4


@pytest.mark.parametrize(
    ('offsets', 'first'),
    [((16, 32, 48, 64), 0), ((0, 0, 0, 64), 0), ((32, 48, 64, 80), 6)],
    ids=['between lines', 'results a line behind', 'with a head'],
)
def test_crowded_results_and_enough_inputs_are_copied(
    offsets: Sequence[int], first: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    arrays = [columns(1024 - first, 6, offset) for offset in offsets]
    found = runs(arrays, monkeypatch)
    if first:
        assert found.pop(0) == Run(first, starts(arrays), [STRIDE] * 4)
    whole, left = divmod(1024 - 2 * first, chunks.CHUNK // 8)
    assert [run.count for run in found] == [chunks.CHUNK // 8] * whole + [left] * (left > 0)
    for k, run in enumerate(found[:whole]):
        own = starts(arrays, first + k * chunks.CHUNK // 8)
        assert run.addresses[1:3] == own[1:3]
        assert run.strides == [chunks.CHUNK, STRIDE, STRIDE, chunks.CHUNK]
        assert not {run.addresses[0], run.addresses[3]} & set(own)
        assert all(run.addresses[copied] % chunks.LINE == 0 for copied in (0, 3))
    if left:
        assert found[-1].addresses == starts(arrays, first + whole * chunks.CHUNK // 8)


def test_registers_that_share_a_line_are_copied_also_from_whole_lines(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arrays = [columns(512, 6, 0) for _ in range(4)]
    found = runs(arrays, monkeypatch, width=4)
    assert [run.strides for run in found] == [[chunks.CHUNK, STRIDE, STRIDE, chunks.CHUNK]] * 8


def test_so_many_columns_are_copied_that_few_are_left(monkeypatch: pytest.MonkeyPatch) -> None:
    # Of 4 x 12 columns 12 are left in one place; every other column lies in the same place.
    offsets = (16, 32, 48, 64)
    for stride, copied in ((STRIDE, (0, 1, 3)), (STRIDE - PAGE // 2, (0, 3))):
        arrays = [columns(768, 12, offset, stride=stride) for offset in offsets]
        found = runs(arrays, monkeypatch)
        assert len(found) == 768 * 8 // chunks.CHUNK
        for run in found:
            wanted = [chunks.CHUNK if k in copied else stride for k in range(4)]
            assert run.strides == wanted


def test_a_batch_of_few_elements_has_no_chunks() -> None:
    program = Program(1, (), {'q': 2, 'qd': 2, 'tau': 2}, {})
    assert chunks.WAYS == 2 + 2 + 2 + 2
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(chunks, 'batch', lambda *given: 'only this')
        assert chunks.batch_of(program, Format('float64', 8, strided=True), 2) == 'only this'
