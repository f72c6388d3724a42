# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of the hard cases: the page hard-cases.md, table by table, and its JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
import math
from pathlib import Path
from typing import Any

from pfd_core.algorithms.programs import METHODS
from pfd_core.report.error_estimates import FACTOR, SHOWN, Row, misses, rows
from pfd_core.report.hard_case_errors import FEW, MANY, PEERS, KernelRow, Result, measure
from pfd_core.report.hard_case_motions import SAMPLES, SteadyRun, steady_runs
from pfd_core.report.hard_cases import CASES, LATER, ROUNDING
from pfd_core.report.markdown import cells, header, json_text, order, paragraph
from pfd_core.report.timing import show_progress
from pfd_core.report.trajectory_cases import MOTIONS
from pfd_core.report.trajectory_errors import (
    NEAR,
    SAME_EFFORT,
    STIFF_FORMULATION,
    TOLERANCE,
    Effort,
    Hold,
    Run,
    formulation,
    holds,
    runs,
)
from pfd_core.report.trajectory_references import REFERENCES

COMMAND = 'pfd report hard-cases'
# Error estimates are compared where the error is above so many units of rounding.
SHOWN_UNITS = SHOWN / ROUNDING['float64']
INTRODUCTION = f"""# Errors of forward dynamics at hard cases

Written by `{COMMAND}`; all numbers except those of peers are the same on every machine.

An error is |x - qdd| / |qdd| in the Euclidean norm, the largest over the states of the case. For
the arm in equilibrium (*static_hold*) it is relative to the acceleration without torques. The
reference qdd has 50 digits. It is certified by a different method in different frames (*second
evaluation*), and by the residual of the Newton-Euler equations (*residual*).

- *kappa_J* is the condition number of H scaled to a diagonal of one. It predicts the error of
  methods that factor H.
- *kappa_s* is the largest relative change of qdd for a relative change of every number of robot,
  scene and state, in twelve seeded directions. An error of kappa_s u is as accurate as rounded
  inputs permit.
- u is the unit of rounding, 2^-53 in float64 and 2^-24 in float32.
- The bounds are for the kernel of method 'auto' with one step of refinement (*refined*). They were
  set before the measurements, except for *static_hold*, whose first bound, 20 u, was below its
  kappa_s u. The default bound is 100 kappa_s u.
- *lost* means that the answer is not finite. The kernel then reports an infinite error estimate.
"""


def markdown(results: Sequence[Result], survey: Survey | None = None) -> str:
    """Return the whole page; without a survey, the part on single states."""
    parts = [INTRODUCTION, '## Outcome\n', *_outcome(results), '']
    parts += ['## Cases and references\n', *_cases(results)]
    for dtype in ROUNDING:
        parts += ['', f"## Kernel of method 'auto', {dtype}\n", *_kernels(results, dtype)]
    parts += [
        '',
        '## Every method, float64\n',
        paragraph(METHODS_TEXT),
        *_methods(results, 'float64'),
    ]
    parts += ['', '## Every method, float32\n', *_methods(results, 'float32')]
    parts += ['', '## Peers, float64\n', *_peers(results)]
    if survey is not None:
        parts += ['', *sections(survey)]
    parts += [
        '',
        '## Not in these tables\n',
        *(f'- {reason}: {", ".join(names)}' for reason, names in LATER.items()),
    ]
    return '\n'.join(parts) + '\n'


METHODS_TEXT = (
    'Error without / with one step of refinement. Each method runs as recorded. The kernels '
    'above are also folded for the robot and fused, so they round differently. Sines of large '
    'angles need fused operations, which explains *large_angle_1e6* in float32. Chains of '
    f'more than {FEW} joints take minutes to record with most methods. Methods for longer '
    'chains, with their largest number of joints: '
    + ', '.join(f'{name} {most}' for name, most in MANY.items())
    + '.'
)


def _outcome(results: Sequence[Result]) -> list[str]:
    """Return the cases beyond their bounds, and the shares beyond 20 and 100 kappa_s u."""
    refined = [(one, row) for one in results for row in one.kernels if row.refine]
    doubles = [row.in_units for _, row in refined if row.dtype == 'float64']
    lines = [
        paragraph(
            f'Refined, in float64: {sum(x > 100 for x in doubles)} of {len(doubles)} cases are '
            f'above 100 kappa_s u (target: none), {sum(x > 20 for x in doubles)} above 20 '
            '(target: 5 % at most).'
        ),
        'Missed bounds:',
        '',
    ]
    wide = {case.name for case in CASES if case.wide}
    missed = [
        f'- {one.name}, {row.dtype}: {order(row.error)}, bound {row.bound}'
        + (f', {RESIDUALS}' if row.dtype == 'float32' and one.name in wide else '')
        for one in results
        for row in one.kernels
        if row.met is False
    ]
    lines += missed or ['- none']
    lines += [
        '',
        f'Error estimates that differ from the error by more than a factor of {FACTOR:g}:',
        '',
    ]
    wrong = [
        f'- {one.name}, {row.dtype}: {row.estimate:.2g} times {order(row.before or 0.0)}'
        for one, row in refined
        if _is_estimated(row)
        if not 1 / FACTOR <= (row.estimate or 0.0) <= FACTOR
    ]
    return lines + (wrong or [f'- none, of errors above {SHOWN_UNITS:.0f} u'])


