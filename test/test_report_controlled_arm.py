# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The controlled arm: one model in all libraries, failed runs, advice, page and README."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import sys
from typing import Any

from contact_oracle import Case
from contact_oracle import Motion as EventDriven
import numpy as np
import pytest

import pfd_core as pfd
from pfd_core.report import controlled_arm_pages
from pfd_core.report.cases.controlled_arm import ControlledArm, controlled_arm, stored_arm
from pfd_core.report.contenders.control_loop import (
    MUJOCO,
    Softness,
    casadi_arm,
    mujoco_arm,
    pinocchio_arm,
)
from pfd_core.report.contenders.drake import drake_arm
from pfd_core.report.contenders.ours_controlled import adaptive, fixed
from pfd_core.report.contenders.work import LeftOutError
from pfd_core.report.measure.controlled_motion import (
    QUICK,
    ControlledRow,
    Findings,
    ReferenceFacts,
    Rounding,
    advice,
    is_ours,
    survey,
)
from pfd_core.report.render.records import read

ROOT = Path(__file__).resolve().parent.parent
REPORT = ROOT / 'docs' / 'report'
# Two links that slide, rest and reverse within a twentieth of a second.
SMALL = controlled_arm(
    pfd.load_robot('planar2'),
    pfd.Scene(
        damping=(0.2, 0.1), armature=(0.02, 0.02), friction=(0.4, 0.2), effort_limits=(8.0, 3.0)
    ),
    start=[-1.2, 0.4],
    target=[-0.9, 0.1],
    moves=[0.0, 0.03],
    move=0.02,
    period=1e-3,
    duration=0.05,
    kp=[300.0, 100.0],
    kd=[10.0, 3.0],
)


def with_effects(case: ControlledArm, without: tuple[str, ...]) -> ControlledArm:
    return replace(case, scene=case.scene.without(without))


SMOOTH = with_effects(SMALL, ('friction',))


def test_the_stored_motion_ends_while_its_last_move_is_under_way() -> None:
    case = stored_arm()
    assert case.periods == 1000
    assert case.duration == pytest.approx(1.0)
    assert not case.qd[0].any()
    assert np.abs(case.qd[-1]).min() > 0.5
    assert (np.abs(case.taus).max(axis=0) < 1.5 * case.robot.effort_limit).all()


def test_a_controller_sets_the_torques_of_a_pd_law_about_the_reference() -> None:
    q, qd = SMALL.q[3] + 0.1, SMALL.qd[3] - 0.2
    wanted = SMALL.taus[3] - 0.1 * SMALL.kp + 0.2 * SMALL.kd
    np.testing.assert_allclose(SMALL.torques(3, q, qd), wanted)


@pytest.mark.slow
def test_our_runs_agree_with_an_event_driven_motion_of_pinocchio_and_scipy() -> None:
    # Until after the first reversals.
    short = SMALL.first(36)
    q, qd = SMALL.start, np.zeros(2)
    plant, limit = SMALL.plant, np.array([8.0, 3.0])
    for k in range(short.periods):
        tau = np.clip(SMALL.torques(k, q, qd), -limit, limit)
        motion = EventDriven(
            Case(
                SMALL.robot, plant.inertia, plant.friction, np.full((2, 2), [-np.inf, np.inf]),
                np.zeros(2), tau, plant.viscosity,
            ),
            q, qd,
        )  # fmt: skip
        motion.advance(SMALL.period)
        q, qd = motion.q, motion.v
    np.testing.assert_allclose(adaptive(short, 1e-12)().q, q, atol=1e-11)
    np.testing.assert_allclose(fixed(short, SMALL.scene, 8, 'rk4', 'float64')().q, q, atol=1e-9)


@pytest.mark.slow
def test_mujoco_and_casadi_simulate_the_same_arm_without_friction() -> None:
    wanted = fixed(SMOOTH, SMOOTH.scene, 4, 'rk4', 'float64')()
    found = [casadi_arm(SMOOTH)('CasADi RK4', 4, Softness(1.0))()]
    found.append(mujoco_arm(SMOOTH)('MuJoCo RK4', 4, Softness())())
    for one in found:
        assert one.status == 'ok'
        np.testing.assert_allclose(one.q, wanted.q, atol=1e-9)
        np.testing.assert_allclose(one.qd, wanted.qd, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(('way', 'order'), [('CasADi Verlet', 2), ('CasADi Euler', 1)])
def test_integrators_around_casadi_have_their_order(way: str, order: int) -> None:
    wanted = fixed(SMOOTH, SMOOTH.scene, 4, 'rk4', 'float64')().q
    simulate = casadi_arm(SMOOTH)
    errors = [
        np.abs(simulate(way, substeps, Softness(1.0))().q - wanted).max() for substeps in (4, 32)
    ]
    assert np.log(errors[0] / errors[1]) / np.log(8) == pytest.approx(order, abs=0.1)


def test_verlet_around_casadi_takes_the_steps_of_ours() -> None:
    ours = fixed(SMOOTH, SMOOTH.scene, 2, 'velocity_verlet', 'float64')()
    peer = casadi_arm(SMOOTH)('CasADi Verlet', 2, Softness(1.0))()
    np.testing.assert_allclose(peer.q, ours.q, rtol=0, atol=1e-13)


@pytest.mark.long
def test_pinocchio_in_cpp_simulates_the_same_arm_without_friction() -> None:
    wanted = fixed(SMOOTH, SMOOTH.scene, 4, 'rk4', 'float64')()
    one = pinocchio_arm(SMOOTH)('Pinocchio C++ RK4', 4, Softness(1.0))()
    np.testing.assert_allclose(one.q, wanted.q, atol=1e-9)


def test_a_run_of_which_mujoco_warns_has_failed() -> None:
    wild = replace(SMOOTH, kp=1e12 * SMOOTH.kp, scene=pfd.Scene())
    for way in MUJOCO:
        assert mujoco_arm(wild)(way, 1, Softness())().status == 'MuJoCo warning'


def test_drake_is_left_out_with_the_command_that_adds_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'pydrake', None)
    monkeypatch.setitem(sys.modules, 'pydrake.all', None)
    with pytest.raises(LeftOutError, match='`pip install drake` adds it'):
        drake_arm(SMALL)


