# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Methods since 1987, and what the paper leaves open: networks, and fewer processors than joints.

The time of a recording on a network is a line over t_r: its arithmetic, and its steps of routes
times t_r. texts/since-1987.md defines both, and the networks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from benchmarks.cases import conjugate, paper
from benchmarks.cases.paper import BEST_KNOWN, PRINTED_AT, Recording
from benchmarks.cases.robots import KINDS
from benchmarks.pages.counts import best_serial, efficiency, speed_up, with_baselines
from benchmarks.run import each
from benchmarks.table import Columns, Row, grid, lines_of, page, table
from pfd_core.dynamics.methods import FORWARD, ITERATIVE, METHODS, SERIAL

SIZES = (2, 3, 4, 5, 6, 8, 10, 12, 16, 24, 32, 64)
# Joints, and numbers of processors: divisors, and for 6 joints also 4.
PROCESSORS = {6: (1, 2, 3, 4, 6), 12: (1, 2, 3, 4, 6, 12), 64: (1, 2, 4, 8, 16, 32, 64)}
# Methods that are not the paper's, those of one processor last.
OTHERS = tuple(x for x in FORWARD if x not in paper.TABLE and not x.endswith('_1987'))
# Prices t_r/t_m over n.
PRICES = (0.0, 0.25, 1.0, 4.0)
PRICES_SHOWN = (1.0, 4.0)
# Times of arithmetic, t_m = 1; sines, which the paper takes as given, have none.
WEIGHTS = {'multiplications': 1.0, 'additions': 1.0, 'divisions': 4.0, 'square_roots': 4.0}
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
    'articulated_body_doubling': ('articulated_body_doubling',),
    'constraint_forces': ('constraint_forces',),
}
NAMES = (
    *('one processor', 'PCRBM', 'array', 'PCGM'),
    *('divide and conquer', 'articulated bodies', 'constraint forces'),
)
SHORT = dict(zip(SYSTEMS, NAMES, strict=True))
SHORT_TITLES = SHORT | {'pcrbm_base_origin': 'PCRBM about the base origin'}
# Methods whose errors are measured, and the chains: of each kind, some with rotors, two of a size.
ACCURATE = ('pcrbm', 'articulated_body_doubling', 'divide_and_conquer', 'constraint_forces')
ROTORS = ', rotors'
ACCURACY = [
    ((n, kind, 500 + seed), rotors)
    for kind, rotors in (*((kind, False) for kind in KINDS), (KINDS[0], True), (KINDS[4], True))
    for seed in range(2)
    for n in conjugate.JOINTS
]
PACKED, UNPACKED = 'packed', 'one lane per link'
SCHEDULES = {'parallel': PACKED, 'unpacked': UNPACKED, 'sequential': ''}


def measure(quick: bool) -> dict[str, Any]:
    """Count every method, and route every system; quick is six joints only."""
    sizes = (PRINTED_AT,) if quick else SIZES
    items = [(system, n) for n in sizes for system in SYSTEMS]
    found = each(recorded, items, 'routing of each system', lambda one: one[1])
    serial = [x for x in METHODS if x in SERIAL and x not in ITERATIVE]
    alone = [(x, n) for n in sizes for x in serial]
    others = [(x, n) for n in sizes for x in OTHERS]
    parallel = [x for x in METHODS if x not in SERIAL]
    fewer = [(x, n, BEST_KNOWN, p) for n in sizes for p in PROCESSORS.get(n, ()) for x in parallel]
    counts = each(counted, [*alone, *others, *fewer], 'counting steps', lambda key: key[1])
    chains = [x for x in ACCURACY if not quick or x[0][0] == PRINTED_AT]
    answers = each(answered, chains, 'errors of chains', lambda x: x[0][0])
    return {
        'accuracy': [row for rows in answers for row in rows],
        'serial': [best_serial(counts[: len(alone)], n) for n in sizes],
        'methods': counts[len(alone) : len(alone) + len(others)],
        'processors': counts[len(alone) + len(others) :],
        'recordings': [row for rows in found for row in rows],
    }


def counted(key: tuple[Any, ...]) -> dict[str, Any]:
    """Return the counts of a method at an n, an edition and a number of processors."""
    return paper.row(*key)


def answered(item: tuple[tuple[int, str, int], bool]) -> list[dict[str, Any]]:
    """Return statuses and errors of ACCURATE on a chain, with rotors or without."""
    chain, rotors = item
    rows = conjugate.statuses_of(chain, ACCURATE, rotors)
    return [row | {'kind': row['kind'] + ROTORS * rotors} for row in rows]


def recorded(item: tuple[str, int]) -> list[dict[str, Any]]:
    """
    Return the recordings of a system at an n, of one processor only the fastest.

    Conjugate gradients take n iterations, as in the paper.
    """
    system, n = item
    if system == ONE:
        ways = [Recording(method, n, schedule='sequential') for method in SYSTEMS[ONE]]
        return [min((_row(ONE, way) for way in ways), key=lambda row: row['arithmetic'])]
    printed = [(system, edition) for edition in paper.EDITIONS[:2] if system in paper.PROCEDURES]
    return [
        _row(system, Recording(method, n, edition, schedule))
        for method, edition in (*printed, *((x, BEST_KNOWN) for x in SYSTEMS[system]))
        for schedule in ('parallel', 'unpacked')
    ]


