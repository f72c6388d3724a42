# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parallel patterns, plain and packed: right for any n, with the step counts of the paper."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import accumulate
import math
from pathlib import Path
import re
from typing import Any

from closed_forms import LENGTHS, levels
import numpy as np
import pytest

from benchmarks.cases import worked_example
from benchmarks.pages import array as array_page
import pfd_core as pfd
from pfd_core.machine.emulator import run as run_program
from pfd_core.machine.lanes import on as on_lane
from pfd_core.machine.recorder import SCHEDULES as MACHINE_SCHEDULES
from pfd_core.machine.recorder import LaneArray, Recorder
from pfd_core.machine.vectors import array as vector_array
from pfd_core.paper import patterns
from pfd_core.paper.lanes import broadcast as lane_broadcast

Places = list[tuple[Any, int]]
# Sums of up to 32 products of numbers near one, in another order than NumPy's.
ROUNDING = {'rtol': 1e-12, 'atol': 1e-12}
on_each_schedule = pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
downward_or_not = pytest.mark.parametrize('downward', [False, True])


def outcome(
    n: int, schedule: str, record: Callable[[Recorder], Places], **inputs: np.ndarray
) -> tuple[np.ndarray, pfd.Steps]:
    """Return the values at the recorded places, and the steps; inputs that nothing reads stay."""
    recorder = Recorder(n, schedule)
    places = record(recorder)
    recorder.output('y', (len(places),), places)
    program = recorder.program()
    given = {name: inputs[name].ravel()[:size] for name, size in program.inputs.items()}
    return run_program(program, given)['y'], program.count()


def rows(recorder: Recorder, name: str, *shape: int) -> LaneArray:
    """Return an input of shape (n, *shape), a row on each lane."""
    n, count = recorder.lanes, math.prod(shape)
    flat = [recorder.input(name, [i * count + k for i in range(n)]) for k in range(count)]
    return vector_array(flat).reshape(*shape)


def on_all(recorder: Recorder, value: Any) -> Places:
    return [(x, lane) for lane in range(recorder.lanes) for x in np.ravel(value)]


def in_order(items: Any, downward: bool, step: Callable[[Any, Any], Any]) -> np.ndarray:
    """Return the results of a recurrence, step(result before, item), along the chain."""
    found = list(accumulate(items[::-1] if downward else items, step))
    return np.array(found[::-1] if downward else found)


def rotations(rng: np.random.Generator, n: int) -> np.ndarray:
    return np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]


@pytest.mark.sweep
@on_each_schedule
@downward_or_not
def test_fohra_multiplies_matrices_in_order(schedule: str, downward: bool) -> None:
    pattern = patterns.suffix if downward else patterns.prefix
    for n in LENGTHS:
        R = rotations(np.random.default_rng(n), n)
        y, steps = outcome(
            n, schedule, lambda r: on_all(r, pattern(lambda a, b: a @ b, rows(r, 'R', 3, 3))), R=R
        )
        wanted = in_order(R, downward, lambda a, b: b @ a if downward else a @ b)
        np.testing.assert_allclose(y.reshape(n, 3, 3), wanted, **ROUNDING)
        # One product a level, or n - 1 in sequence.
        many = n - 1 if schedule == 'sequential' else levels(n)
        assert (steps.multiplications, steps.additions) == (27 * many, 18 * many)
        assert steps.routes == (0 if schedule == 'sequential' else 9 * levels(n))


@pytest.mark.sweep
@on_each_schedule
@downward_or_not
@pytest.mark.parametrize('matrices', [False, True])
def test_foihra_solves_the_recurrence_for_any_n(
    schedule: str, downward: bool, matrices: bool
) -> None:
    pattern = patterns.suffix_affine if downward else patterns.prefix_affine

    def record(recorder: Recorder) -> Places:
        b = rows(recorder, 'b', 3)
        if matrices:
            a = rows(recorder, 'a', 3, 3)
            return on_all(recorder, pattern(a, b, lambda A, x: A @ x, lambda A, B: A @ B))
        (a,) = rows(recorder, 'a', 1)
        return on_all(recorder, pattern(a, b, lambda k, x: k * x, lambda k, m: k * m))

    for n in LENGTHS:
        rng = np.random.default_rng(n)
        a, b = rotations(rng, n) if matrices else rng.normal(size=n), rng.normal(size=(n, 3))
        y, steps = outcome(n, schedule, record, a=a, b=b)
        wanted = b.copy()
        order = range(n - 2, -1, -1) if downward else range(1, n)
        for i in order:
            x = wanted[i + 1 if downward else i - 1]
            wanted[i] += a[i] @ x if matrices else a[i] * x
        np.testing.assert_allclose(y.reshape(n, 3), wanted, **ROUNDING)
        if schedule == 'parallel' and not matrices:
            # Section 2.5 (b) of the paper counts 4 L - 1 and 3 L for eq. (18): the last level
            # needs no product of coefficients.
            L = levels(n)
            assert steps.multiplications == (4 * L - 1 if n > 1 else 0)
            assert steps.additions == 3 * L


