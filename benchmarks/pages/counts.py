# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Steps of every system compared with the paper, speed-up over n, and iterations of PCGM.

texts/counts.md defines steps, editions, speed-up and efficiency. Divisions are counted apart, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmarks.cases import conjugate, paper
from benchmarks.cases.paper import CORRECTED, EDITIONS, KINDS, PRINTED_AT, value
from benchmarks.plots import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION, panels
from benchmarks.run import each
from benchmarks.table import Columns, Row, grid, order, page, shown, stored_table, table
from pfd_core.dynamics.methods import METHODS
from pfd_core.paper.emulate import ROUNDINGS

SIZES = (2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 24, 32, 48, 64)
COUNTED = (*METHODS, 'constraint_forces')


def measure(quick: bool) -> dict[str, Any]:
    """Count every system, and iterations; quick is six joints only."""
    sizes = (PRINTED_AT,) if quick else SIZES
    systems = [(x, n, edition) for n in sizes for x in COUNTED for edition in paper.editions_of(x)]
    square = [(x, n, edition) for n in sizes for x in paper.PROCEDURES for edition in EDITIONS[:2]]
    counts = each(_row, systems, 'counting steps', lambda key: key[1])
    squares = each(_square_row, square, 'counting steps of right angles', lambda key: key[1])
    studied = [n for n in conjugate.SIZES if n in sizes]
    reached = each(conjugate.reached_by, studied, 'iterations of PCGM', int)
    # In a quick run the chains of five and six joints, of which some converge and some do not.
    chains = conjugate.CHAINS[24:36] if quick else conjugate.CHAINS
    statuses = each(conjugate.statuses_of, chains, 'statuses of PCGM', lambda chain: chain[0])
    return {
        'counts': counts,
        'right_angles': squares,
        'serial': [best_serial(counts, n) for n in sizes],
        'parts': list(counted_parts(PRINTED_AT)),
        'reached': [row for rows in reached for row in rows],
        'statuses': [row for rows in statuses for row in rows],
    }


def _row(key: tuple[Any, ...]) -> dict[str, Any]:
    return paper.row(*key)


def _square_row(key: tuple[str, int, str]) -> dict[str, Any]:
    return paper.row(*key, right_angles=True)


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
            prefix: paper.program_of(paper.Recording(system, n, edition, right_angles=square))
            for prefix, edition, square in (
                ('right_angles_', EDITIONS[0], True),
                ('as_printed_', EDITIONS[0], False),
                ('corrected_', CORRECTED, False),
            )
        }
        for part in parts:
            row = {'system': system, 'title': paper.title_of(system), 'remark': '', **part}
            row |= {f'claimed_{kind}': int(value(part[kind], n)) for kind in KINDS[:2]}
            for prefix, program in recorded.items():
                row |= paper.flat(prefix, paper.in_sections(program, part['sections']))
            yield row


def array_by_the_formulas() -> dict[str, Any]:
    """Return totals by Table 1 of PCRBM with and without the array, and where they cross."""
    with_array, without = (
        {n: int(sum(paper.claimed(x, n))) for n in range(1, SIZES[-1])}
        for x in ('pcrbm_array', 'pcrbm')
    )
    first = 1 + max(n for n in with_array if with_array[n] >= without[n])
    at = {'with_array': with_array[PRINTED_AT], 'without_array': without[PRINTED_AT]}
    return at | {'array_from': first}


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


