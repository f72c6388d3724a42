# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Loads, the tip's path and a ghost in the page of `pfd view`, and the page as one file."""

from __future__ import annotations

from functools import partial
from pathlib import Path
import re
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from ros_processes import example_robot
from view_models import (
    STATE,
    UR5,
    Exported,
    Nodes,
    joint_state,
    parsed,
    pendulum_end,
    recorded,
    swinging,
    ur5_poses,
    urdf,
    write_bag,
)

from pfd_ros.cli.main import main
from pfd_ros.testing.lockstep_arm import LockstepArm
from pfd_ros.view.loads import AT_LIMIT, UNKNOWN, Loads, load_colour
from pfd_ros.view.logged_arm import Content, content_of, fill, offset_of, tip_path

TIMES = (0.0, 0.1, 0.2, 0.35, 0.5)
NONE, FULL = (70, 120, 200), (225, 60, 45)


@pytest.fixture(scope='module')
def ur5_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp('view') / 'ur5.mcap', example_robot(UR5), 1.0)


def tip_of(log: Path, places: np.ndarray) -> np.ndarray:
    """Return the tip of a UR5 at some states of a log, by Pinocchio."""
    pose = ur5_poses(log)
    return np.array([pose(place, 'wrist_3_link').translation for place in places])


def test_a_torque_is_blue_at_none_and_red_at_its_limit() -> None:
    assert load_colour(0.0) == NONE
    assert load_colour(1.0) == load_colour(7.0) == FULL
    assert load_colour(float('nan')) == UNKNOWN
    loads = Loads(parsed(urdf()), ['swing'], np.array([[4.0]]))
    assert loads.unlimited == ()
    zero = np.zeros(1)
    colours = [loads.colours(zero, np.array([effort]))[0] for effort in (0.0, -10.0, 10.0, np.nan)]
    assert colours == [NONE, FULL, FULL, UNKNOWN]
    assert loads.colours(zero, np.array([5.0]))[0] not in (NONE, FULL)


def test_a_joint_at_the_end_of_its_range_is_violet() -> None:
    loads = Loads(parsed(urdf()), ['swing'], np.zeros((1, 1)))
    found = {q: loads.colours(np.array([q]), np.zeros(1))[0] for q in (-3.1, -3.0, 2.9, 3.0)}
    assert found == {-3.1: AT_LIMIT, -3.0: AT_LIMIT, 2.9: NONE, 3.0: AT_LIMIT}
    endless = urdf().replace('type="revolute"', 'type="continuous"')
    loads = Loads(parsed(endless), ['swing'], np.zeros((1, 1)))
    assert loads.colours(np.array([9.0]), np.zeros(1)) == [NONE]


def test_without_an_effort_limit_the_scale_ends_at_the_largest_torque() -> None:
    free = parsed(urdf().replace('effort="10"', 'effort="0"'))
    loads = Loads(free, ['swing'], np.array([[-4.0], [np.nan], [2.0]]))
    assert loads.unlimited == ('swing',)
    assert loads.colours(np.zeros(1), np.array([-4.0])) == [FULL]
    # No torque at all divides by nothing.
    assert Loads(free, ['swing'], np.zeros((2, 1))).colours(np.zeros(1), np.zeros(1)) == [NONE]


