# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The triangular array, as printed and corrected, cycle by cycle.

Both designs run on the emulated array. Its actions depend on n alone, so the identity is factored;
the numbers are of the H of the worked example. Utilisation is the share of the cells' cycles in
which they computed or stored something.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.paper import value
from benchmarks.cases.worked_example import equation
from benchmarks.drawings import FAINT, PAPER, Drawing
from benchmarks.plots import BLACK, GREY, ORANGE, SKY
from benchmarks.table import Row, grid, page
from pfd_core.paper.array import (
    DIVIDE,
    MULTIPLY,
    ROOT,
    STORE,
    literal_array,
    pipeline,
    solve,
)
from pfd_core.paper.systolic import Place, Step, Trace

SIZES = (2, 3, 4, 6, 8, 12, 16)
FIGURE = 4  # rows of the array as in Figure 1
PRINTED, CORRECTED = 'as printed', 'corrected'
RUNS: dict[str, Callable[[int], Trace]] = {
    PRINTED: lambda n: literal_array(np.eye(n)).trace,
    CORRECTED: lambda n: pipeline([np.eye(n)])[0].trace,
    'forward': lambda n: pipeline([np.eye(n)], [np.ones(n)])[0].trace,
    'solve': lambda n: solve(np.eye(n), np.ones(n)).trace,
    'pipeline': lambda n: pipeline([np.eye(n)] * 5)[0].trace,
}
# Design, event, cycles, and run; of an event before the end, column and action (None: any).
EVENTS = (
    (PRINTED, 'h_n1 is stored in P_n1', '2 n - 1', PRINTED, ('P_n1', STORE)),
    (PRINTED, 'all input from below is stored', '2 n - 1', PRINTED, (None, STORE)),
    (PRINTED, 'h_nn and the flag meet in P_n1', '2 n', PRINTED, ('P_n1', None)),
    (PRINTED, 'factorisation, a wrong matrix', '3 n - 1', PRINTED, None),
    (CORRECTED, 'factorisation', '3 n - 2', CORRECTED, None),
    (CORRECTED, 'with forward substitution', '3 n - 1', 'forward', None),
    (CORRECTED, 'with both substitutions', '5 n - 2', 'solve', None),
    (CORRECTED, '5 matrices, a new one every n cycles', '3 n - 2 + 4 n', 'pipeline', None),
)


def measure(quick: bool) -> dict[str, Any]:
    """Run the arrays; quick is few sizes."""
    return {
        'times': list(times(SIZES[:3] if quick else SIZES)),
        'actions': [
            *actions(PRINTED, FIGURE, lambda *at: literal_label(FIGURE, *at)),
            *actions('solve', FIGURE, lambda *at: corrected_label(FIGURE, *at)),
        ],
        'numbers': list(numbers(*equation())),
    }


def numbers(H: NDArray[Any], y: NDArray[Any]) -> Iterator[dict[str, Any]]:
    """Yield what each cell computes or stores in each cycle, with the number; None is NaN."""
    traces = {PRINTED: literal_array(H).trace, 'solve': solve(H, y).trace}
    for name, trace in traces.items():
        for cycle, steps in enumerate(trace.steps, 1):
            for (k, i), step in sorted(steps.items()):
                if step.action:
                    at = {'run': name, 'cycle': cycle, 'row': k, 'column': i}
                    kept = step.state if name == PRINTED else step.state.u
                    found = {'number': _number(step), 'register': _or_none(kept)}
                    yield at | {'action': step.action, **found}


def _number(step: Step) -> float | None:
    """Return the result of a cell: what it sends right, on the way back down or left."""
    if step.action == STORE:
        return _or_none(step.state)
    ways = ('right', 'down', 'left')
    return _or_none(next(step.sent[way].value for way in ways if way in step.sent))


def _or_none(number: Any) -> float | None:
    return None if np.isnan(number) else float(number)


def times(sizes: Iterable[int]) -> Iterator[dict[str, Any]]:
    """Yield every event at every n: cycles claimed and measured, utilisation at the end."""
    for n in sizes:
        for design, event, formula, name, before_the_end in EVENTS:
            trace = RUNS[name](n)
            row = {'design': design, 'event': event, 'formula': formula, 'n': n}
            row['claimed'] = int(value(formula, n))
            if before_the_end:
                row['measured'] = _last_cycle(trace, n, *before_the_end)
            else:
                row |= {'measured': trace.cycles, 'utilisation': trace.utilisation}
            yield row


