# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report of a scene: errors by closed forms, and an answer that nothing smaller meets."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import combinations
import json
import math
from pathlib import Path
import sys

import numpy as np
import pytest
from zoo import joint, link, urdf

import pfd_core as pfd
from pfd_core.report import scene_motions, scene_needs, scene_pages, scene_search
from pfd_core.report.scene_effects import EFFECTS, effects_on, full_scene, spelled, without
from pfd_core.report.scene_errors import SceneRow, cut, measure, run_full
from pfd_core.report.scene_motions import EXCITATIONS, SETTINGS, Motion, excited_motion
from pfd_core.report.scene_needs import Needs
from pfd_core.report.timing import Pace

# Rounding of some hundred steps of a motion of about a radian, and of differences of it.
ROUNDING = 1e-12
# RK4 with steps of 0.5 ms on exp(-d t / I), d / I up to 10: (h d / I)^4 and less.
INTEGRATION = 1e-10
FAST = Pace(chunk=1e-5, turns=2, budget=0.1)
WINDOW = 0.1
# A disc of 0.5 kg m^2 on a vertical axis: gravity does not turn it.
INERTIA = 0.5
DISC = urdf(
    'disc',
    link('base'),
    link('disc', 1.0, J=f'0.3 0.3 {INERTIA} 0 0 0'),
    joint('axis', 'continuous', 'base', 'disc', extra='<limit velocity="9" effort="40"/>'),
)


@pytest.fixture(scope='module')
def disc() -> pfd.Robot:
    return pfd.load_robot(DISC)


def motion_of(
    robot: pfd.Robot,
    taus: np.ndarray,
    *,
    qd: float = 0.0,
    held: np.ndarray | None = None,
    after: tuple[int, ...] = (0,),
) -> Motion:
    """Return a motion whose state is known at its start, at rest at 0 unless qd says otherwise."""
    n, states = robot.n, len(after)
    return Motion(
        'made up',
        'a test',
        {'step_size': 1e-3, 'substeps': 2, 'integrator': 'rk4', 'method': 'auto'},
        taus,
        np.zeros(taus.shape, bool) if held is None else held,
        np.array(after),
        np.zeros((states, n)),
        np.full((states, n), qd),
    )


def error_without(
    robot: pfd.Robot, scene: pfd.Scene, name: str, motion: Motion, window: float = WINDOW
) -> SceneRow:
    return measure(run_full(robot, scene, motion, window), without(scene, {name}))


# The table of effects


def test_every_field_of_a_scene_belongs_to_an_effect() -> None:
    assert {field for effect in EFFECTS for field in effect.off} == {
        field.name for field in fields(pfd.Scene)
    }


def test_any_effect_can_be_left_out_of_a_scene_with_all_and_is_off_then() -> None:
    robot, n = pfd.load_robot('planar2'), 2
    everything = pfd.Scene(
        damping=(0.1,) * n,
        armature=(0.1,) * n,
        payload=pfd.Payload(1.0),
        external_wrench=True,
        brakes=True,
        friction=(0.1,) * n,
        static_friction=(0.2,) * n,
        stribeck_velocity=(0.1,) * n,
        joint_limits=((-1.0, 1.0),) * n,
        restitution=0.5,
        stiffness=(1.0,) * n,
        rest_position=(0.1,) * n,
        effort_limits=(5.0,) * n,
        torque_speed=([(0.0, 5.0), (1.0, 4.0)],) * n,
        gravity_compensation=True,
        motor_lag=(0.01,) * n,
    )
    names = tuple(effect.name for effect in EFFECTS)
    assert effects_on(robot, everything) == names
    for name in names:
        assert name not in effects_on(robot, without(everything, {name}))
    assert effects_on(robot, without(everything, names)) == ()


def test_effects_without_numbers_are_off(disc: pfd.Robot) -> None:
    scene = pfd.Scene(damping='model', armature='model')
    assert effects_on(disc, scene) == ('gravity',)
    assert effects_on(disc, pfd.Scene(gravity=(0, 0, 0), damping=(0.0,))) == ()
    assert effects_on(pfd.load_robot('panda'), scene) == ('gravity', 'damping', 'armature')


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
    settings = {**SETTINGS, 'integrator': 'velocity_verlet'}
    full, refused = full_scene(pfd.load_robot('puma560'), pfd.Scene(), settings)
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


# The search


