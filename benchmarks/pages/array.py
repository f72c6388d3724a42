# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The triangular array, as printed and corrected, cycle by cycle; recursive doubling; set ordering.

Both designs run on the emulated array. Its actions depend on n alone, so the identity is factored.
Utilisation is the share of the cells' cycles in which they computed or stored something.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases.paper import value
from benchmarks.plots import arrow, box, circle, svg, words
from benchmarks.table import Row, grid, page, stored_text, table, write_text
from pfd_core.algorithms.paper.array_solver import factor, pipeline, solve
from pfd_core.algorithms.paper.literal_array import STORE, literal_array
from pfd_core.algorithms.paper.set_ordering import set_ordering
from pfd_core.machine.emulator import run
from pfd_core.machine.patterns import prefix
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.machine.systolic import Place, Trace

SIZES = (2, 3, 4, 6, 8, 12, 16)
# Sizes of the pictures of both designs, as Figure 1, and of a whole solve, as the arms'.
FIGURE, SOLVED = 4, 6
LANES, SETS = 6, 4  # of recursive doubling, and of Appendix C
PRINTED, CORRECTED = 'as printed', 'corrected'
TITLES = {PRINTED: 'As printed: equations (29) to (31)', CORRECTED: "Corrected: H = L L'"}
RUNS: dict[str, Callable[[int], Trace]] = {
    PRINTED: lambda n: literal_array(np.eye(n)).trace,
    CORRECTED: lambda n: factor(np.eye(n)).trace,
    'forward': lambda n: factor(np.eye(n), np.ones(n)).trace,
    'solve': lambda n: solve(np.eye(n), np.ones(n)).trace,
    'pipeline': lambda n: pipeline([np.eye(n)] * 5)[0].trace,
}


def cells(n: int) -> Iterator[Place]:
    """Yield the rows and columns of the cells of an array."""
    return ((k, i) for k in range(1, n + 1) for i in range(1, k + 1))


def last_cycle(trace: Trace, place: Place | None = None, action: str | None = None) -> int:
    """Return the last cycle with an action in a place; None is any place or action."""
    return max(
        cycle
        for cycle, acting in enumerate(trace.actions, 1)
        for cell, done in acting.items()
        if place in (None, cell) and action in (None, done)
    )


# Design, event, who claims its cycle, formula, and run; of an event before the end, its cycle.
EVENTS = (
    (PRINTED, 'h_n1 is stored in P_n1', 'the paper', '2 n - 1', PRINTED),
    (PRINTED, 'all input from below is stored', 'the paper', '2 n - 1', PRINTED),
    (PRINTED, 'h_nn and the flag meet in P_n1', 'the paper', '2 n', PRINTED),
    (PRINTED, 'factorisation, a wrong matrix', 'the paper', '3 n - 1', PRINTED),
    (CORRECTED, 'factorisation', 'here', '3 n - 2', CORRECTED),
    (CORRECTED, 'with forward substitution', 'here', '3 n - 1', 'forward'),
    (CORRECTED, 'with both substitutions', 'here', '5 n - 2', 'solve'),
    (CORRECTED, '5 matrices, a new one every n cycles', 'here', '3 n - 2 + 4 n', 'pipeline'),
)
BEFORE_THE_END: dict[str, Callable[[int, Trace], int]] = {
    'h_n1 is stored in P_n1': lambda n, trace: last_cycle(trace, (n, 1), STORE),
    'all input from below is stored': lambda n, trace: last_cycle(trace, action=STORE),
    'h_nn and the flag meet in P_n1': lambda n, trace: last_cycle(trace, (n, 1)),
}


def measure(quick: bool) -> dict[str, Any]:
    """Run the arrays, recursive doubling and set ordering; quick is few sizes."""
    traces = {name: RUNS[name](SOLVED) for name in (PRINTED, CORRECTED, 'solve')}
    busy = {
        name: Counter(place for acting in trace.actions for place in acting)
        for name, trace in traces.items()
    }
    return {
        'times': list(times(SIZES[:3] if quick else SIZES)),
        'lengths': [{'run': name, 'cycles': trace.cycles} for name, trace in traces.items()],
        'cells': [
            {'row': k, 'column': i} | {name: count[k, i] for name, count in busy.items()}
            for k, i in cells(SOLVED)
        ],
        'actions': [
            *actions(PRINTED, FIGURE, lambda *at: literal_label(FIGURE, *at)),
            *actions(CORRECTED, FIGURE, corrected_label),
            *actions('solve', SOLVED, lambda place, cycle: ''),
        ],
        'doubling': list(doubling(LANES)),
        'sets': list(_sets(SETS)),
    }


