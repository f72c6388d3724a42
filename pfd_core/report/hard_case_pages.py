# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of the hard cases: the page hard-cases.md, table by table, and its JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
import math
from pathlib import Path
import statistics
from typing import Any

from pfd_core.algorithms.programs import METHODS
from pfd_core.report.cases.hard_cases import CASES, LATER, QUICK, ROUNDING, Case
from pfd_core.report.cases.motions import MOTIONS, REFERENCES
from pfd_core.report.measure import predictions
from pfd_core.report.measure.errors import (
    FEW,
    HELD_OUT,
    HELD_OUT_STATES,
    LONGEST_HELD_OUT,
    MANY,
    PEERS,
    KernelRow,
    Result,
    measure,
)
from pfd_core.report.measure.estimates import FACTOR, SHOWN, Row, misses, rows
from pfd_core.report.measure.motion_errors import (
    BY_NAME,
    NEAR,
    SAME_EFFORT,
    SAMPLES,
    STIFF_FORMULATION,
    TOLERANCE,
    Effort,
    Hold,
    PredictedRun,
    Run,
    SteadyRun,
    formulation,
    holds,
    predicted_runs,
    runs,
    steady_runs,
)
from pfd_core.report.measure.processes import each
from pfd_core.report.render.markdown import Columns, bullets, lines_of, missed_bounds, page, table
from pfd_core.report.render.markdown import write as write_page
from pfd_core.report.render.numbers import order, percent, yes

# A part of the survey: measures rows.
Part = Callable[[], Iterable[Any]]
# Error estimates are compared where the error is above so many units of rounding.
SHOWN_UNITS = SHOWN / ROUNDING['float64']
# Largest difference of two evaluations with 50 digits that certifies a reference: far below the
# rounding of every number format, and 20 digits are left for the condition of an arm.
CERTIFIED = 1e-30


def markdown(results: Sequence[Result], survey: Survey | None = None) -> str:
    """Return the whole page; without a survey, the part on single states."""
    refined = [(one, row) for one in results for row in one.kernels if row.refine]
    doubles = [row.in_units for _, row in refined if row.dtype == 'float64']
    found = [(one, row) for one in results for row in one.kernels]
    held_out = [(one, row) for one in results for row in one.held_out]
    missed = _missed(found)
    places = (('', found), (', at held-out states', held_out))
    unpredicted = (
        f'{one.name}, {_kernel(row)}{place}: {order(row.error)}'
        for place, rows_of in places
        for one, row in rows_of
        if row.predicted is None
    )
    held_doubles = [(row.in_units, one.name) for one, row in held_out if row.dtype == 'float64']
    held_units, held_name = max(held_doubles, default=(0.0, 'none'))
    wrong = (
        f'{one.name}, {row.dtype}: {row.estimate:.2g} times {order(row.before or 0.0)}'
        for one, row in refined
        if _is_estimated(row)
        if not 1 / FACTOR <= (row.estimate or 0.0) <= FACTOR
    )
    return page(
        'hard-cases',
        command='pfd report hard-cases',
        count=len(doubles),
        largest=f'{max(doubles, default=0.0):.2g}',
        held_largest=f'{held_units:.3g} ({held_name})',
        missed=bullets(missed, '- none'),
        held_out=bullets(_missed(held_out), '- none'),
        seed=HELD_OUT,
        states=HELD_OUT_STATES,
        longest=LONGEST_HELD_OUT,
        held_out_rows=len(held_out),
        unpredicted=bullets(unpredicted, '- none'),
        uncertified=_uncertified(results),
        times=predictions.FACTOR,
        spread=predictions.SPREAD,
        roundings=predictions.ROUNDINGS,
        rms=predictions.RMS,
        rows=sum(row.predicted is not None for _, row in found),
        factor=FACTOR,
        wrong=bullets(wrong, f'- none, of errors above {SHOWN_UNITS:.0f} u'),
        cases=table(CASE_COLUMNS, results),
        **{
            f'kernels_{dtype}': table(
                KERNELS,
                [(one, *(row for row in one.kernels if row.dtype == dtype)) for one in results],
            )
            for dtype in ROUNDING
        },
        few=FEW,
        many=', '.join(f'{name} {most}' for name, most in MANY.items()),
        **{f'methods_{dtype}': _methods(results, dtype) for dtype in ROUNDING},
        peers=_peers(results),
        survey=None if survey is None else section(survey),
        later=bullets((f'{reason}: {", ".join(names)}' for reason, names in LATER.items()), ''),
    )


def _uncertified(results: Sequence[Result]) -> str:
    """Return a sentence on the robots at which two methods in other frames differ."""
    found = [one for one in results if one.difference > CERTIFIED]
    if not found:
        return ''
    names = ', '.join(one.name for one in found)
    return (
        f' Excepted are {names}: their rotation matrices, rounded to float64, are not exactly '
        'orthogonal, so that methods in other frames differ by up to '
        f'{order(max(one.difference for one in found))}.'
    )