def table(rows: dict[str, tuple[int, float]]) -> scene_search.Measure:
    """Return a measure by the letters of the effects that are on: operations and error."""

    def look_up(left_out: frozenset[str]) -> SceneRow:
        on = ''.join(sorted(set('abc') - left_out))
        operations, error = rows[on]
        return SceneRow(tuple(on), on, operations, error, error)

    return look_up


# Without b and c together the errors cancel; a alone costs nothing.
CANCELLING = {
    'abc': (30, 0.0),
    'ab': (20, 0.5),
    'ac': (25, 0.5),
    'bc': (30, 0.1),
    'a': (15, 0.2),
    'b': (20, 0.9),
    'c': (25, 0.9),
    '': (15, 0.8),
}


@pytest.mark.parametrize(
    ('tolerance', 'of_all', 'one_by_one'),
    [(0.05, 'abc', 'abc'), (0.15, 'bc', 'bc'), (0.3, 'a', 'bc'), (0.6, 'a', 'a'), (1.0, '', '')],
)
def test_the_search_finds_the_smallest_scene(
    tolerance: float, of_all: str, one_by_one: str
) -> None:
    look_up = table(CANCELLING)
    for search, wanted in (
        (scene_search.smallest_of_all, of_all),
        (scene_search.smallest_one_by_one, one_by_one),
    ):
        assert look_up(search('abc', look_up, tolerance)).scene == wanted


def test_of_scenes_of_one_cost_that_with_fewer_effects_is_smaller() -> None:
    rows = dict.fromkeys(CANCELLING, (10, 0.0))
    for search in (scene_search.smallest_of_all, scene_search.smallest_one_by_one):
        assert search('abc', table(rows), 0.1) == frozenset('abc')


def test_no_scene_of_the_front_is_beaten_by_another() -> None:
    look_up = table(CANCELLING)
    rows = [look_up(frozenset('abc') - frozenset(on)) for on in CANCELLING]
    assert [row.scene for row in scene_search.pareto_front(rows)] == ['a', 'abc']


@pytest.mark.parametrize('most', [scene_search.MOST_EXHAUSTED, 0])
@pytest.mark.parametrize('tolerance', [1e-6, 1e-3, 0.05, 100.0])
def test_the_smallest_scene_is_in_tolerance_and_no_smaller_one_is(
    tolerance: float, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene_needs, 'MOST_EXHAUSTED', most)
    arm, scene = pfd.load_robot('planar2'), pfd.Scene(damping=(0.5, 0.01), armature=(0.1, 0.01))
    motion = excited_motion(arm, scene, 'swing')
    needs = scene_needs.scene_needs(arm, scene, motion, tolerance, pace=FAST)
    assert needs.exhaustive == (most > 0)
    small, on = needs.smallest, needs.smallest.effects
    full = run_full(arm, scene, motion, WINDOW)
    gone = set(needs.full.effects) - set(on)
    assert measure(full, without(scene, gone)) == small
    assert small.largest <= tolerance
    further = 1 if most == 0 else len(on)
    for count in range(1, further + 1):
        for names in combinations(on, count):
            assert measure(full, without(scene, gone | set(names))).largest > tolerance


def test_the_operations_of_an_effect_are_those_of_four_evaluations(disc: pfd.Robot) -> None:
    scene = pfd.Scene(damping=(1.0,), gravity=None)
    motion = motion_of(disc, np.ones((50, 1)))
    (damping,) = scene_needs.scene_needs(disc, scene, motion, 1e-3, pace=FAST).effects
    counts = [
        sum(pfd.compile_kernel(disc, scene=one).operations['compiled'].values())
        for one in (scene, pfd.Scene(gravity=None))
    ]
    assert damping.operations == 4 * (counts[0] - counts[1]) > 0


# Named motions


@pytest.mark.parametrize('name', EXCITATIONS)
@pytest.mark.parametrize('arm', ['planar2', 'panda', 'puma560', 'ur5'])
def test_a_named_motion_moves_every_joint_within_its_limits(arm: str, name: str) -> None:
    robot = pfd.load_robot(arm)
    scene, _ = full_scene(robot, pfd.Scene(), SETTINGS)
    motion = excited_motion(robot, scene, name)
    assert (np.abs(motion.taus) <= robot.effort_limit).all()
    assert (motion.q >= robot.position_lower).all()
    assert (motion.q <= robot.position_upper).all()
    assert (np.abs(motion.qd) <= robot.velocity_limit).all()
    assert (np.ptp(motion.q, axis=0) > 0.1).all()
    # The states are those of the full scene under these torques, bit for bit.
    full = run_full(robot, scene, motion, WINDOW)
    assert full.departure == 0.0
    np.testing.assert_array_equal(full.q[:-1], motion.q[1:])


