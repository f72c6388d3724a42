# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors of accelerations and motions: the page hard-cases.md.

    cases, errors   ill-conditioned and ordinary cases against 50 digits, with a bound
    compared        the default compared with pinocchio.aba at the cases and at mechanisms
    boxes, checks   errors over thousands of states of arms, against longdouble
    motions, runs   runs of hard motions against stored references
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.boxes import (
    ARMS,
    CHECKED,
    DEFAULT,
    PEER,
    REFINED,
    blocks,
    box,
    box_lines,
    draw_boxes,
    drawn,
    more_accurate,
)
from benchmarks.cases.hard_cases import CASES, MECHANISMS, ROUNDING, Case
from benchmarks.cases.motions import CHECKS, ENDS, HARD, Motion
from benchmarks.cases.problems import Problem, drawing
from benchmarks.cases.quantities import STATE
from benchmarks.peers.answers import first_answer, kernel_answer, peer_answer
from benchmarks.plots import save
from benchmarks.references.accelerations import (
    FACTOR,
    ROUNDINGS,
    SPREAD,
    Reference,
    differences,
    errors,
    kappa_j,
    kappa_s,
    norm,
    predicted,
    reference,
)
from benchmarks.run import each
from benchmarks.table import Columns, bullets, order, page, paragraph, short, table, yes
from pfd_core.algorithms.grouped.energy import record_energy
from pfd_core.kernels.auto import default
from pfd_core.kernels.compile import compile_kernel
from pfd_core.machine.emulator import run
from pfd_core.simulation.embedded_pairs import PAIRS
from pfd_core.simulation.simulator import Simulator

Row = dict[str, Any]
Tables = dict[str, list[Row]]
U = ROUNDING['float64']
QUICK = ('collinear_axes_1e-12', 'so100_fall')
# Seeds of states on which no number of pfd_core was chosen: of the bounds, and of `compared`.
HELD_OUT, COMPARED = 20261125, 20261124
# Held-out states of a case, and the most joints of a chain with more than one, and with any.
STATES, FEW, LONGEST = 4, 12, 60
# States of `compared`, and of a chain of more than LONG joints.
MANY, SOME, LONG = 40, 4, 40
# The limit of the default is TWICE the peer's error, and at least FLOOR roundings
# (docs/decisions/0040-a-default-that-is-not-worse.md).
TWICE, FLOOR = 2.0, 4.0
# Steps of refinement of a column.
KERNELS = {DEFAULT: 0, REFINED: 1}
# An error estimate is compared where the error is above SHOWN roundings; target: factor WITHIN.
SHOWN, WITHIN = 1e-13 / U, 3.0
# Absolute tolerance of an adaptive run, as a part of the relative one.
ABSOLUTE = 0.1
ENERGY_SAMPLES = 6000


def measure(quick: bool = False) -> Tables:
    """Return the rows of all tables, measured on all processors."""
    cases = [case for case in CASES if not quick or case.name in QUICK]
    motions = [motion for motion in HARD if not quick or motion.name in QUICK]
    arms = ('planar2',) if quick else ARMS
    jobs: list[Callable[[], Tables]] = [
        *(partial(case_rows, case) for case in cases),
        *(partial(compared_rows, case) for case in (*cases, *(() if quick else MECHANISMS))),
        *(partial(box_rows, name, 50 if quick else 10_000) for name in arms),
        *(partial(motion_rows, motion) for motion in motions),
    ]
    tables: Tables = {}
    for found in each(_measured, jobs, 'hard cases', _is_long):
        for name, rows in found.items():
            tables.setdefault(name, []).extend(rows)
    return tables


def _measured(job: Callable[[], Tables]) -> Tables:
    return job()


def _is_long(job: Any) -> bool:
    """Return whether a job takes minutes: it begins first."""
    return str(getattr(job.args[0], 'name', job.args[0])).endswith('_200')


def case_rows(case: Case) -> Tables:
    """Return a case, and errors of our kernels and of the peer at its states and held-out ones."""
    own = case.make()
    n = own.plant.robot.n
    known, conditions, rows = _bounded(case.name, own)
    peer = peer_answer(own)
    if peer is not None:
        row = {'case': case.name, 'way': PEER, 'dtype': 'float64', 'refine': 0}
        rows.append(row | {'error': errors(peer, known).max()})
    rows = [{'states': 'own'} | row for row in rows]
    if n <= LONGEST:
        with drawing(HELD_OUT, STATES if n <= FEW else 1):
            rows += [{'states': 'held out'} | row for row in _bounded(case.name, case.make())[2]]
    facts = {'case': case.name, 'cause': case.cause, 'n': n, 'states': len(own.states['q'])}
    kappas = {'kappa_s': conditions[0].max(), 'kappa_j': conditions[1].max()}
    return {'cases': [facts | kappas], 'errors': rows}


