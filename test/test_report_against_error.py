# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Speed against error: every way has its points, lost answers are missing, and pages agree."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

import pfd_core as pfd
from pfd_core.report import against_error_pages
from pfd_core.report.against_error_pages import Findings, markdown, write
from pfd_core.report.cases.hard_cases import CASES, ROUNDING
from pfd_core.report.measure import evaluations, work_precision
from pfd_core.report.measure.errors import kernel_answer, peer_answers
from pfd_core.report.measure.evaluations import Plan, Point, TimedCase, measure
from pfd_core.report.measure.reference import errors, kappa_s, reference
from pfd_core.report.measure.timing import Pace
from pfd_core.report.measure.work_precision import MotionFacts, RunPoint
from pfd_core.report.render.records import read

REPORT = Path(__file__).resolve().parent.parent / 'docs' / 'report'
# The smallest case with a lost answer, which is that of composite bodies in float32.
NAME = 'collinear_axes_1e-12'
TINY = Plan(
    cases=(NAME,),
    methods=('articulated_body', 'composite_body', 'grouped_articulated_body', 'pcgm'),
    batches=(1, 16),
    pace=Pace(chunk=1e-5, turns=1, fewest=1),
    # Pinocchio's C++ takes half a minute to compile, and has tests of its own.
    peers=('Pinocchio', 'MuJoCo'),
)
PAGES = Findings(
    cases=[
        TimedCase(
            NAME, 'coaxial', 3, 1, 7e11, 2.0, 6e-41, 1e-41, 'composite_body', 'composite_body'
        )
    ],
    points=[
        Point(NAME, 'composite_body', 'float64', 0, 1, 5e-8, 6e-8, None, 6e-6, 2.5e10),
        Point(NAME, 'composite_body', 'float64', 1, 1, 6e-8, 7e-8, None, 3e-11, 150.0),
        Point(NAME, 'composite_body', 'float32', 0, 1, 4e-8, 4e-8, None, None, None),
        Point(NAME, 'Pinocchio aba', 'float64', 0, 1, 1e-6, 2e-6, None, 5e-16, 2.1),
        Point(NAME, 'composite_body', 'float64', 0, 64, 5e-9, 6e-9, None, 6e-6, 2.5e10),
        Point(NAME, 'composite_body', 'float64', 1, 64, 7e-9, 8e-9, 0.8, 3e-11, 150.0),
        Point(NAME, 'composite_body', 'float32', 0, 64, 2e-9, 2e-9, None, None, None),
        Point(NAME, 'Pinocchio aba', 'float64', 0, 64, 1e-6, 1e-6, None, 5e-16, 2.1),
    ],
    motions=[MotionFacts('swing', 'no damping', 2, 2.0, 3e-14)],
    runs=[
        RunPoint('swing', 'rk4', 1e-2, None, 'ok', 400.0, 2e-4, 3e-4, 4e-8, 5e-9),
        RunPoint('swing', 'rk4', 5e-2, None, 'not_finite'),
        RunPoint('swing', 'dop853', None, 1e-6, 'ok', 150.0, 4e-3, 5e-3, 6e-7, 7e-8),
    ],
    left_out=[
        f'MuJoCo at {place}: mujoco cannot be imported: install the extra `peers`'
        for place in ('swing', 'fall')
    ],
)


@pytest.fixture(scope='module')
def measured() -> tuple[TimedCase, list[Point]]:
    facts, found, _ = measure(NAME, TINY)
    return facts, found


@pytest.fixture(scope='module')
def points(measured: tuple[TimedCase, list[Point]]) -> list[Point]:
    return measured[1]


def test_the_report_has_every_method_and_cases_of_the_table() -> None:
    assert Plan().methods == pfd.METHODS
    assert set(Plan().cases) <= {case.name for case in CASES}
    assert Plan().batches == (1, 4096)


@pytest.mark.slow
def test_every_method_format_and_refinement_has_a_point_for_every_batch(
    measured: tuple[TimedCase, list[Point]],
) -> None:
    facts, points = measured
    ours = [(p.way, p.dtype, p.refine, p.batch) for p in points if p.way in TINY.methods]
    assert sorted(ours) == sorted(
        (method, dtype, refine, batch)
        for method in TINY.methods
        for dtype in ROUNDING
        for refine in (0, 1)
        for batch in TINY.batches
    )
    for point in points:
        assert 0 < point.minimum <= point.median
        assert (point.error is None) == (point.in_units is None)
        # Compared with the default kernel.
        if (point.way, point.dtype, point.refine) == (facts.auto, 'float64', facts.steps):
            assert point.times == 1.0
        assert point.times > 0


