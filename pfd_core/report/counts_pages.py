# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of the step counts: the page counts.md, its tables, the plot and all files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pfd_core.algorithms.paper.array_solver import solve
from pfd_core.machine.program import Steps
from pfd_core.report.cases.paper import KINDS, TABLE, value
from pfd_core.report.measure.claims import counted_verdicts
from pfd_core.report.measure.convergence import Convergence, measure_convergence, robots
from pfd_core.report.measure.counts import (
    AS_PRINTED,
    BEST_KNOWN,
    CORRECTED,
    MACHINES,
    PRINTED_AT,
    SIZES,
    Cell,
    CountedPart,
    Row,
    best_serial,
    count_all,
    counted_parts,
    edition_title,
    machine_of,
    measure,
    measure_on_processors,
    published_serial,
)
from pfd_core.report.measure.counts import row as counts_of
from pfd_core.report.measure.network_times import NETWORK_SIZES
from pfd_core.report.measure.processes import each
from pfd_core.report.network_pages import median_iterations
from pfd_core.report.network_pages import run as run_networks
from pfd_core.report.paper_pages import write_errata
from pfd_core.report.processor_pages import write as write_processors
from pfd_core.report.render.array_activity import runs_svg
from pfd_core.report.render.markdown import Columns, grid, page, table, write_text
from pfd_core.report.render.markdown import write as write_page
from pfd_core.report.render.plots import over_joints, save


def markdown(rows: Sequence[Row], iterations: Sequence[Convergence]) -> str:
    """Return the whole page."""
    chosen = [row for row in rows if row.n == PRINTED_AT]
    best, arithmetic = best_serial(PRINTED_AT)
    editions = {(row.system, row.edition): row for row in chosen}
    pcrbm = TABLE['pcrbm']
    printed = (pcrbm.multiplications.printed or 0) + (pcrbm.additions.printed or 0)
    published = int(published_serial(PRINTED_AT))
    return page(
        'counts',
        n=PRINTED_AT,
        best=editions[best, BEST_KNOWN].title,
        arithmetic=arithmetic,
        published=published,
        printed=printed,
        printed_speed_up=f'{published / printed:.2f}',
        states=iterations[0].states,
        parts=table(PARTS, counted_parts(PRINTED_AT)),
        systems=table(SYSTEMS, [one for row in chosen for one in _noted(row, iterations)]),
        claims=table(
            CLAIMS,
            [
                (editions, row, kind, iterations)
                for row in chosen
                for kind, cell in row.cells.items()
                if cell.claimed is not None and row.edition == BEST_KNOWN
            ],
        ),
        convergence=table(CONVERGENCE, iterations),
        **{kind: _over_n(rows, partial(_measured_and_claimed, kind)) for kind in KINDS[:2]},
        routes=_over_n(
            [row for row in rows if row.units > 1],
            lambda row: f'{row.steps.routes} / {row.unpacked.routes}',
        ),
        speed_up=_over_n([row for row in rows if row.speed_up is not None], _speed_up),
    )


def summary(rows: Sequence[Row], verdicts: Sequence[str]) -> str:
    """Return the speed-ups of PCRBM and the verdicts on claims as a paragraph, for the README."""
    known = {(row.system, row.edition): row for row in rows if row.n == PRINTED_AT}
    executed, own = known['pcrbm', AS_PRINTED], known['pcrbm', BEST_KNOWN]
    base = known['pcrbm_base_origin', BEST_KNOWN]
    pcrbm, published = TABLE['pcrbm'], published_serial(PRINTED_AT)
    printed = (pcrbm.multiplications.printed or 0) + (pcrbm.additions.printed or 0)
    return page(
        'paper-summary',
        printed=f'{published / printed:.2f}',
        executed=_ratio(executed.published_speed_up),
        best=_ratio(executed.speed_up),
        routed=_ratio(executed.routed_speed_up),
        own=_ratio(own.speed_up),
        own_routed=_ratio(own.routed_speed_up),
        base=_ratio(base.speed_up),
        base_routed=_ratio(base.routed_speed_up),
        sentences=len(verdicts),
        counted=counted_verdicts(verdicts),
    )


