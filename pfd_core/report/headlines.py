# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Sentences of the pages of speed and of README.md: our fastest way compared with the strongest peer.

The strongest peer takes the least time for the same work. It is named among all peers, and among
the peers that take any robot without compilation for it. `publish` writes the sentences into the
blocks of README.md and of the guide, which begin and end with `<!-- speed: NAME -->` and
`<!-- /speed -->`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
import re
from typing import Any

from pfd_core.report.cases.quantities import FORWARD
from pfd_core.report.contenders.ours import METHODS
from pfd_core.report.contenders.pinocchio_cpp import NAME as CPP
from pfd_core.report.measure import decomposition
from pfd_core.report.measure.timing import Row
from pfd_core.report.render.markdown import Cells, grid, lines_of, page, paragraph
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
# Rows of the table of the guide: title, quantity, work, and how the names of our ways end.
GUIDE = (
    ('batch of 4096 states, Fortran order', FORWARD, MANY, 'float64, F order'),
    ('one call from Python through `kernel.bind`', FORWARD, 'call', 'float64: bound'),
    ('a step of a Runge-Kutta rollout', FORWARD, 'rollout', 'float64'),
    ('derivatives of qdd by q, qd, tau, the same batch', 'derivatives', MANY, 'float64, F order'),
    ('the same, one bound call', 'derivatives', 'call', 'float64: bound'),
)
BLOCK = re.compile(r'(<!-- speed: (\w+) -->\n).*?(<!-- /speed -->)', re.DOTALL)
FILES = ('README.md', 'docs/guides/speed-and-accuracy.md')


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
    Return our fastest row, the strongest peer and the strongest that takes any robot.

    The names of our ways end with `ending`. None where a row is missing.
    """
    own = [row for row in rows if (row.robot, row.quantity, row.work) == (robot, quantity, work)]
    ours = fastest(row for row in own if row.way.startswith(OURS) and row.way.endswith(ending))
    strongest, general = fastest(peers(own)), fastest(peers(own, any_robot=True))
    if ours is None or strongest is None or general is None:
        return None
    return ours, strongest, general


def part(own: Row, peer: Row) -> str:
    """Return our part of a peer's time, as 1/14."""
    ratio = factor(own, peer)
    return f'1/{ratio:.0f}' if ratio >= 9.95 else f'1/{ratio:.1f}'


def headline(rows: Sequence[Row], machine: Mapping[str, Any]) -> str:
    """Return the sentences of README.md; '' where the rows lack its arm, batch or peers."""
    found = [compared(rows, ROBOT, *place) for _, *place in GUIDE[:2]]
    parts = [_parts(*rows_of) for rows_of in found if rows_of is not None]
    if len(parts) < len(found):
        return ''
    text = page(
        'speed-headline',
        processor=f'{"virtual " * bool(machine.get("virtual"))}{machine["processor"]}',
        batch=parts[0],
        call=parts[1],
    )
    return ' '.join(text.split())


def _parts(own: Row, strongest: Row, general: Row) -> str:
    text = f'{part(own, strongest)} of the time of the strongest peer, {_phrase(strongest)}'
    if general is strongest:
        return text
    return (
        f'{text}, and {part(own, general)} of the time of the strongest that takes any robot, '
        f'{_phrase(general)}'
    )


def _phrase(row: Row) -> str:
    return PHRASES.get(row.way, row.way)


def guide_table(rows: Sequence[Row]) -> list[str]:
    """Return the table of the guide: works of one arm, and our parts of the peers' times."""
    lines = []
    for title, *place in GUIDE:
        found = compared(rows, ROBOT, *place)
        if found is not None:
            own, *others = found
            cells = [f'{part(own, row)} ({row.way})' for row in others]
            lines.append([title, f'{short(own.minimum * 1e9)} ns', *cells])
    titles = ['UR5', 'our time', 'part of the strongest peer', 'of the strongest for any robot']
    return lines_of(titles, lines)


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
    """Return a table of our fastest ways over the strongest peer, robot by robot."""
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
        'vectors of states',
        'all',
        "CasADi's C alone",
        'our calls from Python',
    ]
    size = batch_name(rows)
    return page('decomposition', batch=size, table=lines_of(titles, lines))


def _steps(own: Mapping[str, Row]) -> Iterator[str]:
    """Yield the time of Pinocchio called from Python, and the factor of each step from there."""
    chain = (decomposition.PYTHON, decomposition.CPP, decomposition.SCALAR, decomposition.VECTOR)
    pairs = [
        *zip(chain[1:], chain[:-1], strict=True),
        (chain[-1], chain[0]),
        (decomposition.CASADI, decomposition.CPP),
        (decomposition.SCALAR, decomposition.FROM_PYTHON),
    ]
    yield short(own[decomposition.PYTHON].minimum * 1e9)
    for faster, slower in pairs:
        known = faster in own and slower in own
        yield short(factor(own[faster], own[slower])) if known else '-'


def publish(rows: Sequence[Row], machine: Mapping[str, Any], root: Path) -> list[Path]:
    """Write the sentences of rows into the blocks of README.md and the guide; return the paths."""
    found = [root / name for name in FILES]
    for path in found:
        text = path.read_text(encoding='utf-8')
        path.write_text(filled(text, blocks(rows, machine)), encoding='utf-8')
    return found


def blocks(rows: Sequence[Row], machine: Mapping[str, Any]) -> dict[str, str]:
    """Return the content of each block by name."""
    sentence = paragraph(headline(rows, machine)) + '\n'
    return {'headline': sentence, 'guide': '\n'.join(guide_table(rows)) + '\n'}


def filled(text: str, content: Mapping[str, str]) -> str:
    """Return a page with its blocks filled."""
    return BLOCK.sub(lambda match: f'{match[1]}{content[match[2]]}{match[3]}', text)
