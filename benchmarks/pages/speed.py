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
import os
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
from typing import Any, NamedTuple

from benchmarks.cases.quantities import FORWARD, LINEAR_STEP, QUANTITIES, random_states
from benchmarks.cases.robots import robot
from benchmarks.peers import casadi, ours
from benchmarks.peers.dynibo import Dynibo
from benchmarks.peers.frax import Frax
from benchmarks.peers.mujoco import Mujoco
from benchmarks.peers.pinocchio import Pinocchio, PinocchioQuantity
from benchmarks.peers.pinocchio_cpp import NAME as CPP
from benchmarks.peers.pinocchio_cpp import PinocchioCpp, compiled_library
from benchmarks.peers.vector_casadi import COMPILERS, LARGEST_ANGLE, VectorCasadi, sine_error
from benchmarks.peers.work import LeftOutError, Peer, Work, valid_sides, work_of
from benchmarks.plots import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION, logarithmic, save
from benchmarks.port_limit import limit_of
from benchmarks.run import show_progress
from benchmarks.table import Cells, bullets, grid, lines_of, order, page, short, table
from benchmarks.timing import MIDDLE_BATCH, Pace, described, surroundings, take_turns
from pfd_core.kernels.runtime.disk_cache import VARIABLE
from pfd_core.model import Robot

Row = Mapping[str, Any]
ARMS = ('ur5', 'panda', 'puma560', 'dense6')
METHODS = ('composite_body', 'grouped_articulated_body')
# The most numbers of an argument, and of a result: more only measures the memory.
MOST_NUMBERS, MOST_RESULTS = 500_000, 2**24
ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """
import sys
import pfd_core as pfd
robot = pfd.load_robot(sys.argv[1])
zero = [0.0] * robot.n
pfd.forward_dynamics(robot, zero, zero, zero, method='auto')
"""
PEERS: dict[str, Callable[[Robot], Peer]] = {
    'Pinocchio': Pinocchio,
    CPP: PinocchioCpp,
    'MuJoCo': Mujoco,
    'dynibo': Dynibo,
    'frax': Frax,
    **{f'CasADi C {way}': partial(casadi.Casadi, method=way) for way in casadi.METHODS},
    **{f'CasADi C on vectors, {x}': partial(VectorCasadi, compiler=x) for x in COMPILERS},
}
OURS: dict[str, Callable[[Robot], Peer]] = {
    f'{method} {dtype}': partial(ours.make, method, dtype)
    for method in METHODS
    for dtype in ('float64', 'float32')
}


class Plan(NamedTuple):
    """Robots, batches, steps of a rollout, pace; robots of first results and of quantities."""

    robots: Sequence[str]
    sizes: Sequence[int]
    steps: int
    pace: Pace
    firsts: Sequence[str]
    quantities: Sequence[str]


CHAINS = tuple(f'chain{n}' for n in (6, 12, 30, 60, 100))
SIZES = (1, 64, 512, 4096, 65536)
FULL = Plan((*ARMS, *CHAINS), SIZES, 1000, Pace(budget=3.0), ARMS[:2], ARMS[:2])
QUICK = Plan(('ur5',), (1, 64), 10, Pace(chunk=1e-4, turns=3), (), ('planar2',))


