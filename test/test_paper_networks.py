# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Times of the paper's systems on networks, and iterations of PCGM to an error of qdd."""

from __future__ import annotations

from functools import cache
from itertools import product
import json
from pathlib import Path
from typing import Any

from bridge import default_pcgm_limit
import numpy as np
import pytest
from sampling import one_fast

from benchmarks.cases.paper import (
    EDITIONS,
    PROCEDURES,
    Recording,
    program_of,
    steps_of,
)
from benchmarks.cases.robots import uniform_chain
from benchmarks.pages import counts
from benchmarks.pages.networks import (
    NETWORKS,
    ONE,
    PACKED,
    SIZES,
    SYSTEMS,
    UNPACKED,
    best,
    of_system,
    recorded,
    system_time,
    time,
)
from benchmarks.table import json_text
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
    return [row for system in (ONE, 'pcrbm') for row in recorded((system, 6))]


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


def test_the_best_serial_method_is_composite_bodies(six: list[Row]) -> None:
    (alone,) = of_system(six, ONE, 6)
    # 2083 steps of arithmetic, of which 6 are divisions, each as long as four others.
    assert (alone['method'], alone['arithmetic']) == ('composite_body', 2101)


def test_with_one_lane_per_link_no_method_has_more_routes_than_packed(written: list[Row]) -> None:
    packed = [x for x in written if x['packing'] == PACKED]
    same = ('method', 'edition', 'n')
    unpacked = {tuple(x[k] for k in same): x for x in written if x['packing'] == UNPACKED}
    assert len(packed) == len(unpacked)
    for x in packed:
        other = unpacked[tuple(x[k] for k in same)]
        assert all(other[network] <= x[network] for network in NETWORKS)


@pytest.mark.parametrize(
    ('network', 'first'), [('crossbar', None), ('pm2i', 64), ('cube', 64), ('ring', 32)]
)
def test_constraint_forces_are_faster_than_pcrbm_from_so_many_joints_on_if_a_route_is_a_step(
    written: list[Row], network: str, first: int | None
) -> None:
    for n in SIZES:
        own, other = (
            system_time(written, x, n, network, 1.0) for x in ('constraint_forces', 'pcrbm')
        )
        assert (own < other) == (first is not None and n >= first)


@pytest.mark.parametrize(('network', 'first'), [('crossbar', 3), ('mesh', 3), ('bus', 3)])
def test_pcrbm_is_faster_than_one_processor_from_three_joints_on_if_a_route_is_a_step(
    written: list[Row], network: str, first: int
) -> None:
    for n in SIZES:
        own, serial = (system_time(written, x, n, network, 1.0) for x in ('pcrbm', ONE))
        assert (own < serial) == (n >= first)


def test_conjugate_gradients_are_nowhere_fastest_even_in_n_iterations(written: list[Row]) -> None:
    for n, network, price in product(SIZES, NETWORKS, PRICES):
        times = {system: system_time(written, system, n, network, price) for system in SYSTEMS}
        assert times.pop('pcgm') > min(times.values())


@pytest.mark.parametrize('n', one_fast([2, 6, 12], 2))
def test_stored_recordings_are_what_is_recorded_now(written: list[Row], n: int) -> None:
    found = [row for system in SYSTEMS for row in recorded((system, n))]
    assert json.loads(json.dumps(found)) == [row for row in written if row['n'] == n]


# ---- iterations of PCGM ----


def reached(n: int, tolerance: float = 1e-6) -> Row:
    """Return the iterations to a tolerance in docs."""
    rows = stored('counts')['reached']
    (found,) = (x for x in rows if (x['n'], x['tolerance']) == (n, tolerance))
    return found


def test_the_first_iterate_is_off_by_all_and_the_last_is_the_answer() -> None:
    unit = 2 * np.random.default_rng(3).random((3, 4, 3)) - 1
    states = {'q': 3 * unit[0], 'qd': unit[1], 'tau': unit[2]}
    errors = counts.errors_of_iterates(uniform_chain(3), states)
    np.testing.assert_array_equal(errors[0], 1.0)
    assert len(errors) <= default_pcgm_limit(3) + 1
    # Ten units of rounding of a solution by H, times its condition; seen up to 1e-14.
    assert errors[-1].max() < 1e-13


@pytest.mark.parametrize('name', one_fast(['uniform6', 'puma560', 'ur5', 'panda']))
def test_n_iterations_do_not_converge_on_arms(name: str) -> None:
    robot = uniform_chain(6) if name == 'uniform6' else pfd.load_robot(name)
    errors = counts.errors_of_iterates(robot, counts.seeded_states(robot.n, 1000))
    assert np.median(errors[robot.n]) > 100 * errors[-1].max()
    # Ten units of rounding of a solution by H, times its condition; seen up to 1.2e-14.
    assert errors[-1].max() < 1e-13


@pytest.mark.parametrize('n', [n for n in counts.PCGM_SIZES if n <= 6])
def test_n_iterations_are_enough_up_to_six_joints(n: int) -> None:
    assert reached(n, 1e-9)['worst'] <= n


@pytest.mark.parametrize('n', [n for n in counts.PCGM_SIZES if n >= 12])
def test_from_twelve_joints_on_no_state_gets_its_accelerations_in_n_iterations(n: int) -> None:
    row = reached(n)
    assert row['within_n'] == 0
    assert row['median'] > n
    assert row['error_after_n'] > 1e-3


def test_iterations_grow_faster_than_joints() -> None:
    ratio = [reached(n)['median'] / n for n in counts.PCGM_SIZES if n >= 8]
    assert ratio == sorted(ratio)


@pytest.mark.parametrize('n', one_fast([4, 12, 24], 4))
def test_stored_iterations_are_what_is_measured_now(n: int) -> None:
    found = counts.reached_by(n)
    assert json.loads(json_text(found)) == [x for x in stored('counts')['reached'] if x['n'] == n]