def _is_estimated(row: KernelRow) -> bool:
    """Return whether a row has an estimate of an error that is more than rounding."""
    large = row.before is not None and row.before > SHOWN_UNITS * ROUNDING[row.dtype]
    return large and row.estimate is not None


RESIDUALS = 'which was set for residuals in float64'


def _cases(results: Sequence[Result]) -> list[str]:
    return header(
        'case | cause | n | states | kappa_J | kappa_s | second evaluation | residual'
    ) + [
        cells(
            one.name,
            one.cause,
            one.n,
            one.states,
            f'{one.kappa_j:.0e}',
            f'{one.kappa_s:.1e}',
            order(one.difference),
            order(one.residual),
        )
        for one in results
    ]


def _kernels(results: Sequence[Result], dtype: str) -> list[str]:
    table = header(
        'case | auto is | not refined | refined | refined, in kappa_s u | bound | met '
        '| estimate / error before the step'
    )
    for one in results:
        plain, refined = (row for row in one.kernels if row.dtype == dtype)
        methods = plain.method
        if refined.method != plain.method:
            methods = f'{plain.method}, refined {refined.method}'
        table.append(
            cells(
                one.name,
                methods,
                order(plain.error) + ('' if plain.met is not False else ', bound missed'),
                order(refined.error),
                f'{refined.in_units:.2g}' if math.isfinite(refined.in_units) else 'lost',
                refined.bound or '-',
                {None: '-', True: 'yes', False: 'no'}[refined.met],
                f'{refined.estimate:.2g}' if _is_estimated(refined) else '-',
            )
        )
    return table


def _methods(results: Sequence[Result], dtype: str) -> list[str]:
    table = header(' | '.join(('case', *METHODS)))
    for one in results:
        found = {
            (row.way, row.refine): order(row.error) for row in one.methods if row.dtype == dtype
        }
        pairs = [
            f'{found[name, 0]} / {found[name, 1]}' if (name, 0) in found else '-'
            for name in METHODS
        ]
        table.append(cells(one.name, *pairs))
    return table


def _peers(results: Sequence[Result]) -> list[str]:
    """Return the table of peers and of the kernel without and with refinement."""
    installed = {row.way for one in results for row in one.methods}
    table = header(' | '.join(('case', 'kernel', 'kernel, refined', *PEERS)))
    for one in results:
        own = [order(row.error) for row in one.kernels if row.dtype == 'float64']
        found = {row.way: order(row.error) for row in one.methods}
        others = (found.get(name, 'refused' if name in installed else 'absent') for name in PEERS)
        table.append(cells(one.name, *own, *others))
    text = (
        'A peer that is *absent* was not installed (`pip install "pfd_ros[peers]"`), *refused* '
        'means that the peer does not load the robot.'
    )
    return [paragraph(text), *table]


@dataclass(frozen=True)
class Survey:
    """Measurements on motions and on random states."""

    estimates: Sequence[Row]
    runs: Sequence[Run]
    steady: Sequence[SteadyRun]
    efforts: Sequence[Effort]
    holds: Sequence[Hold]


def sections(survey: Survey) -> list[str]:
    """Return the sections on motions and on error estimates over random states."""
    return [
        *_estimates(survey.estimates),
        '',
        *_motions(),
        '',
        *_runs(survey.runs),
        '',
        *_steady(survey.steady),
        '',
        *_efforts(survey.efforts),
        '',
        *_holds(survey.holds),
    ]


def data(survey: Survey) -> dict[str, Any]:
    """Return the survey as data."""
    return {
        'estimates': [asdict(one) for one in survey.estimates],
        'motions': [{'name': name, **asdict(known)} for name, known in REFERENCES.items()],
        'runs': [asdict(one) | {'met': one.met} for one in survey.runs],
        'steady': [asdict(one) | {'met': one.met} for one in survey.steady],
        'efforts': [asdict(one) for one in survey.efforts],
        'holds': [asdict(one) for one in survey.holds],
    }


def _estimates(rows: Sequence[Row]) -> list[str]:
    wrong = misses(rows)
    states = sum(row.shown for row in rows)
    text = (
        'Estimate over error of the answer before refinement, both max |.| over max |qdd|, '
        f'float64. Target: within a factor of {FACTOR:g} wherever the error is above '
        f'{SHOWN:g}. Of {states} such states in this table '
        + ('all are.' if not wrong else f'not those of {len(wrong)} rows.')
    )
    table = header(
        f'robot | method | states | with an error above {SHOWN:g} | largest error '
        '| least and most estimate / error | largest estimate of the others'
    )
    for row in rows:
        ratio = '-' if row.least is None else f'{row.least:.3f}, {row.most:.3f}'
        table.append(
            cells(
                row.robot,
                row.method,
                row.states,
                row.shown,
                order(row.largest),
                ratio,
                order(row.alarm),
            )
        )
    return ['## Error estimates over random states\n', paragraph(text), *table]


