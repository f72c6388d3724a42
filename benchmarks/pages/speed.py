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
from math import inf
import os
from pathlib import Path
from tempfile import TemporaryDirectory
import time
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from benchmarks.cases.quantities import FORWARD, QUANTITIES, random_states
from benchmarks.cases.robots import robot
from benchmarks.peers import ours
from benchmarks.peers.casadi import METHODS, Casadi
from benchmarks.peers.mujoco import Mujoco
from benchmarks.peers.others import Dynibo, Frax
from benchmarks.peers.ours import Ours
from benchmarks.peers.pinocchio import Pinocchio
from benchmarks.peers.pinocchio_cpp import NAME as CPP
from benchmarks.peers.pinocchio_cpp import PinocchioCpp
from benchmarks.peers.vector_casadi import COMPILERS, LARGEST_ANGLE, VectorCasadi, sine_error
from benchmarks.peers.work import LeftOutError, Peer, Work, valid_sides, work_of
from benchmarks.plots import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION, logarithmic, save
from benchmarks.port_limit import limit_of
from benchmarks.run import show_progress
from benchmarks.table import Cells, bullets, grid, lines_of, order, page, short
from benchmarks.timing import Pace, differences, interleave, surroundings
from pfd_core.kernels.cache import VARIABLE
from pfd_core.kernels.compile import compile_kernel
from pfd_core.model import Robot

Row = Mapping[str, Any]
Makers = Mapping[str, Callable[[Robot], Peer]]
# Arms of the tables of README.md and the guide.
ROBOT, OTHER_ROBOT = 'ur5', 'panda'
OUR_METHODS = ('composite_body', 'grouped_articulated_body')
# The most numbers of an argument: more only measures the memory.
MOST_NUMBERS = 500_000
# States of a batch that fits into the caches, and takes long compared with its call overhead.
MIDDLE_BATCH = 4096
# Ends of ways that do more than the others.
NOT_COMPARED = (' 2 threads', ' refined')
MAKERS: Makers = {
    'Pinocchio': Pinocchio,
    CPP: PinocchioCpp,
    'MuJoCo': Mujoco,
    'dynibo': Dynibo,
    'frax': Frax,
    **{f'CasADi C {method}': partial(Casadi, method=method) for method in METHODS},
    **{f'CasADi C on vectors, {x}': partial(VectorCasadi, compiler=x) for x in COMPILERS},
    **{
        f'{method} {dtype}': partial(Ours, method=method, dtype=dtype)
        for method, dtype in product(OUR_METHODS, ('float64', 'float32'))
    },
}


class Plan(NamedTuple):
    """Robots, batches, steps of a rollout, pace, robots of other quantities, and peers."""

    robots: Sequence[str]
    sizes: Sequence[int]
    steps: int
    pace: Pace
    others: Sequence[str]
    makers: Makers


CHAINS = tuple(f'chain{n}' for n in (6, 12, 30, 60, 100))
ARMS = (ROBOT, OTHER_ROBOT, 'puma560', 'dense6', *CHAINS)
FULL = Plan(ARMS, (1, 64, 512, MIDDLE_BATCH, 65536), 1000, Pace(budget=3.0), ARMS[:2], MAKERS)
# Without the peers that take long to compile.
FAST = {name: make for name, make in MAKERS.items() if name not in (CPP, 'frax')}
QUICK = Plan((ROBOT,), (1, 64), 10, Pace(chunk=1e-4, turns=3), ('planar2',), FAST)


def measure(quick: bool) -> dict[str, Any]:
    """Return times, limits, first results and exclusions; progress goes to stderr."""
    plan = QUICK if quick else FULL
    data: dict[str, Any] = {'machine': surroundings(), 'rows': [], 'limits': [], 'excluded': []}
    data |= {'first': _first_results(robot(plan.others[0])), 'sines': []}
    for name in plan.robots:
        arm = robot(name)
        sizes = [size for size in plan.sizes if size * arm.n <= MOST_NUMBERS]
        kinds = [('call', 1), ('rollout', plan.steps), *(('batch', size) for size in sizes)]
        _measure(data, arm, FORWARD, kinds, plan.makers, plan.pace)
    for name, quantity in product(plan.others, QUANTITIES):
        makers: Makers = {
            'Pinocchio': partial(Pinocchio, quantity=quantity),
            'CasADi C': partial(Casadi, quantity=quantity),
            'pfd': partial(Ours, method='auto', dtype='float64', quantity=quantity),
        }
        kinds = [('call', 1), ('batch', min(MIDDLE_BATCH, plan.sizes[-1]))]
        if quantity != FORWARD:
            _measure(data, robot(name), quantity, kinds, makers, plan.pace)
    show_progress('')
    return data


