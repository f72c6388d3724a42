# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Time and error of an arm under a controller: integrators, formats, libraries and smaller scenes.

    error   largest |q - reference| of a joint at the end of the motion [rad or m]
    time    processor time of the thread for each simulated second: controller, steps and loop. The
            time of an ensemble is divided by its arms. On an idle core it equals the wall time

The reference is the adaptive integrator with events of friction, restarted in each period, at its
tightest tolerance, refined. Two differences show its error: from itself with another algorithm of
forward dynamics and shorter steps, and from rk4 in the shortest steps, which has other code for
the events.

Libraries without dry friction run with every Softness of a list; the run with the smallest error
counts. A run has failed if it is not finite, MuJoCo warns, or a joint is off by a turn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, combinations, product
import time
from typing import Any

import numpy as np

from pfd_core.report.cases.controlled_arm import ControlledArm
from pfd_core.report.cases.robots import Array
from pfd_core.report.contenders.control_loop import (
    IN_CASADI,
    MUJOCO,
    PINOCCHIO,
    Run,
    Simulate,
    Softness,
    casadi_arm,
    mujoco_arm,
    pinocchio_arm,
)
from pfd_core.report.contenders.drake import DRAKE, drake_arm
from pfd_core.report.contenders.ours_controlled import adaptive, fixed
from pfd_core.report.contenders.work import LeftOutError, Side
from pfd_core.report.measure.processes import each
from pfd_core.report.measure.progress import show_progress
from pfd_core.report.measure.surroundings import surroundings
from pfd_core.report.measure.timing import Pace, interleave
from pfd_core.simulation.step_control import SMALLEST_RTOL

# A turn of a joint [rad].
LOST = 2 * np.pi
# A run that takes longer is a long one [s].
LONG = 0.1
# Our integrators in fixed steps that resolve friction, with the number formats.
FIXED = tuple(product(('rk4', 'velocity_verlet', 'imex2'), ('float64', 'float32')))
ADAPTIVE = 'pfd dop853 float64'
# Effects of smaller scenes, which lack one or several, and their names on the page.
LEAVES = {'friction': 'dry friction', 'armature': 'rotors', 'effort limits': 'motor limits'}
# Effects that scenes of CasADi, the fastest of the other libraries, lack. Without rotors every
# library is as far from the arm.
LEFT_BY_CASADI = ('friction', 'effort limits')
# Integrator, format and steps in a period with errors far below the error of a smaller scene, also
# for light joints with strong damping.
FINE = ('imex2', 'float64', 10)
ROUNDINGS = ('float64', 'float32')
WIDTHS = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5)
RAMPS = tuple(Softness(width) for width in WIDTHS)
# Number of ramps that Drake runs with, from the widest: it takes seconds with a steep one.
DRAKES = 5
SOLVERS = tuple(
    Softness(0.0, steps, impedance) for steps in (0.0, 2.0) for impedance in (0.0, 0.9999)
)


@dataclass(frozen=True)
class Plan:
    """
    Plan of a comparison.

    Attributes
    ----------
    fixed : tuple of (str, str)
        Integrators in fixed steps with their number formats.
    substeps : tuple of int
        Steps in a period of the controller, of every fixed integrator.
    reference_substeps : int
        Steps in a period of the rk4 run with which the reference is compared.
    arms : int
        Arms of an ensemble.
    ensemble_substeps : tuple of int
        Steps in a period of an ensemble.
    tolerances, accuracies : tuple of float
        Relative tolerances of our adaptive integrator, and accuracies of Drake's.
    most_left_out : int
        The most effects of LEAVES that a scene lacks.
    ramps, solvers : tuple of Softness
        What libraries without dry friction, and MuJoCo, run with.
    pace : Pace
        Durations and repetitions.

    """

    fixed: tuple[tuple[str, str], ...] = FIXED
    substeps: tuple[int, ...] = (1, 2, 5, 10, 20)
    reference_substeps: int = 20
    arms: int = 256
    ensemble_substeps: tuple[int, ...] = (1, 2, 5)
    tolerances: tuple[float, ...] = (1e-3, 1e-9)
    accuracies: tuple[float, ...] = (1e-2, 1e-3, 1e-4)
    most_left_out: int = len(LEAVES)
    ramps: tuple[Softness, ...] = RAMPS
    solvers: tuple[Softness, ...] = SOLVERS
    pace: Pace = field(default_factory=lambda: Pace(budget=30.0, turns=40, fewest=2))