def times(sizes: Iterable[int]) -> Iterator[dict[str, Any]]:
    """Yield every event at every n: cycles claimed and measured, utilisation at the end."""
    for n in sizes:
        for design, event, by, formula, name in EVENTS:
            trace, cycle = RUNS[name](n), BEFORE_THE_END.get(event)
            yield {
                'design': design,
                'event': event,
                'by': by,
                'formula': formula,
                'n': n,
                'claimed': int(value(formula, n)),
                'measured': cycle(n, trace) if cycle else trace.cycles,
                'utilisation': None if cycle else trace.utilisation,
            }


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


def corrected_label(place: Place, cycle: int) -> str:
    """Return the subscript of the element that a cell of the corrected design works on."""
    k, i = place
    return f'{cycle - k - i + 2}{k}'


def doubling(n: int) -> Iterator[dict[str, Any]]:
    """
    Yield each lane at each level of recursive doubling, as the emulator executes it.

    The recurrence x_i = x_(i-1) + a_i runs with a_i = 2^i: the binary digits of a lane's sum show
    which a_i it contains, from `first` to `last`. `source` is the lane that the level's route
    reads. Level 0 has the elements. Lanes and elements are counted from 1.
    """
    recorder = Recorder(n)
    sums: list[Lanes] = []

    def add(left: Lanes, right: Lanes) -> Lanes:
        sums.append(left + right)
        return sums[-1]

    a = recorder.input('a', range(n))
    prefix(add, a)
    # In a level a lane without a sum keeps its row.
    kept = [(a, lane) for lane in range(n)]
    for level, row in enumerate(sums):
        kept = [(row, lane) if row.defined >> lane & 1 else kept[lane] for lane in range(n)]
        recorder.output(f'level {level}', (n,), kept)
    program = recorder.program()
    found = run(program, {'a': 2.0 ** np.arange(n)})
    routes = (one.data for one in program.instructions if one.op == 'route')
    moves = [x for x in routes if any(s is not None and s != k for k, s in enumerate(x))]
    for level, sources in enumerate([[None] * n, *moves]):
        held = 2.0 ** np.arange(n) if level == 0 else found[f'level {level - 1}']
        for lane, (number, source) in enumerate(zip(held, sources, strict=True), 1):
            digits = f'{int(number):b}'
            first, last = len(digits) - digits.rindex('1'), len(digits)
            if digits.count('1') != last - first + 1:
                raise ValueError(f'a lane must hold consecutive elements, got {digits}')
            at = {'level': level, 'lane': lane, 'first': first, 'last': last}
            yield at | {'source': None if source is None else source + 1}


def _sets(n: int) -> Iterator[dict[str, Any]]:
    """Yield the sets before each iteration, longest first; a worker adds the last two terms."""
    states = set_ordering(n)
    for k, state in enumerate(states):
        picked = states[k + 1].picked if k + 1 < len(states) else ()
        for index in sorted(state.sets, key=lambda index: -state.additions[index]):
            yield {
                'iteration': k + 1,
                'set': 'S_{}{}'.format(*index),
                'terms': [str(term) for term in state.sets[index]],
                'worker': picked.index(index) + 1 if index in picked else None,
            }


# ---- the page ----


def text(data: dict[str, Any]) -> str:
    """Return the page."""
    rows, runs = data['times'], [x['run'] for x in data['lengths']]
    busy = {
        (x['row'], x['column']): ' / '.join(str(x[run]) for run in runs) for x in data['cells']
    }
    numbers = range(1, SOLVED + 1)
    return page(
        'array',
        claims=table(
            {
                'design': 'design',
                'event': 'event',
                'claimed by': 'by',
                'cycles': 'formula',
                'measured': lambda x: _verdict([y for y in rows if _title(y) == _title(x)]),
            },
            [x for x in rows if x['n'] == rows[0]['n']],
        ),
        cycles=grid({(_title(x), x['n']): x['measured'] for x in rows}, 'cycles measured, n ='),
        utilisation=grid(
            {
                (_title(x), x['n']): f'{x["utilisation"]:.0%}'
                for x in rows
                if x['utilisation'] is not None
            },
            'utilisation of the cells, n =',
        ),
        size=SOLVED,
        lengths=' / '.join(str(x['cycles']) for x in data['lengths']),
        cells=grid(
            {
                (str(k), f'column {i}'): busy.get((k, i), '')
                for k in numbers[::-1]
                for i in numbers
            },
            'row',
        ),
        lanes=LANES,
        sets=SETS,
        levels=max(x['level'] for x in data['doubling']),
        steps=list(_steps(data['sets'])),
    )