def _first_results(arm: Robot) -> list[Row]:
    """Return the seconds from a robot in memory to its first result, compiled and from disk."""
    rows, (q, qd, tau) = list[Row](), work_of(FORWARD, random_states(arm, 1), 'call').arrays
    with TemporaryDirectory() as folder, patch.dict(os.environ, {VARIABLE: folder}):
        for code in ('compiled', 'from disk'):
            start = time.perf_counter()
            compile_kernel(arm)(q, qd, tau)
            seconds = time.perf_counter() - start
            rows.append({'robot': arm.name, 'code': code, 'seconds': seconds})
    return rows


def _measure(
    data: dict[str, Any],
    arm: Robot,
    quantity: str,
    kinds: Sequence[tuple[str, int]],
    makers: Makers,
    pace: Pace,
) -> None:
    """
    Add rows of all works, and the arithmetic limit of our fastest kernel in float64.

    A row has minimum and median [s a state or step], times (the reference's time over this way's,
    median over the turns) and difference (largest max|difference| / max|wanted| of a state).
    """
    reasons, peers = dict[str, str](), list[Peer]()
    for name, make in makers.items():
        show_progress(f'{arm.name}: making {quantity} of {name}')
        try:
            peers.append(make(arm))
        except LeftOutError as reason:
            reasons[name] = str(reason)
    vectors = [peer for peer in peers if isinstance(peer, VectorCasadi)]
    data['sines'] = data['sines'] or [{'way': x.name, 'ulp': sine_error(x)} for x in vectors]
    known = next((peer for peer in peers if isinstance(peer, Pinocchio)), None)
    states = random_states(arm, max(size for kind, size in kinds if kind == 'batch'))
    batches: dict[int, tuple[Work, list[Row]]] = {}
    for kind, size in kinds:
        work = work_of(quantity, states, kind, size)
        show_progress(f'{arm.name}: {quantity}, {work.title}')
        wanted = None if known is None else known.wanted(work)
        sides, rows = valid_sides(peers, work, reasons), list[Row]()
        for side, own in zip(sides, interleave(sides, work.units, pace), strict=True):
            off = None if wanted is None else float(np.max(differences(side.result(), wanted)))
            head = {'robot': arm.name, 'n': arm.n, 'quantity': quantity, 'work': work.title}
            head |= {'way': side.way, 'contents': side.contents}
            rows.append(head | vars(own) | {'difference': off})
        data['rows'] += rows
        if kind == 'batch':
            batches[abs(size - MIDDLE_BATCH)] = work, rows
    work, rows = batches[min(batches)]
    best = fastest(row for row in rows if _is_ours(row, work.title, 'float64, F order'))
    for peer in peers:
        if isinstance(peer, Ours) and best and best['way'] == f'{peer.name}, F order':
            show_progress(f'{arm.name}: {quantity}, arithmetic limit')
            try:
                limit = {'robot': arm.name, 'quantity': quantity, 'way': peer.name}
                data['limits'].append(limit | vars(limit_of(peer.kernel, work, pace)))
            except LeftOutError as reason:
                reasons[f'arithmetic limit of {peer.name}'] = str(reason)
    data['excluded'] += [
        {'way': f'{way}, {quantity}', 'robot': arm.name, 'why': why}
        for way, why in reasons.items()
    ]


def fastest(rows: Iterable[Row]) -> Row | None:
    """Return the row of the least time; None without rows."""
    return min(rows, key=lambda row: float(row['minimum']), default=None)


def _is_ours(row: Row, work: str, ending: str) -> bool:
    own = row['contents'].startswith(ours.CODE) and row['work'] == work
    return own and str(row['way']).endswith(ending)


def _is_peer(row: Row) -> bool:
    """Return whether a row is of a peer at the same work: on one thread, without refinement."""
    own = row['contents'].startswith(ours.CODE)
    return not own and not row['way'].endswith(NOT_COMPARED)


# From here on the page: all from the rows.

