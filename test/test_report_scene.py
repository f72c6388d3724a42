# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of a scene: its effects, and their errors by closed forms."""

from __future__ import annotations

from dataclasses import replace
import json
import math
from pathlib import Path

from effect_cases import everything
import numpy as np
import pytest
from scene_cases import DISC, FAST, INERTIA, ROUNDING, WINDOW, motion_of
from zoo import joint, link, urdf

import pfd_core as pfd
from pfd_core.model import EFFECTS
from pfd_core.report import scene_pages
from pfd_core.report.cases.excitations import SETTINGS, DrivenMotion, excited_motion
from pfd_core.report.measure import scene_needs
from pfd_core.report.measure.scene_effects import effects_on, full_scene, spelled
from pfd_core.report.measure.scene_errors import SceneRow, cut, measure, run_full
from pfd_core.report.measure.scene_margins import MEASURES, OVER_A_STEP, floors, margin_of

# RK4 with steps of 0.5 ms on exp(-d t / I), d / I up to 10: (h d / I)^4 and less.
INTEGRATION = 1e-10
STOPS = 'joint stops'


@pytest.fixture(scope='module')
def disc() -> pfd.Robot:
    return pfd.load_robot(DISC)


def error_without(
    robot: pfd.Robot, scene: pfd.Scene, name: str, motion: DrivenMotion, window: float = WINDOW
) -> SceneRow:
    return measure(run_full(robot, scene, motion, window), scene.without({name}))


# The table of effects


def test_any_effect_can_be_left_out_of_a_scene_with_all_and_is_off_then() -> None:
    robot = pfd.load_robot('planar2')
    scene = everything(robot.n)
    names = tuple(effect.name for effect in EFFECTS)
    assert effects_on(robot, scene) == names
    for name in names:
        assert name not in effects_on(robot, scene.without({name}))
    assert effects_on(robot, scene.without(names)) == ()


def test_effects_without_numbers_are_off(disc: pfd.Robot) -> None:
    scene = pfd.Scene(damping='model', armature='model')
    assert effects_on(disc, scene) == ('gravity',)
    assert effects_on(disc, pfd.Scene(gravity=(0, 0, 0), damping=(0.0,))) == ()
    assert effects_on(pfd.load_robot('panda'), scene) == ('gravity', 'damping', 'armature')


@pytest.mark.slow
def test_the_full_scene_has_what_the_model_states_and_keeps_what_is_given(
    disc: pfd.Robot,
) -> None:
    given = pfd.Scene(gravity=None, damping=(1.0,) * 7)
    full, refused = full_scene(pfd.load_robot('panda'), given, SETTINGS)
    assert (full.gravity, full.damping, full.armature) == (None, given.damping, 'model')
    assert not refused.keys() & {'damping', 'armature'}
    # The model of the disc states limits of velocity and effort, and those alone.
    assert replace(full_scene(disc, pfd.Scene(), SETTINGS)[0], effort_limits=None) == pfd.Scene()


def test_an_effect_of_the_model_that_cannot_be_simulated_is_off_with_the_reason() -> None:
    settings = {**SETTINGS, 'integrator': 'imex2'}
    undamped = replace(pfd.load_robot('puma560'), damping=np.zeros(6))
    full, refused = full_scene(undamped, pfd.Scene(), settings)
    assert full.friction is None
    assert 'friction' in refused['friction']


def test_a_scene_is_spelled_as_the_call_that_makes_it() -> None:
    scene = pfd.Scene(gravity=None, damping=(1.0, 2.0), payload=pfd.Payload(1.5))
    names = {'Scene': pfd.Scene, 'Payload': pfd.Payload}
    assert eval(spelled(scene), names) == scene
    assert spelled(pfd.Scene()) == 'Scene()'


# Errors