def _title(x: Row) -> str:
    return f'{x["design"]}: {x["event"]}'


def _verdict(rows: Sequence[Row]) -> str:
    """Return whether all sizes take the cycles claimed, or the largest size that does not."""
    wrong = [x for x in rows if x['measured'] != x['claimed']]
    if not wrong:
        return f'as claimed, n = {rows[0]["n"]} to {rows[-1]["n"]}'
    one = wrong[-1]
    return f'wrong: {one["measured"]} instead of {one["claimed"]} at n = {one["n"]}'


def _steps(rows: Sequence[Row]) -> Iterator[str]:
    """Yield what each processor makes in each iteration."""
    last = {(x['iteration'], x['set']): x['terms'][-1] for x in rows}
    for k in range(1, max(x['iteration'] for x in rows)):
        added = sorted(
            (x['worker'], x['set']) for x in rows if x['iteration'] == k and x['worker']
        )
        made = (f'P{worker} makes {last[k + 1, name]}' for worker, name in added)
        yield f'- Iteration {k}: ' + '; '.join(made)


# ---- pictures, row 1 of an array at the bottom, as in Figure 1 ----

MARGIN = 20
PALE = '#bbbbbb'
# Colour of each action, from a palette for colour-blind readers.
ACTIONS = {
    'square root': '#0072b2',
    'divide': '#e69f00',
    'multiply and subtract': '#d55e00',
    'store': '#009e73',
}
DONE, DOING, IDLE = '#cfe6f5', '#ffffff', '#eeeeee'
WORKERS = ('#f6d9b8', '#cfe6f5', '#cdeee2', '#f0d4e4')


def plots(data: dict[str, Any], folder: Path) -> list[Path]:
    """Draw cycles of both designs and of a whole solve, doubling, set ordering; copy designs."""
    by_run: dict[str, list[Row]] = {}
    for x in data['actions']:
        by_run.setdefault(x['run'], []).append(x)
    (cycles,) = (x['cycles'] for x in data['lengths'] if x['run'] == 'solve')
    both = {f'{TITLES[x]}, {by_run[x][-1]["cycle"]} cycles': by_run[x] for x in TITLES}
    pictures = {
        'array-designs': stored_text('array-designs.svg'),
        'array-cycles': _cycles(
            both, f'Triangular array, n = {FIGURE}: the element in each cell, cycle by cycle'
        ),
        'array': _cycles(
            {'': by_run['solve']},
            f'Triangular array, n = {SOLVED}: factorisation and both substitutions, '
            f'{cycles} cycles',
        ),
        'doubling': _levels(data['doubling']),
        'set-ordering': _frames(data['sets']),
    }
    return [write_text(folder, f'{name}.svg', picture) for name, picture in pictures.items()]


def _cell(k: int, i: int, x: float, y: float, radius: float, *style: str) -> str:
    """Return a cell: a circle on the diagonal, otherwise a square."""
    return circle(x, y, radius, *style) if i == k else box(x, y, 2 * radius, 2 * radius, *style)


