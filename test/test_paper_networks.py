# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Networks and times of the paper's systems on them, and iterations of PCGM to an error of qdd."""

from __future__ import annotations

from collections import Counter
from functools import cache
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sampling import one_fast
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import shortest_path

from benchmarks.cases import conjugate
from benchmarks.cases.paper import (
    EDITIONS,
    Recording,
    program_of,
    steps_of,
    time_of,
)
from benchmarks.cases.robots import uniform_chain
from benchmarks.pages.since_1987 import (
    NETWORKS,
    PACKED,
    SYSTEMS,
    UNPACKED,
    recorded,
)
import pfd_core as pfd
from pfd_core.dynamics.methods import FORWARD as FORWARD_METHODS
from pfd_core.machine.emulator import run as run_program
from pfd_core.model.plant import resolve as resolve_plant
from pfd_core.paper.conjugate import default_limit as default_pcgm_limit
from pfd_core.paper.networks import Hop as NetworkHop
from pfd_core.paper.networks import NetworkError, route_steps
from pfd_core.paper.networks import carrier as network_carrier
from pfd_core.paper.networks import carry as carry_messages
from pfd_core.paper.networks import hops as network_hops
from pfd_core.paper.networks import steps as network_steps
from pfd_core.paper.networks import wiring as network_wiring

LANES = (1, 2, 3, 5, 6, 8, 11, 16)


def bits(lanes: int) -> int:
    return math.ceil(math.log2(lanes))


def links(network: str, lanes: int) -> set[tuple[int, int]]:
    """Return the links as the literature defines them, written apart from the module."""
    L = bits(lanes)
    N = 2**L
    if network in ('crossbar', 'bus'):
        found = {(i, j) for i in range(lanes) for j in range(lanes)}
    elif network == 'ring':
        found = {(i, (i + d) % lanes) for i in range(lanes) for d in (1, -1)}
    elif network == 'pm2i':
        found = {(i, (i + d * 2**k) % N) for i in range(N) for k in range(L) for d in (1, -1)}
    elif network == 'cube':
        found = {(i, j) for i in range(N) for j in range(N) if bin(i ^ j).count('1') == 1}
    elif network == 'mesh':
        side = math.ceil(math.sqrt(lanes))
        spots = [(x, y) for y in range(math.ceil(lanes / side)) for x in range(side)]
        found = {
            (a, b)
            for a, (x, y) in enumerate(spots)
            for b, (u, v) in enumerate(spots)
            if abs(x - u) + abs(y - v) == 1
        }
    else:
        text = [format(i, f'0{L}b') if L else '' for i in range(N)]
        found = {(i, int(t[1:] + t[:1], 2)) for i, t in enumerate(text) if t}
        found |= {(i, i + 1 - 2 * (i % 2)) for i in range(N) if L}
    return {(i, j) for i, j in found if i != j}


def distances(network: str, lanes: int) -> np.ndarray:
    """Return the hops between lanes on the shortest path, by SciPy."""
    nodes = len(network_wiring(network, lanes).links)
    pairs = np.array(sorted(links(network, lanes)), dtype=int).reshape(-1, 2)
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (nodes, nodes))
    # Neighbouring numbers of a Gray code differ in one bit.
    at = [i ^ (i >> 1) if network == 'cube' else i for i in range(lanes)]
    return shortest_path(graph.tocsr(), unweighted=True)[np.ix_(at, at)]


@pytest.mark.parametrize('lanes', LANES)
@pytest.mark.parametrize('network', NETWORKS)
def test_a_network_has_the_links_of_its_definition(network: str, lanes: int) -> None:
    found = network_wiring(network, lanes).links
    assert {(i, j) for i, row in enumerate(found) for j in row} == links(network, lanes)
    assert len(set(network_wiring(network, lanes).places)) == lanes


@pytest.mark.parametrize('L', range(1, 6))
def test_a_broadcast_reaches_the_farthest_lane_in_its_distance(L: int) -> None:
    n = 2**L
    side = math.ceil(math.sqrt(n))
    from_first = (0,) * n
    assert {network: route_steps(network, from_first) for network in NETWORKS} == {
        'crossbar': 1,
        'bus': 1,
        'ring': n // 2,
        'cube': L,
        'pm2i': math.ceil(L / 2),  # digits 1 and -1 of the signed binary form
        'mesh': max(sum(divmod(lane, side)) for lane in range(n)),
        'shuffle': 2 * L - 1,  # L exchanges make L ones, with a shuffle between two
    }


@pytest.mark.parametrize('network', NETWORKS)
def test_every_word_arrives_by_links_that_carry_one_word_a_step(network: str) -> None:
    rng = np.random.default_rng(41)
    for lanes in (5, 8, 13):
        apart = distances(network, lanes)
        for _ in range(20):
            route = [None if x < 0 else int(x) for x in rng.integers(-3, lanes, lanes)]
            steps = list(network_hops(network, route))
            words = [object() for _ in range(lanes)]
            held = carry_messages(network, lanes, steps, words)
            moved = [(s, t) for t, s in enumerate(route) if s is not None and s != t]
            assert all(held[t][s] is words[s] for s, t in moved)
            # No schedule is shorter than a path or the words on a link, here none twice the two.
            used = Counter(hop[:2] for step in steps for hop in step)
            longest = max((apart[s, t] for s, t in moved), default=0)
            busiest = max(used.values(), default=0)
            if network == 'bus':
                assert len(steps) == len({s for s, _ in moved})
            else:
                assert max(longest, busiest) <= len(steps) <= longest + busiest
            assert route_steps(network, tuple(route)) == len(steps)


