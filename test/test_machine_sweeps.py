# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The column sweep, and gathering from any lane: right for any n, and what they take."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

import pfd_core as pfd
from pfd_core.machine.emulator import run
from pfd_core.machine.lanes import on
from pfd_core.machine.patterns import collect, column_sweep, gather
from pfd_core.machine.recorder import SCHEDULES, Recorder

SIZES = range(1, 33)
# Up to 32 terms of size one over diagonals of size n, in another order than NumPy's.
ROUNDING = 1e-13


def swept(n: int, schedule: str, downward: bool, unit: bool) -> pfd.Program:
    """Return the program of x from T, (n, n) of which one triangle is read, and b."""
    recorder = Recorder(n, schedule)
    columns = [
        recorder.input(
            'T', [i * n + j if (i < j if downward else i > j) else None for i in range(n)]
        )
        if j != (0 if downward else n - 1)
        else None
        for j in range(n)
    ]
    diagonal = None if unit else recorder.input('T', [i * (n + 1) for i in range(n)])
    x = column_sweep(columns, recorder.input('b', range(n)), diagonal, downward)
    recorder.output('x', (n,), [(x, i) for i in range(n)])
    return recorder.program()


@pytest.mark.parametrize('unit', [False, True])
@pytest.mark.parametrize('downward', [False, True])
@pytest.mark.parametrize('schedule', SCHEDULES)
def test_the_column_sweep_solves_triangular_systems(
    schedule: str, downward: bool, unit: bool
) -> None:
    rng = np.random.default_rng(1)
    for n in SIZES:
        T, b = rng.uniform(-1, 1, (n, n)) / n, rng.normal(size=n)
        np.fill_diagonal(T, 1.0 if unit else rng.uniform(1, 2, n))
        program = swept(n, schedule, downward, unit)
        inputs = {'T': T.ravel()[: program.inputs.get('T')], 'b': b}
        x = run(program, {name: inputs[name] for name in program.inputs})['x']
        wanted = np.linalg.solve(np.triu(T) if downward else np.tril(T), b)
        np.testing.assert_allclose(x, wanted, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize('downward', [False, True])
@pytest.mark.parametrize('n', SIZES)
def test_the_column_sweep_takes_n_minus_one_steps_and_n_divisions(n: int, downward: bool) -> None:
    # The paper's 2 n - 1 multiplications, section 2.4, are these with the divisions.
    once = pfd.Steps(multiplications=n - 1, additions=n - 1, routes=n - 1)
    assert swept(n, 'parallel', downward, unit=True).count() == once
    assert swept(n, 'parallel', downward, unit=False).count().divisions == n
    alone = swept(n, 'sequential', downward, unit=True).count()
    assert alone == pfd.Steps(multiplications=n * (n - 1) // 2, additions=n * (n - 1) // 2)


@pytest.mark.parametrize('schedule', SCHEDULES)
def test_gather_takes_each_element_from_where_it_lies(schedule: str) -> None:
    rng = np.random.default_rng(2)
    for n in SIZES:
        recorder = Recorder(n, schedule)
        rows = [recorder.input('a', range(r * n, r * n + n)) for r in range(3)]
        wanted = {
            int(lane): (int(rng.integers(3)), int(rng.integers(n)))
            for lane in rng.choice(n, size=1 + n // 2, replace=False)
        }
        found = gather({lane: (rows[r], source) for lane, (r, source) in wanted.items()})
        assert found.defined == sum(1 << lane for lane in wanted)
        recorder.output('y', (len(wanted),), [(found, lane) for lane in wanted])
        program = recorder.program()
        a = np.arange(float(program.inputs['a']))
        y = run(program, {'a': a})['y']
        np.testing.assert_array_equal(y, [r * n + source for r, source in wanted.values()])
        sent = {(r, source) for lane, (r, source) in wanted.items() if source != lane}
        busiest = max(Counter(source for _, source in sent).values(), default=0)
        assert program.count() == pfd.Steps(routes=busiest if schedule != 'sequential' else 0)


def test_collect_is_free_and_keeps_every_lane_its_own() -> None:
    recorder = Recorder(4)
    a, b = (recorder.input(name, range(4)) for name in 'ab')
    found = collect({0: b, 1: a, 3: on(b, [3])})
    assert found.defined == 0b1011
    recorder.output('y', (3,), [(found, lane) for lane in (0, 1, 3)])
    program = recorder.program()
    y = run(program, {'a': np.arange(4.0), 'b': np.arange(10.0, 14.0)})['y']
    np.testing.assert_array_equal(y, [10, 1, 13])
    assert program.count() == pfd.Steps()


def test_gathering_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match='gather: no lane is named'):
        gather({})
    with pytest.raises(ValueError, match='collect: no lane is named'):
        collect({})