def _bounded(name: str, problem: Problem) -> tuple[Reference, tuple[Any, Any], list[Row]]:
    """Return reference, kappa_s and kappa_j, and errors of our kernels with their bounds."""
    known = reference(problem)
    conditions = kappa_s(problem, known), kappa_j(problem)
    return (
        known,
        conditions,
        [{'case': name} | row for row in kernel_rows(problem, known, *conditions)],
    )


def kernel_rows(
    problem: Problem, known: Reference, by_inputs: NDArray[Any], by_factor: NDArray[Any]
) -> Iterator[Row]:
    """
    Yield the errors of the kernel of 'auto' in both number formats, without and with refinement.

    `by_inputs` and `by_factor` are kappa_s and kappa_j. `share` is the largest error over its
    bound; None where the bound of a state is 1 or more. `before` is the error of the answer that
    refinement corrects, and `estimate` the kernel's estimate over it.
    """
    found: dict[Any, Row] = {}
    for dtype in ROUNDING:
        for refine in (0, 1):
            key = dtype, *default(problem.plant, 'auto', refine)
            if key not in found:
                _, method, steps = key
                first, row = _first(problem, known, dtype) if steps else (None, {})
                error = errors(kernel_answer(problem, dtype, refine), known)
                bounds = FACTOR * predicted(dtype, by_inputs, by_factor, first)
                share = (error / bounds).max() if (bounds < 1).all() else None
                row |= {'way': 'pfd', 'dtype': dtype, 'error': error.max(), 'share': share}
                found[key] = row | {'method': method + ', refined' * steps}
            yield found[key] | {'refine': refine}


def _first(problem: Problem, known: Reference, dtype: str) -> tuple[Any, Row]:
    """Return the estimated errors of the first answer, and the largest error with its ratio."""
    before, estimates = first_answer(problem, dtype)
    true = differences(before, known.qdd)
    k = int(np.argmax(true))
    sound = 0 < true[k] < np.inf and np.isfinite(estimates[k])
    # An estimate is relative to the answer, which is nearly zero for an arm in equilibrium.
    norms = (norm(known.qdd) / known.scale).astype(np.float64)
    ratio = estimates[k] / true[k] if sound else None
    return estimates * norms, {'before': true[k], 'estimate': ratio}


def held_out(case: Case) -> Problem:
    """Return the problem of a case at the states of `compared`."""
    with drawing(COMPARED, MANY if case.make().plant.robot.n <= LONG else SOME):
        return case.make()


def compared_rows(case: Case) -> Tables:
    """Return the row of a case in `compared`."""
    return {'compared': [compared(case.name, held_out(case))]}


def compared(name: str, problem: Problem, ways: Sequence[str] = tuple(KERNELS)) -> Row:
    """Return median and 90 % quantile of the errors [u] of our kernels and of the peer."""
    known = reference(problem)
    method, steps = default(problem.plant, 'auto', 0)
    row: Row = {'case': name, 'method': method + ', refined' * steps}
    answers: dict[Any, Any] = {}
    for way in ways:
        kernel = default(problem.plant, 'auto', KERNELS[way])
        if kernel not in answers:
            answers[kernel] = kernel_answer(problem, 'float64', kernel[1], kernel[0])
        row[way] = _two(answers[kernel], known)
    peer = peer_answer(problem)
    return row if peer is None else row | {PEER: _two(peer, known)}


def _two(answer: NDArray[Any], known: Reference) -> list[float]:
    return list(map(float, np.quantile(errors(answer, known) / U, (0.5, 0.9))))


def over_limit(row: Mapping[str, Any]) -> float:
    """Return the largest error of the default over its limit; 0 without the peer."""
    pairs = zip(row[DEFAULT], row.get(PEER, ()), strict=False)
    return max((own / max(TWICE * peer, FLOOR) for own, peer in pairs), default=0.0)