def test_the_error_without_damping_is_that_of_the_closed_form(disc: pfd.Robot) -> None:
    d, qd = 5.0, 2.0
    motion = motion_of(disc, np.zeros((100, 1)), qd=qd)
    row = error_without(disc, pfd.Scene(damping=(d,)), 'damping', motion)
    t = 1e-3 * np.arange(1, 101)
    off = qd * t - qd * INERTIA / d * (1 - np.exp(-d * t / INERTIA))
    assert row.largest == pytest.approx(off[-1], rel=INTEGRATION)
    assert row.rms == pytest.approx(np.sqrt(np.mean(off**2)), rel=INTEGRATION)
    assert (row.joint, row.time) == ('axis', pytest.approx(0.1))


def test_the_error_without_armature_is_that_of_the_closed_form(disc: pfd.Robot) -> None:
    tau, armature = 3.0, 0.25
    motion = motion_of(disc, np.full((250, 1), tau))
    for window in (0.05, 0.1):
        row = error_without(disc, pfd.Scene(armature=(armature,)), 'armature', motion, window)
        # The same in every window, however fast the disc has become by then.
        off = tau / 2 * window**2 * (1 / INERTIA - 1 / (INERTIA + armature))
        assert row.largest == pytest.approx(off, rel=ROUNDING)


def test_the_error_without_brakes_is_the_way_of_the_held_joint(disc: pfd.Robot) -> None:
    held = np.arange(100)[:, None] < 60  # released within the window
    motion = motion_of(disc, np.full((100, 1), 2.0), held=held)
    row = error_without(disc, pfd.Scene(brakes=True), 'brakes', motion)
    off = 2.0 / INERTIA / 2 * (0.1**2 - 0.04**2)
    assert row.largest == pytest.approx(off, rel=ROUNDING)


def test_gravity_across_the_axes_has_no_share_and_is_dropped() -> None:
    arm = replace(pfd.load_robot('planar2'), base_rotation=np.eye(3))
    scene = pfd.Scene(damping=(0.5, 0.5))
    assert effects_on(arm, scene) == ('gravity', 'damping')
    needs = scene_needs.scene_needs(
        arm, scene, excited_motion(arm, scene, 'sine'), 1e-9, pace=FAST
    )
    gravity, damping = needs.effects
    assert (gravity.without.largest, gravity.without.rms, gravity.share) == (0.0, 0.0, 0.0)
    assert (gravity.needed, damping.needed, damping.share) == (False, True, 1.0)
    assert needs.smallest.effects == ('damping',)
    assert needs.smallest.largest == 0.0


def test_a_simulation_that_overflows_has_an_infinite_error(disc: pfd.Robot) -> None:
    # 1e308 N m over 0.5 kg m^2 is more than the largest float.
    motion = motion_of(disc, np.full((300, 1), 1e308))
    row = error_without(disc, pfd.Scene(armature=(1e100,)), 'armature', motion, 1.0)
    assert (row.largest, row.rms) == (math.inf, math.inf)


# Margins, and errors that every scene has


def test_the_margin_of_a_torque_is_its_share_of_the_largest_commanded_torque(
    disc: pfd.Robot,
) -> None:
    d, tau = 0.5, 3.0
    motion = motion_of(disc, np.full((100, 1), tau))
    margin = margin_of(run_full(disc, pfd.Scene(damping=(d,)), motion, 1.0), 'damping')
    # The last velocity but one of the disc, which tau accelerates from rest.
    qd = tau / d * (1 - np.exp(-d * 0.099 / INERTIA))
    assert (margin.kind, margin.joint) == ('torque', 'axis')
    assert margin.value == pytest.approx(d * qd / tau, rel=INTEGRATION)


def test_the_margin_of_rotors_is_that_of_their_acceleration(disc: pfd.Robot) -> None:
    motion = motion_of(disc, np.full((100, 1), 3.0), qd=0.0)
    for window in (0.02, 0.1):  # no acceleration is taken across the start of a window
        margin = margin_of(run_full(disc, pfd.Scene(armature=(0.5,)), motion, window), 'armature')
        assert margin.value == pytest.approx(0.5 / (0.5 + INERTIA), rel=INTEGRATION)