MANY, FEW = f'batch of {MIDDLE_BATCH}', 'batch of 64'
# Columns of the first table: title, and work and end of the name of our ways.
COMPARED = {
    'one call, `kernel(q, qd, tau)`': ('call', 'float64: kernel(q, qd, tau)'),
    'one call, `out=`': ('call', 'float64: kernel(..., out=)'),
    'one call, bound': ('call', 'float64: bound'),
    'rollout': ('rollout', 'float64'),
    FEW: (FEW, 'float64, F order'),
    'batch of 512': ('batch of 512', 'float64, F order'),
    MANY: (MANY, 'float64, F order'),
    f'{MANY}, C order': (MANY, 'float64, C order'),
}
# Rows of README.md and of the guide, of the arm ROBOT: title, quantity, work, end of our way.
# Rows of README.md: a work, and how our way of it ends, one or two of them.
README = (
    (f'a state in a {MANY}', (MANY, 'float64, F order')),
    (f'a state in a {FEW}', (FEW, 'float64, F order')),
    (
        'one call, arrays bound before / `kernel(q, qd, tau)`',
        ('call', 'float64: bound'),
        COMPARED['one call, `kernel(q, qd, tau)`'],
    ),
)
RESULTS = (
    (f'a state in a {MANY}', FORWARD, MANY, 'float64, F order'),
    (f'a state in a {FEW}', FORWARD, FEW, 'float64, F order'),
    ('one call, arrays bound before', FORWARD, 'call', 'float64: bound'),
)
GUIDE = (
    *RESULTS,
    ('a step of a Runge-Kutta rollout', FORWARD, 'rollout', 'float64'),
    (f'derivatives of qdd, a {MANY}', 'derivatives', MANY, 'float64, F order'),
    ('derivatives of qdd, one bound call', 'derivatives', 'call', 'float64: bound'),
)
# Lines of the picture: label, beginnings and ends of the ways, colour and marker.
IN_64, IN_32 = ('float64, F order', 'float64: bound'), ('float32, F order', 'float32: bound')
LINES = (
    ('this library, float64', OUR_METHODS, IN_64, BLUE, 'o'),
    ('this library, float32', OUR_METHODS, IN_32, VERMILLION, '^'),
    ("CasADi's C on vectors of 8 states", ('CasADi C on vectors',), ('F order',), GREEN, 'D'),
    ("CasADi's C", ('CasADi C comp', 'CasADi C art'), ('C', 'buffer()'), PURPLE, '*'),
    ('Pinocchio in C++', (CPP,), ('',), ORANGE, 's'),
    ('Pinocchio from Python', ('pinocchio',), ('',), 'black', 's'),
    ('MuJoCo', ('mujoco',), ('',), GREY, 'v'),
    ('frax', ('frax',), ('',), SKY, 'P'),
)


def text(data: dict[str, Any]) -> str:
    """Return the page."""
    rows = [row for row in data['rows'] if row['quantity'] == FORWARD]
    machine = data['machine']['description']
    if not any(map(_is_peer, rows)):
        return page('speed-alone', machine=machine)
    first = [[x['robot'], x['code'], short(x['seconds'] * 1e3)] for x in data['first']]
    sines = '; '.join(f'{row["way"]} {row["ulp"]:.1f}' for row in data['sines'])
    excluded: dict[tuple[str, str], list[str]] = {}
    for row in data['excluded']:
        excluded.setdefault((row['way'], row['why']), []).append(row['robot'])
    left_out = (f'{way} on {", ".join(on)}: {why}' for (way, why), on in excluded.items())
    return page(
        'speed',
        machine=machine,
        sines=sines or 'not measured',
        angle=f'{LARGEST_ANGLE:g}',
        headline=headline(data) or None,
        strongest=_strongest(rows, data['limits']),
        works='\n\n'.join(_by_work(rows)),
        first=lines_of(['robot', 'code', 'time [ms]'], first),
        quantities=_quantities(data),
        contents=_contents(data['rows']),
        differences=_differences(rows),
        excluded=bullets(left_out, 'Nothing.'),
    )


def speed_up(own: Row, peer: Row) -> float:
    """Return the time of a peer over ours: of neighbouring turns, if both rows have them."""
    if own['times'] is None or peer['times'] is None:
        return float(peer['median'] / own['median'])
    return float(own['times'] / peer['times'])


def compared(
    rows: Iterable[Row], arm: str, quantity: str, work: str, ending: str
) -> tuple[Row, Row, Row] | None:
    """
    Return our fastest row, the fastest peer and the fastest that takes any robot.

    The names of our ways end with `ending`; in C order peers take C order, too. None where a row
    is missing.
    """
    place = arm, quantity, work
    same = [row for row in rows if (row['robot'], row['quantity'], row['work']) == place]
    peers = [row for row in same if _is_peer(row)]
    if ending.endswith('C order'):
        peers = [row for row in peers if not row['way'].endswith('F order')]
    own = fastest(row for row in same if _is_ours(row, work, ending))
    strongest = fastest(peers)
    general = fastest(row for row in peers if 'any robot' in row['contents'])
    if own is None or strongest is None or general is None:
        return None
    return own, strongest, general


