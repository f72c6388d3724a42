# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of speed against error: page speed-against-error.md, its JSON and its plots."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from pfd_core.report import (
    against_error,
    against_error_plots,
    port_limit,
    quantity_plot,
    quantity_rows,
    quantity_tables,
    work_precision,
)
from pfd_core.report.against_error import PEERS, CaseFacts, Point
from pfd_core.report.markdown import cells, header, json_text
from pfd_core.report.motions import SAMPLES
from pfd_core.report.speed_tables import error_cell, least_and_median, short
from pfd_core.report.surroundings import surroundings, told
from pfd_core.report.timing import Row, show_progress
from pfd_core.report.work_precision import MotionFacts, RunPoint

COMMAND = 'pfd report speed --against-error'
NAME = 'speed-against-error'
QUANTITIES = quantity_rows.Plan(robots=('ur5', 'panda'), references=8)
QUICK_QUANTITIES = replace(
    QUANTITIES, robots=('planar2',), batches=(64,), pace=against_error.QUICK.pace
)
INTRODUCTION = """# Speed against error

Written by `{command}`; times are from one machine on one day.

{machine}.

All implementations of one case, and all runs of one motion, are interleaved in one process; a time
is minimum / median over the rounds. {noise}

## One evaluation

![Time of an evaluation over its error, {many} states in a call](speed-against-error.png)

The same for one state in a call: [speed-against-error-single.png](speed-against-error-single.png).

- An error is |x - qdd| / |qdd|, the largest over the states of the case, against a certified
  reference of 50 digits ([hard-cases.md](hard-cases.md)). In brackets it is in units of kappa_s u:
  kappa_s is the structured condition number of the state, u the unit of rounding of the number
  format, 2^-53 or 2^-24. 1 = as accurate as rounded inputs permit. In the plot u is 2^-53 for all,
  and a second line marks the unit of float32.
- Ours are the kernels that users get from `compile_kernel`; *auto* is the default method. One
  state is a call of `kernel.bind`, a batch is in Fortran order on one thread.
- Pinocchio's batch in WORLD axes is `abaInParallel` on one thread; batches in LOCAL axes and for
  CRBA with Cholesky are loops in Python. MuJoCo uses `mj_forward` and one step of
  `mujoco.rollout`, with contacts and constraints off; the error is from `mj_forward`.
- *lost* means that the answer is not finite: a missing point in the plot.
"""
OTHERS = """## Quantities

![Time over error of every quantity](speed-against-error-quantities.png)

Two arms, and the fastest call of each implementation; for all robots and implementations run `pfd
report speed --against-error --quantity NAME`. Times are minimum / median for each state.
"""


@dataclass(frozen=True)
class Findings:
    """
    Cases and motions with their points, excluded implementations with reasons, and the machine.

    `quantities` are rows of quantities other than forward dynamics.
    """

    cases: list[CaseFacts] = field(default_factory=list)
    points: list[Point] = field(default_factory=list)
    motions: list[MotionFacts] = field(default_factory=list)
    runs: list[RunPoint] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    machine: dict[str, Any] = field(default_factory=surroundings)
    quantities: list[Row] = field(default_factory=list)


def survey(
    evaluations: against_error.Plan,
    integrators: work_precision.Plan,
    quantities: quantity_rows.Plan | None = None,
) -> Findings:
    """Measure both plans; progress goes to a terminal's stderr."""
    found = Findings()
    for name in evaluations.cases:
        facts, points, left_out = against_error.measure(name, evaluations)
        found.cases.append(facts)
        found.points.extend(points)
        found.left_out.extend(left_out)
    for make in integrators.motions:
        motion, runs, left_out = work_precision.measure(make(), integrators)
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
    facts = {'machine': told(findings.machine), 'noise': _noise(findings)}
    parts = [INTRODUCTION.format(command=COMMAND, many=max(sizes, default=0), **facts)]
    parts += ['### One step of refinement, and peers\n', SUMMARY, *_summary(findings, sizes), '']
    for case in findings.cases:
        points = [point for point in findings.points if point.case == case.name]
        parts += [f'### {case.name}\n', _described(case), *_lost(points)]
        parts += [*_case_table(case, points, sizes), '']
    parts += _integrators(findings.motions, findings.runs)
    if findings.quantities:
        errors = quantity_tables.ERRORS.format(states=QUANTITIES.references)
        parts += [OTHERS, errors, quantity_tables.NOTES]
        parts.append(quantity_tables.against_error(findings.quantities))
    # The page has no shares of the port limit, which come with the rows of quantities.
    left_out = [text for text in findings.left_out if not text.startswith(port_limit.WORK)]
    parts += ['## Excluded\n', *(_grouped(left_out) or ['Nothing.'])]
    return '\n'.join(parts).rstrip() + '\n'


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