def test_the_margin_of_stops_is_the_least_distance_to_one(disc: pfd.Robot) -> None:
    motion = motion_of(disc, np.zeros((100, 1)), qd=2.0)
    margin = margin_of(run_full(disc, pfd.Scene(joint_limits=((-1.0, 0.5),)), motion, 1.0), STOPS)
    assert (margin.kind, margin.value) == ('stop', pytest.approx(0.3, rel=ROUNDING))


def test_the_margin_of_limits_is_the_largest_share_of_the_limit(disc: pfd.Robot) -> None:
    motion = motion_of(disc, np.linspace(0.0, 10.0, 100)[:, None])
    scene = pfd.Scene(effort_limits=(40.0,))
    assert margin_of(run_full(disc, scene, motion, 1.0), 'effort limits').value == 0.25
    # The table falls from 20 at 1 rad/s to 0 at 3 rad/s; the disc keeps turning at 2 rad/s.
    coasting = motion_of(disc, np.full((2, 1), 1e-9), qd=2.0)
    table = pfd.Scene(torque_speed=(((1.0, 20.0), (3.0, 0.0)),))
    margin = margin_of(run_full(disc, table, coasting, 1.0), 'torque-speed tables')
    assert margin.value == pytest.approx(1e-9 / 10.0, rel=1e-6)


def test_the_margins_of_friction_and_brakes_are_shares_of_the_time(disc: pfd.Robot) -> None:
    held = np.arange(100)[:, None] < 60
    motion = motion_of(disc, np.zeros((100, 1)), held=held)
    full = run_full(disc, pfd.Scene(brakes=True, friction=(1.0,)), motion, 1.0)
    assert margin_of(full, 'brakes').value == pytest.approx(0.6)
    assert margin_of(full, 'friction').value == 1.0


def test_every_effect_but_the_lag_of_motors_has_a_margin() -> None:
    measured = {effect.name for effect in EFFECTS} - OVER_A_STEP | set(MEASURES)
    assert {effect.name for effect in EFFECTS} - measured == {'motor lag'}


def test_a_motion_of_one_step_exercises_no_torque(disc: pfd.Robot) -> None:
    full = run_full(disc, pfd.Scene(damping=(1.0,)), motion_of(disc, np.ones((1, 1))), 1.0)
    assert margin_of(full, 'damping').value == 0.0


def test_the_error_of_the_integrator_is_that_of_the_closed_form(disc: pfd.Robot) -> None:
    # So strong that a step of RK4 has an error far above rounding.
    d, qd = 200.0, 2.0
    motion = motion_of(disc, np.zeros((100, 1)), qd=qd)
    full = run_full(disc, pfd.Scene(damping=(d,)), motion, 1.0)
    t = 1e-3 * np.arange(1, 101)[:, None]
    exact = qd * INERTIA / d * (1 - np.exp(-d * t / INERTIA))
    integrator, *rounding = floors(full)
    # Steps a quarter as long leave 1/256 of the error.
    assert integrator.largest == pytest.approx(np.abs(full.q - exact).max(), rel=1 / 200)
    assert all(floor.largest < 1e-5 for floor in rounding)
    assert [floor.cause.split(':')[0] for floor in rounding] == ['rounding', 'rounding in float32']


@pytest.mark.slow
def test_the_page_advises_and_names_what_the_motion_says_nothing_about(
    disc: pfd.Robot, tmp_path: Path
) -> None:
    scene = pfd.Scene(gravity=None, damping=(0.5,), joint_limits=((-1.0, 5.0),))
    motion = motion_of(disc, np.full((100, 1), 3.0))
    needs = scene_needs.scene_needs(disc, scene, motion, 1e-6, pace=FAST)
    assert [row.exercised for row in needs.effects] == [True, False]
    page, *_ = scene_pages.write(needs, tmp_path)
    text = ' '.join(page.read_text().split())
    assert '**Advice**: simulate this motion with damping: within' in text
    assert 'joint stops: axis comes within 1 of a stop' in text