QUICK = Plan(
    fixed=(('rk4', 'float64'), ('velocity_verlet', 'float64')),
    substeps=(1, 5),
    reference_substeps=10,
    arms=16,
    ensemble_substeps=(1,),
    tolerances=(1e-3,),
    accuracies=(1e-3,),
    most_left_out=1,
    ramps=(Softness(1e-2), Softness(1e-3)),
    solvers=SOLVERS[:1],
    pace=Pace(chunk=1e-4, turns=2, fewest=2),
)


@dataclass(frozen=True)
class ReferenceFacts:
    """Differences of the reference from its second computation, and from rk4 [rad]."""

    self_difference: float
    from_fixed: float
    fixed_substeps: int


@dataclass(frozen=True)
class ControlledRow:
    """
    Time and error of one run.

    Attributes
    ----------
    way : str
        Library, integrator and number format.
    step : float or None
        Step of a fixed integrator [s].
    tolerance : float or None
        Relative tolerance or accuracy of an adaptive one.
    left_out : tuple of str
        Effects that the scene lacks, keys of LEAVES.
    arms : int
        Arms of the ensemble.
    softness : str
        How friction is approximated, '' where it is resolved or left out.
    status : str
        'ok', or the reason why the run has failed.
    error, middle : float or None
        Error of the worst joint, and of the median joint [rad or m].
    minimum, median : float or None
        Seconds for each simulated second.

    """

    way: str
    step: float | None
    tolerance: float | None
    left_out: tuple[str, ...] = ()
    arms: int = 1
    softness: str = ''
    status: str = 'ok'
    error: float | None = None
    middle: float | None = None
    minimum: float | None = None
    median: float | None = None

    @property
    def setting(self) -> str:
        """Step or tolerance as a string."""
        if self.step is None:
            return f'tolerance {self.tolerance:.0e}'
        return f'{self.step * 1e3:g} ms'


@dataclass(frozen=True)
class Rounding:
    """Least and largest distance [rad] of runs that differ by rounding only."""

    dtype: str
    least: float
    largest: float


@dataclass(frozen=True)
class Findings:
    """
    The reference, rows, roundings, excluded libraries with reasons, and the machine.

    `ramps` [rad/s] and `solvers` are what libraries without dry friction ran with.
    """

    reference: ReferenceFacts
    periods: int
    rows: list[ControlledRow]
    roundings: list[Rounding]
    left_out: list[str]
    ramps: list[float]
    solvers: list[str]
    machine: dict[str, Any] = field(default_factory=surroundings)


@dataclass(frozen=True)
class _Candidate:
    """A row without numbers, and its runs; the best run counts."""

    row: ControlledRow
    runs: Sequence[tuple[str, Run]]


@dataclass(frozen=True)
class _Measured:
    """A row with its error, the run, and the seconds that it took once."""

    row: ControlledRow
    run: Run
    seconds: float


def survey(case: ControlledArm, plan: Plan) -> Findings:
    """Measure a plan; progress goes to a terminal's stderr."""
    show_progress('reference')
    wanted, facts = reference(case, plan.reference_substeps)
    for _ in each(partial(_make, case), _fixed_runs(plan), 'compiling simulations'):
        pass
    left_out: list[str] = []
    candidates = list(chain(_ours(case, plan), _peers(case, plan, left_out)))
    measured = [_measured(candidate, wanted) for candidate in candidates]
    sound = [one for one in measured if one.row.status == 'ok']
    show_progress(f'{len(sound)} runs take turns')
    rows = [one.row for one in measured if one.row.status != 'ok']
    # Long runs take turns among themselves: they would leave the others few turns.
    for long in (False, True):
        own = [one for one in sound if (one.seconds > LONG) == long]
        sides = [Side(one.row.way, one.run, lambda: wanted) for one in own]
        found = interleave(sides, 1, plan.pace, time.thread_time)
        for done, times in zip(own, found, strict=True):
            unit = case.duration * done.row.arms
            least, median = times.minimum / unit, times.median / unit
            rows.append(replace(done.row, minimum=least, median=median))
    order = list(dict.fromkeys(candidate.row.way for candidate in candidates))
    rows.sort(
        key=lambda row: (
            (len(row.left_out), row.left_out, row.arms, order.index(row.way)),
            (-(row.step or 0.0), -(row.tolerance or 0.0)),
        )
    )
    roundings = [_rounding(case, plan, dtype) for dtype in ROUNDINGS]
    show_progress('')
    return Findings(
        facts,
        case.periods,
        rows,
        roundings,
        left_out,
        [ramp.width for ramp in plan.ramps],
        [str(solver) for solver in plan.solvers],
    )


