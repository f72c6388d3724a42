# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Time of an evaluation of forward dynamics over its error, at ordinary and hard cases.

A point is the default kernel of ours in a number format, with or without a step of refinement, or
a way of another library: seconds for each state of a call or a batch, and the largest error over
the states of the case. Cases, references of 50 digits and condition numbers are those of the hard
cases. At one case and batch size all ways take turns in one process. A batch repeats the states of
the case. Loops in Python are left out, and so is a way that warns of its result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.hard_cases import CASES, ROUNDING, Case
from benchmarks.cases.problems import Problem
from benchmarks.cases.robots import Array
from benchmarks.peers import casadi, mujoco, pinocchio, pinocchio_cpp, vector_casadi
from benchmarks.peers.work import LeftOutError, Peer, Side, Work, valid_sides
from benchmarks.plots import (
    BLACK,
    CASADI,
    GREEN,
    GREY,
    KERNELS,
    MUJOCO,
    PINOCCHIO,
    logarithmic,
    mark,
)
from benchmarks.references.accelerations import Reference, errors, kappa_s, reference
from benchmarks.run import each, show_progress
from benchmarks.table import Cells, bullets, grid, order, page, short
from benchmarks.timing import Pace, interleave
from pfd_core.kernels.compile import compile_kernel
from pfd_core.model import Robot

BATCH = 4096
OURS = 'pfd default'
# Other libraries, with the colour and the markers of their ways in the plot.
PEERS: Mapping[str, tuple[Callable[[Robot], Peer], str, str]] = {
    'Pinocchio': (pinocchio.Pinocchio, GREEN, 'PX'),
    'Pinocchio C++': (pinocchio_cpp.PinocchioCpp, PINOCCHIO, 'xsD+'),
    'CasADi C': (casadi.Casadi, CASADI, '*p'),
    'CasADi C composite': (partial(casadi.Casadi, method=casadi.COMPOSITE), CASADI, 'HP'),
    'CasADi C, vectors': (vector_casadi.VectorCasadi, '#8C510A', 'h'),
    'MuJoCo': (mujoco.Mujoco, MUJOCO, 'v'),
}
PANELS = 4
# Errors below this many kappa_s u are drawn here.
LEAST = 1e-2


@dataclass(frozen=True)
class Plan:
    """Names of hard cases, batch sizes and pace."""

    cases: Sequence[str] = (
        'ordinary_puma560',
        'ordinary_ur5',
        'ordinary_panda',
        'payload_1e6',
        'heavy_tip_1e8_n12',
        'near_stretched_40',
        'collinear_axes_1e-12',
    )
    batch: int = BATCH
    # Shorter chunks and more turns than elsewhere: ratios of a few percent matter here.
    pace: Pace = field(default_factory=lambda: Pace(chunk=1e-3, turns=100, fewest=10, budget=8.0))


QUICK = Plan(
    cases=('ordinary_planar2', 'collinear_axes_1e-12'),
    batch=128,
    pace=Pace(chunk=1e-4, turns=3, fewest=2),
)


def measure(quick: bool) -> dict[str, Any]:
    """
    Return cases, points and what is missing.

    A point is {case, way, library, dtype, refine, batch, minimum and median [s a state], times
    (time of our default in float64 over this time), error, in_units (error / (kappa_s u))}.
    """
    plan = QUICK if quick else Plan()
    cases = [case for name in plan.cases for case in CASES if case.name == name]
    for _ in each(_compile, [(case, key) for case in cases for key in KERNELS], 'compiling'):
        pass
    rows, points, missing = [], list[dict[str, Any]](), list[str]()
    for case in cases:
        show_progress(f'{case.name}: reference')
        problem = case.make()
        known = reference(problem)
        condition = kappa_s(problem, known)
        rows.append(
            {
                'name': case.name,
                'cause': case.cause,
                'n': problem.plant.robot.n,
                'states': len(condition),
                'kappa_s': float(condition.max()),
            }
        )
        for batch in (1, plan.batch):
            show_progress(f'{case.name}: {batch} states in a call')
            ways = list(_ways(problem, known, condition, batch, missing))
            sides = [side for _, side, _ in ways]
            found = interleave(sides, batch, plan.pace)
            for (row, _, _), times in zip(ways, found, strict=True):
                points.append({'case': case.name, 'batch': batch} | row | vars(times))
    return {'cases': rows, 'points': points, 'missing': list(dict.fromkeys(missing))}


