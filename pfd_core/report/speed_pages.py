# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of the speed: the page speed.md, table by table, JSON and a plot over n."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
import re
from typing import Any

from pfd_core.report import port_limit
from pfd_core.report.first_results import FROM_DISK, PROCESS, WORKS
from pfd_core.report.markdown import cells, header, json_text
from pfd_core.report.quantity_tables import NOTES, PORT_LIMIT_NOTE, summary
from pfd_core.report.speed import QUICK, Findings, Survey, survey
from pfd_core.report.speed_ours import METHODS
from pfd_core.report.speed_tables import (
    batch_name,
    difference_cell,
    grid,
    limit_cell,
    milliseconds_cell,
    time_cell,
)
from pfd_core.report.surroundings import told
from pfd_core.report.timing import MIDDLE_BATCH, Row

COMMAND = 'pfd report speed'
SHARE = 'share of the port limit'
# Ends of the names of ways that are not the fastest of their kind, and not in the plot.
SLOWER = (': kernel(q, qd, tau)', 'out=)', ', C order', ' threads')
INTRODUCTION = f"""# Speed compared with peers

Written by `{COMMAND}`, starting with forward dynamics; the numbers are from one machine on one
day.

{{machine}}.

All implementations of one task are interleaved in one process, in chunks of a few milliseconds. A
cell has minimum / median of the time per state, or per step of a rollout, and in brackets the
speed-up over the first row: the median ratio of two interleaved times. A chunk begins with an
uncounted call for warm caches, unless one call takes longer than a chunk. All run on one thread
unless the row states otherwise.

- Sine and cosine and the Python overhead of a call are included everywhere. *bound* is
  `kernel.bind(q, qd, tau, out)`. MuJoCo's state is set before `mj_forward`, and CasADi's before
  `buffer()`.
- A rollout is the classical Runge-Kutta method with constant torques, four evaluations a step. It
  returns the state after each step; ours computes accelerations only when they are read.
- MuJoCo has contacts and constraints switched off. Its batch is `mujoco.rollout` over one step.
- *CasADi C* is the articulated-body algorithm of Featherstone's textbook (2008, table 7.1) written
  with casadi.SX, and its generated C compiled with `cc -O3 -march=native`.
- *chainN* has N equal rods, each axis at right angles to the previous one; *dense6* has six joints
  with skew axes and no zero parameter. All sides use the same numbers.
- Method names are ours, with the number format; the peers compute in float64. Ours and CasADi's
  code is compiled for one robot on this processor; "Until the first result" has the time of
  compilation. The wheels of Pinocchio and MuJoCo take any robot. Not every method is compiled for
  long chains.
"""

PORT_LIMIT = f"""\
A loop with the kernel's mix of operations, independent and in registers: minimum / median of its
time per state, and in brackets its time over that of the kernel in a batch of {MIDDLE_BATCH}
states in Fortran order (where that is measured, else the nearest), the median over turns of both.
This is the share of the processor's arithmetic limit that the kernel reaches. Loads and stores,
input checks and latencies keep it below 1; other processes disturb a kernel, which needs the
caches, more than a loop in registers. Loops that wait for instructions are excluded.
"""

OTHERS = f"""\
A short table: one number format, one call and one batch; for all implementations, robots and sizes
run `{COMMAND} --quantity NAME`. Minimum / median of the time per state, and the speed-up over
Pinocchio in Python and CasADi's C.

{NOTES}{PORT_LIMIT_NOTE}"""


def markdown(findings: Findings) -> str:
    """Return the whole page."""
    rows = findings.rows
    parts = [INTRODUCTION.format(machine=told(findings.machine)), _summary(rows)]
    prepared = [*WORKS, *(work + FROM_DISK for work in WORKS), PROCESS]
    shown_below = (*prepared, port_limit.WORK)
    for work in dict.fromkeys(row.work for row in rows if row.work not in shown_below):
        parts.append(f'## {work.capitalize()} [ns]\n')
        parts.append(grid([row for row in rows if row.work == work], time_cell))
    limits = [row for row in rows if row.work == port_limit.WORK]
    if limits:
        parts += ['## Share of the port limit [ns]\n', PORT_LIMIT, grid(limits, limit_cell)]
    parts.append('## Until the first result [ms]\n')
    parts.append(
        'Time from a robot in memory to the first result, and then to the first batch, without '
        f'and with the cache on disk. The {PROCESS} imports NumPy first.\n'
    )
    for work in prepared:
        found = [row for row in rows if row.work == work]
        if found:
            parts += [f'### {work.capitalize()}\n', grid(found, milliseconds_cell)]
    if findings.others:
        parts += ['## Other quantities\n', OTHERS, summary(findings.others)]
    far = _largest_differences(rows)
    parts.append('## Difference from `pinocchio.aba`\n')
    for work, what in (
        ('call', 'the accelerations of a state'),
        ('rollout', 'the positions after a rollout'),
    ):
        parts.append(f'Largest max|difference| / max|reference| of {what}.\n')
        parts.append(grid([row for row in far if row.work == work], difference_cell))
    parts.append('## Excluded\n')
    parts.append('\n'.join(f'- {text}' for text in findings.left_out) or 'Nothing.')
    return '\n'.join(parts).rstrip() + '\n'


