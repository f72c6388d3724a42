# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Times of the paper's systems on networks, and iterations of PCGM to an error of qdd."""

from __future__ import annotations

from functools import cache
import json
import math
from pathlib import Path
from typing import Any

from bridge import default_pcgm_limit
import numpy as np
import pytest
from sampling import one_fast

from benchmarks.cases.paper import (
    EDITIONS,
    KINDS,
    PROCEDURES,
    Recording,
    program_of,
    steps_of,
)
from benchmarks.pages import iterations as pcgm
from benchmarks.pages.networks import (
    NETWORKS,
    ONE,
    PACKED,
    SIZES,
    SYSTEMS,
    UNPACKED,
    answers,
    best,
    break_even,
    of_system,
    packing_pays_below,
    parallel_pays_below,
    recorded,
    system_time,
    time,
)
import pfd_core as pfd

PAGES = Path(__file__).resolve().parent.parent / 'docs' / 'report'
AS_PRINTED, CORRECTED, BEST_KNOWN = EDITIONS
Row = dict[str, Any]
PRICES = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)  # of a route, in multiplications


@cache
def stored(name: str) -> dict[str, list[Row]]:
    """Return the rows of a page in docs."""
    found: dict[str, list[Row]] = json.loads((PAGES / f'{name}.json').read_text(encoding='utf-8'))[
        'data'
    ]
    return found


@pytest.fixture(scope='module')
def written() -> list[Row]:
    return stored('networks')['recordings']


@pytest.fixture(scope='module')
def six() -> list[Row]:
    return [row for system in (ONE, 'pcrbm') for row in recorded((system, 6, None))]


# ---- networks ----


@pytest.mark.parametrize('network', one_fast(NETWORKS, 'ring'))
def test_routes_of_a_method_are_those_that_emulate_executes(network: str) -> None:
    run = pfd.emulate(
        pfd.load_robot('ur5'), *[[0.1] * 6] * 3, method='pcrbm_base_origin', network=network
    )
    one = Recording('pcrbm_base_origin', 6)
    counts = steps_of(one, program_of(one), network=network)
    assert counts.routes == run.steps.routes


def test_every_system_is_recorded_at_every_size(written: list[Row]) -> None:
    assert {(row['system'], row['n']) for row in written} == {
        (system, n) for system in SYSTEMS for n in SIZES
    }


def test_best_known_is_best_on_every_network_at_every_price(written: list[Row]) -> None:
    compared = 0
    for n in SIZES:
        for system in PROCEDURES:
            ours = [
                row
                for row in written
                if (row['system'], row['n'], row['edition']) == (system, n, BEST_KNOWN)
                and not row['converged']
            ]
            for network in NETWORKS:
                for price in PRICES:
                    least = time(best(ours, network, price), network, price)
                    for edition in (AS_PRINTED, CORRECTED):
                        for one in of_system(written, system, n, edition):
                            assert least <= time(one, network, price)
                            compared += 1
    assert compared == len(SIZES) * 3 * len(NETWORKS) * len(PRICES) * 4


def test_packed_loses_to_1987_on_a_ring_and_one_lane_per_link_wins(six: list[Row]) -> None:
    # 573, 648 and the routes are of an earlier study with other code.
    base = {row['packing']: row for row in six if row['method'] == 'pcrbm_base_origin'}
    assert time(base[PACKED], 'crossbar', 1) == 573 + 345
    assert time(base[PACKED], 'ring', 1) == 573 + 637
    assert time(base[UNPACKED], 'crossbar', 1) == 837
    assert time(base[UNPACKED], 'ring', 1) == 992
    printed = of_system(six, 'pcrbm', 6, AS_PRINTED)
    assert time(base[PACKED], 'ring', 1) > min(time(one, 'ring', 1) for one in printed)
    for network, wanted in (('crossbar', 837), ('ring', 992)):
        chosen = best(of_system(six, 'pcrbm', 6), network, 1.0)
        assert (chosen['method'], chosen['packing']) == ('pcrbm_base_origin', UNPACKED)
        assert time(chosen, network, 1.0) == wanted
        chosen = best(of_system(six, 'pcrbm', 6), network, 0.0)
        assert (chosen['packing'], time(chosen, network, 0.0)) == (PACKED, 573)


