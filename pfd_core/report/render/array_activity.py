# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Picture of a run of a systolic array: one small array for every cycle, in SVG.

A cell that acts in a cycle has the colour of its action; idle cells are outlines. Row 1 is at the
bottom, as in Figure 1 of Lee and Chang 1987, and cells on the diagonal are circles. The SVG is
plain text without fonts or dates of the machine, so that it is the same
everywhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from html import escape

from pfd_core.machine.systolic import Place, Trace

# Colour of each action, from a palette for colour-blind readers.
ACTIONS = {
    'square root': '#0072b2',
    'divide': '#e69f00',
    'multiply and subtract': '#d55e00',
    'store': '#009e73',
}
OTHER = '#666666'
CELL = 14
GAP = 18
MARGIN = 20
LINE = 20
PER_ROW = 7


def activity_svg(trace: Trace, title: str, per_row: int = PER_ROW) -> str:
    """
    Return an SVG picture of a run of a square or triangular array.

    Parameters
    ----------
    trace : Trace
        Record of the run.
    title : str
        Heading of the picture.
    per_row : int
        Cycles side by side, at least 1.

    """
    if per_row < 1:
        raise ValueError(f'per_row must be at least 1, got {per_row}')
    n = max(row for row, _ in trace.states)
    # In the order in which they first occur.
    names = list(dict.fromkeys(name for acting in trace.actions for name in acting.values()))
    side = n * CELL + GAP
    frame_height = side + LINE
    frames = max(trace.cycles, 1)
    width = 2 * MARGIN + max(per_row * side, 170 * len(names))
    height = 2 * MARGIN + 2 * LINE + -(-frames // per_row) * frame_height
    body = [
        f'<title>{escape(title)}</title>',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        f'<text x="{MARGIN}" y="{MARGIN + 4}" font-size="14">{escape(title)}</text>',
        *_legend(names),
    ]
    for t in range(frames):
        x = MARGIN + t % per_row * side
        y = MARGIN + 2 * LINE + t // per_row * frame_height
        acting = trace.actions[t] if t < len(trace.actions) else {}
        body += [
            f'<g transform="translate({x} {y})">',
            f'<text y="12">cycle {t + 1}</text>',
            *(_cell(place, n, acting.get(place)) for place in sorted(trace.states)),
            '</g>',
        ]
    lines = '\n'.join(body)
    head = f'width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
    font = 'font-family="sans-serif" font-size="11"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {head} {font}>\n{lines}\n</svg>\n'


def _legend(names: list[str]) -> Iterator[str]:
    y = MARGIN + LINE
    for k, name in enumerate(names):
        x = MARGIN + 170 * k
        colour = ACTIONS.get(name, OTHER)
        yield f'<rect x="{x}" y="{y - 9}" width="10" height="10" fill="{colour}"/>'
        yield f'<text x="{x + 15}" y="{y}">{escape(name)}</text>'


def _cell(place: Place, n: int, action: str | None) -> str:
    """Return one cell: a circle on the diagonal and a square elsewhere."""
    row, column = place
    x, y = (column - 1) * CELL, LINE + (n - row) * CELL
    fill = 'none' if action is None else ACTIONS.get(action, OTHER)
    style = f'fill="{fill}" stroke="#999999" stroke-width="0.7"'
    if row == column:
        r = CELL / 2 - 1
        return f'<circle cx="{x + CELL / 2:g}" cy="{y + CELL / 2:g}" r="{r:g}" {style}/>'
    return f'<rect x="{x + 1}" y="{y + 1}" width="{CELL - 2}" height="{CELL - 2}" {style}/>'
