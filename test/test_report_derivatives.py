# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Derivatives and linearised steps at the hard cases: reference, bounds, peers and the page."""

from __future__ import annotations

from dataclasses import replace
import json
from pathlib import Path

import mpmath
import numpy as np
import pytest
from tolerances import NOT_ORTHOGONAL, ROUNDED_FRAMES

import pfd_core as pfd
from pfd_core.model import Robot, resolve
from pfd_core.report import derivative_pages
from pfd_core.report.cases.hard_cases import CASES, ROUNDING, Case
from pfd_core.report.cases.problems import Problem, drawing, scene_of
from pfd_core.report.derivative_pages import TITLES, markdown, write
from pfd_core.report.measure import predictions
from pfd_core.report.measure.derivative_errors import (
    HELD_OUT,
    KERNELS,
    PEER,
    Matrices,
    Result,
    Row,
    measure,
    measured,
    our_rows,
    solved,
)
from pfd_core.report.measure.derivative_reference import (
    DERIVATIVES,
    errors,
    exact,
    in_positions,
    step_length,
)
from pfd_core.report.measure.reference import reference
from pfd_core.report.render.numbers import order
from pfd_core.report.render.records import record_of

ROOT = Path(__file__).resolve().parent.parent
PAGES = ROOT / 'docs' / 'report'
BY_NAME = {case.name: case for case in CASES}
LONG = [pytest.mark.slow, pytest.mark.long]
# A difference over 1e-40 in 130 digits keeps 50 digits and more.
FIFTY = 1e-50
# Condition numbers up to 1e13, third derivatives at scales down to 1e-9, of 80 digits.
CERTIFICATE = 1e-35
# kappa_s is a difference quotient over 2^-40.
QUOTIENT = 1e-6

# Errors of the default above twice the peer's and 4 u: at the page's states, at held-out states.
WORSE: list[set[tuple[str, str]]] = [{('collinear_axes_1e-4', 'qd')}, set()]


def wheel(mass: float = 1.0, distance: float = 0.0) -> Robot:
    """Return a wheel about a horizontal axis; its centre of mass lies off the axis [m]."""
    return Robot(
        name='wheel',
        joint_names=('joint',),
        joint_types=('continuous',),
        rotations=np.eye(3)[None],
        translations=np.zeros((1, 3)),
        masses=np.array([mass]),
        centers=np.array([[distance, 0.0, 0.0]]),
        inertias=2 * np.eye(3)[None],
        base_rotation=np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    )


def of_wheel(robot: Robot, scene: pfd.Scene) -> Problem:
    states = {'q': np.array([[0.5]]), 'qd': np.array([[2.0]]), 'tau': np.array([[3.0]])}
    return Problem(resolve(robot, scene), states)


def test_the_reference_of_a_pendulum_is_its_closed_form_in_50_digits() -> None:
    mass, distance, gravity = 1.5, 0.25, 8.0
    problem = of_wheel(wheel(mass, distance), pfd.Scene(gravity=(0.0, 0.0, -gravity)))
    found = exact(problem, reference(problem, False), None)
    J = mpmath.mpf(2 + mass * distance**2)
    with mpmath.workdps(60):
        slope = mass * gravity * distance * mpmath.sin(mpmath.mpf('0.5')) / J
        assert abs(found.matrices['q'][0, 0, 0] - slope) < FIFTY
        assert abs(found.matrices['tau'][0, 0, 0] - 1 / J) < FIFTY
    assert found.matrices['qd'][0, 0, 0] == 0
    assert found.residual < FIFTY
    assert found.difference < FIFTY
    # Inverse dynamics of one joint does not couple position and acceleration.
    assert found.gain[0] == 0


def test_the_step_of_a_wheel_is_its_closed_form_and_its_condition_that_of_its_inertia() -> None:
    problem = of_wheel(wheel(), pfd.Scene(gravity=None))
    h = 2.0**-7
    known = reference(problem, False)
    found = exact(problem, known, h)
    np.testing.assert_allclose(found.matrices['A'][0].astype(float), [[1, 1], [0, 1]])
    with mpmath.workdps(60):
        for row, part in zip(found.matrices['B'][0], (0.5, 1.0), strict=True):
            assert abs(row[0] - part * mpmath.mpf(h) ** 2 / 2) < FIFTY
    assert found.share[0] < FIFTY
    # 1 / J changes as much as J does.
    assert found.kappa_s['tau'] == pytest.approx(1.0, rel=QUOTIENT)
    assert found.kappa_s['B'] == pytest.approx(1.0, rel=QUOTIENT)