# Columns of rows with a note on their iterations.
SYSTEMS: Columns = {
    'system': lambda x: edition_title(x[0].system, x[0].edition) + x[1],
    'processors': lambda x: machine_of(x[0].system),
    'mult': lambda x: _mult(x[0].steps),
    'of these div': lambda x: x[0].steps.divisions,
    'add': lambda x: x[0].steps.additions,
    'sqrt': lambda x: x[0].steps.square_roots,
    'routes': lambda x: x[0].steps.routes,
    'one lane per link: mult': lambda x: _parallel(x[0], _mult(x[0].unpacked)),
    'add ': lambda x: _parallel(x[0], x[0].unpacked.additions),
    'routes ': lambda x: _parallel(x[0], x[0].unpacked.routes),
    'busy': lambda x: f'{x[0].busy:.0%}',
    'speed-up, arithmetic alone / with routes': lambda x: _speed_up(x[0]),
    'over published counts': lambda x: _ratio(x[0].published_speed_up),
    'over one processor': lambda x: _ratio(x[0].own_speed_up),
    'efficiency, alone / with routes': lambda x: _efficiency(x[0]),
    'of the same algorithm': lambda x: f'{x[0].own_efficiency:.0%}',
}


def _noted(row: Row, iterations: Sequence[Convergence]) -> list[tuple[Row, str]]:
    """Return a row; an iterative method also with the iterations to converge, each noted."""
    if row.iterations is None:
        return [(row, '')]
    if row.edition != BEST_KNOWN:
        return [(row, f', {row.iterations} iterations')]
    fewest, most = _range(iterations, row)
    return [
        (counts_of(row.system, row.n, count), f', {count} iterations ({note})')
        for count, note in (
            (row.iterations, 'not converged'),
            (fewest, 'the fewest to converge'),
            (most, 'the most to converge'),
        )
    ]


def _of_row(row: Row, iterations: Sequence[Convergence]) -> list[Convergence]:
    return [one for one in iterations if (one.system, one.n) == (row.system, row.n)]


def _range(iterations: Sequence[Convergence], row: Row) -> tuple[int, int]:
    """Return the fewest and the most iterations to converge of all robots with these joints."""
    found = _of_row(row, iterations)
    return min(one.least for one in found), max(one.most for one in found)


def _parallel(row: Row, count: int) -> str:
    return '-' if row.units == 1 else str(count)


def _speed_up(row: Row) -> str:
    if row.speed_up is None:
        return '-'
    return f'{row.speed_up:.2f} / {row.routed_speed_up:.2f}'


def _ratio(value: float | None) -> str:
    return '-' if value is None else f'{value:.2f}'


def _efficiency(row: Row) -> str:
    if row.efficiency is None:
        return '-'
    return f'{row.efficiency:.0%} / {row.routed_efficiency:.0%}'


# Columns of (rows by system and edition, row of the best known, kind of operation, iterations).
CLAIMS: Columns = {
    'system': lambda x: x[1].title,
    'operation': lambda x: x[2],
    'formula': lambda x: _number(x[1].cells[x[2]].claimed),
    'printed': lambda x: _number(x[1].cells[x[2]].printed),
    'sum of its parts': lambda x: _number(x[1].cells[x[2]].parts),
    'as printed': lambda x: _of(x, AS_PRINTED, lambda cell: cell.measured),
    'one lane per link': lambda x: _of(x, AS_PRINTED, lambda cell: cell.unpacked),
    'corrected': lambda x: _of(x, CORRECTED, lambda cell: cell.measured),
    'one lane per link ': lambda x: _of(x, CORRECTED, lambda cell: cell.unpacked),
    'best known': lambda x: x[1].cells[x[2]].measured,
    'one lane per link  ': lambda x: _number(x[1].cells[x[2]].unpacked),
    'as printed is': lambda x: _of(x, AS_PRINTED, lambda cell: cell.comparison),
    'remark': lambda x: _remark(*x[1:]),
}