def measure(quick: bool) -> dict[str, Any]:
    """Return times, limits, first results and exclusions; progress goes to stderr."""
    plan = QUICK if quick else FULL
    tables: dict[str, Any] = {'machine': surroundings()}
    tables |= {name: [] for name in ('rows', 'limits', 'first', 'sines', 'excluded')}
    excluded: dict[tuple[str, str], list[str]] = {}
    for name in plan.robots:
        arm, reasons = robot(name), dict[str, str]()
        works = list(_works(arm, plan))
        peers = list(_made(arm, name in plan.firsts, works, reasons, tables['first']))
        _measure_works(tables, arm, FORWARD, works, peers, plan.pace, reasons)
        if name in plan.firsts:
            tables['first'] += _fresh_process(arm)
        if name == plan.robots[0]:
            vectors = (peer for peer in peers if isinstance(peer, VectorCasadi))
            tables['sines'] = [{'way': one.name, 'ulp': sine_error(one)} for one in vectors]
        for reason in reasons.items():
            excluded.setdefault(reason, []).append(name)
    for name in plan.quantities:
        arm = robot(name)
        states = random_states(arm, max(plan.sizes[1], min(MIDDLE_BATCH, plan.sizes[-1])))
        for quantity in QUANTITIES:
            reasons = {}
            peers = list(_of_quantity(arm, quantity, reasons))
            works = [work_of(kind, quantity, states) for kind in ('call', 'batch')]
            _measure_works(tables, arm, quantity, works, peers, plan.pace, reasons)
            for way, why in reasons.items():
                excluded.setdefault((f'{way}, {quantity}', why), []).append(name)
    show_progress('')
    tables['excluded'] = [
        f'{way} on {", ".join(on)}: {why}' for (way, why), on in excluded.items()
    ]
    return tables


def _works(arm: Robot, plan: Plan) -> Iterator[Work]:
    states = random_states(arm, max(size for size in plan.sizes if size * arm.n <= MOST_NUMBERS))
    q, qd, tau = (states[name] for name in ('q', 'qd', 'tau'))
    yield Work('call', q[0], qd[0], tau[0])
    yield Work('rollout', q[0], qd[0], tau[0], plan.steps)
    for size in plan.sizes:
        if size <= len(q):
            yield Work('batch', q[:size], qd[:size], tau[:size])


def _made(
    arm: Robot, timed: bool, works: list[Work], reasons: dict[str, str], first: list[Row]
) -> Iterator[Peer]:
    """Yield the peers of a robot; exclusions and times to a first result are added."""
    for name, make in (PEERS | OURS).items():
        show_progress(f'{arm.name}: making {name}')
        try:
            if not timed:
                yield make(arm)
                continue
            if make is PinocchioCpp:
                # For any robot, so that a first result does not contain it.
                compiled_library()
            with _empty_cache():
                peer, cold = _first_result(arm, make, works)
                again = make in OURS.values()
                warm = _first_result(arm, make, works)[1] if again else None
            first.append({'robot': arm.name, 'way': name, 'cold': cold, 'disk': warm})
            yield peer
        except LeftOutError as reason:
            reasons[name] = str(reason)


def _first_result(
    arm: Robot, make: Callable[[Robot], Peer], works: list[Work]
) -> tuple[Peer, float]:
    start = time.perf_counter()
    peer = make(arm)
    next(chain.from_iterable(map(peer.sides, works))).run()
    return peer, time.perf_counter() - start


def _fresh_process(arm: Robot) -> Iterator[Row]:
    """Yield the seconds of a new process from its start to a result."""
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get('PYTHONPATH')])])
    seconds = []
    with _empty_cache():
        for _ in range(2):
            start = time.perf_counter()
            environment = {**os.environ, 'PYTHONPATH': path}
            command = [sys.executable, '-c', PROGRAM, arm.name]
            subprocess.run(command, check=True, env=environment)
            seconds.append(time.perf_counter() - start)
    way = 'fresh process: pfd.forward_dynamics'
    yield {'robot': arm.name, 'way': way, 'cold': seconds[0], 'disk': seconds[1]}


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


def _of_quantity(arm: Robot, quantity: str, reasons: dict[str, str]) -> Iterator[Peer]:
    makers: dict[str, Callable[[], Peer]] = {
        'Pinocchio': partial(PinocchioQuantity, arm, quantity),
        'CasADi C': partial(casadi.Casadi, arm, quantity),
        'pfd float64': partial(ours.make_quantity, quantity, 'float64', 0, arm),
    }
    for name, make in makers.items():
        show_progress(f'{arm.name}: making {quantity} of {name}')
        try:
            yield make()
        except LeftOutError as reason:
            reasons[name] = str(reason)


