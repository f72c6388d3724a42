# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of the counts: the paper's claims, the verdicts, and pages that are not stale."""

from __future__ import annotations

from dataclasses import asdict
from itertools import pairwise
import json
import math
from pathlib import Path
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from pfd_core.algorithms.paper.literal_array import literal_array
from pfd_core.algorithms.paper.triangular_array import ROOT
from pfd_core.algorithms.programs import FORWARD, ITERATIVE, METHODS, SERIAL
from pfd_core.model import load_robot, resolve
from pfd_core.report.cases.paper import TABLE
from pfd_core.report.cases.robots import uniform_chain as chain
from pfd_core.report.counts_pages import markdown, write
from pfd_core.report.measure.convergence import (
    ARMS,
    CHAINS,
    convergence,
    measure_convergence,
    robots,
)
from pfd_core.report.measure.counts import (
    PRINTED_AT,
    SIZES,
    best_serial,
    measure,
    row,
    serial_arithmetic,
)

PAGES = Path(__file__).resolve().parent.parent / 'docs' / 'report'


def test_the_formulas_at_six_joints_are_those_of_the_paper() -> None:
    # By hand from Table 1; where the printed value is another, the claim carries a remark.
    by_hand = {
        'walker_orin_1': (3419, 2502),
        'walker_orin_2': (2309, 1692),
        'walker_orin_3': (1627, 1255),
        'walker_orin_4': (2805, 2532),
        'articulated_body': (2082, 1639),
        'pcrbm': (323, 323),
        'pcrbm_array': (331, 322),
        'pcgm': (499, 621),
    }
    for name, system in TABLE.items():
        claims = (system.multiplications, system.additions)
        assert tuple(claim.formula(PRINTED_AT) for claim in claims) == by_hand[name]
        for claim in claims:
            assert claim.printed == claim.formula(PRINTED_AT) or claim.remark


def test_the_parts_of_the_paper_sum_to_what_adding_them_by_hand_gives() -> None:
    parts = TABLE['pcrbm'].multiplications.parts, TABLE['pcrbm'].additions.parts
    assert [part(6) for part in parts if part] == [263, 305]
    parts = TABLE['pcgm'].multiplications.parts, TABLE['pcgm'].additions.parts
    assert [part(6) for part in parts if part] == [499, 621]


def test_parts_are_told_only_where_the_text_derives_them() -> None:
    # Sections 2.5 and 3; the text has no counts of parts of a serial method or of the array.
    told = {name for name, system in TABLE.items() if system.additions.parts}
    assert told == {'pcrbm', 'pcgm'}
    assert told == {name for name, system in TABLE.items() if system.multiplications.parts}


def test_every_system_of_the_paper_is_measured() -> None:
    assert set(TABLE) <= set(METHODS)


@pytest.mark.parametrize('method', ['pcrbm', 'pcrbm_array'])
def test_six_joints_take_fewer_steps_than_the_paper_prints_only_with_packing(method: str) -> None:
    counts = row(method, 6)
    for kind in ('multiplications', 'additions'):
        cell = counts.cells[kind]
        assert cell.printed is not None
        assert cell.unpacked is not None
        assert cell.measured < cell.printed < cell.unpacked
    assert counts.unpacked.routes < counts.steps.routes / 2


def test_pcrbm_takes_more_multiplications_than_the_parts_of_the_paper_sum_to() -> None:
    cell = row('pcrbm', 6).cells['multiplications']
    assert cell.parts is not None
    assert cell.measured > cell.parts


@pytest.mark.parametrize('n', SIZES[:9])
@pytest.mark.slow
def test_no_efficiency_is_above_one(n: int) -> None:
    assert_no_efficiency_above_one(n)


LONG = [pytest.mark.slow, pytest.mark.long]


@pytest.mark.slow
@pytest.mark.parametrize('n', [SIZES[9], *(pytest.param(n, marks=LONG) for n in SIZES[10:])])
def test_no_efficiency_of_a_long_chain_is_above_one(n: int) -> None:
    assert_no_efficiency_above_one(n)


