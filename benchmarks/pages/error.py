# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Speed against error: an arm under a controller, and integrators of free motions.

    error   largest |q - reference| of a joint at the end of the motion [rad or m]
    time    processor time of the thread for each simulated second: controller, steps and loop. The
            time of an ensemble is divided by its arms. On an idle core it equals the wall time

The reference is the adaptive integrator with events of friction, restarted in each period, at its
tightest tolerance, refined. Two differences show its error: from itself with another algorithm of
forward dynamics and shorter steps, and from rk4 in short steps, which has other code for the
events.

Libraries without dry friction run with several ramps or constraints; the run with the smallest
error counts. A run has failed if it is not finite, MuJoCo warns, or a joint is off by a turn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
import time
from typing import Any, NamedTuple

import numpy as np

from benchmarks.cases.motions import ControlledArm, free_arms, stored_arm
from benchmarks.cases.robots import Array
from benchmarks.peers import control_loop
from benchmarks.peers.control_loop import CONSTRAINTS, RAMPS, Run
from benchmarks.peers.work import LeftOutError, Side
from benchmarks.plots import CASADI, FLOAT32, FLOAT64, MUJOCO, PINOCCHIO, panels
from benchmarks.run import show_progress
from benchmarks.table import Cells, Row, bullets, grid, lines_of, order, page, result_row, short
from benchmarks.timing import Pace, surroundings, take_turns
from pfd_core.simulation.step_control import SMALLEST_RTOL

# A turn of a joint [rad].
LOST = 2 * np.pi
# Longest step of the second computation of a reference [s], and rk4's steps a period.
LONGEST, SHORT_STEPS = 2e-3, 20
CONTROLLED = 'controlled'
# A run that takes longer is a long one [s].
LONG = 0.1
INTEGRATORS = ('rk4', 'velocity_verlet', 'imex2')
ADAPTIVE = 'pfd dop853 float64'


ALL = tuple(product(INTEGRATORS, ('float64', 'float32')))
# End of the way of a run without the inertia of rotors.
NO_ROTORS = ', no rotors'


class Plan(NamedTuple):
    """Steps in a period and tolerances, what other libraries run with, and runs of ours."""

    substeps: Sequence[int]
    tolerances: Sequence[float]
    ramps: Sequence[float]
    constraints: Sequence[tuple[float, float]]
    pace: Pace
    fixed: Sequence[tuple[str, str]] = ALL
    ensemble_substeps: Sequence[int] = ()
    arms: int = 256


PACE, FREE_PACE = Pace(budget=30.0, fewest=2), Pace(budget=16.0, turns=20)
PLAN = Plan((1, 2, 5, 10, 20), (1e-3, 1e-9), RAMPS, CONSTRAINTS, PACE, ALL, (1, 2, 5))
STEPS, TENTHS = (10, 20, 50, 100, 200, 500, 1000), tuple(10.0**-k for k in range(3, 13))
FREE = Plan(STEPS, TENTHS, (1.0,), CONSTRAINTS[:1], FREE_PACE)
QUICK_PACE = Pace(chunk=1e-4, turns=2, fewest=2)
QUICK = Plan((1, 5), (1e-3,), RAMPS[2:4], CONSTRAINTS[:1], QUICK_PACE, ALL[:3:2], (1,), 16)
QUICK_FREE = Plan((10, 100), (1e-3,), (1.0,), CONSTRAINTS[:1], QUICK_PACE, ALL[:3:2])


def measure(quick: bool) -> dict[str, Any]:
    """Return the machine, the controlled arm, and free motions by name."""
    return {
        'machine': surroundings(),
        CONTROLLED: _measure(stored_arm(), QUICK if quick else PLAN),
        'free': {
            name: {'cause': cause} | _measure(arm, QUICK_FREE if quick else FREE)
            for name, (cause, arm) in free_arms().items()
        },
    }