@pytest.mark.parametrize(
    'name',
    [
        pytest.param(case.name, marks=[] if case.name == 'ordinary_planar2' else LONG)
        for case in CASES
        if measured(case)
    ],
)
def test_inverse_dynamics_and_the_rules_of_operations_certify_the_differences(name: str) -> None:
    some = first(BY_NAME[name])
    known = reference(some, False)
    found = exact(some, known, step_length(known, some.states))
    assert found.residual < (ROUNDED_FRAMES if name in NOT_ORTHOGONAL else CERTIFICATE)
    assert found.difference < CERTIFICATE


def first(case: Case) -> Problem:
    problem = case.make()
    return replace(problem, states={name: x[:1] for name, x in problem.states.items()})


def held_out(case: Case) -> Problem:
    with drawing(HELD_OUT, 1):
        return case.make()


def test_derivatives_at_held_out_states_keep_five_times_their_predicted_error() -> None:
    problem = held_out(BY_NAME['collinear_axes_1e-12'])
    known = solved(problem, reference(problem, False), None)
    rows = [
        row
        for dtype, refine in KERNELS
        for row in our_rows(known, Matrices(problem, dtype, refine, None))
    ]
    assert [row.matrix for row in rows] == list(DERIVATIVES) * len(KERNELS)
    assert not [row for row in rows if row.met is False]
    # With kappa_J 7e11 single precision has no bound, nor has d qdd / d q with its gain of 6e10.
    unbounded = {(row.dtype, row.matrix) for row in rows if row.predicted is None}
    assert unbounded == {('float64', 'q'), *(('float32', name) for name in DERIVATIVES)}


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize('name', [case.name for case in CASES if measured(case)])
def test_the_page_is_not_stale_and_no_row_misses_its_bound(name: str) -> None:
    found = measure(BY_NAME[name])
    assert not [row for row in (*found.rows, *found.held_out) if row.met is False]
    wanted = (PAGES / 'derivatives.md').read_text(encoding='utf-8').splitlines()
    lines = [line for line in markdown([found]).splitlines() if line.startswith(f'| {name} |')]
    # Of the table of cases, and of each matrix.
    assert len(lines) == 1 + len(found.kappa_s)
    assert not set(lines) - set(wanted)


def test_emulated_derivatives_have_the_bits_of_the_compiled_kernel() -> None:
    problem = BY_NAME['collinear_axes_1e-12'].make()
    plant = problem.plant
    for dtype in ROUNDING:
        kernel = pfd.compile_kernel(
            plant.robot, scene=scene_of(plant), quantity='derivatives', dtype=dtype
        )
        states = {name: x.astype(dtype) for name, x in problem.states.items()}
        found = Matrices(problem, dtype, 0, None).of(states)
        whole = np.concatenate([found[name] for name in DERIVATIVES], axis=-1)
        np.testing.assert_array_equal(whole, kernel(**states))


def test_velocities_of_a_step_are_multiplied_by_its_length() -> None:
    h, n = 2.0**-9, 2
    S = np.arange(1.0, 2 * n * 3 * n + 1).reshape(2 * n, 3 * n)
    scale = np.diag([1, 1, h, h])
    wanted = np.hstack([scale @ S[:, : 2 * n] @ np.linalg.inv(scale), scale @ S[:, 2 * n :]])
    np.testing.assert_array_equal(in_positions(S, h), wanted)


def test_in_a_step_no_joint_moves_or_accelerates_further_than_its_limit() -> None:
    for name in ('ordinary_planar2', 'fast_qd_1e6', 'tiny_tip_1e-18'):
        some = first(BY_NAME[name])
        known = reference(some, False)
        h = step_length(known, some.states)
        assert np.log2(h) == round(np.log2(h))
        moves = max(h * np.abs(some.states['qd']).max(), h**2 * float(np.abs(known.qdd).max()))
        assert moves <= 2.0**-7
        assert h == 2.0**-7 or moves > 2.0**-10


def test_a_matrix_that_is_not_finite_has_an_infinite_error_and_a_zero_one_an_absolute() -> None:
    known = np.array([np.eye(2), np.eye(2), np.zeros((2, 2))]).astype(object)
    found = np.array([1.25 * np.eye(2), np.full((2, 2), np.nan), [[0, 3], [4, 0]]])
    assert errors(found, known).tolist() == [0.25, np.inf, 5.0]


def test_an_arm_with_other_effects_has_no_scene_of_its_plant() -> None:
    robot = pfd.load_robot('planar2')
    scene = pfd.Scene(gravity=(1.0, 2.0, 3.0), armature=(0.5, 0.25), external_wrench=True)
    plant = resolve(robot, scene)
    assert resolve(robot, scene_of(plant)).digest == plant.digest
    with pytest.raises(ValueError, match='effects other than'):
        scene_of(resolve(robot, pfd.Scene(damping=(1.0, 1.0))))