def _named(row: Row) -> str:
    return str(row['way']).replace(', F order', '').replace(', C order', '')


def _ns(row: Row) -> str:
    return f'{short(row["minimum"] * 1e9)} ns'


def _ratio(own: Row, peer: Row) -> str:
    return f'{short(speed_up(own, peer))} ({_named(peer)})'


def _relation(own: Row, peer: Row) -> str:
    ratio = speed_up(own, peer)
    times = f'{ratio:.1f} times as fast as' if ratio >= 1 else f'{1 / ratio:.1f} times the time of'
    return f'{times} {_named(peer)} ({_ns(peer)})'


def headline(data: dict[str, Any]) -> str:
    """Return the sentences on the arm ROBOT; '' where a row is missing."""
    plain = ('', FORWARD, *COMPARED['one call, `kernel(q, qd, tau)`'])
    values = {'processor': data['machine']['processor']}
    for key, (_, *place) in zip(('many', 'few', 'one', 'plain'), (*RESULTS, plain), strict=True):
        ways = compared(data['rows'], ROBOT, *place)
        if ways is None:
            return ''
        values |= {key: _ns(ways[0]), f'{key}_peer': _relation(*ways[:2])}
        if key == 'many':
            values['many_general'] = _relation(ways[0], ways[2])
    return page('speed-headline', **values)


def results_rows(data: dict[str, Any]) -> list[dict[str, str]]:
    """Return the rows of README.md: what, ours, peer, theirs and our speed-up, as text."""
    rows = []
    for title, *places in README:
        found = [compared(data['rows'], ROBOT, FORWARD, *place) for place in places]
        pairs = [ways[:2] for ways in found if ways is not None]
        if len(pairs) == len(places):
            columns = {
                'ours': (_ns(own) for own, _ in pairs),
                'peer': dict.fromkeys(_named(peer) for _, peer in pairs),
                'theirs': dict.fromkeys(_ns(peer) for _, peer in pairs),
                'speed-up': (short(speed_up(*pair)) for pair in pairs),
            }
            cells = {key: ' / '.join(texts) for key, texts in columns.items()}
            rows.append({'what': f'forward dynamics of a UR5, {title}'} | cells)
    return rows


def for_any_robot(data: dict[str, Any]) -> str:
    """Return a sentence of README.md on the peers that take any robot; '' without them."""
    title, *place = RESULTS[0]
    found = compared(data['rows'], ROBOT, *place)
    if found is None:
        return ''
    own, _, general = found
    return (
        f'{_named(general)}, the fastest peer that takes any robot without compilation for it, '
        f'takes {_ns(general)} for {title}, {short(speed_up(own, general))} times ours.'
    )


def guide_table(data: dict[str, Any]) -> str:
    """Return the table of the guide: works of one arm, with the speed-up over the peers."""
    lines = []
    for title, *place in GUIDE:
        found = compared(data['rows'], ROBOT, *place)
        if found is not None:
            own, *peers = found
            lines.append([title, _ns(own), *(_ratio(own, peer) for peer in peers)])
    titles = ['UR5', 'our time', 'times as fast as the fastest peer', 'the fastest for any robot']
    return '\n'.join(lines_of(titles, lines)) + '\n'


def guide_notes(data: dict[str, Any]) -> str:
    """Return the paragraph of the guide on derivatives of another arm and the arithmetic limit."""
    parts: dict[str, str] = {}
    for key, (_, *place) in zip(('batch', 'call'), GUIDE[-2:], strict=True):
        found = compared(data['rows'], OTHER_ROBOT, *place)
        if found is None:
            return ''
        parts |= {key: _relation(*found[:2]), f'{key}_general': _relation(found[0], found[2])}
    shares = _shares(data['limits'], FORWARD).values()
    return page('speed-notes', **parts, least=f'{min(shares):.0%}', most=f'{max(shares):.0%}')


def _shares(limits: Sequence[Row], quantity: str) -> dict[str, float]:
    return {row['robot']: row['times'] for row in limits if row['quantity'] == quantity}


