# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Steps of the systems of Lee and Chang (1987) against what the paper counts and prints."""

from __future__ import annotations

from functools import cache
from itertools import product
import math
from typing import Any

from closed_forms import arithmetic, chain, levels, rounds
import numpy as np
import pytest
from sampling import one_fast

from benchmarks.cases.paper import (
    KINDS,
    PROCEDURES,
    TABLE,
    Recording,
    claimed,
    editions_of,
    program_of,
    row,
    steps_of,
    value,
)
from benchmarks.cases.robots import uniform_chain
from benchmarks.pages import counts as page
from benchmarks.pages.counts import arithmetic_of, counted_parts, efficiency, speed_up
import pfd_core as pfd
from pfd_core.dynamics import methods
from pfd_core.model.plant import resolve as resolve_plant
from pfd_core.paper.array import literal_array
from pfd_core.paper.newton_euler import record_inverse_dynamics

SIZES = page.SIZES
EDITIONS = ('as printed', 'corrected', 'best known')
AS_PRINTED, CORRECTED, BEST_KNOWN = EDITIONS
EMULATED = {AS_PRINTED: 'printed', CORRECTED: 'corrected'}
DIRECT = tuple(method for method in pfd.METHODS if method not in methods.ITERATIVE)
Row = dict[str, Any]


@cache
def counted(system: str, n: int, edition: str = BEST_KNOWN) -> Row:
    return row(system, n, edition)


@cache
def best_serial(n: int) -> Row:
    """Return the baseline of n joints, by the same function as the page's."""
    rows = [counted(x, n, e) for x in DIRECT for e in editions_of(x)[-2:]]
    return page.best_serial(rows, n)


# ---- the paper's own numbers ----


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
    assert {name: claimed(name, 6) for name in TABLE} == by_hand
    for system in TABLE.values():
        for claim in (system[kind] for kind in KINDS):
            assert claim['printed'] == value(claim['formula'], 6) or claim.get('remark')


def test_the_parts_of_the_paper_sum_to_what_adding_them_by_hand_gives() -> None:
    # Sections 2.5 and 3; the text has no counts of parts of a serial method or of the array.
    for kind, sums in (('multiplications', (263, 499)), ('additions', (305, 621))):
        parts = {name: x[kind]['parts'] for name, x in TABLE.items() if 'parts' in x[kind]}
        assert {name: value(part, 6) for name, part in parts.items()} == dict(
            zip(('pcrbm', 'pcgm'), sums, strict=True)
        )


def test_two_ceilings_as_floors_and_6_n_give_334_and_328() -> None:
    # A conjecture about the printed values, which no formula gives.
    n, h, L = 6, 3, 3
    assert 35 // 6 + 6 * n + 10 * h + 31 * L + 170 == 334
    assert 35 // 2 + 6 * n + 5 * h + 45 * L + 125 == 328
    assert claimed('pcrbm', n) == (6 + 4 * n + 10 * h + 31 * L + 170, 18 + 5 * n + 5 * h + 260)


@pytest.mark.parametrize('n', SIZES)
def test_the_derived_parts_and_the_decomposed_step_2_make_the_papers_constants(n: int) -> None:
    # 170 = 110 + 60, and 125 = 86 + 39 without the 3 n of (25) and the L of (15).
    parts = {x['item']: x for x in page.stored_table('paper_parts')['pcrbm']}
    derived = [x for x in parts.values() if x['derived']]
    for kind, less in (('multiplications', 0), ('additions', 3 * n + (n - 1).bit_length())):
        whole = sum(value(x[kind], n) for x in derived)
        assert whole == value(TABLE['pcrbm'][kind]['parts'], n)
        total = whole + value(parts['(f), step 2'][kind], n) - less
        assert total == value(TABLE['pcrbm'][kind]['formula'], n)


# ---- counts ----


@pytest.mark.parametrize('n', [2, 6])
@pytest.mark.parametrize(
    ('method', 'edition'),
    [
        *((method, BEST_KNOWN) for method in (*pfd.METHODS, 'constraint_forces')),
        *product(('pcrbm', 'pcgm'), (AS_PRINTED, CORRECTED)),
    ],
)
def test_a_row_has_the_steps_that_emulate_counts_without_rotations(
    method: str, edition: str, n: int
) -> None:
    old = {} if edition == BEST_KNOWN else {'edition': EMULATED[edition]}
    name = f'{method}_1987' if old else method
    run = pfd.emulate(uniform_chain(n), *[[0.1] * n] * 3, method=name, **old)
    steps = run.steps
    for section in {x.section for x in run.program.instructions}:
        if section in ('joint rotation', 'rotations'):
            steps -= run.program.count(section=section)
    counts = row(method, n, edition, iterations=run.iterations)
    assert counts['multiplications'] == steps.multiplications + steps.divisions
    for kind in ('divisions', 'additions', 'square_roots', 'routes'):
        assert counts[kind] == getattr(steps, kind)


