# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors over thousands of states of public arms: states, quantiles as rows, tables and box plots.

The states are of the whole range of the joints, at up to 2 rad/s and 5 N m, and have a separate
seed, on which no number was chosen.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.cases.problems import Problem, drawing, problem
from benchmarks.cases.robots import PUBLIC, Array, robot
from benchmarks.plots import BLUE, PINOCCHIO, SKY
from benchmarks.table import lines_of, short

ARMS = ('puma560', 'ur5', 'panda', 'so100', *PUBLIC)
SEED = 20261126
# Lower whisker, box, upper whisker.
QUANTILES = {'p1': 0.01, 'p25': 0.25, 'p50': 0.5, 'p75': 0.75, 'p99': 0.99}
# States of a run of a program, which keeps all of its numbers.
BLOCK = 500
# States at which the reference in longdouble is compared with 50 digits.
CHECKED = 5
DEFAULT, REFINED, PEER = 'default', 'refine=1', 'Pinocchio'
WAYS = {DEFAULT: SKY, REFINED: BLUE, PEER: PINOCCHIO}


def drawn(name: str, states: int) -> Problem:
    """Return states of an arm."""
    with drawing(SEED, states):
        return problem(robot(name), qd=2.0, tau=5.0)


def blocks(many: Problem) -> Iterator[Problem]:
    """Yield the states of a problem in blocks."""
    for k in range(0, len(many.states['q']), BLOCK):
        yield Problem(many.plant, {name: x[k : k + BLOCK] for name, x in many.states.items()})


def box(values: Array, **row: str) -> dict[str, Any]:
    """Return a row with the quantiles of values (S,) and the largest, None if not finite."""
    shares = np.quantile(values, list(QUANTILES.values())).tolist()
    quantiles = dict(zip(QUANTILES, shares, strict=True))
    return {**row, 'states': len(values), **quantiles, 'largest': float(values.max())}


def box_lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a table of rows: quantiles and the largest value of each arm and way."""
    titles = ['arm', 'way', 'format', '1 %', 'median', '99 %', 'largest']
    return lines_of(
        titles,
        (
            [row['arm'], row['way'], row['dtype']]
            + [short(row[key]) for key in ('p1', 'p50', 'p99')]
            + ['not finite' if row['largest'] is None else short(row['largest'])]
            for row in rows
        ),
    )


def more_accurate(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return on how many arms the peer has the smaller quantiles, and by how much at most."""
    texts = []
    for title, key in (('median', 'p50'), ('99 % quantile', 'p99')):
        found = {(row['arm'], row['way']): row[key] for row in rows if row['dtype'] == 'float64'}
        peers = {arm: value for (arm, way), value in found.items() if way == PEER}
        if not peers:
            return 'no result (Pinocchio is not installed)'
        ratio, arm = max((found[arm, DEFAULT] / value, arm) for arm, value in peers.items())
        count = sum(found[arm, DEFAULT] > value for arm, value in peers.items())
        by = f', by up to {ratio:.2g} times ({arm})' if count else ''
        texts.append(f'the smaller {title} on {count} of {len(peers)} arms{by}')
    return ' and '.join(texts)


def draw_boxes(axes: Any, rows: Sequence[Mapping[str, Any]], title: str) -> None:
    """Draw the boxes of rows in float64, arm by arm, on a logarithmic axis."""
    from matplotlib.patches import Patch

    arms = list(dict.fromkeys(row['arm'] for row in rows))
    width = 0.8 / len(WAYS)
    names = ('whislo', 'q1', 'med', 'q3', 'whishi')
    for k, (way, colour) in enumerate(WAYS.items()):
        some = [row for row in rows if (row['way'], row['dtype']) == (way, 'float64')]
        if not some:
            continue
        shapes = [
            {name: row[key] for name, key in zip(names, QUANTILES, strict=True)}
            | {'fliers': [] if row['largest'] is None else [row['largest']]}
            for row in some
        ]
        axes.bxp(
            shapes,
            positions=[arms.index(row['arm']) + (k - 1) * width for row in some],
            widths=0.85 * width,
            patch_artist=True,
            boxprops={'facecolor': colour, 'alpha': 0.45, 'edgecolor': colour},
            medianprops={'color': colour, 'linewidth': 2},
            whiskerprops={'color': colour},
            capprops={'color': colour},
            flierprops={'marker': 'x', 'markersize': 4, 'markeredgecolor': colour},
            manage_ticks=False,
        )
    axes.set_yscale('log')
    axes.margins(x=0.01, y=0.2)  # for the legend
    axes.grid(axis='y', alpha=0.25)
    axes.set_xticks(range(len(arms)), arms)
    axes.set_ylabel('error [u]')
    axes.set_title(title, fontsize=11)
    handles = [Patch(facecolor=colour, alpha=0.45, label=way) for way, colour in WAYS.items()]
    axes.legend(handles=handles, fontsize=9, loc='upper left', ncols=len(WAYS))