def _motions() -> list[str]:
    text = (
        'Free motions from a given state. The reference is extrapolated from the modified '
        'midpoint rule, of order 24 in 34 digits, or from an Euler step with implicit damping, of '
        'order 20 in 50 digits. Its *self-difference* is the distance to a reference with macro '
        'steps a third longer.'
    )
    table = header('motion | cause | time [s] | scheme | order | self-difference [rad]')
    for motion in MOTIONS:
        known = REFERENCES[motion.name]
        table.append(
            cells(
                motion.name,
                motion.cause,
                motion.duration,
                motion.way.scheme,
                motion.way.order,
                order(known.self_difference),
            )
        )
    return ['## Motions and their references\n', paragraph(text), *table]


def _runs(rows: Sequence[Run]) -> list[str]:
    missed = [row for row in rows if not row.met]
    text = (
        'Angle errors are those at the time of the reference [rad]; energy errors are the '
        'largest of the run, relative to the peak kinetic energy. Bounds were set before the '
        f'runs, except for the SO-100 and dop853. {len(rows) - len(missed)} of {len(rows)} are '
        'met. Runs of dop853 are refined.'
    )
    table = header(
        'motion | integrator | format | step [s] or rtol | time [s] | error of '
        '| found | bound | met'
    )
    for row in rows:
        check = row.check
        duration = next(one.duration for one in MOTIONS if one.name == check.motion)
        table.append(
            cells(
                check.motion,
                check.integrator,
                check.dtype,
                f'{check.step:g}',
                check.duration or duration,
                check.quantity,
                order(row.error) if math.isfinite(row.error) else 'not finite',
                f'{check.bound:g}',
                'yes' if row.met else 'no',
            )
        )
    return ['## Runs of the motions\n', paragraph(text), *table]


def _steady(rows: Sequence[SteadyRun]) -> list[str]:
    missed = [row for row in rows if not row.met]
    text = (
        'The angle of joints at rest or at constant velocity is known exactly. The error is the '
        f'largest difference from it, modulo whole turns, at {SAMPLES} times [rad], in steps of '
        f'1 ms. Bounds were set before. {len(rows) - len(missed)} of {len(rows)} are met.'
    )
    table = header('motion | cause | format | time [s] | found | bound | met')
    for row in rows:
        table.append(
            cells(
                row.name,
                row.cause,
                row.dtype,
                row.duration,
                order(row.error) if math.isfinite(row.error) else 'not finite',
                f'{row.bound:g}',
                'yes' if row.met else 'no',
            )
        )
    return ['## Motions without acceleration\n', paragraph(text), *table]


def _efforts(efforts: Sequence[Effort]) -> list[str]:
    text = (
        f'Evaluations that dop853 takes for *{STIFF_FORMULATION}* at a tolerance of '
        f'{TOLERANCE:g}. Rounding errors of forward dynamics look like fast motion and shorten '
        f'its steps. Target: one step of refinement takes at most {SAME_EFFORT:g} times '
        'the evaluations of two, whose error is the last digit.'
    )
    table = header('steps of refinement | evaluations')
    table += [cells(one.refine, one.evaluations or 'gave up after 24 000') for one in efforts]
    return ['## Formulation stiffness\n', paragraph(text), *table]


def _holds(holds: Sequence[Hold]) -> list[str]:
    text = (
        'A torque is constant over a period T (zero-order hold). A loop is then unstable for kd '
        'above 2 h / T, where h is the smallest eigenvalue of the inertia matrix, and for kp / '
        f'kd above 2 / T. Runs {NEAR:.0%} below and above these limits, in 8 substeps of rk4:'
    )
    table = header('loop | T [s] | kp | kd | decays below | grows above')
    for hold in holds:
        table.append(
            cells(
                hold.name,
                hold.period,
                f'{hold.kp:.3g}',
                f'{hold.kd:.3g}',
                'yes' if hold.decays else 'no',
                'yes' if hold.grows else 'no',
            )
        )
    return ['## Zero-order hold\n', paragraph(text), *table]


def run(folder: Path) -> list[Path]:
    """Measure everything and write the report into a folder; progress goes to a terminal."""
    results = []
    for case in CASES:
        show_progress(f'measuring {case.name}')
        results.append(measure(case))
    show_progress('measuring estimates and motions')
    survey = Survey(
        tuple(rows()),
        tuple(runs()),
        tuple(steady_runs()),
        tuple(formulation()),
        tuple(holds()),
    )
    show_progress('')
    return write(results, folder, survey)


def write(results: Sequence[Result], folder: Path, survey: Survey | None = None) -> list[Path]:
    """Write hard-cases.md and hard-cases.json; a lost answer is null in the JSON."""
    folder.mkdir(parents=True, exist_ok=True)
    page, found = folder / 'hard-cases.md', folder / 'hard-cases.json'
    page.write_text(markdown(results, survey), encoding='utf-8')
    content = {'cases': [asdict(one) for one in results]} | (data(survey) if survey else {})
    found.write_text(json_text(content), encoding='utf-8')
    return [page, found]