def _measure_works(
    tables: dict[str, Any],
    arm: Robot,
    quantity: str,
    works: Sequence[Work],
    peers: Sequence[Peer],
    pace: Pace,
    reasons: dict[str, str],
) -> None:
    """Add rows of all works, and the arithmetic limit of our fastest kernel in double precision."""
    rows: list[Row] = []
    for work in works:
        show_progress(f'{arm.name}: {quantity}, {work.title}')
        sides = valid_sides((side for peer in peers for side in peer.sides(work)), reasons)
        rows += [row | {'quantity': quantity} for row in take_turns(arm.name, work, sides, pace)]
    tables['rows'] += rows
    batch = min(works, key=lambda work: abs(work.units - MIDDLE_BATCH))
    best = fastest(row for row in rows if _is_ours(row, batch.title, 'float64, F order'))
    for peer in peers:
        if isinstance(peer, ours.Ours) and best and f'{peer.name}, F order' == best['way']:
            head = {'robot': arm.name, 'quantity': quantity, 'way': peer.name}
            show_progress(f'{arm.name}: {quantity}, arithmetic limit')
            try:
                tables['limits'].append(head | vars(limit_of(peer.kernel, batch, pace)))
            except LeftOutError as reason:
                reasons[f'arithmetic limit of {peer.name}'] = str(reason)


def fastest(rows: Iterable[Row]) -> Row | None:
    """Return the row of the least time; None without rows."""
    return min(rows, key=lambda row: row['minimum'], default=None)


def _is_ours(row: Row, work: str, ending: str) -> bool:
    return row['work'] == work and row['code'] == ours.CODE and row['way'].endswith(ending)


def text(data: dict[str, Any]) -> str:
    """Return the page."""
    rows = [row for row in data['rows'] if row['quantity'] == FORWARD]
    others = [row for row in data['rows'] if row['quantity'] != FORWARD]
    if not any(_is_peer(row) for row in rows):
        return page('speed-alone', machine=described(data['machine']))
    titles = {'robot': 'robot', 'until the first result [ms]': 'way'}
    columns = {key: (lambda row, key=key: _ms(row[key])) for key in ('cold', 'disk')}
    first = table(
        titles | {'compiled': columns['cold'], 'from disk': columns['disk']}, data['first']
    )
    return page(
        'speed',
        machine=described(data['machine']),
        step=LINEAR_STEP * 1e3,
        sines='; '.join(f'{row["way"]} {row["ulp"]:.1f}' for row in data['sines'])
        or 'not measured',
        angle=LARGEST_ANGLE,
        headline=headline(data) or None,
        strongest=_strongest(rows, data['limits']),
        factors=_factors(rows),
        works='\n\n'.join(_by_work(rows)),
        first=first if data['first'] else None,
        quantities=_quantities(others, data['limits']),
        contents=_contents(data['rows']),
        differences=_differences(rows),
        excluded=bullets(data['excluded'], 'Nothing.'),
    )


# Our ways of the comparisons: title, work, and how their names end.
COMPARED = {
    'one call, `kernel(q, qd, tau)`': ('call', 'float64: kernel(q, qd, tau)'),
    'one call, `out=`': ('call', 'float64: kernel(..., out=)'),
    'one call, bound': ('call', 'float64: bound'),
    'rollout': ('rollout', 'float64'),
    'batch of 64': ('batch of 64', 'float64, F order'),
    'batch of 512': ('batch of 512', 'float64, F order'),
    'batch of 4096': ('batch of 4096', 'float64, F order'),
    'batch of 4096, C order': ('batch of 4096', 'float64, C order'),
}
# Rows of README.md, and of the guide, of the arm ROBOT: title, quantity, work, our way.
ROBOT, OTHER_ROBOT, MANY = 'ur5', 'panda', 'batch of 4096'
RESULTS = (
    ('a state in a batch of 4096', FORWARD, MANY, 'float64, F order'),
    ('a state in a batch of 64', FORWARD, 'batch of 64', 'float64, F order'),
    ('one call, arrays bound before', FORWARD, 'call', 'float64: bound'),
)
GUIDE = (
    *RESULTS,
    ('a step of a Runge-Kutta rollout', FORWARD, 'rollout', 'float64'),
    ('derivatives of qdd, a batch of 4096', 'derivatives', MANY, 'float64, F order'),
    ('derivatives of qdd, one bound call', 'derivatives', 'call', 'float64: bound'),
)


