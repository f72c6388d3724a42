# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Time and error of an arm under a controller, and of free motions.

Integrators, number formats, other libraries, and for the controlled arm smaller scenes.

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

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations, product
import time
from typing import Any

import numpy as np

from benchmarks.cases.controlled_arm import ControlledArm, free_arms, stored_arm
from benchmarks.cases.robots import Array
from benchmarks.peers.control_loop import (
    IN_CASADI,
    MUJOCO,
    PINOCCHIO,
    Run,
    Simulate,
    Softness,
    adaptive,
    casadi_arm,
    fixed,
    mujoco_arm,
    pinocchio_arm,
)
from benchmarks.peers.work import LeftOutError, Side
from benchmarks.run import each, show_progress
from benchmarks.table import Row
from benchmarks.timing import Pace, interleave
from pfd_core.simulation.step_control import SMALLEST_RTOL

# A turn of a joint [rad].
LOST = 2 * np.pi
# Longest step of the second computation of a reference [s].
LONGEST = 2e-3
CONTROLLED = 'controlled'
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
RAMPS = tuple(Softness(w) for w in (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5))
SOLVERS = tuple(
    Softness(0.0, steps, impedance) for steps in (0.0, 2.0) for impedance in (0.0, 0.9999)
)
# Other libraries: their ways, a function that makes the arm, and whether friction is a ramp.
PEERS: Mapping[str, tuple[Iterable[str], Callable[[ControlledArm], Simulate], bool]] = {
    'CasADi': (IN_CASADI, casadi_arm, True),
    'Pinocchio': ((PINOCCHIO,), pinocchio_arm, True),
    'MuJoCo': (MUJOCO, mujoco_arm, False),
}
IN_C = 'controller and loop in C; in each period {}'
NATIVE = 'one call of `Ensemble.rollout`: controller, steps and loop in native code'
# Way: contents of its time, and its friction.
CONTENTS: Mapping[str, tuple[str, str]] = {
    **{f'pfd {integrator} {dtype}': (NATIVE, 'resolved by events') for integrator, dtype in FIXED},
    ADAPTIVE: (
        'a loop in Python: the controller in NumPy and one call of `integrate` in each period',
        'resolved by events',
    ),
    **dict.fromkeys(
        IN_CASADI,
        (IN_C.format("steps in C around CasADi's C, compiled with -O3 -march=native"), 'ramp'),
    ),
    PINOCCHIO: (
        IN_C.format('steps in C++ around `pinocchio::aba`, compiled with -O3 -march=native'),
        'ramp',
    ),
    **dict.fromkeys(MUJOCO, (IN_C.format('`mj_step`'), 'soft constraint')),
}


@dataclass(frozen=True)
class Plan:
    """Our integrators, steps in a period, sizes, tolerances, and what other libraries run with."""

    fixed: Sequence[tuple[str, str]] = FIXED
    substeps: Sequence[int] = (1, 2, 5, 10, 20)
    ensemble_substeps: Sequence[int] = (1, 2, 5)
    arms: int = 256
    tolerances: Sequence[float] = (1e-3, 1e-9)
    most_left_out: int = len(LEAVES)
    ramps: Sequence[Softness] = RAMPS
    solvers: Sequence[Softness] = SOLVERS
    pace: Pace = field(default_factory=lambda: Pace(budget=30.0, turns=40, fewest=2))


QUICK = Plan(
    fixed=(('rk4', 'float64'), ('velocity_verlet', 'float64')),
    substeps=(1, 5),
    ensemble_substeps=(1,),
    arms=16,
    tolerances=(1e-3,),
    most_left_out=1,
    ramps=(Softness(1e-2), Softness(1e-3)),
    solvers=SOLVERS[:1],
    pace=Pace(chunk=1e-4, turns=2, fewest=2),
)


FREE = Plan(
    substeps=(10, 20, 50, 100, 200, 500, 1000),
    ensemble_substeps=(),
    tolerances=tuple(10.0**-k for k in range(3, 13)),
    most_left_out=0,
    ramps=(Softness(1.0),),
    solvers=SOLVERS[:1],
    pace=Pace(budget=16.0, turns=20, fewest=3),
)
QUICK_FREE = replace(
    FREE, fixed=QUICK.fixed, substeps=(10, 100), tolerances=(1e-3, 1e-8), pace=QUICK.pace
)