def test_no_efficiency_on_the_page_is_above_one() -> None:
    counts = json.loads((PAGES / 'counts.json').read_text())['counts']
    found = [entry['efficiency'] for entry in counts if entry['efficiency'] is not None]
    assert len(found) == (len(METHODS) - len(ITERATIVE)) * len(SIZES)
    assert 0 < min(found) <= max(found) <= 1


def assert_no_efficiency_above_one(n: int) -> None:
    """Check speed-ups over the best serial count, and that this is what its name says."""
    best, arithmetic = best_serial(n)
    for counts in measure([n]):
        s = counts.steps
        own = s.multiplications + s.divisions + s.additions + s.square_roots
        assert 0 < counts.busy <= 1
        if counts.system in ITERATIVE:
            assert counts.speed_up is counts.routed_speed_up is counts.efficiency is None
            continue
        assert counts.speed_up == pytest.approx(arithmetic / own)
        assert counts.routed_speed_up == pytest.approx(arithmetic / (own + s.routes))
        assert counts.efficiency == pytest.approx(counts.speed_up / counts.units)
        assert 0 < counts.efficiency <= 1
        if counts.system in SERIAL:
            assert counts.speed_up <= 1
        if counts.system == best:
            assert counts.speed_up == 1


@pytest.mark.parametrize('n', [2, 6, 10])
def test_no_method_for_n_lanes_beats_the_best_serial_one_on_one_processor(n: int) -> None:
    for method in set(METHODS) - set(SERIAL) - set(ITERATIVE):
        assert serial_arithmetic(method, n) > best_serial(n)[1], method


def test_the_cells_of_the_array_are_processors() -> None:
    assert row('pcrbm_array', 6).units == 6 + 21
    assert row('pcrbm', 6).units == 6


