# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The reports of one quantity other than forward dynamics: pages, JSON and plots.

    pfd report speed --quantity NAME                    speed-NAME, all robots and sizes
    pfd report speed --against-error --quantity NAME    speed-against-error-NAME
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pfd_core.report import speed_pages
from pfd_core.report.cases.quantities import QUANTITIES
from pfd_core.report.measure import quantity_rows
from pfd_core.report.measure.quantity_rows import Plan
from pfd_core.report.measure.speed import ARMS, HASTY, SIZES, Findings
from pfd_core.report.measure.surroundings import described, surroundings
from pfd_core.report.measure.timing import Row
from pfd_core.report.render.markdown import bullets, page
from pfd_core.report.render.markdown import write as write_page
from pfd_core.report.time_tables import (
    NOTES,
    against_error,
    contents,
    difference_cell,
    limits,
    over_robots,
    plot_errors,
    summary,
    works,
)

SPEED = Plan(robots=(*ARMS, 'chain6', 'chain12', 'chain30'), batches=SIZES[1:])
AGAINST_ERROR = Plan(robots=(*ARMS, 'chain6', 'chain12'), references=8)
QUICK = Plan(robots=('ur5', 'chain3'), batches=(64,), pace=HASTY)


def survey(plan: Plan) -> Findings:
    """Measure the quantities of a plan; progress goes to a terminal's stderr."""
    machine = surroundings()
    rows, left_out = quantity_rows.measure(plan)
    return Findings(rows, left_out, machine)


def markdown(findings: Findings, quantity: str, references: int = 0) -> str:
    """Return the page of a quantity; with errors at so many references, or without."""
    rows, known = findings.rows, QUANTITIES[quantity]
    if references:
        tables = page('quantity-errors', states=references, errors=against_error(rows))
    else:
        tables = _speed_tables(rows)
    return page(
        'quantity',
        title='Speed against error' if references else 'Speed, against peers',
        command=f'pfd report speed {"--against-error " * bool(references)}--quantity {quantity}',
        machine=described(findings.machine),
        quantity=quantity,
        call=known.call or f"`compile_kernel(robot, quantity='{quantity}')`",
        result=known.title,
        notes=NOTES,
        summary=summary(rows),
        tables='\n\n'.join(filter(None, (tables.rstrip('\n'), contents(rows)))),
        excluded=bullets(findings.left_out, 'Nothing.'),
    )


def _speed_tables(rows: Sequence[Row]) -> str:
    calls = [row for row in rows if row.work == 'call' and row.difference is not None]
    difference = ['## Difference from Pinocchio\n', 'max|difference| / max|entry| of a state.\n']
    difference += over_robots(calls, difference_cell)
    found = (works(rows), (limits(rows) or '').rstrip('\n'), '\n'.join(difference))
    return '\n\n'.join(filter(None, found))


def run(
    folder: Path, quantity: str, against_error: bool = False, quick: bool = False
) -> list[Path]:
    """Measure, write the report into a folder and return its files."""
    plan = AGAINST_ERROR if against_error else SPEED
    if quick:
        plan = replace(QUICK, references=min(2, plan.references))
    plan = replace(plan, quantities=(quantity,))
    return write(survey(plan), folder, quantity, plan.references)


def write(findings: Findings, folder: Path, quantity: str, references: int = 0) -> list[Path]:
    """
    Write the page, its JSON and a plot, and return their paths.

    The plot is over n as PNG, or with references over errors as PNG and SVG.
    """
    name = f'speed-{"against-error-" * bool(references)}{quantity}'
    pages = write_page(folder, name, markdown(findings, quantity, references), findings)
    plot = plot_errors if references else speed_pages.plot
    return [*pages, *plot(findings.rows, folder, name)]
