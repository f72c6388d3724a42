# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of the priced machine: the page networks.md, its tables and its plots."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
import math
from pathlib import Path
from typing import Any

from pfd_core.machine.networks import NETWORKS
from pfd_core.report.measure.convergence import Convergence
from pfd_core.report.measure.counts import (
    AS_PRINTED,
    BEST_KNOWN,
    CORRECTED,
    EDITIONS,
    PRINTED_AT,
    PROCEDURES,
    title_of,
)
from pfd_core.report.measure.network_times import (
    NETWORK_SIZES,
    ONE_PROCESSOR,
    PACKED,
    PRICES,
    SYSTEMS,
    WEIGHTS,
    Recorded,
    best,
    crossover,
    fastest_system,
    measure_system,
    of_system,
    packing_pays_below,
    parallel_pays_below,
    systems_at,
)
from pfd_core.report.measure.processes import each
from pfd_core.report.render.markdown import Cells, grid, page
from pfd_core.report.render.markdown import write as write_page
from pfd_core.report.render.plots import (
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

TITLES = {
    'crossbar': 'crossbar',
    'pm2i': 'PM2I',
    'cube': 'hypercube',
    'mesh': '2-D mesh',
    'ring': 'ring',
    'shuffle': 'shuffle-exchange',
    'bus': 'bus',
}
# Sizes of the tables that show few, and of the plots.
SHOWN = (6, 12, 32, 64)
DRAWN = (6, 64)
# Prices of a route of the tables over n.
FEW_PRICES = (0.0, 0.25, 1.0, 4.0)
# Pairs of systems whose crossover is shown: the first is faster for short chains.
CONTESTS = (
    ('serial', 'pcrbm'),
    ('pcgm', 'pcrbm'),
    ('pcrbm', 'pcrbm_array'),
    ('pcrbm', 'divide_and_conquer'),
    ('pcrbm', 'constraint_forces'),
    ('serial', 'constraint_forces'),
)
SHORT = {
    'serial': 'one processor',
    'pcrbm': 'PCRBM',
    'pcrbm_array': 'array',
    'pcgm': 'PCGM',
    'divide_and_conquer': 'divide and conquer',
    'constraint_forces': 'constraint forces',
}


def markdown(recordings: Sequence[Recorded]) -> str:
    """Return the whole page."""
    sizes = sorted({one.n for one in recordings})
    shown = [n for n in SHOWN if n in sizes]
    at = [one for one in recordings if one.n == PRINTED_AT]
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
        best_known=grid(_best_known(at), 'network, t_r/t_m ='),
        packing=grid(_packing(recordings, shown), 'method'),
        parallel=grid(_parallel(recordings, shown), 'system'),
        fastest=grid(_fastest(recordings, sizes), 'network, t_r/t_m'),
        crossovers=grid(_crossovers(recordings), 'network, t_r/t_m'),
        choices=grid(_choices(at), 'recording'),
    )


def _listed(values: Iterable[float]) -> str:
    *first, last = (f'{value:g}' for value in values)
    return f'{", ".join(first)} and {last}' if first else last


def _recording(one: Recorded) -> str:
    edition = f', {one.edition}' if one.system in PROCEDURES else ''
    if one.system == ONE_PROCESSOR:
        return f'{title_of(one.method)}, one processor'
    iterations = ''
    if one.iterations is not None:
        note = 'median to convergence' if one.converged else 'not converged'
        iterations = f', {one.iterations} iterations ({note})'
    return f'{title_of(one.method)}{edition}{iterations}, {one.packing}'


def _at_one_price(recordings: Sequence[Recorded]) -> Cells:
    """Return the times of PCRBM's editions for t_r = t_m by edition and network."""
    cells: Cells = {}
    for edition in EDITIONS:
        found = of_system(recordings, 'pcrbm', PRINTED_AT, edition)
        for network in NETWORKS:
            if edition == BEST_KNOWN:
                chosen = best(found, network, 1.0)
                cells[edition, TITLES[network]] = f'**{chosen.time(network, 1.0):g}**'
                cells['chosen by best known', TITLES[network]] = _chosen(chosen)
            else:
                for one in found:
                    name = f'{edition}, {one.packing}'
                    cells[name, TITLES[network]] = f'{one.time(network, 1.0):g}'
    return cells


def _chosen(one: Recorded) -> str:
    base = 'base origin, ' if one.method == 'pcrbm_base_origin' else ''
    return base + one.packing


def _lines(recordings: Sequence[Recorded]) -> Cells:
    cells: Cells = {}
    for one in recordings:
        cells[_recording(one), 'arithmetic'] = f'{one.arithmetic:g}'
        for network in NETWORKS:
            cells[_recording(one), f'{TITLES[network]} t_r'] = one.routes[network]
    return cells


def _best_known(recordings: Sequence[Recorded]) -> Cells:
    """Return the time and the packing of the best known recording by network and price."""
    found = of_system(recordings, 'pcrbm', PRINTED_AT)
    return {
        (TITLES[network], f'{price:g}'): f'{chosen.time(network, price):g} {_chosen(chosen)}'
        for network in NETWORKS
        for price in PRICES
        for chosen in [best(found, network, price)]
    }


def _packing(recordings: Sequence[Recorded], shown: Sequence[int]) -> Cells:
    """Return the prices below which packing pays, by method and network."""
    cells: Cells = {}
    for system, methods in SYSTEMS.items():
        for method in methods:
            own = {
                n: [one for one in of_system(recordings, system, n) if one.method == method]
                for n in shown
            }
            for network in NETWORKS:
                prices = (_price(packing_pays_below(own[n], network)) for n in shown)
                cells[title_of(method), TITLES[network]] = ' / '.join(prices)
    return cells