def box_rows(name: str, states: int) -> Tables:
    """Return the distributions of an arm's errors, and the check of their reference."""
    many, some = drawn(name, states), drawn(name, CHECKED)
    known = [reference(block, wide=True) for block in blocks(many)]
    exact = Reference(*(np.concatenate([getattr(x, k) for x in known]) for k in ('qdd', 'scale')))
    state = [many.states[key] for key in STATE]
    found = {}
    for dtype in ROUNDING:
        for way, refine in KERNELS.items():
            kernel = compile_kernel(many.plant.robot, dtype=dtype, refine=refine)
            found[way, dtype] = np.asarray(kernel(*(np.asarray(x, dtype) for x in state)))
    peer = peer_answer(many)
    if peer is not None:
        found[PEER, 'float64'] = peer
    rows = [
        box(errors(qdd, exact) / ROUNDING[dtype], arm=name, way=way, dtype=dtype)
        for (way, dtype), qdd in found.items()
    ]
    off = errors(reference(some, wide=True).qdd, reference(some)).max() / U
    return {'boxes': rows, 'checks': [{'arm': name, 'distance': off}]}


def motion_rows(motion: Motion) -> Tables:
    """Return a hard motion and its runs."""
    row = {'motion': motion.name, 'cause': motion.cause, 'duration': motion.duration}
    row |= {'self_difference': ENDS[motion.name]['self_difference']}
    runs = [run_row(motion, check) for check in CHECKS if check['motion'] == motion.name]
    return {'motions': [row], 'runs': runs}