def _missed(found: Sequence[tuple[Result, KernelRow]]) -> list[str]:
    return [
        f'{one.name}, {_kernel(row)}: {order(row.error)}'
        + (f', {row.share:.2g} times its bound' if row.share else ', other bits than its twin')
        for one, row in found
        if row.met is False
    ]


def _kernel(row: KernelRow) -> str:
    return row.dtype + ', refined' * row.refine


def summary(results: Sequence[Result]) -> str:
    """Return the outcome as a paragraph, for the README."""
    rows = [(one, row) for one in results for row in one.kernels if row.predicted is not None]
    held = [(one, row) for one in results for row in one.held_out if row.predicted is not None]
    return page(
        'hard-cases-summary',
        cases=len(results),
        times=predictions.FACTOR,
        rows=len(rows),
        met=sum(row.met is True for _, row in rows),
        missed=missed_bounds(_missed(rows)),
        held_rows=len(held),
        held_met=sum(row.met is True for _, row in held),
        held_missed=missed_bounds(_missed(held)),
        share=percent(statistics.median(row.share or 0.0 for _, row in rows)),
        largest_share=percent(max(row.share or 0.0 for _, row in rows)),
        lost=sum(
            row.predicted is None for one in results for row in (*one.kernels, *one.held_out)
        ),
    )


CASE_COLUMNS: Columns = {
    'case': 'name',
    'cause': 'cause',
    'n': 'n',
    'states': 'states',
    'kappa_J': lambda one: f'{one.kappa_j:.0e}',
    'kappa_s': lambda one: f'{one.kappa_s:.1e}',
    'second evaluation': lambda one: order(one.difference),
    'residual': lambda one: order(one.residual),
}
# Columns of a case with its rows without and with refinement.
KERNELS: Columns = {
    'case': lambda x: x[0].name,
    'method of auto': lambda x: (
        x[1].method
        if x[1].method.removesuffix(', refined') == x[2].method
        else f'{x[1].method}; refined: {x[2].method}'
    ),
    'default': lambda x: order(x[1].error),
    'refined': lambda x: order(x[2].error),
    'refined, in kappa_s u': lambda x: (
        f'{x[2].in_units:.2g}' if math.isfinite(x[2].in_units) else 'lost'
    ),
    'predicted': lambda x: ', '.join(_predicted(row) for row in x[1:]),
    'error / bound': lambda x: ', '.join(
        '-' if row.share is None else f'{row.share:.2g}' for row in x[1:]
    ),
    'met': lambda x: ', '.join(yes(row.met) for row in x[1:]),
    'estimate / error before the step': lambda x: (
        f'{x[2].estimate:.2g}' if _is_estimated(x[2]) else '-'
    ),
}


def _predicted(row: KernelRow) -> str:
    return '-' if row.predicted is None else order(row.predicted)


def _is_estimated(row: KernelRow) -> bool:
    """Return whether a row has an estimate of an error that is more than rounding."""
    large = row.before is not None and row.before > SHOWN_UNITS * ROUNDING[row.dtype]
    return large and row.estimate is not None


def _methods(results: Sequence[Result], dtype: str) -> list[str]:
    lines = []
    for one in results:
        found = {
            (row.way, row.refine): order(row.error) for row in one.methods if row.dtype == dtype
        }
        pairs = (
            f'{found[name, 0]} / {found[name, 1]}' if (name, 0) in found else '-'
            for name in METHODS
        )
        lines.append([one.name, *pairs])
    return lines_of(['case', *METHODS], lines)


def _peers(results: Sequence[Result]) -> list[str]:
    installed = {row.way for one in results for row in one.methods}
    lines = []
    for one in results:
        own = [order(row.error) for row in one.kernels if row.dtype == 'float64']
        found = {row.way: order(row.error) for row in one.methods}
        peers = (found.get(name, 'refused' if name in installed else 'absent') for name in PEERS)
        lines.append([one.name, *own, *peers])
    return lines_of(['case', 'kernel', 'kernel, refined', *PEERS], lines)


@dataclass(frozen=True)
class Survey:
    """Measurements on motions and on random states."""

    estimates: Sequence[Row]
    runs: Sequence[Run]
    steady: Sequence[SteadyRun]
    efforts: Sequence[Effort]
    holds: Sequence[Hold]
    exact: Sequence[PredictedRun] = ()


