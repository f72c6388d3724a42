# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Steps against what the paper counts, and closed forms in n, of effects, on fewer processors."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import product
import math
from typing import Any

from closed_forms import (
    EVERY_SIZE,
    SIZES,
    arithmetic,
    by_section,
    chain,
    elimination,
    levels,
    rounds,
    routes_by_section,
)
import numpy as np
import pytest
from zoo import one_fast

from benchmarks.cases.paper import (
    KINDS,
    PROCEDURES,
    TABLE,
    Recording,
    claimed,
    program_of,
    row,
    steps_of,
    value,
)
from benchmarks.cases.robots import uniform_chain
from benchmarks.pages import counts as page
from benchmarks.pages.counts import counted_parts
import pfd_core as pfd
from pfd_core.dynamics import methods
from pfd_core.dynamics.methods import FORWARD as FORWARD_METHODS
from pfd_core.model.plant import resolve as resolve_plant
from pfd_core.paper.array import SECTION as PCRBM_ARRAY_SECTION
from pfd_core.paper.array import literal_array
from pfd_core.paper.composite import record_terms
from pfd_core.paper.newton_euler import record_inverse_dynamics

PAGE_SIZES = page.SIZES
EDITIONS = ('as printed', 'corrected', 'best known')
AS_PRINTED, CORRECTED, BEST_KNOWN = EDITIONS
EMULATED = {AS_PRINTED: 'printed', CORRECTED: 'corrected'}
Row = dict[str, Any]


@cache
def counted(system: str, n: int, edition: str = BEST_KNOWN) -> Row:
    return row(system, n, edition)


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


@pytest.mark.parametrize('n', PAGE_SIZES)
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


@pytest.mark.parametrize('n', one_fast(PAGE_SIZES[:9], 5))
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


# ---- closed forms in n ----


SERIAL = (*(f'walker_orin_{k}' for k in range(1, 5)), 'articulated_body')
WRENCHED = pfd.Scene(external_wrench=True)
# Chains and scenes, and the additions of NE1 beyond 15 L + 65: the paper prints 84 and 15 L + 63
# (section 2.5 (d)).
NE1 = {
    'turning joints': ({}, None, 0),
    'a sliding joint': ({'prismatic': True}, None, 6),
    'a wrench': ({}, WRENCHED, 6),
    'no gravity': ({}, pfd.Scene(gravity=None), -3),
}


@pytest.mark.parametrize('case', NE1)
@pytest.mark.parametrize('n', SIZES[1:])
def test_ne1_takes_87_multiplications_and_15_levels_and_65_additions(n: int, case: str) -> None:
    kind, scene, more = NE1[case]
    program = record_terms(resolve_plant(chain(n, **kind), scene), 'parallel')
    wanted = (87, 15 * levels(n) + 65 + more, 0, 0)
    assert arithmetic(program.count(section='newton_euler')) == wanted
    if case == 'a wrench':
        assert arithmetic(program.count(section='wrench'))[:2] == (18, 12)


def test_ne1_of_a_single_link_has_no_velocity_before_it() -> None:
    program = record_terms(resolve_plant(chain(1)), 'parallel')
    assert arithmetic(program.count(section='newton_euler')) == (81, 62, 0, 0)


def test_an_unknown_section_and_more_iterations_than_the_loop_allows_are_errors() -> None:
    with pytest.raises(ValueError, match='iterations must be at most 3, got 4'):
        FORWARD_METHODS['pcgm_1987'](resolve_plant(chain(3)), 'parallel').count(iterations=4)
    program = FORWARD_METHODS['pcrbm'](resolve_plant(chain(3)), 'parallel')
    with pytest.raises(ValueError, match=r"section must be one of .*'row sweep'.* got 'row swep'"):
        program.count(section='row swep')
    with pytest.raises(ValueError, match=r"section must be one of .* got \['row sweep'\]"):
        program.count(section=['row sweep'])  # type: ignore[arg-type]


