# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The sections of hard-cases.md on motions and on error estimates over random states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
import math
from typing import Any

from pfd_core.report.error_estimates import FACTOR, SHOWN, Row, misses
from pfd_core.report.hard_case_motions import SAMPLES, SteadyRun
from pfd_core.report.markdown import cells, header, order, paragraph
from pfd_core.report.trajectory_cases import MOTIONS
from pfd_core.report.trajectory_errors import (
    NEAR,
    SAME_EFFORT,
    STIFF_FORMULATION,
    TOLERANCE,
    Effort,
    Hold,
    Run,
)
from pfd_core.report.trajectory_references import REFERENCES


@dataclass(frozen=True)
class Survey:
    """What is measured beside single states."""

    estimates: Sequence[Row]
    runs: Sequence[Run]
    steady: Sequence[SteadyRun]
    efforts: Sequence[Effort]
    holds: Sequence[Hold]


def sections(survey: Survey) -> list[str]:
    """Return the lines of all sections."""
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
        'Estimate over error of the answer that refinement corrects, both max |.| over max |qdd|, '
        f'float64. Asked for: within a factor of {FACTOR:g} wherever the error is above '
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
        'Errors of an angle are taken at the time of the reference [rad], errors of the energy '
        'over the whole run, over the peak kinetic energy. Bounds were set before, but for those '
        f'of the SO-100 and of dop853. {len(rows) - len(missed)} of {len(rows)} are met. Runs of '
        'dop853 are refined.'
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
        'Of joints that rest or turn evenly the angle is known for all times. The error is the '
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
        f'{TOLERANCE:g}. Rounding errors of forward dynamics look like fast motion, and its steps '
        'become as short as they are large. Asked for: one step of refinement takes at most '
        f'{SAME_EFFORT:g} times the evaluations of two, whose error is the last digit.'
    )
    table = header('steps of refinement | evaluations')
    table += [cells(one.refine, one.evaluations or 'gave up after 24 000') for one in efforts]
    return ['## Formulation stiffness\n', paragraph(text), *table]


def _holds(holds: Sequence[Hold]) -> list[str]:
    text = (
        'A torque is held for a period T, and the integrator does not see the controller. A loop '
        'must then be unstable from kd = 2 h / T on, h the smallest eigenvalue of the inertia '
        f'matrix, and from kp / kd = 2 / T on. Runs {NEAR:.0%} below and above these limits, in 8 '
        'substeps of rk4:'
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