def _is_peer(row: Row) -> bool:
    """Return whether a row is of a peer at the same work: on one thread, without refinement."""
    return row['code'] != ours.CODE and not row['way'].endswith((' 2 threads', ' refined'))


def _named(row: Row) -> str:
    return str(row['way']).replace(', F order', '').replace(', C order', '')


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
    key = (arm, quantity, work)
    own = [row for row in rows if (row['robot'], row['quantity'], row['work']) == key]
    best = fastest(row for row in own if _is_ours(row, work, ending))
    peers = [row for row in own if _is_peer(row)]
    if ending.endswith('C order'):
        peers = [row for row in peers if not row['way'].endswith('F order')]
    strongest = fastest(peers)
    general = fastest(row for row in peers if 'any robot' in row['code'])
    return (
        None
        if best is None or strongest is None or general is None
        else (best, strongest, general)
    )


def _ns(row: Row) -> str:
    return f'{short(row["minimum"] * 1e9)} ns'


def _ms(seconds: float | None) -> str:
    return '-' if seconds is None else short(seconds * 1e3)


def _relation(own: Row, peer: Row) -> str:
    ratio = speed_up(own, peer)
    compare = (
        f'{ratio:.1f} times as fast as' if ratio >= 1 else f'{1 / ratio:.1f} times slower than'
    )
    return f'{compare} {_named(peer)} ({_ns(peer)})'


def headline(data: dict[str, Any]) -> str:
    """Return the sentences of README.md and the page; '' where a row is missing."""
    found = {title: compared(data['rows'], ROBOT, *place) for title, *place in RESULTS}
    plain = fastest(
        row
        for row in data['rows']
        if row['robot'] == ROBOT and _is_ours(row, 'call', 'kernel(q, qd, tau)')
    )
    if None in found.values() or plain is None:
        return ''
    many, few, one = (row for row in found.values() if row is not None)
    machine = data['machine']
    return page(
        'speed-headline',
        processor=f'{"virtual " * bool(machine.get("virtual"))}{machine["processor"]}',
        many=_ns(many[0]),
        many_peer=_relation(*many[:2]),
        many_general=_relation(many[0], many[2]),
        few=_ns(few[0]),
        few_peer=_relation(*few[:2]),
        one=_ns(one[0]),
        one_peer=_relation(*one[:2]),
        plain=_ns(plain),
    )


def results_rows(data: dict[str, Any]) -> list[dict[str, str]]:
    """Return the rows of README.md: what, ours, peer, theirs and our speed-up, as text."""
    rows = []
    for title, *place in RESULTS:
        found = compared(data['rows'], ROBOT, *place)
        if found is not None:
            own, peer, _ = found
            rows.append(
                {
                    'what': f'forward dynamics of a UR5, {title}',
                    'ours': _ns(own),
                    'peer': _named(peer),
                    'theirs': _ns(peer),
                    'speed-up': short(speed_up(own, peer)),
                }
            )
    return rows


def guide_table(data: dict[str, Any]) -> str:
    """Return the table of the guide: works of one arm, with the speed-up over the peers."""
    lines = []
    for title, *place in GUIDE:
        found = compared(data['rows'], ROBOT, *place)
        if found is not None:
            own, *peers = found
            cells = (f'{short(speed_up(own, peer))} ({_named(peer)})' for peer in peers)
            lines.append([title, _ns(own), *cells])
    titles = [
        'UR5',
        'our time',
        'times as fast as the fastest peer',
        'as the fastest for any robot',
    ]
    return '\n'.join(lines_of(titles, lines)) + '\n'


def guide_notes(data: dict[str, Any]) -> str:
    """Return the paragraph of the guide on derivatives of another arm and the arithmetic limit."""
    parts = {}
    for key, (_, *place) in zip(('batch', 'call'), GUIDE[-2:], strict=True):
        own, peer, general = compared(data['rows'], OTHER_ROBOT, *place) or ({},) * 3
        parts |= {key: _relation(own, peer), f'{key}_general': _relation(own, general)}
    shares = {row['robot']: row['times'] for row in data['limits'] if row['quantity'] == FORWARD}
    least, most = min(shares.values()), max(shares.values())
    return page('speed-notes', **parts, least=f'{least:.0%}', most=f'{most:.0%}')


