# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of errors over thousands of states, distributions.md, its JSON and its box plots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
import statistics
from typing import Any

from pfd_core.report.measure.distributions import (
    CHECKED,
    DEFAULT,
    DERIVATIVES,
    FORWARD,
    PEER,
    QUICK,
    REFINED,
    STEPS,
    Box,
    Check,
    Plan,
    measure,
)
from pfd_core.report.measure.processes import each
from pfd_core.report.render.markdown import Columns, lines_of, page, table
from pfd_core.report.render.markdown import write as write_page
from pfd_core.report.render.numbers import short
from pfd_core.report.render.plots import BLACK, BLUE, GREEN, PURPLE, SKY, save

NAME = 'distributions'
TITLES = {
    FORWARD: 'Forward dynamics',
    DERIVATIVES: 'Derivatives of the acceleration by q, qd, tau',
    STEPS: 'A and B of a linearised step',
}
COLOURS = {DEFAULT: SKY, REFINED: BLUE, PEER: BLACK, 'kappa_s': GREEN, 'kappa_J': PURPLE}
CONDITIONS = ('kappa_s', 'kappa_J')


@dataclass(frozen=True)
class Findings:
    """Distributions, and checks of their references."""

    boxes: list[Box] = field(default_factory=list)
    checks: list[Check] = field(default_factory=list)


def run(folder: Path, quick: bool = False) -> list[Path]:
    """Measure all arms, or quickly one, and write the page into a folder."""
    plan = QUICK if quick else Plan()
    found = Findings()
    for boxes, checks in each(measure, [(name, plan) for name in plan.arms], 'distributions'):
        found.boxes.extend(boxes)
        found.checks.extend(checks)
    return write(found, folder)


def markdown(found: Findings) -> str:
    """Return the page."""
    known = [box for box in found.boxes if box.way not in CONDITIONS]
    states = {box.quantity: box.states for box in known}
    refused = sorted({box.quantity for box in known if box.largest is None})
    return page(
        NAME,
        command='pfd report distributions',
        arms=len({box.robot for box in known}),
        states=', '.join(
            f'{count} for {TITLES[quantity][0].lower()}{TITLES[quantity][1:]}'
            if quantity != STEPS
            else f'{count} for {TITLES[quantity]}'
            for quantity, count in states.items()
        ),
        outcome='\n'.join(_outcome(found.boxes, quantity) for quantity in TITLES),
        checked=CHECKED,
        distance=short(max(check.distance for check in found.checks)),
        checks=table(CHECKS, found.checks),
        forward=_table(found.boxes, FORWARD),
        derivatives=_table(found.boxes, DERIVATIVES),
        steps=_table(found.boxes, STEPS),
        missing=f'Answers that are not finite: {", ".join(refused)}.' if refused else None,
    )


def summary(found: Findings) -> str:
    """Return the outcome of forward dynamics as a paragraph, for the README."""
    ways = {'default': DEFAULT, 'refined': REFINED, 'peer': PEER}
    boxes = {name: _some(found.boxes, FORWARD, way) for name, way in ways.items()}
    every = [box for some in boxes.values() for box in some]
    return page(
        'distributions-summary',
        states=every[0].states,
        arms=len(boxes['default']),
        middle=_larger(boxes['default'], boxes['peer'], 2),
        outer=_larger(boxes['default'], boxes['peer'], -1),
        medians=short(max(box.shares[2] for box in every)),
        **{name: _worst(some) for name, some in boxes.items()},
    )


def _larger(own: Sequence[Box], peers: Sequence[Box], k: int) -> str:
    """Return on how many arms a quantile is larger than the peer's, and by how much at most."""
    by_arm = {box.robot: box.shares[k] for box in peers}
    ratios = [(box.shares[k] / by_arm[box.robot], box.robot) for box in own if box.robot in by_arm]
    ratio, robot = max(ratios)
    count = sum(one > 1 for one, _ in ratios)
    return f'{count} of {len(ratios)} arms' + f', by up to {ratio:.2g} times ({robot})' * (
        count > 0
    )