def _of(
    x: tuple[Mapping[tuple[str, str], Row], Row, str, Any],
    edition: str,
    cell: Callable[[Cell], object],
) -> object:
    """Return a cell of an edition, or a dash where a system does not have it."""
    editions, row, kind, _ = x
    found = editions.get((row.system, edition))
    return '-' if found is None else cell(found.cells[kind])


# Columns of a CountedPart.
PARTS: Columns = {
    'system': lambda x: TABLE[x.part.system].title,
    'item': 'part.item',
    'what': 'part.text',
    'count': lambda x: 'derived' if x.part.derived else 'decomposed from the total',
    'paper: mult': lambda x: _formula(x, KINDS[0]),
    'add': lambda x: _formula(x, KINDS[1]),
    'as printed: mult': lambda x: _mult(x.as_printed),
    'add ': 'as_printed.additions',
    'one lane per link: mult': lambda x: _mult(x.unpacked),
    'add  ': 'unpacked.additions',
    'corrected: mult': lambda x: _mult(x.corrected),
    'add   ': 'corrected.additions',
    'as printed is': lambda x: _difference(x),
    'remark': 'part.remark',
}


def _formula(x: CountedPart, kind: str) -> str:
    formula, claimed = getattr(x.part, kind), str(_claimed(x, kind))
    return claimed if formula == claimed else f'{formula} = {claimed}'


def _claimed(x: CountedPart, kind: str) -> int:
    return int(value(getattr(x.part, kind), PRINTED_AT))


def _mult(steps: Steps) -> int:
    return steps.multiplications + steps.divisions


def _difference(x: CountedPart) -> str:
    more = (
        _mult(x.as_printed) - _claimed(x, KINDS[0]),
        x.as_printed.additions - _claimed(x, KINDS[1]),
    )
    return f'{more[0]:+d} / {more[1]:+d}' if any(more) else 'equal'


def _remark(row: Row, kind: str, iterations: Sequence[Convergence]) -> str:
    """Return the remark of a claim, with the price of convergence for an iterative method."""
    remark = row.cells[kind].remark
    if row.iterations is None or kind == 'square_roots':
        return remark
    worst = max(one.worst_after_n for one in _of_row(row, iterations))
    few, many = _range(iterations, row)
    cost = [counts_of(row.system, row.n, k).cells[kind].measured for k in (few, many)]
    price = (
        f'all for {row.n} iterations, which leave errors of up to {worst:.0e}; {few} to {many} '
        f'iterations converge and take {cost[0]} to {cost[1]} (best known)'
    )
    return '; '.join(filter(None, (remark, price)))


def _number(value: float | None) -> str:
    if value is None:
        return '-'
    return f'{value:.0f}' if value == int(value) else f'{value:.1f}'


CONVERGENCE: Columns = {
    'system': 'system',
    'robot': 'robot',
    'n': 'n',
    'iterations: fewest': 'least',
    'median': 'median',
    'most': 'most',
    'mult': lambda one: _cost(one, lambda row: row.cells[KINDS[0]].measured),
    'add': lambda one: _cost(one, lambda row: row.cells[KINDS[1]].measured),
    'routes': lambda one: _cost(one, lambda row: row.steps.routes),
    'error after n iterations: median': lambda one: f'{one.error_after_n:.0e}',
    'largest': lambda one: f'{one.worst_after_n:.0e}',
    'at the end: largest': lambda one: f'{one.worst_converged:.0e}',
}


def _cost(found: Convergence, count: Callable[[Row], int]) -> str:
    few, many = (count(counts_of(found.system, found.n, k)) for k in (found.least, found.most))
    return str(few) if few == many else f'{few} to {many}'


def _over_n(rows: Sequence[Row], cell: Callable[[Row], str]) -> list[str]:
    return grid({(_title(row), row.n): cell(row) for row in rows}, 'system')


