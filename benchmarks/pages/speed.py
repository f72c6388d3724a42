# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The page speed: times of forward dynamics and of other quantities, compared with peers.

Peers get the numbers of our own robot. States are of the order of one, and torques belong to
accelerations of the order of one, so that differences between the results are not cancellation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import chain
from math import inf
import os
from pathlib import Path
from tempfile import TemporaryDirectory
import time
from typing import Any, NamedTuple

from benchmarks.cases.quantities import FORWARD, LINEAR_STEP, QUANTITIES, random_states
from benchmarks.cases.robots import robot
from benchmarks.peers import ours
from benchmarks.peers.casadi import METHODS, Casadi
from benchmarks.peers.dynibo import Dynibo
from benchmarks.peers.frax import Frax
from benchmarks.peers.mujoco import Mujoco
from benchmarks.peers.pinocchio import Pinocchio, PinocchioQuantity
from benchmarks.peers.pinocchio_cpp import NAME as CPP
from benchmarks.peers.pinocchio_cpp import PinocchioCpp, compiled_library
from benchmarks.peers.vector_casadi import COMPILERS, LARGEST_ANGLE, VectorCasadi, sine_error
from benchmarks.peers.work import LeftOutError, Peer, Side, Work, valid_sides, work_of
from benchmarks.plots import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION, logarithmic, save
from benchmarks.port_limit import limit_of
from benchmarks.run import show_progress
from benchmarks.table import Cells, bullets, grid, lines_of, order, page, short
from benchmarks.timing import MIDDLE_BATCH, Pace, described, surroundings, take_turns
from pfd_core.kernels.runtime.disk_cache import VARIABLE
from pfd_core.model import Robot

Row = Mapping[str, Any]
ARMS = ('ur5', 'panda', 'puma560', 'dense6')
CHAINS = tuple(f'chain{n}' for n in (6, 12, 30, 60, 100))
OUR_METHODS = ('composite_body', 'grouped_articulated_body')
# The most numbers of an argument: more only measures the memory.
MOST_NUMBERS = 500_000
OURS: dict[str, Callable[[Robot], Peer]] = {
    f'{method} {dtype}': partial(ours.make, method, dtype)
    for method in OUR_METHODS
    for dtype in ('float64', 'float32')
}
MAKERS: dict[str, Callable[[Robot], Peer]] = {
    'Pinocchio': Pinocchio,
    CPP: PinocchioCpp,
    'MuJoCo': Mujoco,
    'dynibo': Dynibo,
    'frax': Frax,
    **{f'CasADi C {method}': partial(Casadi, method=method) for method in METHODS},
    **{f'CasADi C on vectors, {x}': partial(VectorCasadi, compiler=x) for x in COMPILERS},
    **OURS,
}
OF_QUANTITY: dict[str, Callable[[Robot, str], Peer]] = {
    'Pinocchio': PinocchioQuantity,
    'CasADi C': Casadi,
    'pfd float64': lambda arm, quantity: ours.make_quantity(quantity, 'float64', 0, arm),
}


class Plan(NamedTuple):
    """Robots, batches, steps of a rollout, pace, robots of first results and of quantities."""

    robots: Sequence[str]
    sizes: Sequence[int]
    steps: int
    pace: Pace
    firsts: Sequence[str]
    quantities: Sequence[str]
    makers: Mapping[str, Callable[[Robot], Peer]]


SIZES = (1, 64, 512, 4096, 65536)
FULL = Plan((*ARMS, *CHAINS), SIZES, 1000, Pace(budget=3.0), ARMS[:2], ARMS[:2], MAKERS)
# Without the peers that take long to compile.
FAST = {name: make for name, make in MAKERS.items() if name not in (CPP, 'frax')}
QUICK = Plan(('ur5',), SIZES[:2], 10, Pace(chunk=1e-4, turns=3), (), ('planar2',), FAST)