# Of six joints with twists of 0 and 90 degrees, by hand: as printed and corrected.
TOTALS = {
    'pcrbm': ((340, 325), (344, 334)),
    'pcrbm_array': ((348, 332), (347, 332)),
    'pcgm': ((505, 647), (500, 632)),
}


@pytest.mark.parametrize('system', PROCEDURES)
def test_totals_with_right_angles_are_those_of_hand(system: str) -> None:
    found = (row(system, 6, edition, right_angles=True) for edition in EDITIONS[:2])
    assert tuple((x['multiplications'], x['additions']) for x in found) == TOTALS[system]


# Of the parts that the paper derives, with twists of 0 and 90 degrees and with skew axes; others
# differ, for the reason in their remark.
EQUAL = {('pcrbm', '(b)'), ('pcrbm', '(c)'), ('pcgm', '(c)')}
MORE = {
    ('pcrbm', '(a)'): ((0, 0), (19, 14)),
    ('pcrbm', '(d)'): ((3, 2), (3, 2)),
    ('pcgm', '(a)'): ((0, 0), (19, 14)),
    ('pcgm', '(b), step 3'): ((3, 2), (3, 2)),
    ('pcgm', '(b), step 7'): ((0, 3), (0, 3)),
    ('pcgm', '(e)'): ((5, 4), (27, 21)),
}


