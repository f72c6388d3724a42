# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Beyond the paper: networks, iterates of PCGM, articulated bodies by recursive doubling."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cache
import json
import math
from pathlib import Path
from typing import Any

from closed_forms import LENGTHS, arithmetic, by_section, chain, levels, routes_by_section
import numpy as np
from oracle import ACCELERATION, Oracle, jacobi_condition, relative
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import shortest_path
from zoo import Array, one_fast, random_chain, random_state, without_mass

from benchmarks.cases import conjugate
from benchmarks.cases.paper import EDITIONS, Recording, program_of, steps_of, time_of
from benchmarks.cases.robots import uniform_chain
from benchmarks.pages.since_1987 import NETWORKS, PACKED, SYSTEMS, UNPACKED, recorded
import pfd_core as pfd
from pfd_core.dynamics.methods import FORWARD as FORWARD_METHODS
from pfd_core.machine.emulator import run as run_program
from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.recorder import Recorder
from pfd_core.model.plant import resolve as resolve_plant
from pfd_core.paper.articulated_doubling import joined_links
from pfd_core.paper.articulated_doubling import plan as doubling_plan
from pfd_core.paper.conjugate import most_iterations
from pfd_core.paper.networks import Hop as NetworkHop
from pfd_core.paper.networks import NetworkError, route_steps
from pfd_core.paper.networks import by_section as network_sections
from pfd_core.paper.networks import carrier as network_carrier
from pfd_core.paper.networks import carry as carry_messages
from pfd_core.paper.networks import hops as network_hops
from pfd_core.paper.networks import wiring as network_wiring

LANES = (1, 2, 3, 5, 6, 8, 11, 16)


def links(network: str, lanes: int) -> set[tuple[int, int]]:
    """Return the links as the literature defines them, written apart from the module."""
    L = math.ceil(math.log2(lanes))
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
        network: network_sections(program, network)['orientation'].routes
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


@pytest.mark.parametrize('n', one_fast([2, 6, 12], 6))
def test_stored_recordings_are_what_is_recorded_now(written: list[Row], n: int) -> None:
    found = [row for system in SYSTEMS for row in recorded((system, n))]
    assert json.loads(json.dumps(found)) == [row for row in written if row['n'] == n]


# ---- iterations of PCGM ----


def test_the_first_iterate_is_off_by_all_and_the_last_is_the_answer() -> None:
    unit = 2 * np.random.default_rng(3).random((3, 4, 3)) - 1
    states = {'q': 3 * unit[0], 'qd': unit[1], 'tau': unit[2]}
    errors = conjugate.errors_of_iterates(uniform_chain(3), states)
    np.testing.assert_array_equal(errors[0], 1.0)
    assert len(errors) <= most_iterations(3) + 1
    # Ten units of rounding of a solution by H, times its condition; seen up to 1e-14.
    assert errors[-1].max() < 1e-13


# ---- articulated bodies by recursive doubling: what every method must do is in test_methods ----


DOUBLED = FORWARD_METHODS['articulated_body_doubling']
SERIAL = FORWARD_METHODS['articulated_body']


def run(
    robot: pfd.Robot, given: dict[str, Array], schedule: str, **scene: Any
) -> dict[str, Array]:
    plant = resolve_plant(robot, pfd.Scene(**scene) if scene else None)
    return run_program(DOUBLED(plant, schedule), given)


def state_of(robot: pfd.Robot, seed: int) -> dict[str, Array]:
    values = random_state(np.random.default_rng(seed), robot.n)
    return dict(zip(('q', 'qd', 'tau'), values, strict=True))


# ---- the verdict on the paper's sentence ----


@pytest.mark.parametrize('schedule', ['unpacked', 'parallel'])
def test_all_articulated_inertias_follow_in_ceil_log2_of_n_minus_1_levels(schedule: str) -> None:
    # Unpacked every level doubles all pieces. Packed, half the pieces are joined on the way back.
    for n in range(2, 130):
        steps = doubling_plan(Recorder(n, schedule), {})
        least = levels(n - 1)
        assert len(steps) == least if schedule == 'unpacked' else len(steps) <= 2 * least
        reach = {i: i for i in range(1, n)}
        for step in steps:
            assert all(reach[i] + 1 == j for i, j in step.sources.items())
            reach |= {i: reach[j] for i, j in step.sources.items()}
        assert set(reach.values()) == {n - 1}