def _measure(case: ControlledArm, plan: Plan) -> dict[str, Any]:
    """
    Return the reference's differences, seconds, runs and what is missing.

    A run is {way, step [s], tolerance, arms, softness, status, error [rad], minimum and median [s
    a simulated second]}.
    """
    show_progress(f'reference of a {case.robot.name}')
    wanted, differences = _reference(case)
    missing: list[str] = []
    best = dict[tuple[str, ...], tuple[dict[str, Any], Run, float]]()
    for row, run in _candidates(case, plan, missing):
        show_progress(f'{row["way"]}, {setting(row)} {row["softness"]}')
        one = _tried(row, run, wanted)
        key = tuple(str(row[x]) for x in ('way', 'step', 'tolerance', 'arms'))
        best[key] = min(best.get(key, one), one, key=_error)
    show_progress(f'{len(best)} runs take turns')
    # Long runs take turns among themselves: they would leave the others few turns.
    for long in (False, True):
        own = [x for x in best.values() if x[0]['status'] == 'ok' and (x[2] > LONG) == long]
        sides = [Side(row['way'], run, lambda: wanted) for row, run, _ in own]
        found = take_turns(sides, 1, plan.pace, time.thread_time)
        for (row, _, _), times in zip(own, found, strict=True):
            unit = case.duration * row['arms']
            row |= {'minimum': times.minimum / unit, 'median': times.median / unit}
    return {
        'reference': differences,
        'seconds': case.duration,
        'runs': [row for row, _, _ in best.values()],
        'missing': missing,
    }


def _reference(case: ControlledArm) -> tuple[Array, dict[str, float]]:
    """Return the positions at the end, (n,), and their differences from other computations."""

    def at_best(method: str, max_step: float) -> Array:
        tightest = {'rtol': SMALLEST_RTOL, 'atol': SMALLEST_RTOL, 'refine': 1}
        found = control_loop.adaptive(
            case, SMALLEST_RTOL, method=method, max_step=max_step, **tightest
        )()
        if found.status != 'ok':
            raise ArithmeticError(f'the {case.robot.name} has no reference: {found.status}')
        return found.q

    wanted = at_best('articulated_body', np.inf)
    others = {'self_difference': at_best('composite_body', min(case.period / 5, LONGEST))}
    if case.plant.friction is not None:
        others['from_fixed'] = control_loop.fixed(case, SHORT_STEPS, 'rk4')().q
    return wanted, {name: float(np.abs(q - wanted).max()) for name, q in others.items()}


def _candidates(
    case: ControlledArm, plan: Plan, missing: list[str]
) -> Iterator[tuple[dict[str, Any], Run]]:
    """Yield rows without numbers, each with its run."""

    def row(way: str, substeps: int = 0, **known: Any) -> dict[str, Any]:
        step = {'step': case.period / substeps if substeps else None, 'tolerance': None}
        return {'way': way, **step, 'arms': 1, 'softness': '', **known}

    for integrator, dtype in plan.fixed:
        sizes = [(1, x) for x in plan.substeps] + [(plan.arms, x) for x in plan.ensemble_substeps]
        for arms, substeps in sizes:
            run = control_loop.fixed(case, substeps, integrator, dtype, arms=arms)
            yield row(f'pfd {integrator} {dtype}', substeps, arms=arms), run
    bare = replace(case, scene=case.scene.without(['armature']))
    for integrator in INTEGRATORS if case.kp.any() else ():
        run = control_loop.fixed(bare, 1, integrator)
        yield row(f'pfd {integrator} float64{NO_ROTORS}', 1), run
    for tolerance in plan.tolerances:
        yield row(ADAPTIVE, tolerance=tolerance), control_loop.adaptive(case, tolerance)
    others = {
        'CasADi': partial(control_loop.casadi_runs, case, plan.substeps, plan.ramps),
        'Pinocchio': partial(control_loop.pinocchio_runs, case, plan.substeps, plan.ramps),
        'MuJoCo': partial(control_loop.mujoco_runs, case, plan.substeps, plan.constraints),
    }
    for library, runs in others.items():
        try:
            for way, substeps, softness, run in runs():
                yield row(way, substeps, softness=softness), run
        except LeftOutError as reason:
            missing.append(f'{library}: {reason}')


def _error(one: tuple[Row, Run, float]) -> float:
    return np.inf if one[0]['error'] is None else float(one[0]['error'])


