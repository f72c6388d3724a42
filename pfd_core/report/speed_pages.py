# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of the speed: the page speed.md, table by table, JSON and a plot over n."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import cycle
from pathlib import Path
import re
from typing import Any

from pfd_core.report import headlines
from pfd_core.report.contenders.ours import METHODS
from pfd_core.report.measure import decomposition, port_limit
from pfd_core.report.measure.first_results import FROM_DISK, PROCESS, WORKS
from pfd_core.report.measure.speed import QUICK, Findings, Survey, survey
from pfd_core.report.measure.surroundings import described
from pfd_core.report.measure.timing import Row
from pfd_core.report.render.markdown import Cells, bullets, grid, page
from pfd_core.report.render.markdown import write as write_page
from pfd_core.report.render.numbers import least_and_median
from pfd_core.report.render.plots import (
    CASADI,
    FLOAT32,
    FLOAT64,
    MUJOCO,
    PINOCCHIO,
    over_joints,
    save,
)
from pfd_core.report.time_tables import (
    NOTES,
    batch_name,
    by_work,
    contents,
    difference_cell,
    factor,
    fastest,
    limits,
    over_robots,
    share_cell,
    summary,
    works,
)

COMMAND = 'pfd report speed'
SHARE = 'share of the arithmetic limit'
PREPARED = (*WORKS, *(work + FROM_DISK for work in WORKS), PROCESS)
# Ends of the names of ways that are not in the plot.
SLOWER = (': kernel(q, qd, tau)', 'out=)', ', C order', ' threads', 'WORLD', ' refined')
# Colours of the ways whose names contain these words.
COLOURS = {'pinocchio': PINOCCHIO, 'mujoco': MUJOCO, 'casadi': CASADI, 'float32': FLOAT32}


def markdown(findings: Findings) -> str:
    """Return the whole page."""
    rows = findings.rows
    known = dict(by_work(rows))
    milliseconds = partial(least_and_median, unit=1e3)
    others = page(
        'other-quantities', command=COMMAND, notes=NOTES, summary=summary(findings.others)
    )
    far = dict(by_work(_largest_differences(rows)))
    return page(
        'speed',
        command=COMMAND,
        machine=described(findings.machine),
        headline=headlines.headline(findings) or None,
        strongest=headlines.against_strongest([row for row in rows if row.work not in PREPARED]),
        summary=_summary(rows),
        decomposition=headlines.decomposed(rows),
        contents=contents([*rows, *findings.others]),
        works=works(rows, (*PREPARED, port_limit.WORK, decomposition.WORK)) or None,
        limits=limits(rows),
        process=PROCESS,
        first_results='\n\n'.join(
            '\n'.join(
                [
                    f'### {work.capitalize()}\n',
                    *over_robots(known[work], milliseconds),
                ]
            )
            for work in PREPARED
            if work in known
        ),
        others=others if findings.others else None,
        calls=over_robots(far.get('call', []), difference_cell),
        rollouts=over_robots(far.get('rollout', []), difference_cell),
        excluded=bullets(findings.left_out, 'Nothing.'),
    )


def _summary(rows: Sequence[Row]) -> str:
    """Return a table of our speed-up over Pinocchio's fastest way, robot by robot."""
    size = batch_name(rows)
    columns = {'call with out=': ('call', 'float64: kernel(..., out=)'), **headlines.columns(rows)}
    ratios: Cells = {}
    for robot in dict.fromkeys(row.robot for row in rows):
        own = [row for row in rows if row.robot == robot and row.way.startswith(tuple(METHODS))]
        for title, (work, ending) in columns.items():
            best = fastest(row for row in own if row.work == work and row.way.endswith(ending))
            ratios[robot, title] = '-' if best is None else _over_pinocchio(best, rows)
        ratios[robot, SHARE] = share_cell(headlines.limit_row(rows, robot))
    return page('speed-summary', batch=size, ratios=grid(ratios, 'robot'))


def _over_pinocchio(own: Row, rows: Sequence[Row]) -> str:
    same = (row for row in rows if (row.robot, row.work) == (own.robot, own.work))
    ways = (row for row in headlines.peers(same, any_robot=True) if 'inocchio' in row.way)
    peer = fastest(ways)
    return '-' if peer is None else f'{factor(own, peer):.1f}'


def _largest_differences(rows: Sequence[Row]) -> list[Row]:
    """Return the row of largest difference of each contender and robot, rollouts apart."""
    found: dict[tuple[str, str, str], Row] = {}
    for row in rows:
        if row.difference is not None:
            contender = re.split('[:,]', row.way)[0]
            work = 'rollout' if row.work == 'rollout' else 'call'
            before = found.setdefault((work, contender, row.robot), row)
            largest = max(row, before, key=lambda row: row.difference or 0.0)
            found[work, contender, row.robot] = replace(largest, way=contender, work=work)
    return list(found.values())


def run(folder: Path, quick: bool = False, plan: Survey | None = None) -> list[Path]:
    """Measure, write the report into a folder and return its files."""
    return write(survey(plan or (QUICK if quick else Survey())), folder)


def write(findings: Findings, folder: Path) -> list[Path]:
    """Write speed.md, speed.json and a plot, speed.png, and return their paths."""
    pages = write_page(folder, 'speed', markdown(findings), findings)
    return [*pages, *plot(findings.rows, folder, 'speed')]


def plot(rows: Sequence[Row], folder: Path, name: str) -> list[Path]:
    """Write the plot of the least time of a call and of a state in a batch over n."""
    return save(partial(_draw, rows), folder, name, (13, 6.5), ['png'])


def _draw(rows: Sequence[Row], figure: Any) -> None:
    for axes, work in zip(figure.subplots(1, 2), ('call', batch_name(rows)), strict=True):
        chains = [row for row in rows if row.work == work and row.robot.startswith('chain')]
        axes.set_title(f'chains of n joints: {work}')
        axes.set_ylabel('least time of a state [ns]')
        if chains:
            _draw_chains(axes, [row for row in chains if not row.way.endswith(SLOWER)])


def _draw_chains(axes: Any, rows: Sequence[Row]) -> None:
    """Draw the ways over n: a colour for each library and number format, a marker for each way."""
    markers: dict[str, Iterator[str]] = {}
    for way in dict.fromkeys(row.way for row in rows):
        own = [row for row in rows if row.way == way]
        found = (colour for word, colour in COLOURS.items() if word in way.lower())
        colour = next(found, FLOAT64)
        axes.loglog(
            [row.n for row in own],
            [row.minimum * 1e9 for row in own],
            color=colour,
            marker=next(markers.setdefault(colour, cycle('os^Dv'))),
            label=way,
        )
    over_joints(axes, sorted({row.n for row in rows}))
    axes.legend(
        fontsize=7, handlelength=3, loc='upper center', bbox_to_anchor=(0.5, -0.1), ncols=2
    )