def _compile(given: tuple[Case, tuple[str, int]]) -> None:
    """Compile a kernel of a case; the disk cache keeps it."""
    case, (dtype, refine) = given
    problem = case.make()
    kernel = compile_kernel(problem.plant.robot, dtype=dtype, refine=refine)
    kernel(*problem.states.values())


def _ways(
    problem: Problem, known: Reference, condition: Array, batch: int, missing: list[str]
) -> Iterator[tuple[dict[str, Any], Side, object]]:
    """Yield rows without times, what to time, and the owner of its native memory."""
    robot, count = problem.plant.robot, len(condition)
    states = [np.ascontiguousarray(x) for x in problem.states.values()]

    def row(way: str, library: str, answers: Array, dtype: str, refine: int) -> dict[str, Any]:
        off = errors(answers, known)
        sound = bool(np.isfinite(off).all())
        return {
            'way': way,
            'library': library,
            'dtype': dtype,
            'refine': refine,
            'error': float(off.max()) if sound else None,
            'in_units': float((off / condition).max() / ROUNDING[dtype]) if sound else None,
        }

    for dtype, refine in KERNELS:
        kernel = compile_kernel(robot, dtype=dtype, refine=refine)
        answers = kernel(*states)
        run = _bound(kernel, [np.resize(x, (batch, robot.n)) for x in states])
        reference = (dtype, refine) == ('float64', 0)
        side = Side(OURS, run, partial(np.asarray, answers), reference=reference)
        yield row(OURS, 'pfd', answers, dtype, refine), side, kernel
    for library, (make, _, _) in PEERS.items():
        try:
            peer = make(robot)
            reasons = dict[str, str]()
            works = _works(states, batch, count)
            found = [valid_sides([peer], work, reasons) for work in works]
        except LeftOutError as reason:
            missing.append(f'{library}: {reason}')
            continue
        except (ValueError, RuntimeError) as reason:
            missing.append(f'{library} refuses {robot.name}: {reason}')
            continue
        missing += [f'{way} at {robot.name}: {reason}' for way, reason in reasons.items()]
        for side in found[0]:
            if side.way.startswith(pinocchio.LOOP) or side.way.endswith('threads'):
                continue
            same = [s for sides in found for s in sides if s.way == side.way]
            if batch == 1:
                answers = np.array([np.ravel(s.result()) for s in same])
            else:
                answers = np.asarray(side.result())[:count]
            if len(answers) == count:
                refine = int('refined' in side.way)
                timed = replace(side, reference=False)
                yield row(side.way, library, answers, 'float64', refine), timed, peer


def _works(states: Sequence[Array], batch: int, count: int) -> list[Work]:
    """Return the works that answer all states: one batch, or a call for each state."""
    if batch > 1:
        q, qd, tau = (np.resize(x, (batch, x.shape[1])) for x in states)
        return [Work('batch', (q, qd, tau))]
    return [Work('call', tuple(x[k].copy() for x in states)) for k in range(count)]


def _bound(kernel: Any, states: Sequence[NDArray[Any]]) -> Callable[[], object]:
    """Return the call of a kernel that is bound to one state, or to a batch in Fortran order."""
    q, qd, tau = (np.asfortranarray(x).astype(kernel.dtype) for x in states)
    if len(q) == 1:
        q, qd, tau = q[0], qd[0], tau[0]
    bound: Callable[[], object] = kernel.bind(q, qd, tau, np.empty_like(q))
    return bound


def text(data: Mapping[str, Any]) -> str:
    """Return the section of the page."""
    sizes = sorted({point['batch'] for point in data['points']})
    one, many = (_grid(data, size) for size in (1, sizes[-1]))
    return page(
        'error-evaluations',
        many=sizes[-1],
        batch=many,
        call=one,
        causes=bullets((f'{case["name"]}: {case["cause"]}' for case in data['cases']), ''),
        missing=bullets(data['missing'], 'Nothing.'),
    )


