# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""PCRBM and PCGM of a small arm, to be followed by hand; the patterns of the paper in pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from operator import mul
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases import paper
from benchmarks.cases.paper import CORRECTED, Recording
from benchmarks.cases.worked_example import CENTERS, MASSES, MOMENTS, REACH, example
from benchmarks.drawings import FAINT, INK, PAPER, Drawing
from benchmarks.plots import BLACK, BLUE, GREY, ORANGE, SKY
from benchmarks.table import Row, grid, lines_of, page
from pfd_core.machine.emulator import run
from pfd_core.machine.lanes import merge
from pfd_core.machine.operations import OPERATIONS
from pfd_core.machine.recorder import Recorder, lanes_of
from pfd_core.paper.lanes import taken
from pfd_core.paper.patterns import levels, prefix_affine
from pfd_core.paper.solve import set_ordering

# Lanes of the pictures; rows of the sets as in Appendix C.
LANES, SETS = 6, 4


def measure(quick: bool) -> dict[str, Any]:
    """Run both procedures and the patterns; nothing is shorter in a quick run."""
    composite, conjugate = example('pcrbm'), example('pcgm')
    return {
        'pcrbm': composite,
        'pcgm': conjugate,
        'doubling': list(doubling(LANES)),
        'sets': list(_sets(SETS)),
        'lanes': list(busy_lanes()),
    }


# ---- the patterns ----


def doubling(n: int) -> Iterator[dict[str, Any]]:
    """
    Yield each lane at each level of FOIHRA, as the emulator executes it.

    A batch shows what a lane holds. With a_i = 1 and one b_k alone, Y contains b_k where it is not
    zero; with one a_k = 0, X contains a_k where it is zero. The terms of Y are b_first to b_last,
    the factors of X a_lowest to a_last. Lanes and elements are counted from 1.
    """
    recorder = Recorder(n, 'unpacked')
    a, b = (recorder.input(name, range(n)) for name in 'ab')
    found = [(a, b)]
    for sources in levels(recorder, downward=False):
        X, Y = found[-1]
        Y = merge(X * taken(Y, sources) + Y, Y)
        found.append((merge(X * taken(X, sources), X), Y))
    answer = prefix_affine(a, b, mul, mul)
    for level, pair in enumerate([*found, (a, answer)]):
        for name, row in zip('XY', pair, strict=True):
            recorder.output(f'{name}{level}', (n,), [(row, lane) for lane in range(n)])
    program, ones, unit = recorder.program(), np.ones((n, n)), np.eye(n)
    terms = run(program, {'a': ones, 'b': unit})
    factors = run(program, {'a': ones - unit, 'b': unit})
    if not np.array_equal(terms[f'Y{len(found) - 1}'], terms[f'Y{len(found)}']):
        raise ValueError('the levels must give what prefix_affine does')
    for level in range(len(found)):
        for lane in range(1, n + 1):
            first, last = _consecutive(terms[f'Y{level}'][:, lane - 1] != 0)
            lowest, _ = _consecutive(factors[f'X{level}'][:, lane - 1] == 0)
            held = {'first': first, 'last': last, 'lowest': lowest}
            yield {'level': level, 'lane': lane, **held}


