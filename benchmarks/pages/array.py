# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The triangular array, as printed and corrected, cycle by cycle; recursive doubling; set ordering.

Both designs run on the emulated array. Its actions depend on n alone, so the identity is factored.
Utilisation is the share of the cells' cycles in which they computed or stored something.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from benchmarks.cases.paper import value
from benchmarks.table import Row, grid, page
from pfd_core.machine.emulator import run
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.paper.array import STORE, factor, literal_array, pipeline, solve
from pfd_core.paper.patterns import prefix
from pfd_core.paper.set_ordering import set_ordering
from pfd_core.paper.systolic import Place, Trace

SIZES = (2, 3, 4, 6, 8, 12, 16)
# Rows of the array as in Figure 1, lanes of recursive doubling, and rows as in Appendix C.
FIGURE, LANES, SETS = 4, 6, 4
PRINTED, CORRECTED = 'as printed', 'corrected'
RUNS: dict[str, Callable[[int], Trace]] = {
    PRINTED: lambda n: literal_array(np.eye(n)).trace,
    CORRECTED: lambda n: factor(np.eye(n)).trace,
    'forward': lambda n: factor(np.eye(n), np.ones(n)).trace,
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
    """Run the arrays, recursive doubling and set ordering; quick is few sizes."""
    return {
        'times': list(times(SIZES[:3] if quick else SIZES)),
        'actions': [
            *actions(PRINTED, FIGURE, lambda *at: literal_label(FIGURE, *at)),
            *actions(CORRECTED, FIGURE, corrected_label),
        ],
        'doubling': list(doubling(LANES)),
        'sets': list(_sets(SETS)),
    }


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


def corrected_label(place: Place, cycle: int) -> str:
    """Return the subscript of the element that a cell of the corrected design works on."""
    k, i = place
    return f'{cycle - k - i + 2}{k}'


def doubling(n: int) -> Iterator[dict[str, Any]]:
    """
    Yield each lane at each level of recursive doubling, as the emulator executes it.

    The recurrence x_i = x_(i-1) + a_i runs with a_i = 2^i: the binary digits of a lane's sum show
    which a_i it contains, from `first` to `last`. Lanes and elements are counted from 1.
    """
    recorder = Recorder(n)
    levels: list[Lanes] = []

    def add(left: Lanes, right: Lanes) -> Any:
        levels.append(right)
        return left + right

    levels.append(prefix(add, recorder.input('a', range(n))))
    for level, row in enumerate(levels):
        recorder.output(str(level), (n,), [(row, lane) for lane in range(n)])
    found = run(recorder.program(), {'a': 2.0 ** np.arange(n)})
    for level in range(len(levels)):
        for lane, number in enumerate(found[str(level)], 1):
            digits = f'{int(number):b}'
            first, last = len(digits) - digits.rindex('1'), len(digits)
            if digits.count('1') != last - first + 1:
                raise ValueError(f'a lane must hold consecutive elements, got {digits}')
            yield {'level': level, 'lane': lane, 'first': first, 'last': last}


def _sets(n: int) -> Iterator[dict[str, Any]]:
    """Yield the sets before each iteration, longest first; a worker adds the last two terms."""
    states = set_ordering(n)
    for k, state in enumerate(states):
        picked = states[k + 1].picked if k + 1 < len(states) else ()
        for index in sorted(state.additions, key=lambda index: -state.additions[index]):
            yield {
                'iteration': k + 1,
                'set': 'S_{}{}'.format(*index),
                'terms': state.terms(index),
                'worker': picked.index(index) + 1 if index in picked else None,
            }


# ---- the page ----


def text(data: dict[str, Any]) -> str:
    """Return the page."""
    title = '{design}: {event}, {formula}'
    return page(
        'array',
        cycles=grid({(title.format(**x), x['n']): _cycles(x) for x in data['times']}, 'n ='),
        figure=FIGURE,
        printed=_acting(data['actions'], PRINTED),
        corrected=_acting(data['actions'], CORRECTED),
        lanes=LANES,
        levels=max(x['level'] for x in data['doubling']),
        doubling=grid(
            {(x['level'], f'lane {x["lane"]}'): _held(x) for x in data['doubling']}, 'level'
        ),
        sets=SETS,
        ordering=grid(
            {(x['set'], f'before iteration {x["iteration"]}'): _terms(x) for x in data['sets']},
            'set',
        ),
    )


def _cycles(x: Row) -> str:
    claimed = '' if x['measured'] == x['claimed'] else f', not {x["claimed"]}'
    utilisation = f' ({x["utilisation"]:.0%})' if 'utilisation' in x else ''
    return f'{x["measured"]}{claimed}{utilisation}'


def _acting(rows: Iterable[Row], design: str) -> list[str]:
    """Return what each cell does in each cycle; it rests where a place is empty."""
    own = [x for x in rows if x['run'] == design]
    known = {
        (x['row'], x['column'], x['cycle']): f'{x["action"].split()[-1]} {x["label"]}' for x in own
    }
    cycles = range(1, max(x['cycle'] for x in own) + 1)
    cells = ((k, i) for k in range(1, FIGURE + 1) for i in range(1, k + 1))
    return grid(
        {(f'P_{k}{i}', t): known.get((k, i, t), '') for k, i in cells for t in cycles}, 'cycle'
    )


def _held(x: Row) -> str:
    held = ' .. '.join(dict.fromkeys((f'R_{x["first"]}', f'R_{x["last"]}')))
    return f'**{held}**' if x['first'] == 1 else held


def _terms(x: Row) -> str:
    return ', '.join(x['terms']) + (f' (P{x["worker"]})' if x['worker'] else '')