SUMMARY = """\
The default method in float64, without and with one step of refinement, and the peers: minimum
nanoseconds per state of the largest batch, and error. For ill-conditioned arms `refine=1` also
changes the method. The cost of refinement is the median ratio of both times.
"""


def _summary(findings: Findings, sizes: Sequence[int]) -> list[str]:
    """Return a table of the default method and the peers over cases."""
    most = max(sizes, default=0)
    titles = ['auto', 'auto, refined', 'cost of refinement', *PEERS]
    absent = {
        peer: 'not installed'
        for peer in PEERS
        for text in findings.left_out
        if text.startswith(peer.split()[0]) and 'install the extra' in text
    }
    lines = header(' | '.join(['case', 'kappa_J', 'kappa_s', *titles]))
    for case in findings.cases:
        known = {
            (point.way, point.refine): point
            for point in findings.points
            if (point.case, point.batch, point.dtype) == (case.name, most, 'float64')
        }
        refined = known.get((case.refined, 1))
        cost = f'{1 / refined.times:.2f}' if refined is not None and refined.times else '-'
        ours = [_time_and_error(known.get((case.default(refine), refine))) for refine in (0, 1)]
        peers = [_time_and_error(known.get((peer, 0)), absent.get(peer, '-')) for peer in PEERS]
        conditions = [f'{case.kappa_j:.0e}', f'{case.kappa_s:.1e}']
        lines.append(cells(case.name, *conditions, *ours, cost, *peers))
    return lines


def _grouped(left_out: Sequence[str]) -> list[str]:
    """Return one line for each way and reason, with all places where it was excluded."""
    places: dict[tuple[str, str], list[str]] = {}
    for text in left_out:
        what, reason = text.split(': ', 1)
        way, place = what.rsplit(' at ', 1)
        places.setdefault((way, reason), []).append(place)
    return [f'- {way} at {", ".join(at)}: {reason}' for (way, reason), at in places.items()]


def _time_and_error(point: Point | None, otherwise: str = '-') -> str:
    if point is None:
        return otherwise
    return f'{short(point.minimum * 1e9)}, {error_cell(point.error)}'


def _described(case: CaseFacts) -> str:
    other = '' if case.refined == case.auto else f', refined {case.refined}'
    return (
        f'{case.cause}. n = {case.n}, {case.states} state{"s" * (case.states > 1)}, auto is '
        f'{case.auto}{other}; kappa_J {case.kappa_j:.0e}, kappa_s {case.kappa_s:.1e}; '
        f'reference of 50 digits, second evaluation {case.difference:.0e}, residual '
        f'{case.residual:.0e}.\n'
    )


def _lost(points: Sequence[Point]) -> list[str]:
    """Return a line that names the ways without a finite answer, if there are any."""
    ways = dict.fromkeys(
        f'{point.way} {point.dtype}{", refined" * (point.refine > 0)}'
        for point in points
        if point.error is None
    )
    return [f'Missing in the plot, since the answer is lost: {"; ".join(ways)}.\n'] if ways else []


def _case_table(case: CaseFacts, points: Sequence[Point], sizes: Sequence[int]) -> list[str]:
    """Return the table of a case: one row for each way."""
    titles = [f'{size} state{"s" * (size > 1)} in a call [ns]' for size in sizes]
    lines = header(' | '.join(['method', 'format', 'refine', *titles, 'error (in kappa_s u)']))
    ways = dict.fromkeys((point.way, point.dtype, point.refine) for point in points)
    for way, dtype, refine in ways:
        own = {p.batch: p for p in points if (p.way, p.dtype, p.refine) == (way, dtype, refine)}
        times = [least_and_median(own[size].minimum, own[size].median, 1e9) for size in sizes]
        one = own[sizes[0]]
        units = '' if one.in_units is None else f' ({short(one.in_units)})'
        name = f'{way} (auto)' if way == case.default(refine) else way
        lines.append(cells(name, dtype, refine, *times, error_cell(one.error) + units))
    return lines


