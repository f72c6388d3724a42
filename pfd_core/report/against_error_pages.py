# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of speed against error: page speed-against-error.md, its JSON and its plots."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pfd_core.report import against_error_plots, time_tables
from pfd_core.report.measure import evaluations, port_limit, quantity_rows, work_precision
from pfd_core.report.measure.energies import SAMPLES
from pfd_core.report.measure.evaluations import PEERS, Point, TimedCase
from pfd_core.report.measure.progress import show_progress
from pfd_core.report.measure.surroundings import described, surroundings
from pfd_core.report.measure.timing import Row
from pfd_core.report.measure.work_precision import MotionFacts, RunPoint
from pfd_core.report.render.markdown import Cells, Columns, bullets, grid, lines_of, page, table
from pfd_core.report.render.markdown import write as write_page
from pfd_core.report.render.numbers import least_and_median, order, short

NAME = 'speed-against-error'
QUANTITIES = quantity_rows.Plan(robots=('ur5', 'panda'), references=8)
QUICK_QUANTITIES = replace(
    QUANTITIES, robots=('planar2',), batches=(64,), pace=evaluations.QUICK.pace
)


@dataclass(frozen=True)
class Findings:
    """
    Cases and motions with their points, excluded implementations with reasons, and the machine.

    `quantities` are rows of quantities other than forward dynamics.
    """

    cases: list[TimedCase] = field(default_factory=list)
    points: list[Point] = field(default_factory=list)
    motions: list[MotionFacts] = field(default_factory=list)
    runs: list[RunPoint] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    machine: dict[str, Any] = field(default_factory=surroundings)
    quantities: list[Row] = field(default_factory=list)


def survey(
    cases: evaluations.Plan,
    integrators: work_precision.Plan,
    quantities: quantity_rows.Plan | None = None,
) -> Findings:
    """Measure both plans; progress goes to a terminal's stderr."""
    found = Findings()
    evaluations.compile_all(cases)
    for name in cases.cases:
        facts, points, left_out = evaluations.measure(name, cases)
        found.cases.append(facts)
        found.points.extend(points)
        found.left_out.extend(left_out)
    for given in integrators.motions:
        motion, runs, left_out = work_precision.measure(given, integrators)
        found.motions.append(motion)
        found.runs.extend(runs)
        found.left_out.extend(left_out)
    if quantities is not None:
        rows, left_out = quantity_rows.measure(quantities)
        found.quantities.extend(rows)
        found.left_out.extend(left_out)
    show_progress('')
    return found


def markdown(findings: Findings) -> str:
    """Return the whole page."""
    sizes = sorted({point.batch for point in findings.points})
    most = max(sizes, default=0)
    quantities = page(
        'quantities-against-error',
        states=QUANTITIES.references,
        notes=time_tables.NOTES,
        errors=time_tables.against_error(findings.quantities),
    )
    # The page has no shares of the port limit, which come with the rows of quantities.
    left_out = [text for text in findings.left_out if not text.startswith(port_limit.WORK)]
    return page(
        NAME,
        machine=described(findings.machine),
        noise=_noise(findings),
        many=most,
        summary=_summary(findings, most),
        contents=time_tables.contents(findings.points),
        cases='\n\n'.join(_case(case, findings.points, sizes) for case in findings.cases) or None,
        integrators=page(
            'integrators',
            samples=SAMPLES,
            motions='\n\n'.join(_motion(one, findings.runs) for one in findings.motions) or None,
        ),
        quantities=quantities if findings.quantities else None,
        excluded=bullets(_grouped(left_out), 'Nothing.'),
    )


