# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of the iterations of PCGM, pcgm.md, its tables and its plot."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pfd_core.algorithms.emulation import arithmetic
from pfd_core.machine.program import Steps
from pfd_core.report.cases.paper import TABLE
from pfd_core.report.measure.pcgm_iterations import (
    CYCLE,
    SIZES,
    STATES,
    TOLERANCES,
    VARIANTS,
    Reached,
    Study,
    joined,
    study,
)
from pfd_core.report.measure.processes import each
from pfd_core.report.render.markdown import Columns, grid, page, table
from pfd_core.report.render.markdown import write as write_page
from pfd_core.report.render.plots import BLACK, BLUE, GREEN, GREY, ORANGE, over_joints, save

# The tolerance at which the page compares costs.
COMPARED_AT = 1e-6
COLOURS = {'plain': BLACK, 'scaled': ORANGE, 'warm': BLUE, 'both': GREEN}
PRICED_AT = 6


class Found:
    """The rows of a study by n and variant, at the tolerance where costs are compared."""

    def __init__(self, measured: Study) -> None:
        self.sizes = list(measured.pcrbm)
        self.pcrbm = measured.pcrbm
        self.reached = {(row.n, row.variant, row.tolerance): row for row in measured.iterations}
        self.prices = {(one.n, one.variant): one for one in measured.prices}

    def iterations(self, n: int, variant: str) -> Reached:
        """Return the iterations of a variant."""
        return self.reached[n, variant, COMPARED_AT]

    def converged(self, n: int, variant: str) -> Steps:
        """Return the steps of a variant, median of the states."""
        return self.prices[n, variant].total(self.iterations(n, variant).median)

    def cheapest(self, n: int) -> str:
        """Return the variant with least arithmetic, median of the states."""
        return min(VARIANTS, key=lambda variant: arithmetic(self.converged(n, variant)))


def markdown(measured: Study) -> str:
    """Return the whole page."""
    found = Found(measured)
    iterations = {
        f'to_{k}': grid(
            {
                (str(n), f'{name}: median / worst / within n'): _cell(
                    found.reached[n, name, tolerance]
                )
                for n in found.sizes
                for name in VARIANTS
            },
            'n',
        )
        for k, tolerance in enumerate(TOLERANCES)
    }
    return page(
        'pcgm',
        states=STATES,
        cycle=f'{CYCLE * 1e3:g}',
        compared=f'{COMPARED_AT:.0e}',
        tolerances=', '.join(f'{tolerance:.0e}' for tolerance in TOLERANCES),
        priced_at=PRICED_AT,
        **{f'at_{k}': f'{tolerance:.0e}' for k, tolerance in enumerate(TOLERANCES)},
        **iterations,
        costs=table(COSTS, [(found, n) for n in found.sizes]),
        prices=table(PRICES, [found.prices[PRICED_AT, name] for name in VARIANTS]),
    )


def _cell(row: Reached) -> str:
    missed = f' ({row.missed} missed)' if row.missed else ''
    return f'{row.median} / {row.worst}{missed} / {row.within_n:.0%}'


def _both(steps: Steps) -> str:
    return f'{steps.multiplications + steps.divisions} / {steps.additions}'


def _plain(x: tuple[Found, int], iterations: int) -> Steps:
    return x[0].prices[x[1], 'plain'].total(iterations)


def _over(x: tuple[Found, int], iterations: int) -> str:
    found, n = x
    return f'{arithmetic(_plain(x, iterations)) / arithmetic(found.pcrbm[n]):.2f}'


# Columns of (Found, n).
COSTS: Columns = {
    'n': lambda x: x[1],
    'formula of Table 1': lambda x: _formula(x[1]),
    'n iterations': lambda x: _both(_plain(x, x[1])),
    'error left: median / worst': lambda x: _errors(x[0].iterations(x[1], 'plain')),
    'converged: median': lambda x: _both(_plain(x, x[0].iterations(x[1], 'plain').median)),
    'worst': lambda x: _both(_plain(x, x[0].iterations(x[1], 'plain').worst)),
    'cheapest variant, median': lambda x: _cheapest(*x),
    'PCRBM, corrected': lambda x: _both(x[0].pcrbm[x[1]]),
    'arithmetic of PCGM over PCRBM: n iterations': lambda x: _over(x, x[1]),
    'converged': lambda x: _over(x, x[0].iterations(x[1], 'plain').median),
}


def _formula(n: int) -> str:
    system = TABLE['pcgm']
    return f'{system.multiplications.formula(n)} / {system.additions.formula(n)}'


def _errors(row: Reached) -> str:
    return f'{row.error_after_n:.0e} / {row.worst_after_n:.0e}'


def _cheapest(found: Found, n: int) -> str:
    best = found.cheapest(n)
    return f'{best}: {_both(found.converged(n, best))}'


# Columns of a Price.
PRICES: Columns = {
    'variant': 'variant',
    'before the loop: mult': lambda one: one.first.multiplications + one.first.divisions,
    'add': lambda one: one.first.additions,
    'routes': lambda one: one.first.routes,
    'each iteration: mult': lambda one: one.each.multiplications + one.each.divisions,
    'add ': lambda one: one.each.additions,
    'routes ': lambda one: one.each.routes,
}


def run(folder: Path, sizes: Sequence[int] = SIZES) -> list[Path]:
    """Measure and write pcgm.md, .json and .png into a folder."""
    return write(joined(each(study, sizes, 'iterations of PCGM', lambda n: n)), folder)


def write(measured: Study, folder: Path) -> list[Path]:
    """Write the page, its data and its plot."""
    pages = write_page(folder, 'pcgm', markdown(measured), measured)
    return [*pages, *save(partial(_draw, Found(measured)), folder, 'pcgm', (12, 5), ['png'])]


def _draw(found: Found, figure: Any) -> None:
    """Draw iterations over n, and steps of arithmetic over n."""
    sizes = found.sizes
    left, right = figure.subplots(1, 2)
    for name, colour in COLOURS.items():
        own = [found.iterations(n, name) for n in sizes]
        left.loglog(sizes, [row.median for row in own], color=colour, marker='.', label=name)
        left.loglog(sizes, [row.worst for row in own], color=colour, linestyle=':')
        costs = [arithmetic(found.converged(n, name)) for n in sizes]
        right.loglog(sizes, costs, color=colour, marker='.', label=f'{name}, converged')
    left.loglog(sizes, sizes, color=GREY, linestyle='--', label='n, as the paper counts')
    left.set_title(f'iterations to {COMPARED_AT:.0e}: median, worst (dotted)')
    in_n = [arithmetic(found.prices[n, 'plain'].total(n)) for n in sizes]
    right.loglog(sizes, in_n, color=GREY, linestyle='--', label='plain, n iterations')
    costs = [arithmetic(found.pcrbm[n]) for n in sizes]
    right.loglog(sizes, costs, color=GREY, marker='x', label='PCRBM, corrected')
    right.set_title('steps of arithmetic, one lane per link, no routes')
    for axes in (left, right):
        over_joints(axes, [2**k for k in range(1, 7)])
        axes.legend(fontsize=8)
