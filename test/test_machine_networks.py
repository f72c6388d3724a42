# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Networks: the steps of routes in closed form, and every hop checked."""

from __future__ import annotations

from collections import Counter
import math

from bridge import (
    FORWARD_METHODS,
    NETWORKS,
    Lanes,
    NetworkError,
    NetworkHop,
    Recorder,
    carry_messages,
    iterate,
    lane_broadcast,
    lane_merge,
    lane_shift,
    lane_where,
    network_carrier,
    network_hops,
    network_steps,
    network_wiring,
    on_lane,
    resolve_plant,
    route_steps,
    run_program,
    uniform_chain_robot,
)
import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import shortest_path

import pfd_core as pfd

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


@pytest.mark.parametrize('network', NETWORKS)
def test_one_word_takes_the_shortest_path(network: str) -> None:
    for lanes in (6, 11, 16):
        apart = distances(network, lanes)
        for source in range(lanes):
            for target in range(lanes):
                route = [source if lane == target else None for lane in range(lanes)]
                assert route_steps(network, tuple(route)) == apart[source, target]


@pytest.mark.parametrize('k', range(4))
def test_a_shift_by_a_power_of_two_takes_the_known_steps_of_the_network(k: int) -> None:
    n, by = 16, 2**k
    shifted = tuple(i - by if i >= by else None for i in range(n))
    assert {network: route_steps(network, shifted) for network in NETWORKS} == {
        'crossbar': 1,
        'pm2i': 1,
        'cube': 1 if k == 0 else 2,  # Gray code
        # Along a row, and where the row ends back along the next one.
        'mesh': (by // 4) or 4 - by + 1,
        'ring': by,
        'shuffle': route_steps('shuffle', shifted),  # no closed form
        'bus': n - by,
    }


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


def test_an_unknown_network_and_too_few_processors_are_errors() -> None:
    program = FORWARD_METHODS['pcrbm'](resolve_plant(uniform_chain_robot(2)), 'unpacked')
    for count in (network_wiring, lambda name, _: network_steps(program, name)):
        with pytest.raises(ValueError, match=r"network must be one of .*'ring'.* got 'torus'"):
            count('torus', 4)
    with pytest.raises(ValueError, match="'ring' needs a processor for each of 2 lanes, got 1"):
        network_steps(program, 'ring', 1)
    state = np.zeros((3, 2))
    with pytest.raises(ValueError, match="'torus'"):
        pfd.emulate(uniform_chain_robot(2), *state, network='torus')


@pytest.mark.parametrize('network', NETWORKS)
@pytest.mark.parametrize('method', ['pcrbm', 'pcgm'])
def test_a_method_has_the_same_bits_on_every_network(method: str, network: str) -> None:
    program = FORWARD_METHODS[method](resolve_plant(uniform_chain_robot(5)), 'unpacked')
    rng = np.random.default_rng(42)
    state = {name: rng.normal(size=5) for name in ('q', 'qd', 'tau')}
    np.testing.assert_array_equal(
        run_program(program, state, route=network_carrier(network))['qdd'],
        run_program(program, state)['qdd'],
    )


@pytest.mark.parametrize('L', range(1, 5))
def test_the_orientation_recurrence_takes_the_shifts_of_its_levels(L: int) -> None:
    # Nine words a level: 1 step each on PM2I, 1 and then 2 on the cube, 2^k on the ring.
    program = FORWARD_METHODS['pcrbm'](resolve_plant(uniform_chain_robot(2**L)), 'unpacked')
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


def test_choices_cost_no_step() -> None:
    recorder = Recorder(3)
    x = recorder.input('x', range(3))
    y = lane_where(x, x, 1.0)  # select
    y = lane_merge(on_lane(y, [0]), x)  # merge
    y = lane_merge(lane_shift(y, 1), y)  # merge after a route
    y = lane_merge(lane_broadcast(y, 2), y)  # all lanes are filled: nothing to merge

    def step(value: Lanes) -> tuple[tuple[Lanes], Lanes]:
        value = lane_where(value, value - 1.0, value)
        return (value,), value

    (y,), _ = iterate(step, (y,), y, 10)
    recorder.output('y', (1,), [(y, 0)])
    program = recorder.program()
    assert program.count(iterations=4) == pfd.Steps(additions=4, routes=2)
