# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Sentences of the pages of speed and of README.md: our fastest way compared with the fastest peer.

The fastest peer takes the least time for the same work. It is named among all peers, and among
the peers that take any robot without compilation for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from pfd_core.report.cases.quantities import FORWARD
from pfd_core.report.contenders.ours import METHODS
from pfd_core.report.contenders.pinocchio_cpp import NAME as CPP
from pfd_core.report.measure import decomposition, port_limit
from pfd_core.report.measure.speed import Findings
from pfd_core.report.measure.timing import Row
from pfd_core.report.render.markdown import Cells, grid, lines_of, page
from pfd_core.report.render.numbers import short
from pfd_core.report.time_tables import batch_name, factor, fastest

# Beginnings of the ways of this library, and of peers whose code is compiled for one robot.
OURS = (*METHODS, 'pfd')
ONE_ROBOT = ('CasADi',)
# Peers' ways in a sentence.
PHRASES = {
    'CasADi C, loop in C': 'C that CasADi generates for this arm (loop in C, `-O3 -march=native`)',
    'CasADi C, RK4 in C': 'C that CasADi generates for this arm (loop in C, `-O3 -march=native`)',
    'CasADi C, buffer()': "`buffer()` of CasADi's C",
    'pinocchio.aba': '`pinocchio.aba`',
    'pinocchio.aba WORLD': '`pinocchio.aba` in world axes',
    'pinocchio.abaInParallel, 1 thread': "Pinocchio's `abaInParallel`",
    'Python loop over pinocchio.aba': 'a Python loop over `pinocchio.aba`',
    f'{CPP} aba': "Pinocchio's `aba` in C++ compiled for this processor",
    f'{CPP} aba, WORLD': "Pinocchio's `aba` (world axes) in C++ compiled for this processor",
    f'{CPP} crba + Cholesky': "Pinocchio's `crba` and Cholesky in C++ compiled for this processor",
    'mujoco mj_forward, state in place': "MuJoCo's `mj_forward`",
    'mujoco mj_step, RK4': "MuJoCo's `mj_step`",
    'mujoco.rollout': '`mujoco.rollout`',
}
# The arm and the batch of the sentences.
ROBOT, MANY = 'ur5', 'batch of 4096'
# Further batches of the sentences, and the ways of a call.
OTHER_BATCHES = (
    ('in C order', MANY, 'C'),
    ('in batches of 64 states', 'batch of 64', 'F'),
    ('in a batch of one state', 'batch of 1', 'F'),
)
CALLS = {'plain': ': kernel(q, qd, tau)', 'out': ': kernel(..., out=)', 'bound': ': bound'}
# The arm whose derivatives the notes of the guide compare.
OTHER_ROBOT = 'panda'
# Rows of the table of the guide: title, quantity, work, and how the names of our ways end.
GUIDE = (
    ('batch of 4096 states, Fortran order', FORWARD, MANY, 'float64, F order'),
    ('one call from Python through `kernel.bind`', FORWARD, 'call', 'float64: bound'),
    ('a step of a Runge-Kutta rollout', FORWARD, 'rollout', 'float64'),
    ('derivatives of qdd by q, qd, tau, the same batch', 'derivatives', MANY, 'float64, F order'),
    ('the same, one bound call', 'derivatives', 'call', 'float64: bound'),
)


def peers(rows: Iterable[Row], any_robot: bool = False) -> Iterator[Row]:
    """Yield the rows of peers on one thread; with `any_robot` not those compiled for one robot."""
    for row in rows:
        ours, shared = row.way.startswith(OURS), row.way.endswith(' threads')
        refined = row.way.endswith(' refined')
        for_one = any_robot and row.way.startswith(ONE_ROBOT)
        if not (ours or shared or refined or for_one):
            yield row


