# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The paper's claims: each verdict has a test, the index names what exists, no stale page."""

from __future__ import annotations

import ast
from functools import cache
from importlib import import_module
import inspect
import json
from pathlib import Path
import re

import pytest
from test_paper_references import EQUATIONS as NUMBERS
from test_paper_references import cited, texts

from pfd_core.algorithms.paper.array_solver import solve
from pfd_core.algorithms.paper.pcgm_1987 import record_pcgm_1987
from pfd_core.algorithms.paper.pcrbm_1987 import AS_PRINTED, record_pcrbm_1987
from pfd_core.algorithms.programs import FORWARD, record_inverse_dynamics
from pfd_core.model import resolve
from pfd_core.report.cases.paper import EQUATIONS, PROCEDURES, TABLE, Implemented, value
from pfd_core.report.cases.robots import uniform_chain
from pfd_core.report.measure.claims import CLAIMS, VERDICTS, Claim, verdicts
from pfd_core.report.paper_pages import write_claims

ROOT = Path(__file__).resolve().parent.parent
PAGES = ROOT / 'docs' / 'report'
INDEX = (*EQUATIONS, *PROCEDURES)


@cache
def tree_of(file: str) -> ast.Module:
    return ast.parse((ROOT / 'test' / file).read_text(encoding='utf-8'))


def functions_of(file: str) -> set[str]:
    return {node.name for node in tree_of(file).body if isinstance(node, ast.FunctionDef)}


def modules_of(file: str) -> set[str]:
    return {node.module or '' for node in tree_of(file).body if isinstance(node, ast.ImportFrom)}


@pytest.mark.parametrize('one', [*CLAIMS, *INDEX], ids=lambda one: one.test.split('::')[1][:60])
def test_the_test_that_is_named_exists(one: Claim | Implemented) -> None:
    file, name = one.test.split('::')
    assert name in functions_of(file)


def test_every_equation_of_the_paper_has_its_function() -> None:
    named = [name for one in EQUATIONS for name in one.names]
    assert len(named) == len(set(named))
    # Equations (1) to (31) and (A.1) to (A.8); (2), (8) and (9) have two parts each.
    assert set(named) == NUMBERS


@pytest.mark.parametrize('one', INDEX, ids=lambda one: one.names[0])
def test_a_function_of_the_index_exists_and_its_module_is_tested_where_it_says(
    one: Implemented,
) -> None:
    module, _, function = one.function.partition(':')
    found = getattr(import_module(module), function)
    assert inspect.isfunction(found)
    assert found.__module__ == module
    tested = modules_of(one.test.split('::')[0])
    # A method is recorded by its name, too.
    assert {module, 'pfd_core.algorithms.programs'} & tested


@pytest.mark.parametrize('one', EQUATIONS, ids=lambda one: one.names[0])
def test_the_module_of_an_equation_cites_it(one: Implemented) -> None:
    module = one.function.partition(':')[0]
    path = ROOT / (module.replace('.', '/') + '.py')
    source = {name for text in texts(path) for name in cited(text)}
    assert set(one.names) <= source


def test_every_procedure_that_the_paper_prints_is_in_the_index() -> None:
    # Algorithm and Procedure in its text, and what it calls by name.
    names = {name for one in PROCEDURES for name in one.names}
    assert names >= {
        'FOHRA',
        'FOIHRA',
        'Row-Sweeping',
        'Set-Ordering',
        'Parallel-Cholesky-Factorization',
        'NE1',
        'PCRBM',
        'PCGM',
    }


@cache
def pages() -> dict[str, str]:
    return {path.name: path.read_text() for path in PAGES.glob('claims.*')}


@pytest.mark.slow
def test_the_page_is_what_the_command_writes_now(tmp_path: Path) -> None:
    for page in write_claims(tmp_path):
        assert page.read_text() == pages()[page.name], 'run pfd report paper --out docs/report'


def test_the_page_counts_its_verdicts() -> None:
    rows = [line.split(' | ') for line in pages()['claims.md'].splitlines() if '::test_' in line]
    own = [row[2] for row in rows[: len(CLAIMS)]]
    kinds = {kind: own.count(kind) for kind in VERDICTS}
    stated = ', '.join(f'{count} {kind}' for kind, count in kinds.items())
    text = f'{len(own)} quantitative sentences of the paper: {stated}.'
    assert text in ' '.join(pages()['claims.md'].split())
    assert sum(kinds.values()) == len(CLAIMS)