def in_words(x: Row, prefix: str = '') -> str:
    """Return the steps of a row in words."""
    kinds = ('multiplications', 'additions', 'square_roots', 'routes')
    found = {kind.replace('_', ' '): x[prefix + kind] for kind in kinds}
    words = [f'{k} {kind.removesuffix("s") if k == 1 else kind}' for kind, k in found.items() if k]
    return f'{", ".join(words[:-1])} and {words[-1]}'


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

    def of_pcrbm(name: str) -> list[dict[str, Any]]:
        found = (x for x in counts[name] if (x['system'], x['n']) == ('pcrbm', PRINTED_AT))
        return with_baselines(found, counts['serial'])

    executed, own = of_pcrbm('right_angles')[0], of_pcrbm('counts')[-1]
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
    square = [x for x in data['right_angles'] if x['n'] == PRINTED_AT]
    (printed_square,) = with_baselines(square[:1], data['serial'])
    return page(
        'counts',
        n=PRINTED_AT,
        best=serial['title'],
        arithmetic=serial['best'],
        published=published,
        printed=printed,
        printed_speed_up=f'{published / printed:.2f}',
        systems=table(SYSTEMS, (x for x in at if x['system'] in paper.TABLE)),
        claims=table(CLAIMS, _claims(at, square)),
        parts=table(PARTS, data['parts']),
        square_speed_up=f'{speed_up(printed_square, "published"):.2f}',
        square_routed=f'{speed_up(printed_square, "published", True):.2f}',
        square_unpacked=in_words(printed_square, 'unpacked_'),
        **array_by_the_formulas(),
        states=conjugate.STATES,
        **conjugate.thresholds(data['reached'], data['statuses']),
        within=f'{conjugate.WITHIN:g}',
        roundings=f'{ROUNDINGS:g}',
        statuses=table(STATUSES, conjugate.summary(data['statuses'])),
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
    **shown('units multiplications divisions additions square_roots routes'),
    'with one lane per link': lambda x: ', '.join(
        str(x[f'unpacked_{kind}']) for kind in ('multiplications', 'additions', 'routes')
    ),
    'busy': lambda x: f'{x["work"] / arithmetic_of(x) / x["units"]:.0%}',
    'speed-up, alone / with routes': _two(speed_up, 'best', '.2f'),
    'over published counts': _two(speed_up, 'published', '.2f'),
    'over one processor': _two(speed_up, 'own', '.2f'),
}


SQUARE = 'right_angles', 'right_angles_corrected'
CLAIMS: Columns = {
    **shown('system operation formula printed sum_of_parts'),
    'as printed, twists 0/90': lambda x: x.get(SQUARE[0], '-'),
    'corrected, twists 0/90': lambda x: x.get(SQUARE[1], '-'),
    **shown('as_printed corrected best_known remark'),
}


def _claims(rows: Iterable[Row], square: Iterable[Row]) -> Iterator[Row]:
    """Yield the claims of Table 1, with the counts of each edition at PRINTED_AT."""
    counts = {(x['system'], x['edition'].replace(' ', '_')): x for x in rows}
    for name, edition in zip(SQUARE, EDITIONS, strict=False):
        counts |= {(x['system'], name): x for x in square if x['edition'] == edition}
    names = *SQUARE, *(edition.replace(' ', '_') for edition in EDITIONS)
    for system, claims in paper.TABLE.items():
        for kind in KINDS:
            claim = claims[kind]
            if claim['formula'] == '0':
                continue
            editions = {
                name: counts[system, name][kind] for name in names if (system, name) in counts
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
    'as printed, twists 0/90: mult': 'right_angles_multiplications',
    'add ': 'right_angles_additions',
    **shown('as_printed_multiplications as_printed_additions'),
    **shown('corrected_multiplications corrected_additions remark'),
}
STATUSES: Columns = {
    'method': 'method',
    'chains': 'chains',
    'ok': 'ok',
    'worst error of these': lambda x: f'{x["worst"]:.2f} of what ok allows, {x["error"]:.0e}',
    'other status': 'refused',
    'of these right': 'right',
    'of these with an error below 1e-6': 'small',
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
    ('articulated_body_doubling', EDITIONS[2], False, {'color': ORANGE, 'marker': 'v'}),
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

    square = (x for x in data['right_angles'] if x['system'] == 'pcrbm')
    of_square = {'color': VERMILLION, 'marker': 'o', 'linestyle': ':', 'markersize': 4}
    of_square['label'] = 'PCRBM, as printed, twists 0/90'
    points = [
        (x['n'], speed_up(x, 'published'))
        for x in with_baselines(square, data['serial'])
        if x['edition'] == EDITIONS[0]
    ]
    left = [printed, (points, of_square), *lines(OVER_PUBLISHED, 'published')]
    right = list(lines(OVER_BEST, 'best'))
    most = max(y for points, _ in (*left, *right) for _, y in points)
    axes = {'xlabel': 'joints, n', 'xticks': sizes[::2], 'xticklabels': sizes[::2]}
    axes |= {'ylabel': 'speed-up', 'yscale': 'linear', 'ylim': (0, 1.05 * most)}
    content = [
        (axes | {'title': "over Table 1's least serial count"}, left),
        (axes | {'title': 'over our least serial count'}, right),
    ]
    return panels(content, folder / 'speed-up.png', (10, 5.6), 2)