def compared(
    rows: Iterable[Row], robot: str, quantity: str, work: str, ending: str
) -> tuple[Row, Row, Row] | None:
    """
    Return our fastest row, the fastest peer and the fastest that takes any robot.

    The names of our ways end with `ending`. None where a row is missing.
    """
    own = [row for row in rows if (row.robot, row.quantity, row.work) == (robot, quantity, work)]
    ours = _ours(own, ending)
    strongest, general = fastest(peers(own)), fastest(peers(own, any_robot=True))
    if ours is None or strongest is None or general is None:
        return None
    return ours, strongest, general


def _ours(rows: Iterable[Row], ending: str) -> Row | None:
    return fastest(row for row in rows if row.way.startswith(OURS) and row.way.endswith(ending))


def part(own: Row, peer: Row) -> str:
    """Return our part of a peer's time, as 1/14."""
    ratio = factor(own, peer)
    return f'1/{ratio:.0f}' if ratio >= 9.95 else f'1/{ratio:.1f}'


def headline(findings: Findings) -> str:
    """Return the sentences of README.md; '' where the rows lack its arm, batch or peers."""
    rows, machine = [*findings.rows, *findings.others], findings.machine
    found = [compared(rows, ROBOT, *place) for _, *place in GUIDE[:2]]
    parts = [_parts(*rows_of) for rows_of in found if rows_of is not None]
    calls = {
        name: compared(rows, ROBOT, FORWARD, 'call', f'float64{ending}')
        for name, ending in CALLS.items()
    }
    if len(parts) < len(found) or None in calls.values():
        return ''
    return page(
        'speed-headline',
        processor=f'{"virtual " * bool(machine.get("virtual"))}{machine["processor"]}',
        batch=parts[0],
        others=_other_batches(rows),
        call=parts[1],
        **{name: f'{one[0].minimum * 1e9:.0f}' for name, one in calls.items() if one is not None},
    )


def _other_batches(rows: Sequence[Row]) -> str:
    """Return a sentence on C order and smaller batches, with a space; '' without them."""
    texts = []
    for title, work, order in OTHER_BATCHES:
        found = compared(rows, ROBOT, FORWARD, work, f'float64, {order} order')
        if found is not None:
            own, peer, _ = found
            ratio = factor(own, peer)
            longer = f"{1 / ratio:.1f} times the peer's"
            texts.append(f'{part(own, peer) if ratio >= 1 else longer} {title}')
    return f'Relative to the fastest peer the time is {", ".join(texts)}. ' if texts else ''


def _parts(own: Row, strongest: Row, general: Row) -> str:
    text = f'{part(own, strongest)} of the time of the fastest peer, {_phrase(strongest)}'
    if general is strongest:
        return text
    return (
        f'{text}, and {part(own, general)} of the time of the fastest that takes any robot, '
        f'{_phrase(general)}'
    )


def _phrase(row: Row) -> str:
    return PHRASES.get(row.way, row.way)


def guide_table(findings: Findings) -> str:
    """Return the table of the guide: works of one arm, and our parts of the peers' times."""
    rows = [*findings.rows, *findings.others]
    lines = []
    for title, *place in GUIDE:
        found = compared(rows, ROBOT, *place)
        if found is not None:
            own, *others = found
            cells = [f'{part(own, row)} ({row.way})' for row in others]
            lines.append([title, f'{short(own.minimum * 1e9)} ns', *cells])
    titles = ['UR5', 'our time', 'part of the fastest peer', 'of the fastest for any robot']
    return '\n'.join(lines_of(titles, lines)) + '\n'


def _part_of(rows: Iterable[Row], robot: str, place: Sequence[str], peer: str) -> str:
    """Return our part of the time of the fastest way of a peer; '-' without rows."""
    quantity, work, ending = place
    own = [row for row in rows if (row.robot, row.quantity, row.work) == (robot, quantity, work)]
    ours = _ours(own, ending)
    theirs = fastest(row for row in peers(own) if peer in row.way)
    return '-' if ours is None or theirs is None else part(ours, theirs)