def reference(case: ControlledArm, substeps: int) -> tuple[Array, ReferenceFacts]:
    """Return the positions at the end, (n,), and their differences from other computations."""

    def at_best(method: str, max_step: float) -> Array:
        run = adaptive(
            case,
            SMALLEST_RTOL,
            absolute=SMALLEST_RTOL,
            method=method,
            refine=1,
            max_step=max_step,
        )
        found = run()
        if found.status != 'ok':
            raise ArithmeticError(f'the controlled arm has no reference: {found.status}')
        return found.q

    wanted = at_best('articulated_body', np.inf)
    other = at_best('composite_body', case.period / 5)
    fine = fixed(case, case.scene, substeps, 'rk4', 'float64')().q
    self_difference, from_fixed = (float(np.abs(x - wanted).max()) for x in (other, fine))
    return wanted, ReferenceFacts(self_difference, from_fixed, substeps)


def _measured(candidate: _Candidate, wanted: Array) -> _Measured:
    """Return the run of smallest error, its row without times."""
    show_progress(f'{candidate.row.way}, {candidate.row.setting}')
    found = []
    for softness, run in candidate.runs:
        begin = time.thread_time()
        answer = run()
        seconds = time.thread_time() - begin
        off = np.abs(answer.q - wanted)
        status = answer.status
        if status == 'ok' and not off.max() <= LOST:
            status = 'lost'
        row = replace(candidate.row, softness=softness, status=status)
        if status == 'ok':
            row = replace(row, error=float(off.max()), middle=float(np.median(off)))
        found.append(_Measured(row, run, seconds))
    return min(found, key=lambda one: np.inf if one.row.error is None else one.row.error)


@dataclass(frozen=True)
class _FixedRun:
    """A run of ours in fixed steps, `arms` at once, without some effects."""

    left_out: tuple[str, ...]
    integrator: str
    dtype: str
    substeps: int
    arms: int

    def of(self, case: ControlledArm) -> _Candidate:
        way = f'pfd {self.integrator} {self.dtype}'
        step = case.period / self.substeps
        row = ControlledRow(way, step, None, self.left_out, self.arms)
        scene = case.scene.without(self.left_out)
        run = fixed(case, scene, self.substeps, self.integrator, self.dtype, arms=self.arms)
        return _Candidate(row, [('', run)])


def _fixed_runs(plan: Plan) -> list[_FixedRun]:
    runs = [
        _FixedRun((), *pair, substeps, arms)
        for arms, numbers in ((1, plan.substeps), (plan.arms, plan.ensemble_substeps))
        for pair in plan.fixed
        for substeps in numbers
    ]
    for names in _subsets(LEAVES, plan.most_left_out):
        runs += [
            _FixedRun(names, *pair, 1, arms) for pair in plan.fixed for arms in (1, plan.arms)
        ]
        runs.append(_FixedRun(names, *FINE, 1))
    return runs


def _make(case: ControlledArm, run: _FixedRun) -> None:
    """Compile what a run needs; the disk cache keeps it."""
    run.of(case)


def _ours(case: ControlledArm, plan: Plan) -> Iterator[_Candidate]:
    for run in _fixed_runs(plan):
        yield run.of(case)
    for tolerance in plan.tolerances:
        yield _Candidate(
            ControlledRow(ADAPTIVE, None, tolerance), [('', adaptive(case, tolerance))]
        )


def _subsets(names: Iterable[str], most: int) -> Iterator[tuple[str, ...]]:
    """Yield all combinations of one name up to `most` names."""
    known = tuple(names)
    for count in range(1, most + 1):
        yield from combinations(known, count)


# Other libraries: their ways, and a function that makes the arm.
PEERS: dict[str, tuple[Iterable[str], Callable[[ControlledArm], Simulate]]] = {
    'CasADi': (IN_CASADI, casadi_arm),
    'Pinocchio': ((PINOCCHIO,), pinocchio_arm),
    'MuJoCo': (MUJOCO, mujoco_arm),
    'Drake': (DRAKE, drake_arm),
}