def _cycles(runs: Mapping[str, Sequence[Row]], title: str) -> str:
    """Draw runs one below the other, a small array for every cycle; idle cells are outlines."""
    n = max(x['row'] for rows in runs.values() for x in rows)
    labelled = any(x['label'] for rows in runs.values() for x in rows)
    size, per_row, line = (22, 6, 20) if labelled else (14, 7, 20)
    side = n * size + 18
    body = [words(MARGIN, MARGIN + 4, title, 14)]
    names = list(dict.fromkeys(x['action'] for rows in runs.values() for x in rows))
    for k, name in enumerate(names):
        x = MARGIN + 170 * k
        body += [box(x + 5, 36, 10, 10, ACTIONS[name]), words(x + 15, 40, name)]
    top = MARGIN + 2.0 * line
    for heading, rows in runs.items():
        if heading:
            body.append(words(MARGIN, top + 14, heading, 12))
            top += line
        acting = {(x['cycle'], x['row'], x['column']): x for x in rows}
        cycles = rows[-1]['cycle']
        for t in range(cycles):
            left, y = MARGIN + t % per_row * side, top + t // per_row * (side + line)
            body.append(words(left, y + 12, f'cycle {t + 1}'))
            for k, i in cells(n):
                one = acting.get((t + 1, k, i))
                at = left + (i - 0.5) * size, y + line + (n - k + 0.5) * size
                fill = ACTIONS[one['action']] if one else 'none'
                body.append(_cell(k, i, *at, size / 2 - 1, fill, '#999999'))
                if one and one['label']:
                    body.append(words(at[0], at[1] + 3.5, one['label'], 10, 'middle', 'white'))
        top += -(-cycles // per_row) * (side + line) + 18
    return svg(2 * MARGIN + max(per_row * side, 170 * len(names)), top, title, body)


def _levels(rows: Sequence[Row]) -> str:
    """Draw the lanes of recursive doubling, a row for each level, with arrows for routes."""
    n, step, height = max(x['lane'] for x in rows), 96, 84
    title = f'Recursive doubling, n = {n}: R_1 R_2 .. R_i on lane i'
    body = [words(MARGIN, MARGIN + 4, title, 14)]
    for x in rows:
        at, y = MARGIN + (x['lane'] - 0.5) * step, MARGIN + 57 + x['level'] * height
        if x['lane'] == 1:
            k = x['level']
            heading = f'level {k}: lane i gets from lane i - {2 ** (k - 1)}' if k else 'R_i given'
            body.append(words(MARGIN + n * step + 16, y + 4, heading))
        if x['level'] == 0:
            body.append(words(at, MARGIN + 32, f'lane {x["lane"]}', anchor='middle'))
        else:
            body.append(arrow(at, y - height + 13, at, y - 13, PALE))
        if x['source']:
            source = MARGIN + (x['source'] - 0.5) * step
            body.append(arrow(source + 12, y - height + 13, at - 12, y - 13))
        held = ' .. '.join(dict.fromkeys((f'R{x["first"]}', f'R{x["last"]}')))
        body.append(box(at, y, step - 16, 26, DONE if x['first'] == 1 else DOING))
        body.append(words(at, y + 4, held, anchor='middle'))
    bottom = MARGIN + 44 + (rows[-1]['level'] + 1) * height
    return svg(MARGIN + n * step + 260, bottom, title, body)


def _frames(rows: Sequence[Row]) -> str:
    """Draw the sets before each iteration; a processor adds the coloured terms."""
    last, width, step, line = rows[-1]['iteration'], 350, 62, 26
    height = (len(rows) // last + 1) * line + 30
    title = f'Appendix C: set ordering, n = {SETS}, {last - 1} parallel additions'
    body = [words(MARGIN, MARGIN + 4, title, 14)]
    for k in range(last):
        left, top = MARGIN + k % 2 * width, MARGIN + 20 + k // 2 * height
        own = [x for x in rows if x['iteration'] == k + 1]
        count = sum(x['worker'] is not None for x in own)
        heading = f'Iteration {k + 1}: {count} additions' if count else 'Result'
        body.append(words(left, top + 14, heading, 12))
        for place, x in enumerate(own):
            y, terms = top + 34 + place * line, x['terms']
            body.append(words(left, y + 5, x['set']))
            for t, term in enumerate(terms):
                at, fill = left + 63 + t * step, IDLE if len(terms) == 1 else DOING
                if x['worker'] and t >= len(terms) - 2:
                    fill = WORKERS[x['worker'] - 1]
                body += [
                    box(at, y, step - 4, line - 6, fill),
                    words(at, y + 4, term, 10, 'middle'),
                ]
            if x['worker']:
                at = left + 38 + len(terms) * step
                body.append(words(at, y + 4, f'P{x["worker"]} adds', 10))
    rows_of_frames = -(-last // 2)
    return svg(2 * MARGIN + 2 * width, MARGIN + 20 + rows_of_frames * height, title, body)