def _strongest(rows: Sequence[Row], limits: Sequence[Row]) -> list[str]:
    """Return a table of our fastest ways over the fastest peer, robot by robot."""
    shares = {row['robot']: row['times'] for row in limits if row['quantity'] == FORWARD}
    cells: Cells = {}
    for arm in dict.fromkeys(row['robot'] for row in rows):
        for title, place in COMPARED.items():
            found = compared(rows, arm, FORWARD, *place)
            if found is not None:
                own, peer, _ = found
                cells[arm, title] = f'{short(speed_up(own, peer))} ({_named(peer)})'
        share = shares.get(arm)
        cells[arm, 'share of the arithmetic limit'] = '-' if share is None else f'{share:.2f}'
    return grid(cells, 'robot')


# Steps from Pinocchio to ours: title, and the beginnings and an end of the ways of which the
# fastest counts.
STEPS = (
    ('Pinocchio from Python [ns]', ('Python loop',), ''),
    ('without calls from Python', (CPP,), ''),
    ('code for one robot', ('CasADi C composite', 'CasADi C articulated'), 'loop in C'),
    ('vectors of states', ('CasADi C on vectors',), ''),
    ('our kernel', METHODS, 'float64, F order'),
)


def _factors(rows: Sequence[Row]) -> list[str] | None:
    """Return a table of the factor over Pinocchio in steps; None without the ways."""
    lines = []
    for arm in dict.fromkeys(row['robot'] for row in rows):
        own = [row for row in rows if row['robot'] == arm and row['work'] == MANY]
        found = [
            fastest(
                row for row in own if row['way'].startswith(begin) and row['way'].endswith(end)
            )
            for _, begin, end in STEPS
        ]
        ways = [row for row in found if row is not None]
        if len(ways) == len(STEPS):
            pairs = [*zip(ways[1:], ways, strict=False), (ways[-1], ways[0])]
            factors = (short(speed_up(fast, slow)) for fast, slow in pairs)
            lines.append([arm, short(ways[0]['minimum'] * 1e9), *factors])
    return lines_of(['robot', *(title for title, *_ in STEPS), 'all'], lines) if lines else None


def _cell(row: Row) -> str:
    ratio = '' if row['times'] is None else f' ({short(row["times"])})'
    return f'{short(row["minimum"] * 1e9)} / {short(row["median"] * 1e9)}{ratio}'


def _by_work(rows: Sequence[Row]) -> Iterator[str]:
    """Yield a table of all ways over the robots, work by work."""
    for work in dict.fromkeys(row['work'] for row in rows):
        cells = {(row['way'], row['robot']): _cell(row) for row in rows if row['work'] == work}
        yield '\n'.join([f'## {work.capitalize()} [ns]\n', *grid(cells)])


def _quantities(rows: Sequence[Row], limits: Sequence[Row]) -> str:
    """Return, robot by robot, our times of each quantity, and the speed-up over the peers."""
    parts: list[str] = []
    shares = {(row['robot'], row['quantity']): row['times'] for row in limits}
    batch = max((row['work'] for row in rows if row['work'] != 'call'), key=len, default='')
    for arm in dict.fromkeys(row['robot'] for row in rows):
        cells: Cells = {}
        for quantity in QUANTITIES:
            for title, place in ('call', 'pfd float64: bound'), (batch, 'pfd float64, F order'):
                key = (arm, quantity, title)
                own = {
                    row['way']: row
                    for row in rows
                    if (row['robot'], row['quantity'], row['work']) == key
                }
                if place in own:
                    best = own[place]
                    cells[quantity, f'{title} [ns]'] = short(best['minimum'] * 1e9)
                    for name in ('inocchio', 'CasADi'):
                        peer = fastest(row for row in own.values() if name in row['way'])
                        ratio = '-' if peer is None else short(speed_up(best, peer))
                        label = 'Pinocchio' if name == 'inocchio' else name
                        cells[quantity, f'{title}, times as fast as {label}'] = ratio
            share = shares.get((arm, quantity))
            cells[quantity, 'share of the limit'] = '-' if share is None else f'{share:.2f}'
        parts += [f'### {arm}\n', *grid(cells, 'quantity'), '']
    return '\n'.join(parts)


