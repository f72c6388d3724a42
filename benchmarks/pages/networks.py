# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Time of every system on every network, over the price of a route.

The time of a recording is a line over t_r: its arithmetic, and its steps of routes times t_r. A
system is recorded packed and with one lane per link. *Best known* is the fastest of our recordings
of a system at that price on that network: it chooses the packing, and for PCRBM also the base
origin. Weights of arithmetic are the defaults of pfd_core.paper.prices. The triangular array has
separate links, which are not on the network.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import math
from typing import Any

from benchmarks.cases import paper
from benchmarks.cases.paper import BEST_KNOWN, PRINTED_AT, Recording
from benchmarks.cases.robots import uniform_chain
from benchmarks.pages.iterations import CHAINS, convergence
from benchmarks.run import each
from benchmarks.table import Cells, Row, grid, page
from pfd_core.dynamics.methods import ITERATIVE, METHODS, SERIAL
from pfd_core.paper.prices import Weights

SIZES = (2, 3, 4, 5, 6, 8, 10, 12, 16, 24, 32, 64)
# Sizes of the tables that show few; prices t_r/t_m over n.
SHOWN, PRICES = (6, 12, 32, 64), (0.0, 0.25, 1.0, 4.0)
WEIGHTS = Weights()
NETWORKS = {
    'crossbar': 'crossbar',
    'pm2i': 'PM2I',
    'cube': 'hypercube',
    'mesh': '2-D mesh',
    'ring': 'ring',
    'shuffle': 'shuffle-exchange',
    'bus': 'bus',
}
ONE = 'serial'
# Our own methods of each system; the first is one processor.
SYSTEMS = {
    ONE: tuple(method for method in METHODS if method in SERIAL and method not in ITERATIVE),
    'pcrbm': ('pcrbm', 'pcrbm_base_origin'),
    'pcrbm_array': ('pcrbm_array',),
    'pcgm': ('pcgm',),
    'divide_and_conquer': ('divide_and_conquer',),
    'constraint_forces': ('constraint_forces',),
}
NAMES = ('one processor', 'PCRBM', 'array', 'PCGM', 'divide and conquer', 'constraint forces')
SHORT = dict(zip(SYSTEMS, NAMES, strict=True))
PACKED, UNPACKED = 'packed', 'one lane per link'
SCHEDULES = {'parallel': PACKED, 'unpacked': UNPACKED, 'sequential': ''}


def measure(quick: bool) -> dict[str, Any]:
    """Record and route every system; quick is six joints only."""
    sizes = (PRINTED_AT,) if quick else SIZES
    chains = [n for n in CHAINS if n in sizes]
    medians = dict(zip(chains, each(_median, chains, 'counting iterations', int), strict=True))
    items = [(system, n, medians.get(n)) for n in sizes for system in SYSTEMS]
    found = each(recorded, items, 'routing of each system', lambda one: one[1])
    return {'recordings': [row for rows in found for row in rows]}


def _median(n: int) -> int:
    return int(convergence('pcgm', uniform_chain(n))['median'])


def recorded(item: tuple[str, int, int | None]) -> list[dict[str, Any]]:
    """
    Return the recordings of a system at an n, of one processor only the fastest.

    Conjugate gradients take n iterations, and again, best known, the given median to convergence.
    """
    system, n, median = item
    if system == ONE:
        ways = [Recording(method, n, schedule='sequential') for method in SYSTEMS[ONE]]
        return [min((_row(ONE, way) for way in ways), key=lambda row: row['arithmetic'])]
    printed = [(system, edition) for edition in paper.EDITIONS[:2] if system in paper.PROCEDURES]
    rows = []
    for method, edition in (*printed, *((x, BEST_KNOWN) for x in SYSTEMS[system])):
        for schedule in ('parallel', 'unpacked'):
            one = Recording(method, n, edition, schedule)
            rows.append(_row(system, one, n if system in ITERATIVE else None))
            if median and system in ITERATIVE and edition == BEST_KNOWN:
                rows.append(_row(system, one, median, converged=True))
    return rows


def _row(
    system: str, one: Recording, iterations: int | None = None, converged: bool = False
) -> dict[str, Any]:
    """Return a recording: the time of its arithmetic, and its steps of routes by network."""
    program, count = paper.program_of(one), iterations or 1
    on = {network: paper.steps_of(one, program, count, network) for network in NETWORKS}
    return {
        'system': system,
        'edition': one.edition,
        'method': one.method,
        'title': paper.title_of(one.method, one.edition),
        'n': one.n,
        'iterations': iterations,
        'converged': converged,
        'packing': SCHEDULES[one.schedule],
        'arithmetic': WEIGHTS.arithmetic(on['crossbar']),
        **{network: steps.routes for network, steps in on.items()},
    }