def test_the_accelerations_of_64_links_are_those_of_the_recurrence() -> None:
    # The same articulated bodies link by link, in 50 digits.
    robot = random_chain(np.random.default_rng(64), 64, 0.3)
    given = state_of(robot, 64)
    exact = run_program(SERIAL(resolve_plant(robot), 'sequential'), given, digits=50)['qdd']
    for schedule in ('unpacked', 'parallel'):
        found = run(robot, given, schedule)
        assert relative(found['qdd'], exact.astype(float)) < 2e-12
        assert (found['pivots'] > 0).all()


# ---- counts of turning joints with one lane a link, as the module states them ----


@pytest.mark.parametrize(
    'n', [n if n <= 17 else pytest.param(n, marks=pytest.mark.slow) for n in (*LENGTHS[2:], 10)]
)
def test_steps_and_routes_of_each_section_are_closed_forms(n: int) -> None:
    program = DOUBLED(resolve_plant(chain(n)), 'unpacked')
    counts, routes = by_section(program), routes_by_section(program)
    L = levels(n - 1)
    # Multiplications, additions, divisions and routes.
    wanted = {
        'link constants': (81, 57, 0, 0),
        'single links': (70, 41, 1, 2),
        'doubling': (940 * L - 1102, 795 * L - 986, 5 * L, 55 * L - 43),
        'articulated bodies': (79, 62, 1, 15),
        'bias forces': (150 * L - 103, 125 * L - 87, 0, 30 * L - 19),
        'accelerations': (25 * L + 13, 25 * L + 8, 0, 5 * L + 6),
    }
    found = {key: (*counts[key][:3], routes.get(key, 0)) for key in wanted}
    if L < 4:
        # Levels of fewer joints than a piece has rows are cheaper.
        assert found.pop('doubling')[0] == {1: 250, 2: 767, 3: 1533}[L]
        del wanted['doubling']
    assert found == wanted
    assert all(row[3] == 0 for row in counts.values())  # no square root


def totals(method: str, n: int, schedule: str) -> tuple[int, int]:
    """Return the steps of arithmetic, and of routes, of a chain of n turning joints."""
    steps = FORWARD_METHODS[method](resolve_plant(chain(n)), schedule).count()
    return sum(arithmetic(steps)), steps.routes


@pytest.mark.long
def test_ten_times_the_links_take_twice_the_steps_and_of_pcrbm_six_times() -> None:
    for method, least, most in (('articulated_body_doubling', 1, 2), ('pcrbm', 6, 7)):
        few, many = (totals(method, n, 'parallel')[0] for n in (8, 80))
        assert least * few < many < most * few, method


# ---- links without inertia about their joint ----


def test_links_are_joined_up_to_a_solid_one() -> None:
    robot = random_chain(np.random.default_rng(1), 8, 0.0)
    thin = robot.inertias.copy()
    thin[4] = 0.0  # a point
    robot = without_mass(replace(robot, inertias=thin), (2, 3, 6))
    assert joined_links(robot, [2, 3, 6]) == {2: 5, 3: 5, 4: 5, 6: 7}
    # A light link ends no group, solid as it may be.
    assert joined_links(robot, [2, 3, 5, 6]) == dict.fromkeys((2, 3, 4, 5, 6), 7)
    given = state_of(robot, 2)
    exact = run_program(SERIAL(resolve_plant(robot), 'sequential'), given, digits=50)['qdd']
    found = run(robot, given, 'unpacked')['qdd']
    condition = jacobi_condition(Oracle(robot).H(given['q']))
    assert relative(found, exact.astype(float)) < ACCELERATION * condition


# ---- accuracy on ill-conditioned chains ----


def scaled(robot: pfd.Robot, factors: Array) -> pfd.Robot:
    """Return the robot with masses and inertias of its links multiplied."""
    return replace(
        robot, masses=robot.masses * factors, inertias=robot.inertias * factors[:, None, None]
    )


def light(share: float) -> Array:
    """Return factors of 20 links, two of which are light."""
    return np.where(np.isin(np.arange(20), [2, 11]), share, 1.0)