def _tried(row: dict[str, Any], run: Run, wanted: Array) -> tuple[dict[str, Any], Run, float]:
    """Return the row with the error of a run, the run, and its seconds."""
    began = time.thread_time()
    status, q = run()
    seconds = time.thread_time() - began
    off = np.abs(q - wanted)
    if status == 'ok' and off.max() > LOST:
        status = 'lost'
    error = float(off.max()) if status == 'ok' else None
    known = {'status': status, 'error': error, 'minimum': None, 'median': None}
    return row | known, run, seconds


# From here on the page: all from the rows.

TOLERANCES = tuple(10.0**-k for k in (1, 2, 3, 4, 5, 6, 8, 10, 12))
# Another motion has another error: advice has a margin.
MARGIN = 2.0
# Errors [rad] of rows of README.md: coarse and fine for a controller's test.
COARSE_AND_FINE = (1e-3, 1e-5)
# Way: colour, marker and line in the plots.
STYLES: Mapping[str, tuple[str, str, str]] = {
    'pfd rk4 float64': (FLOAT64, 'o', '-'),
    'pfd velocity_verlet float64': (FLOAT64, '>', '-.'),
    'pfd imex2 float64': (FLOAT64, 's', '--'),
    'pfd rk4 float32': (FLOAT32, '^', '-'),
    'pfd velocity_verlet float32': (FLOAT32, '<', '-.'),
    'pfd imex2 float32': (FLOAT32, 'v', '--'),
    'CasADi RK4': (CASADI, 'P', '-'),
    'CasADi Verlet': (CASADI, 'X', '-.'),
    'CasADi Euler': (CASADI, 'd', ':'),
    ADAPTIVE: (FLOAT64, '*', ''),
    control_loop.PINOCCHIO: (PINOCCHIO, 'D', '-'),
    'MuJoCo RK4': (MUJOCO, 'X', '-'),
    'MuJoCo Euler': (MUJOCO, '<', ':'),
    'MuJoCo implicit': (MUJOCO, 'v', '-.'),
    'MuJoCo implicitfast': (MUJOCO, '>', '--'),
}
# Rows of one arm of ours, of many, and of other libraries.
KINDS: Sequence[Callable[[Row], bool]] = (
    lambda row: row['way'].startswith('pfd') and row['arms'] == 1,
    lambda row: row['way'].startswith('pfd') and row['arms'] > 1,
    lambda row: not row['way'].startswith('pfd'),
)


def setting(row: Row) -> str:
    """Return the step or the tolerance of a row as text."""
    if row['step'] is None:
        return f'tolerance {row["tolerance"]:.0e}'
    return f'{row["step"] * 1e3:g} ms'


def text(data: Mapping[str, Any]) -> str:
    """Return the page."""
    controlled, motions = data[CONTROLLED], []
    for name, found in data['free'].items():
        change = order(found['reference']['self_difference'])
        motions += [
            f'### {name}\n',
            f'{found["cause"]}; {found["seconds"]:g} s. With another algorithm and shorter steps '
            f'the reference changes by {change} rad.\n',
            *_runs(found),
        ]
    return page(
        'error',
        machine=data['machine'],
        advice=_advice(controlled['runs']),
        **{key: order(value) for key, value in controlled['reference'].items()},
        rotors=without_rotors(controlled['runs']),
        runs=_runs(controlled),
        missing=bullets(controlled['missing'], 'Nothing.'),
        motions=motions,
    )


def _floor(data: Mapping[str, Any]) -> float:
    """Return the smallest error that the reference resolves [rad]."""
    return float(max(data['reference'].values()))


def _milliseconds(row: Row) -> str:
    return short(row['minimum'] * 1e3)