@pytest.mark.parametrize(
    ('network', 'steps', 'message'),
    [
        ('ring', [[NetworkHop(0, 2, 0)]], 'no link from 0 to 2'),
        ('cube', [[NetworkHop(0, 3, 0)]], 'no link from 0 to 3'),
        (
            'ring',
            [[NetworkHop(0, 1, 0)], [NetworkHop(0, 1, 0), NetworkHop(0, 1, 0)]],
            'two words on the link',
        ),
        ('ring', [[NetworkHop(0, 1, 0), NetworkHop(1, 2, 0)]], 'node 1 does not hold word 0'),
        ('bus', [[NetworkHop(0, 1, 0), NetworkHop(2, 3, 2)]], 'two words in one step'),
    ],
)
def test_a_hop_that_the_network_cannot_do_is_an_error(
    network: str, steps: list[list[NetworkHop]], message: str
) -> None:
    with pytest.raises(NetworkError, match=message):
        carry_messages(network, 6, steps, range(6))


@pytest.mark.parametrize('network', NETWORKS)
@pytest.mark.parametrize('method', ['pcrbm', 'pcgm'])
def test_a_method_has_the_same_bits_on_every_network(method: str, network: str) -> None:
    program = FORWARD_METHODS[method](resolve_plant(uniform_chain(5)), 'unpacked')
    rng = np.random.default_rng(42)
    state = {name: rng.normal(size=5) for name in ('q', 'qd', 'tau')}
    np.testing.assert_array_equal(
        run_program(program, state, route=network_carrier(network))['qdd'],
        run_program(program, state)['qdd'],
    )


@pytest.mark.parametrize('L', range(1, 5))
def test_the_orientation_recurrence_takes_the_shifts_of_its_levels(L: int) -> None:
    # Nine words a level: 1 step each on PM2I, 1 and then 2 on the cube, 2^k on the ring.
    program = FORWARD_METHODS['pcrbm'](resolve_plant(uniform_chain(2**L)), 'unpacked')
    routes = {
        network: network_steps(program, network, section='orientation').routes
        for network in ('crossbar', 'pm2i', 'cube', 'ring')
    }
    assert routes == {
        'crossbar': 9 * L,
        'pm2i': 9 * L,
        'cube': 9 * (2 * L - 1),
        'ring': 9 * (2**L - 1),
    }


# ---- times of systems ----


PAGES = Path(__file__).resolve().parent.parent / 'docs' / 'report'
Row = dict[str, Any]


@cache
def stored(name: str) -> dict[str, list[Row]]:
    """Return the rows of a page in docs."""
    found: dict[str, list[Row]] = json.loads((PAGES / f'{name}.json').read_text(encoding='utf-8'))[
        'data'
    ]
    return found


@pytest.fixture(scope='module')
def written() -> list[Row]:
    return stored('since-1987')['recordings']


# ---- networks ----


@pytest.mark.parametrize('network', one_fast(NETWORKS, 'ring'))
def test_routes_of_a_method_are_those_that_emulate_executes(network: str) -> None:
    run = pfd.emulate(
        pfd.load_robot('ur5'), *[[0.1] * 6] * 3, method='pcrbm_base_origin', network=network
    )
    one = Recording('pcrbm_base_origin', 6)
    counts = steps_of(one, program_of(one), network=network)
    assert counts.routes == run.steps.routes


@pytest.mark.parametrize(('edition', 'cycles'), [*zip(EDITIONS, (17, 16, 28), strict=True)])
def test_a_cycle_of_the_array_takes_its_longest_operation(edition: str, cycles: int) -> None:
    # t_c of section 2.6: 3 n - 1, 3 n - 2 and 5 n - 2 cycles. Outside the array no root is taken.
    one = Recording('pcrbm_array', 6, edition)
    program = program_of(one)
    times = [
        time_of(
            one,
            program,
            {'multiplications': 1, 'additions': 1, 'square_roots': root} | {'divisions': 4},
        )
        for root in (0, 4, 40)
    ]
    assert np.diff(times).tolist() == [0, 36 * cycles]


def test_with_one_lane_per_link_no_method_has_more_routes_than_packed(written: list[Row]) -> None:
    packed = [x for x in written if x['packing'] == PACKED]
    same = ('method', 'edition', 'n')
    unpacked = {tuple(x[k] for k in same): x for x in written if x['packing'] == UNPACKED}
    assert len(packed) == len(unpacked)
    for x in packed:
        other = unpacked[tuple(x[k] for k in same)]
        assert all(other[network] <= x[network] for network in NETWORKS)


@pytest.mark.parametrize('n', one_fast([2, 6, 12], 2))
def test_stored_recordings_are_what_is_recorded_now(written: list[Row], n: int) -> None:
    found = [row for system in SYSTEMS for row in recorded((system, n))]
    assert json.loads(json.dumps(found)) == [row for row in written if row['n'] == n]


# ---- iterations of PCGM ----


def test_the_first_iterate_is_off_by_all_and_the_last_is_the_answer() -> None:
    unit = 2 * np.random.default_rng(3).random((3, 4, 3)) - 1
    states = {'q': 3 * unit[0], 'qd': unit[1], 'tau': unit[2]}
    errors = conjugate.errors_of_iterates(uniform_chain(3), states)
    np.testing.assert_array_equal(errors[0], 1.0)
    assert len(errors) <= default_pcgm_limit(3) + 1
    # Ten units of rounding of a solution by H, times its condition; seen up to 1e-14.
    assert errors[-1].max() < 1e-13