INTEGRATORS = """## Integrators

![Time and evaluations over trajectory and energy error](work-precision.png)

Free motions of an arm, without torques. The trajectory error is the largest difference of a joint
from the reference at {samples} times [rad], the energy error the largest difference of the energy
in units of the largest kinetic energy. Times and evaluations are for one simulated second.

- rk4, velocity_verlet and imex2 run in native code. dop853 is `pfd.integrate`, whose steps are in
  Python; its times include some milliseconds to load its kernel. States at the {samples} times
  come from its dense output, whose evaluations are counted. imex2 has two evaluations a step and,
  with damping, two implicit solutions, which count as evaluations.
- MuJoCo's integrators run in `mj_step`; Euler and the implicit integrators treat joint damping
  implicitly.
- The reference is `pfd.integrate` at its tightest tolerance, refined. Its self-difference is the
  distance to a second reference by a different method with shorter steps. Errors near it are not
  resolved.
- A run that diverged is a missing point: its state was not finite, was reset by MuJoCo, or was off
  by more than a turn (*lost*).
"""


def _integrators(motions: Sequence[MotionFacts], runs: Sequence[RunPoint]) -> Iterator[str]:
    yield INTEGRATORS.format(samples=SAMPLES)
    for motion in motions:
        own = [run for run in runs if run.motion == motion.name]
        yield from (f'### {motion.name}\n', _moved(motion), *_motion_table(own), '')
        yield from ('Missing points:\n', *_missing(own), '')


def _moved(motion: MotionFacts) -> str:
    return (
        f'{motion.note}. n = {motion.n}, {motion.duration:g} s; self-difference of the reference '
        f'{motion.self_difference:.0e} rad.\n'
    )


def _motion_table(runs: Sequence[RunPoint]) -> list[str]:
    titles = ['time [ms]', 'evaluations', 'trajectory error [rad]', 'energy error']
    lines = header(' | '.join(['integrator', 'step or tolerance', *titles]))
    for run in runs:
        if run.minimum is None or run.median is None:
            found = ['missing', '-', '-', '-']
        else:
            evaluations = '-' if run.evaluations is None else f'{run.evaluations:.0f}'
            errors = [error_cell(run.trajectory_error), error_cell(run.energy_error)]
            found = [least_and_median(run.minimum, run.median, 1e3), evaluations, *errors]
        lines.append(cells(run.way, run.setting, *found))
    return lines


def _missing(runs: Sequence[RunPoint]) -> list[str]:
    found = [f'- {run.way}, {run.setting}: {run.status}' for run in runs if run.status != 'ok']
    return found or ['- none']


def run(folder: Path, quick: bool = False) -> int:
    """Measure, write the report into a folder, print its files and return the exit status, 0."""
    if quick:
        findings = survey(against_error.QUICK, work_precision.QUICK, QUICK_QUANTITIES)
    else:
        findings = survey(against_error.Plan(), work_precision.Plan(), QUANTITIES)
    print('\n'.join(str(path) for path in write(findings, folder)))
    return 0


def write(findings: Findings, folder: Path) -> list[Path]:
    """
    Write the page, its JSON and the plots as PNG and SVG, and return their paths.

    The plots are skipped if matplotlib (extra `report`) is not installed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    page, data = folder / f'{NAME}.md', folder / f'{NAME}.json'
    page.write_text(markdown(findings), encoding='utf-8')
    data.write_text(json_text(asdict(findings)), encoding='utf-8')
    plots = against_error_plots.write(
        findings.cases, findings.points, findings.motions, findings.runs, folder
    )
    plots += quantity_plot.write(findings.quantities, folder, f'{NAME}-quantities')
    return [page, data, *plots]
