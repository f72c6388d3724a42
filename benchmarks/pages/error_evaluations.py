# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Time of an evaluation of forward dynamics over its error, at ordinary and hard cases.

Cases and references of 50 digits are those of the hard cases. At one case all ways take turns in
one process, in a batch that repeats the states of the case.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from benchmarks.cases.hard_cases import CASES
from benchmarks.pages import speed
from benchmarks.peers.ours import ours
from benchmarks.peers.work import made, valid_sides
from benchmarks.references.accelerations import errors, reference
from benchmarks.run import show_progress
from benchmarks.table import Cells, bullets, grid, order, page, short
from benchmarks.timing import Pace, take_turns

MEASURED = (
    'ordinary_puma560',
    'ordinary_ur5',
    'ordinary_panda',
    'payload_1e6',
    'heavy_tip_1e8_n12',
    'collinear_axes_1e-12',
)
BATCH, PACE = 4096, Pace(chunk=1e-3, turns=100, fewest=10, budget=8.0)
QUICK = (('collinear_axes_1e-12',), 128, Pace(chunk=1e-4, turns=3))
OURS = {
    f'pfd {dtype} {refine}': partial(ours, dtype=dtype, refine=refine)
    for dtype, refine in product(('float64', 'float32'), (0, 1))
}


def measure(quick: bool) -> dict[str, Any]:
    """Return points: case, way, minimum [s a state] and largest error; and what is missing."""
    names, batch, pace = QUICK if quick else (MEASURED, BATCH, PACE)
    makers: speed.Makers = {**OURS, **(speed.FAST if quick else speed.OTHERS)}
    points, reasons = list[dict[str, Any]](), dict[str, str]()
    for case in (case for name in names for case in CASES if case.name == name):
        show_progress(f'{case.name}: reference')
        problem = case.make()
        known, robot, states = reference(problem), problem.plant.robot, problem.states.values()
        peers, count = made(makers, robot, reasons), len(problem.states['q'])
        given = [np.resize(x, (batch, robot.n)) for x in states]
        sides = [
            side for side in valid_sides(peers, given, reasons) if not side.way.endswith('C order')
        ]
        show_progress(f'{case.name}: {len(sides)} ways')
        for side, times in zip(sides, take_turns(sides, batch, pace), strict=True):
            error = float(errors(np.asarray(side.result())[:count], known).max())
            row = {'case': case.name, 'n': robot.n, 'way': side.way.replace(', F order', '')}
            points.append(row | {'minimum': times.minimum, 'error': error})
    return {'points': points, 'missing': [f'{name}: {why}' for name, why in reasons.items()]}


def text(data: Mapping[str, Any]) -> str:
    """Return the section of the page."""
    cells = Cells()
    for point in data['points']:
        cell = f'{short(point["minimum"] * 1e9)} ns, {order(point["error"])}'
        cells[point['way'], f'{point["case"]}, n = {point["n"]}'] = cell
    missing = bullets(data['missing'], 'Nothing.')
    return page('error-evaluations', many=BATCH, batch=grid(cells, 'way'), missing=missing)