def test_a_predicted_error_of_a_matrix_follows_the_formula() -> None:
    u, one = 2.0**-24, np.ones(1)
    # 862 operations for 16 numbers, each of a root mean square of 0.4247 u.
    assert pytest.approx(0.4247 * np.sqrt(862 / 16), rel=1e-3) == predictions.DERIVED
    found = predictions.predicted_matrix(
        'float32', 2 * one, 1e3 * one, 0.5 * one, 4 * one, 1e-5 * one
    )
    wanted = u * (1 + 2 * predictions.DERIVED) + 0.5 * (1e3 * predictions.DERIVED * u + 4e-5)
    assert found == pytest.approx(wanted)


def read() -> list[Result]:
    content = json.loads((PAGES / 'derivatives.json').read_text(encoding='utf-8'))
    # Infinite errors are null in the JSON.
    found: list[Result] = record_of(list[Result], content['cases'], np.inf)
    return found


def test_the_page_is_that_of_the_data() -> None:
    found = read()
    assert [one.name for one in found] == [case.name for case in CASES if measured(case)]
    assert (PAGES / 'derivatives.md').read_text(encoding='utf-8') == markdown(found)


def test_no_bound_is_missed_on_the_page() -> None:
    rows = [row for one in read() for row in (*one.rows, *one.held_out)]
    assert len([row for row in rows if row.met]) > 1400
    assert not [row for row in rows if row.met is False]


def worse(name: str, rows: tuple[Row, ...]) -> set[tuple[str, str]]:
    """Return case and matrix of each error of the default that the peer halves, above 4 u."""
    default = {r.matrix: r for r in rows if (r.way, r.dtype, r.refine) == ('pfd', 'float64', 0)}
    return {
        (name, peer.matrix)
        for peer in rows
        if peer.way == PEER
        and default[peer.matrix].error > max(2 * peer.error, 4 * ROUNDING['float64'])
    }


def test_the_default_is_worse_than_its_peer_only_where_the_page_says_so() -> None:
    text = (PAGES / 'derivatives.md').read_text(encoding='utf-8')
    found: list[set[tuple[str, str]]] = [set(), set()]
    for one in read():
        for some, rows in zip(found, (one.rows, one.held_out), strict=True):
            some |= worse(one.name, rows)
    assert found == WORSE
    for name, matrix in set().union(*found):
        assert f'- {name}, {TITLES[matrix]}: ' in text


def test_a_missed_bound_and_a_lost_matrix_are_on_the_page(tmp_path: Path) -> None:
    good = Row('q', 'pfd', 'float64', 0, 1e-15, 3.0, 2e-15, 0.1, True)
    unbounded = replace(good, predicted=None, share=None, met=None)
    rows = (
        good,
        replace(good, refine=1),
        replace(good, dtype='float32', error=1e-3, share=7.0, met=False),
        replace(unbounded, dtype='float32', refine=1, error=np.inf),
        replace(unbounded, way=PEER, error=4e-16),
    )
    one = Result('arm', 2, 2.0**-7, 1.0, 0.0, 0.0, {'q': 1.0}, 0.0, np.nan, rows)
    page, data, *plots = write([one], tmp_path)
    text = page.read_text(encoding='utf-8')
    assert '- arm, d qdd / d q, float32: 1e-03, 7 times its bound' in text
    assert '- arm, float32: d qdd / d q; errors up to lost' in text
    assert f'- arm, d qdd / d q: {1e-15 * 2**53:.3g} u, Pinocchio {4e-16 * 2**53:.3g} u' in text
    assert '2 of 3 errors meet it' in ' '.join(text.split())
    assert json.loads(data.read_text())['cases'][0]['rows'][3]['error'] is None
    assert [path.suffix for path in plots] == ['.png', '.svg']
    assert order(np.inf) == 'lost'


def test_the_command_writes_the_page_and_its_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = Result('arm', 2, 2.0**-7, 1.0, 0.0, 0.0, {}, 0.0, np.nan, ())
    monkeypatch.setattr(derivative_pages, 'measure', lambda case: replace(one, name=case.name))
    # Without plots, and without processes, whose start takes seconds.
    monkeypatch.setattr(derivative_pages, 'save', lambda draw, *place: [])
    monkeypatch.setattr(derivative_pages, 'each', lambda measure, items, *_: map(measure, items))
    paths = derivative_pages.run(tmp_path)
    assert [path.name for path in paths[:2]] == ['derivatives.md', 'derivatives.json']
    assert all(path.is_file() for path in paths)
    names = [case['name'] for case in json.loads(paths[1].read_text())['cases']]
    assert names == [case.name for case in CASES if measured(case)]