def section(survey: Survey) -> str:
    """Return the sections on motions and on error estimates over random states."""
    wrong = misses(survey.estimates)
    return page(
        'hard-motions',
        factor=FACTOR,
        shown=SHOWN,
        states=sum(row.shown for row in survey.estimates),
        outcome=f'all but the states of {len(wrong)} rows are.' if wrong else 'all are.',
        estimates=table(ESTIMATES, survey.estimates),
        motions=table(MOTION_COLUMNS, MOTIONS),
        runs_met=_met(survey.runs),
        runs=table(RUNS, survey.runs),
        samples=SAMPLES,
        steady_met=_met(survey.steady),
        steady=table(STEADY, survey.steady),
        stiff=STIFF_FORMULATION,
        tolerance=TOLERANCE,
        same_effort=SAME_EFFORT,
        efforts=table(EFFORTS, survey.efforts),
        near=NEAR,
        holds=table(HOLDS, survey.holds),
        times=predictions.FACTOR,
        exact_met=_met(survey.exact),
        exact=table(EXACT_RUNS, survey.exact),
    )


def _met(found: Sequence[Run] | Sequence[SteadyRun] | Sequence[PredictedRun]) -> str:
    return f'{sum(one.met for one in found)} of {len(found)}'


ESTIMATES: Columns = {
    'robot': 'robot',
    'method': 'method',
    'states': 'states',
    f'with an error above {SHOWN:g}': 'shown',
    'largest error': lambda row: order(row.largest),
    'least and most estimate / error': lambda row: (
        '-' if row.least is None else f'{row.least:.3f}, {row.most:.3f}'
    ),
    'largest estimate of the others': lambda row: order(row.alarm),
}
MOTION_COLUMNS: Columns = {
    'motion': 'name',
    'cause': 'cause',
    'time [s]': 'duration',
    'scheme': 'way.scheme',
    'order': 'way.order',
    'self-difference [rad]': lambda motion: order(REFERENCES[motion.name].self_difference),
}
RUNS: Columns = {
    'motion': 'check.motion',
    'integrator': 'check.integrator',
    'format': 'check.dtype',
    'step [s] or rtol': lambda row: f'{row.check.step:g}',
    'time [s]': lambda row: row.check.duration or BY_NAME[row.check.motion].duration,
    'error of': 'check.quantity',
    'found': lambda row: _found(row.error),
    'bound': lambda row: f'{row.check.bound:g}',
    'met': lambda row: yes(row.met),
}
STEADY: Columns = {
    'motion': 'name',
    'cause': 'cause',
    'format': 'dtype',
    'time [s]': 'duration',
    'found': lambda row: _found(row.error),
    'bound': lambda row: f'{row.bound:g}',
    'met': lambda row: yes(row.met),
}
EXACT_RUNS: Columns = {
    'motion': 'name',
    'cause': 'cause',
    'format': 'dtype',
    'steps': 'steps',
    'found [rad]': lambda row: _found(row.error),
    'predicted [rad]': lambda row: order(row.predicted),
    'found / bound': lambda row: f'{row.share:.2g}',
    'met': lambda row: yes(row.met),
}
EFFORTS: Columns = {
    'steps of refinement': 'refine',
    'evaluations': lambda one: one.evaluations or 'more than 24 000',
}
HOLDS: Columns = {
    'loop': 'name',
    'T [s]': 'period',
    'kp': lambda hold: f'{hold.kp:.3g}',
    'kd': lambda hold: f'{hold.kd:.3g}',
    'decays below': lambda hold: yes(hold.decays),
    'grows above': lambda hold: yes(hold.grows),
}


def _found(error: float) -> str:
    return order(error) if math.isfinite(error) else 'not finite'


def data(survey: Survey) -> dict[str, Any]:
    """Return the survey as data."""
    return {
        'estimates': survey.estimates,
        'motions': [{'name': name, **asdict(known)} for name, known in REFERENCES.items()],
        'runs': [asdict(one) | {'met': one.met} for one in survey.runs],
        'steady': [asdict(one) | {'met': one.met} for one in survey.steady],
        'efforts': survey.efforts,
        'holds': survey.holds,
        'predicted': [asdict(one) | {'met': one.met} for one in survey.exact],
    }


def run(folder: Path, quick: bool = False) -> list[Path]:
    """Measure everything, or quickly one case, and write the report into a folder."""
    if quick:
        return write(list(each(measure, QUICK, 'hard cases')), folder)
    parts: list[Part] = [rows, runs, steady_runs, formulation, holds, predicted_runs]
    items: list[Case | Part] = [*parts, *CASES]
    found = list(each(_measured, items, 'hard cases and motions', _is_long))
    return write(found[len(parts) :], folder, Survey(*found[: len(parts)]))


def _is_long(item: Case | Part) -> bool:
    return not isinstance(item, Case) or '_200' in item.name


def _measured(item: Case | Part) -> Any:
    return measure(item) if isinstance(item, Case) else tuple(item())


def write(results: Sequence[Result], folder: Path, survey: Survey | None = None) -> list[Path]:
    """Write hard-cases.md and hard-cases.json; a lost answer is null in the JSON."""
    content = {'cases': results} | (data(survey) if survey else {})
    return write_page(folder, 'hard-cases', markdown(results, survey), content)