def _title(row: Row) -> str:
    iterations = ', n iterations' if row.iterations else ''
    return edition_title(row.system, row.edition) + iterations


def _measured_and_claimed(kind: str, row: Row) -> str:
    cell = row.cells[kind]
    return f'{cell.measured}' + ('' if cell.claimed is None else f' / {_number(cell.claimed)}')


def run(folder: Path, quick: bool = False) -> list[Path]:
    """
    Measure every method and write all pages into a folder; quick is one size only.

    Progress goes to a terminal.
    """
    sizes: Sequence[int] = (PRINTED_AT,) if quick else SIZES
    machines = [one for one in MACHINES if not quick or one[0] == PRINTED_AT]
    count_all(sizes, machines)
    rows, fewer = list(measure(sizes)), list(measure_on_processors(machines))
    chains = list(robots((PRINTED_AT,), ()) if quick else robots())
    found = each(measure_convergence, chains, 'counting iterations', lambda robot: robot.n)
    iterations = [one for some in found for one in some]
    pages = [*write(rows, iterations, folder), *write_processors(fewer, folder)]
    sizes = (PRINTED_AT,) if quick else NETWORK_SIZES
    return [*pages, *run_networks(median_iterations(iterations), folder, sizes)]


def write(rows: Sequence[Row], iterations: Sequence[Convergence], folder: Path) -> list[Path]:
    """Write counts.md, .json and .png, the array at work, array.svg, and errata.md."""
    data = {
        'counts': rows,
        'parts': list(counted_parts(PRINTED_AT)),
        'convergence': iterations,
    }
    pages = write_page(folder, 'counts', markdown(rows, iterations), data)
    pages += [write_text(folder, 'array.svg', solve_picture(PRINTED_AT)), write_errata(folder)]
    return [*pages, *save(partial(_draw, rows), folder, 'counts', (12, 6.5), ['png'])]


def _draw(rows: Sequence[Row], figure: Any) -> None:
    """Draw multiplications and additions over n, formulas dashed, as printed dotted."""
    import matplotlib

    for axes, kind in zip(figure.subplots(1, 2), KINDS[:2], strict=True):
        for k, system in enumerate(dict.fromkeys(row.system for row in rows)):
            # Ten colours, then their light shades.
            color = matplotlib.colormaps['tab20'](2 * k % 20 + k // 10)
            best, printed = (
                [row for row in rows if (row.system, row.edition) == (system, edition)]
                for edition in (BEST_KNOWN, AS_PRINTED)
            )
            n, cells = [row.n for row in best], [row.cells[kind] for row in best]
            measured = [cell.measured for cell in cells]
            axes.loglog(n, measured, color=color, marker='.', ms=4, label=_title(best[0]))
            if cells[0].claimed is not None:
                claimed = [cell.claimed for cell in cells]
                axes.loglog(n, claimed, color=color, linestyle='--', lw=0.8)
            if printed:
                counts = [row.cells[kind].measured for row in printed]
                axes.loglog(n, counts, color=color, linestyle=':')
        over_joints(axes, [2**k for k in range(1, 7)])
        axes.set_ylabel('steps')
        axes.set_title(f'{kind}, no routes: counted, as printed (dotted), Table 1 (dashed)')
    entries = figure.axes[0].get_legend_handles_labels()
    figure.legend(*entries, loc='outside lower center', ncols=3, fontsize=8, frameon=False)


def solve_picture(n: int) -> str:
    """Return the SVG of a whole solve of n equations by the triangular array."""
    # The actions do not depend on the numbers of a positive definite matrix.
    H = [[n + 1.0 if i == j else 1.0 for j in range(n)] for i in range(n)]
    trace = solve(H, [1.0] * n).trace
    title = (
        f'Triangular array, n = {n}: factorisation and both substitutions, {trace.cycles} cycles'
    )
    return runs_svg({'': (trace, None)}, title)
