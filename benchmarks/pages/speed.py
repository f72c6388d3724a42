# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The page speed: times of forward dynamics and of other quantities, compared with peers.

Peers get the numbers of our own robot. States are of the order of one, and torques belong to
accelerations of the order of one, so that differences between the results are not cancellation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product
import os
from pathlib import Path
from tempfile import TemporaryDirectory
import time
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.cases.problems import FORWARD, QUANTITIES, STATE, random_states
from benchmarks.cases.robots import robot
from benchmarks.peers.casadi import COMPILERS, LARGEST_ANGLE, casadi_c, vector_casadi
from benchmarks.peers.others import dynibo, frax, mujoco
from benchmarks.peers.ours import CODE, ours
from benchmarks.peers.pinocchio import CPP, Pinocchio, pinocchio_cpp
from benchmarks.peers.work import Peer, made, title_of, valid_sides
from benchmarks.plots import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION, panels
from benchmarks.run import show_progress
from benchmarks.table import Cells, bullets, grid, lines_of, page, result_row, short
from benchmarks.timing import Pace, surroundings, take_turns
from pfd_core.kernels.cache import VARIABLE
from pfd_core.kernels.compile import compile_kernel
from pfd_core.model.robot import Robot

Row = Mapping[str, Any]
Makers = Mapping[str, Callable[[Robot], Peer]]
# The arm of README.md.
ROBOT = 'ur5'
ARMS = (ROBOT, 'panda', 'puma560', 'dense6', 'chain6', 'chain12')
# States of a batch that fits into the caches, and takes long compared with its call overhead.
MIDDLE_BATCH = 4096
SIZES = (1, 64, 512, MIDDLE_BATCH, 65536)
OTHERS: Makers = {
    'Pinocchio': Pinocchio,
    CPP: pinocchio_cpp,
    'MuJoCo': mujoco,
    'dynibo': dynibo,
    'frax': frax,
    'CasADi C': casadi_c,
    **{f'CasADi C on vectors, {x}': partial(vector_casadi, compiler=x) for x in COMPILERS},
}
# Without the peers that take long to compile.
FAST = {name: make for name, make in OTHERS.items() if name not in (CPP, 'frax')}
OUR_METHODS = ('composite_body', 'grouped_articulated_body')
OURS = {
    f'{method} {dtype}': partial(ours, method=method, dtype=dtype)
    for method, dtype in product(OUR_METHODS, ('float64', 'float32'))
}


def measure(quick: bool) -> dict[str, Any]:
    """Return times, first results and exclusions; progress goes to stderr."""
    pace = Pace(chunk=1e-4, turns=3) if quick else Pace(budget=3.0)
    sizes, others = (SIZES[:2], FAST) if quick else (SIZES, OTHERS)
    data: dict[str, Any] = {'machine': surroundings(), 'rows': [], 'excluded': []}
    data['first'] = _first_results(robot(ROBOT))
    for name in ARMS[:1] if quick else ARMS:
        _measure(data, robot(name), FORWARD, {**others, **OURS}, sizes, pace)
    for name, quantity in product(ARMS[:1] if quick else ARMS[:2], QUANTITIES):
        makers: Makers = {
            'Pinocchio': partial(Pinocchio, quantity=quantity),
            'CasADi C': partial(casadi_c, quantity=quantity),
            'pfd': partial(ours, quantity=quantity),
        }
        if quantity != FORWARD:
            size = min(MIDDLE_BATCH, sizes[-1])
            _measure(data, robot(name), quantity, makers, [size], pace)
    return data


def _first_results(arm: Robot) -> list[Row]:
    """Return the seconds from a robot in memory to its first result, compiled and from disk."""
    rows, states = list[Row](), random_states(arm, 1)
    with TemporaryDirectory() as folder, patch.dict(os.environ, {VARIABLE: folder}):
        for code in ('compiled', 'from disk'):
            start = time.perf_counter()
            compile_kernel(arm)(*(states[name][0] for name in STATE))
            seconds = time.perf_counter() - start
            rows.append({'robot': arm.name, 'code': code, 'seconds': seconds})
    return rows