@pytest.mark.parametrize('n', SIZES[1:])
def test_pcrbm_is_the_sum_of_its_parts(n: int) -> None:
    program = FORWARD_METHODS['pcrbm'](resolve_plant(chain(n)), 'parallel')
    L, s, h = levels(n), elimination(n), math.ceil((n - 1) / 2)
    parts = {
        # The rotations of the joints themselves, which the paper takes as given.
        'joint rotation': (12, 6, 0, 0),
        # The paper prints 27 L - 19 and 18 L - 14, which holds for twists of 0 and 90 degrees.
        # Elements of the products of a level are packed onto full rows of lanes.
        'orientation': (3 * rounds(n), 2 * rounds(n), 0, 0),
        'link vectors': (63, 42, 0, 0),
        'equation (15)': (0, L, 0, 0),
        'equations (16), (17)': (3, 6, 2, 0),
        'equation (18)': (4 * L - 1, 3 * L, 0, 0),
        'equation (19)': (13, 12, 0, 0),
        'equation (20)': (0, 6 * L, 0, 0),
        'step 6': (18, 9, 0, 0),
        'equation (23)': (6, 6, 0, 0),
        'diagonal of H': (3, 2, 0, 0),
        'row sweep': (0, 3 * (n - 1), 0, 0),
        # Pairs i < j, packed: h rounds, with the 9 h and 5 h of section 2.5 (f).
        'moments of the row sweep': (6 * h, 3 * h, 0, 0),
        'elements of H': (3 * h, 2 * h, 0, 0),
        # No square root.
        'factorisation': (s, s, n, 0),
        'column sweeps': (n - 1, n - 1, 0, 0),
    }
    found = by_section(program)
    assert {section: found[section] for section in parts} == parts
    assert arithmetic(program.count()) == (
        4 * L + 3 * rounds(n) + s + 9 * h + n + 182,
        25 * L + 2 * rounds(n) + s + 5 * h + 4 * n + 142,
        n + 2,
        0,
    )


# ---- serial methods --------------------------------------------------------------------------


# A cubic in n for n > 1 is settled by four values; long programs take seconds.
SERIAL_SIZES = (*range(1, 13), 16, 24, 32)