def test_a_cycle_of_the_array_is_one_multiplication_in_every_table() -> None:
    # PCRBM without its factorisation and column sweep, 21 and 15 + 0, and 28 cycles.
    for n in (2, 6, 9):
        counts = row('pcrbm_array', n)
        own = counts.steps.multiplications + counts.steps.divisions
        assert own == counts.cells['multiplications'].measured
        solve = row('pcrbm', n)
        C = [r * (r + 3) // 2 for r in range(1, n)]
        products = sum(c < n for c in C) + math.ceil(sum(c for c in C if c >= n) / n) + n - 1
        without = solve.cells['multiplications'].measured - products - n
        assert own == without + 5 * n - 2


def test_every_circular_cell_takes_its_root_in_a_cycle_of_its_own() -> None:
    for n in (1, 2, 6):
        actions = literal_array(np.eye(n)).trace.actions
        assert sum(ROOT in acting.values() for acting in actions) == n
        assert row('pcrbm_array', max(n, 2)).steps.square_roots == max(n, 2)


@pytest.mark.parametrize('method', ['pcrbm', 'walker_orin_1', 'walker_orin_2', 'walker_orin_3'])
@pytest.mark.slow
def test_direct_methods_stay_at_or_below_the_papers_formulas(method: str) -> None:
    for n in (2, 3, 5, 8, 12, 20, 32):
        for kind in ('multiplications', 'additions'):
            cell = row(method, n).cells[kind]
            assert cell.claimed is not None
            assert cell.measured <= cell.claimed, (method, n, kind)


def test_divide_and_conquer_grows_with_the_logarithm_alone() -> None:
    record = FORWARD['divide_and_conquer']
    steps = [record(resolve(chain(n)), 'parallel').count() for n in (8, 16, 32, 64)]
    growth = [b.multiplications - a.multiplications for a, b in pairwise(steps)]
    assert growth[0] == growth[1] == growth[2] > 0


def test_a_comparison_and_a_remark_on_contradictions() -> None:
    cells = row('walker_orin_4', 6).cells
    assert cells['multiplications'].comparison == 'higher'
    assert '117 n instead of 12 n' in cells['multiplications'].remark
    assert cells['additions'].comparison == 'lower'
    assert row('pcgm', 6).cells['square_roots'].comparison == 'equal'
    assert "through L D L'" in row('pcrbm', 6).cells['square_roots'].remark


@pytest.mark.parametrize('method', ITERATIVE)
@pytest.mark.parametrize('name', ['uniform6', 'puma560', 'ur5'])
def test_six_iterations_do_not_converge_on_six_joints(method: str, name: str) -> None:
    found = convergence(method, chain(6) if name == 'uniform6' else load_robot(name))
    assert 6 < found.least <= found.median <= found.most
    assert found.error_after_n > 100 * found.worst_converged
    # Ten units of rounding of a solution by H, times its condition; seen up to 1.2e-14.
    assert found.worst_converged < 1e-13


def test_convergence_on_six_joints_costs_more_than_the_paper_prints() -> None:
    counts = row('pcgm', 6, convergence('pcgm', chain(6)).least)
    for kind in ('multiplications', 'additions'):
        printed = counts.cells[kind].printed
        assert printed is not None
        assert counts.cells[kind].measured > printed


@pytest.mark.slow
def test_the_pages_in_docs_are_what_the_command_writes_now() -> None:
    data = json.loads((PAGES / 'counts.json').read_text())
    known = {(entry['system'], entry['n']): entry for entry in data['counts']}
    assert set(known) == {(method, n) for method in METHODS for n in SIZES}
    for entry in json.loads(
        json.dumps([asdict(one) for one in measure([n for n in SIZES if n <= 12])])
    ):
        assert known[entry['system'], entry['n']] == entry, (
            'run pfd report counts --out docs/report'
        )
    tried = {(entry['system'], entry['robot']): entry for entry in data['convergence']}
    names = [*(f'uniform{n}' for n in CHAINS), *ARMS]
    assert set(tried) == {(method, name) for method in ITERATIVE for name in names}
    for entry in map(asdict, measure_convergence(robots((2, 6), ('puma560',)))):
        assert tried[entry['system'], entry['robot']] == entry


def test_the_page_has_the_numbers_of_its_data() -> None:
    page, counts = (PAGES / 'counts.md').read_text(), row('pcrbm', 6)
    s, u = counts.steps, counts.unpacked
    line = f'| {s.multiplications + s.divisions} | {s.divisions} | {s.additions} | 0 | {s.routes} '
    line += f'| {u.multiplications + u.divisions} | {u.additions} | {u.routes} |'
    assert f'| {counts.title} | n {line}' in page
    found = [convergence('pcgm', robot) for robot in (chain(6), *map(load_robot, ARMS[:2]))]
    few, many = min(one.least for one in found), max(one.most for one in found)
    for iterations, note in (
        (6, 'not converged'),
        (few, 'the fewest to converge'),
        (many, 'the most to converge'),
    ):
        cells = row('pcgm', 6, iterations).cells
        line = f'| Parallel conjugate gradients, {iterations} iterations ({note}) | n '
        assert f'{line}| {cells["multiplications"].measured} |' in page
    assert f'{few} to {many} iterations converge' in page


@pytest.mark.slow
@pytest.mark.long
def test_the_whole_report_is_what_the_command_writes_now(tmp_path: Path) -> None:
    rows, iterations = list(measure()), list(measure_convergence(robots()))
    pages = write(rows, iterations, tmp_path)
    assert {page.name for page in pages} >= {'counts.md', 'counts.json', 'array.svg'}
    for page in pages:
        if page.suffix != '.png':
            assert page.read_text() == (PAGES / page.name).read_text(), page.name
    ET.parse(tmp_path / 'array.svg')
    assert markdown(rows, iterations) == (PAGES / 'counts.md').read_text()