def _parallel(recordings: Sequence[Recorded], shown: Sequence[int]) -> Cells:
    """Return the prices below which a system is faster than one processor."""
    cells: Cells = {}
    for system in SYSTEMS:
        for network in NETWORKS:
            cells[SHORT[system], TITLES[network]] = ' / '.join(
                _price(
                    parallel_pays_below(
                        of_system(recordings, system, n), network, _alone(recordings, n)
                    )
                )
                if _answers(recordings, system, n)
                else '-'
                for n in shown
            )
    return cells


def _alone(recordings: Sequence[Recorded], n: int) -> float:
    (one,) = of_system(recordings, ONE_PROCESSOR, n)
    return one.arithmetic


def _answers(recordings: Sequence[Recorded], system: str, n: int) -> bool:
    """Return whether a system's recordings give qdd: PCGM's after n iterations do not."""
    return all(one.iterations is None or one.converged for one in of_system(recordings, system, n))


def _price(value: float) -> str:
    if math.isinf(value):
        return 'always'
    return f'{value:.2f}' if value else 'never'


def _fastest(recordings: Sequence[Recorded], sizes: Sequence[int]) -> Cells:
    return {
        (f'{TITLES[network]}, {price:g}', n): SHORT[
            fastest_system(recordings, n, network, price)[0]
        ]
        for network in NETWORKS
        for price in FEW_PRICES
        for n in sizes
    }


def _crossovers(recordings: Sequence[Recorded]) -> Cells:
    """Return the n from which the second system of a contest is faster."""
    cells: Cells = {}
    for network in NETWORKS:
        for price in FEW_PRICES:
            for one, other in CONTESTS:
                n = crossover(recordings, one, other, network, price)
                name = f'{SHORT[other]} before {SHORT[one]}'
                cells[f'{TITLES[network]}, {price:g}', name] = '-' if n is None else n
    return cells


def _choices(recordings: Sequence[Recorded]) -> Cells:
    return {
        (_recording(one), name): getattr(one.choices, name)
        for one in recordings
        for name in ('selects', 'merges', 'comparisons')
    }


def median_iterations(found: Iterable[Convergence]) -> dict[int, int]:
    """Return the median iterations of conjugate gradients on uniform chains, by n."""
    return {
        one.n: one.median
        for one in found
        if one.system == 'pcgm' and one.robot == f'uniform{one.n}'
    }


def run(
    iterations: Mapping[int, int], folder: Path, sizes: Sequence[int] = NETWORK_SIZES
) -> list[Path]:
    """Measure every recording on every network and write the page; progress to a terminal."""
    measured = partial(measure_system, iterations=iterations)
    found = each(measured, systems_at(sizes), 'routing of each system', lambda one: one[1])
    return write([one for some in found for one in some], folder)


def write(recordings: Sequence[Recorded], folder: Path) -> list[Path]:
    """Write networks.md and .json, and plots of time over t_r/t_m at each n of DRAWN measured."""
    pages = write_page(folder, 'networks', markdown(recordings), {'recordings': recordings})
    for n in sorted({one.n for one in recordings} & set(DRAWN)):
        draw = partial(_draw, recordings, n)
        pages += save(draw, folder, f'networks-{n}', (13, 7), ['png'])
    return pages


OCHRE = '#C8B400'
# Colour and line of each system and edition that is drawn.
LINES = {
    ('pcrbm', AS_PRINTED): (VERMILLION, ':'),
    ('pcrbm', CORRECTED): (ORANGE, '--'),
    ('pcrbm', BEST_KNOWN): (BLUE, '-'),
    ('pcrbm_array', BEST_KNOWN): (SKY, '-'),
    ('pcgm', BEST_KNOWN): (GREEN, '-'),
    ('divide_and_conquer', BEST_KNOWN): (PURPLE, '-'),
    ('constraint_forces', BEST_KNOWN): (OCHRE, '-'),
}


def _draw(recordings: Sequence[Recorded], n: int, figure: Any) -> None:
    """Draw a panel for each network: time over the price of a route, both logarithmic."""
    prices = [2.0**k for k in (x / 4 for x in range(-24, 17))]
    panels = figure.subplots(2, 4, sharex=True, sharey=True).ravel()
    for network, axes in zip(NETWORKS, panels, strict=False):
        logarithmic(axes)
        axes.axhline(_alone(recordings, n), color=BLACK, lw=1, label='one processor')
        for (system, edition), (color, line) in LINES.items():
            found = of_system(recordings, system, n, edition)
            if edition == BEST_KNOWN and not _answers(recordings, system, n):
                continue
            packed = [one for one in found if edition == BEST_KNOWN or one.packing == PACKED]
            times = [best(packed, network, price).time(network, price) for price in prices]
            label = SHORT[system] + (f', {edition}' if system == 'pcrbm' else '')
            axes.plot(prices, times, color=color, linestyle=line, label=label)
        axes.axvline(1, color=GREY, lw=0.6)
        axes.set_title(TITLES[network])
        axes.set_xticks([1 / 64, 1 / 8, 1, 8], ['1/64', '1/8', '1', '8'])
    for axes in panels[4:]:
        axes.set_xlabel('$t_r/t_m$')
    for axes in panels[::4]:
        axes.set_ylabel('time in $t_m$')
    handles, labels = panels[0].get_legend_handles_labels()
    panels[-1].axis('off')
    panels[-1].legend(handles, labels, loc='center', title=f'n = {n}, best known where not named')
