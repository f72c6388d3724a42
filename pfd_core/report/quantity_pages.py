# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The reports of one quantity other than forward dynamics: pages, JSON and plots.

    pfd report speed --quantity NAME                    speed-NAME, all robots and sizes
    pfd report speed --against-error --quantity NAME    speed-against-error-NAME
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path

from pfd_core.report import port_limit, quantity_plot, quantity_rows, speed_pages
from pfd_core.report.markdown import json_text
from pfd_core.report.quantity_kernels import QUANTITIES
from pfd_core.report.quantity_rows import Plan
from pfd_core.report.quantity_tables import ERRORS, NOTES, PORT_LIMIT_NOTE, against_error, summary
from pfd_core.report.speed import ARMS, HASTY, SIZES, Findings
from pfd_core.report.speed_tables import difference_cell, grid, limit_cell, time_cell
from pfd_core.report.surroundings import surroundings, told
from pfd_core.report.timing import Row

SPEED = Plan(robots=(*ARMS, 'chain6', 'chain12', 'chain30'), batches=SIZES[1:])
AGAINST_ERROR = Plan(robots=(*ARMS, 'chain6', 'chain12'), references=8)
QUICK = Plan(robots=('ur5', 'chain3'), batches=(64,), pace=HASTY)

INTRODUCTION = """# {title}: {quantity}

Written by `{command}`; the numbers are those of one machine on one day.

{machine}.

Measured is {call}: {result}.
All ways of doing one work take turns in one process. A cell of time holds minimum / median per
state over the turns; a ratio, such as in brackets, is the median over the turns of the ratio of
two times taken shortly after each other, here to the time of Pinocchio in Python.

"""


def survey(plan: Plan) -> Findings:
    """Measure the quantities of a plan; progress goes to a terminal's stderr."""
    machine = surroundings()
    rows, left_out = quantity_rows.measure(plan)
    return Findings(rows, left_out, machine)


def markdown(findings: Findings, quantity: str, references: int = 0) -> str:
    """Return the page of a quantity; with errors at so many references, or without."""
    rows = findings.rows
    option = '--against-error ' * bool(references)
    page = INTRODUCTION.format(
        title='Speed against error' if references else 'Speed, against peers',
        command=f'{speed_pages.COMMAND} {option}--quantity {quantity}',
        machine=told(findings.machine),
        quantity=quantity,
        call=QUANTITIES[quantity].call or f"`compile_kernel(robot, quantity='{quantity}')`",
        result=QUANTITIES[quantity].title,
    )
    parts = [page + NOTES + PORT_LIMIT_NOTE, '## Beside the peers\n', summary(rows)]
    if references:
        parts += ['## Time and error\n', ERRORS.format(states=references), against_error(rows)]
    else:
        parts += _speed_tables(rows)
    parts += ['## Excluded\n', *([f'- {text}' for text in findings.left_out] or ['Nothing.'])]
    return '\n'.join(parts).rstrip() + '\n'


def _speed_tables(rows: list[Row]) -> Iterable[str]:
    """Yield tables of all ways over the robots, work by work."""
    for work in dict.fromkeys(row.work for row in rows if row.work != port_limit.WORK):
        yield f'## {work.capitalize()} [ns]\n'
        yield grid([row for row in rows if row.work == work], time_cell)
    limits = [row for row in rows if row.work == port_limit.WORK]
    if limits:
        yield from ('## Share of the port limit [ns]\n', speed_pages.PORT_LIMIT)
        yield grid(limits, limit_cell)
    calls = [row for row in rows if row.work == 'call' and row.difference is not None]
    yield '## Difference from Pinocchio\n\nmax|difference| / max|entry| of a state.\n'
    yield grid(calls, difference_cell)


def run(folder: Path, quantity: str, against_error: bool = False, quick: bool = False) -> int:
    """Measure, write the report into a folder, print its files and return the exit status, 0."""
    plan = AGAINST_ERROR if against_error else SPEED
    if quick:
        plan = replace(QUICK, references=min(2, plan.references))
    plan = replace(plan, quantities=(quantity,))
    findings = survey(plan)
    paths = write(findings, folder, quantity, plan.references)
    print('\n'.join(str(path) for path in paths))
    return 0


def write(findings: Findings, folder: Path, quantity: str, references: int = 0) -> list[Path]:
    """
    Write the page, its JSON and a plot, and return their paths.

    The plot is over n as PNG, or with references over errors as PNG and SVG; it is skipped where
    matplotlib (extra `report`) is not installed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    name = f'speed-{"against-error-" * bool(references)}{quantity}'
    page, data, picture = (folder / f'{name}.{suffix}' for suffix in ('md', 'json', 'png'))
    page.write_text(markdown(findings, quantity, references), encoding='utf-8')
    data.write_text(json_text(asdict(findings)), encoding='utf-8')
    if references:
        return [page, data, *quantity_plot.write(findings.rows, folder, name)]
    return [page, data, *([picture] if speed_pages.plot(findings.rows, picture) else [])]
