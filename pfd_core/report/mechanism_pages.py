# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors of the default method on mechanisms in unusual proportions: the page mechanisms.md.

Each mechanism has one seeded state. `before` holds the errors at the commit ed0d2c3, before the
grouped parameters were exact and `auto` looked at the pivots of a plain kernel; they were measured
with the same table.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
import json
from pathlib import Path

import numpy as np

from pfd_core.kernels.auto import choose
from pfd_core.report.hard_case_errors import kernel_answer, peer_answers, worst
from pfd_core.report.hard_case_mechanisms import (
    dropped,
    extended,
    graded,
    lifted,
    loaded,
    on_one_axis,
    weighed,
)
from pfd_core.report.hard_case_problems import Problem
from pfd_core.report.hard_case_reference import reference
from pfd_core.report.markdown import cells, header, order, paragraph

COMMAND = 'pfd report mechanisms'
PEER = 'Pinocchio aba'
# A default that is so many times worse than the peer, and than the rounding of the result, is
# counted.
WORSE = 10.0
ROUNDING = 2.0**-53


@dataclass(frozen=True)
class Mechanism:
    """
    A mechanism of the page.

    Attributes
    ----------
    name, cause : str
        Name, and the reason why it is hard.
    make : callable
        Makes the problem.
    before : tuple of float
        Error of the default without and with one step of refinement at ed0d2c3, one digit.

    """

    name: str
    cause: str
    make: Callable[[], Problem]
    before: tuple[float, float]


@dataclass(frozen=True)
class Result:
    """
    Errors at a mechanism.

    Attributes
    ----------
    name, cause : str
        As in the table.
    before, after : tuple of float
        Error of the default without and with one step of refinement.
    methods : tuple of str
        The methods that `auto` stands for, without and with refinement.
    peer : float or None
        Error of Pinocchio's `aba`, where it is installed.

    """

    name: str
    cause: str
    before: tuple[float, float]
    after: tuple[float, float]
    methods: tuple[str, str]
    peer: float | None


LIFT = 'a distance along an axis to a parallel joint'
DROP = 'the origin of a frame far along its axis, its neighbours near'
HEAVY_SLIDES = 'slides under a heavy last link'
ONE_AXIS = 'several joints on one axis, little inertia between'
RATIOS = 'each link a hundred times heavier than the one before'
LOAD = 'a load a thousand times heavier than the arm'


def _lift(axes: str, index: int, distance: float) -> Callable[[], Problem]:
    return lambda: lifted(axes, {index: distance})


def _lift_and_back(distance: float) -> Callable[[], Problem]:
    return lambda: lifted('yzzzyz', {1: distance, 2: -distance})


def _drop(axes: str, index: int, distance: float) -> Callable[[], Problem]:
    return lambda: dropped(axes, index, distance)


def _slides(mass: float) -> Callable[[], Problem]:
    return lambda: weighed('XYZXYZ', {5: mass})