def parts(method: str, n: int) -> Iterator[tuple[str, tuple[int, int, int]]]:
    """Yield the closed forms: section, multiplications, additions, divisions."""
    single = n == 1
    yield 'joint rotation', (4 * n, 2 * n, 0)
    # Constants of the links: centres of mass, and with composite bodies what moves with them.
    composite = method in ('walker_orin_3', 'articulated_body')
    yield 'parameters', (15 * n, 12 * n, 0) if composite else (0, 3 * n, 0)
    if method == 'articulated_body':
        # A single link has no link before: neither its velocity nor its acceleration.
        yield 'velocities', (57 * n - 62 + 14 * single, 30 * n - 42 + 12 * single, 0)
        yield ('articulated bodies', (0, 0, 1) if single else (106 * n - 119, 109 * n - 124, n))
        yield 'solve', (92 * n - 90 + 19 * single, 83 * n - 91 + 19 * single, 0)
        return
    # The angular acceleration of the second link has no component along its joint.
    short = {1: (23, 16, 0), 2: (99, 82, 0)}
    yield 'bias', short.get(n, (96 * n - 95, 86 * n - 92, 0))
    yield 'right-hand side', (0, n, 0)
    if method == 'walker_orin_4':
        yield 'start', (n + 1, n - 1, 0)
        yield 'H u', (11, 7, 0) if single else (68 * n - 67, 56 * n - 62, 0)
        yield 'conjugate gradient', (5 * n, 5 * n - 2, 2)
        yield 'status', (0, 2, 1)
        return
    H = {
        'walker_orin_1': (45 * n * n - 53 * n + 12, 36 * n * n - 42 * n + 11, 0),
        'walker_orin_2': (34 * n * n - 42 * n + 14, (55 * n * n - 67 * n) // 2 + 13, 0),
        'walker_orin_3': (11 * n * n + 32 * n - 43, 7 * n * n + 45 * n - 52, 0),
    }
    # Of one joint the columns over all links are those over the links that move.
    yield 'inertia matrix', H['walker_orin_2' if (method, n) == ('walker_orin_1', 1) else method]
    cube = (n**3 - n) // 6
    pairs = n * (n - 1)
    yield 'solve', (cube + 3 * pairs // 2 + n, cube + pairs, n)


@pytest.mark.sweep
@pytest.mark.parametrize(
    'n', [n if n < 9 else pytest.param(n, marks=pytest.mark.slow) for n in SERIAL_SIZES]
)
@pytest.mark.parametrize('method', SERIAL)
def test_counts_are_closed_forms_for_1_to_32_joints(method: str, n: int) -> None:
    wanted = {section: counts for section, counts in parts(method, n) if any(counts)}
    program = FORWARD_METHODS[method](resolve_plant(chain(n)), 'sequential')
    counts = by_section(program).items()
    assert {section: row[:3] for section, row in counts if any(row[:3])} == wanted


# ---- beyond the paper ------------------------------------------------------------------------


@pytest.mark.parametrize('n', SIZES)
def test_h_about_the_base_origin_takes_half_a_row_for_each_joint(n: int) -> None:
    program = FORWARD_METHODS['pcrbm_base_origin'](resolve_plant(chain(n)), 'parallel')
    L, K = levels(n), n // 2 + 1
    for section, wanted in (
        ('base origin', (15, 3 * L + 15, 0, 0)),
        ('composite bodies', (24, 10 * L + 18, 0, 0)),
        ('elements of H', (6 * K, 5 * K, 0, 0)),
    ):
        assert arithmetic(program.count(section=section)) == wanted


# ---- PCGM ----


@pytest.mark.parametrize('n', SIZES[1:])
def test_an_iteration_takes_47_multiplications(n: int) -> None:
    # The paper counts 49 multiplications, divisions among them, and 14 L + 30 additions.
    program = FORWARD_METHODS['pcgm'](resolve_plant(chain(n)), 'parallel')
    one, two = program.count(iterations=1), program.count(iterations=2)
    L = math.ceil(math.log2(n))
    # Four sums of vectors in a product with H.
    packed = sum(4 * math.ceil(3 * (n - 2**k) / n) for k in range(L))
    assert two.multiplications - one.multiplications == 47
    assert two.divisions - one.divisions == 2
    assert two.additions - one.additions == 29 + packed + 2 * L + 3


# ---- constraint forces, divide and conquer ----


CONSTRAINED = FORWARD_METHODS['constraint_forces']


@pytest.mark.parametrize('n', SIZES)
def test_steps_and_routes_of_constraint_forces_are_closed_forms(n: int) -> None:
    program = CONSTRAINED(resolve_plant(chain(n)), 'unpacked')
    counts, routes = by_section(program), routes_by_section(program)
    L, joined = levels(n), n > 1
    wanted = {
        # Inverses of inertia and mass and points of links; E_ii, E_oo and E_io.
        'link constants': (2 * 30 + 75 + 30 + 90, 2 * 17 + 48 + 18 + 54, 4, 0),
        # G' E G, C, G' v, and the terms of r.
        'joint equations': (8 * (9 + 5 + 1) + 4 * 5, 4 * (9 + 5 + 1) + 15 + 3 * 5, 0, 0),
        # Each level: a factor, 11 columns, 40 products; between levels 5 x 5 blocks.
        'elimination': (515 * L - 125, 430 * L - 100, 5 * L, 0),
        'accelerations': (4 * 6 + 8, 4 * 5 + 4 + 3, 0, 0),
    }
    alone = {
        'link constants': (105, 65, 2, 0),
        'joint equations': (5, 0, 0, 0),
        'accelerations': (6, 5, 0, 0),
    }
    # K and D, two substitutions with a column, and D.
    wanted = (wanted if joined else alone) | {'constraint forces': (55, 40, 5, 0)}
    own = wanted.keys() | {'elimination'}
    assert {key: row for key, row in counts.items() if key in own} == wanted
    moved = {'joint equations': 6, 'elimination': 90 * L - 25, 'accelerations': 7}
    assert {key: k for key, k in routes.items() if key in moved} == (moved if joined else {})


DIVIDED = FORWARD_METHODS['divide_and_conquer']


@pytest.mark.parametrize('n', SIZES)
def test_steps_grow_as_the_logarithm_of_the_joints(n: int) -> None:
    counts = by_section(DIVIDED(resolve_plant(chain(n)), 'parallel'))
    L = levels(n)
    single, joining, parting, last = (
        counts.get(s, (0, 0, 0, 0))
        for s in ('single links', 'joining', 'parting', 'accelerations')
    )
    assert single == (135, 53, 1, 0)
    assert joining == {0: (0, 0, 0, 0), 1: (358, 322, 6, 0)}.get(
        L, (1276 * L - 1026, 1114 * L - 882, 6 * L, 0)
    )
    assert parting == (72 * max(L - 1, 0), 72 * max(L - 1, 0), 0, 0)
    assert last == (13, 12, 0, 0)


# ---- routes with one lane per link ----


ROUTED = ('pcrbm', 'pcrbm_array', 'pcrbm_base_origin', 'pcgm')


def routed(method: str, n: int) -> dict[str, int]:
    """Return the routes of each section."""
    L, many = levels(n), int(n > 1)
    # 9 elements a level of R; z_(i-1); five sums of vectors, and w_(i-1).
    found = {'orientation': 9 * L, 'link vectors': 3 * many, 'omega': 15 * L + 3 * many}
    if method == 'pcgm':
        # Four sums of vectors, two inner products, of which each result is broadcast.
        inner = {'first inner product': L, 'step 8': L + many, 'step 12': L}
        return found | inner | {'step 7': 12 * L, 'steps 14, 15': many}
    if method == 'pcrbm_base_origin':
        # o_i and o_(i-1); mass, first moment and inertia; two 6-vectors for each distance around:
        # a pair farther apart than n/2 comes out on the other lane.
        far = sum(n - d for d in range(1, n) if 2 * d > n)
        found |= {'base origin': 3 * L + 3 * many, 'composite bodies': 10 * L}
        found |= {'elements of H': 12 * (n // 2) + far}
    else:
        # M, c with its coefficients, E; M_(j+1), c_(j+1); p*_i and z_i for the pairs.
        found |= {'equation (15)': L, 'equations (16), (17)': many, 'equation (20)': 6 * L}
        found |= {'equation (18)': (4 * L - 1) * many, 'equation (19)': 3 * many}
        found |= dict.fromkeys(('moments of the row sweep', 'elements of H'), 3 * (n - 1))
    if method == 'pcrbm_array':
        # Elements of H and y on their way to the array; h_11 and y_1 are on lane 0.
        return found | {f'streams of the {PCRBM_ARRAY_SECTION}': n * (n + 1) // 2 + n - 2}
    # l_ij for j < i < n - 1 and 1/d_j; n - 1 elements each way, n - 1 diagonals.
    factors = (n - 1) * (n - 2) // 2 + n - 1
    return found | {'factorisation': factors, 'column sweeps': 3 * (n - 1)}


@pytest.mark.sweep
@pytest.mark.parametrize('n', EVERY_SIZE)
@pytest.mark.parametrize('method', ROUTED)
def test_routes_with_one_lane_per_link_have_their_closed_forms(method: str, n: int) -> None:
    found = routes_by_section(FORWARD_METHODS[method](resolve_plant(chain(n)), 'unpacked'))
    assert found == {section: count for section, count in routed(method, n).items() if count}