@pytest.mark.slow
def test_errors_are_those_of_the_kernels_in_units_of_kappa_s_u(points: list[Point]) -> None:
    (case,) = (case for case in CASES if case.name == NAME)
    problem = case.make()
    known = reference(problem)
    (condition,) = kappa_s(problem, known)
    for point in points:
        if point.way not in TINY.methods:
            continue
        # The emulator gives the bits of the kernel.
        qdd = kernel_answer(problem, point.dtype, point.refine, point.way)
        (wanted,) = errors(qdd, known)
        assert point.error == (wanted if np.isfinite(wanted) else None)
        if point.error is not None:
            units = wanted / condition / ROUNDING[point.dtype]
            assert point.in_units == pytest.approx(units)


@pytest.mark.slow
def test_an_answer_that_is_lost_has_no_error(points: list[Point]) -> None:
    lost = {(p.way, p.dtype, p.refine) for p in points if p.error is None}
    # Conjugate gradients do not converge there in single precision.
    assert lost == {
        (method, 'float32', refine) for method in ('composite_body', 'pcgm') for refine in (0, 1)
    }


@pytest.mark.slow
def test_pinocchio_is_there_in_both_conventions_and_by_crba(points: list[Point]) -> None:
    (case,) = (case for case in CASES if case.name == NAME)
    answers = dict(peer_answers(case.make()))
    found = [(p.way, p.batch) for p in points if p.way not in TINY.methods]
    # In a batch MuJoCo warns of a bad acceleration, and restarts: that is no answer.
    assert found == [
        (way, batch)
        for batch in TINY.batches
        for way in answers
        if (way, batch) != ('MuJoCo', TINY.batches[-1])
    ]
    assert {'Pinocchio aba', 'Pinocchio aba, WORLD', 'Pinocchio crba'} <= set(answers)


def test_pinocchios_batch_is_that_of_its_world_axes() -> None:
    # The error of a batch is taken from aba in WORLD axes.
    pin = pytest.importorskip('pinocchio')
    peer = evaluations.Pinocchio(pfd.load_robot('ur5'))
    states = list(np.random.default_rng(5).uniform(-1, 1, (3, 8, 6)))
    side = evaluations._pinocchio_side(peer, 'pinocchio.aba WORLD', states)
    side.run()
    one_by_one = [
        pin.aba(peer.model, peer.data, *state, pin.Convention.WORLD).copy()
        for state in zip(*states, strict=True)
    ]
    np.testing.assert_array_equal(side.result(), one_by_one)


@pytest.mark.slow
def test_what_takes_minutes_or_is_absent_is_left_out_with_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ('mujoco', 'pinocchio'):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setattr(evaluations, 'methods', lambda n: TINY.methods[:2])
    _, points, left_out = measure(NAME, TINY)
    assert {point.way for point in points} == set(TINY.methods[:2])
    assert [text.split(':')[0] for text in left_out] == [
        f'{way} at {NAME}' for way in ('grouped_articulated_body', 'pcgm', 'Pinocchio', 'MuJoCo')
    ]


def test_a_case_with_a_scene_of_its_own_is_refused() -> None:
    with pytest.raises(ValueError, match='geared_rotors_1e6 has a scene'):
        measure('geared_rotors_1e6', TINY)


def test_the_page_has_every_point_and_says_what_is_missing() -> None:
    page = markdown(PAGES)
    row = '| composite_body (auto) | float64 | 1 | 60 / 70 | 7 / 8 | 3e-11 (150) |'
    assert row in page
    assert '| composite_body (auto) | float32 | 0 | 40 / 40 | 2 / 2 | lost |' in page
    row = '7e+11 | 2.0e+00 | 5, 6e-06 | 7, 3e-11 | - | 1000, 5e-16 | - | - | not installed |'
    assert len(evaluations.PEERS) == 8
    assert f'| {NAME} | {row}' in page
    assert 'since the answer is lost: composite_body float32.' in page
    assert '| rk4 | 10 ms | 0.2 / 0.3 | 400 | 4e-08 | 5e-09 |' in page
    assert '| rk4 | 50 ms | missing | - | - | - |' in page
    assert '- rk4, 50 ms: not_finite' in page
    assert '| dop853 | rtol 1e-06 | 4 / 5 | 150 | 6e-07 | 7e-08 |' in page
    assert 'self-difference of the reference 3e-14 rad' in page
    assert '- MuJoCo at swing, fall: mujoco cannot be imported: install the extra' in page
    # Medians over minima: 1 three times, 8/7, 7/6, 6/5 twice, 5/4, 3/2 and 2.
    assert 'at least 1.20 times their\nminimum, one in ten at least 2.00 times' in page


