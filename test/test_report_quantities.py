# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Speed and error of quantities other than forward dynamics: equal work, and their pages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import json
from pathlib import Path
import shutil
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pinocchio as pin
import pytest
from sampling import one_fast
import tolerances
import zoo

import pfd_core as pfd
from pfd_core.report import against_error_pages, quantity_pages, speed_pages, time_tables
from pfd_core.report.cases import quantities
from pfd_core.report.cases.quantities import FORWARD, QUANTITIES
from pfd_core.report.cases.robots import robot
from pfd_core.report.contenders import casadi, native, pinocchio
from pfd_core.report.contenders.ours import make_quantity
from pfd_core.report.contenders.work import LeftOutError, Side, work_of
from pfd_core.report.measure import evaluations, port_limit, quantity_rows, speed, work_precision
from pfd_core.report.measure.differences import largest_difference
from pfd_core.report.measure.quantity_reference import exact
from pfd_core.report.measure.timing import Pace, Row

# Derivatives multiply with H^-1: the rounding of accelerations, in both programs.
DERIVATIVES = 1e-9
# Shares of the largest entry that a few thousand roundings of a number format may take.
OURS = {'float64': tolerances.DYNAMICS, 'float32': tolerances.SINGLE}
TINY = quantity_rows.Plan(
    robots=('planar2',),
    quantities=('gravity_torques', 'derivatives', 'linear_step'),
    batches=(64,),
    references=2,
    pace=Pace(chunk=1e-5, turns=1, fewest=1),
)
COUNT = 3
WITH_COMPILER = pytest.mark.skipif(
    shutil.which(native.C.compiler) is None, reason='needs a C compiler'
)


def row(quantity: str, work: str, way: str, seconds: float, **more: float | None) -> Row:
    return Row('ur5', 6, work, way, seconds, 2 * seconds, quantity=quantity, **more)


ROWS = [
    row('derivatives', 'call', 'pinocchio.computeABADerivatives', 5e-6, times=1.0, error=2e-13),
    row('derivatives', 'call', 'CasADi C, buffer()', 1e-6, times=5.0, error=3e-16),
    row('derivatives', 'call', 'pfd float64: kernel(..., out=)', 8e-7, times=6.0, error=1e-16),
    row('derivatives', 'call', 'pfd float64: bound', 2e-7, times=25.0, error=1e-16),
    row('derivatives', 'batch of 4096', 'Python loop over pinocchio.computeABADerivatives', 5e-6,
        times=1.0, error=7e-13),
    row('derivatives', 'batch of 4096', 'CasADi C, loop in C', 9e-7, times=6.0, error=4e-16),
    row('derivatives', 'batch of 4096', 'pfd float64, F order', 1e-7, times=48.0, error=6e-17),
    row('derivatives', 'batch of 4096', 'pfd float64, C order', 1.1e-7, times=45.0, error=6e-17),
    row('derivatives', port_limit.WORK, 'pfd float64', 6e-8, times=0.55),
]  # fmt: skip
LEFT_OUT = ['CasADi C, linear_step at ur5: it is absent']


@pytest.fixture(scope='module')
def arm() -> pfd.Robot:
    """Return joints of all kinds on odd axes, on a base that is turned."""
    return pfd.load_robot(zoo.ODD_ARM, tip='tool')


@pytest.fixture(scope='module')
def measured() -> tuple[list[Row], list[str]]:
    return quantity_rows.measure(TINY)


def by_pinocchio(arm: pfd.Robot) -> dict[str, Callable[..., np.ndarray]]:
    """Return Pinocchio's quantities as functions of q, qd, qdd and tau, of a model of its own."""
    model = zoo.to_pinocchio(arm)
    data, tip, axes = model.createData(), model.nframes - 1, pin.LOCAL_WORLD_ALIGNED

    def symmetric(upper: np.ndarray) -> np.ndarray:
        return np.triu(upper) + np.triu(upper, 1).T

    def pose(q: np.ndarray) -> np.ndarray:
        pin.framesForwardKinematics(model, data, q)
        return data.oMf[tip].homogeneous

    def derivatives(q: np.ndarray, qd: np.ndarray, tau: np.ndarray) -> np.ndarray:
        by_q, by_qd, by_tau = pin.computeABADerivatives(model, data, q, qd, tau)
        return np.hstack([by_q, by_qd, symmetric(by_tau)])

    return {
        'inverse_dynamics': lambda q, qd, qdd, tau: pin.rnea(model, data, q, qd, qdd),
        'inertia_matrix': lambda q, qd, qdd, tau: symmetric(pin.crba(model, data, q)),
        'bias_torques': lambda q, qd, qdd, tau: pin.nonLinearEffects(model, data, q, qd),
        'gravity_torques': lambda q, qd, qdd, tau: pin.computeGeneralizedGravity(model, data, q),
        'tip_pose': lambda q, qd, qdd, tau: pose(q),
        'tip_jacobian': lambda q, qd, qdd, tau: pin.computeFrameJacobian(
            model, data, q, tip, axes
        ),
        'derivatives': lambda q, qd, qdd, tau: derivatives(q, qd, tau),
    }


