# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Time of every system on every network, over the price of a route.

The time of a recording is a line over t_r: its arithmetic, and its steps of routes times t_r. A
system is recorded packed and with one lane per link. *As printed* and *corrected* show both
recordings. *Best known* is the fastest of our recordings of a system at that price on that
network: it chooses the packing, and for PCRBM also the base origin. Weights of arithmetic are the
defaults of pfd_core.machine.prices: an addition takes the time of a multiplication, a division or
root four times as long. The triangular array has separate links, which are not on the network.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from functools import partial
import math
from pathlib import Path
from typing import Any

from benchmarks.cases import paper
from benchmarks.cases.paper import AS_PRINTED, BEST_KNOWN, CORRECTED, PRINTED_AT, Recording
from benchmarks.cases.robots import uniform_chain
from benchmarks.pages.iterations import CHAINS, convergence
from benchmarks.plots import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    logarithmic,
    save,
)
from benchmarks.run import each
from benchmarks.table import Cells, Row, grid, page
from pfd_core.algorithms.programs import ITERATIVE, METHODS, SERIAL
from pfd_core.machine.prices import Weights, choices

SIZES = (2, 3, 4, 5, 6, 8, 10, 12, 16, 24, 32, 64)
# Sizes of the tables that show few, and of the plots; prices t_r/t_m, and those over n.
SHOWN, DRAWN = (6, 12, 32, 64), (6, 64)
PRICES, FEW_PRICES = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0), (0.0, 0.25, 1.0, 4.0)
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
# Our own methods of each system, and its short name; the first is one processor.
SYSTEMS = {
    ONE: tuple(method for method in METHODS if method in SERIAL and method not in ITERATIVE),
    'pcrbm': ('pcrbm', 'pcrbm_base_origin'),
    'pcrbm_array': ('pcrbm_array',),
    'pcgm': ('pcgm',),
    'divide_and_conquer': ('divide_and_conquer',),
    'constraint_forces': ('constraint_forces',),
}
SHORT = dict(zip(SYSTEMS, ('one processor', 'PCRBM', 'array', 'PCGM'), strict=False))
SHORT |= {'divide_and_conquer': 'divide and conquer', 'constraint_forces': 'constraint forces'}
PACKED, UNPACKED = 'packed', 'one lane per link'
SCHEDULES = {PACKED: 'parallel', UNPACKED: 'unpacked'}
# Pairs of systems whose crossover is shown: the first is faster for short chains.
CONTESTS = (
    (ONE, 'pcrbm'),
    ('pcgm', 'pcrbm'),
    ('pcrbm', 'pcrbm_array'),
    ('pcrbm', 'divide_and_conquer'),
    ('pcrbm', 'constraint_forces'),
    (ONE, 'constraint_forces'),
)
# Colour and line of each system and edition that is drawn.
LINES = {
    ('pcrbm', AS_PRINTED): (VERMILLION, ':'),
    ('pcrbm', CORRECTED): (ORANGE, '--'),
    ('pcrbm', BEST_KNOWN): (BLUE, '-'),
    ('pcrbm_array', BEST_KNOWN): (SKY, '-'),
    ('pcgm', BEST_KNOWN): (GREEN, '-'),
    ('divide_and_conquer', BEST_KNOWN): (PURPLE, '-'),
    ('constraint_forces', BEST_KNOWN): ('#C8B400', '-'),
}


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
        ways = [Recording(method, n, BEST_KNOWN, 'sequential') for method in SYSTEMS[ONE]]
        return [min((_row(ONE, way, '') for way in ways), key=lambda row: row['arithmetic'])]
    editions = [(system, edition) for edition in paper.EDITIONS[:2] if system in paper.PROCEDURES]
    counts = (n, median) if system in ITERATIVE else (None,)
    return [
        _row(system, Recording(method, n, edition, schedule), packing, count, k == 1)
        for method, edition in [*editions, *((method, BEST_KNOWN) for method in SYSTEMS[system])]
        for packing, schedule in SCHEDULES.items()
        for k, count in enumerate(counts)
        if k == 0 or (edition == BEST_KNOWN and count)
    ]


