# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of fewer processors than joints: processors.md, its tables, and the plot."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pfd_core.algorithms.emulation import arithmetic
from pfd_core.machine.program import Steps
from pfd_core.report.measure.counts import (
    BEST_KNOWN,
    Row,
    best_serial,
    edition_title,
    title_of,
)
from pfd_core.report.render.markdown import grid, page
from pfd_core.report.render.markdown import write as write_page
from pfd_core.report.render.plots import save


def markdown(rows: Sequence[Row], best: Mapping[int, tuple[str, int]]) -> str:
    """Return the whole page; `best` has the best serial method and its arithmetic for each n."""
    return page('processors', sections='\n'.join(_section(rows, n, *best[n]) for n in best))


def _section(rows: Sequence[Row], n: int, best: str, least: int) -> str:
    of_n = [row for row in rows if row.n == n]
    direct = [row for row in of_n if row.speed_up is not None]
    return page(
        'processors-n',
        n=n,
        best=title_of(best),
        arithmetic=least,
        steps=_grid(of_n, lambda x: f'{_sum(x.steps)} / {_sum(x.unpacked)}'),
        own=_grid(of_n, lambda x: f'{x.own_speed_up:.2f} / {x.routed_own_speed_up:.2f}'),
        own_efficiency=_grid(
            of_n, lambda x: f'{x.own_efficiency:.1%} / {x.routed_own_efficiency:.1%}'
        ),
        best_speed_up=_grid(direct, lambda x: f'{x.speed_up:.2f} / {x.routed_speed_up:.2f}'),
        efficiency=_grid(direct, lambda x: f'{x.efficiency:.1%} / {x.routed_efficiency:.1%}'),
    )


def _grid(rows: Sequence[Row], cell: Callable[[Row], str]) -> list[str]:
    return grid(
        {
            (edition_title(row.system, row.edition), f'p = {row.processors}'): cell(row)
            for row in rows
        },
        'system',
    )


def _sum(steps: Steps) -> str:
    return f'{arithmetic(steps)} + {steps.routes}'


def write(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write processors.md and .json and, with matplotlib, processors.png into a folder."""
    best = {n: best_serial(n) for n in dict.fromkeys(row.n for row in rows)}
    data = {'best_serial': best, 'processors': rows}
    paths = write_page(folder, 'processors', markdown(rows, best), data)
    return [*paths, *save(partial(_draw, rows), folder, 'processors', (12, 13), ['png'])]


# Rows of panels: the field, the same with routes, and the title.
PANELS = (
    ('own_speed_up', 'routed_own_speed_up', 'speed-up over the same algorithm'),
    ('speed_up', 'routed_speed_up', 'speed-up over the best serial algorithm'),
    ('own_efficiency', 'routed_own_efficiency', 'efficiency, the same algorithm'),
    ('efficiency', 'routed_efficiency', 'efficiency, the best serial algorithm'),
)


def _draw(rows: Sequence[Row], figure: Any) -> None:
    """Draw speed-ups and efficiencies over p, best known, a column of panels for each n."""
    # The cells of the array are processors that no p has.
    drawn = [row for row in rows if row.edition == BEST_KNOWN and row.units == row.processors]
    systems = list(dict.fromkeys(row.system for row in drawn))
    sizes = list(dict.fromkeys(row.n for row in drawn))
    panels = figure.subplots(len(PANELS), len(sizes), squeeze=False)
    for (field, routed, title), line in zip(PANELS, panels, strict=True):
        for n, axes in zip(sizes, line, strict=True):
            for k, system in enumerate(systems):
                found = [row for row in drawn if (row.system, row.n) == (system, n)]
                if getattr(found[0], field) is not None:
                    _lines(axes, found, field, f'C{k}', '-', found[0].title)
                    _lines(axes, found, routed, f'C{k}', '--', None)
            p = [row.processors for row in drawn if (row.system, row.n) == (systems[0], n)]
            axes.set_xscale('log')
            if 'speed_up' in field:
                axes.set_yscale('log')
                axes.plot(p, p, color='black', lw=0.8, label='efficiency 100 %')
                axes.set_yticks([0.1, 0.5, *p], ['0.1', '0.5', *map(str, p)])
            else:
                axes.set_ylim(0, 1.02)
            axes.set_xticks(p, list(map(str, p)))
            axes.minorticks_off()
            axes.grid(alpha=0.25)
            axes.set_xlabel('processors p')
            axes.set_title(f'n = {n}: {title}', fontsize=10)
    panels[0, 0].legend(fontsize=7, title='with routes dashed', title_fontsize=7)


def _lines(
    axes: Any,
    rows: Sequence[Row],
    field: str,
    color: str,
    style: str,
    label: str | None,
) -> None:
    processors, values = [row.processors for row in rows], [getattr(row, field) for row in rows]
    axes.plot(processors, values, style, color=color, marker='.', label=label)