def sides_agree(sides: list[Side], wanted: np.ndarray, tolerance: float) -> None:
    assert sides
    for side in sides:
        side.run()
        found = np.atleast_2d(side.result())
        error = np.abs(found - wanted[: len(found)]).max(axis=-1)
        assert (error < tolerance * np.abs(wanted[: len(found)]).max(axis=-1)).all(), side.way


def all_sides(contender: object, quantity: str, states: dict[str, np.ndarray]) -> list[Side]:
    works = (work_of(kind, quantity, states) for kind in ('call', 'batch'))
    return [side for work in works for side in contender.sides(work)]


@pytest.mark.parametrize('quantity', [name for name in QUANTITIES if name != 'linear_step'])
@pytest.mark.slow
def test_all_ways_and_the_reference_of_a_quantity_are_pinocchios(
    quantity: str, arm: pfd.Robot
) -> None:
    states = quantities.random_states(arm, COUNT)
    known = by_pinocchio(arm)[quantity]
    wanted = np.array([np.ravel(known(*x)) for x in zip(*states.values(), strict=True)])
    tolerance = DERIVATIVES if quantity == 'derivatives' else tolerances.DYNAMICS
    digits = exact(quantity, arm, states)
    assert largest_difference(wanted, digits) < tolerance
    peer = pinocchio.PinocchioQuantity(arm, quantity)
    sides_agree(all_sides(peer, quantity, states), wanted, tolerance)
    for dtype in ('float64', 'float32'):
        own = make_quantity(quantity, dtype, 0, arm)
        unit = OURS[dtype] / tolerances.DYNAMICS
        sides_agree(all_sides(own, quantity, states), wanted, tolerance * unit)


@WITH_COMPILER
@pytest.mark.parametrize(
    'quantity', one_fast(name for name in casadi.ALGORITHMS if name != FORWARD)
)
def test_casadis_c_gives_pinocchios_quantity(quantity: str, arm: pfd.Robot) -> None:
    pytest.importorskip('casadi')
    if quantity == 'derivatives':
        arm = robot('chain3')  # Its C is compiled in a second.
    states = quantities.random_states(arm, COUNT)
    peer = casadi.Casadi(arm, quantity)
    known = by_pinocchio(arm)[quantity]
    wanted = np.array([np.ravel(known(*x)) for x in zip(*states.values(), strict=True)])
    tolerance = DERIVATIVES if quantity == 'derivatives' else tolerances.DYNAMICS
    sides_agree(all_sides(peer, quantity, states), wanted, tolerance)


def test_the_chained_stages_are_the_series_of_a_linear_motion() -> None:
    rng = np.random.default_rng(4)
    J, h = rng.uniform(-1, 1, (2, 6)), 0.3
    q, qd, tau = rng.uniform(-1, 1, (3, 2))
    found = quantities.linear_rk4(lambda *x: (J @ np.concatenate(x), J), q, qd, tau, h)
    # Of x' = M x + N tau, classical Runge-Kutta has four terms of the exponential series.
    M = np.vstack([np.hstack([np.zeros((2, 2)), np.eye(2)]), J[:, :4]])
    N = np.vstack([np.zeros((2, 2)), J[:, 4:]])
    powers = [np.linalg.matrix_power(h * M, k) for k in range(5)]
    A = sum(power / factor for power, factor in zip(powers, (1, 1, 2, 6, 24), strict=True))
    terms = zip(powers, (1, 2, 6, 24), strict=False)
    B = h * sum(power / factor for power, factor in terms) @ N
    np.testing.assert_allclose(found, np.hstack([A, B]), rtol=0, atol=1e-14)


