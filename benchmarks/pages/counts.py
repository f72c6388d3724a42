# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Steps of every system compared with the paper, on fewer processors, and iterations of PCGM.

The paper counts divisions as multiplications and takes the rotation of each joint as given; so do
the rows, and divisions are also counted apart. It does not count routes, steps that move data
between lanes. Speed-up divides the arithmetic of one processor by the arithmetic of a system. The
processor executes the same algorithm, or the best direct algorithm at that n: its sequential
recording, or the system's program operation by operation, whichever is less. So n processors are
at most n times as fast.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.cases import paper
from benchmarks.cases.paper import BEST_KNOWN, CORRECTED, EDITIONS, KINDS, PRINTED_AT, value
from benchmarks.cases.robots import uniform_chain
from benchmarks.pages import iterations as pcgm
from benchmarks.plots import BLACK, BLUE, GREEN, GREY, ORANGE, over_joints, save
from benchmarks.run import each
from benchmarks.table import Columns, Row, grid, order, page, stored_table, table
from pfd_core.algorithms.emulation import in_sections
from pfd_core.algorithms.programs import ITERATIVE, METHODS, SERIAL
from pfd_core.model import Robot, load_robot

SIZES = (2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 24, 32, 48, 64)
# Joints, and numbers of processors: divisors, and for 6 joints also 4, of which one has no link.
PROCESSORS = {6: (1, 2, 3, 4, 6), 12: (1, 2, 3, 4, 6, 12), 64: (1, 2, 4, 8, 16, 32, 64)}
COUNTED = (*METHODS, 'constraint_forces')
COUNTS = (*KINDS[:2], 'routes')
COMPARED_AT = 1e-6  # the error at which costs of PCGM are compared


def measure(quick: bool) -> dict[str, Any]:
    """Count every system, and iterations; quick is six joints only."""
    sizes = (PRINTED_AT,) if quick else SIZES
    robots = (*map(uniform_chain, pcgm.CHAINS), *map(load_robot, pcgm.ARMS))
    tried = [(method, robot) for robot in robots if robot.n in sizes for method in ITERATIVE]
    converged = list(each(_convergence, tried, 'counting iterations', lambda one: one[1].n))
    keys: list[Key] = [
        (method, n, edition, None, k)
        for n in sizes
        for method in COUNTED
        for edition in paper.editions_of(method)
        for k in (None, *(_range(converged, method) if (n, edition) == (6, BEST_KNOWN) else ()))
    ]
    fewer: list[Key] = [
        (method, n, edition, p, None)
        for n in sizes
        for p in PROCESSORS.get(n, ())
        for method in METHODS
        if method not in SERIAL
        for edition in paper.editions_of(method)[-2:]
    ]
    found = list(each(_row, keys + fewer, 'counting steps', lambda key: key[1]))
    counts, studied = found[: len(keys)], [n for n in pcgm.SIZES if n in sizes]
    reached = each(pcgm.reached_by, studied, 'iterations of PCGM', int)
    return {
        'counts': counts,
        'serial': [best_serial(counts, n) for n in sizes],
        'claims': [
            {'system': x, 'title': paper.title_of(x), 'operation': kind}
            | {key: paper.TABLE[x][kind].get(key) for key in CLAIM}
            for x in METHODS
            if x in paper.TABLE
            for kind in KINDS
        ],
        'parts': list(counted_parts(PRINTED_AT)),
        'convergence': converged,
        'processors': found[len(keys) :],
        'reached': [row for rows in reached for row in rows],
        'prices': [pcgm.price(PRINTED_AT, name) for name in pcgm.VARIANTS],
    }


CLAIM = ('formula', 'printed', 'parts', 'remark')
# Method, n, edition, processors and iterations.
Key = tuple[str, int, str, int | None, int | None]


def _row(key: Key) -> dict[str, Any]:
    return paper.row(*key)


