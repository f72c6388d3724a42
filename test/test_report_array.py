# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of the triangular array: times by closed forms, pictures, and a page of today."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest

import pfd_core as pfd
from pfd_core.algorithms.paper.array_solver import factor, pipeline
from pfd_core.algorithms.paper.literal_array import STORE
from pfd_core.algorithms.paper.triangular_array import DIVIDE, MULTIPLY, ROOT
from pfd_core.report.array_pages import (
    FIGURE,
    corrected_label,
    designs_picture,
    literal_label,
    markdown,
    run,
)
from pfd_core.report.cases.paper import TABLE, value
from pfd_core.report.cases.robots import uniform_chain
from pfd_core.report.measure.array_runs import (
    CLAIMS,
    MATRICES,
    factor_run,
    last_cycle,
    literal_run,
    measure_array,
)
from pfd_core.report.measure.counts import row

PAGES = Path(__file__).resolve().parent.parent / 'docs' / 'report'
SVG = '{http://www.w3.org/2000/svg}'


@pytest.mark.parametrize('n', [1, 2, 3, 4, 7])
def test_every_time_is_as_claimed_but_the_end_of_the_papers_input(n: int) -> None:
    # The paper has all input stored after 2 n - 1 cycles; P_nn stores h_nn in cycle 3 n - 2.
    wrong = [one for one in measure_array([n]) if one.measured != one.claimed]
    assert [one.event for one in wrong] == ['all input from below is stored'] * (n > 1)
    assert all(one.measured == 3 * n - 2 for one in wrong)


@pytest.mark.parametrize('n', [2, 6])
def test_matrices_follow_one_another_every_n_cycles_and_not_sooner(n: int) -> None:
    H = [[2.0 if i == j else 0.0 for j in range(n)] for i in range(n)]
    cycles = [pipeline([H] * k)[0].trace.cycles for k in (1, 2, 5)]
    assert cycles == [3 * n - 2, 4 * n - 2, 7 * n - 2]
    with pytest.raises(ValueError, match=f'interval must be at least {n} cycles'):
        pipeline([H] * 2, interval=n - 1)


@pytest.mark.parametrize('n', [1, 2, 6])
def test_utilisation_has_its_closed_forms(n: int) -> None:
    # An element (k, m) is in i = 1..k cells: n(n+1)(n+2)/6 in all; as printed each of n(n+1)/2
    # cells stores h_ki first, and h_kk comes with the flag as the last item of its row.
    found = {one.event: one.utilisation for one in measure_array([n]) if one.utilisation}
    cells, work = n * (n + 1) / 2, n * (n + 1) * (n + 2) / 6
    assert found['factorisation'] == pytest.approx(work / cells / (3 * n - 2))
    assert found['factorisation, a wrong matrix'] == pytest.approx(
        (work + cells) / cells / (3 * n - 1)
    )
    several = found[f'{MATRICES} matrices, a new one every n cycles']
    cycles = 3 * n - 2 + (MATRICES - 1) * n
    assert several == pytest.approx(MATRICES * work / cells / cycles)


@pytest.mark.parametrize('n', [1, 2, 4, 5])
def test_the_labels_of_the_picture_are_what_the_cells_do(n: int) -> None:
    literal = literal_run(n)
    places: dict[str, list[tuple[int, int]]] = {}
    for cycle, acting in enumerate(literal.actions, 1):
        for (k, i), action in acting.items():
            label = literal_label(n, (k, i), cycle)
            if action == STORE:
                assert label == f'{k}{i}'
            else:
                places.setdefault(label, []).append((k, i))
                assert (action == ROOT) == (label == f'{k}{k}' and k == i)
    # The element h_mk passes the cells of row k from left to right.
    for m in range(1, n + 1):
        for k in range(1, m + 1):
            assert places[f'{m}{k}'] == [(k, i) for i in range(1, k + 1)]
    ends = {MULTIPLY: False, DIVIDE: True, ROOT: True}
    for cycle, acting in enumerate(factor_run(n).actions, 1):
        for (k, i), action in acting.items():
            m = int(corrected_label((k, i), cycle)[0])
            assert k <= m <= n
            assert ends[action] == (k == i)
            assert (action == ROOT) == (m == k == i)
    assert last_cycle(literal, action=STORE) == 3 * n - 2


def test_the_drawing_has_every_cell_and_stream_of_both_designs() -> None:
    root = ElementTree.fromstring(designs_picture(4))
    words = [element.text or '' for element in root.iter(f'{SVG}text')]
    for k in range(1, 5):
        for i in range(1, k + 1):
            assert words.count(f'P{k}{i}') == 2
    # The first item of a stream is the next to its cell.
    assert 'h11 h41 h31 h21' in words
    assert 'h41 h31 h21 h11*' in words
    assert words.count('*') == 4  # flags from below, as printed only


@pytest.mark.parametrize('n', [2, 3])
def test_emulate_and_the_report_count_the_same_steps_of_the_array(n: int) -> None:
    run_of_array = pfd.emulate(uniform_chain(n), *[[0.1] * n] * 3, method='pcrbm_array')
    rotations = run_of_array.program.count(section='joint rotation')
    counted = row('pcrbm_array', n).steps
    assert run_of_array.steps - rotations == counted
    assert run_of_array.cycles == 5 * n - 2


def test_the_page_and_its_pictures_are_what_the_command_writes_now(tmp_path: Path) -> None:
    for page in run(tmp_path):
        assert page.read_text() == (PAGES / page.name).read_text(), (
            'run pfd report paper --out docs/report'
        )
    assert FIGURE == 4  # of the paper's Figure 1


@pytest.mark.parametrize('n', [1, 2, 6])
def test_a_cell_acts_once_for_each_element_of_its_row(n: int) -> None:
    # P_ki meets the elements h_kk .. h_nk of row k; as printed it stores h_ki first.
    for trace, stored in ((factor_run(n), 0), (literal_run(n), 1)):
        for k in range(1, n + 1):
            for i in range(1, k + 1):
                acting = sum((k, i) in cycle for cycle in trace.actions)
                assert acting == n - k + 1 + stored


@pytest.mark.parametrize('n', range(2, 13))
def test_table_1_counts_a_cycle_as_a_multiplication_and_an_addition(n: int) -> None:
    array, lanes = TABLE['pcrbm_array'], TABLE['pcrbm']
    for kind, own in (('multiplications', 'P6 + h'), ('additions', 'P2')):
        with_array, without = (getattr(one, kind).formula(n) for one in (array, lanes))
        assert with_array == without - value(own, n) + 3 * n - 1


def test_a_time_that_is_not_as_claimed_is_called_wrong() -> None:
    rows = list(measure_array([2, 3]))
    page = markdown(rows)
    assert page.count('wrong: 7 instead of 5 at n = 3') == 1
    assert page.count('as claimed, n = 2 to 3') == len(CLAIMS) - 1
    assert factor([[4.0]]).trace.cycles == 1