@pytest.mark.slow
def test_linear_steps_of_all_ways_are_differences_of_simulated_steps(arm: pfd.Robot) -> None:
    states = quantities.random_states(arm, 1)
    sim = pfd.Simulator(arm, step_size=quantities.LINEAR_STEP, substeps=1, integrator='rk4')

    def end(x: np.ndarray) -> np.ndarray:
        sim.reset(x[: arm.n], x[arm.n : 2 * arm.n])
        sim.step(x[2 * arm.n :])
        return np.concatenate([sim.q, sim.qd])

    small = 2.0**-17  # Rounding and the third derivative are of the same size here.
    wanted = []
    for x in np.hstack([states[name] for name in ('q', 'qd', 'tau')]):
        columns = [end(x + small * unit) - end(x - small * unit) for unit in np.eye(len(x))]
        wanted.append((np.array(columns).T / (2 * small)).ravel())
    digits = exact('linear_step', arm, states)
    assert largest_difference(np.array(wanted), digits) < 1e-8
    rounded = digits.astype(float)
    peer = pinocchio.PinocchioQuantity(arm, 'linear_step')
    sides_agree(all_sides(peer, 'linear_step', states), rounded, tolerances.DYNAMICS)
    for dtype, tolerance in OURS.items():
        own = make_quantity('linear_step', dtype, 0, arm)
        sides_agree(all_sides(own, 'linear_step', states), rounded, tolerance)


def test_an_error_is_that_of_the_largest_entry_of_the_worst_state() -> None:
    wanted = np.array([[1.0, -4.0], [2.0, 0.5]], dtype=object)
    found = np.array([[1.5, -4.0], [2.0, 0.75]])
    assert largest_difference(found, wanted) == 0.125


@pytest.mark.slow
def test_every_quantity_has_a_row_for_every_way_and_size(
    measured: tuple[list[Row], list[str]],
) -> None:
    rows, left_out = measured
    for quantity in TINY.quantities:
        solves = quantity != 'gravity_torques'
        ours = [f'pfd {d}{r}' for d in OURS for r in ('', ' refined')[: 1 + solves]]
        for work in ('call', 'batch of 64'):
            ways = {
                time_tables.contender(row)
                for row in rows
                if (row.quantity, row.work) == (quantity, work)
            }
            assert ways - {'CasADi C'} == {*ours, pinocchio.PINOCCHIO[quantity].name}
        limits = [r.way for r in rows if (r.quantity, r.work) == (quantity, port_limit.WORK)]
        assert limits == (ours if quantity != 'linear_step' else [])
    assert (
        'port limit of pfd float64, linear_step at planar2: its operations are in called functions'
        in '\n'.join(left_out)
    )


@pytest.mark.slow
def test_rows_have_times_ratios_and_errors(measured: tuple[list[Row], list[str]]) -> None:
    for row in (row for row in measured[0] if row.work != port_limit.WORK):
        assert 0 < row.minimum <= row.median
        assert row.times is not None
        assert row.error < OURS['float32' if 'float32' in row.way else 'float64'], row
        assert row.difference < OURS['float32' if 'float32' in row.way else 'float64'], row


def test_without_references_there_are_no_errors_and_no_refinement() -> None:
    plan = replace(TINY, quantities=('derivatives',), dtypes=('float64',), references=0)
    rows, _ = quantity_rows.measure(plan)
    assert rows
    assert all(row.error is None and 'refined' not in row.way for row in rows)


def test_absent_peers_are_left_out_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ('casadi', 'pinocchio'):
        monkeypatch.setitem(sys.modules, name, None)
    plan = replace(TINY, quantities=('gravity_torques',), dtypes=('float64',), references=0)
    rows, left_out = quantity_rows.measure(plan)
    assert all(row.times is None for row in rows if row.work != port_limit.WORK)
    assert [text.split(':')[0] for text in left_out] == [
        f'{peer}, gravity_torques at planar2' for peer in ('Pinocchio', 'CasADi C')
    ]
    assert all('install the extra `peers`' in text for text in left_out)


def test_what_would_be_too_large_is_not_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(LeftOutError, match='12 joints'):
        make_quantity('linear_step', 'float64', 0, robot('chain13'))
    monkeypatch.setattr(quantity_rows, 'MOST_NUMBERS', 10)
    plan = replace(TINY, quantities=('gravity_torques',), batches=(5, 6), dtypes=('float64',))
    rows, _ = quantity_rows.measure(replace(plan, peers=()))
    # Two numbers a state.
    assert {row.work for row in rows} == {'call', 'batch of 5', port_limit.WORK}


def test_a_long_text_of_casadi_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip('casadi')
    monkeypatch.setattr(casadi, 'MOST_INSTRUCTIONS', 10)
    with pytest.raises(LeftOutError, match=r'instructions|no C compiler'):
        casadi.Casadi(robot('chain2'), 'inertia_matrix')


def test_the_summary_has_our_times_and_their_ratios_to_each_peer() -> None:
    # CasADi is 5 and 6 times as fast as Pinocchio, ours 25 and 48 times.
    wanted = '| derivatives | 200 / 400 | 25 | 5 | 100 / 200 | 48 | 8 | 0.55 |'
    assert wanted in time_tables.summary(ROWS)
    alone = [row for row in ROWS if row.way.startswith('pfd')]
    alone = [replace(row, times=None) for row in alone]
    assert '| derivatives | 200 / 400 | - | - | 100 / 200 |' in time_tables.summary(alone)