def row(way: str, error: float, milliseconds: float, **more: Any) -> ControlledRow:
    seconds = milliseconds / 1e3
    return ControlledRow(
        way, 1e-3, None, error=error, middle=error / 2, minimum=seconds, median=seconds, **more
    )


ROWS = [
    row('pfd rk4 float64', 1e-11, 1.05),
    row('pfd rk4 float32', 4e-8, 1.0),
    row('pfd imex2 float64', 2e-7, 1.5),
    row('pfd velocity_verlet float64', 6e-7, 1.2),
    row('pfd rk4 float32', 4e-8, 0.1, arms=16),
    row('pfd rk4 float32', 3e-3, 0.5, left_out=('effort limits',)),
    row('pfd rk4 float32', 1e-2, 0.4, left_out=('friction',)),
    row('pfd imex2 float64', 0.4, 2.0, left_out=('armature',)),
    row('CasADi RK4', 1e-4, 2.0, softness='ramp of 0.01 rad/s'),
    ControlledRow('MuJoCo Euler', 1e-3, None, status='MuJoCo warning'),
]
FINDINGS = Findings(
    ReferenceFacts(1e-15, 2e-15, 50),
    1000,
    ROWS,
    [Rounding('float64', 0.0, 1e-15), Rounding('float32', 3e-8, 4e-8)],
    ['Drake: it is absent'],
    [0.01],
    ['default'],
)


def test_advice_is_the_fastest_run_within_half_of_the_tolerance() -> None:
    coarse, fine, finest, none = advice(ROWS, [6e-3, 1e-3, 1e-9, 1e-13])
    assert coarse.one is not None
    assert coarse.one.left_out == ('effort limits',)
    assert fine.one == ROWS[1]
    assert finest.one == ROWS[0]
    assert fine.many == ROWS[4]
    assert fine.other == ROWS[8]
    assert finest.many is finest.other is None
    assert none.one is None


def test_of_nearly_equal_times_the_scene_with_most_effects_is_advised() -> None:
    whole, smaller = row('pfd rk4 float64', 1e-5, 1.04), ROWS[5]
    for least, wanted in ((0.5, smaller), (1.0, whole)):
        fastest = replace(smaller, minimum=least / 1e3)
        (found,) = advice([fastest, whole], [1e-2])
        assert found.one == (whole if wanted is whole else fastest)


def test_the_page_shows_failed_runs_exclusions_and_what_each_effect_costs() -> None:
    text = controlled_arm_pages.markdown(FINDINGS, SMALL)
    assert '| MuJoCo Euler | 1 ms | all effects | 1 | - | MuJoCo warning | - |' in text
    assert '- Drake: it is absent' in text
    assert '| without dry friction | 1.0e-02 | 5.0e-03 |' in text
    assert '| 1e-12 | - | none | - | none | none |' in text


def test_the_plot_is_written_in_both_formats(tmp_path: Path) -> None:
    paths = controlled_arm_pages.write(FINDINGS, SMALL, tmp_path)
    assert [path.suffix for path in paths] == ['.md', '.json', '.png', '.svg']
    assert all(path.stat().st_size for path in paths)


STORED = read(Findings, REPORT / 'controlled-arm.json')


def test_the_page_has_the_numbers_of_its_json() -> None:
    page = (REPORT / 'controlled-arm.md').read_text(encoding='utf-8')
    assert controlled_arm_pages.markdown(STORED, stored_arm()) == page


@pytest.mark.long
def test_a_quick_survey_has_a_row_for_each_way_and_smaller_scene() -> None:
    found = survey(SMALL, replace(QUICK, substeps=(1, 2)))
    assert found.reference.self_difference < 1e-12
    assert found.reference.from_fixed < 1e-8
    # Three scenes without one effect: two runs for one arm, two for many and one in short steps.
    # Of them CasADi has two, each by three integrators.
    smaller = [one for one in found.rows if one.left_out]
    assert sum(map(is_ours, smaller)) == 3 * 5
    assert sum(not is_ours(one) for one in smaller) == 2 * 3
    ways = {one.way for one in found.rows}
    assert ways <= controlled_arm_pages.STYLES.keys()
    assert ways <= controlled_arm_pages.CONTENTS.keys()
    for one in found.rows:
        assert (one.status == 'ok') == (one.error is not None) == (one.minimum is not None)
    best = {one.way: one.error for one in found.rows if not one.left_out and one.arms == 1}
    assert best['pfd rk4 float64'] < 1e-6 < best['CasADi RK4']
