# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the sources cite from Lee and Chang (1987) is in its text, and its cost is cited too."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
import json
from pathlib import Path
import re

import pytest

from pfd_core.report.cases.robots import uniform_chain as chain
from pfd_core.report.measure.convergence import convergence
from pfd_core.report.measure.counts import (
    AS_PRINTED,
    BEST_KNOWN,
    CORRECTED,
    Row,
    best_serial,
    published_serial,
    row,
)

ROOT = Path(__file__).resolve().parent.parent
SOURCES = sorted((ROOT / 'pfd_core').rglob('*.py'))
PAGES = tuple(
    ROOT / page
    for page in ('README.md', 'docs/notation.md', 'docs/guides/paper.md', 'docs/report/counts.md')
)

# Equation numbers of the paper, read off its text. (14), (17), (A.6) and (A.8) are lost in the
# scan, where a display without a number stands between its neighbours.
NUMBERED = ('1', '2.a', '2.b', '8.a', '8.b', '9.a', '9.b', *(f'A.{k}' for k in range(1, 9)))
EQUATIONS = {*NUMBERED, *map(str, (3, 4, 5, 6, 7)), *map(str, range(10, 32))}
SECTIONS = {'1', '2', '2.1', '2.2', '2.3', '2.4', '2.5', '2.6', '3', '4'}
APPENDICES = {'A', 'B', 'C'}

NUMBER = r'\((?:A\.)?\d+(?:\.[ab])?\)'
CITED = re.compile(
    rf'\b[Ee]q(?:s?\.|s|uations?)?\s+({NUMBER}(?:(?:,| to| and|,? and)\s+{NUMBER})*)'
)
# Formulas of the parts of the serial methods: the paper prints totals only.
NOT_IN_THE_PAPER = ('137 ?n', '101 ?n', '74 ?n', '54 ?n', '12 ?n^2 + 55', '7 ?n^2 + 66')


@cache
def texts(path: Path) -> tuple[str, ...]:
    """Return the docstrings and other strings of a module, or the whole of a page."""
    return tuple(_texts(path))


def _texts(path: Path) -> Iterator[str]:
    text = path.read_text(encoding='utf-8')
    if path.suffix != '.py':
        yield text
        return
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value
    yield '\n'.join(line.partition('#')[2] for line in text.splitlines() if '#' in line)


def cited(text: str) -> Iterator[str]:
    """Yield the numbers of the equations that a text cites; of a range, all."""
    for match in CITED.finditer(text):
        last = None
        for word, number in re.findall(rf'(to|and|,)?\s*({NUMBER})', match[1]):
            name = number.strip('()')
            if word == 'to' and last and last.isdecimal() and name.isdecimal():
                yield from map(str, range(int(last), int(name)))
            yield name
            last = name


def test_citations_are_found_in_every_form() -> None:
    text = 'eqs (16) to (18), eq. (27); equations (11), (12) and (29) to\n(31), eqs (A.4), (A.5)'
    found = {'16', '17', '18', '27', '11', '12', '29', '30', '31', 'A.4', 'A.5'}
    assert set(cited(text)) == found


@pytest.mark.parametrize('path', [*SOURCES, *PAGES], ids=lambda path: path.name)
def test_every_equation_and_section_that_is_cited_exists(path: Path) -> None:
    for text in texts(path):
        assert set(cited(text)) <= EQUATIONS
        for section in re.findall(r'\b[Ss]ections? (\d(?:\.\d+)*)', text):
            assert section in SECTIONS
        for appendix in re.findall(r'\bAppendix ([A-Z])\b', text):
            assert appendix in APPENDICES


def test_most_equations_are_cited_somewhere() -> None:
    # Else the search above would find nothing, and say so of anything.
    found = {name for path in SOURCES for text in texts(path) for name in cited(text)}
    assert {str(k) for k in (1, 3, 4, 5, 11, 12, 13, 14, 15, 18, 20, 21, 26, 27, 31)} <= found


@pytest.mark.parametrize('path', SOURCES, ids=lambda path: path.name)
def test_no_formula_that_the_paper_lacks_is_attributed_to_it(path: Path) -> None:
    for text in texts(path):
        for sentence in re.split(r'(?<=\.)\s', text):
            if re.search(r'Lee and Chang|the paper', sentence):
                for formula in NOT_IN_THE_PAPER:
                    assert not re.search(formula.replace('^', r'\^').replace('+', r'\+'), sentence)


def guide() -> str:
    return ' '.join((ROOT / 'docs' / 'guides' / 'paper.md').read_text(encoding='utf-8').split())