# Of 20 links: factors of their masses, and the error allowed. Digits are lost only where light
# links are not joined, above 2^-30 of their load, and only with one lane a link, which keeps C.
HARD = {
    'eight decades': (10.0 ** np.random.default_rng(20).uniform(-8, 0, 20), 1e-10),
    'light base': (10.0 ** np.linspace(-8, 0, 20), 1e-12),
    'light tip': (10.0 ** np.linspace(0, -8, 20), 1e-13),
    'light links of 1e-4': (light(1e-4), 1e-12),
    'light links of 1e-7': (light(1e-7), 1e-9),
    'light links of 1e-10': (light(1e-10), 1e-12),
    'light links of 1e-16': (light(1e-16), 1e-12),
}


# The others are between these.
WORST = ('light links of 1e-7', 'light links of 1e-16', 'light tip')


@pytest.mark.parametrize(
    'name', [pytest.param(x, marks=[pytest.mark.slow] * (x not in WORST)) for x in HARD]
)
def test_ill_conditioned_chains_of_20_links_keep_their_digits(name: str) -> None:
    factors, bound = HARD[name]
    robot = scaled(random_chain(np.random.default_rng(20), 20, 0.0), factors)
    given = state_of(robot, 20)
    exact = run_program(SERIAL(resolve_plant(robot), 'sequential'), given, digits=50)['qdd']
    for schedule in ('parallel', 'unpacked'):
        found = run(robot, given, schedule)
        assert relative(found['qdd'], exact.astype(float)) < bound
        assert (found['pivots'] > 0).all()


# ---- fewer processors than joints ----


def problem(n: int, seed: int) -> tuple[pfd.Robot, tuple[Any, ...]]:
    rng = np.random.default_rng(seed)
    types = ['revolute', 'prismatic', 'revolute', 'revolute', 'prismatic'][:n]
    return random_chain(rng, n, joint_types=types), random_state(rng, n)


def test_a_batch_with_brakes_runs_on_any_number_of_processors() -> None:
    robot, _ = problem(5, 5)
    q, qd, tau = np.random.default_rng(6).normal(size=(3, 2, 5))
    scene = pfd.Scene(brakes=True, damping='model', armature='model')
    brakes = np.array([[True, False, False, True, False], [False] * 5])
    options: dict[str, Any] = {'scene': scene, 'brakes': brakes}
    wanted = pfd.emulate(robot, q, qd, tau, **options).qdd
    for processors in (1, 2, 3, 4):
        found = pfd.emulate(robot, q, qd, tau, processors=processors, **options).qdd
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-11)
        assert (found[0, [0, 3]] == 0).all()


def test_one_processor_reports_the_operations_of_the_serial_program() -> None:
    robot, state = problem(4, 7)
    for method in ('pcrbm', 'pcrbm_1987'):
        run = pfd.emulate(robot, *state, method=method, processors=1)
        serial = FORWARD_METHODS[method](resolve_plant(robot), 'sequential')
        assert run.steps == serial.count()
        assert run.utilisation == 1
    array = pfd.emulate(robot, *state, method='pcrbm_array', processors=2)
    assert array.cycles == 5 * 4 - 2
    assert array.steps.square_roots == 4


@pytest.mark.parametrize('method', ['pcrbm', 'pcgm_1987', 'divide_and_conquer'])
def test_p_processors_take_the_steps_of_n_for_as_many_lanes_at_a_time(method: str) -> None:
    robot, state = problem(5, 8)
    program = FORWARD_METHODS[method](resolve_plant(robot), 'parallel')
    busy = [
        one.active.bit_count()
        for one in program.instructions
        if OPERATIONS[one.op].cost == 'additions'
    ]
    for processors in (2, 3, 4, 5):
        run = pfd.emulate(robot, *state, method=method, processors=processors)
        assert run.program == program
        assert run.steps == program.count(processors, iterations=run.iterations or 0)
        if run.iterations is None:
            assert run.steps.additions == sum(math.ceil(k / processors) for k in busy)


def test_a_network_joins_as_many_processors_as_joints() -> None:
    robot, state = problem(3, 10)
    with pytest.raises(ValueError, match="network 'ring' needs a processor for each of 3 lanes"):
        pfd.emulate(robot, *state, processors=2, network='ring')