def _measure(
    data: dict[str, Any],
    arm: Robot,
    quantity: str,
    makers: Makers,
    sizes: Sequence[int],
    pace: Pace,
) -> None:
    """
    Add the rows of one call and of batches.

    A row has minimum and median [s a state], and times: the first way's time over this way's,
    median over the turns.
    """
    reasons = dict[str, str]()
    peers, states = made(makers, arm, reasons), random_states(arm, max(sizes))
    for size in (0, *sizes):
        arrays = (states[name] for name in QUANTITIES[quantity])
        given = [x[:size] if size else x[0] for x in arrays]
        show_progress(f'{arm.name}: {quantity}, {title_of(given)}')
        sides = valid_sides(peers, given, reasons)
        head = {'robot': arm.name, 'quantity': quantity, 'work': title_of(given)}
        for side, times in zip(sides, take_turns(sides, size or 1, pace), strict=True):
            own = {'way': side.way, 'contents': side.contents, **times._asdict()}
            data['rows'].append(head | own)
    data['excluded'] += [f'{way}, {quantity} of {arm.name}: {x}' for way, x in reasons.items()]


# From here on the page: all from the rows.

MANY, FEW = f'batch of {MIDDLE_BATCH}', 'batch of 64'
# Works: titles of columns, and work and end of the name of our ways.
PLAIN, BOUND = 'one call, `kernel(q, qd, tau)`', 'one call, bound'
COMPARED = {
    PLAIN: ('call', 'float64: kernel(q, qd, tau)'),
    BOUND: ('call', 'float64: bound'),
    FEW: (FEW, 'float64, F order'),
    'batch of 512': ('batch of 512', 'float64, F order'),
    MANY: (MANY, 'float64, F order'),
    f'{MANY}, C order': (MANY, 'float64, C order'),
}
# Rows of README.md: one or two works of COMPARED.
README = {
    f'a state in a {MANY}': (MANY,),
    'one call, arrays bound before / `kernel(q, qd, tau)`': (BOUND, PLAIN),
}
# Lines of the picture: label, beginnings and end of the ways, colour and marker.
LINES = (
    ('this library, float64', OUR_METHODS, 'float64, F order', BLUE, 'o'),
    ('this library, float32', OUR_METHODS, 'float32, F order', VERMILLION, '^'),
    ("CasADi's C on vectors of 8 states", ('CasADi C on vectors',), 'F order', GREEN, 'D'),
    ("CasADi's C", ('CasADi C comp',), 'loop in C', PURPLE, '*'),
    ('Pinocchio in C++', (CPP,), '', ORANGE, 's'),
    ('Pinocchio from Python', ('pinocchio',), '', 'black', 's'),
    ('MuJoCo', ('mujoco',), '', GREY, 'v'),
    ('frax', ('frax',), '', SKY, 'P'),
)


def text(data: dict[str, Any]) -> str:
    """Return the page."""
    rows = [row for row in data['rows'] if row['quantity'] == FORWARD]
    first = [[x['robot'], x['code'], short(x['seconds'] * 1e3)] for x in data['first']]
    return page(
        'speed',
        machine=data['machine'],
        angle=f'{LARGEST_ANGLE:g}',
        strongest=_strongest(data['rows']),
        general=for_any_robot(data),
        works='\n\n'.join(_by_work(rows)),
        first=lines_of(['robot', 'code', 'time [ms]'], first),
        contents=_contents(data['rows']),
        excluded=bullets(data['excluded'], 'Nothing.'),
    )


def _is_ours(row: Row) -> bool:
    return str(row['contents']).startswith(CODE)


def compared(
    rows: Iterable[Row], arm: str, quantity: str, title: str
) -> tuple[Row, Row, Row] | None:
    """
    Return our fastest row, the fastest peer and the fastest that takes any robot.

    They are of a work of COMPARED, on one thread; in C order peers take C order, too. None where a
    row is missing.
    """
    work, ending = COMPARED[title]
    place = arm, quantity, work
    same = [row for row in rows if (row['robot'], row['quantity'], row['work']) == place]
    peers = [row for row in same if not _is_ours(row)]
    if ending.endswith('C order'):
        peers = [row for row in peers if not row['way'].endswith('F order')]
    kinds = (
        [row for row in same if _is_ours(row) and row['way'].endswith(ending)],
        peers,
        [row for row in peers if 'any robot' in row['contents']],
    )
    if not all(kinds):
        return None
    own, peer, general = (min(kind, key=lambda row: float(row['minimum'])) for kind in kinds)
    return own, peer, general