def test_the_path_of_the_tip_equals_pinocchio(ur5_log: Path) -> None:
    found = content_of(ur5_log)
    assert found.tip == 'wrist_3_link'
    path = tip_path(found)
    assert len(path) == len(found.motion.time)
    places = np.array([0, len(path) // 2, len(path) - 1])
    np.testing.assert_allclose(path[places], tip_of(ur5_log, places), atol=1e-12)


def test_a_ghost_is_shown_at_the_same_stamps(tmp_path: Path, empty: Any) -> None:
    arm = content_of(swinging(tmp_path / 'a', TIMES, text=urdf()))
    states = [
        ('/joint_states', STATE, k, joint_state(100.2 + 0.1 * k, ['swing'], [1.0 + k]))
        for k in range(3)
    ]
    # It has no model: that of the arm is taken.
    ghost = content_of(write_bag(tmp_path / 'b', states), other=arm.seen.urdf)
    assert offset_of(arm.motion, ghost.motion) == pytest.approx(0.2)
    show = fill(empty, arm, ghost)
    for time, q in ((0.0, 1.0), (0.25, 1.0), (0.35, 2.0), (0.5, 3.0)):
        show(time)
        node = empty.scene.get_handle_by_name(f'/ghost/link_{ghost.poses.index("end")}')
        np.testing.assert_allclose(node.position, pendulum_end(q).translation, atol=1e-12)


def test_logs_without_a_time_in_common_start_together(tmp_path: Path) -> None:
    arm = content_of(swinging(tmp_path / 'a', TIMES, text=urdf()))
    state = ('/joint_states', STATE, 0, joint_state(7.0, ['swing'], [1.0]))
    ghost = content_of(write_bag(tmp_path / 'b', [state]), other=arm.seen.urdf)
    assert offset_of(arm.motion, ghost.motion) is None


def test_the_exported_page_has_the_arm_at_the_times_of_the_log(
    ur5_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / 'arm.html'
    assert main(['view', str(ur5_log), '--export', str(target)]) == 0
    assert capsys.readouterr().out.startswith(f'{target} plays ur5.mcap in a browser (')
    exported = Exported(target)
    found: Content = content_of(ur5_log)
    assert exported.duration == pytest.approx(found.motion.duration, abs=0.05)
    node = f'/arm/link_{found.poses.index("wrist_3_link")}'
    positions = exported.positions(node)
    assert len(positions) >= 30  # a second
    chosen = [positions[k] for k in (0, len(positions) // 2, -1)]
    # Times are sums of the times between frames: rounded.
    places = np.array([found.motion.at(time + 1e-6) for time, _ in chosen])
    expected = tip_of(ur5_log, places)
    np.testing.assert_allclose([position for _, position in chosen], expected, atol=1e-6)
    assert np.linalg.norm(expected[1] - expected[0]) > 0.2
    # Nothing in the page is loaded from elsewhere.
    text = target.read_text(encoding='utf-8')
    assert not re.findall(r'(?:src|href)="(?:https?:)?//', text)


def test_an_export_replaces_no_file_and_leaves_none_behind(
    ur5_log: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    there = tmp_path / 'there.html'
    there.write_text('mine')
    assert main(['view', str(ur5_log), '--export', str(there)]) == 1
    assert there.read_text() == 'mine'
    assert 'File exists' in capsys.readouterr().err
    assert main(['view', str(ur5_log), '--export', str(tmp_path / 'no' / 'a.html')]) == 1
    assert 'No such file or directory' in capsys.readouterr().err

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr('pfd_ros.view.export.fill', interrupted)
    assert main(['view', str(ur5_log), '--export', str(tmp_path / 'b.html')]) == 130
    assert not (tmp_path / 'b.html').exists()


# ---- wrench and payload ----

# The page has float32 vertices.
SINGLE = 1e-6
# Two pushes of the UR5 in frames that its last link carries, and the payloads under which.
PUSHES = {
    'tool0': ((12.0, -7.0, 20.0), (0.8, -1.5, 0.6)),
    'wrist_3_link': ((-30.0, 5.0, 1.0), (0.0, 0.0, -2.0)),
}
FIRST = (1.0, (0.0, 0.05, 0.02), (0.0,) * 6)
SECOND = (2.5, (0.1, -0.02, 0.05), (0.02, 0.001, -0.002, 0.03, 0.003, 0.025))
PART = 0.1  # s of each of the four parts of that run: neither, the pushes, neither


@pytest.fixture(scope='module')
def pushed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a UR5 that is pushed twice, and whose payload changes and goes."""
    path = tmp_path_factory.mktemp('view') / 'pushed.mcap'
    mass, center, _ = FIRST
    settings = {'external_wrench': True, 'payload_mass': mass, 'payload_center': center}
    settings['publish_rate'] = 100.0

    def swing(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return np.linspace(3.0, -2.0, 6) * np.cos(9.0 * t) - 0.3 * qd

    with LockstepArm(example_robot(UR5), recording=path, **settings) as arm:
        arm.run(swing, PART)
        arm.push(*PUSHES['tool0'], 'tool0')
        arm.run(swing, PART)
        arm.push(*PUSHES['wrist_3_link'], 'wrist_3_link')
        mass, center, inertia = SECOND
        arm.set(payload_mass=mass, payload_center=center, payload_inertia=inertia)
        arm.run(swing, PART)
        arm.push((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        arm.set(payload_mass=0.0)
        arm.run(swing, PART)
    return path


def visible(nodes: Nodes) -> list[str]:
    names = ('/wrench/force', '/wrench/torque', '/payload')
    return [name for name in names if nodes[name].visible]


def check_wrench(nodes: Nodes, frame: pin.SE3, wrench: Any, scale: Any) -> None:
    force, torque = map(np.array, wrench)
    head, shaft = nodes.points('/wrench/force/head'), nodes.points('/wrench/force/shaft')
    along = frame.rotation @ force / scale.force
    reaching = (head - frame.translation) @ along / np.linalg.norm(along)
    tip = head[np.argmax(reaching)]
    np.testing.assert_allclose(tip, frame.translation + along, atol=SINGLE)
    # The shaft begins at the point of application.
    begin = (shaft - frame.translation) @ along / np.linalg.norm(along)
    np.testing.assert_allclose(shaft[begin < SINGLE].mean(axis=0), frame.translation, atol=SINGLE)
    about = frame.rotation @ torque
    turn = nodes.points('/wrench/torque/turn') - frame.translation
    axis = about / np.linalg.norm(about)
    radius = np.linalg.norm(torque) / scale.torque
    distances = np.linalg.norm(np.cross(turn, axis), axis=1)
    assert np.abs(turn @ axis).max() < 0.15 * radius
    assert np.median(distances) == pytest.approx(radius, rel=0.05)
    # From its begin to its head it turns as the right hand's fingers do.
    assert np.sum(np.cross(turn[:-1], turn[1:]) @ axis) > 0


def test_arrows_and_payload_of_a_recording_are_at_the_poses_of_pinocchio(
    pushed: Path, empty: Any
) -> None:
    content = content_of(pushed)
    assert content.lines == ()
    nodes, count = Nodes(empty, content), len(content.motion.time)
    pose = ur5_poses(pushed)
    for part, frame in ((1, 'tool0'), (2, 'wrist_3_link')):
        for place in (part * count // 4 + 1, (2 * part + 1) * count // 8, (part + 1) * count // 4):
            nodes.show(content.motion.time[place - 1])
            at = partial(pose, place - 1)
            assert visible(nodes) == ['/wrench/force', '/wrench/torque', '/payload']
            check_wrench(nodes, at(frame), PUSHES[frame], content.scale)
            centre = at('wrist_3_link').act(np.array((FIRST, SECOND)[part - 1][1]))
            for name in ('/payload/body', '/payload/centre'):
                points = nodes.points(name)
                middle = (points.min(axis=0) + points.max(axis=0)) / 2
                np.testing.assert_allclose(points.mean(axis=0), centre, atol=10 * SINGLE)
                np.testing.assert_allclose(middle, centre, atol=0.1 * np.ptp(points))


def test_arrows_are_hidden_without_a_wrench_and_the_payload_without_a_mass(
    pushed: Path, empty: Any
) -> None:
    content = content_of(pushed)
    nodes, states = Nodes(empty, content), content.motion.time
    shown = []
    for time in states:
        nodes.show(time)
        shown.append(visible(nodes))
    quarter = round(PART / (states[1] - states[0]))
    assert len(states) == 4 * quarter
    both = ['/wrench/force', '/wrench/torque', '/payload']
    assert shown == quarter * [['/payload']] + 2 * quarter * [both] + quarter * [[]]