def _peers(case: ControlledArm, plan: Plan, left_out: list[str]) -> Iterator[_Candidate]:
    for library in PEERS:
        try:
            yield from _of_peer(library, case, plan)
        except LeftOutError as reason:
            left_out.append(f'{library}: {reason}')


def _of_peer(library: str, case: ControlledArm, plan: Plan) -> Iterator[_Candidate]:
    show_progress(f'making {library}')
    ways, make = PEERS[library]
    simulate, adaptive = make(case), library == 'Drake'
    softnesses = {'MuJoCo': plan.solvers, 'Drake': plan.ramps[:DRAKES]}.get(library, plan.ramps)
    for way in ways:
        for setting in plan.accuracies if adaptive else plan.substeps:
            step, tolerance = (None, setting) if adaptive else (case.period / setting, None)
            runs = [(str(soft), simulate(way, setting, soft)) for soft in softnesses]
            yield _Candidate(ControlledRow(way, step, tolerance), runs)
    if library == 'CasADi':
        yield from _scenes_of_casadi(case, plan)


def _scenes_of_casadi(case: ControlledArm, plan: Plan) -> Iterator[_Candidate]:
    for names in _subsets(LEFT_BY_CASADI, plan.most_left_out):
        simulate = casadi_arm(replace(case, scene=case.scene.without(names)))
        # Without friction the width of a ramp has no effect.
        ramps = [('', Softness(1.0))]
        if 'friction' not in names:
            ramps = [(str(soft), soft) for soft in plan.ramps]
        for way in IN_CASADI:
            runs = [(name, simulate(way, 1, soft)) for name, soft in ramps]
            yield _Candidate(ControlledRow(way, case.period, None, names), runs)


def _rounding(case: ControlledArm, plan: Plan, dtype: str) -> Rounding:
    """Return how far runs differ from another algorithm, or from double precision."""
    show_progress(f'rounding of {dtype}')

    def end(dtype: str, method: str, substeps: int) -> Array:
        return fixed(case, case.scene, substeps, 'rk4', dtype, method)().q

    off = []
    for substeps in plan.substeps:
        other = end('float64', 'articulated_body' if dtype == 'float64' else 'auto', substeps)
        off.append(float(np.abs(end(dtype, 'auto', substeps) - other).max()))
    return Rounding(dtype, min(off), max(off))


def scene_errors(rows: Iterable[ControlledRow]) -> dict[tuple[str, ...], ControlledRow]:
    """Return our row in the shortest steps of each scene that lacks effects."""
    found: dict[tuple[str, ...], ControlledRow] = {}
    for row in filter(is_ours, rows):
        before = found.get(row.left_out)
        if row.left_out and (before is None or (row.step or 0.0) < (before.step or 0.0)):
            found[row.left_out] = row
    return found


@dataclass(frozen=True)
class Advice:
    """The fastest rows within a tolerance [rad]: ours of one arm, of many, of other libraries."""

    tolerance: float
    one: ControlledRow | None
    many: ControlledRow | None
    other: ControlledRow | None


TOLERANCES = tuple(10.0**-k for k in (1, 2, 3, 4, 5, 6, 8, 10, 12))
# Another motion has another error: advice has a margin. Of times that differ by less than this
# part, the scene with most effects is better.
MARGIN, NEARLY = 2.0, 0.05


def advice(rows: Sequence[ControlledRow], tolerances: Sequence[float]) -> list[Advice]:
    """Return for each tolerance the fastest rows whose error is within it, with MARGIN."""

    def fastest(tolerance: float, fits: Callable[[ControlledRow], bool]) -> ControlledRow | None:
        within = [row for row in rows if row.error is not None and row.error * MARGIN <= tolerance]
        timed = [(row.minimum, row) for row in within if row.minimum is not None and fits(row)]
        least = min((time for time, _ in timed), default=0.0)
        near = [one for one in timed if one[0] <= (1 + NEARLY) * least]
        return min(near, key=lambda one: (len(one[1].left_out), one[0]))[1] if near else None

    return [
        Advice(
            tolerance,
            fastest(tolerance, lambda row: is_ours(row) and row.arms == 1),
            fastest(tolerance, lambda row: is_ours(row) and row.arms > 1),
            fastest(tolerance, lambda row: not is_ours(row)),
        )
        for tolerance in tolerances
    ]


def is_ours(row: ControlledRow) -> bool:
    """Return whether a row is of this library."""
    return row.way.startswith('pfd ')