def test_routes_of_pcrbm_are_those_of_an_earlier_study_with_other_code(six: list[Row]) -> None:
    ours = [x for x in six if (x['method'], x['edition']) == ('pcrbm', BEST_KNOWN)]
    networks = ('crossbar', 'pm2i', 'cube', 'mesh', 'ring', 'bus')
    assert {x['packing']: tuple(x[network] for network in networks) for x in ours} == {
        PACKED: (378, 484, 766, 821, 735, 844),
        UNPACKED: (174, 224, 328, 419, 346, 501),
    }


@pytest.mark.parametrize('network', NETWORKS)
def test_at_the_break_even_both_schedules_take_the_same_time(six: list[Row], network: str) -> None:
    ours = [x for x in six if (x['method'], x['edition']) == ('pcrbm', BEST_KNOWN)]
    price = packing_pays_below(ours, network)
    packed, unpacked = (time(x, network, price) for x in ours)
    assert packed == pytest.approx(unpacked, rel=1e-14)
    for factor, packing in ((0.99, PACKED), (1.01, UNPACKED)):
        assert best(ours, network, factor * price)['packing'] == packing
    (alone,) = of_system(six, ONE, 6)
    # 2083 steps of arithmetic, of which 6 are divisions, each as long as four others.
    assert (alone['method'], alone['arithmetic']) == ('composite_body', 2101)
    price = parallel_pays_below(ours, network, alone)
    assert min(time(x, network, price) for x in ours) == pytest.approx(2101, rel=1e-14)


def test_a_break_even_that_is_at_no_price_or_at_every_price() -> None:
    def line(arithmetic: float, routes: int) -> Row:
        return {'arithmetic': arithmetic, 'ring': routes}

    assert break_even(line(5, 3), line(9, 1), 'ring') == 2
    assert break_even(line(9, 3), line(5, 1), 'ring') == 0
    assert break_even(line(5, 3), line(9, 3), 'ring') == math.inf
    with pytest.raises(ValueError, match='2 fewer routes on ring'):
        break_even(line(5, 1), line(9, 3), 'ring')
    assert parallel_pays_below([line(5, 0)], 'ring', line(9, 0)) == math.inf
    assert parallel_pays_below([line(9, 1)], 'ring', line(9, 0)) == 0


@pytest.mark.parametrize(
    ('network', 'first'), [('crossbar', None), ('pm2i', 64), ('cube', 64), ('ring', 32)]
)
def test_constraint_forces_are_faster_than_pcrbm_from_so_many_joints_on_if_a_route_is_a_step(
    written: list[Row], network: str, first: int | None
) -> None:
    for n in SIZES:
        own, other = (
            system_time(written, x, n, network, 1.0) or math.nan
            for x in ('constraint_forces', 'pcrbm')
        )
        assert (own < other) == (first is not None and n >= first)


@pytest.mark.parametrize(('network', 'first'), [('crossbar', 3), ('mesh', 3), ('bus', 3)])
def test_pcrbm_is_faster_than_one_processor_from_three_joints_on_if_a_route_is_a_step(
    written: list[Row], network: str, first: int
) -> None:
    for n in SIZES:
        own, serial = (
            system_time(written, x, n, network, 1.0) or math.nan for x in ('pcrbm', ONE)
        )
        assert (own < serial) == (n >= first)


def test_the_answers_of_pcgm_after_n_iterations_are_none(written: list[Row]) -> None:
    assert not answers(of_system(written, 'pcgm', 64))
    assert system_time(written, 'pcgm', 64, 'ring', 1.0) is None
    assert system_time(written, 'pcgm', 6, 'ring', 1.0) is not None


@pytest.mark.parametrize('n', one_fast([2, 6, 12], 2))
def test_stored_recordings_are_what_is_recorded_now(written: list[Row], n: int) -> None:
    medians = {row['n']: row['iterations'] for row in written if row['converged']}
    found = [row for system in SYSTEMS for row in recorded((system, n, medians.get(n)))]
    assert json.loads(json.dumps(found)) == [row for row in written if row['n'] == n]