@pytest.mark.slow
def test_the_json_has_every_number_and_the_plots_are_written(tmp_path: Path) -> None:
    paths = write(PAGES, tmp_path)
    names = ['speed-against-error-single', 'speed-against-error', 'work-precision']
    assert [path.name for path in paths] == [
        'speed-against-error.md',
        'speed-against-error.json',
        *(f'{name}.{suffix}' for name in names for suffix in ('png', 'svg')),
    ]
    found = read(Findings, paths[1])
    assert found == PAGES
    assert markdown(found) == paths[0].read_text()
    for path in paths[3::2]:
        text = ''.join(ElementTree.parse(path).getroot().itertext())
        assert ('per simulated second' if 'work' in path.name else 'one evaluation [ns]') in text


def test_a_step_of_refinement_costs_time_also_where_the_default_has_one() -> None:
    text = (REPORT / 'speed-against-error.md').read_text(encoding='utf-8')
    titles, _, *rows = (
        line.split(' | ')
        for line in text.split('### One step of refinement')[1].split('##')[0].splitlines()
        if line.startswith('|')
    )
    costs = {row[0]: float(row[titles.index('cost of refinement')]) for row in rows}
    assert min(costs.values()) > 1, costs


def test_the_report_in_the_documentation_has_every_case_method_and_integrator() -> None:
    found = read(Findings, REPORT / 'speed-against-error.json')
    page = (REPORT / 'speed-against-error.md').read_text()
    assert tuple(case.name for case in found.cases) == Plan().cases
    left_out = '\n'.join(found.left_out)
    for case in found.cases:
        assert f'### {case.name}\n' in page
        ways = {point.way for point in found.points if point.case == case.name}
        assert all(way in ways or f'{way} at {case.name}' in left_out for way in pfd.METHODS)
        assert {'Pinocchio aba', 'Pinocchio aba, WORLD', 'Pinocchio crba'} <= ways
    for motion in found.motions:
        ways = {run.way for run in found.runs if run.motion == motion.name}
        assert set(ways) >= {*work_precision.TABLE, work_precision.ADAPTIVE}


@pytest.mark.slow
def test_the_same_numbers_give_the_same_picture(tmp_path: Path) -> None:
    runs = replace(PAGES, cases=[], points=[])
    first, second = (write(runs, tmp_path / name) for name in ('one', 'two'))
    assert len(first) == 4
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes(), one.name


def test_the_plots_are_left_out_without_matplotlib(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ('matplotlib', 'matplotlib.figure'):
        monkeypatch.setitem(sys.modules, name, None)
    assert [path.suffix for path in write(PAGES, tmp_path)] == ['.md', '.json']


@pytest.mark.parametrize('quick', [True, False])
def test_quick_takes_the_quick_plans(
    quick: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    monkeypatch.setattr(against_error_pages, 'survey', lambda *plans: asked.append(plans) or PAGES)
    monkeypatch.setattr(
        against_error_pages, 'write', lambda findings, folder: [folder / 'page.md']
    )
    assert against_error_pages.run(tmp_path, quick=quick) == [tmp_path / 'page.md']
    assert asked == [
        (evaluations.QUICK, work_precision.QUICK, against_error_pages.QUICK_QUANTITIES)
        if quick
        else (Plan(), work_precision.Plan(), against_error_pages.QUANTITIES)
    ]


def test_kernels_compiled_by_other_processes_are_not_compiled_again(
    folder: Path, emitted: list[str]
) -> None:
    plan = replace(TINY, methods=('composite_body', 'articulated_body'), peers=())
    evaluations.compile_all(plan)
    assert list(folder.iterdir())
    before = len(emitted)
    evaluations.measure(plan.cases[0], plan)
    assert len(emitted) == before


def test_a_survey_gathers_cases_and_motions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluations, 'compile_all', lambda plan: None)
    monkeypatch.setattr(
        evaluations, 'measure', lambda name, plan: (PAGES.cases[0], PAGES.points, [name])
    )
    monkeypatch.setattr(
        work_precision, 'measure', lambda motion, plan: (PAGES.motions[0], PAGES.runs, [motion])
    )
    plan = replace(work_precision.QUICK, motions=('swing',))
    found = against_error_pages.survey(replace(TINY, cases=('one', 'two')), plan)
    assert found.points == 2 * PAGES.points
    assert found.runs == PAGES.runs
    assert found.left_out == ['one', 'two', 'swing']


def test_the_page_in_docs_is_made_of_the_numbers_next_to_it() -> None:
    found = read(Findings, REPORT / 'speed-against-error.json')
    assert markdown(found) == (REPORT / 'speed-against-error.md').read_text(encoding='utf-8')