def _contents(rows: Sequence[Row]) -> list[str]:
    known: dict[tuple[str, ...], dict[str, None]] = {}
    for row in rows:
        kind = row['work'].split()[0]
        place = (kind, row['code'], row['call'], row['loop'] or '-', row['numbers'])
        known.setdefault(place, {})[_named(row)] = None
    titles = ['work', 'code of one state', 'call', 'loop', 'numbers, sine and cosine', 'ways']
    return lines_of(titles, ([*place, '; '.join(ways)] for place, ways in known.items()))


def _differences(rows: Sequence[Row]) -> list[str]:
    """Return the largest difference of each program and robot, rollouts apart."""
    found: dict[tuple[str, object], float] = {}
    for row in rows:
        if row['difference'] is not None:
            name = row['way'].split(':')[0].split(',')[0]
            work = 'rollout' if row['work'] == 'rollout' else 'accelerations'
            place = f'{work}: {name}', row['robot']
            found[place] = max(found.get(place, 0.0), row['difference'])
    return grid({place: order(value) for place, value in found.items()})


# Lines of the picture: label, beginnings of the ways, an end, colour and marker.
LINES = (
    ('this library, float64', METHODS, ('float64, F order', 'float64: bound'), BLUE, 'o'),
    ('this library, float32', METHODS, ('float32, F order', 'float32: bound'), VERMILLION, '^'),
    ("CasADi's C on vectors of 8 states", ('CasADi C on vectors',), ('F order',), GREEN, 'D'),
    ("CasADi's C", ('CasADi C comp', 'CasADi C art'), ('C', 'buffer()'), PURPLE, '*'),
    ('Pinocchio, C++ for this processor', (CPP,), ('',), ORANGE, 's'),
    ('Pinocchio from Python', ('pinocchio',), ('',), 'black', 's'),
    ('MuJoCo', ('mujoco',), ('',), GREY, 'v'),
    ('frax', ('frax',), ('',), SKY, 'P'),
)


def plots(data: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the least time of a state over n, and over the size of a batch."""
    rows = [row for row in data['rows'] if row['quantity'] == FORWARD]
    return save(partial(_draw, rows), folder, 'speed', (15, 5.8), ['png'])


def _draw(rows: Sequence[Row], figure: Any) -> None:
    batches = [row for row in rows if row['work'].startswith('batch')]
    chains = [row for row in rows if row['robot'].startswith('chain')]
    panels = (
        ('chains of n joints, one call', 'joints n', [x for x in chains if x['work'] == 'call']),
        (f'chains of n joints, {MANY}', 'joints n', [x for x in chains if x['work'] == MANY]),
        ('UR5, batches', 'states of a batch', [x for x in batches if x['robot'] == ROBOT]),
    )
    for axes, (title, label, own) in zip(figure.subplots(1, 3), panels, strict=True):
        axes.set(title=title, xlabel=label, ylabel='least time of a state [ns]')
        logarithmic(axes)
        ticks = set()
        for name, begin, ends, colour, marker in LINES:
            least: dict[int, float] = {}
            for row in own:
                if row['way'].startswith(begin) and row['way'].endswith(ends):
                    x = row['n'] if label == 'joints n' else int(row['work'].split()[-1])
                    least[x] = min(least.get(x, 1.0), row['minimum'])
            ticks |= set(least)
            places = sorted(least.items())
            values = [1e9 * seconds for _, seconds in places]
            axes.plot([x for x, _ in places], values, color=colour, marker=marker, label=name)
        axes.set_xticks(sorted(ticks), [str(tick) for tick in sorted(ticks)])
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=4, frameon=False)