def _grid(data: Mapping[str, Any], size: int) -> list[str]:
    """Return a row for each case, a column for each way: time, error and units of kappa_s u."""
    cells: Cells = {}
    for case in data['cases']:
        name = f'{case["name"]}, n = {case["n"]}'
        cells[name, 'kappa_s'] = f'{case["kappa_s"]:.1e}'
        for point in data['points']:
            if (point['case'], point['batch']) == (case['name'], size):
                units = '' if point['in_units'] is None else f' ({short(point["in_units"])})'
                time = short(point['minimum'] * 1e9)
                cells[name, _title(point)] = f'{time}, {order(point["error"])}{units}'
    return grid(cells, 'case')


def _title(point: Mapping[str, Any]) -> str:
    if point['library'] != 'pfd':
        return str(point['way'])
    return f'pfd {point["dtype"]}{", refined" * point["refine"]}'


def draw(data: Mapping[str, Any], figure: Any) -> None:
    """Draw a panel for each case: time of a state of the batch over the error."""
    cases, most = data['cases'], max(point['batch'] for point in data['points'])
    points = [point for point in data['points'] if point['batch'] == most]
    rows = -(-(len(cases) + 1) // PANELS)
    panels = figure.subplots(rows, PANELS, squeeze=False, sharex=True, sharey=True)
    styles = _styles(points)
    for axes, case in zip(panels.flat, cases, strict=False):
        _draw_case(axes, case, [p for p in points if p['case'] == case['name']], styles)
    for axes in panels.flat[len(cases) :]:
        axes.axis('off')
    figure.supxlabel('relative error of the acceleration / ($\\kappa_s u$),  u = $2^{-53}$')
    figure.supylabel('time of one evaluation [ns]')
    figure.suptitle(
        f'Forward dynamics: time against error, {most} states in a call, one thread. '
        'Down and left is better.'
    )
    entries = [mark(*style, title, markersize=8) for title, style in styles.items()]
    panels.flat[len(cases)].legend(handles=entries, loc='center', fontsize=9, frameon=False)


def _styles(points: Sequence[Mapping[str, Any]]) -> dict[str, tuple[str, str]]:
    """Return colour and marker of each way."""
    found: dict[str, tuple[str, str]] = {}
    for point in points:
        title = _title(point)
        if point['library'] == 'pfd':
            found[title] = KERNELS[point['dtype'], point['refine']]
        elif title not in found:
            _, colour, markers = PEERS[point['library']]
            used = [marker for own, marker in found.values() if own == colour]
            found[title] = colour, next(m for m in markers + 'o^<>' if m not in used)
    return found


def _draw_case(
    axes: Any,
    case: Mapping[str, Any],
    points: Sequence[Mapping[str, Any]],
    styles: Mapping[str, tuple[str, str]],
) -> None:
    """Draw the points of a case; a line leads from our answers to the refined ones."""
    axes.set_title(f'{case["name"]} (n = {case["n"]})', fontsize=10)
    logarithmic(axes)
    unit = ROUNDING['float64']
    for dtype, u in ROUNDING.items():
        axes.axvline(u / unit, color=GREY, linewidth=0.8, linestyle=':')
        axes.text(
            u / unit, 0.99, f' {dtype}', transform=axes.get_xaxis_transform(), fontsize=7,
            color=GREY, va='top',
        )  # fmt: skip
    ends: dict[str, list[tuple[float, float]]] = {}
    for point in points:
        if point['in_units'] is None:
            continue
        error = max(point['in_units'] * ROUNDING[point['dtype']] / unit, LEAST)
        place = error, point['minimum'] * 1e9
        colour, marker = styles[_title(point)]
        axes.plot(*place, marker, color=colour, markersize=8, zorder=3)
        if point['library'] == 'pfd':
            ends.setdefault(point['dtype'], []).append(place)
    for line in ends.values():
        axes.plot(*zip(*line, strict=True), color=BLACK, linewidth=0.9, zorder=2)