def _strongest(rows: Sequence[Row], limits: Sequence[Row]) -> list[str]:
    """Return a table of our fastest ways over the fastest peer, robot by robot."""
    shares, cells = _shares(limits, FORWARD), Cells()
    for arm in dict.fromkeys(row['robot'] for row in rows):
        for title, place in COMPARED.items():
            found = compared(rows, arm, FORWARD, *place)
            if found is not None:
                cells[arm, title] = _ratio(*found[:2])
        cells[arm, 'share of the limit'] = f'{shares[arm]:.2f}' if arm in shares else '-'
    return grid(cells, 'robot')


def _by_work(rows: Sequence[Row]) -> Iterator[str]:
    """Yield a table of all ways over the robots, work by work."""
    for work in dict.fromkeys(row['work'] for row in rows):
        cells = Cells()
        for row in (row for row in rows if row['work'] == work):
            times = f'{short(row["minimum"] * 1e9)} / {short(row["median"] * 1e9)}'
            ratio = '' if row['times'] is None else f' ({short(row["times"])})'
            cells[row['way'], row['robot']] = times + ratio
        yield '\n'.join([f'## {work.capitalize()} [ns]\n', *grid(cells)])


def _quantities(data: dict[str, Any]) -> list[str]:
    """Return our times of each other quantity, and the speed-up over the peers."""
    rows, cells = [row for row in data['rows'] if row['quantity'] != FORWARD], Cells()
    for arm, quantity, work in dict.fromkeys((x['robot'], x['quantity'], x['work']) for x in rows):
        ending = 'float64: bound' if work == 'call' else 'float64, F order'
        found, place = compared(rows, arm, quantity, work, ending), f'{arm}, {quantity}'
        if found is not None:
            own, peer, general = found
            cells[place, f'{work} [ns]'] = short(own['minimum'] * 1e9)
            cells[place, f'{work}, times as fast as the fastest peer'] = _ratio(own, peer)
            cells[place, f'{work}, the fastest for any robot'] = _ratio(own, general)
        share = _shares(data['limits'], quantity).get(arm)
        cells[place, 'share of the limit'] = '-' if share is None else f'{share:.2f}'
    return grid(cells, 'quantity')


def _contents(rows: Sequence[Row]) -> list[str]:
    known: dict[tuple[str, str], dict[str, None]] = {}
    for row in rows:
        known.setdefault((row['work'].split()[0], row['contents']), {})[_named(row)] = None
    lines = ([*place, '; '.join(ways)] for place, ways in known.items())
    return lines_of(['work', 'code of one state; call and loop; numbers', 'ways'], lines)


def _differences(rows: Sequence[Row]) -> list[str]:
    """Return the largest difference of each way over all robots, rollouts apart."""
    cells: Cells = {}
    for row in sorted(rows, key=lambda row: -(row['difference'] or 0.0)):
        if row['difference'] is not None:
            column = 'rollout' if row['work'] == 'rollout' else 'accelerations'
            place = row['way'].split(':')[0].split(',')[0], column
            cells.setdefault(place, f'{order(row["difference"])} ({row["robot"]})')
    return grid(cells, 'way')


def plots(data: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the least time of a state over n, and over the size of a batch."""
    rows = [row for row in data['rows'] if row['quantity'] == FORWARD]
    return save(partial(_draw, rows), folder, 'speed', (15, 5.8), ['png'])


def _draw(rows: Sequence[Row], figure: Any) -> None:
    rows = [row for row in rows if not row['way'].endswith(NOT_COMPARED)]
    chains = [row for row in rows if row['robot'].startswith('chain')]
    batches = [x for x in rows if x['robot'] == ROBOT and x['work'].startswith('batch')]
    panels = (
        ('chains of n joints: one call', 'n', [x for x in chains if x['work'] == 'call']),
        (f'chains of n joints: {MANY}', 'n', [x for x in chains if x['work'] == MANY]),
        ('UR5: batches', 'states of a batch', batches),
    )
    for axes, (title, label, own) in zip(figure.subplots(1, 3), panels, strict=True):
        axes.set(title=title, xlabel=label, ylabel='least time of a state [ns]')
        logarithmic(axes)
        ticks: set[int] = set()
        for name, begin, ends, colour, marker in LINES:
            least: dict[int, float] = {}
            for row in own:
                if row['way'].startswith(begin) and row['way'].endswith(ends):
                    x = row['n'] if label == 'n' else int(row['work'].split()[-1])
                    least[x] = min(least.get(x, inf), row['minimum'] * 1e9)
            ticks |= set(least)
            places = sorted(least)
            values = [least[x] for x in places]
            axes.plot(places, values, color=colour, marker=marker, label=name)
        axes.set_xticks(sorted(ticks), [str(tick) for tick in sorted(ticks)])
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=4, frameon=False)