def _row(
    system: str,
    one: Recording,
    packing: str,
    iterations: int | None = None,
    converged: bool = False,
) -> dict[str, Any]:
    """Return a recording: steps, time of its arithmetic, and steps of routes by network."""
    program, count = paper.program_of(one), iterations or 1
    on = {network: paper.steps_of(one, program, count, network) for network in NETWORKS}
    steps = on['crossbar']
    return {
        'system': system,
        'edition': one.edition,
        'method': one.method,
        'title': paper.title_of(one.method, one.edition),
        'n': one.n,
        'iterations': iterations,
        'converged': converged,
        'packing': packing,
        'multiplications': steps.multiplications,
        'additions': steps.additions,
        'divisions': steps.divisions,
        'square_roots': steps.square_roots,
        'arithmetic': WEIGHTS.arithmetic(steps),
        **{network: steps.routes for network, steps in on.items()},
        **asdict(choices(program, count)),
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


def crossover(rows: Sequence[Row], one: str, other: str, network: str, price: float) -> int | None:
    """
    Return the least measured n from which on the other system is faster.

    None if it is not faster at the largest n at which both are measured.
    """
    found = None
    for n in sorted({row['n'] for row in rows}, reverse=True):
        before, after = (system_time(rows, name, n, network, price) for name in (one, other))
        if before is not None and after is not None:
            if after >= before:
                break
            found = n
    return found


# ---- the page ----


def text(data: dict[str, Any]) -> str:
    """Return the page."""
    rows = data['recordings']
    sizes = sorted({row['n'] for row in rows})
    shown = [n for n in SHOWN if n in sizes]
    at = [row for row in rows if row['n'] == PRINTED_AT]
    pcrbm = of_system(at, 'pcrbm', PRINTED_AT)
    priced = [(f'{NETWORKS[x]}, {price:g}', x, price) for x in NETWORKS for price in FEW_PRICES]
    ours = [(x, method) for x in SYSTEMS if x != ONE for method in SYSTEMS[x]]

    def by_network(cell: Callable[..., object], keys: Iterable[tuple[str, Any]]) -> Cells:
        """Return cells of a key by title and network."""
        return {
            (title, NETWORKS[network]): cell(key, network)
            for title, key in keys
            for network in NETWORKS
        }

    def packing(key: tuple[str, str], network: str) -> str:
        own = [[x for x in of_system(rows, key[0], n) if x['method'] == key[1]] for n in shown]
        return ' / '.join(_price(packing_pays_below(some, network)) for some in own)

    def parallel(system: str, network: str) -> str:
        return ' / '.join(_pays(rows, system, n, network) for n in shown)

    def chosen(price: float, network: str) -> str:
        one = best(pcrbm, network, price)
        return f'{time(one, network, price):g} {_chosen(one)}'

    return page(
        'networks',
        n=PRINTED_AT,
        longest=max(sizes),
        division=f'{WEIGHTS.division:g}',
        root=f'{WEIGHTS.square_root:g}',
        sizes=_listed(shown),
        prices=_listed(PRICES),
        same_price=grid(_at_one_price(at), 'PCRBM, t_r = t_m'),
        lines=grid(_lines(at), 'recording'),
        best_known=grid(
            {
                (title, f'{price:g}'): chosen(price, network)
                for network, title in NETWORKS.items()
                for price in PRICES
            },
            'network, t_r/t_m =',
        ),
        packing=grid(by_network(packing, ((paper.title_of(x[1]), x) for x in ours)), 'method'),
        parallel=grid(
            by_network(parallel, ((SHORT[x], x) for x in SYSTEMS if x != ONE)), 'system'
        ),
        fastest=grid(
            {(key, n): _fastest(rows, n, x, price) for key, x, price in priced for n in sizes},
            'network, t_r/t_m',
        ),
        crossovers=grid(
            {
                (key, f'{SHORT[other]} before {SHORT[one]}'): (
                    crossover(rows, one, other, x, price) or '-'
                )
                for key, x, price in priced
                for one, other in CONTESTS
            },
            'network, t_r/t_m',
        ),
        choices=grid(
            {
                (_recording(row), name): row[name]
                for row in at
                for name in ('selects', 'merges', 'comparisons')
            },
            'recording',
        ),
    )


def _listed(values: Iterable[float]) -> str:
    *first, last = (f'{value:g}' for value in values)
    return f'{", ".join(first)} and {last}' if first else last


def _recording(row: Row) -> str:
    if row['system'] == ONE:
        return f'{row["title"]}, one processor'
    note = 'median to convergence' if row['converged'] else 'not converged'
    iterations = f', {row["iterations"]} iterations ({note})' if row['iterations'] else ''
    return f'{row["title"]}{iterations}, {row["packing"]}'


def _chosen(row: Row) -> str:
    return ('base origin, ' if row['method'] == 'pcrbm_base_origin' else '') + str(row['packing'])


def _at_one_price(rows: Sequence[Row]) -> Cells:
    """Return the times of PCRBM's editions for t_r = t_m by edition and network."""
    cells: Cells = {}
    for network, title in NETWORKS.items():
        for edition in paper.EDITIONS[:2]:
            for row in of_system(rows, 'pcrbm', PRINTED_AT, edition):
                cells[f'{edition}, {row["packing"]}', title] = f'{time(row, network, 1.0):g}'
        chosen = best(of_system(rows, 'pcrbm', PRINTED_AT), network, 1.0)
        cells[BEST_KNOWN, title] = f'**{time(chosen, network, 1.0):g}**'
        cells['chosen by best known', title] = _chosen(chosen)
    return cells


def _lines(rows: Iterable[Row]) -> Cells:
    cells: Cells = {}
    for row in rows:
        cells[_recording(row), 'arithmetic'] = f'{row["arithmetic"]:g}'
        cells |= {
            (_recording(row), f'{title} t_r'): row[network] for network, title in NETWORKS.items()
        }
    return cells


def _pays(rows: Sequence[Row], system: str, n: int, network: str) -> str:
    own, (serial,) = of_system(rows, system, n), of_system(rows, ONE, n)
    return _price(parallel_pays_below(own, network, serial)) if answers(own) else '-'


def _price(value: float) -> str:
    return 'always' if math.isinf(value) else f'{value:.2f}' if value else 'never'


def _fastest(rows: Sequence[Row], n: int, network: str, price: float) -> str:
    times = {system: system_time(rows, system, n, network, price) for system in SYSTEMS}
    known = {system: time for system, time in times.items() if time is not None}
    return SHORT[min(known, key=known.__getitem__)]


def plots(data: dict[str, Any], folder: Path) -> list[Path]:
    """Draw time over the price of a route at each n of DRAWN that was measured."""
    rows = data['recordings']
    sizes = sorted({row['n'] for row in rows} & set(DRAWN))
    drawn = ((f'networks-{n}', partial(_draw, rows, n)) for n in sizes)
    return [path for name, draw in drawn for path in save(draw, folder, name, (13, 7), ['png'])]


def _draw(rows: Sequence[Row], n: int, figure: Any) -> None:
    """Draw a panel for each network: time over the price of a route, both logarithmic."""
    prices = [2.0 ** (k / 4) for k in range(-24, 17)]
    (serial,) = of_system(rows, ONE, n)
    panels = figure.subplots(2, 4, sharex=True, sharey=True).ravel()
    for (network, title), axes in zip(NETWORKS.items(), panels, strict=False):
        logarithmic(axes)
        axes.axhline(serial['arithmetic'], color=BLACK, lw=1, label=SHORT[ONE])
        for (system, edition), (color, line) in LINES.items():
            found = of_system(rows, system, n, edition)
            if edition != BEST_KNOWN:
                found = [row for row in found if row['packing'] == PACKED]
            elif not answers(found):
                continue
            times = [time(best(found, network, price), network, price) for price in prices]
            label = SHORT[system] + (f', {edition}' if system == 'pcrbm' else '')
            axes.plot(prices, times, color=color, linestyle=line, label=label)
        axes.axvline(1, color=GREY, lw=0.6)
        axes.set_title(title)
        axes.set_xticks([1 / 64, 1 / 8, 1, 8], ['1/64', '1/8', '1', '8'])
    for axes in panels[4:]:
        axes.set_xlabel('$t_r/t_m$')
    for axes in panels[::4]:
        axes.set_ylabel('time in $t_m$')
    handles, labels = panels[0].get_legend_handles_labels()
    panels[-1].axis('off')
    panels[-1].legend(handles, labels, loc='center', title=f'n = {n}, best known where not named')