def run_row(motion: Motion, check: Row) -> Row:
    """Return the error of a check's run; infinite if a state is not finite."""
    duration, step = check['duration'], check['step']
    settings: Row = {'integrator': check['integrator']}
    if check['integrator'] in PAIRS:
        settings |= {'rtol': step, 'atol': ABSOLUTE * step, 'refine': 1, 'dense': False}
        found: Any = motion.integrated(duration, **settings)
    else:
        settings |= {'step_size': step, 'substeps': 1, 'dtype': check['dtype']}
        sim = Simulator(motion.robot, motion.scene, **settings)
        sim.reset(q=motion.q, qd=motion.qd)
        found = sim.rollout(np.zeros((round(duration / step), motion.robot.n), check['dtype']))
    error = np.inf
    if found.status == 'ok' and check['quantity'] == 'angle':
        error = np.abs(found.q[-1] - np.array(ENDS[motion.name]['q'], float)).max()
    elif found.status == 'ok':
        every = max(1, len(found.q) // ENERGY_SAMPLES)
        states = {'q': found.q[::every], 'qd': found.qd[::every]}
        kinetic, potential = run(record_energy(motion.plant), states)['energy'].T
        total = kinetic + potential
        error = np.abs(total - total[0]).max() / kinetic.max()
    return check | {'error': float(error)}


def text(data: Mapping[str, Any]) -> str:
    """Return the page."""
    own, held = _ours(data, 'own'), _ours(data, 'held out')
    known = [row for row in data['compared'] if PEER in row]
    runs = data['runs']
    return page(
        'hard-cases',
        command='python -m benchmarks hard-cases',
        count=len(data['cases']),
        outcome=more_accurate(data['boxes']),
        met=_met(own),
        held_met=_met(held),
        missed=bullets(_listed((*own, *held), lambda share: (share or 0.0) > 1), '- none'),
        unbounded=bullets(_listed((*own, *held), lambda share: share is None), '- none'),
        times=FACTOR,
        spread=SPREAD,
        roundings=ROUNDINGS,
        states=STATES,
        few=FEW,
        longest=LONGEST,
        within=WITHIN,
        shown=SHOWN,
        wrong=bullets(_wrong((*own, *held)), '- none'),
        cases=table(_case_columns(data), data['cases']),
        compared_count=len(known),
        larger=sum(any(a > b for a, b in zip(x[DEFAULT], x[PEER], strict=True)) for x in known),
        above=sum(over_limit(row) > 1 for row in known),
        twice=TWICE,
        floor=FLOOR,
        many=MANY,
        some=SOME,
        long=LONG,
        compared=table(COMPARED_COLUMNS, data['compared']),
        arms=len({row['arm'] for row in data['boxes']}),
        box_states=max(row['states'] for row in data['boxes']),
        distance=short(max(row['distance'] for row in data['checks'])),
        checked=CHECKED,
        boxes=box_lines(data['boxes']),
        runs_met=f'{sum(map(_is_met, runs))} of {len(runs)}',
        motions=table(MOTION_COLUMNS, data['motions']),
        runs=table(RUN_COLUMNS, runs),
    )


def summary(data: Mapping[str, Any]) -> str:
    """Return the outcome as a sentence, for README.md."""
    own, held = _ours(data, 'own'), _ours(data, 'held out')
    states = max(row['states'] for row in data['boxes'])
    unbounded = sum(row['share'] is None for row in (*own, *held))
    sentence = (
        f'[Errors](docs/report/hard-cases.md) at {len(data["cases"])} ill-conditioned and '
        f'ordinary cases against 50 digits, in float64 and float32: {_met(own)} are within '
        f'{FACTOR:g} times the error that analysis predicts, at held-out states {_met(held)}; '
        f'{unbounded} have no bound. Over {states} states each, `pinocchio.aba` has '
        f'{more_accurate(data["boxes"])}.'
    )
    return paragraph(sentence) + '\n'


def _ours(data: Mapping[str, Any], states: str) -> list[Row]:
    return [row for row in data['errors'] if (row['way'], row['states']) == ('pfd', states)]


def _met(rows: Sequence[Row]) -> str:
    shares = [row['share'] for row in rows if row['share'] is not None]
    return f'{sum(share <= 1 for share in shares)} of {len(shares)}'


def _kernel(row: Row) -> str:
    return f'{row["case"]}, {row["dtype"]}{", refine=1" * row["refine"]}, {row["states"]} states'


def _listed(rows: Sequence[Row], wanted: Callable[[float | None], bool]) -> Iterator[str]:
    for row in rows:
        if wanted(row['share']):
            share = '' if row['share'] is None else f', {row["share"]:.2g} times its bound'
            yield f'{_kernel(row)}: {order(row["error"])}{share}'


def _wrong(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the error estimates that differ from an error of more than SHOWN too much."""
    for row in rows:
        ratio, before = row.get('estimate'), row.get('before')
        if ratio is not None and before is not None and row['refine']:
            shown = before > SHOWN * ROUNDING[row['dtype']]
            if shown and not 1 / WITHIN <= ratio <= WITHIN:
                yield f'{_kernel(row)}: {ratio:.2g} times {order(before)}'


def _case_columns(data: Mapping[str, Any]) -> Columns:
    found = {
        (row['case'], row['way'], row['dtype'], row['refine']): row
        for row in data['errors']
        if row['states'] == 'own'
    }

    def error(way: str, dtype: str, refine: int) -> Callable[[Any], object]:
        def cell(one: Row) -> str:
            row = found.get((one['case'], way, dtype, refine))
            if row is None:
                return '-'
            return 'lost' if row['error'] is None else short(row['error'] / ROUNDING[dtype])

        return cell

    def share(one: Row) -> str:
        rows = (row for key, row in found.items() if key[0] == one['case'])
        shares = [row['share'] for row in rows if row.get('share') is not None]
        return f'{max(shares):.2g}' if shares else '-'

    return {
        'case': 'case',
        'n': 'n',
        'kappa_J': lambda one: f'{one["kappa_j"]:.0e}',
        'kappa_s': lambda one: short(one['kappa_s']),
        'default': error('pfd', 'float64', 0),
        'refine=1': error('pfd', 'float64', 1),
        PEER: error(PEER, 'float64', 0),
        'float32': error('pfd', 'float32', 0),
        'float32, refine=1': error('pfd', 'float32', 1),
        'error / bound': share,
        'method of auto': lambda one: found[one['case'], 'pfd', 'float64', 0]['method'],
        'cause': 'cause',
    }


def _pair(way: str) -> Callable[[Any], object]:
    return lambda row: ', '.join(map(short, row[way])) if way in row else '-'


def _is_met(row: Row) -> bool:
    return row['error'] is not None and bool(row['error'] <= row['bound'])


COMPARED_COLUMNS: Columns = {
    'case': 'case',
    'method of auto': 'method',
    **{way: _pair(way) for way in (*KERNELS, PEER)},
    'error / limit': lambda row: f'{over_limit(row):.2f}' if PEER in row else '-',
}
MOTION_COLUMNS: Columns = {
    'motion': 'motion',
    'time [s]': 'duration',
    'self-difference [rad]': lambda row: order(row['self_difference']),
    'cause': 'cause',
}
RUN_COLUMNS: Columns = {
    'motion': 'motion',
    'integrator': 'integrator',
    'format': 'dtype',
    'step [s] or rtol': lambda row: f'{row["step"]:g}',
    'time [s]': 'duration',
    'error of': 'quantity',
    'found': lambda row: order(row['error']),
    'bound': lambda row: f'{row["bound"]:g}',
    'met': lambda row: yes(_is_met(row)),
}


def plots(data: Mapping[str, Any], folder: Path) -> list[Path]:
    """Draw the errors over thousands of states of arms as box plots."""
    title = 'Error of the acceleration, float64: 1, 25, 50, 75 and 99 % of the states, and largest'

    def draw(figure: Any) -> None:
        draw_boxes(figure.subplots(), data['boxes'], title)

    return save(draw, folder, 'hard-cases', (11, 4.5), ('png',))