def measure(quick: bool) -> dict[str, Any]:
    """Return times, limits, first results and exclusions; progress goes to stderr."""
    plan = QUICK if quick else FULL
    data: dict[str, Any] = {'machine': surroundings(), 'rows': [], 'limits': [], 'first': []}
    excluded: dict[tuple[str, str], list[str]] = {}
    for name in plan.robots:
        arm, reasons = robot(name), dict[str, str]()
        works = list(_works(arm, plan))
        first = data['first'] if name in plan.firsts else None
        peers = list(_made(arm, plan.makers, works, reasons, first))
        _add(data, arm, FORWARD, works, peers, plan.pace, reasons)
        vectors = (peer for peer in peers if isinstance(peer, VectorCasadi))
        if 'sines' not in data:
            data['sines'] = [{'way': one.name, 'ulp': sine_error(one)} for one in vectors]
        for reason in reasons.items():
            excluded.setdefault(reason, []).append(name)
    for name, quantity in ((x, y) for x in plan.quantities for y in QUANTITIES):
        arm, reasons, peers = robot(name), {}, []
        for peer, make in OF_QUANTITY.items():
            show_progress(f'{name}: making {quantity} of {peer}')
            try:
                peers.append(make(arm, quantity))
            except LeftOutError as reason:
                reasons[peer] = str(reason)
        states = random_states(arm, plan.sizes[-2] if len(plan.sizes) > 2 else plan.sizes[-1])
        works = [work_of(kind, quantity, states) for kind in ('call', 'batch')]
        _add(data, arm, quantity, works, peers, plan.pace, reasons)
        for way, why in reasons.items():
            excluded.setdefault((f'{way}, {quantity}', why), []).append(name)
    show_progress('')
    places = ((way, ', '.join(on), why) for (way, why), on in excluded.items())
    return data | {'excluded': [f'{way} on {on}: {why}' for way, on, why in places]}


def _works(arm: Robot, plan: Plan) -> Iterator[Work]:
    sizes = [size for size in plan.sizes if size * arm.n <= MOST_NUMBERS]
    states = random_states(arm, max(sizes))
    q, qd, tau = (states[name] for name in ('q', 'qd', 'tau'))
    yield Work('call', q[0], qd[0], tau[0])
    yield Work('rollout', q[0], qd[0], tau[0], plan.steps)
    for size in sizes:
        yield Work('batch', q[:size], qd[:size], tau[:size])


def _made(
    arm: Robot,
    makers: Mapping[str, Callable[[Robot], Peer]],
    works: list[Work],
    reasons: dict[str, str],
    first: list[Row] | None,
) -> Iterator[Peer]:
    """Yield the peers of a robot; exclusions, and times to a first result, are added."""
    for name, make in makers.items():
        show_progress(f'{arm.name}: making {name}')
        try:
            if first is None:
                yield make(arm)
                continue
            if make is PinocchioCpp:
                # For any robot, so that a first result does not contain it.
                compiled_library()
            with _empty_cache():
                peer, cold = _first_result(arm, make, works)
                warm = _first_result(arm, make, works)[1] if name in OURS else None
        except LeftOutError as reason:
            reasons[name] = str(reason)
        else:
            first.append({'robot': arm.name, 'way': name, 'cold': cold, 'disk': warm})
            yield peer


def _first_result(
    arm: Robot, make: Callable[[Robot], Peer], works: list[Work]
) -> tuple[Peer, float]:
    start = time.perf_counter()
    peer = make(arm)
    next(chain.from_iterable(map(peer.sides, works))).run()
    return peer, time.perf_counter() - start


@contextmanager
def _empty_cache() -> Iterator[None]:
    """Keep compiled code in an empty folder, which is removed when the block ends."""
    before = os.environ.get(VARIABLE)
    with TemporaryDirectory(prefix='pfd_speed_') as folder:
        os.environ[VARIABLE] = folder
        try:
            yield
        finally:
            os.environ.pop(VARIABLE)
            if before is not None:
                os.environ[VARIABLE] = before


def _add(
    data: dict[str, Any],
    arm: Robot,
    quantity: str,
    works: Sequence[Work],
    peers: Sequence[Peer],
    pace: Pace,
    reasons: dict[str, str],
) -> None:
    """Add rows of all works, and the arithmetic limit of our fastest kernel in float64."""
    rows: list[Row] = []
    for work in works:
        show_progress(f'{arm.name}: {quantity}, {work.title}')
        sides = valid_sides(_sides(peers, work, reasons), reasons)
        rows += [row | {'quantity': quantity} for row in take_turns(arm.name, work, sides, pace)]
    data['rows'] += rows
    batch = min(works, key=lambda work: abs(work.units - MIDDLE_BATCH))
    best = fastest(row for row in rows if _is_ours(row, batch.title, 'float64, F order'))
    for peer in peers:
        if isinstance(peer, ours.Ours) and best and best['way'] == f'{peer.name}, F order':
            head = {'robot': arm.name, 'quantity': quantity, 'way': peer.name}
            show_progress(f'{arm.name}: {quantity}, arithmetic limit')
            try:
                data['limits'].append(head | vars(limit_of(peer.kernel, batch, pace)))
            except LeftOutError as reason:
                reasons[f'arithmetic limit of {peer.name}'] = str(reason)


def _sides(peers: Sequence[Peer], work: Work, reasons: dict[str, str]) -> Iterator[Side]:
    for peer in peers:
        try:
            yield from peer.sides(work)
        except LeftOutError as reason:
            reasons[f'{type(peer).__name__}, {work.title}'] = str(reason)