def _consecutive(held: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the first and the last element that is held, from 1; all between must be."""
    elements = np.flatnonzero(held) + 1
    if len(elements) != elements[-1] - elements[0] + 1:
        raise ValueError(f'a lane must hold consecutive elements, got {elements}')
    return int(elements[0]), int(elements[-1])


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


def busy_lanes() -> Iterator[dict[str, Any]]:
    """
    Yield the steps of PCRBM, corrected, for LANES joints: what each is, and its busy lanes.

    Equal neighbouring steps are one row. A route is what its lanes receive.
    """
    program = paper.program_of(Recording('pcrbm', LANES, CORRECTED))

    def kind(one: Any) -> tuple[str, str, list[int]]:
        busy = lanes_of(one.active)
        if one.op == 'route':
            moved = enumerate(one.data)
            busy = tuple(lane for lane, source in moved if source not in (None, lane))
        return one.section, OPERATIONS[one.op].cost or '', [lane + 1 for lane in busy]

    steps = (x for x in map(kind, program.instructions) if x[1] and x[2])
    for (section, cost, lanes), equal in groupby(steps):
        yield {'section': section, 'kind': cost, 'lanes': lanes, 'steps': len(list(equal))}


# ---- the page ----


def text(data: dict[str, Any]) -> str:
    """Return the page."""
    return page(
        'worked-example',
        links=lines_of(
            ('link', 'p*_i', 's_i', 'm_i', 'J_i'),
            (
                (k + 1, _shown(REACH[k]), _shown(CENTERS[k]), _shown(MASSES[k]), _shown(J))
                for k, J in enumerate(MOMENTS)
            ),
        ),
        **{f'pcrbm_{step}': _table(data['pcrbm'], step) for step in map(str, range(1, 11))},
        pcgm_start=_table(data['pcgm'], '4', '5'),
        pcgm_product=_table(data['pcgm'], 'H u'),
        **{f'pcgm_{k}': _table(data['pcgm'], f'iteration {k}') for k in (1, 2, 3)},
        difference=f'{_difference(data):.0e}',
        lanes=LANES,
        steps=sum(x['steps'] for x in data['lanes'] if x['kind'] != 'routes'),
        routes=sum(x['steps'] for x in data['lanes'] if x['kind'] == 'routes'),
        sets=SETS,
        ordering=grid(
            {(x['set'], f'before iteration {x["iteration"]}'): _terms(x) for x in data['sets']},
            'set',
        ),
    )


def _table(rows: Sequence[Row], *steps: str) -> list[str]:
    own = [x for x in rows if x['step'] in steps]
    titles = ('', *(f'lane {k + 1}' for k in range(len(own[0]['lanes']))))
    return lines_of(titles, ([f'`{x["name"]}`', *map(_shown, x['lanes'])] for x in own))


def _shown(value: Any) -> str:
    """Return a number, a vector, the rows of a matrix, or the elements of a symmetric one."""
    if value is None:
        return ''
    # Six digits, and no minus sign of a zero.
    numbers = np.array([float(f'{x:.6g}') + 0.0 for x in np.ravel(value)])
    words = [f'{x:g}' for x in numbers]
    if np.shape(value) == (3, 3):
        return '; '.join(' '.join(words[k : k + 3]) for k in (0, 3, 6))
    if np.shape(value) == (6,):
        names = zip(('xx', 'xy', 'xz', 'yy', 'yz', 'zz'), words, strict=True)
        return ', '.join(f'{name} {x}' for name, x in names if x != '0')
    return f'({", ".join(words)})' if len(words) > 1 else words[0]


def _difference(data: Mapping[str, Any]) -> float:
    """Return the largest difference of both accelerations."""
    one, other = (np.array(data[name][-1]['lanes']) for name in ('pcrbm', 'pcgm'))
    return float(np.abs(one - other).max())


def _terms(x: Row) -> str:
    return ', '.join(x['terms']) + (f' (P{x["worker"]})' if x['worker'] else '')


# ---- pictures ----

# Of steps one after the other, light to dark.
SHADES = ('#d9ecf7', '#b3d9ef', '#8cc5e6', '#66b2de', '#409fd5')
FINAL = '#f6d9a8'


def plots(data: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the sweeps, FOIHRA, and PCRBM lane by time."""
    return [
        _sweeps(data['lanes'], folder),
        _foihra(data['doubling'], folder),
        _lanes(data['lanes'], folder),
    ]


def _sweeps(rows: Sequence[Row], folder: Path) -> Path:
    """Draw the step in which each element of both sweeps is computed."""
    n, side = LANES, 62
    drawing = Drawing(2 * n * side + 210, n * side + 106, 'Row sweep and column sweep')
    swept = [x['lanes'] for x in rows if x['section'] == 'row sweep' and x['kind'] == 'additions']
    elements = {(j, j): ('n', 0) for j in range(1, n + 1)}
    for step, lanes in enumerate(swept, 1):
        elements |= {(n - step, j): ('n', step) for j in lanes}
    _triangle(drawing, 30, elements, 'Row sweep (25): n_ij = n_(i+1)j + b_ij', up=True)
    steps = [x for x in rows if x['section'] == 'column sweeps']
    divided = [x['lanes'][0] for x in steps if x['kind'] == 'divisions'][:n]
    products = [x['lanes'] for x in steps if x['kind'] == 'multiplications'][: n - 1]
    elements = {(j, j): ('x', step) for step, j in enumerate(divided, 1)}
    for step, lanes in enumerate(products, 1):
        elements |= {(k, divided[step - 1]): ('l', step) for k in lanes}
    _triangle(drawing, n * side + 100, elements, 'Column sweep: L x = y', up=False)
    return drawing.save(folder, 'sweeps.svg')


def _triangle(
    drawing: Drawing, left: float, elements: Mapping[Any, tuple[str, int]], title: str, up: bool
) -> None:
    """Draw a triangle of elements, each with its step and an arrow of what it is made from."""
    n, side, top = LANES, 62, 50
    drawing.text(left, 24, title, 14, 'start', bold=True)
    for (i, j), (name, step) in elements.items():
        x, y = left + (j - 1) * side, top + (i - 1) * side
        fill = PAPER if step == 0 else SHADES[min(step, len(SHADES)) - 1]
        drawing.box(x, y, side - 10, side - 14, FINAL if name == 'x' else fill, GREY)
        drawing.text(x + side / 2 - 5, y + 20, f'x{j}' if name == 'x' else f'{name}{i}{j}', 13)
        words = 'given' if step == 0 else f'step {step}'
        drawing.text(x + side / 2 - 5, y + 38, words, 10, fill=INK)
        if up and step:
            drawing.arrow(x + side / 2 - 5, y + side, x + side / 2 - 5, y + side - 13)
        elif name == 'l' and i == j + 1:
            drawing.arrow(x + side / 2 - 5, y - 14, x + side / 2 - 5, y - 1)
    for k in range(1, n + 1):
        x, y = left + (k - 1) * side + side / 2 - 5, top + (k - 1) * side + 28
        if up:
            drawing.text(x, top + n * side + 12, f'lane {k}', 11, fill=FAINT)
        else:
            drawing.text(left + n * side, y, f'lane {k}', 11, 'start', FAINT)
    words = (
        'A lane has a column; a step fills a row, from below.'
        if up
        else 'A lane has a row; in step j lane j divides, and the lanes below subtract l_kj x_j.'
    )
    drawing.text(left, top + n * side + 36, words, 12, 'start')


def _foihra(rows: Sequence[Row], folder: Path) -> Path:
    """Draw coefficient and terms of each lane at each level."""
    n, wide, high, left, top = LANES, 128, 96, 70, 62
    deep = max(x['level'] for x in rows)
    drawing = Drawing(left + n * wide + 10, top + deep * high + 80, 'FOIHRA, level by level')
    drawing.text(left, 24, 'FOIHRA: x_i = a_i x_(i-1) + b_i, x_0 = 0', 14, 'start', bold=True)

    def span(name: str, first: int, last: int) -> str:
        if last - first > 1:
            return f'{name}{first} .. {name}{last}'
        return ', '.join(f'{name}{k}' for k in dict.fromkeys((first, last)))

    for x in rows:
        k, lane = x['level'], x['lane']
        at, y = left + (lane - 1) * wide, top + k * high
        if k == 0:
            drawing.text(at + 54, top - 12, f'lane {lane}', 12, fill=FAINT)
        source = lane - 2 ** (k - 1) if k else 0
        if source > 0:
            drawing.arrow(left + (source - 1) * wide + 54, y - high + 50, at + 54, y - 1)
        drawing.box(at, y, 108, 48, FINAL if x['first'] == 1 else SHADES[0], GREY)
        # Products of coefficients are of no use once the terms are complete.
        if k < deep:
            drawing.text(at + 54, y + 19, f'X: {span("a", x["lowest"], lane)}', 11)
        drawing.text(
            at + 54, y + (38 if k < deep else 29), f'Y: {span("b", x["first"], lane)}', 11
        )
    for k in range(deep + 1):
        drawing.text(8, top + k * high + 29, f'level {k}', 12, 'start', FAINT)
    words = (
        'X is the product of the coefficients named, Y contains the terms named. Orange is final.'
    )
    drawing.text(left, top + deep * high + 70, words, 12, 'start')
    return drawing.save(folder, 'foihra.svg')


# What a section of PCRBM is called in the chart: the steps of the paper.
PAPER_STEPS = {
    'orientation': '1',
    'link vectors': '2',
    'newton_euler': '9',
    'right-hand side': '9',
    'equation (15)': '3',
    'equations (16), (17)': '4',
    'equation (18)': '4',
    'equation (19)': '5',
    'equation (20)': '5',
    'step 6': '6',
    'equation (23)': '7',
    'diagonal of H': '8',
    'moments of the row sweep': '7',
    'row sweep': '7',
    'elements of H': '8',
    'factorisation': '10, L',
    'column sweeps': '10, x',
}
COLORS = {'additions': BLUE, 'multiplications': SKY, 'divisions': ORANGE, 'square_roots': BLACK}
MOVED = '#bbbbbb'


def _lanes(rows: Sequence[Row], folder: Path) -> Path:
    """Draw what each lane does in each step."""
    steps = [x for x in rows for _ in range(x['steps'])]
    half, high, left = -(-len(steps) // 2), 22, 60
    wide = 2.0
    drawing = Drawing(left + half * wide + 20, 2 * (LANES * high + 62) + 84, 'PCRBM lane by time')
    title = f'PCRBM, corrected, n = {LANES}: {len(steps)} steps'
    drawing.text(left, 22, title, 14, 'start', bold=True)
    legend = [*COLORS.items(), ('routes', MOVED), ('idle', PAPER)]
    for k, (kind, color) in enumerate(legend):
        drawing.box(left + 130 * k, 34, 12, 12, color, GREY)
        drawing.text(left + 130 * k + 18, 45, kind.replace('_', ' '), 13, 'start')
    for part in range(2):
        own = steps[part * half : (part + 1) * half]
        top = 86 + part * (LANES * high + 62)
        corners: dict[str, list[tuple[float, float, float]]] = {}
        for lane in range(1, LANES + 1):
            y, at = top + (lane - 1) * high, 0
            drawing.text(left - 8, y + 15, f'lane {lane}', 13, 'end', FAINT)
            for color, equal in groupby(_color(x, lane) for x in own):
                width = len(list(equal))
                corners.setdefault(color, []).append((left + at * wide, y, width * wide))
                at += width
        for color, found in corners.items():
            if color:
                drawing.boxes(found, high - 3, color)
        at = 0
        for name, equal in groupby(PAPER_STEPS[x['section']] for x in own):
            width = len(list(equal))
            drawing.box(left + at * wide, top - 6, 1, LANES * high + 6, GREY)
            if width > 4:
                drawing.text(left + (at + width / 2) * wide, top - 10, name, 13)
            at += width
        y = top + LANES * high + 16
        drawing.text(left, y, f'step {part * half + 1}', 13, 'start', FAINT)
        drawing.text(left + at * wide, y, f'step {part * half + at}', 13, 'end', FAINT)
    captions = (
        'Above the lanes: the steps of the paper, in the order in which the program runs. Step 9 '
        'needs step 2 alone, and goes on below.',
        'Steps 7 and 8 are twice: first n_jj and the diagonal of H, then the pairs i < j and the '
        'row sweep.',
    )
    for k, words in enumerate(captions):
        drawing.text(left, 2 * (LANES * high + 62) + 60 + 18 * k, words, 13, 'start')
    return drawing.save(folder, 'pcrbm-lanes.svg')


def _color(x: Row, lane: int) -> str:
    """Return the colour of a lane in a step; empty if it is idle."""
    if lane not in x['lanes']:
        return ''
    return MOVED if x['kind'] == 'routes' else COLORS[x['kind']]
