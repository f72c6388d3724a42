# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The triangular array and set ordering; the parallel patterns, right and with their counts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial
from itertools import accumulate
import math
from pathlib import Path
import re
from typing import Any

from closed_forms import EVERY_SIZE, LENGTHS, levels
import mpmath
import numpy as np
import pytest

from benchmarks.cases import worked_example
from benchmarks.pages import array as array_page
from benchmarks.pages import array as page
from benchmarks.pages import worked_example as example_page
import pfd_core as pfd
from pfd_core.machine.emulator import run as run_program
from pfd_core.machine.lanes import on as on_lane
from pfd_core.machine.recorder import SCHEDULES as MACHINE_SCHEDULES
from pfd_core.machine.recorder import LaneArray, Recorder
from pfd_core.machine.vectors import array as vector_array
from pfd_core.paper import patterns, systolic
from pfd_core.paper.array import literal_array
from pfd_core.paper.array import pipeline as array_pipeline
from pfd_core.paper.array import solve as array_solve
from pfd_core.paper.lanes import broadcast as lane_broadcast
from pfd_core.paper.solve import literal_factor, set_ordering

FIRST = systolic.Link((1, 0), (1, 1))


def row_of_cells(n: int, cell: Any) -> systolic.Array:
    """Return n cells in a row_of_cells, linked from left to right, open at both ends."""
    links = [systolic.Link((1, i), (1, i + 1)) for i in range(n + 1)]
    return systolic.Array({(1, i): cell for i in range(1, n + 1)}, links)


def pass_on(state: Any, ports: systolic.Ports) -> systolic.Step:
    return systolic.Step(state, {'right': ports['left']}, 'pass')


def test_a_cell_cannot_read_where_it_has_no_link() -> None:
    def peek(state: Any, ports: systolic.Ports) -> systolic.Step:
        assert ports.get('up') is None
        assert 'up' not in ports
        return systolic.Step(ports['up'])

    array = systolic.Array({(1, 1): pass_on, (1, 2): peek}, row_of_cells(2, pass_on).links)
    with pytest.raises(systolic.LinkError, match=r"reads from 'up', but only has .*'left'"):
        array.run({FIRST: {1: 'a'}})


@pytest.mark.parametrize(
    ('way', 'message'),
    [
        ('up', r"cell \(1, 1\) sends 'up', but only has links to \['right'\]"),
        ('north', r"cell \(1, 1\) sends 'north', but only has links to \['right'\]"),
    ],
)
def test_a_cell_cannot_send_where_it_has_no_link(way: str, message: str) -> None:
    with pytest.raises(systolic.LinkError, match=message):
        row_of_cells(2, lambda state, ports: systolic.Step(state, {way: 1})).run({FIRST: {1: 'a'}})


@pytest.mark.parametrize(
    ('link', 'message'),
    [
        (systolic.Link((1, 1), (1, 3)), r'\(1, 1\) -> \(1, 3\) must join a cell with a neigh'),
        (systolic.Link((1, 1), (2, 2)), r'\(1, 1\) -> \(2, 2\) must join a cell with a neigh'),
        (systolic.Link((1, 1), (1, 1)), r'\(1, 1\) -> \(1, 1\) must join a cell with a neigh'),
        (systolic.Link((5, 5), (5, 6)), r'\(5, 5\) -> \(5, 6\) must join a cell with a neigh'),
    ],
)
def test_links_join_neighbours_and_touch_a_cell(link: systolic.Link, message: str) -> None:
    with pytest.raises(systolic.LinkError, match=message):
        systolic.Array({(1, 1): pass_on}, [FIRST, link])


# ---- the array ----


STORE, MULTIPLY, ROOT = 'store', 'multiply and subtract', 'square root'
Array = np.ndarray[Any, Any]


@pytest.mark.parametrize('n', [1, 2, 3, 4, 7])
def test_every_time_is_as_claimed_but_the_end_of_the_papers_input(n: int) -> None:
    # The paper has all input stored after 2 n - 1 cycles; P_nn stores h_nn in cycle 3 n - 2.
    wrong = [x for x in page.times([n]) if x['measured'] != x['claimed']]
    assert [x['event'] for x in wrong] == ['all input from below is stored'] * (n > 1)
    assert all(x['measured'] == 3 * n - 2 for x in wrong)


def integers(n: int) -> tuple[Array, Array, Array]:
    """Return L, H = L L' and x of small whole numbers: every step of a solve is then exact."""
    rng = np.random.default_rng(n)
    L = np.tril(rng.integers(-4, 5, (n, n)), -1) + np.diag(rng.integers(1, 6, n)).astype(float)
    return L, L @ L.T, rng.integers(-9, 10, n).astype(float)


@pytest.mark.parametrize('n', EVERY_SIZE)
def test_a_right_hand_side_takes_one_cycle_more_and_a_solve_2n_minus_1(n: int) -> None:
    L, H, x = integers(n)
    plain, forward, whole = (
        array_pipeline([H])[0],
        array_pipeline([H], [H @ x])[0],
        array_solve(H, H @ x),
    )
    np.testing.assert_array_equal(plain.L, L)
    np.testing.assert_array_equal(forward.z, L.T @ x)
    np.testing.assert_array_equal(whole.x, x)
    cycles = [found.trace.cycles for found in (plain, forward, whole)]
    assert cycles == [3 * n - 2, 3 * n - 1, 5 * n - 2]