def fastest(rows: Iterable[Row]) -> Row | None:
    """Return the row of the least time; None without rows."""
    return min(rows, key=lambda row: float(row['minimum']), default=None)


def _is_ours(row: Row, work: str, ending: str) -> bool:
    own = row['code'] == ours.CODE and row['work'] == work
    return own and str(row['way']).endswith(ending)


def _is_peer(row: Row) -> bool:
    """Return whether a row is of a peer at the same work: on one thread, without refinement."""
    return row['code'] != ours.CODE and not row['way'].endswith((' 2 threads', ' refined'))


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
ROBOT, OTHER_ROBOT = 'ur5', 'panda'
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
# From Pinocchio to ours: title, and beginnings and end of the ways of which the fastest counts.
STEPS = (
    ('Pinocchio from Python [ns]', ('Python loop',), ''),
    ('without calls from Python', (CPP,), ''),
    ('code for one robot', ('CasADi C composite', 'CasADi C articulated'), 'loop in C'),
    ('vectors of states', ('CasADi C on vectors',), ''),
    ('our kernel', OUR_METHODS, 'float64, F order'),
)
# Lines of the picture: label, beginnings and ends of the ways, colour and marker.
LINES = (
    ('this library, float64', OUR_METHODS, ('float64, F order', 'float64: bound'), BLUE, 'o'),
    (
        'this library, float32',
        OUR_METHODS,
        ('float32, F order', 'float32: bound'),
        VERMILLION,
        '^',
    ),
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
    if not any(map(_is_peer, rows)):
        return page('speed-alone', machine=described(data['machine']))
    first = [[x['robot'], x['way'], _ms(x['cold']), _ms(x['disk'])] for x in data['first']]
    sines = '; '.join(f'{row["way"]} {row["ulp"]:.1f}' for row in data['sines'])
    return page(
        'speed',
        machine=described(data['machine']),
        step=LINEAR_STEP * 1e3,
        sines=sines or 'not measured',
        angle=f'{LARGEST_ANGLE:g}',
        headline=headline(data) or None,
        strongest=_strongest(rows, data['limits']),
        factors=_factors(rows),
        works='\n\n'.join(_by_work(rows)),
        first=lines_of(['robot', 'way', 'compiled [ms]', 'from disk [ms]'], first),
        quantities=_quantities(data),
        contents=_contents(data['rows']),
        differences=_differences(rows),
        excluded=bullets(data['excluded'], 'Nothing.'),
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
    same = [
        row
        for row in rows
        if (row['robot'], row['quantity'], row['work']) == (arm, quantity, work)
    ]
    peers = [row for row in same if _is_peer(row)]
    if ending.endswith('C order'):
        peers = [row for row in peers if not row['way'].endswith('F order')]
    own = fastest(row for row in same if _is_ours(row, work, ending))
    strongest = fastest(peers)
    general = fastest(row for row in peers if 'any robot' in row['code'])
    if own is None or strongest is None or general is None:
        return None
    return own, strongest, general


def _named(row: Row) -> str:
    return str(row['way']).replace(', F order', '').replace(', C order', '')


def _ns(row: Row) -> str:
    return f'{short(row["minimum"] * 1e9)} ns'


def _ms(seconds: float | None) -> str:
    return '-' if seconds is None else short(seconds * 1e3)


def _ratio(own: Row, peer: Row) -> str:
    return f'{short(speed_up(own, peer))} ({_named(peer)})'


def _relation(own: Row, peer: Row) -> str:
    ratio = speed_up(own, peer)
    times = f'{ratio:.1f} times as fast as' if ratio >= 1 else f'{1 / ratio:.1f} times the time of'
    return f'{times} {_named(peer)} ({_ns(peer)})'


def headline(data: dict[str, Any]) -> str:
    """Return the sentences on the arm ROBOT; '' where a row is missing."""
    rows, machine = data['rows'], data['machine']
    call = compared(rows, ROBOT, FORWARD, *COMPARED['one call, `kernel(q, qd, tau)`'])
    found = [compared(rows, ROBOT, *place) for _, *place in RESULTS]
    values = {'processor': f'{"virtual " * bool(machine.get("virtual"))}{machine["processor"]}'}
    for key, ways in zip(('many', 'few', 'one', 'plain'), (*found, call), strict=True):
        if ways is None:
            return ''
        values |= {key: _ns(ways[0]), f'{key}_peer': _relation(*ways[:2])}
        if key == 'many':
            values['many_general'] = _relation(ways[0], ways[2])
    return page('speed-headline', **values)


def results_rows(data: dict[str, Any]) -> list[dict[str, str]]:
    """Return the rows of README.md: what, ours, peer, theirs and our speed-up, as text."""
    rows = []
    for title, *place in RESULTS:
        found = compared(data['rows'], ROBOT, *place)
        if found is not None:
            own, peer, _ = found
            row = {'what': f'forward dynamics of a UR5, {title}', 'ours': _ns(own)}
            row |= {'peer': _named(peer), 'theirs': _ns(peer)}
            rows.append(row | {'speed-up': short(speed_up(own, peer))})
    return rows


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


def _factors(rows: Sequence[Row]) -> list[str] | None:
    """Return a table of the factor over Pinocchio in steps; None without the ways."""
    lines = []
    for arm in dict.fromkeys(row['robot'] for row in rows):
        own = [row for row in rows if row['robot'] == arm and row['work'] == MANY]
        found = (
            fastest(x for x in own if x['way'].startswith(begin) and x['way'].endswith(end))
            for _, begin, end in STEPS
        )
        ways = [row for row in found if row is not None]
        if len(ways) == len(STEPS):
            pairs = [*zip(ways[1:], ways, strict=False), (ways[-1], ways[0])]
            factors = (short(speed_up(fast, slow)) for fast, slow in pairs)
            lines.append([arm, short(ways[0]['minimum'] * 1e9), *factors])
    return lines_of(['robot', *(title for title, *_ in STEPS), 'all'], lines) if lines else None


def _by_work(rows: Sequence[Row]) -> Iterator[str]:
    """Yield a table of all ways over the robots, work by work."""
    for work in dict.fromkeys(row['work'] for row in rows):
        cells = Cells()
        for row in (row for row in rows if row['work'] == work):
            times = f'{short(row["minimum"] * 1e9)} / {short(row["median"] * 1e9)}'
            ratio = '' if row['times'] is None else f' ({short(row["times"])})'
            cells[row['way'], row['robot']] = times + ratio
        yield '\n'.join([f'## {work.capitalize()} [ns]\n', *grid(cells)])


def _quantities(data: dict[str, Any]) -> str:
    """Return, robot by robot, our times of each quantity, and the speed-up over the peers."""
    rows = [row for row in data['rows'] if row['quantity'] != FORWARD]
    parts: list[str] = []
    for arm in dict.fromkeys(row['robot'] for row in rows):
        cells = Cells()
        for quantity in QUANTITIES:
            same = [row for row in rows if (row['robot'], row['quantity']) == (arm, quantity)]
            for work in dict.fromkeys(row['work'] for row in same):
                ending = 'float64: bound' if work == 'call' else 'float64, F order'
                own = fastest(row for row in same if _is_ours(row, work, ending))
                if own is None:
                    continue
                cells[quantity, f'{work} [ns]'] = short(own['minimum'] * 1e9)
                for name, word in {'Pinocchio': 'pinocchio', 'CasADi C': 'CasADi'}.items():
                    ways = (row for row in same if row['work'] == work and word in row['way'])
                    peer = fastest(ways)
                    ratio = '-' if peer is None else short(speed_up(own, peer))
                    cells[quantity, f'{work}, times as fast as {name}'] = ratio
            share = _shares(data['limits'], quantity).get(arm)
            cells[quantity, 'share of the limit'] = '-' if share is None else f'{share:.2f}'
        parts += [f'### {arm}\n', *grid(cells, 'quantity'), '']
    return '\n'.join(parts)


def _contents(rows: Sequence[Row]) -> list[str]:
    known: dict[tuple[str, ...], dict[str, None]] = {}
    for row in rows:
        place = (row['code'], row['call'], row['loop'] or '-', row['numbers'])
        known.setdefault((row['work'].split()[0], *place), {})[_named(row)] = None
    titles = ['work', 'code of one state', 'call', 'loop', 'numbers, sine and cosine', 'ways']
    return lines_of(titles, ([*place, '; '.join(ways)] for place, ways in known.items()))


def _differences(rows: Sequence[Row]) -> list[str]:
    """Return the largest difference of each program and robot, rollouts apart."""
    found: dict[tuple[str, object], float] = {}
    for row in rows:
        if row['difference'] is not None:
            work = 'rollout' if row['work'] == 'rollout' else 'accelerations'
            place = f'{work}: {row["way"].split(":")[0].split(",")[0]}', row['robot']
            found[place] = max(found.get(place, 0.0), row['difference'])
    cells: Cells = {place: order(value) for place, value in sorted(found.items(), key=_rollout)}
    return grid(cells)


def _rollout(item: tuple[tuple[str, object], float]) -> bool:
    return item[0][0].startswith('rollout')


def plots(data: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the least time of a state over n, and over the size of a batch."""
    rows = [row for row in data['rows'] if row['quantity'] == FORWARD]
    return save(partial(_draw, rows), folder, 'speed', (15, 5.8), ['png'])


def _draw(rows: Sequence[Row], figure: Any) -> None:
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