def _noise(findings: Findings) -> str:
    """Return how far medians lie above minima, as a sentence."""
    ratios = [point.median / point.minimum for point in findings.points]
    ratios += [run.median / run.minimum for run in findings.runs if run.median and run.minimum]
    ratios.sort()
    if not ratios:
        return ''
    middle, high = (ratios[len(ratios) * part // 10] for part in (5, 9))
    return (
        f'The noise of the machine: half of the medians are at least {middle:.2f} times their\n'
        f'minimum, one in ten at least {high:.2f} times.'
    )


def _summary(findings: Findings, most: int) -> list[str]:
    """Return a table of the default method and the peers over cases."""
    absent = {
        peer: 'not installed'
        for peer in PEERS
        for text in findings.left_out
        if text.startswith(peer.split()[0]) and 'install the extra' in text
    }
    failed = {text.split(': ')[0] for text in findings.left_out if ': failed: ' in text}
    cells: Cells = {}
    for case in findings.cases:
        known = {
            (point.way, point.refine): point
            for point in findings.points
            if (point.case, point.batch, point.dtype) == (case.name, most, 'float64')
        }
        plain, refined = known.get((case.auto, case.steps)), known.get((case.refined, 1))
        cost = _cost(known.get((case.refined, 0)), refined)
        found = {
            'kappa_J': f'{case.kappa_j:.0e}',
            'kappa_s': f'{case.kappa_s:.1e}',
            'auto': _time_and_error(plain),
            'auto, refined': _time_and_error(refined),
            'cost of refinement': cost,
            **{
                peer: _time_and_error(
                    known.get((peer, int(peer.endswith('refined')))),
                    'failed' if f'{peer} at {case.name}' in failed else absent.get(peer, '-'),
                )
                for peer in PEERS
            },
        }
        cells |= {(case.name, title): cell for title, cell in found.items()}
    return grid(cells, 'case')


def _cost(plain: Point | None, refined: Point | None) -> str:
    """Return the time of a refined kernel over the time of its method without refinement."""
    ratios = [point.times for point in (plain, refined) if point is not None and point.times]
    return f'{ratios[0] / ratios[1]:.2f}' if len(ratios) == 2 else '-'


def _time_and_error(point: Point | None, otherwise: str = '-') -> str:
    if point is None:
        return otherwise
    return f'{short(point.minimum * 1e9)}, {order(point.error)}'


def _grouped(left_out: Sequence[str]) -> Iterator[str]:
    """Yield one line for each way and reason, with all places where it was excluded."""
    places: dict[tuple[str, str], list[str]] = {}
    for text in left_out:
        what, reason = text.split(': ', 1)
        way, place = what.rsplit(' at ', 1)
        places.setdefault((way, reason), []).append(place)
    for (way, reason), at in places.items():
        yield f'{way} at {", ".join(at)}: {reason}'


def _case(case: TimedCase, points: Sequence[Point], sizes: Sequence[int]) -> str:
    """Return the section of a case: a row for each way."""
    points = [point for point in points if point.case == case.name]
    other = '' if case.refined == case.auto else f', refined {case.refined}'
    facts = (
        f'{case.cause}. n = {case.n}, {case.states} state{"s" * (case.states > 1)}, auto is '
        f'{case.auto}{", refined" * case.steps}{other}; '
        f'kappa_J {case.kappa_j:.0e}, kappa_s {case.kappa_s:.1e}; '
        f'reference of 50 digits, second evaluation {case.difference:.0e}, residual '
        f'{case.residual:.0e}.\n'
    )
    lost = dict.fromkeys(
        f'{point.way} {point.dtype}{", refined" * (point.refine > 0)}'
        for point in points
        if point.error is None
    )
    missing = f'Missing in the plot, since the answer is lost: {"; ".join(lost)}.\n'
    own: dict[tuple[str, str, int], dict[int, Point]] = {}
    for point in points:
        own.setdefault((point.way, point.dtype, point.refine), {})[point.batch] = point
    lines = []
    for (way, dtype, refine), found in own.items():
        times = [least_and_median(found[size]) if size in found else 'failed' for size in sizes]
        one = next(iter(found.values()))
        units = '' if one.in_units is None else f' ({short(one.in_units)})'
        name = f'{way} (auto)' if way == case.default(refine) else way
        lines.append([name, dtype, refine, *times, order(one.error) + units])
    titles = [f'{size} state{"s" * (size > 1)} in a call [ns]' for size in sizes]
    titles = ['method', 'format', 'refine', *titles, 'error (in kappa_s u)']
    parts = [f'### {case.name}\n', facts, *([missing] if lost else []), *lines_of(titles, lines)]
    return '\n'.join(parts)


def _or_missing(cell: str, run: RunPoint) -> str:
    return '-' if run.minimum is None else cell


RUNS: Columns = {
    'integrator': 'way',
    'step or tolerance': 'setting',
    'time [ms]': lambda run: 'missing' if run.minimum is None else least_and_median(run, 1e3),
    'evaluations': lambda run: '-' if run.evaluations is None else f'{run.evaluations:.0f}',
    'trajectory error [rad]': lambda run: _or_missing(order(run.trajectory_error), run),
    'energy error': lambda run: _or_missing(order(run.energy_error), run),
}


def _motion(motion: MotionFacts, runs: Sequence[RunPoint]) -> str:
    """Return the section of a motion, with its missing points."""
    own = [run for run in runs if run.motion == motion.name]
    facts = (
        f'{motion.note}. n = {motion.n}, {motion.duration:g} s; self-difference of the reference '
        f'{motion.self_difference:.0e} rad.\n'
    )
    missing = (f'{run.way}, {run.setting}: {run.status}' for run in own if run.status != 'ok')
    parts = [f'### {motion.name}\n', facts, *table(RUNS, own), '', 'Missing points:\n']
    return '\n'.join([*parts, bullets(missing, '- none')])


def run(folder: Path, quick: bool = False) -> list[Path]:
    """Measure, write the report into a folder and return its files."""
    if quick:
        findings = survey(evaluations.QUICK, work_precision.QUICK, QUICK_QUANTITIES)
    else:
        findings = survey(evaluations.Plan(), work_precision.Plan(), QUANTITIES)
    return write(findings, folder)


def write(findings: Findings, folder: Path) -> list[Path]:
    """Write the page, its JSON and the plots as PNG and SVG, and return their paths."""
    return [
        *write_page(folder, NAME, markdown(findings), findings),
        *against_error_plots.write(
            findings.cases, findings.points, findings.motions, findings.runs, folder
        ),
        *time_tables.plot_errors(findings.quantities, folder, f'{NAME}-quantities'),
    ]