@pytest.mark.parametrize('n', one_fast(SIZES[:9], 5))
def test_parts_are_those_of_the_paper_or_differ_by_a_known_number(n: int) -> None:
    L = (n - 1).bit_length()
    P6, P2 = -((1 - n * n) // 6), -((1 - n * n) // 2)
    known = MORE | dict.fromkeys(EQUAL, ((0, 0), (0, 0)))
    known |= {
        ('pcrbm', '(e)'): ((0, P6 - P2),) * 2,  # set ordering is shorter than the paper says
        ('pcrbm', '(f)'): ((74, 30 + 18 - 3 * n), (77, 33 + 18 - 3 * n)),
        ('pcgm', '(d)'): ((1, L + 2),) * 2,
    }
    derived = 0
    for x in counted_parts(n):
        more = tuple(
            tuple(x[f'{prefix}_{kind}'] - x[f'claimed_{kind}'] for kind in KINDS[:2])
            for prefix in ('right_angles', 'as_printed')
        )
        if x['derived']:
            derived += 1
            assert more == known[x['system'], x['item']]
        assert more == ((0, 0), (0, 0)) or x['remark']
    assert derived == len(known)


@pytest.mark.parametrize('method', one_fast(['pcrbm', 'pcrbm_array']))
def test_our_best_takes_fewer_steps_than_the_paper_prints_only_with_packing(method: str) -> None:
    counts = counted(method, 6)
    for kind in KINDS[:2]:
        assert counts[kind] < TABLE[method][kind]['printed'] < counts[f'unpacked_{kind}']
    assert counts['unpacked_routes'] < counts['routes'] / 2


@pytest.mark.parametrize('method', ['pcrbm', 'walker_orin_1', 'walker_orin_2', 'walker_orin_3'])
@pytest.mark.slow
def test_direct_methods_stay_at_or_below_the_papers_formulas(method: str) -> None:
    for n in (2, 3, 5, 8, 12, 20, 32):
        for kind, formula in zip(KINDS, claimed(method, n), strict=False):
            assert counted(method, n)[kind] <= formula, (method, n, kind)


@pytest.mark.parametrize('name', ['puma560', 'ur5'])
def test_a_puma_takes_27_l_minus_19_multiplications_and_18_l_minus_14_additions(name: str) -> None:
    robot = pfd.load_robot(name)
    L = levels(robot.n)
    program = methods.FORWARD['pcrbm_1987'](resolve_plant(robot), 'parallel')
    counts = program.count(section='orientation')
    # By hand, twists 0 and 90 degrees: four elements are sums of two products, four others free.
    assert (counts.multiplications, counts.additions) == (27 * L - 19, 18 * L - 14)
    assert counts.routes == 9 * L


@pytest.mark.parametrize('n', range(2, 10))
def test_ne_as_a_whole_is_pose_and_ne1(n: int) -> None:
    # Joint rotations, orientations, link vectors and inertias in base axes, then NE1 with qdd.
    steps = record_inverse_dynamics(resolve_plant(chain(n)), 'parallel').count()
    L, products = levels(n), rounds(n)
    assert arithmetic(steps) == (3 * products + 165, 2 * products + 15 * L + 116, 0, 0)
    assert steps.sines == 2


# ---- the array ----


def test_the_cells_of_the_array_are_processors() -> None:
    assert counted('pcrbm_array', 6)['units'] == 6 + 21
    assert counted('pcrbm', 6)['units'] == 6


@pytest.mark.parametrize('n', one_fast([2, 6, 9], 2))
def test_a_cycle_of_the_array_is_one_multiplication(n: int) -> None:
    # PCRBM without its factorisation and column sweep, and 5 n - 2 cycles.
    C = [r * (r + 3) // 2 for r in range(1, n)]
    products = sum(c < n for c in C) + math.ceil(sum(c for c in C if c >= n) / n) + n - 1
    without = counted('pcrbm', n)['multiplications'] - products - n
    assert counted('pcrbm_array', n)['multiplications'] == without + 5 * n - 2


def test_every_circular_cell_takes_its_root_in_a_cycle_of_its_own() -> None:
    for n in (1, 2, 6):
        actions = literal_array(np.eye(n)).trace.actions
        assert sum('square root' in acting.values() for acting in actions) == n
        assert counted('pcrbm_array', max(n, 2))['square_roots'] == max(n, 2)


@pytest.mark.parametrize('n', [2, 6])
def test_a_cycle_in_which_a_cell_divides_is_a_division(n: int) -> None:
    # Element m of column k leaves its circular cell in cycle m + 2 k - 2.
    dividing = {m + 2 * k - 2 for k in range(1, n) for m in range(k + 1, n + 1)}
    divisions = {}
    for edition in (CORRECTED, BEST_KNOWN):
        one = Recording('pcrbm_array', n, edition, 'unpacked')
        divisions[edition] = steps_of(one, program_of(one), network='ring').divisions
    # Outside the array the substitutions divide 2 n times, and 1 / m of (16) and (17) is one.
    assert divisions[CORRECTED] == len(dividing) + 2 * n + 1
    # Of the 5 n - 2 cycles of a whole solve, 4 n - 3 divide; composite bodies divide twice.
    assert divisions[BEST_KNOWN] == 4 * n - 3 + 2


# ---- speed-ups ----


def check_ratios(counts: Row, least: Row) -> None:
    """Assert that no speed-up is above the processors, by any of the ratios."""
    direct = counts['iterations'] is None
    over = counts | least if direct else counts
    for name in ('own', *(('best',) if direct else ())):
        alone, routed = (efficiency(over, name, how) for how in (False, True))
        assert 0 < routed <= alone <= 1, counts
    assert 0 < counts['work'] / (arithmetic_of(counts) * counts['units']) <= 1
    # One processor needs no more steps than all of them do operations.
    assert counts['own'] <= counts['work']
    if direct and counts['edition'] != AS_PRINTED:
        assert counts['own'] >= least['best']
        if counts['system'] in methods.SERIAL:
            assert speed_up(counts, 'own') == 1


LONG = [pytest.mark.slow, pytest.mark.long]


@pytest.mark.parametrize(
    'n', [*one_fast(SIZES[:9], 3), *(pytest.param(n, marks=LONG) for n in SIZES[9:])]
)
def test_no_efficiency_is_above_one(n: int) -> None:
    for method in pfd.METHODS:
        for edition in editions_of(method):
            check_ratios(counted(method, n, edition), best_serial(n))


@pytest.mark.parametrize('n', one_fast([2, 3, 5], 3))
def test_no_efficiency_is_above_one_at_any_number_of_processors(n: int) -> None:
    for method in DIRECT:
        if method not in methods.SERIAL and method != 'divide_and_conquer':
            for p in range(1, n + 1):
                check_ratios(row(method, n, processors=p), best_serial(n))


@pytest.mark.parametrize('n', one_fast([2, 6, 10], 6))
def test_no_method_for_n_lanes_beats_thebest_serial_one_on_one_processor(n: int) -> None:
    titles = {counted(x, n)['title'] for x in methods.SERIAL}
    assert best_serial(n)['title'] in titles
    for method in DIRECT:
        for edition in editions_of(method)[-2:]:
            if method not in methods.SERIAL:
                assert counted(method, n, edition)['own'] > best_serial(n)['best']