def best_serial(counts: Iterable[Row], n: int) -> dict[str, Any]:
    """Return the direct method with least arithmetic on one processor, and that of Table 1."""
    direct = [x for x in counts if x['n'] == n and x['iterations'] is None]
    # Without the edition as printed, which does not give qdd.
    right = (x for x in direct if x['system'] in METHODS and x['edition'] != EDITIONS[0])
    best = min(right, key=lambda x: x['own'])
    published = paper.published_serial(n)
    return {'n': n, 'title': best['title'], 'best': best['own'], 'published': published}


def counted_parts(n: int) -> Iterator[dict[str, Any]]:
    """Yield the parts of sections 2.5 and 3, each counted by its sections of the recordings."""
    kinds = (
        ('as_printed_', EDITIONS[0], 'parallel'),
        ('unpacked_', EDITIONS[0], 'unpacked'),
        ('corrected_', CORRECTED, 'parallel'),
    )
    for system, parts in stored_table('paper_parts').items():
        recorded = [
            (prefix, paper.program_of(paper.Recording(system, n, edition, schedule)))
            for prefix, edition, schedule in kinds
        ]
        for part in parts:
            row = {'system': system, 'title': paper.title_of(system), 'remark': '', **part}
            row |= {f'claimed_{kind}': int(value(part[kind], n)) for kind in KINDS[:2]}
            for prefix, program in recorded:
                row |= paper.flat(prefix, in_sections(program, part['sections']))
            yield row


def _convergence(one: tuple[str, Robot]) -> dict[str, Any]:
    """Return the iterations of a method, and the cost of the fewest and of the most."""
    found = pcgm.convergence(*one)
    for which in ('least', 'most'):
        counts = paper.row(found['system'], found['n'], iterations=found[which])
        found |= {f'{which}_{kind}': counts[kind] for kind in COUNTS}
    return found


def _range(converged: Iterable[Row], system: str) -> tuple[int, ...]:
    """Return the fewest and the most iterations of all robots with PRINTED_AT joints, if any."""
    own = [x for x in converged if (x['system'], x['n']) == (system, PRINTED_AT)]
    return (min(x['least'] for x in own), max(x['most'] for x in own)) if own else ()


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


def with_baselines(data: Mapping[str, Any], name: str = 'counts') -> list[dict[str, Any]]:
    """Return rows with `best` and `published`, the arithmetic of one processor; not of PCGM."""
    known = {x['n']: x for x in data['serial']}
    # Iterations depend on the state.
    return [
        x | {key: None if x['iterations'] else known[x['n']][key] for key in ('best', 'published')}
        for x in data[name]
    ]


def _printed(claims: Iterable[Row]) -> int:
    """Return the total of multiplications and additions that Table 1 prints for PCRBM."""
    return sum(x['printed'] for x in claims if x['system'] == 'pcrbm' and x['operation'] in COUNTS)


