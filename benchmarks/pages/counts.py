# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Steps of every system compared with the paper, speed-up over n, and iterations of PCGM.

texts/counts.md defines steps, editions, speed-up and efficiency. Divisions are counted apart, too.
Of PCGM every iterate is observed while the emulator runs the counted program, for the residual
does not measure its error, max|x - qdd| / max|qdd| with qdd by PCRBM. Sine and cosine are expanded
into the other operations, so that iterations and errors are the same on every machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import paper
from benchmarks.cases.paper import CORRECTED, EDITIONS, KINDS, PRINTED_AT, value
from benchmarks.cases.problems import seeded_states
from benchmarks.cases.robots import Array, uniform_chain
from benchmarks.plots import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION, panels
from benchmarks.run import each
from benchmarks.table import Columns, Row, grid, order, page, shown, stored_table, table
from benchmarks.timing import differences
from pfd_core.dynamics.methods import FORWARD, METHODS
from pfd_core.kernels.sines import expand_sines
from pfd_core.machine.emulator import run
from pfd_core.model import Robot, resolve
from pfd_core.paper.conjugate import record_pcgm

SIZES = (2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 24, 32, 48, 64)
COUNTED = (*METHODS, 'constraint_forces')
# Iterations of PCGM to an error: joints, states of each, and errors.
PCGM_SIZES, STATES = (2, 3, 4, 5, 6, 8, 12, 16, 24, 32, 48, 64), 100
TOLERANCES = (1e-3, 1e-6, 1e-9)


def measure(quick: bool) -> dict[str, Any]:
    """Count every system, and iterations; quick is six joints only."""
    sizes = (PRINTED_AT,) if quick else SIZES
    systems = [(x, n, edition) for n in sizes for x in COUNTED for edition in paper.editions_of(x)]
    counts = each(_row, systems, 'counting steps', lambda key: key[1])
    studied = [n for n in PCGM_SIZES if n in sizes]
    reached = each(reached_by, studied, 'iterations of PCGM', int)
    return {
        'counts': counts,
        'serial': [best_serial(counts, n) for n in sizes],
        'parts': list(counted_parts(PRINTED_AT)),
        'reached': [row for rows in reached for row in rows],
    }


def _row(key: tuple[Any, ...]) -> dict[str, Any]:
    return paper.row(*key)


def best_serial(counts: Iterable[Row], n: int) -> dict[str, Any]:
    """Return the direct method with least arithmetic on one processor, and that of Table 1."""
    # Without the edition as printed, which does not give qdd.
    right = (x for x in counts if x['system'] in METHODS and x['edition'] != EDITIONS[0])
    direct = (x for x in right if x['n'] == n and x['iterations'] is None)
    best = min(direct, key=lambda x: x['own'])
    published = paper.published_serial(n)
    return {'n': n, 'title': best['title'], 'best': best['own'], 'published': published}


def counted_parts(n: int) -> Iterator[dict[str, Any]]:
    """Yield the parts of sections 2.5 and 3, each counted by its sections of the recordings."""
    for system, parts in stored_table('paper_parts').items():
        recorded = {
            prefix: paper.program_of(paper.Recording(system, n, edition))
            for prefix, edition in (('as_printed_', EDITIONS[0]), ('corrected_', CORRECTED))
        }
        for part in parts:
            row = {'system': system, 'title': paper.title_of(system), 'remark': '', **part}
            row |= {f'claimed_{kind}': int(value(part[kind], n)) for kind in KINDS[:2]}
            for prefix, program in recorded.items():
                row |= paper.flat(prefix, paper.in_sections(program, part['sections']))
            yield row


def errors_of_iterates(robot: Robot, states: Mapping[str, Array]) -> Array:
    """
    Return the errors of x_0 = 0, x_1, ... of PCGM in each state, (iterations + 1, S).

    `states` holds q, qd and tau, (S, n); after its last iteration a state keeps its error.
    """
    plant, errors = resolve(robot), list[Array]()
    # One lane per link, as in the paper.
    direct, iterative = FORWARD['pcrbm'](plant, 'parallel'), record_pcgm(plant, 'unpacked')
    wanted = run(expand_sines(direct, 'float64'), states)['qdd']

    def observe(rows: list[Any]) -> None:
        # Rows are (lanes, states), x first.
        errors.append(differences(np.broadcast_to(rows[0], wanted.T.shape).T, wanted))

    run(expand_sines(iterative, 'float64'), states, observe=observe)
    return np.array(errors)