# ---- times of rows ----


def time(row: Row, network: str, price: float) -> float:
    """Return the time of a recording on a network for a price of a route."""
    return float(row['arithmetic'] + price * row[network])


def of_system(rows: Iterable[Row], system: str, n: int, edition: str = BEST_KNOWN) -> list[Row]:
    """
    Return the recordings of an edition of a system at one n.

    Conjugate gradients, best known: the converged recordings, if they were measured.
    """
    key = (system, n, edition)
    found = [row for row in rows if (row['system'], row['n'], row['edition']) == key]
    return [row for row in found if row['converged']] or found


def best(rows: Iterable[Row], network: str, price: float) -> Row:
    """Return the fastest recording on a network for a price of a route."""
    return min(rows, key=lambda row: time(row, network, price))


def answers(rows: Iterable[Row]) -> bool:
    """Return whether recordings give qdd: PCGM's after n iterations do not."""
    return all(row['iterations'] is None or row['converged'] for row in rows)


def break_even(one: Row, other: Row, network: str) -> float:
    """
    Return the price of a route below which the first recording is faster than the second.

    Infinity if it is faster at every price, zero if at none. ValueError if the first recording has
    fewer steps of routes than the second.
    """
    saved, routed = other['arithmetic'] - one['arithmetic'], one[network] - other[network]
    if routed < 0:
        raise ValueError(f'the first recording has {-routed} fewer routes on {network}')
    if routed == 0:
        return math.inf if saved > 0 else 0.0
    return float(max(saved, 0.0) / routed)


def packing_pays_below(rows: Iterable[Row], network: str) -> float:
    """Return the price below which a method is faster packed than with one lane per link."""
    by_packing = {row['packing']: row for row in rows}
    return break_even(by_packing[PACKED], by_packing[UNPACKED], network)


def parallel_pays_below(rows: Iterable[Row], network: str, serial: Row) -> float:
    """Return the price below which some recording is faster than one on one processor."""
    faster = (row for row in rows if row['arithmetic'] < serial['arithmetic'])
    return max((break_even(row, serial, network) for row in faster), default=0.0)


def system_time(
    rows: Iterable[Row], system: str, n: int, network: str, price: float
) -> float | None:
    """Return the time of a system's best known answer; None if it was not measured."""
    found = of_system(rows, system, n)
    return time(best(found, network, price), network, price) if found and answers(found) else None


# ---- the page ----


def text(data: dict[str, Any]) -> str:
    """Return the page."""
    rows = data['recordings']
    sizes = sorted({row['n'] for row in rows})
    shown = [n for n in SHOWN if n in sizes]

    others = [system for system in SYSTEMS if system != ONE]
    packing: Cells = {
        (f'{paper.title_of(method)}, n = {n}', title): _price(packing_pays_below(own, network))
        for system in others
        for method in SYSTEMS[system]
        for n in shown
        for own in [[x for x in of_system(rows, system, n) if x['method'] == method]]
        for network, title in NETWORKS.items()
    }
    parallel: Cells = {
        (f'{SHORT[system]}, n = {n}', title): _price(parallel_pays_below(own, network, serial))
        for system in others
        for n in shown
        for own, (serial,) in [(of_system(rows, system, n), of_system(rows, ONE, n))]
        for network, title in NETWORKS.items()
        if answers(own)
    }
    return page(
        'networks',
        n=PRINTED_AT,
        division=f'{WEIGHTS.division:g}',
        root=f'{WEIGHTS.square_root:g}',
        lines=grid(
            {
                (_recording(row), name): f'{row[key]:g}'
                for row in rows
                if row['n'] == PRINTED_AT
                for key, name in {'arithmetic': 'arithmetic', **NETWORKS}.items()
            },
            'recording',
        ),
        packing=grid(packing, 'method'),
        parallel=grid(parallel, 'system'),
        fastest=grid(
            {
                (f'{title}, {price:g}', n): _fastest(rows, n, network, price)
                for network, title in NETWORKS.items()
                for price in PRICES
                for n in sizes
            },
            'network, t_r/t_m',
        ),
    )


def _recording(row: Row) -> str:
    note = 'median to convergence' if row['converged'] else 'not converged'
    iterations = f', {row["iterations"]} iterations ({note})' if row['iterations'] else ''
    return f'{row["title"]}{iterations}, {row["packing"] or SHORT[ONE]}'


def _price(value: float) -> str:
    return 'always' if math.isinf(value) else f'{value:.2f}' if value else 'never'


def _fastest(rows: Sequence[Row], n: int, network: str, price: float) -> str:
    times = {system: system_time(rows, system, n, network, price) for system in SYSTEMS}
    known = {system: time for system, time in times.items() if time is not None}
    return SHORT[min(known, key=known.__getitem__)]