def measure(quick: bool) -> dict[str, Any]:
    """Return the measurement of the arm under a controller, and of each free motion by name."""
    measured = {CONTROLLED: _measure(stored_arm(), QUICK if quick else Plan())}
    for name, (cause, arm) in free_arms().items():
        measured[name] = {'cause': cause} | _measure(arm, QUICK_FREE if quick else FREE)
    return measured


def _measure(case: ControlledArm, plan: Plan) -> dict[str, Any]:
    """
    Return the reference's differences, runs, roundings, settings of peers and what is missing.

    A run is {way, step [s], tolerance, left_out (effects), arms, softness, status, error and
    middle (of worst and median joint) [rad], minimum and median [s a simulated second]}.
    """
    show_progress(f'reference of a {case.robot.name}')
    wanted, facts = _reference(case, plan.substeps[-1])
    for _ in each(partial(_compile, case), _fixed_rows(case, plan), 'compiling simulations'):
        pass
    missing: list[str] = []
    candidates = [*_ours(case, plan), *_peers(case, plan, missing)]
    measured = [_measured(row, runs, wanted) for row, runs in candidates]
    show_progress(f'{len(measured)} runs take turns')
    # Long runs take turns among themselves: they would leave the others few turns.
    for long in (False, True):
        own = [one for one in measured if one[0]['status'] == 'ok' and (one[2] > LONG) == long]
        sides = [Side(row['way'], run, lambda: wanted) for row, run, _ in own]
        found = interleave(sides, 1, plan.pace, time.thread_time)
        for (row, _, _), times in zip(own, found, strict=True):
            unit = case.duration * row['arms']
            row |= {'minimum': times.minimum / unit, 'median': times.median / unit}
    roundings = [_rounding(case, plan, dtype) for dtype in ('float64', 'float32')]
    return {
        'reference': facts
        | {'periods': case.periods, 'rate': 1 / case.period, 'seconds': case.duration},
        'runs': sorted((row for row, _, _ in measured), key=_place),
        'roundings': roundings,
        'ramps': [ramp.width for ramp in plan.ramps],
        'solvers': [str(solver) for solver in plan.solvers],
        'missing': missing,
    }


def _place(row: Row) -> tuple[Any, ...]:
    names = tuple(row['left_out'])
    way = list(CONTENTS).index(row['way'])
    return len(names), names, row['arms'], way, -(row['step'] or 0.0), -(row['tolerance'] or 0.0)


def _reference(case: ControlledArm, substeps: int) -> tuple[Array, dict[str, Any]]:
    """Return the positions at the end, (n,), and their differences from other computations."""

    def at_best(method: str, max_step: float) -> Array:
        tightest = {'rtol': SMALLEST_RTOL, 'atol': SMALLEST_RTOL, 'refine': 1}
        found = adaptive(case, SMALLEST_RTOL, method=method, max_step=max_step, **tightest)()
        if found.status != 'ok':
            raise ArithmeticError(f'the {case.robot.name} has no reference: {found.status}')
        return found.q

    wanted = at_best('articulated_body', np.inf)
    other = at_best('composite_body', min(case.period / 5, LONGEST))
    fine = fixed(case, case.scene, substeps, 'rk4', 'float64')().q
    off, from_fixed = (float(np.abs(x - wanted).max()) for x in (other, fine))
    return wanted, {'self_difference': off, 'from_fixed': from_fixed, 'substeps': substeps}


def _row(
    way: str, left_out: Sequence[str] = (), arms: int = 1, **setting: float
) -> dict[str, Any]:
    """Return a row without numbers; its setting is `step` or `tolerance`."""
    known = {'step': None, 'tolerance': None} | setting
    return {'way': way, **known, 'left_out': list(left_out), 'arms': arms}


def _measured(
    row: dict[str, Any], runs: Sequence[tuple[str, Run]], wanted: Array
) -> tuple[dict[str, Any], Run, float]:
    """Return the row of the run with the smallest error, the run, and its seconds once."""
    show_progress(f'{row["way"]}, {setting(row)}')
    found = []
    for softness, run in runs:
        began = time.thread_time()
        answer = run()
        seconds = time.thread_time() - began
        off = np.abs(answer.q - wanted)
        sound = answer.status == 'ok' and bool(off.max() <= LOST)
        numbers = {
            'softness': softness,
            'status': 'lost' if answer.status == 'ok' and not sound else answer.status,
            'error': float(off.max()) if sound else None,
            'middle': float(np.median(off)) if sound else None,
            'minimum': None,
            'median': None,
        }
        found.append((row | numbers, run, seconds))
    return min(found, key=lambda one: np.inf if one[0]['error'] is None else one[0]['error'])