def limit_row(rows: Sequence[Row], robot: str) -> Row | None:
    """Return the row of the port limit of a robot's fastest batch in float64; None without."""
    own, suffix = [row for row in rows if row.robot == robot], ', F order'
    size = batch_name(rows)
    best = fastest(row for row in own if row.work == size and row.way.endswith(f'float64{suffix}'))
    name = None if best is None else best.way.removesuffix(suffix)
    return next((row for row in own if row.work == port_limit.WORK and row.way == name), None)


def guide_notes(findings: Findings) -> str:
    """Return the paragraph of the guide on derivatives of another arm and the port limit."""
    parts = {
        f'{name}_{peer.lower()}': _part_of(findings.others, OTHER_ROBOT, place, peer)
        for name, (_, *place) in zip(('batch', 'call'), GUIDE[3:], strict=True)
        for peer in ('CasADi', 'pinocchio')
    }
    shares = {
        robot: row.times
        for robot in dict.fromkeys(row.robot for row in findings.rows)
        if (row := limit_row(findings.rows, robot)) is not None and row.times is not None
    }
    others = [share for robot, share in shares.items() if robot != ROBOT]
    return page(
        'speed-notes',
        **parts,
        share=f'{shares[ROBOT]:.0%}',
        least=f'{min(others):.0%}',
        most=f'{max(others):.0%}',
    )


def columns(rows: Sequence[Row]) -> dict[str, tuple[str, str]]:
    """Return title, work, and how the names of our ways end, of tables over robots."""
    size = batch_name(rows)
    return {
        'one bound call': ('call', 'float64: bound'),
        'rollout': ('rollout', 'float64'),
        f'{size}, F order': (size, 'float64, F order'),
        f'{size}, C order': (size, 'float64, C order'),
        f'{size}, F order, float32': (size, 'float32, F order'),
    }


def against_strongest(rows: Sequence[Row]) -> list[str]:
    """Return a table of our fastest ways over the fastest peer, robot by robot."""
    cells: Cells = {}
    for robot in dict.fromkeys(row.robot for row in rows):
        for title, (work, ending) in columns(rows).items():
            found = compared(rows, robot, FORWARD, work, ending)
            cells[robot, title] = '-'
            if found is not None:
                own, peer, _ = found
                cells[robot, title] = f'{short(factor(own, peer))} ({peer.way.split(",")[0]})'
    return grid(cells, 'robot')


def decomposed(rows: Sequence[Row]) -> str | None:
    """Return the section on where the factor over Pinocchio comes from; None without rows."""
    lines = []
    for robot in dict.fromkeys(row.robot for row in rows):
        own = {
            row.way: row for row in rows if (row.robot, row.work) == (robot, decomposition.WORK)
        }
        if own:
            lines.append([robot, *_steps(own)])
    if not lines:
        return None
    titles = [
        'robot',
        'Pinocchio from Python [ns]',
        'without calls from Python',
        'code for one robot',
        "CasADi's C",
        'vectors of states',
        'all',
        'our calls from Python',
    ]
    size = batch_name(rows)
    return page('decomposition', batch=size, table=lines_of(titles, lines))


def _steps(own: Mapping[str, Row]) -> Iterator[str]:
    """Yield the time of Pinocchio called from Python, and the factor of each step from there."""
    chain = (decomposition.PYTHON, decomposition.CPP, decomposition.SCALAR, decomposition.VECTOR)
    without_calls, one_robot, vectors = zip(chain[1:], chain[:-1], strict=True)
    pairs = [
        without_calls,
        one_robot,
        (decomposition.CASADI, decomposition.CPP),
        vectors,
        (chain[-1], chain[0]),
        (decomposition.SCALAR, decomposition.FROM_PYTHON),
    ]
    yield short(own[decomposition.PYTHON].minimum * 1e9)
    for faster, slower in pairs:
        known = faster in own and slower in own
        yield short(factor(own[faster], own[slower])) if known else '-'
