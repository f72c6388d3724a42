# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pictures of runs of systolic arrays: one small array for every cycle, in SVG.

A cell that acts in a cycle has the colour of its action; idle cells are outlines. Row 1 is at the
bottom, as in Figure 1 of Lee and Chang 1987, and cells on the diagonal are circles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

from pfd_core.machine.systolic import Place, Trace
from pfd_core.report.render.svg import document, text

# Colour of each action, from a palette for colour-blind readers.
ACTIONS = {
    'square root': '#0072b2',
    'divide': '#e69f00',
    'multiply and subtract': '#d55e00',
    'store': '#009e73',
}
OTHER = '#666666'
CELL, LABELLED = 14, 22
GAP = 18
MARGIN = 20
LINE = 20
# Cycles side by side.
PER_ROW, PER_ROW_LABELLED = 7, 6


# From the place of a cell and a cycle to the name of the cell's element.
Label = Callable[[Place, int], str]


def runs_svg(runs: Mapping[str, tuple[Trace, Label | None]], title: str) -> str:
    """
    Return an SVG picture of runs of arrays of the same size, one below the other.

    Parameters
    ----------
    runs : mapping
        Heading, or '', to the record of a run, and the label of a cell that acts, or None.
    title : str
        Heading of the picture.

    """
    n = max(row for trace, _ in runs.values() for row, _ in trace.states)
    names = _names([trace for trace, _ in runs.values()])
    labelled = any(label for _, label in runs.values())
    size, per_row = (LABELLED, PER_ROW_LABELLED) if labelled else (CELL, PER_ROW)
    side = n * size + GAP
    body = [text(MARGIN, MARGIN + 4, title, 14), *_legend(names)]
    y = float(MARGIN + 2 * LINE)
    for heading, (trace, label) in runs.items():
        if heading:
            body.append(text(MARGIN, y + 14, heading, 12))
            y += LINE
        for t in range(trace.cycles):
            at = MARGIN + t % per_row * side, y + t // per_row * (side + LINE)
            body += _frame(trace, n, t, at, size, label)
        y += -(-trace.cycles // per_row) * (side + LINE) + GAP
    return document(2 * MARGIN + max(per_row * side, 170 * len(names)), y, title, body)


def _names(traces: Sequence[Trace]) -> list[str]:
    """Return the actions in the order in which they first occur."""
    acting = (names for trace in traces for names in trace.actions)
    return list(dict.fromkeys(name for names in acting for name in names.values()))


def _frame(
    trace: Trace, n: int, t: int, at: tuple[float, float], size: float, label: Label | None
) -> Iterator[str]:
    acting = trace.actions[t]
    yield f'<g transform="translate({at[0]:g} {at[1]:g})">'
    yield text(0, 12, f'cycle {t + 1}')
    for place in sorted(trace.states):
        action = acting.get(place)
        yield _cell(place, n, action, size)
        if label and action:
            x, y = (place[1] - 0.5) * size, LINE + (n - place[0] + 0.5) * size
            yield text(x, y + 3.5, label(place, t + 1), 10, 'middle', 'white')
    yield '</g>'


def _legend(names: list[str]) -> Iterator[str]:
    y = MARGIN + LINE
    for k, name in enumerate(names):
        x = MARGIN + 170 * k
        colour = ACTIONS.get(name, OTHER)
        yield f'<rect x="{x}" y="{y - 9}" width="10" height="10" fill="{colour}"/>'
        yield text(x + 15, y, name)


def _cell(place: Place, n: int, action: str | None, size: float) -> str:
    row, column = place
    x, y = (column - 1) * size, LINE + (n - row) * size
    fill = 'none' if action is None else ACTIONS.get(action, OTHER)
    style = f'fill="{fill}" stroke="#999999" stroke-width="0.7"'
    if row == column:
        r = size / 2 - 1
        return f'<circle cx="{x + size / 2:g}" cy="{y + size / 2:g}" r="{r:g}" {style}/>'
    side = f'width="{size - 2:g}" height="{size - 2:g}"'
    return f'<rect x="{x + 1:g}" y="{y + 1:g}" {side} {style}/>'