def test_the_readme_and_the_guide_have_the_numbers_of_the_pages() -> None:
    readme, guide = (
        ' '.join((ROOT / name).read_text(encoding='utf-8').split())
        for name in ('README.md', 'docs/guides/paper.md')
    )
    data = json.loads(pages()['claims.json'])
    true = sum(one['verdict'] == 'true' for one in data)
    assert (
        f'{len(data)} quantitative sentences of the paper have a verdict: {true} true,' in readme
    )
    (fohra,) = (one['evidence'] for one in data if '27 L - 19' in one['sentence'])
    puma, skew = re.findall(r': (\d+ and \d+)', fohra)
    assert f"on a PUMA FOHRA takes the paper's {puma}, with skew axes {skew}" in guide
    rows = json.loads((PAGES / 'pcgm.json').read_text(encoding='utf-8'))['iterations']
    (median,) = (
        row['median']
        for row in rows
        if (row['n'], row['variant'], row['tolerance']) == (64, 'plain', 1e-6)
    )
    assert f'64 links need {median} in the median for an error of 1e-6' in guide


def test_a_verdict_follows_its_check() -> None:
    claims = [
        Claim('1', 'x', lambda result=result: (result, 'seen'), 'a::b', wrong_matrix=wrong)  # type: ignore[misc]
        for result, wrong in ((True, False), (True, True), (False, True), (None, False))
    ]
    assert tuple(one.verdict for one in verdicts(claims)) == VERDICTS
    assert {one.evidence for one in verdicts(claims)} == {'seen'}


def total(system: str, n: int) -> float:
    claims = TABLE[system].multiplications, TABLE[system].additions
    return float(sum(claim.formula(n) for claim in claims))


def test_the_verdict_on_methods_1_to_3_is_that_of_the_formulas() -> None:
    # By hand at n = 6: 3419 + 2502, 2309 + 1692 and 1627 + 1255, and 2805 + 2532.
    assert [total(f'walker_orin_{k}', 6) for k in (1, 2, 3, 4)] == [5921, 4001, 2882, 5337]
    assert all(total('walker_orin_1', n) > total('walker_orin_4', n) for n in range(2, 13))
    # With 117 n, which gives the printed 3435, method 1 is ahead up to 8 joints.
    more = [total('walker_orin_1', n) < total('walker_orin_4', n) + 105 * n for n in range(2, 13)]
    assert more == [n <= 8 for n in range(2, 13)]


def test_the_introduction_compares_a_factorisation_with_a_whole_method() -> None:
    assert [int(value('P6', n)) for n in (6, 12, 68, 69)] == [6, 24, 771, 794]
    assert [int(value('7 n + 9 h', n)) for n in (6, 12, 68, 69)] == [69, 138, 782, 789]


@pytest.mark.parametrize('n', [2, 4, 8])
def test_a_doubling_of_the_joints_adds_the_same_steps_to_newton_euler(n: int) -> None:
    # By hand: a level of FOHRA 27 and 18, five sums of vectors 15.
    one, two = (
        record_inverse_dynamics(resolve(uniform_chain(k)), 'unpacked').count() for k in (n, 2 * n)
    )
    more = two - one
    assert (more.multiplications, more.additions, more.divisions) == (27, 33, 0)


@pytest.mark.parametrize('n', [2, 3, 6])
def test_one_square_root_is_enough_only_for_the_wrong_matrix(n: int) -> None:
    plant = resolve(uniform_chain(n))
    roots = [
        program.count().square_roots
        for program in (
            record_pcrbm_1987(plant, 'parallel', misprints=AS_PRINTED),
            record_pcrbm_1987(plant, 'parallel'),
            FORWARD['pcrbm'](plant, 'parallel'),
        )
    ]
    assert roots == [1, n, 0]


@pytest.mark.parametrize('n', [2, 3, 6, 9])
def test_column_sweeps_take_what_the_paper_counts(n: int) -> None:
    steps = record_pcrbm_1987(resolve(uniform_chain(n)), 'parallel').count(section='column sweeps')
    # Two triangles: a division a column, and a product and a difference for all but the last.
    assert (steps.divisions, steps.multiplications, steps.additions) == (
        2 * n,
        2 * (n - 1),
        2 * (n - 1),
    )


def test_the_array_takes_a_time_in_proportion_to_n() -> None:
    def cycles(n: int) -> int:
        H = [[2.0 if i == j else 0.0 for j in range(n)] for i in range(n)]
        return solve(H, [1.0] * n).trace.cycles

    assert [cycles(n) for n in (2, 4, 8, 16)] == [8, 18, 38, 78]


@pytest.mark.parametrize('n', [2, 6, 24])
def test_pcrbm_takes_fewer_steps_than_pcgm_far_beyond_twelve_joints(n: int) -> None:
    plant = resolve(uniform_chain(n))
    direct = record_pcrbm_1987(plant, 'parallel').count()
    iterative = record_pcgm_1987(plant, 'parallel').count(iterations=n)
    assert direct.additions < iterative.additions
    own, other = (steps.multiplications + steps.divisions for steps in (direct, iterative))
    assert own < other
    for kind, last in (('multiplications', 238), ('additions', 296)):
        pcrbm, pcgm = (getattr(TABLE[name], kind).formula for name in ('pcrbm', 'pcgm'))
        # Up to this n by the paper's own formulas.
        assert pcrbm(last) < pcgm(last)
        assert pcrbm(last + 1) >= pcgm(last + 1)