def _summary(rows: Sequence[Row]) -> str:
    """Return a table of our best speed-up over Pinocchio, robot by robot."""
    size = batch_name(rows)
    ours = tuple(METHODS)
    columns: dict[str, Callable[[Row], bool]] = {
        'call with out=': lambda row: (
            row.work == 'call' and 'float64: kernel(..., out=)' in row.way
        ),
        'bound call': lambda row: row.work == 'call' and 'float64: bound' in row.way,
        'rollout': lambda row: row.work == 'rollout' and 'float64' in row.way,
        f'{size}, F order': lambda row: row.work == size and row.way.endswith('float64, F order'),
        f'{size}, C order': lambda row: row.work == size and 'float64, C' in row.way,
        f'{size}, F order, float32': lambda row: row.work == size and 'float32, F' in row.way,
    }
    lines = [
        '## Our fastest method compared with Pinocchio\n',
        'Against `pinocchio.aba`, a Python loop over it, and `abaInParallel` on one thread, all '
        'in float64; the last but one column is our float32 kernel compared with it. The last '
        "column is the share of this processor's arithmetic limit that the fastest float64 kernel "
        f'in Fortran order reaches ({size}).\n',
        *header(' | '.join(['robot', *columns, SHARE])),
    ]
    for robot in dict.fromkeys(row.robot for row in rows):
        own = [row for row in rows if row.robot == robot and row.way.startswith(ours)]
        found = []
        for fits in columns.values():
            best = min(filter(fits, own), key=lambda row: row.minimum, default=None)
            found.append('-' if best is None or best.times is None else f'{best.times:.1f}')
        lines.append(cells(robot, *found, _share(own, size)))
    return '\n'.join([*lines, ''])


def _share(own: Sequence[Row], size: str) -> str:
    """Return the share of the port limit of the fastest kernel in float64."""
    suffix = ', F order'
    batches = [row for row in own if row.work == size and row.way.endswith(f'float64{suffix}')]
    best = min(batches, key=lambda row: row.minimum, default=None)
    name = None if best is None else best.way.removesuffix(suffix)
    found = [row for row in own if row.work == port_limit.WORK and row.way == name]
    return f'{found[0].times:.2f}' if found and found[0].times is not None else '-'


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


def run(folder: Path, quick: bool = False, plan: Survey | None = None) -> int:
    """Measure, write the report into a folder, print its files and return the exit status, 0."""
    findings = survey(plan or (QUICK if quick else Survey()))
    print('\n'.join(str(path) for path in write(findings, folder)))
    return 0


def write(findings: Findings, folder: Path) -> list[Path]:
    """
    Write speed.md, speed.json and a plot, speed.png, and return their paths.

    The plot is skipped if matplotlib (extra `report`) is not installed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    page, data, picture = (folder / f'speed.{suffix}' for suffix in ('md', 'json', 'png'))
    page.write_text(markdown(findings), encoding='utf-8')
    data.write_text(json_text(asdict(findings)), encoding='utf-8')
    return [page, data, *([picture] if plot(findings.rows, picture) else [])]


def plot(rows: Sequence[Row], path: Path) -> bool:
    """Draw the least time of a call and of a state in a batch over n; False without matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        return False
    figure = Figure(figsize=(13, 6.5), layout='constrained')
    FigureCanvasAgg(figure)
    for axes, work in zip(figure.subplots(1, 2), ('call', batch_name(rows)), strict=True):
        chains = [row for row in rows if row.work == work and row.robot.startswith('chain')]
        axes.set_title(f'chains of n joints: {work}, least time of a state [ns]')
        axes.set_xlabel('joints n')
        if chains:
            _draw(axes, [row for row in chains if not row.way.endswith(SLOWER)])
    figure.savefig(path, dpi=110)
    return True


def _draw(axes: Any, rows: Sequence[Row]) -> None:
    """Draw the ways over n: a colour for each method or peer, single precision dashed."""
    names = [row.way.replace(' float32', ' float64') for row in rows]
    colours = {name: f'C{k}' for k, name in enumerate(dict.fromkeys(names))}
    for way in dict.fromkeys(row.way for row in rows):
        own = [row for row in rows if row.way == way]
        axes.loglog(
            [row.n for row in own],
            [row.minimum * 1e9 for row in own],
            '--' if 'float32' in way else '-',
            color=colours[way.replace(' float32', ' float64')],
            marker='.',
            label=way,
        )
    ticks = sorted({row.n for row in rows})
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.minorticks_off()
    axes.grid(which='both', alpha=0.25)
    axes.legend(
        fontsize=7, handlelength=3, loc='upper center', bbox_to_anchor=(0.5, -0.1), ncols=2
    )