def _worst(boxes: Sequence[Box]) -> str:
    """Return the largest 99 % quantile and its arm."""
    worst = max(boxes, key=lambda box: box.shares[-1])
    return f'{short(worst.shares[-1])} ({worst.robot})'


def _some(boxes: Sequence[Box], quantity: str, way: str) -> list[Box]:
    wanted = (quantity, way, 'float64')
    return [box for box in boxes if (box.quantity, box.way, box.dtype) == wanted]


def _outcome(boxes: Sequence[Box], quantity: str) -> str:
    """Return a line on one quantity: the median and the worst arm of every way."""
    texts = []
    for way in (DEFAULT, REFINED, PEER):
        some = _some(boxes, quantity, way)
        if some:
            middle = statistics.median(box.shares[2] for box in some)
            texts.append(f'{way} {short(middle)}, and {_worst(some)}')
    return f'- {TITLES[quantity]}: {"; ".join(texts)}.'


CHECKS: Columns = {
    'arm': 'robot',
    'quantity': 'quantity',
    'states': 'states',
    'distance from 50 digits [u]': lambda check: f'{check.distance:.2g}',
}


def _table(boxes: Sequence[Box], quantity: str) -> list[str]:
    """Return the table of one quantity: median, 99 % and the largest of each way."""
    titles = ['arm', 'way', 'format', 'states', '1 %', 'median', '99 %', 'largest']
    some = [box for box in boxes if box.quantity == quantity]
    return lines_of(
        titles,
        (
            [box.robot, box.way, box.dtype, box.states]
            + [short(box.shares[k]) for k in (0, 2, 4)]
            + ['not finite' if box.largest is None else short(box.largest)]
            for box in some
        ),
    )


def write(found: Findings, folder: Path) -> list[Path]:
    """Write distributions.md, .json, .png and .svg, and return their paths."""
    pages = write_page(folder, NAME, markdown(found), asdict(found))
    return [*pages, *save(partial(_draw, found.boxes), folder, NAME, (11, 12.5))]


def _draw(boxes: Sequence[Box], figure: Any) -> None:
    panels = figure.subplots(4, 1, sharex=True)
    arms = list(dict.fromkeys(box.robot for box in boxes))
    errors = (DEFAULT, REFINED, PEER)
    for axes, quantity in zip(panels, TITLES, strict=False):
        _panel(axes, [box for box in boxes if box.quantity == quantity], arms, errors)
        axes.set_ylabel('error [u of float64]')
        axes.set_title(f'{TITLES[quantity]}: error', fontsize=11)
    _panel(panels[-1], boxes, arms, CONDITIONS)
    panels[-1].set_ylabel('condition number')
    panels[-1].set_title(
        'Condition: of the robot and state (kappa_s), of the scaled inertia matrix (kappa_J)',
        fontsize=11,
    )
    panels[-1].set_xticks(range(len(arms)), arms)


def _panel(axes: Any, boxes: Sequence[Box], arms: Sequence[str], ways: Sequence[str]) -> None:
    """Draw the boxes of some ways, arm by arm, on a logarithmic axis."""
    from matplotlib.patches import Patch

    width = 0.8 / len(ways)
    for k, way in enumerate(ways):
        some = [box for box in boxes if box.way == way and box.dtype == 'float64']
        places = [arms.index(box.robot) + (k - (len(ways) - 1) / 2) * width for box in some]
        stats = [
            dict(zip(('whislo', 'q1', 'med', 'q3', 'whishi'), box.shares, strict=True))
            | {'fliers': [] if box.largest is None else [box.largest]}
            for box in some
        ]
        colour = COLOURS[way]
        if some:
            axes.bxp(
                stats,
                positions=places,
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
    handles = [Patch(facecolor=COLOURS[way], alpha=0.45, label=way) for way in ways]
    axes.legend(handles=handles, fontsize=9, loc='upper left', ncols=len(ways))