def test_the_table_of_errors_has_the_fastest_call_and_the_largest_error_of_a_way() -> None:
    table = time_tables.against_error(ROWS)
    peer = 'pinocchio.computeABADerivatives'
    assert f'| derivatives | {peer} | 5000 / 10000 | 5000 / 10000 | 7e-13 |' in table
    assert '| derivatives | pfd float64 | 200 / 400 | 100 / 200 | 1e-16 |' in table


@pytest.mark.parametrize('references', [0, 4])
def test_the_pages_of_a_quantity_hold_every_row(references: int, tmp_path: Path) -> None:
    found = speed.Findings(ROWS, LEFT_OUT, speed.surroundings())
    paths = quantity_pages.write(found, tmp_path, 'derivatives', references)
    stem = 'speed-against-error-derivatives' if references else 'speed-derivatives'
    suffixes = ['md', 'json', 'png', *(['svg'] if references else [])]
    assert [path.name for path in paths] == [f'{stem}.{suffix}' for suffix in suffixes]
    page = paths[0].read_text()
    assert "`compile_kernel(robot, quantity='derivatives')`: d qdd / d(q, qd, tau)" in page
    assert '- CasADi C, linear_step at ur5: it is absent' in page
    if references:
        assert '| derivatives | CasADi C | 1000 / 2000 | 900 / 1800 | 4e-16 |' in page
    else:
        assert '| pfd float64: kernel(..., out=) | 800 / 1600 (6) |' in page
        assert '| pfd float64 | 60 / 120 (0.55) |' in page
    data = json.loads(paths[1].read_text())
    assert [Row(**row) for row in data['rows']] == ROWS


def test_the_pages_of_forward_dynamics_have_the_table_of_the_others() -> None:
    found = speed.Findings([], LEFT_OUT, speed.surroundings(), ROWS)
    page = speed_pages.markdown(found)
    assert page.index('## Other quantities') < page.index('| derivatives | 200 / 400 | 25 | 5 |')
    page = against_error_pages.markdown(
        against_error_pages.Findings(quantities=ROWS, left_out=LEFT_OUT)
    )
    assert '| derivatives | pfd float64 | 200 / 400 | 100 / 200 | 1e-16 |' in page
    assert '- CasADi C, linear_step at ur5: it is absent' in page


def test_the_plot_of_errors_has_a_panel_for_every_quantity(tmp_path: Path) -> None:
    others = [replace(row, quantity='tip_pose') for row in ROWS]
    _, svg = time_tables.plot_errors([*ROWS, *others], tmp_path, 'plot')
    text = ''.join(ElementTree.parse(svg).getroot().itertext())
    assert all(panel in text for panel in ('ur5: derivatives', 'ur5: tip_pose'))
    assert all(
        label in text for label in ('pfd float64', 'Pinocchio, fastest from Python', 'CasADi')
    )


def test_the_plot_is_left_out_without_matplotlib_or_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not time_tables.plot_errors([], tmp_path, 'plot')
    monkeypatch.setitem(sys.modules, 'matplotlib.figure', None)
    assert not time_tables.plot_errors(ROWS, tmp_path, 'plot')


def test_surveys_of_forward_dynamics_measure_the_others_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = []
    monkeypatch.setattr(
        quantity_rows, 'measure', lambda plan: asked.append(plan) or (ROWS, LEFT_OUT)
    )
    plan = replace(speed.QUICK, robots=(), others=TINY)
    found = speed.survey(plan)
    assert (found.others, found.left_out) == (ROWS, LEFT_OUT)
    nothing = replace(evaluations.QUICK, cases=())
    runs = replace(work_precision.QUICK, motions=())
    both = against_error_pages.survey(nothing, runs, TINY)
    assert (both.quantities, both.left_out) == (ROWS, LEFT_OUT)
    assert asked == [TINY] * 2


@pytest.mark.sweep
@pytest.mark.parametrize('quick', [False, True])
@pytest.mark.parametrize('against_error', [False, True])
def test_a_report_measures_the_requested_quantity(
    against_error: bool, quick: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    found = speed.Findings(ROWS, [], speed.surroundings())
    monkeypatch.setattr(quantity_pages, 'survey', lambda plan: asked.append(plan) or found)
    assert quantity_pages.run(tmp_path, 'derivatives', against_error, quick)
    (plan,) = asked
    assert plan.quantities == ('derivatives',)
    assert bool(plan.references) == against_error
    assert (plan.batches == (64,)) == quick
