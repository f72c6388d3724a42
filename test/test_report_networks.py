# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of the networks: what is best, where packing pays, and a page that is not stale."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
import json
import math
from pathlib import Path

import pytest

from pfd_core.algorithms.paper.pcrbm_array import streams
from pfd_core.machine.networks import NETWORKS
from pfd_core.machine.prices import Choices
from pfd_core.machine.program import Steps
from pfd_core.report.measure.convergence import measure_convergence, robots
from pfd_core.report.measure.counts import (
    AS_PRINTED,
    BEST_KNOWN,
    CORRECTED,
    EDITIONS,
    PROCEDURES,
    on_networks,
)
from pfd_core.report.measure.network_times import (
    NETWORK_SIZES,
    ONE_PROCESSOR,
    PACKED,
    PRICES,
    SYSTEMS,
    UNPACKED,
    Recorded,
    best,
    break_even,
    crossover,
    measure_system,
    of_system,
    packing_pays_below,
    parallel_pays_below,
    system_time,
    systems_at,
)
from pfd_core.report.network_pages import markdown, median_iterations
from pfd_core.report.render.records import record_of


def measured(sizes: Sequence[int], iterations: Mapping[int, int]) -> list[Recorded]:
    return [x for one in systems_at(sizes) for x in measure_system(one, iterations)]


KEY = ('system', 'edition', 'method', 'n', 'iterations', 'converged', 'packing')
PAGES = Path(__file__).resolve().parent.parent / 'docs' / 'report'


@pytest.fixture(scope='module')
def data() -> list[dict[str, object]]:
    found: list[dict[str, object]] = json.loads(
        (PAGES / 'networks.json').read_text(encoding='utf-8')
    )['recordings']
    return found


@pytest.fixture(scope='module')
def written(data: list[dict[str, object]]) -> list[Recorded]:
    """Return the recordings of the page."""
    found: list[Recorded] = record_of(list[Recorded], data)
    return found


@pytest.fixture(scope='module')
def six() -> list[Recorded]:
    return measured([6], {})


def test_best_known_is_best_on_every_network_at_every_price(written: list[Recorded]) -> None:
    compared = 0
    for n in NETWORK_SIZES:
        for system in PROCEDURES:
            ours = [
                one
                for one in written
                if (one.system, one.n, one.edition) == (system, n, BEST_KNOWN)
                and not one.converged
            ]
            for network in NETWORKS:
                for price in PRICES:
                    least = best(ours, network, price).time(network, price)
                    for edition in (AS_PRINTED, CORRECTED):
                        for one in of_system(written, system, n, edition):
                            assert least <= one.time(network, price)
                            compared += 1
    assert compared == len(NETWORK_SIZES) * 3 * len(NETWORKS) * len(PRICES) * 4


def test_packed_loses_to_1987_on_a_ring_and_one_lane_per_link_wins(six: list[Recorded]) -> None:
    # 573, 648 and the routes are of an earlier study with other code.
    base = {x.packing: x for x in six if x.method == 'pcrbm_base_origin'}
    assert base[PACKED].time('crossbar', 1) == 573 + 345
    assert base[PACKED].time('ring', 1) == 573 + 637
    assert base[UNPACKED].time('crossbar', 1) == 837
    assert base[UNPACKED].time('ring', 1) == 992
    printed = of_system(six, 'pcrbm', 6, AS_PRINTED)
    assert base[PACKED].time('ring', 1) > min(one.time('ring', 1) for one in printed)
    for network, time in (('crossbar', 837), ('ring', 992)):
        chosen = best(of_system(six, 'pcrbm', 6), network, 1.0)
        assert (chosen.method, chosen.packing) == ('pcrbm_base_origin', UNPACKED)
        assert chosen.time(network, 1.0) == time
        chosen = best(of_system(six, 'pcrbm', 6), network, 0.0)
        assert (chosen.packing, chosen.time(network, 0.0)) == (PACKED, 573)


def test_the_guide_has_the_numbers_of_the_page(
    six: list[Recorded], written: list[Recorded]
) -> None:
    guide = (PAGES.parent / 'guides' / 'paper.md').read_text(encoding='utf-8')
    times = {
        network: [
            f'{best(of_system(six, "pcrbm", 6, edition), network, 1.0).time(network, 1.0):g}'
            for edition in EDITIONS
        ]
        for network in ('crossbar', 'ring')
    }
    (alone,) = of_system(six, ONE_PROCESSOR, 6)
    packing = [
        packing_pays_below([x for x in six if x.method == 'pcrbm_base_origin'], network)
        for network in ('crossbar', 'ring')
    ]
    (a, b, c), (x, y, z) = times['crossbar'], times['ring']
    text = ' '.join(guide.split())
    assert f'On a crossbar PCRBM takes {a} as printed, {b} corrected and {c} at best' in text
    assert f'on a ring {x}, {y} and {z}.' in text
    assert f'best serial method takes {alone.arithmetic:g}' in text
    assert f'less than {packing[0]:.2f} of a multiplication on a crossbar' in text
    assert f'or less than {packing[1]:.2f} on a ring.' in text
    forces = [of_system(written, 'constraint_forces', n)[0].steps for n in (6, 64)]
    small, large = (
        f'{x.multiplications + x.divisions} and {x.additions} with {x.routes} routes'
        for x in forces
    )
    assert f'{small} at six joints, and {large} at 64' in text


def test_routes_of_pcrbm_are_those_of_an_earlier_study_with_other_code(
    six: list[Recorded],
) -> None:
    found = {x.packing: x.routes for x in six if x.method == 'pcrbm' and x.edition == BEST_KNOWN}
    study = {
        PACKED: (378, 484, 766, 821, 735, 844),
        UNPACKED: (174, 224, 328, 419, 346, 501),
    }
    networks = ('crossbar', 'pm2i', 'cube', 'mesh', 'ring', 'bus')
    for packing, routes in study.items():
        assert tuple(found[packing][network] for network in networks) == routes