# ---- iterations of PCGM ----


def reached(n: int, variant: str = 'plain', tolerance: float = 1e-6) -> Row:
    """Return the iterations of a variant in docs."""
    key = (n, variant, tolerance)
    rows = stored('counts')['reached']
    (found,) = (x for x in rows if (x['n'], x['variant'], x['tolerance']) == key)
    return found


def test_the_first_iterate_of_a_cold_start_is_off_by_all_and_the_last_is_the_answer() -> None:
    unit = 2 * np.random.default_rng(3).random((3, 4, 3)) - 1
    states = {'q': 3 * unit[0], 'qd': unit[1], 'tau': unit[2]}
    cold, warm = (pcgm.errors_of_iterates(3, name, states) for name in ('plain', 'warm'))
    np.testing.assert_array_equal(cold[0], 1.0)
    assert len(cold) <= default_pcgm_limit(3) + 1
    for errors in (cold, warm):
        # Ten units of rounding of a solution by H, times its condition; seen up to 1e-14.
        assert errors[-1].max() < 1e-13
    assert warm[0].max() < 0.1


@pytest.mark.parametrize('n', [2, 6])
def test_an_iteration_and_a_warm_start_have_their_closed_forms(n: int) -> None:
    # By hand: H u takes 42 and 12 L + 29, inner products and updates 5, 2 L + 3 and 2 divisions.
    L = (n - 1).bit_length()
    prices = {name: pcgm.price(n, name) for name in pcgm.VARIANTS}
    for name in ('plain', 'warm'):
        found = [prices[name][f'each_{kind}'] for kind in ('multiplications', 'divisions')]
        assert found == [47 + 2, 2]
        assert prices[name]['each_additions'] == 14 * L + 32
    for name in ('scaled', 'both'):
        each = prices[name]
        assert each['each_multiplications'] - each['each_divisions'] == 48
    # A start other than zero: tau - b - H x_0.
    for kind, more in (('multiplications', 42), ('additions', 12 * L + 30), ('divisions', 0)):
        key = f'first_{kind}'
        assert prices['warm'][key] - prices['plain'][key] == more


@pytest.mark.parametrize('n', [n for n in pcgm.SIZES if n <= 6])
def test_n_iterations_are_enough_up_to_six_joints(n: int) -> None:
    assert reached(n, tolerance=1e-9)['worst'] <= n


@pytest.mark.parametrize('n', [n for n in pcgm.SIZES if n >= 12])
def test_from_twelve_joints_on_no_state_gets_its_accelerations_in_n_iterations(n: int) -> None:
    row = reached(n)
    assert row['within_n'] == 0
    assert row['median'] > n
    assert row['error_after_n'] > 1e-3


def test_iterations_grow_faster_than_joints_and_scaling_makes_it_worse() -> None:
    ratio = [reached(n)['median'] / n for n in pcgm.SIZES if n >= 8]
    assert ratio == sorted(ratio)
    for n in (48, 64):
        assert reached(n, 'scaled')['median'] > reached(n)['median']


def test_pcrbm_takes_less_arithmetic_than_pcgm_at_every_size() -> None:
    direct = {
        x['n']: [x[f'unpacked_{kind}'] for kind in KINDS[:2]]
        for x in stored('counts')['counts']
        if (x['system'], x['edition']) == ('pcrbm', CORRECTED)
    }
    for n in pcgm.SIZES:
        rows = [reached(n, variant) for variant in pcgm.VARIANTS]
        cheapest = min(rows, key=lambda x: sum(x['in_median']))
        for cost in (rows[0]['in_n'], cheapest['in_median']):
            assert all(a > b for a, b in zip(cost[:2], direct[n], strict=True))
        assert cheapest['variant'] == 'warm' or n < 48


@pytest.mark.parametrize('n', one_fast([4, 12, 24], 4))
def test_stored_iterations_are_what_is_measured_now(n: int) -> None:
    found = pcgm.reached_by(n)
    for row in found:
        stored_row = reached(n, row['variant'], row['tolerance'])
        assert stored_row == {key: getattr(x, 'item', lambda x=x: x)() for key, x in row.items()}