def test_a_difference_of_more_than_a_turn_is_reported_as_divergence(
    disc: pfd.Robot, tmp_path: Path
) -> None:
    motion = motion_of(disc, np.full((100, 1), 3000.0))
    needs = scene_needs.scene_needs(
        disc, pfd.Scene(gravity=None, armature=(100.0,)), motion, 1e-3, pace=FAST
    )
    page, data, *_ = scene_pages.write(needs, tmp_path)
    assert 'Without any effect the motion diverges' in ' '.join(page.read_text().split())
    assert json.loads(data.read_text())['bare']['largest'] > 2 * math.pi


# Windows


def test_windows_end_at_the_last_known_state_within_their_length(disc: pfd.Robot) -> None:
    taus = np.zeros((250, 1))
    states = motion_of(disc, taus, after=(0, 40, 80, 120, 240))
    assert cut(states, 0.1).tolist() == [[0, 80], [80, 120], [120, 220], [220, 250]]
    assert cut(motion_of(disc, taus), 0.1).tolist() == [[0, 100], [100, 200], [200, 250]]
    assert len(cut(states, 1e-9)) == 250


def test_the_full_run_starts_from_known_states_and_says_how_far_it_was_away(
    disc: pfd.Robot,
) -> None:
    # The disc turns at 2 rad/s, but the state after 100 steps is said to be 0.
    motion = motion_of(disc, np.zeros((200, 1)), qd=2.0, after=(0, 100))
    full = run_full(disc, pfd.Scene(), motion, WINDOW)
    assert full.departure == pytest.approx(0.2, rel=ROUNDING)
    t = 1e-3 * np.arange(1, 101)
    assert full.q[:, 0] == pytest.approx(np.concatenate([2 * t, 2 * t]), rel=ROUNDING)


# Bad input


def test_an_unknown_motion_is_refused(disc: pfd.Robot) -> None:
    with pytest.raises(ValueError, match=r"one of swing, sine, steps, got 'dance'"):
        excited_motion(disc, pfd.Scene(), 'dance')


@pytest.mark.parametrize('value', [0.0, -1e-3, math.nan, math.inf])
@pytest.mark.parametrize('name', ['tolerance', 'window'])
def test_a_tolerance_and_a_window_are_above_zero(name: str, value: float, disc: pfd.Robot) -> None:
    given = {'tolerance': 1e-3, 'window': WINDOW, name: value}
    motion = motion_of(disc, np.zeros((10, 1)))
    with pytest.raises(ValueError, match=f'^{name} must be'):
        scene_needs.scene_needs(disc, pfd.Scene(), motion, pace=FAST, **given)


def test_a_full_scene_that_overflows_is_refused(disc: pfd.Robot) -> None:
    motion = motion_of(disc, np.full((300, 1), 1e308))
    with pytest.raises(ValueError, match=r'made up in Scene\(\) overflows by step 300'):
        run_full(disc, pfd.Scene(), motion, 1.0)


def test_a_scene_that_cannot_be_simulated_is_never_the_answer(tmp_path: Path) -> None:
    # Without its rotor nothing resists the joint.
    massless = urdf(
        'massless',
        link('base'),
        link('arm', 1e-300, J='0 0 0 0 0 0'),
        joint('axis', 'continuous', 'base', 'arm'),
    )
    arm = pfd.load_robot(massless)
    scene = pfd.Scene(armature=(0.1,))
    needs = scene_needs.scene_needs(arm, scene, motion_of(arm, np.ones((50, 1))), 1e9, pace=FAST)
    assert needs.smallest.effects == ('armature',)
    armature = next(row for row in needs.effects if row.name == 'armature')
    assert armature.without.largest == math.inf
    assert 'axis' in armature.without.refused
    page, data, *_ = scene_pages.write(needs, tmp_path)
    assert f'Refused without armature: {armature.without.refused}' in page.read_text()
    assert '| armature | ' in page.read_text()
    text = ' '.join(page.read_text().split())
    reason = ' '.join(armature.without.refused.split())
    assert 'subsets of the 2 effects were tried. The simulation refused 2 of 4 scenes: ' in text
    assert f': {reason} (2). *best*' in text
    assert 'were simulated' not in text
    assert json.loads(data.read_text())['effects'][-1]['without']['largest'] is None