def speed_up(own: Row, peer: Row) -> str:
    """Return the time of a peer over ours, from neighbouring turns, as text."""
    return short(own['times'] / peer['times'])


def _named(row: Row) -> str:
    return str(row['way']).replace(', F order', '').replace(', C order', '')


def _ns(row: Row) -> str:
    return f'{short(row["minimum"] * 1e9)} ns'


def results_rows(data: dict[str, Any]) -> list[dict[str, str]]:
    """Return the rows of README.md: what, ours, peer, theirs and our speed-up, as text."""
    rows = []
    for title, works in README.items():
        ways = (compared(data['rows'], ROBOT, FORWARD, work) for work in works)
        pairs = (found[:2] for found in ways if found is not None)
        cells = [(_ns(x), _named(y), _ns(y), speed_up(x, y)) for x, y in pairs]
        rows.append(result_row(f'forward dynamics of a UR5, {title}', cells))
    return rows


def for_any_robot(data: dict[str, Any]) -> str:
    """Return a sentence on the peers that take any robot; '' without them."""
    found = compared(data['rows'], ROBOT, FORWARD, MANY)
    if found is None:
        return ''
    own, _, general = found
    return (
        f'{_named(general)}, the fastest peer that takes any robot without compilation for it, '
        f'takes {_ns(general)} for a state in a {MANY}, {speed_up(own, general)} times ours.'
    )


def _strongest(rows: Sequence[Row]) -> list[str]:
    """Return our fastest ways and the fastest peer, for each robot and quantity."""
    if all(map(_is_ours, rows)):
        return ["No peer could be measured: `pip install '.[peers]'`, and gcc, clang or g++."]
    cells = Cells()
    places = dict.fromkeys((row['robot'], row['quantity']) for row in rows)
    for (arm, quantity), work in product(places, COMPARED):
        found = compared(rows, arm, quantity, work)
        if found is not None:
            own, peer, _ = found
            title = f'{arm}, {quantity}'.removesuffix(f', {FORWARD}').replace('_', ' ')
            cells[title, work] = f'{_ns(own)}, {speed_up(own, peer)} ({_named(peer)})'
    return grid(cells, 'robot, quantity')


def _by_work(rows: Sequence[Row]) -> Iterator[str]:
    """Yield a table of all ways over the robots, work by work."""
    for work in dict.fromkeys(row['work'] for row in rows):
        cells = Cells()
        for row in (row for row in rows if row['work'] == work):
            times = f'{short(row["minimum"] * 1e9)} / {short(row["median"] * 1e9)}'
            cells[row['way'], row['robot']] = f'{times} ({short(row["times"])})'
        yield '\n'.join([f'## {work.capitalize()} [ns]\n', *grid(cells)])


def _contents(rows: Sequence[Row]) -> list[str]:
    known: dict[tuple[str, str], dict[str, None]] = {}
    for row in rows:
        known.setdefault((row['work'].split()[0], row['contents']), {})[_named(row)] = None
    lines = ([*place, '; '.join(ways)] for place, ways in known.items())
    return lines_of(['work', 'code of one state; call and loop; numbers', 'ways'], lines)


def plots(data: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the least time of a state over the size of a batch."""
    titles = {ROBOT: 'UR5', 'chain12': 'chain of 12 joints'}
    drawn = []
    for arm, title in titles.items():
        rows = [row for row in data['rows'] if (row['robot'], row['quantity']) == (arm, FORWARD)]
        settings = {'title': title, 'xlabel': 'states of a batch', 'xticks': SIZES}
        settings |= {'xticklabels': SIZES, 'ylabel': 'least time of a state [ns]'}
        drawn.append((settings, [_line(rows, *line) for line in LINES]))
    return panels(drawn, folder / 'speed.png', (11, 5.8), 4)


def _line(
    rows: Sequence[Row], label: str, begin: tuple[str, ...], end: str, colour: str, marker: str
) -> tuple[list[tuple[int, float]], dict[str, Any]]:
    least: dict[int, float] = {}
    for row in rows:
        way, (kind, *size) = row['way'], row['work'].split(' of ')
        if kind == 'batch' and way.startswith(begin) and way.endswith(end):
            states = int(size[0])
            least[states] = min(least.get(states, np.inf), row['minimum'] * 1e9)
    return sorted(least.items()), {'label': label, 'color': colour, 'marker': marker}