def _last_cycle(trace: Trace, n: int, cell: str | None, action: str | None) -> int:
    """Return the last cycle with an action, in P_n1 or any cell; None is any action."""
    return max(
        cycle
        for cycle, acting in enumerate(trace.actions, 1)
        for place, done in acting.items()
        if (cell is None or place == (n, 1)) and action in (None, done)
    )


def actions(name: str, n: int, label: Callable[[Place, int], str]) -> Iterator[dict[str, Any]]:
    """Yield the action of each cell in each cycle of a run, with the subscript of its element."""
    for cycle, acting in enumerate(RUNS[name](n).actions, 1):
        for (k, i), action in sorted(acting.items()):
            at = {'run': name, 'cycle': cycle, 'row': k, 'column': i}
            yield at | {'action': action, 'label': label((k, i), cycle)}


def literal_label(n: int, place: Place, cycle: int) -> str:
    """Return the subscript of the element that a cell of the design as printed works on."""
    k, i = place
    # Items of row k enter P_k1 from cycle 2k on; before that the cell stores h_ki.
    item = cycle - (2 * k + i - 1)
    if item < 0:
        return f'{k}{i}'
    return f'{k + 1 + item}{k}' if item < n - k else f'{k}{k}'


def corrected_label(n: int, place: Place, cycle: int) -> str:
    """Return what a cell of the corrected design works on: an element of L, of z or of x."""
    k, i = place
    element = cycle - k - i + 2
    if element <= n:
        return f'{element}{k}'
    return f'{"z" if element == n + 1 else "x"}{k}'


# ---- the page ----


def text(data: dict[str, Any]) -> str:
    """Return the page."""
    title = '{design}: {event}, {formula}'
    return page(
        'array',
        cycles=grid({(title.format(**x), x['n']): _cycles(x) for x in data['times']}, 'n ='),
        figure=FIGURE,
        printed=_acting(data['numbers'], PRINTED),
        corrected=_acting(data['numbers'], 'solve'),
    )


def _cycles(x: Row) -> str:
    claimed = '' if x['measured'] == x['claimed'] else f', not {x["claimed"]}'
    utilisation = f' ({x["utilisation"]:.0%})' if 'utilisation' in x else ''
    return f'{x["measured"]}{claimed}{utilisation}'


def _acting(rows: Iterable[Row], design: str) -> list[str]:
    """Return what each cell does in each cycle; it rests where a place is empty."""
    own = [x for x in rows if x['run'] == design]
    known = {(x['row'], x['column'], x['cycle']): _shown(x) for x in own}
    cycles = range(1, max(x['cycle'] for x in own) + 1)
    cells = sorted({(x['row'], x['column']) for x in own})
    return grid(
        {(str(t), f'P_{k}{i}'): known.get((k, i, t), '') for t in cycles for k, i in cells},
        'cycle',
    )


def _shown(x: Row) -> str:
    return f'{x["action"].split()[-1]} {_written(x["number"])}'


def _written(number: float | None) -> str:
    return 'none' if number is None else f'{number + 0.0:.4g}'


# ---- pictures ----

COLORS = {STORE: '#dddddd', DIVIDE: ORANGE, MULTIPLY: SKY, ROOT: BLACK}


def plots(data: dict[str, Any], folder: Path) -> list[Path]:
    """Draw Figure 1 with numbers, and cell by cycle."""
    return [_figure_1(data['numbers'], folder), _space_time(data['actions'], folder)]


