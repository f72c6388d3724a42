# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of quantities other than forward dynamics, for all pages that have them."""

from __future__ import annotations

from collections.abc import Sequence

from pfd_core.report import port_limit
from pfd_core.report.markdown import cells, header
from pfd_core.report.quantity_kernels import LINEAR_STEP, QUANTITIES
from pfd_core.report.speed_tables import batch_name, error_cell, least_and_median, short
from pfd_core.report.timing import Row

# How to read the figures, and what each excludes.
NOTES = f"""\
- *bound* is `kernel.bind(q, ..., out=out)`, which excludes creating and converting arrays; batches
  are evaluated into an existing array, on one thread.
- Pinocchio's functions are called from Python, so its times include Python's overhead, which a C++
  program does not have. They exclude copying results out of Pinocchio's data and filling the lower
  triangle of symmetric matrices, which ours include. Its batches are loops in Python, except
  `rneaInParallel`.
- Its functions are `rnea`, `crba`, `nonLinearEffects`, `computeGeneralizedGravity`,
  `framesForwardKinematics`, `computeFrameJacobian` and `computeABADerivatives`. A linearised step
  is four calls of the last, multiplied with NumPy, which takes most of its time.
- *CasADi C* is textbook algorithms (recursive Newton-Euler, articulated bodies, products of
  transforms), differentiated by CasADi, with its C compiled by `cc -O3 -march=native`; one state
  is a call of `buffer()`, which excludes copying the arguments; it has no linearised step.
- *linear_step* is [A B] of a step of {LINEAR_STEP * 1e3:.3g} ms of classical Runge-Kutta;
  `simulator.linearize` checks its arguments, which *bound* does not.
"""
PORT_LIMIT_NOTE = """\
- The share of the port limit excludes loads and stores: d qdd / d(q, qd, tau) of six joints writes
  864 bytes a state. A linearised step has none, since it calls functions in a loop.
"""
ERRORS = """\
An error is max|difference| / max|entry| compared with 50 digits, the largest over {states} states
with float32 numbers. The robots' numbers are rounded to the number format, which is part of the
error in float32. *refined* computes derivatives at accelerations after one step of refinement,
which costs time and does not change other rounding errors.
"""


def summary(rows: Sequence[Row]) -> str:
    """Return, for each robot, a table of our times in float64 and their ratios to the peers'."""
    batch = batch_name(rows)
    titles = ['bound', 'times Pinocchio', 'times CasADi C']
    titles = [*titles, f'{batch}, F order', *titles[1:], 'share of the port limit']
    parts = []
    for robot in dict.fromkeys(row.robot for row in rows):
        parts += [f'### {robot}\n', *header(' | '.join(['quantity [ns]', *titles]))]
        for quantity in QUANTITIES:
            own = [row for row in rows if (row.robot, row.quantity) == (robot, quantity)]
            if own:
                single = _ratios(own, 'call', 'pfd float64: bound')
                many = _ratios(own, batch, 'pfd float64, F order')
                parts.append(cells(quantity, *single, *many, _share(own)))
        parts.append('')
    return '\n'.join(parts)


def _ratios(rows: Sequence[Row], work: str, way: str) -> list[str]:
    """Return minimum / median [ns] of a way, and its speed in times Pinocchio's and CasADi's."""
    known = {row.way: row for row in rows if row.work == work}
    if way not in known:
        return ['-'] * 3
    own = known[way]
    ratios = ['-' if own.times is None else short(own.times)]
    peer = next((row for name, row in known.items() if name.startswith('CasADi')), None)
    if peer is None:
        ratios.append('-')
    elif own.times is None or peer.times is None:
        ratios.append(short(peer.median / own.median))
    else:
        ratios.append(short(own.times / peer.times))
    return [least_and_median(own.minimum, own.median, 1e9), *ratios]


def _share(rows: Sequence[Row]) -> str:
    """Return the share of the port limit of the kernel in float64."""
    limit = next(
        (row for row in rows if (row.work, row.way) == (port_limit.WORK, 'pfd float64')), None
    )
    return '-' if limit is None or limit.times is None else f'{limit.times:.2f}'


def against_error(rows: Sequence[Row]) -> str:
    """Return, for each robot, a table of time and error of every way of every quantity."""
    batch = batch_name(rows)
    parts = []
    for robot in dict.fromkeys(row.robot for row in rows):
        titles = ['quantity', 'way', 'a state in a call [ns]', f'{batch} [ns]', 'error']
        parts += [f'### {robot}\n', *header(' | '.join(titles))]
        for quantity in QUANTITIES:
            own = [row for row in rows if (row.robot, row.quantity) == (robot, quantity)]
            for way in dict.fromkeys(contender(row) for row in own):
                parts.append(cells(quantity, way, *_time_and_error(own, way, batch)))
        parts.append('')
    return '\n'.join(parts)


def contender(row: Row) -> str:
    """Return the name of the program that a way belongs to."""
    name = row.way.removeprefix('Python loop over ')
    return name.split(', ')[0].split(': ')[0]


def least(rows: Sequence[Row], way: str, work: str) -> Row | None:
    """Return the fastest row of a contender at a work."""
    found = [row for row in rows if row.work == work and contender(row) == way]
    return min(found, key=lambda row: row.minimum, default=None)


def _time_and_error(rows: Sequence[Row], way: str, batch: str) -> list[str]:
    """Return the least times of a contender and its largest error."""
    found = [least(rows, way, work) for work in ('call', batch)]
    errors = [row.error for row in rows if contender(row) == way and row.error is not None]
    error = error_cell(max(errors)) if errors else '-'
    times = [
        '-' if row is None else least_and_median(row.minimum, row.median, 1e9) for row in found
    ]
    return [*times, error]
