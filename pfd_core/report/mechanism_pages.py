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
from functools import partial
from pathlib import Path
from typing import Any

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
from pfd_core.report.markdown import cells, header, json_text, order, paragraph

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
        The methods that `auto` selects, without and with refinement.
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


# Name, cause, function and arguments that make the problem, errors before.
_TABLE: Sequence[tuple[str, str, Callable[..., Problem], tuple[Any, ...], tuple[float, float]]] = (
    ('lift_10m', LIFT, lifted, ('yzzyzy', {1: 10.0}), (3e-14, 1e-16)),
    ('lift_100m', LIFT, lifted, ('yzzyzy', {1: 100.0}), (4e-13, 6e-16)),
    ('lift_1km', LIFT, lifted, ('yzzyzy', {1: 1e3}), (5e-11, 2e-16)),
    ('lift_1000km', LIFT, lifted, ('yzzyzy', {1: 1e6}), (3e-5, 1e-7)),
    ('lift_of_base_10m', LIFT, lifted, ('zzyzyz', {0: 10.0}), (4e-14, 9e-17)),
    ('lift_of_base_1km', LIFT, lifted, ('zzyzyz', {0: 1e3}), (7e-10, 2e-16)),
    ('lift_of_base_1000km', LIFT, lifted, ('zzyzyz', {0: 1e6}), (7e-4, 8e-7)),
    ('lift_and_back_10m', LIFT, lifted, ('yzzzyz', {1: 10.0, 2: -10.0}), (6e-14, 2e-16)),
    ('lift_and_back_1km', LIFT, lifted, ('yzzzyz', {1: 1e3, 2: -1e3}), (2e-9, 3e-15)),
    ('lift_and_back_1000km', LIFT, lifted, ('yzzzyz', {1: 1e6, 2: -1e6}), (2e-3, 4e-6)),
    ('lift_on_a_lever_1km', LIFT, lifted, ('yyzzY', {2: 1e3}), (3e-9, 3e-16)),
    ('lift_of_scara_10m', LIFT, lifted, ('yzzZz', {1: 10.0}), (5e-14, 3e-16)),
    ('lift_of_scara_1km', LIFT, lifted, ('yzzZz', {1: 1e3}), (5e-11, 1e-16)),
    ('drop_at_base_10m', DROP, dropped, ('zzyzyz', 1, 10.0), (6e-14, 2e-16)),
    ('drop_at_base_1km', DROP, dropped, ('zzyzyz', 1, 1e3), (5e-10, 1e-16)),
    ('drop_at_base_1000km', DROP, dropped, ('zzyzyz', 1, 1e6), (5e-4, 7e-7)),
    ('drop_10m', DROP, dropped, ('yzzyzy', 2, 10.0), (6e-14, 6e-16)),
    ('drop_1km', DROP, dropped, ('yzzyzy', 2, 1e3), (7e-10, 3e-14)),
    ('drop_1000km', DROP, dropped, ('yzzyzy', 2, 1e6), (7e-4, 5e-7)),
    ('drop_with_slide_1km', DROP, dropped, ('yzzZyz', 2, 1e3), (2e-10, 2e-14)),
    ('drop_with_slide_1000km', DROP, dropped, ('yzzZyz', 2, 1e6), (2e-4, 4e-8)),
    ('six_slides_tip_1e2', HEAVY_SLIDES, weighed, ('XYZXYZ', {5: 1e2}), (8e-15, 6e-18)),
    ('six_slides_tip_1e4', HEAVY_SLIDES, weighed, ('XYZXYZ', {5: 1e4}), (3e-13, 5e-18)),
    ('six_slides_tip_1e8', HEAVY_SLIDES, weighed, ('XYZXYZ', {5: 1e8}), (6e-9, 6e-18)),
    ('two_slides_tip_1e8', HEAVY_SLIDES, weighed, ('ZZ', {1: 1e8}), (1e-8, 1e-17)),
    ('slides_and_turns_ratio_100', RATIOS, graded, ('yZzYxZ', 100.0), (2e-13, 1e-16)),
    (
        'slides_lifted_1km',
        'distances of 1 km along slides and turns',
        lifted,
        ('yZzYxz', {1: 1e3, 3: 1e3}),
        (4e-15, 3e-16),
    ),
    ('slides_out_1km', 'slides up to 1 km out', extended, ('yZzYxz', 1e3), (4e-16, 1e-16)),
    ('five_on_one_axis_1e-4', ONE_AXIS, on_one_axis, ('zzzzzy', 5, 1e-4), (4e-14, 1e-16)),
    ('five_on_one_axis_1e-8', ONE_AXIS, on_one_axis, ('zzzzzy', 5, 1e-8), (4e-10, 7e-17)),
    ('three_on_one_axis_1e-8', ONE_AXIS, on_one_axis, ('zzzyz', 3, 1e-8), (8e-17, 4e-17)),
    (
        'turn_and_slide_on_one_axis',
        ONE_AXIS,
        on_one_axis,
        ('zZzZy', 4, 1e-8, 1e-6),
        (6e-17, 4e-17),
    ),
    ('turns_ratio_100', RATIOS, graded, ('yzyzyz', 100.0), (2e-14, 2e-16)),
    ('planar_ratio_100', RATIOS, graded, ('yyyyyy', 100.0), (2e-10, 1e-16)),
    (
        'planar_tip_1e4',
        'a heavy last link on parallel joints',
        weighed,
        ('yyyyyy', {5: 1e4}),
        (3e-12, 4e-17),
    ),
    ('ur5_load_1e4', LOAD, loaded, ('ur5', 1e4, 0.125), (2e-13, 2e-16)),
    ('panda_load_1e4_at_8m', LOAD, loaded, ('panda', 1e4, 8.0), (4e-10, 7e-17)),
)
MECHANISMS = tuple(
    Mechanism(name, cause, partial(make, *arguments), before)
    for name, cause, make, arguments, before in _TABLE
)

INTRODUCTION = f"""# Errors of the default method for mechanisms of unusual proportions

Generated by `{COMMAND}`. An error is |x - qdd| / |qdd|, Euclidean, in float64, against 50 digits
([hard-cases.md](hard-cases.md)). *default* is the kernel of `method='auto'`, *refined* the same
with `refine=1`. *before* is the error at commit ed0d2c3 ([decision
0024](../decisions/0024-accuracy-of-the-default.md)).
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
    data.write_text(json_text([asdict(one) for one in results]))
    return [page, data]