def summary(counts: Mapping[str, Any], claims: Mapping[str, Any]) -> str:
    """Return the speed-ups of PCRBM and the verdicts in two sentences, from both pages' data."""
    rows = [x for x in with_baselines(counts) if x['n'] == PRINTED_AT]
    known = {(x['system'], x['edition']): x for x in rows}
    executed = known['pcrbm', EDITIONS[0]]
    own = known['pcrbm', BEST_KNOWN]
    return page(
        'paper-summary',
        printed=f'{executed["published"] / _printed(counts["claims"]):.2f}',
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
    every = with_baselines(data)
    rows = [x for x in every if x['iterations'] in (None, x['n'])]
    at = [x for x in every if x['n'] == PRINTED_AT]
    serial = next(x for x in data['serial'] if x['n'] == PRINTED_AT)
    printed, published = _printed(data['claims']), int(serial['published'])
    return page(
        'counts',
        n=PRINTED_AT,
        best=serial['title'],
        arithmetic=serial['best'],
        published=published,
        printed=printed,
        printed_speed_up=f'{published / printed:.2f}',
        states=data['convergence'][0]['states'],
        systems=table(SYSTEMS, _noted(at)),
        claims=table(CLAIMS, (_compared(x, at, data['convergence']) for x in data['claims'])),
        parts=table(PARTS, data['parts']),
        convergence=table(CONVERGENCE, data['convergence']),
        **{kind: _over_n(rows, _and_claimed(data['claims'], kind)) for kind in KINDS[:2]},
        routes=_over_n(
            [x for x in rows if x['units'] > 1],
            lambda x: f'{x["routes"]} / {x["unpacked_routes"]}',
        ),
        speed_up=_over_n([x for x in rows if x['best']], _two(speed_up, 'best', '.2f')),
        processors='\n'.join(_processors(data, x) for x in data['serial'] if x['n'] in PROCESSORS),
        cycle=f'{pcgm.CYCLE * 1e3:g}',
        compared=order(COMPARED_AT),
        tolerances=', '.join(map(order, pcgm.TOLERANCES)),
        pcgm_states=pcgm.FEWER_STATES,
        reached='\n'.join(_reached(data['reached'], x) for x in pcgm.TOLERANCES),
        costs=table(COSTS, pcgm_costs(data)),
        prices=table(PRICES, data['prices']),
    )


def _over_n(rows: Iterable[Row], cell: Cell) -> list[str]:
    return grid({(_title(x), x['n']): cell(x) for x in rows}, 'system')


def _title(x: Row) -> str:
    return str(x['title']) + (', n iterations' if x['iterations'] else '')


def _two(ratio: Callable[..., float], over: str, form: str) -> Cell:
    """Return a column: a ratio by arithmetic alone / with routes."""
    both = f'{{:{form}}} / {{:{form}}}'
    return lambda x: '-' if x[over] is None else both.format(ratio(x, over), ratio(x, over, True))


def _and_claimed(claims: Iterable[Row], kind: str) -> Cell:
    formulas = {x['system']: x['formula'] for x in claims if x['operation'] == kind}

    def cell(x: Row) -> str:
        formula = formulas.get(x['system'])
        return f'{x[kind]} / {_number(value(formula, x["n"]))}' if formula else str(x[kind])

    return cell


def _number(found: Any) -> str:
    return f'{float(found):.0f}' if found == int(found) else f'{float(found):.1f}'


NOTES = ('not converged', 'the fewest to converge', 'the most to converge')


def _noted(rows: Iterable[Row]) -> Iterator[Row]:
    """Yield rows, those of our iterative methods with a note on their iterations."""
    notes = {system: iter(NOTES) for system in ITERATIVE}
    for x in rows:
        note = f' ({next(notes[x["system"]])})' if _iterates(x) else ''
        iterations = f', {x["iterations"]} iterations{note}' if x['iterations'] else ''
        yield {**x, 'title': x['title'] + iterations}


def _iterates(x: Row) -> bool:
    return bool(x['iterations']) and x['edition'] == BEST_KNOWN


def _parallel(kind: str) -> Cell:
    return lambda x: '-' if x['units'] == 1 else x[f'unpacked_{kind}']


def _machine(x: Row) -> str:
    """Return the processors as a formula in n."""
    machine = '1' if x['system'] in SERIAL else 'n'
    return str(paper.TABLE.get(x['system'], {}).get('processors', machine))


SYSTEMS: Columns = {
    'system': 'title',
    'processors': _machine,
    'mult': 'multiplications',
    'of these div': 'divisions',
    'add': 'additions',
    'sqrt': 'square_roots',
    'routes': 'routes',
    'one lane per link: mult': _parallel('multiplications'),
    'add ': _parallel('additions'),
    'routes ': _parallel('routes'),
    'busy': lambda x: f'{x["work"] / arithmetic_of(x) / x["units"]:.0%}',
    'speed-up, arithmetic alone / with routes': _two(speed_up, 'best', '.2f'),
    'over published counts': lambda x: (
        f'{speed_up(x, "published"):.2f}' if x['published'] else '-'
    ),
    'over one processor': lambda x: f'{speed_up(x, "own"):.2f}',
    'efficiency, alone / with routes': _two(efficiency, 'best', '.0%'),
    'of the same algorithm': lambda x: f'{efficiency(x, "own"):.0%}',
}


def _compared(claim: Row, rows: Iterable[Row], converged: Iterable[Row]) -> Row:
    """Return a claim with its counts in each edition, and the price of convergence."""
    system, kind = claim['system'], claim['operation']
    own = [x for x in rows if x['system'] == system]
    formula, remarks = value(claim['formula'], PRINTED_AT), [claim['remark']]
    cells: dict[str, object] = {'value': _number(formula), 'sum': '-'}
    if claim['parts']:
        cells['sum'] = _number(value(claim['parts'], PRINTED_AT))
    # Of several numbers of iterations the first, which is n.
    for x in reversed(own):
        cells |= {x['edition']: x[kind], f'{x["edition"]}, unpacked': _parallel(kind)(x)}
    if EDITIONS[0] in cells:
        found = own[0][kind]
        cells['comparison'] = (
            'equal' if found == formula else 'higher' if found > formula else 'lower'
        )
    if own[-1]['iterations'] and kind != 'square_roots':
        _, few, many = (x for x in own if x['edition'] == BEST_KNOWN)
        after_n = (x for x in converged if (x['system'], x['n']) == (system, PRINTED_AT))
        remarks.append(
            f'all for {PRINTED_AT} iterations, which leave errors of up to '
            f'{order(max(x["worst_after_n"] for x in after_n))}; {few["iterations"]} to '
            f'{many["iterations"]} iterations converge and take {few[kind]} to {many[kind]} '
            '(best known)'
        )
    return {**claim, **cells, 'remark': '; '.join(filter(None, remarks))}


def _or_dash(key: str) -> Cell:
    return lambda x: x.get(key, '-')


CLAIMS: Columns = {
    'system': 'title',
    'operation': 'operation',
    'formula': 'value',
    'printed': 'printed',
    'sum of its parts': 'sum',
    **{
        title: _or_dash(key)
        for k, edition in enumerate(EDITIONS)
        for title, key in {
            edition: edition,
            'one lane per link' + k * ' ': f'{edition}, unpacked',
        }.items()
    },
    'as printed is': _or_dash('comparison'),
    'remark': 'remark',
}


def _formula(kind: str) -> Cell:
    """Return a column: a formula and its value, or the value alone."""
    return lambda x: ' = '.join(dict.fromkeys((x[kind], str(x[f'claimed_{kind}']))))


def _difference(x: Row) -> str:
    more = [x[f'as_printed_{kind}'] - x[f'claimed_{kind}'] for kind in KINDS[:2]]
    return f'{more[0]:+d} / {more[1]:+d}' if any(more) else 'equal'


PARTS: Columns = {
    'system': 'title',
    'item': 'item',
    'what': 'text',
    'count': lambda x: 'derived' if x['derived'] else 'decomposed from the total',
    'paper: mult': _formula('multiplications'),
    'add': _formula('additions'),
    'as printed: mult': 'as_printed_multiplications',
    'add ': 'as_printed_additions',
    'one lane per link: mult': 'unpacked_multiplications',
    'add  ': 'unpacked_additions',
    'corrected: mult': 'corrected_multiplications',
    'add   ': 'corrected_additions',
    'as printed is': _difference,
    'remark': 'remark',
}


def _few_to_many(kind: str) -> Cell:
    keys = (f'least_{kind}', f'most_{kind}')
    return lambda x: ' to '.join(dict.fromkeys(str(x[key]) for key in keys))


CONVERGENCE: Columns = {
    'system': 'system',
    'robot': 'robot',
    'n': 'n',
    'iterations: fewest': 'least',
    'median': 'median',
    'most': 'most',
    'mult': _few_to_many('multiplications'),
    'add': _few_to_many('additions'),
    'routes': _few_to_many('routes'),
    'error after n iterations: median': lambda x: order(x['error_after_n']),
    'largest': lambda x: order(x['worst_after_n']),
    'at the end: largest': lambda x: order(x['worst_converged']),
}


def _processors(data: Mapping[str, Any], serial: Row) -> str:
    rows = [x for x in with_baselines(data, 'processors') if x['n'] == serial['n']]
    direct = [x for x in rows if x['best'] is not None]

    def over_p(rows: Iterable[Row], cell: Cell) -> list[str]:
        return grid({(x['title'], f'p = {x["processors"]}'): cell(x) for x in rows}, 'system')

    def steps(x: Row) -> str:
        counts = (f'{arithmetic_of(x, k)} + {x[f"{k}routes"]}' for k in ('', 'unpacked_'))
        return ' / '.join(counts)

    return page(
        'counts-processors',
        n=serial['n'],
        best=serial['title'],
        arithmetic=serial['best'],
        steps=over_p(rows, steps),
        own=over_p(rows, _two(speed_up, 'own', '.2f')),
        own_efficiency=over_p(rows, _two(efficiency, 'own', '.1%')),
        best_speed_up=over_p(direct, _two(speed_up, 'best', '.2f')),
        efficiency=over_p(direct, _two(efficiency, 'best', '.1%')),
    )


# ---- conjugate gradients ----


def _reached(rows: Iterable[Row], tolerance: float) -> str:
    """Return the section of a tolerance."""

    def cell(x: Row) -> str:
        missed = f' ({x["missed"]} missed)' if x['missed'] else ''
        return f'{x["median"]} / {x["worst"]}{missed} / {x["within_n"]:.0%}'

    own = [x for x in rows if x['tolerance'] == tolerance]
    title = '{variant}: median / worst / within n'
    cells = grid({(str(x['n']), title.format(**x)): cell(x) for x in own}, 'n')
    return '\n'.join((f'### Error of {order(tolerance)}', '', *cells, ''))


def pcgm_costs(data: Mapping[str, Any]) -> list[dict[str, Any]]:
    """
    Return the costs of PCGM at COMPARED_AT for each n: lists of multiplications, additions, roots.

    A row has the cost `pcrbm`, and the row of `reached` of each variant and of the `cheapest`.
    """
    pcrbm = {
        x['n']: [x[f'unpacked_{kind}'] for kind in KINDS]
        for x in data['counts']
        if (x['system'], x['edition']) == ('pcrbm', CORRECTED)
    }
    formulas = [x['formula'] for x in data['claims'] if x['system'] == 'pcgm'][:2]
    by_n: dict[int, dict[str, Row]] = {}
    for x in data['reached']:
        if x['tolerance'] == COMPARED_AT:
            by_n.setdefault(x['n'], {})[x['variant']] = x
    return [
        {
            'n': n,
            'pcrbm': pcrbm[n],
            'formula': [value(formula, n) for formula in formulas],
            'cheapest': min(own.values(), key=lambda x: sum(x['in_median'])),
            **own,
        }
        for n, own in by_n.items()
    ]


def _cost(*keys: str) -> Callable[[Any], str]:
    def cell(x: Any) -> str:
        for key in keys:
            x = x[key]
        return f'{x[0]} / {x[1]}'

    return cell


def _over_pcrbm(name: str) -> Cell:
    return lambda x: f'{sum(x["plain"][name]) / sum(x["pcrbm"]):.2f}'


COSTS: Columns = {
    'n': 'n',
    'formula of Table 1': _cost('formula'),
    'n iterations': _cost('plain', 'in_n'),
    'error left: median / worst': lambda x: ' / '.join(
        order(x['plain'][f'{which}_after_n']) for which in ('error', 'worst')
    ),
    'converged: median': _cost('plain', 'in_median'),
    'worst': _cost('plain', 'in_worst'),
    'cheapest variant, median': lambda x: (
        f'{x["cheapest"]["variant"]}: {_cost("cheapest", "in_median")(x)}'
    ),
    'PCRBM, corrected': _cost('pcrbm'),
    'arithmetic of PCGM over PCRBM: n iterations': _over_pcrbm('in_n'),
    'converged': _over_pcrbm('in_median'),
}
PRICES: Columns = {
    'variant': 'variant',
    'before the loop: mult': 'first_multiplications',
    'add': 'first_additions',
    'routes': 'first_routes',
    'each iteration: mult': 'each_multiplications',
    'add ': 'each_additions',
    'routes ': 'each_routes',
}


# ---- pictures ----


def plots(data: dict[str, Any], folder: Path) -> list[Path]:
    """Draw steps over n, and iterations of PCGM over n."""
    steps = save(partial(_draw_steps, data), folder, 'counts', (12, 6.5), ['png'])
    return [*steps, *save(partial(_draw_pcgm, data), folder, 'pcgm', (12, 5), ['png'])]


def _draw_steps(data: Mapping[str, Any], figure: Any) -> None:
    """Draw multiplications and additions over n, formulas dashed, as printed dotted."""
    import matplotlib

    formulas = {(x['system'], x['operation']): x['formula'] for x in data['claims']}
    rows = [x for x in data['counts'] if x['iterations'] in (None, x['n'])]
    for axes, kind in zip(figure.subplots(1, 2), KINDS[:2], strict=True):
        for k, system in enumerate(dict.fromkeys(x['system'] for x in rows)):
            printed, _, best = (
                [x for x in rows if (x['system'], x['edition']) == (system, edition)]
                for edition in EDITIONS
            )
            n = [x['n'] for x in best]
            # Ten colours, then their light shades.
            color = matplotlib.colormaps['tab20'](2 * k % 20 + k // 10)
            label = _title(best[0])
            axes.loglog(n, [x[kind] for x in best], color=color, marker='.', ms=4, label=label)
            if (system, kind) in formulas:
                claims = [float(value(formulas[system, kind], size)) for size in n]
                axes.loglog(n, claims, color=color, linestyle='--', lw=0.8)
            if printed:
                axes.loglog(n, [x[kind] for x in printed], color=color, linestyle=':')
        over_joints(axes, [2**k for k in range(1, 7)])
        axes.set_ylabel('steps')
        axes.set_title(f'{kind}, no routes: counted, as printed (dotted), Table 1 (dashed)')
    entries = figure.axes[0].get_legend_handles_labels()
    figure.legend(*entries, loc='outside lower center', ncols=3, fontsize=8, frameon=False)


def _draw_pcgm(data: Mapping[str, Any], figure: Any) -> None:
    """Draw iterations over n, and steps of arithmetic over n."""
    rows = pcgm_costs(data)
    n = [x['n'] for x in rows]
    left, right = figure.subplots(1, 2)
    for name, color in zip(pcgm.VARIANTS, (BLACK, ORANGE, BLUE, GREEN), strict=True):
        own = [x[name] for x in rows]
        left.loglog(n, [x['median'] for x in own], color=color, marker='.', label=name)
        left.loglog(n, [x['worst'] for x in own], color=color, linestyle=':')
        costs = [sum(x['in_median']) for x in own]
        right.loglog(n, costs, color=color, marker='.', label=f'{name}, converged')
    left.loglog(n, n, color=GREY, linestyle='--', label='n, as the paper counts')
    left.set_title(f'iterations to {order(COMPARED_AT)}: median, worst (dotted)')
    in_n = [sum(x['plain']['in_n']) for x in rows]
    right.loglog(n, in_n, color=GREY, linestyle='--', label='plain, n iterations')
    direct = [sum(x['pcrbm']) for x in rows]
    right.loglog(n, direct, color=GREY, marker='x', label='PCRBM, corrected')
    right.set_title('steps of arithmetic, one lane per link, no routes')
    for axes in (left, right):
        over_joints(axes, [2**k for k in range(1, 7)])
        axes.legend(fontsize=8)