@pytest.mark.parametrize('n', range(1, 9))
def test_the_printed_array_keeps_its_input_in_the_cycles_of_the_paper(n: int) -> None:
    _, H, _ = integers(n)
    trace = literal_array(H).trace
    stored = {
        place: t
        for t, acting in enumerate(trace.actions, 1)
        for place, name in acting.items()
        if name == STORE
    }
    places = [(k, i) for k in range(1, n + 1) for i in range(1, k + 1)]
    assert stored == {(k, i): 2 * k + i - 2 for k, i in places}
    assert {place: trace.states[place] for place in stored} == {
        (k, i): H[k - 1, i - 1] for k, i in places
    }
    # h_nn and the flag are in P_n1 at 2n, its last cycle, and one cell further in each.
    for i in range(1, n + 1):
        assert trace.actions[2 * n + i - 2][n, i] == (ROOT if i == n else MULTIPLY)


@pytest.mark.parametrize('n', EVERY_SIZE)
def test_the_printed_array_takes_3n_minus_1_cycles_for_equations_11_and_12(n: int) -> None:
    _, H, _ = integers(n)
    # One on the diagonal, little elsewhere: the one kind of matrix whose roots all exist. With
    # ones on the diagonal the first wrong element is l_32, which divides by h_22.
    mild = np.eye(n) + (H - np.diag(np.diag(H))) / (64.0 * n * abs(H).max())
    for matrix in (H, mild):
        found = literal_array(matrix)
        equations = run_program(equations_11_and_12(n, 'parallel'), {'H': matrix.ravel()})
        np.testing.assert_array_equal(found.L, equations['L'])
        assert found.trace.cycles == 3 * n - 1
    # The bound of Cholesky's backward error.
    difference = abs(found.L @ found.L.T - mild)[np.tril_indices(n)].max()
    assert (difference <= (n + 1) * np.finfo(float).eps) == (n < 3)


@pytest.mark.parametrize('second', [2.0, 1.0])
def test_a_cell_that_compares_numbers_keeps_an_equal_element_too(second: float) -> None:
    # Column 1 of Figure 2 (b) as printed, u_in = h_ki: h_21 and h_31 pass P_21 on their way.
    wanted = {(1, 1): 1.0, (1, 2): second}

    def keeps(number: float, kept: list[float] | None, ports: systolic.Ports) -> systolic.Step:
        item, kept = ports['left'], kept or []
        equal = item == number
        return systolic.Step([*kept, item] if equal else kept, {} if equal else {'right': item})

    links = row_of_cells(2, pass_on).links
    cells = {place: partial(keeps, number) for place, number in wanted.items()}
    trace = systolic.Array(cells, links).run({FIRST: {1: 1.0, 2: second}})
    assert (trace.states[1, 1], trace.states[1, 2]) == (
        ([1.0], [2.0]) if second == 2.0 else ([1.0, 1.0], None)
    )


def test_a_matrix_that_cannot_be_factored_gives_nan_and_leaves_the_next_ones_alone() -> None:
    _, H, _ = integers(4)
    results = array_pipeline([H, -H, H])
    assert [np.isfinite(result.L).all() for result in results] == [True, False, True]
    np.testing.assert_array_equal(results[2].L, results[0].L)
    for matrix in ([[-1.0]], [[0.0]], [[1.0, 2.0], [2.0, 1.0]]):
        for number in (1.0, mpmath.mpf(1)):
            found = array_solve(np.array(matrix) * number, np.ones(len(matrix)))
            assert not np.isfinite(found.x.astype(float)).any()


@pytest.mark.parametrize('n', [2, 6])
def test_matrices_follow_one_another_every_n_cycles(n: int) -> None:
    H = 2 * np.eye(n)
    cycles = [array_pipeline([H] * k)[0].trace.cycles for k in (1, 2, 5)]
    assert cycles == [3 * n - 2, 4 * n - 2, 7 * n - 2]


@pytest.mark.parametrize('n', [1, 2, 6])
def test_a_cell_acts_once_for_each_element_of_its_row(n: int) -> None:
    # P_ki meets the elements h_kk .. h_nk of row k; as printed it stores h_ki first.
    for name, stored in (('corrected', 0), ('as printed', 1)):
        acting = Counter(place for cycle in page.RUNS[name](n).actions for place in cycle)
        assert acting == {
            (k, i): n - k + 1 + stored for k in range(1, n + 1) for i in range(1, k + 1)
        }


@pytest.mark.parametrize('n', [2, 3, 6, 8, 9])
def test_a_level_doubles_what_a_lane_holds(n: int) -> None:
    rows = list(example_page.doubling(n))
    assert len(rows) == n * (1 + (n - 1).bit_length())
    for x in rows:
        # Lane i holds its element and the 2^k - 1 before it, as far as there are any.
        level, lane = x['level'], x['lane']
        assert (x['first'], x['last']) == (max(1, lane + 1 - 2**level), lane)