def reached_by(n: int) -> list[dict[str, Any]]:
    """
    Return the iterations of PCGM until the error is within each tolerance, and errors after n.

    A median of an even number of states is the lower of the two in the middle. ArithmeticError if
    a state does not reach a tolerance.
    """
    errors = errors_of_iterates(uniform_chain(n), seeded_states(n, STATES))
    after_n, rows = np.sort(errors[min(n, len(errors) - 1)]), []
    for tolerance in TOLERANCES:
        inside = errors <= tolerance
        if not inside.any(axis=0).all():
            raise ArithmeticError(f'PCGM does not reach {tolerance} in a state of {n} joints')
        first = np.sort(inside.argmax(axis=0))
        row = {'n': n, 'median': first[(STATES - 1) // 2], 'worst': first[-1]}
        row |= {'tolerance': tolerance, 'within_n': np.mean(inside[: n + 1].any(axis=0))}
        row |= {'error_after_n': after_n[(STATES - 1) // 2], 'worst_after_n': after_n[-1]}
        rows.append(row)
    return rows


# ---- numbers of rows ----


def arithmetic_of(x: Row, prefix: str = '') -> int:
    """Return the steps of arithmetic in a row."""
    return int(sum(x[prefix + kind] for kind in KINDS))


def speed_up(x: Row, over: str, routed: bool = False) -> float:
    """Return x[over] divided by the steps, routed: with routes, of the faster packing."""
    with_routes = (arithmetic_of(x, k) + x[f'{k}routes'] for k in ('', 'unpacked_'))
    return float(x[over] / (min(with_routes) if routed else arithmetic_of(x)))


def efficiency(x: Row, over: str, routed: bool = False) -> float:
    """Return the speed-up divided by the number of processors, cells of the array included."""
    return speed_up(x, over, routed) / float(x['units'])


def with_baselines(rows: Iterable[Row], serial: Iterable[Row]) -> list[dict[str, Any]]:
    """Return rows with `best` and `published`, the arithmetic of one processor; not of PCGM."""
    known = {x['n']: x for x in serial}
    # Iterations depend on the state.
    return [
        {**x, **{k: None if x['iterations'] else known[x['n']][k] for k in ('best', 'published')}}
        for x in rows
    ]


def _printed() -> int:
    """Return the total of multiplications and additions that Table 1 prints for PCRBM."""
    return int(sum(paper.TABLE['pcrbm'][kind]['printed'] for kind in KINDS[:2]))


def summary(counts: Mapping[str, Any], claims: Mapping[str, Any]) -> str:
    """Return the speed-ups of PCRBM and the verdicts in two sentences, from both pages' data."""
    found = (x for x in counts['counts'] if (x['system'], x['n']) == ('pcrbm', PRINTED_AT))
    executed, _, own = with_baselines(found, counts['serial'])
    return page(
        'paper-summary',
        printed=f'{executed["published"] / _printed():.2f}',
        executed=f'{speed_up(executed, "published"):.2f}',
        own=f'{speed_up(own, "best"):.2f}',
        own_routed=f'{speed_up(own, "best", True):.2f}',
        sentences=len(claims['claims']),
        counted=paper.counted_verdicts(x['verdict'] for x in claims['claims']),
    )


# ---- the page ----

Cell = Callable[[Row], object]


def text(data: dict[str, Any]) -> str:
    """Return the page."""
    rows = with_baselines(data['counts'], data['serial'])
    at = [x for x in rows if x['n'] == PRINTED_AT]
    serial = next(x for x in data['serial'] if x['n'] == PRINTED_AT)
    printed, published = _printed(), int(serial['published'])
    return page(
        'counts',
        n=PRINTED_AT,
        best=serial['title'],
        arithmetic=serial['best'],
        published=published,
        printed=printed,
        printed_speed_up=f'{published / printed:.2f}',
        systems=table(SYSTEMS, (x for x in at if x['system'] in paper.TABLE)),
        claims=table(CLAIMS, _claims(at)),
        parts=table(PARTS, data['parts']),
        states=STATES,
        reached=grid(
            {(x['n'], 'after n'): AFTER_N.format(**x) for x in data['reached']}
            | {(x['n'], order(x['tolerance'])): REACHED.format(**x) for x in data['reached']},
            'n',
        ),
    )


def _two(ratio: Callable[..., float], over: str, form: str) -> Cell:
    """Return a column: a ratio by arithmetic alone / with routes."""
    both = f'{{:{form}}} / {{:{form}}}'
    return lambda x: '-' if x[over] is None else both.format(ratio(x, over), ratio(x, over, True))


SYSTEMS: Columns = {
    'system': lambda x: x['title'] + ', n iterations' * bool(x['iterations']),
    **shown('processors units multiplications divisions additions square_roots routes'),
    **shown('unpacked_multiplications unpacked_additions unpacked_routes'),
    'busy': lambda x: f'{x["work"] / arithmetic_of(x) / x["units"]:.0%}',
    'speed-up, alone / with routes': _two(speed_up, 'best', '.2f'),
    'over published counts': _two(speed_up, 'published', '.2f'),
    'over one processor': _two(speed_up, 'own', '.2f'),
    'efficiency, alone / with routes': _two(efficiency, 'best', '.0%'),
    'of the same algorithm': _two(efficiency, 'own', '.0%'),
}


CLAIMS = shown(
    'system operation formula printed sum_of_parts as_printed corrected best_known remark'
)


def _claims(rows: Iterable[Row]) -> Iterator[Row]:
    """Yield the claims of Table 1, with the counts of each edition at PRINTED_AT."""
    counts = {(x['system'], x['edition']): x for x in rows}
    for system, claims in paper.TABLE.items():
        for kind in KINDS:
            claim = claims[kind]
            editions = {
                edition.replace(' ', '_'): counts[system, edition][kind]
                for edition in EDITIONS
                if (system, edition) in counts
            }
            row = {'system': paper.title_of(system), 'operation': kind, **claim, **editions}
            parts = value(claim['parts'], PRINTED_AT) if 'parts' in claim else None
            yield row | {'formula': value(claim['formula'], PRINTED_AT), 'sum_of_parts': parts}


def _formula(kind: str) -> Cell:
    """Return a column: a formula and its value, or the value alone."""
    return lambda x: ' = '.join(dict.fromkeys((x[kind], str(x[f'claimed_{kind}']))))


PARTS: Columns = {
    **shown('title item text derived'),
    'paper: mult': _formula('multiplications'),
    'add': _formula('additions'),
    **shown('as_printed_multiplications as_printed_additions'),
    **shown('corrected_multiplications corrected_additions remark'),
}
# Cells of the table of iterations.
AFTER_N = '{error_after_n:.0e} / {worst_after_n:.0e}'
REACHED = '{median} / {worst} / {within_n:.0%}'

# Lines of the plot over each baseline: system, edition, whether a route is a step, and the style.
ROUTED = {'linestyle': '--'}
OVER_PUBLISHED: tuple[tuple[str, str, bool, dict[str, Any]], ...] = (
    ('pcrbm', EDITIONS[0], False, {'color': VERMILLION, 'marker': 'o'}),
    ('pcrbm', CORRECTED, False, {'color': BLUE, 'marker': 's'}),
    ('pcrbm', CORRECTED, True, {'color': BLUE, 'marker': 's', **ROUTED}),
)
OVER_BEST: tuple[tuple[str, str, bool, dict[str, Any]], ...] = (
    *OVER_PUBLISHED[1:],
    ('pcrbm', EDITIONS[2], False, {'color': GREEN, 'marker': '^'}),
    ('pcrbm', EDITIONS[2], True, {'color': GREEN, 'marker': '^', **ROUTED}),
    ('pcrbm_array', EDITIONS[2], True, {'color': PURPLE, 'marker': 'D', **ROUTED}),
    ('articulated_body_doubling', EDITIONS[2], True, {'color': ORANGE, 'marker': 'v', **ROUTED}),
    ('divide_and_conquer', EDITIONS[2], True, {'color': SKY, 'marker': 'P', **ROUTED}),
    ('constraint_forces', EDITIONS[2], True, {'color': GREY, 'marker': 'X', **ROUTED}),
)


# In the legend.
SHORT = (('Parallel composite rigid bodies', 'PCRBM'), (' the triangular', ' the'))


def plots(data: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the speed-up over n, as the paper's formula gives it and as executed."""
    rows = with_baselines(data['counts'], data['serial'])
    sizes = [x['n'] for x in data['serial']]
    claim = [(n, paper.published_serial(n) / float(sum(paper.claimed('pcrbm', n)))) for n in sizes]
    printed = (claim, {'color': BLACK, 'marker': '*', 'label': "PCRBM, the paper's formula"})

    def lines(what: Iterable[tuple[str, str, bool, dict[str, Any]]], over: str) -> Iterator[Any]:
        for system, edition, routed, style in what:
            own = [x for x in rows if (x['system'], x['edition']) == (system, edition)]
            if own:
                label = own[0]['title'] + ', with routes' * routed
                for long, short in SHORT:
                    label = label.replace(long, short)
                points = [(x['n'], speed_up(x, over, routed)) for x in own]
                yield points, {'markersize': 4, 'label': label, **style}

    left = [printed, *lines(OVER_PUBLISHED, 'published')]
    right = list(lines(OVER_BEST, 'best'))
    most = max(y for points, _ in (*left, *right) for _, y in points)
    axes = {'xlabel': 'joints, n', 'xticks': sizes[::2], 'xticklabels': sizes[::2]}
    axes |= {'ylabel': 'speed-up', 'yscale': 'linear', 'ylim': (0, 1.05 * most)}
    content = [
        (axes | {'title': "over Table 1's least serial count"}, left),
        (axes | {'title': 'over our least serial count'}, right),
    ]
    return panels(content, folder / 'speed-up.png', (10, 5.6), 2)