def _runs(data: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of two tables, of steps and of tolerances."""
    for kind in ('step', 'tolerance'):
        cells = Cells()
        for row in (x for x in data['runs'] if x[kind] is not None):
            many = f', each of {row["arms"]}' if row['arms'] > 1 else ''
            found = row['status'] if row['minimum'] is None else None
            cell = found or f'{_milliseconds(row)} ms, {max(row["error"], _floor(data)):.1e}'
            cells[row['way'] + many, setting(row)] = cell
        yield from (*grid(cells, 'way'), '')


def _fastest(rows: Sequence[Row], tolerance: float) -> list[Row | None]:
    """Return the fastest row of each kind within a tolerance, with MARGIN."""
    done = (row for row in rows if row['minimum'] is not None)
    sound = [row for row in done if row['error'] * MARGIN <= tolerance]
    return [
        min(filter(fits, sound), key=lambda row: float(row['minimum']), default=None)
        for fits in KINDS
    ]


def _advice(rows: Sequence[Row]) -> list[str]:
    """Return the fastest run of each kind for each tolerance."""
    lines = dict[tuple[str, ...], float]()
    for tolerance in TOLERANCES:
        cells = tuple(
            f'{_milliseconds(row)} ({row["way"].removeprefix("pfd ")}, {setting(row)})'
            if row
            else 'none'
            for row in _fastest(rows, tolerance)
        )
        # Advice for a smaller error also holds for a larger one.
        lines[cells] = tolerance
    titles = ['error allowed [rad]', 'one arm [ms]', 'each of many arms [ms]']
    titles.append('fastest other library, one arm [ms]')
    return lines_of(titles, ([f'{tolerance:g}', *cells] for cells, tolerance in lines.items()))


def results_rows(data: Mapping[str, Any]) -> list[dict[str, str]]:
    """
    Return rows of README.md: what, ours, peer, theirs and speed-up, as text; none without peers.

    The fastest runs of one arm within each tolerance.
    """
    rows = []
    for tolerance in COARSE_AND_FINE:
        own, _, peer = _fastest(data[CONTROLLED]['runs'], tolerance)
        if own and peer:
            what = f'a second of a UR5 under a controller, to {tolerance:g} rad'
            times = f'{_milliseconds(own)} ms', f'{_milliseconds(peer)} ms'
            ratio = short(peer['minimum'] / own['minimum'])
            rows.append(result_row(what, [(times[0], peer['way'], times[1], ratio)]))
    return rows


def without_rotors(rows: Sequence[Row]) -> str:
    """Return a sentence on our runs without rotors in steps of one period."""
    own = {row['way'].split()[1]: row for row in rows if row['way'].endswith(NO_ROTORS)}
    period = max(row['step'] for row in own.values())
    lost = ' and '.join(name for name, row in own.items() if row['minimum'] is None)
    done = {name: _milliseconds(row) for name, row in own.items() if row['minimum'] is not None}
    does = ', '.join(f'{name} does, in {time} ms' for name, time in done.items())
    return (
        f'Without rotor inertia, which most URDFs lack, {lost or "none"} do not finish in steps '
        f'of {period * 1e3:g} ms; {does or "none does"}.'
    )


def plots(data: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write time over error of the arm under a controller, and of free motions."""

    def panel(title: str, found: Mapping[str, Any]) -> tuple[dict[str, Any], Any]:
        labels = {
            'xlabel': 'error of the worst joint at the end [rad]   (left is better)',
            'ylabel': 'time of one simulated second on one thread [ms]   (down is better)',
        }
        return {'title': title, **labels}, _lines(found)

    many = max(row['arms'] for row in data[CONTROLLED]['runs'])
    title = f'A geared UR5 with friction under a 1 kHz controller (open: each of {many} arms)'
    free = [panel(f'{name}, {x["seconds"]:g} s', x) for name, x in data['free'].items()]
    return [
        *panels([panel(title, data[CONTROLLED])], folder / 'error.png', (10.0, 6.0), 5),
        *panels(free, folder / 'error-integrators.png', (14.0, 7.6), 5),
    ]


def _lines(data: Mapping[str, Any]) -> list[tuple[Any, dict[str, Any]]]:
    """Return the lines of the ways of STYLES; open where of many arms."""
    done = [row for row in data['runs'] if row['minimum'] is not None]
    floor, lines = _floor(data), []
    for way, (colour, marker, line) in STYLES.items():
        for arms in sorted({row['arms'] for row in done if row['way'] == way}):
            own = [row for row in done if (row['way'], row['arms']) == (way, arms)]
            points = [(max(row['error'], floor), row['minimum'] * 1e3) for row in own]
            style = {'marker': marker, 'linestyle': line, 'color': colour, 'linewidth': 1.1}
            style |= {'markersize': 9 if marker == '*' else 6}
            style |= {'label': way} if arms == 1 else {'markerfacecolor': 'white'}
            lines.append((points, style))
    return lines