# ---- set ordering, equations (11) and (12) ----

# The sets as Appendix C prints them after Steps 1, 2, 4 and 6, with its misprints corrected.
APPENDIX_C = (
    """
    S_44 = {a_44^(3), a_44^(2), a_44^(1), a_44^(0)}
    S_43 = {a_43^(2), a_43^(1), a_43^(0)}
    S_33 = {a_33^(2), a_33^(1), a_33^(0)}
    S_42 = {a_42^(1), a_42^(0)}
    S_32 = {a_32^(1), a_32^(0)}
    S_22 = {a_22^(1), a_22^(0)}
    """,
    """
    S_44 = {a_44^(3), a_44^(2), a_44^(1,0)}
    S_43 = {a_43^(2), a_43^(1,0)}
    S_33 = {a_33^(2), a_33^(1,0)}
    S_32 = {a_32^(1), a_32^(0)}
    S_22 = {a_22^(1), a_22^(0)}
    S_42 = {a_42^(1,0)}
    """,
    """
    S_44 = {a_44^(3), a_44^(2,0)}
    S_22 = {a_22^(1), a_22^(0)}
    S_43 = {a_43^(2,0)}
    S_33 = {a_33^(2,0)}
    S_32 = {a_32^(1,0)}
    """,
    """
    S_44 = {a_44^(3,0)}
    S_22 = {a_22^(1,0)}
    """,
)


def test_appendix_c_comes_out_set_by_set() -> None:
    states = set_ordering(4)
    assert len(states) == len(APPENDIX_C)
    for state, text in zip(states, APPENDIX_C, strict=True):
        assert str(state).split() == text.split()


@pytest.mark.parametrize('n', EVERY_SIZE)
def test_the_procedure_takes_a_third_of_the_additions_that_the_paper_prints(n: int) -> None:
    states = set_ordering(n)
    taken = len(states) - 1
    assert taken == math.ceil((n * n - 1) / 6)
    assert taken <= n * (n - 1) // 2  # what section 2.4 says of the procedure
    assert sum(len(state.picked) for state in states) == (n**3 - n) // 6
    assert states[-1].N == 0
    last = {index: states[-1].terms(index) for index in states[-1].additions}
    assert last == {(k, i): [f'a_{k}{i}^({i - 1},0)'] for k, i in last}


def equations_11_and_12(n: int, schedule: str) -> pfd.Program:
    """Return the program of L, (n, n), and its radicands, (n,), from the lower triangle of `H`."""
    recorder = Recorder(n, schedule)
    lower = [[k * n + i if k >= i else None for k in range(n)] for i in range(n)]
    columns, diagonal, radicands = literal_factor([recorder.input('H', at) for at in lower])
    zero = recorder.constant(0.0)
    rows = [[*columns[:k], diagonal, *[zero] * (n - 1 - k)] for k in range(n)]
    recorder.output('L', (n, n), [(x, k) for k, row in enumerate(rows) for x in row])
    recorder.output('radicands', (n,), [(radicands, lane) for lane in range(n)])
    return recorder.program()


@pytest.mark.parametrize('n', EVERY_SIZE)
def test_the_literal_factorisation_takes_the_steps_of_its_parts(n: int) -> None:
    # The paper: ceil((n^2-1)/6), ceil((n^2-1)/2), ceil((n-1)/2) and one.
    steps = equations_11_and_12(n, 'parallel').count()
    level = math.ceil((n * n - 1) / 6)
    assert (steps.multiplications, steps.additions) == (level, level)
    assert (steps.divisions, steps.square_roots) == (math.ceil((n - 1) / 2), 1)


def printed(H: np.ndarray) -> np.ndarray:
    """Return equations (11) and (12), element by element, as they are printed."""
    n = len(H)
    L = np.zeros((n, n))
    with np.errstate(invalid='ignore'):
        for k in range(n):
            for i in range(k + 1):
                lhat = H[k, i]
                for j in range(i):
                    lhat = lhat - H[i, j] * H[k, j]
                L[k, i] = np.sqrt(lhat) if i == k else lhat / H[i, i]
    return L


@pytest.mark.parametrize('schedule', MACHINE_SCHEDULES)
@pytest.mark.parametrize('n', [1, 2, 3, 4, 7, 12])
def test_the_program_is_equations_11_and_12(n: int, schedule: str) -> None:
    A = np.random.default_rng(n).normal(size=(n, n))
    H = A @ A.T + 0.1 * np.eye(n)
    result = run_program(equations_11_and_12(n, schedule), {'H': H.ravel()})
    np.testing.assert_array_equal(result['L'], printed(H))
    below = np.array([H[k, k] - H[k, :k] @ H[k, :k] for k in range(n)])
    # Of sums of up to 11 products of the order of n^2, in another order.
    np.testing.assert_allclose(result['radicands'], below, rtol=0, atol=1e-11)


# ---- parallel patterns, plain and packed ----


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