def test_the_guide_gives_the_steps_of_pcrbm_with_what_packing_costs() -> None:
    counts = row('pcrbm', 6)
    s, u = counts.steps, counts.unpacked
    cells = counts.cells['multiplications'], counts.cells['additions']
    sentence = guide().split('For PCRBM at six joints')[1].split('##')[0]
    printed = row('pcrbm', 6, edition=AS_PRINTED)
    corrected = row('pcrbm', 6, edition=CORRECTED).steps
    p, q, c = printed.steps, printed.unpacked, corrected
    claimed = [cell.claimed for cell in printed.cells.values()]
    for stated in (
        f'as printed, PCRBM takes {p.multiplications + p.divisions} multiplications and '
        'divisions, '
        f'a square root, {p.additions} additions and {p.routes} routes, or '
        f'{q.multiplications + q.divisions}, {q.square_roots}, {q.additions} and {q.routes} with '
        'one lane per link',
        f'a speed-up of {printed.published_speed_up:.2f}, or {with_routes(printed)} if a route',
        f'PCRBM takes {c.multiplications + c.divisions}, {c.square_roots} square roots, '
        f'{c.additions} and {c.routes}',
        f"Our form in the paper's frames takes {s.multiplications + s.divisions}, {s.additions} "
        f'and {s.routes}, or '
        f'{u.multiplications + u.divisions}, {u.additions} and {u.routes} with one lane per link',
        f'prints {cells[0].printed} multiplications and {cells[1].printed} additions',
        f'sum to {cells[0].parts:.0f} and {cells[1].parts:.0f}, the formula of Table 1 gives '
        f'{claimed[0]:.0f} and {claimed[1]:.0f}',
        f'a speed-up of {published_serial(6) / (334 + 328):.2f} over the serial count',
    ):
        assert stated in sentence
    assert best_serial(6)[0] in ('walker_orin_3', 'articulated_body')
    assert f'{counts.speed_up:.2f} times as many steps of arithmetic' in guide()
    assert f'{counts.routed_speed_up:.2f} times if a route is a step' in guide()


def with_routes(counts: Row) -> str:
    """Return the speed-up over the published serial count, each route a step."""
    s, u = counts.steps, counts.unpacked
    routed = min(
        x.multiplications + x.divisions + x.additions + x.square_roots + x.routes for x in (s, u)
    )
    return f'{published_serial(counts.n) / routed:.2f}'


def test_the_readme_gives_the_speed_ups_of_the_paper_as_printed_and_of_our_best() -> None:
    readme = ' '.join((ROOT / 'README.md').read_text(encoding='utf-8').split())
    printed, best = row('pcrbm', 6, edition=AS_PRINTED), row('pcrbm', 6)
    assert f'a speed-up of {published_serial(6) / (334 + 328):.2f} over a published' in readme
    assert (
        f'Executed as printed, PCRBM reaches {printed.published_speed_up:.2f} over the same count '
        'and gives a wrong matrix. Over the best serial count here it reaches '
        f'{printed.speed_up:.2f}, or {printed.routed_speed_up:.2f} if a data move between '
        'processors counts as a step.'
    ) in readme
    assert f'reaches {best.speed_up:.2f}, or {best.routed_speed_up:.2f}; about' in readme


def test_the_guide_gives_what_convergence_and_divide_and_conquer_cost() -> None:
    page = (ROOT / 'docs' / 'report' / 'counts.md').read_text(encoding='utf-8')
    iterations = re.search(r'To rounding they take (\d+) to (\d+) iterations', guide())
    assert iterations is not None
    few, many = (row('pcgm', 6, int(k)).cells for k in iterations.groups())
    worst = re.search(r'six iterations leave relative errors of up to (\S+)\. ', guide())
    assert worst is not None
    few_to_many = f'{iterations[1]} to {iterations[2]} iterations'
    price = f'leave errors of up to {worst[1]}; {few_to_many} converge and take'
    assert f'all for 6 iterations, which {price}' in page
    assert int(iterations[1]) == convergence('pcgm', chain(6)).least
    for kind, name in (
        ('multiplications', 'multiplications and divisions'),
        ('additions', 'additions'),
    ):
        assert f'{few[kind].measured} to {many[kind].measured} {name}' in guide()
    routes = [row('pcgm', 6, int(k)).steps.routes for k in iterations.groups()]
    assert f'with {routes[0]} to {routes[1]} routes' in guide()
    counts = row('divide_and_conquer', 6)
    measured = [cell.measured for cell in counts.cells.values()]
    stated = f'it takes {measured[0]} and {measured[1]} with {counts.steps.routes} routes'
    assert stated in guide()


def test_the_guide_gives_the_steps_of_64_joints() -> None:
    # Of the page, whose numbers are tested.
    text = (ROOT / 'docs' / 'report' / 'counts.json').read_text(encoding='utf-8')
    rows = {
        (entry['system'], entry['n']): entry['cells']
        for entry in json.loads(text)['counts']
        if entry['edition'] == BEST_KNOWN
    }
    stated = []
    for method in ('divide_and_conquer', 'pcrbm'):
        stated += [cell['measured'] for cell in rows[method, 64].values()][:2]
    assert (
        f'still {stated[0]} and {stated[1]} where PCRBM takes {stated[2]} and {stated[3]}'
        in guide()
    )