def _space_time(rows: Sequence[Row], folder: Path) -> Path:
    """Draw what each cell of both designs works on in each cycle."""
    wide, high, left = 34, 22, 60
    cells = [(k, i) for k in range(1, FIGURE + 1) for i in range(1, k + 1)]
    ends = {name: max(x['cycle'] for x in rows if x['run'] == name) for name in (PRINTED, 'solve')}
    roots = [x['cycle'] for x in rows if x['run'] == 'solve' and x['action'] == ROOT]
    titles = {
        PRINTED: f'As printed: {ends[PRINTED]} cycles, a wrong matrix',
        'solve': f'Corrected: L in {max(roots)} cycles, z and x in {ends["solve"]}',
    }
    block = len(cells) * high + 74
    drawing = Drawing(
        left + max(ends.values()) * wide + 20, len(titles) * block + 40, 'Cell by cycle'
    )
    for part, (name, title) in enumerate(titles.items()):
        top = part * block + 52
        drawing.text(left, top - 28, title, 14, 'start', bold=True)
        for at, (k, i) in enumerate(cells):
            drawing.text(left - 8, top + at * high + 15, f'P{k}{i}', 11, 'end', FAINT)
        for x in (x for x in rows if x['run'] == name):
            at = cells.index((x['row'], x['column']))
            x0, y0 = left + (x['cycle'] - 1) * wide, top + at * high
            drawing.box(x0, y0, wide - 2, high - 2, COLORS[x['action']])
            ink = PAPER if x['action'] == ROOT else BLACK
            drawing.text(x0 + wide / 2 - 1, y0 + 15, x['label'], 11, fill=ink)
        for cycle in range(1, ends[name] + 1):
            drawing.text(left + (cycle - 0.5) * wide - 1, top - 6, cycle, 10, fill=FAINT)
    y = len(titles) * block + 22
    for k, (action, color) in enumerate(COLORS.items()):
        drawing.box(left + 165 * k, y - 11, 12, 12, color, GREY)
        drawing.text(left + 165 * k + 18, y, action, 12, 'start')
    return drawing.save(folder, 'array-cycles.svg')


def _figure_1(rows: Sequence[Row], folder: Path) -> Path:
    """Draw both designs with the streams of H, the register u of each cell and the results."""
    H, y = equation()
    n, side, left = len(H), 104, 190
    high = n * side + 56
    drawing = Drawing(620, 2 * high + 20, 'Figure 1 with numbers')
    titles = {
        PRINTED: 'As printed: equations (29) to (31)',
        'solve': "Corrected: H = L L', L z = y",
    }
    for part, (name, title) in enumerate(titles.items()):
        own = [x for x in rows if x['run'] == name]
        drawing.text(20, part * high + 24, title, 14, 'start', bold=True)
        for k in range(1, n + 1):
            at = part * high + 72 + (n - k) * side
            for i in range(1, k + 1):
                x = left + (i - 1) * side
                drawing.arrow(x + 26, at, x + (side - 27 if i < k else 48), at)
                if k < n:
                    drawing.arrow(x, at - 26, x, at - side + 27)
                _cell(drawing, x, at, [z for z in own if (z['row'], z['column']) == (k, i)], n)
            column = [f'{h:g}' for h in H[k - 1 :, k - 1]]
            start = next(x['cycle'] for x in own if x['row'] == k and x['action'] != STORE)
            if name == PRINTED:
                items, x = [*column[1:], column[0]], left + (k - 1) * side
                begin = next(z['cycle'] for z in own if z['row'] == z['column'] == k)
                drawing.arrow(x, at + 52, x, at + 27)
                drawing.text(x, at + 65, ', '.join([*column, '*']), 12)
                drawing.text(x, at + 78, f'from cycle {begin}', 10, fill=FAINT)
            else:
                items = [f'{column[0]}*', *column[1:], f'{y[k - 1]:g}']
            drawing.arrow(left - 54, at, left - 27, at)
            drawing.text(left - 60, at + 4, ', '.join(items), 12, 'end')
            drawing.text(left - 60, at + 18, f'from cycle {start}', 10, 'end', FAINT)
    words = 'In a cell: its register u. Streams are written in the order in which they enter.'
    drawing.text(20, 2 * high + 6, words, 12, 'start')
    return drawing.save(folder, 'array-figure-1.svg')


def _cell(drawing: Drawing, x: float, y: float, own: Sequence[Row], n: int) -> None:
    """Draw a cell with its register u, and right of a diagonal cell the results that leave it."""
    k, i = own[0]['row'], own[0]['column']
    if k == i:
        drawing.circle(x, y, 26, PAPER, GREY)
        # The way back comes later.
        leaving = [z for z in own if z['action'] != STORE and z['cycle'] < 3 * n]
        words = ', '.join(_written(z['number']) for z in leaving)
        drawing.text(x + 53, y + 4, words, 13, 'start')
        cycles = ' to '.join(dict.fromkeys(str(leaving[end]['cycle']) for end in (0, -1)))
        drawing.text(x + 53, y + 18, f'cycle {cycles}', 10, 'start', FAINT)
    else:
        drawing.box(x - 26, y - 26, 52, 52, PAPER, GREY)
    drawing.text(x, y - 6, f'P{k}{i}', 11, fill=FAINT)
    drawing.text(x, y + 14, _written(own[-1]['register']), 13, bold=True)