@on_each_schedule
def test_the_row_sweep_adds_up_columns_from_the_diagonal(schedule: str) -> None:
    def record(recorder: Recorder) -> Places:
        n, x0, a = recorder.lanes, rows(recorder, 'x0', 3), rows(recorder, 'a', 3)
        # a(i, j) = a(i): row i has it on the lanes behind the diagonal.
        terms = [on_lane(lane_broadcast(a, i), range(i + 1, n)) for i in range(n - 1)]
        swept = patterns.row_sweep(terms, x0)
        return [(x, j) for i in range(n) for j in range(i, n) for x in swept[i]]

    for n in LENGTHS:
        a, x0 = np.random.default_rng(n).normal(size=(2, n, 3))
        y, steps = outcome(n, schedule, record, a=a, x0=x0)
        wanted = [x0[j] + a[i:j].sum(axis=0) for i in range(n) for j in range(i, n)]
        np.testing.assert_allclose(y.reshape(-1, 3), wanted, **ROUNDING)
        pairs = n * (n - 1) // 2
        assert steps.additions == 3 * (pairs if schedule == 'sequential' else n - 1)
        assert steps.multiplications == 0


@pytest.mark.sweep
@pytest.mark.parametrize('unit', [False, True])
@downward_or_not
@on_each_schedule
def test_the_column_sweep_solves_triangular_systems(
    schedule: str, downward: bool, unit: bool
) -> None:
    def record(recorder: Recorder) -> Places:
        # Of T, (n, n), one triangle is read.
        n = recorder.lanes
        columns = [
            recorder.input(
                'T', [i * n + j if (i < j if downward else i > j) else None for i in range(n)]
            )
            if j != (0 if downward else n - 1)
            else None
            for j in range(n)
        ]
        diagonal = None if unit else recorder.input('T', [i * (n + 1) for i in range(n)])
        b = recorder.input('b', range(n))
        x = patterns.column_sweep(columns, b, diagonal, downward)
        return [(x, i) for i in range(n)]

    for n in LENGTHS:
        rng = np.random.default_rng(n)
        T, b = rng.uniform(-1, 1, (n, n)) / n, rng.normal(size=n)
        np.fill_diagonal(T, 1.0 if unit else rng.uniform(1, 2, n))
        x, steps = outcome(n, schedule, record, T=T, b=b)
        # Up to 32 terms of size one over diagonals of size n, in another order than NumPy's.
        wanted = np.linalg.solve(np.triu(T) if downward else np.tril(T), b)
        np.testing.assert_allclose(x, wanted, rtol=0, atol=1e-13)
        # The paper's 2 n - 1 multiplications, section 2.4, are n - 1 with the n divisions.
        alone = schedule == 'sequential'
        many = n * (n - 1) // 2 if alone else n - 1
        if unit:
            assert steps == pfd.Steps(many, many, routes=0 if alone else n - 1)
        assert steps.divisions == (0 if unit else n)


# ---- the worked example ----


