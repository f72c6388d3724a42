# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Drawings of triangular arrays side by side: links, input streams, and the rules of their cells.

As Figures 1 and 2 of Lee and Chang 1987: row 1 is at the bottom, circular cells are on the
diagonal, and items run right and up.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from pfd_core.report.render.svg import arrow, box, circle, document, text

STEP, RADIUS = 64, 17
LEFT, TOP, WIDTH = 170, 70, 520
CELL_TOP, RULE = 60, 16


@dataclass(frozen=True)
class Stream:
    """Items that enter a row or a column in their order, and the cycle of the first one."""

    items: tuple[str, ...]
    cycle: int


@dataclass(frozen=True)
class CellRules:
    """A kind of cell: name, whether it is circular, labels of its ports, rules."""

    name: str
    circular: bool
    ports: dict[str, str]
    rules: Sequence[str]


@dataclass(frozen=True)
class Design:
    """
    An array of n rows.

    Attributes
    ----------
    title : str
        Heading.
    left, below : dict
        Row to the stream that enters it, and column to the stream that enters from below.
    cells : tuple of CellRules
        Kinds of cells.

    """

    title: str
    left: dict[int, Stream]
    cells: tuple[CellRules, ...]
    below: dict[int, Stream] = field(default_factory=dict)


def designs_svg(designs: Sequence[Design], title: str) -> str:
    """Return the picture of designs of the same size side by side."""
    n = max(designs[0].left)
    items = max((len(s.items) for d in designs for s in d.below.values()), default=0)
    rules = max(sum(len(kind.rules) + 8 for kind in design.cells) for design in designs)
    foot = TOP + n * STEP + 13 * items + 30
    body: list[str] = [text(20, 24, title, 14)]
    for k, design in enumerate(designs):
        body += [f'<g transform="translate({k * WIDTH} 0)">', *_design(design, n, foot), '</g>']
    return document(WIDTH * len(designs), foot + rules * RULE + CELL_TOP, title, body)


def _design(design: Design, n: int, foot: float) -> Iterator[str]:
    yield text(20, 48, design.title, 13)
    for k in range(1, n + 1):
        for i in range(1, k + 1):
            x, y = _centre(n, k, i)
            yield _shape(i == k, x, y, RADIUS)
            yield text(x, y + 4, f'P{k}{i}', anchor='middle')
            yield arrow(x + RADIUS, y, x + (36 if i == k else STEP - RADIUS), y)
            if k < n or design.below:
                yield arrow(x, y - RADIUS, x, y - STEP + RADIUS + (0 if k < n else 18))
    for k, stream in design.left.items():
        x, y = _centre(n, k, 1)
        yield arrow(x - 40, y, x - RADIUS, y)
        yield text(x - 44, y + 4, ' '.join(reversed(stream.items)), 10, 'end')
        yield text(x - 44, y + 16, f'from cycle {stream.cycle}', 8, 'end', '#666666')
    for i, stream in design.below.items():
        x, y = _centre(n, i, i)
        yield arrow(x, y + RADIUS + 20, x, y + RADIUS)
        for line, item in enumerate((*stream.items, f'from cycle {stream.cycle}')):
            last = line == len(stream.items)
            place = y + RADIUS + 31 + 12 * line
            yield text(x, place, item, 8 if last else 10, 'middle', '#666666' if last else 'black')
    y = foot
    for kind in design.cells:
        yield from _rules(kind, y)
        y += (len(kind.rules) + 8) * RULE


def _centre(n: int, row: int, column: int) -> tuple[float, float]:
    return LEFT + (column - 1) * STEP, TOP + 20 + (n - row) * STEP


def _shape(circular: bool, x: float, y: float, size: float) -> str:
    return circle(x, y, size) if circular else box(x - size, y - size, 2 * size, 2 * size)


def _rules(kind: CellRules, y: float) -> Iterator[str]:
    """Draw a cell with its ports, and its rules below."""
    x, centre = LEFT - 60, y + CELL_TOP
    yield text(20, y + 4, kind.name, 12)
    size = 1.3 * RADIUS
    yield _shape(kind.circular, x, centre, size)
    ends = {
        'left': ((x - 50, centre, x - size, centre), (x - 54, centre + 4, 'end')),
        'right': ((x + size, centre, x + 50, centre), (x + 54, centre + 4, 'start')),
        'down': ((x, centre + size + 22, x, centre + size), (x + 6, centre + size + 20, 'start')),
        'up': ((x, centre - size, x, centre - size - 20), (x + 6, centre - size - 12, 'start')),
    }
    for direction, label in kind.ports.items():
        ends_of_arrow, (label_x, label_y, anchor) = ends[direction]
        yield arrow(*ends_of_arrow)
        yield text(label_x, label_y, label, 10, anchor)
    for line, rule in enumerate(kind.rules):
        yield text(20, centre + size + 40 + line * RULE, rule)
