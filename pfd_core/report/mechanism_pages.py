# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Is the default ever less accurate than Pinocchio's aba? The page mechanisms.md.

Every hard case and mechanism is measured at many states: at seed SEED, on which limits of
pfd_core.kernels.auto were chosen, and at seed HELD_OUT, on which nothing was chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from pfd_core.kernels.auto import default
from pfd_core.report.cases.hard_cases import CASES, MECHANISMS, QUICK, ROUNDING, Case
from pfd_core.report.cases.problems import SEED, Problem, drawing
from pfd_core.report.measure.errors import kernel_answer, peer_answers
from pfd_core.report.measure.processes import each
from pfd_core.report.measure.reference import errors, reference
from pfd_core.report.render.markdown import Columns, bullets, page, table, write
from pfd_core.report.render.numbers import short

PEER = 'Pinocchio aba'
HELD_OUT = 20261124
# States of a case, and of a chain of more than LONG joints.
STATES, FEW_STATES, LONG = 40, 4, 40
SHARES = (0.5, 0.9)
# The limit of the default is FACTOR times the peer's error, and at least FLOOR roundings: of the
# parameters, of tau - bias, of the last product and of the last sum.
FACTOR, FLOOR = 2.0, 4.0
# Requested method and steps of refinement, by the name of a column.
WAYS = {
    'default': ('auto', 0),
    'refine=1': ('auto', 1),
    'composite_body': ('composite_body', 0),
    'articulated_body': ('articulated_body', 0),
}
# Methods other than the default are measured on chains of up to so many joints.
SHORT = 12

Errors = tuple[float, ...]


@dataclass(frozen=True)
class Result:
    """
    Errors at the states of a case.

    Attributes
    ----------
    name : str
        Name of the case.
    seed : int
        Seed of the states.
    auto : str
        What 'auto' selects.
    found : dict
        Name in WAYS, or PEER where it is installed -> error [u] that SHARES of the states do not
        exceed.

    """

    name: str
    seed: int
    auto: str
    found: dict[str, Errors]

    @property
    def larger(self) -> bool:
        """Whether an error of the default is larger than the peer's."""
        pairs = zip(self.found['default'], self.found.get(PEER, (np.inf, np.inf)), strict=True)
        return any(own > peer for own, peer in pairs)

    @property
    def better(self) -> dict[str, float]:
        """Errors of the default over the errors of each other kernel, where above FACTOR."""
        return {
            way: ratio
            for way in WAYS
            if way in self.found
            and (ratio := min(map(_over, self.found['default'], self.found[way]))) > FACTOR
        }

    @property
    def worst_ratio(self) -> float:
        """Largest error of the default over FACTOR times the peer's; 0 without the peer."""
        if PEER not in self.found:
            return 0.0
        pairs = zip(self.found['default'], self.found[PEER], strict=True)
        return max(own / max(FACTOR * peer, FLOOR) for own, peer in pairs)


def _over(own: float, other: float) -> float:
    """Return how many times an error exceeds another one, 0 for errors of a few roundings."""
    return own / max(other, 1.0) if own > FLOOR else 0.0


def drawn(case: Case, seed: int) -> Problem:
    """Return the problem of a case at states of a seed."""
    n = case.make().plant.robot.n
    with drawing(seed, STATES if n <= LONG else FEW_STATES):
        return case.make()


def measure(name: str, problem: Problem, seed: int = SEED, ways: Sequence[str] = ()) -> Result:
    """Return the errors of some WAYS, default all, and of the peer; ImportError without mpmath."""
    known, u = reference(problem, certified=False), ROUNDING['float64']
    n = problem.plant.robot.n
    wanted = ways or [way for way in WAYS if n <= SHORT or WAYS[way][0] == 'auto']
    kernels = {way: default(problem.plant, *WAYS[way]) for way in wanted}
    answers = {
        (method, steps): kernel_answer(problem, 'float64', steps, method)
        for method, steps in set(kernels.values())
    }
    by_name = {way: answers[kernel] for way, kernel in kernels.items()}
    # The first answer of the peers, if any is installed.
    by_name |= {peer: answer for peer, answer in islice(peer_answers(problem), 1) if peer == PEER}
    found = {
        way: tuple(np.quantile(errors(answer, known) / u, SHARES).tolist())
        for way, answer in by_name.items()
    }
    method, steps = kernels['default']
    return Result(name, seed, method + ', refined' * steps, found)


def _cell(way: str, one: Result) -> str:
    return ', '.join(f'{x:.2g}' for x in one.found[way]) if way in one.found else '-'


COLUMNS: Columns = {
    'case': 'name',
    'method of auto': 'auto',
    **{way: partial(_cell, way) for way in (*WAYS, PEER)},
    'share of the limit': lambda one: f'{one.worst_ratio:.2f}' if PEER in one.found else '-',
}


def markdown(results: Sequence[Result]) -> str:
    """Return the page."""
    groups = [[one for one in results if one.seed == seed] for seed in (SEED, HELD_OUT)]
    return page(
        'mechanisms',
        command='pfd report mechanisms',
        factor=FACTOR,
        floor=FLOOR,
        peer=PEER,
        seed=SEED,
        held_out=HELD_OUT,
        states=STATES,
        few=FEW_STATES,
        long=LONG,
        short=SHORT,
        counts=_counted(groups, lambda one: one.worst_ratio > 1),
        larger=_counted(groups, lambda one: one.larger),
        better=bullets(
            (
                f'{one.name}, seed {one.seed}: '
                + ', '.join(
                    f'{way} {short(ratio)} times less' for way, ratio in one.better.items()
                )
                for one in results
                if one.better
            ),
            '- none',
        ),
        worse=bullets(
            (
                f'{one.name}, seed {one.seed}: {one.worst_ratio:.2f}'
                for one in results
                if one.worst_ratio > 1
            ),
            '- none',
        ),
        results=table(COLUMNS, groups[0]),
        held=table(COLUMNS, groups[1]),
    )


def _counted(groups: Sequence[Sequence[Result]], holds: Callable[[Result], bool]) -> str:
    """Return in how many cases with the peer something holds, for each seed."""
    with_peer = [[one for one in group if PEER in one.found] for group in groups]
    return ' and '.join(f'{sum(map(holds, group))} of {len(group)}' for group in with_peer)


def run(folder: Path, quick: bool = False) -> list[Path]:
    """Measure everything, or quickly one case, and write the page into a folder."""
    cases = QUICK if quick else (*CASES, *MECHANISMS)
    items = [(case, seed) for seed in (SEED, HELD_OUT) for case in cases]
    results = list(each(_measured, items, 'mechanisms'))
    return write(folder, 'mechanisms', markdown(results), results)


def _measured(item: tuple[Case, int]) -> Result:
    case, seed = item
    return measure(case.name, drawn(case, seed), seed)