def _fixed_rows(case: ControlledArm, plan: Plan) -> list[tuple[dict[str, Any], int]]:
    """Return the rows of our runs in fixed steps, with their substeps."""
    wanted: list[tuple[tuple[str, ...], str, str, int, int]] = [
        ((), integrator, dtype, substeps, arms)
        for arms, numbers in ((1, plan.substeps), (plan.arms, plan.ensemble_substeps))
        for integrator, dtype in plan.fixed
        for substeps in numbers
    ]
    for names in _subsets(LEAVES, plan.most_left_out):
        wanted += [(names, *pair, 1, arms) for pair in plan.fixed for arms in (1, plan.arms)]
        wanted.append((names, *FINE, 1))
    return [
        (_row(f'pfd {integrator} {dtype}', names, arms, step=case.period / substeps), substeps)
        for names, integrator, dtype, substeps, arms in wanted
    ]


def _run_of(case: ControlledArm, row: Row, substeps: int) -> Run:
    _, integrator, dtype = row['way'].split()
    scene = case.scene.without(row['left_out'])
    return fixed(case, scene, substeps, integrator, dtype, arms=row['arms'])


def _compile(case: ControlledArm, given: tuple[Row, int]) -> None:
    """Compile what a run needs; the disk cache keeps it."""
    _run_of(case, *given)


Candidate = tuple[dict[str, Any], Sequence[tuple[str, Run]]]


def _ours(case: ControlledArm, plan: Plan) -> Iterator[Candidate]:
    for row, substeps in _fixed_rows(case, plan):
        yield row, [('', _run_of(case, row, substeps))]
    for tolerance in plan.tolerances:
        yield _row(ADAPTIVE, tolerance=tolerance), [('', adaptive(case, tolerance))]


def _subsets(names: Iterable[str], most: int) -> Iterator[tuple[str, ...]]:
    """Yield all combinations of one name up to `most` names."""
    known = tuple(names)
    for count in range(1, most + 1):
        yield from combinations(known, count)


def _peers(case: ControlledArm, plan: Plan, missing: list[str]) -> Iterator[Candidate]:
    for library, (ways, make, ramp) in PEERS.items():
        show_progress(f'compiling {library}')
        softnesses = plan.ramps if ramp else plan.solvers
        scenes = (
            [(), *_subsets(LEFT_BY_CASADI, plan.most_left_out)] if library == 'CasADi' else [()]
        )
        try:
            for names in scenes:
                simulate = make(replace(case, scene=case.scene.without(names)))
                # Without friction the width of a ramp has no effect.
                given = (
                    [('', Softness(1.0))]
                    if 'friction' in names
                    else [(str(soft), soft) for soft in softnesses]
                )
                for way, substeps in product(ways, (1,) if names else plan.substeps):
                    row = _row(way, names, step=case.period / substeps)
                    yield row, [(name, simulate(way, substeps, soft)) for name, soft in given]
        except LeftOutError as reason:
            missing.append(f'{library}: {reason}')


def _rounding(case: ControlledArm, plan: Plan, dtype: str) -> dict[str, Any]:
    """Return how far runs are from another algorithm, or from double precision: {dtype, ...}."""
    show_progress(f'rounding of {dtype}')

    def end(dtype: str, method: str, substeps: int) -> Array:
        return fixed(case, case.scene, substeps, 'rk4', dtype, method)().q

    off = []
    for substeps in plan.substeps:
        other = end('float64', 'articulated_body' if dtype == 'float64' else 'auto', substeps)
        off.append(float(np.abs(end(dtype, 'auto', substeps) - other).max()))
    return {'dtype': dtype, 'least': min(off), 'largest': max(off)}


def setting(row: Row) -> str:
    """Return the step or the tolerance of a row as text."""
    if row['step'] is None:
        return f'tolerance {row["tolerance"]:.0e}'
    return f'{row["step"] * 1e3:g} ms'