def _row(system: str, one: Recording) -> dict[str, Any]:
    """Return a recording: the time of its arithmetic, and its steps of routes by network."""
    program, count = paper.program_of(one), one.n if one.method in ITERATIVE else 1
    on = {network: paper.steps_of(one, program, count, network) for network in NETWORKS}
    return {
        'system': system,
        'edition': one.edition,
        'method': one.method,
        'title': paper.title_of(one.method, one.edition),
        'n': one.n,
        'packing': SCHEDULES[one.schedule],
        'arithmetic': paper.time_of(one, program, WEIGHTS, count),
        **{network: steps.routes for network, steps in on.items()},
    }


# ---- times of rows ----


def time(row: Row, network: str, price: float) -> float:
    """Return the time of a recording on a network for a price of a route."""
    return float(row['arithmetic'] + price * row[network])


def of_system(rows: Iterable[Row], system: str, n: int, edition: str = BEST_KNOWN) -> list[Row]:
    """Return the recordings of an edition of a system at one n."""
    key = (system, n, edition)
    return [row for row in rows if (row['system'], row['n'], row['edition']) == key]


def best(rows: Iterable[Row], network: str, price: float) -> Row:
    """Return the fastest recording on a network for a price of a route."""
    return min(rows, key=lambda row: time(row, network, price))


def system_time(rows: Iterable[Row], system: str, n: int, network: str, price: float) -> float:
    """Return the time of a system in its fastest best known recording."""
    return time(best(of_system(rows, system, n), network, price), network, price)


# ---- the page ----

METHOD_COLUMNS: Columns = {
    'n': 'n',
    'method': lambda x: f'{x["title"]} (`{x["system"]}`)',
    'processors': 'processors',
    'multiplications': 'multiplications',
    'additions': 'additions',
    'routes': 'routes',
    'with one lane per link': lambda x: ', '.join(
        str(x[f'unpacked_{kind}']) for kind in ('multiplications', 'additions', 'routes')
    ),
    'speed-up, alone / with routes': lambda x: _two(speed_up, x, '.2f'),
}


def text(data: dict[str, Any]) -> str:
    """Return the page."""
    rows = data['recordings']
    sizes = sorted({row['n'] for row in rows})
    methods, fewer = (with_baselines(data[x], data['serial']) for x in ('methods', 'processors'))
    return page(
        'since-1987',
        n=PRINTED_AT,
        division=f'{WEIGHTS["divisions"]:g}',
        root=f'{WEIGHTS["square_roots"]:g}',
        accuracy=grid(dict(_accuracy(data['accuracy'])), 'chains'),
        methods=table(METHOD_COLUMNS, (x for x in methods if x['n'] in (PRINTED_AT, sizes[-1]))),
        lines=table(
            {'recording': _recording, 'arithmetic': lambda x: f'{x["arithmetic"]:g}'}
            | {title: network for network, title in NETWORKS.items()},
            (row for row in rows if (row['n'], row['edition']) == (PRINTED_AT, BEST_KNOWN)),
        ),
        fastest=lines_of(
            ['network, t_r/t_m', *sizes],
            (
                [f'{title}, {price:g}', *(_fastest(rows, n, network, price) for n in sizes)]
                for network, title in NETWORKS.items()
                for price in PRICES_SHOWN
            ),
        ),
        processors=grid({_place(x): _ratios(x) for x in fewer if x['best']}, 'joints, processors'),
    )


def _accuracy(rows: Sequence[Row]) -> Iterator[tuple[tuple[str, str], str]]:
    """Yield the errors of each method on each kind of chain, and how many are `ok`."""
    for kind in dict.fromkeys(row['kind'] for row in rows):
        for method in ACCURATE:
            own = [x for x in rows if (x['kind'], x['method']) == (kind, method)]
            cell = '-'
            if own:
                median, most = np.quantile([x['error'] for x in own], [0.5, 1.0])
                right = sum(x['status'] == 'ok' for x in own)
                cell = f'{median:.0e} / {most:.0e}, {right} of {len(own)}'
            yield (kind, SHORT[method]), cell


def _two(ratio: Callable[..., float], x: Row, form: str) -> str:
    """Return a ratio to the best serial method by arithmetic alone / with routes."""
    return ' / '.join(format(ratio(x, 'best', routed), form) for routed in (False, True))


def _place(x: Row) -> tuple[str, str]:
    return f'{x["n"]}, {x["processors"]}', SHORT_TITLES[x['system']]


def _ratios(x: Row) -> str:
    """Return speed-up and efficiency of a method on some processors."""
    return f'{_two(speed_up, x, ".2f")} ({_two(efficiency, x, ".0%")})'


def _recording(row: Row) -> str:
    iterations = f', {row["n"]} iterations' if row['method'] in ITERATIVE else ''
    return f'{row["title"]}{iterations}, {row["packing"] or SHORT[ONE]}'


def _fastest(rows: Sequence[Row], n: int, network: str, price: float) -> str:
    times = {system: system_time(rows, system, n, network, price) for system in SYSTEMS}
    return SHORT[min(times, key=times.__getitem__)]