MECHANISMS: Sequence[Mechanism] = (
    Mechanism('lift_10m', LIFT, _lift('yzzyzy', 1, 10.0), (3e-14, 1e-16)),
    Mechanism('lift_100m', LIFT, _lift('yzzyzy', 1, 100.0), (4e-13, 6e-16)),
    Mechanism('lift_1km', LIFT, _lift('yzzyzy', 1, 1e3), (5e-11, 2e-16)),
    Mechanism('lift_1000km', LIFT, _lift('yzzyzy', 1, 1e6), (3e-5, 1e-7)),
    Mechanism('lift_of_base_10m', LIFT, _lift('zzyzyz', 0, 10.0), (4e-14, 9e-17)),
    Mechanism('lift_of_base_1km', LIFT, _lift('zzyzyz', 0, 1e3), (7e-10, 2e-16)),
    Mechanism('lift_of_base_1000km', LIFT, _lift('zzyzyz', 0, 1e6), (7e-4, 8e-7)),
    Mechanism('lift_and_back_10m', LIFT, _lift_and_back(10.0), (6e-14, 2e-16)),
    Mechanism('lift_and_back_1km', LIFT, _lift_and_back(1e3), (2e-9, 3e-15)),
    Mechanism('lift_and_back_1000km', LIFT, _lift_and_back(1e6), (2e-3, 4e-6)),
    Mechanism('lift_on_a_lever_1km', LIFT, _lift('yyzzY', 2, 1e3), (3e-9, 3e-16)),
    Mechanism('lift_of_scara_10m', LIFT, _lift('yzzZz', 1, 10.0), (5e-14, 3e-16)),
    Mechanism('lift_of_scara_1km', LIFT, _lift('yzzZz', 1, 1e3), (5e-11, 1e-16)),
    Mechanism('drop_at_base_10m', DROP, _drop('zzyzyz', 1, 10.0), (6e-14, 2e-16)),
    Mechanism('drop_at_base_1km', DROP, _drop('zzyzyz', 1, 1e3), (5e-10, 1e-16)),
    Mechanism('drop_at_base_1000km', DROP, _drop('zzyzyz', 1, 1e6), (5e-4, 7e-7)),
    Mechanism('drop_10m', DROP, _drop('yzzyzy', 2, 10.0), (6e-14, 6e-16)),
    Mechanism('drop_1km', DROP, _drop('yzzyzy', 2, 1e3), (7e-10, 3e-14)),
    Mechanism('drop_1000km', DROP, _drop('yzzyzy', 2, 1e6), (7e-4, 5e-7)),
    Mechanism('drop_with_slide_1km', DROP, _drop('yzzZyz', 2, 1e3), (2e-10, 2e-14)),
    Mechanism('drop_with_slide_1000km', DROP, _drop('yzzZyz', 2, 1e6), (2e-4, 4e-8)),
    Mechanism('six_slides_tip_1e2', HEAVY_SLIDES, _slides(1e2), (8e-15, 6e-18)),
    Mechanism('six_slides_tip_1e4', HEAVY_SLIDES, _slides(1e4), (3e-13, 5e-18)),
    Mechanism('six_slides_tip_1e8', HEAVY_SLIDES, _slides(1e8), (6e-9, 6e-18)),
    Mechanism('two_slides_tip_1e8', HEAVY_SLIDES, lambda: weighed('ZZ', {1: 1e8}), (1e-8, 1e-17)),
    Mechanism(
        'slides_and_turns_ratio_100', RATIOS, lambda: graded('yZzYxZ', 100.0), (2e-13, 1e-16)
    ),
    Mechanism(
        'slides_lifted_1km',
        'distances of 1 km along slides and turns',
        lambda: lifted('yZzYxz', {1: 1e3, 3: 1e3}),
        (4e-15, 3e-16),
    ),
    Mechanism(
        'slides_out_1km', 'slides up to 1 km out', lambda: extended('yZzYxz', 1e3), (4e-16, 1e-16)
    ),
    Mechanism(
        'five_on_one_axis_1e-4', ONE_AXIS, lambda: on_one_axis('zzzzzy', 5, 1e-4), (4e-14, 1e-16)
    ),
    Mechanism(
        'five_on_one_axis_1e-8', ONE_AXIS, lambda: on_one_axis('zzzzzy', 5, 1e-8), (4e-10, 7e-17)
    ),
    Mechanism(
        'three_on_one_axis_1e-8', ONE_AXIS, lambda: on_one_axis('zzzyz', 3, 1e-8), (8e-17, 4e-17)
    ),
    Mechanism(
        'turn_and_slide_on_one_axis',
        ONE_AXIS,
        lambda: on_one_axis('zZzZy', 4, 1e-8, 1e-6),
        (6e-17, 4e-17),
    ),
    Mechanism('turns_ratio_100', RATIOS, lambda: graded('yzyzyz', 100.0), (2e-14, 2e-16)),
    Mechanism('planar_ratio_100', RATIOS, lambda: graded('yyyyyy', 100.0), (2e-10, 1e-16)),
    Mechanism(
        'planar_tip_1e4',
        'a heavy last link on parallel joints',
        lambda: weighed('yyyyyy', {5: 1e4}),
        (3e-12, 4e-17),
    ),
    Mechanism('ur5_load_1e4', LOAD, lambda: loaded('ur5', 1e4, 0.125), (2e-13, 2e-16)),
    Mechanism('panda_load_1e4_at_8m', LOAD, lambda: loaded('panda', 1e4, 8.0), (4e-10, 7e-17)),
)

INTRODUCTION = f"""# Errors of the default on mechanisms in unusual proportions

Written by `{COMMAND}`. An error is |x - qdd| / |qdd|, Euclidean, in float64, against
50 digits ([hard-cases.md](hard-cases.md)). *default* is the kernel of `method='auto'`, *refined*
the same with `refine=1`. *before* are the errors at the commit ed0d2c3
([decision 0024](../decisions/0024-accuracy-of-the-default.md)).
"""


def measure(mechanism: Mechanism) -> Result:
    """Return the errors at a mechanism; ImportError without mpmath."""
    problem = mechanism.make()
    known = reference(problem)
    plain, refined = (worst(kernel_answer(problem, 'float64', k), known) for k in (0, 1))
    peers = {name: worst(np.asarray(found), known) for name, found in peer_answers(problem)}
    return Result(
        mechanism.name,
        mechanism.cause,
        mechanism.before,
        (plain, refined),
        (choose(problem.plant, 'auto', 0), choose(problem.plant, 'auto', 1)),
        peers.get(PEER),
    )


def is_worse(error: float, peer: float | None) -> bool:
    """Return whether an error is more than WORSE times that of the peer."""
    return peer is not None and error > WORSE * max(peer, ROUNDING)


def markdown(results: Sequence[Result]) -> str:
    """Return the page."""
    before, after = (
        sum(is_worse(errors[0], one.peer) for one in results for errors in [getattr(one, when)])
        for when in ('before', 'after')
    )
    count = paragraph(
        f'The default is more than {WORSE:g} times worse than {PEER} in {after} of '
        f'{len(results)} mechanisms; before, in {before}.'
    )
    table = header(
        'mechanism | cause | default before | default | auto is | refined before | refined '
        f'| {PEER}'
    )
    for one in results:
        peer = 'absent' if one.peer is None else order(one.peer)
        errors = [order(x) for pair in zip(one.before, one.after, strict=True) for x in pair]
        table.append(cells(one.name, one.cause, *errors[:2], one.methods[0], *errors[2:], peer))
    return '\n'.join([INTRODUCTION, count, *table]) + '\n'


def run(folder: Path) -> list[Path]:
    """Measure everything and write mechanisms.md and mechanisms.json into a folder."""
    results = [measure(mechanism) for mechanism in MECHANISMS]
    folder.mkdir(parents=True, exist_ok=True)
    page, data = folder / 'mechanisms.md', folder / 'mechanisms.json'
    page.write_text(markdown(results), encoding='utf-8')
    data.write_text(json.dumps([asdict(one) for one in results], indent=1) + '\n')
    return [page, data]