@pytest.mark.parametrize('name', ['swing', 'sine'])
def test_the_derivatives_of_a_reference_are_those_of_its_position(name: str) -> None:
    h = 1e-4
    t = np.arange(0, scene_motions.SECONDS, h)
    y, yd, ydd = EXCITATIONS[name].reference(t, 3)
    assert y.shape == yd.shape == ydd.shape == (len(t), 3)
    assert np.abs(yd).max() <= EXCITATIONS[name].peak
    # Central differences: the third derivative is below 300, times h^2 / 6.
    for value, derivative in ((y, yd), (yd, ydd)):
        slope = (value[2:] - value[:-2]) / (2 * h)
        inner = np.abs(t[1:-1] - scene_motions.SECONDS / 2) > h  # the swing turns there
        np.testing.assert_allclose(slope[inner], derivative[1:-1][inner], atol=300 * h**2 / 6)


def test_limits_of_zero_are_none(disc: pfd.Robot) -> None:
    unknown = replace(disc, velocity_limit=np.zeros(1), effort_limit=np.zeros(1))
    assert np.ptp(excited_motion(unknown, pfd.Scene(), 'sine').q) > 0.9


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
    assert json.loads(data.read_text())['effects'][-1]['without']['largest'] is None


# Pages


@pytest.fixture(scope='module')
def panda_needs() -> Needs:
    robot, scene = pfd.load_robot('panda'), pfd.Scene(damping='model', armature='model')
    told: list[str] = []
    motion = excited_motion(robot, scene, 'steps')
    needs = scene_needs.scene_needs(robot, scene, motion, 1e-3, pace=FAST, tell=told.append)
    assert [text for text in told if text.startswith('simulating scene')][-1].split()[2] == '8:'
    return needs


def test_the_pages_hold_the_answer_and_every_scene(panda_needs: Needs, tmp_path: Path) -> None:
    pytest.importorskip('matplotlib')
    paths = scene_pages.write(panda_needs, tmp_path / 'new')
    names = ['scene.md', 'scene.json', 'scene.yaml', 'scene.png', 'scene.svg']
    assert [path.name for path in paths] == names
    assert all(path.stat().st_size for path in paths)
    page = paths[0].read_text()
    small = panda_needs.smallest
    assert spelled(pfd.load_scene(paths[2])) == small.scene
    assert f'**{", ".join(small.effects)}**; left out: damping' in page
    assert f'    pfd.{small.scene}\n' in page
    for row in panda_needs.effects:
        assert f'| {row.name} | {row.operations} |' in page
    assert page.count('| yes |') + page.count('| no |') >= len(panda_needs.scenes) == 8
    assert max(map(len, (x for x in page.splitlines() if not x.startswith('|')))) <= 99
    data = json.loads(paths[1].read_text())
    assert data['smallest']['effects'] == list(small.effects)
    assert len(data['scenes']) == 8
    assert sum(row['share'] for row in data['effects']) == pytest.approx(1.0)
    assert data['step_times']['full minimum'] > 0


def test_the_plot_is_the_same_in_every_run(panda_needs: Needs, tmp_path: Path) -> None:
    pytest.importorskip('matplotlib')
    one, other = (scene_pages.write(panda_needs, tmp_path / name)[-1] for name in 'ab')
    assert one.read_bytes() == other.read_bytes()


def test_the_plot_is_left_out_without_matplotlib(
    panda_needs: Needs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ('matplotlib', 'matplotlib.figure', 'matplotlib.backends.backend_agg'):
        monkeypatch.setitem(sys.modules, name, None)
    paths = scene_pages.write(panda_needs, tmp_path)
    assert [path.name for path in paths] == ['scene.md', 'scene.json', 'scene.yaml']
    assert 'scene.png' not in paths[0].read_text()


@pytest.mark.parametrize(
    'effect', [{'joint_limits': ((-1.0, 1.0),)}, {'motor_lag': (0.1,)}, {'friction': (0.1,)}]
)
def test_effects_over_a_step_of_time_have_operations(disc: pfd.Robot, effect: dict) -> None:
    bare, with_it = (pfd.Simulator(disc, pfd.Scene(**x)).operations for x in ({}, effect))
    evaluation = sum(pfd.compile_kernel(disc).operations['compiled'].values())
    assert 4 * evaluation < bare < with_it