@pytest.mark.parametrize('network', NETWORKS)
def test_at_the_break_even_both_schedules_take_the_same_time(
    six: list[Recorded], network: str
) -> None:
    ours = [x for x in six if x.method == 'pcrbm' and x.edition == BEST_KNOWN]
    price = packing_pays_below(ours, network)
    packed, unpacked = (x.time(network, price) for x in ours)
    assert packed == pytest.approx(unpacked, rel=1e-14)
    for factor, packing in ((0.99, PACKED), (1.01, UNPACKED)):
        assert best(ours, network, factor * price).packing == packing
    (alone,) = of_system(six, ONE_PROCESSOR, 6)
    # Method 3 of Walker and Orin, and its time, by an earlier study with other code.
    assert (alone.method, alone.arithmetic) == ('walker_orin_3', 2184)
    serial = alone.arithmetic
    price = parallel_pays_below(ours, network, serial)
    assert min(x.time(network, price) for x in ours) == pytest.approx(serial, rel=1e-14)


def test_a_break_even_that_is_at_no_price_or_at_every_price() -> None:
    def line(arithmetic: float, routes: int) -> Recorded:
        return Recorded(
            '', '', '', 1, None, False, '', Steps(), arithmetic, {'ring': routes}, Choices()
        )

    assert break_even(line(5, 3), line(9, 1), 'ring') == 2
    assert break_even(line(9, 3), line(5, 1), 'ring') == 0
    assert break_even(line(5, 3), line(9, 3), 'ring') == math.inf
    with pytest.raises(ValueError, match='2 fewer routes on ring'):
        break_even(line(5, 1), line(9, 3), 'ring')
    assert parallel_pays_below([line(5, 0)], 'ring', 9) == math.inf
    assert parallel_pays_below([line(9, 1)], 'ring', 9) == 0


def test_from_the_crossover_on_the_other_system_is_faster(written: list[Recorded]) -> None:
    for network in NETWORKS:
        for price in PRICES:
            for one, other in ((ONE_PROCESSOR, 'pcrbm'), ('pcrbm', 'constraint_forces')):
                n = crossover(written, one, other, network, price)
                faster = []
                for k in NETWORK_SIZES:
                    a, b = (system_time(written, x, k, network, price) for x in (one, other))
                    assert a is not None
                    assert b is not None
                    faster.append(b < a)
                if n is None:
                    assert not faster[-1]
                else:
                    k = NETWORK_SIZES.index(n)
                    assert all(faster[k:])
                    assert k == 0 or not faster[k - 1]


@pytest.mark.parametrize('n', [2, 3, 6, 9])
def test_the_streams_bring_each_element_of_H_to_its_row_once(n: int) -> None:
    brought = [(k, m) for sources in streams(n, n) for k, m in enumerate(sources) if m is not None]
    assert sorted(brought) == [(k, m) for k in range(n) for m in range(k + 1, n)]
    assert sum(1 for _ in streams(n, n)) == 2 * n - 3
    # Lanes of three links: an element moves if its row and column are on different lanes.
    lanes = math.ceil(n / 3)
    moved = Counter(
        (k // 3, m // 3) for k in range(n) for m in range(k + 1, n) if k // 3 != m // 3
    )
    routes = list(streams(n, lanes))
    found = [(k, m) for route in routes for k, m in enumerate(route) if m is not None]
    assert Counter(found) == moved
    assert all(len({*route} - {None}) == lanes - route.count(None) for route in routes)
    assert not list(streams(n, 1))


@pytest.mark.parametrize('n', [2, 6])
def test_a_cycle_in_which_a_cell_divides_is_a_division(n: int) -> None:
    # Element m of column k leaves its circular cell in cycle m + 2 k - 2.
    dividing = {m + 2 * k - 2 for k in range(1, n) for m in range(k + 1, n + 1)}
    divisions = {}
    for edition in (CORRECTED, BEST_KNOWN):
        _, on = on_networks('pcrbm_array', n, edition, 'unpacked', 1)
        divisions[edition] = on['ring'].divisions
    # Outside the array the substitutions divide 2 n times, and 1 / m of (16) and (17) is one.
    assert divisions[CORRECTED] == len(dividing) + 2 * n + 1
    # Of the 5 n - 2 cycles of a whole solve, 4 n - 3 divide; composite bodies divide twice.
    assert divisions[BEST_KNOWN] == 4 * n - 3 + 2


def test_the_page_is_what_the_command_writes_now(
    data: list[dict[str, object]], written: list[Recorded], six: list[Recorded]
) -> None:
    known = {tuple(entry[name] for name in KEY): entry for entry in data}
    assert {one.n for one in written} == set(NETWORK_SIZES)
    iterations = median_iterations(
        x for arm in robots((2, 3), ()) for x in measure_convergence(arm)
    )
    for one in [*measured([2, 3], iterations), *six]:
        key = tuple(getattr(one, name) for name in KEY)
        assert known[key] == json.loads(json.dumps(asdict(one))), (
            'run pfd report counts --out docs/report'
        )
    assert {one.system for one in written} == {ONE_PROCESSOR, *SYSTEMS}
    assert (PAGES / 'networks.md').read_text(encoding='utf-8') == markdown(written)


@pytest.mark.slow
@pytest.mark.long
def test_every_recording_of_the_page_is_what_is_counted_now(written: list[Recorded]) -> None:
    counts = {one.n: one.iterations for one in written if one.converged}
    assert written == measured(NETWORK_SIZES, counts)  # type: ignore[arg-type]