def planar_equation() -> tuple[np.ndarray, np.ndarray]:
    """Return H and the bias of its arm by the Lagrange equations in the plane, apart from it."""
    arm = worked_example
    length, reach = arm.REACH[:, 0], arm.REACH[:, 0] + arm.CENTERS[:, 0]
    angle, speed = np.cumsum(np.round(arm.STATE['q'] / (np.pi / 2))), np.cumsum(arm.STATE['qd'])
    along = np.array([[(1, 0), (0, 1), (-1, 0), (0, -1)][int(k) % 4] for k in angle], dtype=float)
    H, bias = np.zeros((3, 3)), np.zeros(3)
    for k, m in enumerate(arm.MASSES):
        # Of the centre of mass of link k: derivatives by the joint angles, and centripetal.
        arms = np.array([*(length[:k, None] * along[:k]), reach[k] * along[k]])
        turned = np.stack([-arms[:, 1], arms[:, 0]], axis=1)
        J = np.array([turned[i:].sum(axis=0) if i <= k else (0, 0) for i in range(3)])
        drift = -(speed[: k + 1, None] ** 2 * arms).sum(axis=0)
        turns = (np.arange(3) <= k).astype(float)
        H += m * J @ J.T + arm.MOMENTS[k, 2] * np.outer(turns, turns)
        bias += m * J @ (drift - arm.GRAVITY[:2])
    return H, bias


def test_the_worked_example_has_the_numbers_of_the_lagrange_equations() -> None:
    rows = worked_example.example('pcrbm')
    H, bias = planar_equation()
    upper = [[x or 0.0 for x in one['lanes']] for one in rows if one['step'] == '8']
    np.testing.assert_array_equal(upper, np.triu(H))
    (found,) = (one['lanes'] for one in rows if one['name'].startswith('b_i ='))
    np.testing.assert_array_equal(found, bias)
    qdd = np.linalg.solve(H, worked_example.STATE['tau'] - bias)
    for method in ('pcrbm', 'pcgm'):
        np.testing.assert_allclose(worked_example.example(method)[-1]['lanes'], qdd, **ROUNDING)


def test_the_array_solves_the_equation_of_the_worked_example() -> None:
    H, bias = planar_equation()
    found, y = worked_example.equation()
    np.testing.assert_array_equal(found, H)
    np.testing.assert_array_equal(y, worked_example.STATE['tau'] - bias)
    rows = [x for x in array_page.numbers(H, y) if x['run'] == 'solve']
    kept = {(x['row'], x['column']): x['register'] for x in rows}
    L = np.linalg.cholesky(H)
    assert kept == {(k + 1, i + 1): pytest.approx(L[k, i]) for k in range(3) for i in range(k + 1)}
    # The last result of each diagonal cell is an element of the solution.
    last = {x['row']: x['number'] for x in rows if x['row'] == x['column']}
    assert list(last.values()) == pytest.approx(np.linalg.solve(H, y))


def answers() -> list[str]:
    """Return the answers of the guide, each in one line."""
    path = Path(__file__).resolve().parent.parent / 'docs' / 'guides' / 'paper.md'
    text = path.read_text(encoding='utf-8').partition('\nAnswers:\n')[2]
    return [' '.join(x.split()) for x in re.split(r'^[1-9]\. ', text, flags=re.MULTILINE)[1:]]


def written(numbers: Iterable[float]) -> str:
    return f'({", ".join(f"{x:.6g}" for x in numbers)})'


def test_answers_of_the_guide_are_the_numbers_of_the_worked_example(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = answers()
    assert len(found) == 9
    rows = worked_example.example('pcrbm')
    E = [one['lanes'][0] for one in rows if one['step'] == '5'][-1]
    assert found[0].split(' = ')[2].startswith(written(E[k] for k in (0, 3, 5)))
    second = {x['name']: x['lanes'] for x in worked_example.example('pcgm')}
    names = {name.split(' = ')[0]: lanes for name, lanes in second.items()}
    assert f'{names["gamma_1"][0]:.6g}' in found[3]
    assert written(names['x_2']) in found[3]
    # P_42 first acts on h_44, which comes first in its row.
    cycles = enumerate(array_page.RUNS['solve'](4).actions, 1)
    first = next(cycle for cycle, acting in cycles if (4, 2) in acting)
    assert found[7].endswith(f'= {first}.')
    monkeypatch.setitem(worked_example.STATE, 'qd', np.zeros(3))
    assert f'b = {written(planar_equation()[1])}' in found[1]
    monkeypatch.setattr(worked_example, 'MASSES', np.array([2.0, 1.0, 3.0]))
    H, _ = planar_equation()
    values = dict(re.findall(r'h_(\d\d) = (?:[^,]* = )?(\d+)', found[2]))
    assert values == {f'{i + 1}{k + 1}': f'{H[i, k]:g}' for i in range(3) for k in range(i, 3)}
