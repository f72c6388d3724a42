# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Frames that a robot carries, by name; against Pinocchio they are tested with the URDFs."""

from __future__ import annotations

import copy
from dataclasses import replace
import re

from bridge import Frame, resolve_plant, run_program
import numpy as np
from oracle import relative
import pytest
from tolerances import DYNAMICS
from zoo import FORK, ODD_ARM, Array, random_chain, random_rotation

import pfd_core as pfd

FINGERS = {'left_finger': 0.02, 'right_finger': 0.03}


def pose(robot: pfd.Robot, frame: str | None, q: Array) -> Array:
    found: Array = run_program(pfd.QUANTITIES['tip_pose'](resolve_plant(robot), frame), {'q': q})[
        'pose'
    ]
    return found


def carried(seed: int) -> tuple[np.random.Generator, pfd.Robot]:
    """Return a random chain with a frame on each link."""
    rng = np.random.default_rng(seed)
    robot = random_chain(rng, 5)
    frames = {f'f{k}': Frame(k, random_rotation(rng), rng.uniform(-1, 1, 3)) for k in range(6)}
    return rng, replace(robot, frames=frames)


def test_a_urdf_gives_all_links_that_move_with_the_chain_and_those_below_it() -> None:
    everything = {'world', 'pedestal', 'turret', 'box', 'upper', 'slide', 'elbow', 'fore'}
    everything |= {'bracket', 'camera', 'wrist', 'hand', 'tool'}
    robot = pfd.load_robot(ODD_ARM)
    assert set(robot.frames) == everything
    assert robot.frames['world'].link == robot.frames['pedestal'].link == 0
    assert robot.frames['box'].link == robot.frames['turret'].link == 1
    assert robot.frames['tool'].link == robot.n
    fork = pfd.load_robot(FORK, locked=FINGERS)
    assert set(fork.frames) == {'base', 'arm', 'palm', 'left', 'right'}


def test_a_table_gives_its_base_and_its_tip() -> None:
    robot = pfd.load_robot('ur5')
    assert list(robot.frames) == [robot.base, robot.tip]
    assert robot.frame() == robot.frame(robot.tip) == Frame(6, np.eye(3), np.zeros(3))


@pytest.mark.parametrize('indices', [[0], [2], [4], [0, 1], [1, 3, 4], [0, 1, 2, 4]])
def test_frames_keep_their_poses_when_joints_are_locked(indices: list[int]) -> None:
    rng, robot = carried(3)
    q = np.clip(rng.uniform(-1, 1, 5), robot.position_lower, robot.position_upper)
    less = pfd.lock(robot, {robot.joint_names[i]: q[i] for i in indices})
    assert list(less.frames) == list(robot.frames)
    for name in robot.frames:
        found = pose(less, name, np.delete(q, indices))
        assert relative(found, pose(robot, name, q)) < DYNAMICS, name


def test_a_payload_leaves_frames_alone() -> None:
    _, robot = carried(4)
    assert pfd.with_payload(robot, pfd.Payload(1.0, (0, 0, 0.1))).frames == robot.frames


def test_frames_make_no_other_robot() -> None:
    robot = pfd.load_robot(ODD_ARM)
    assert replace(robot, frames={}) == robot
    assert replace(robot, frames={}).digest == robot.digest


def test_storing_and_loading_frames_loses_no_bit() -> None:
    for robot in (pfd.load_robot(ODD_ARM), carried(7)[1]):
        again = pfd.load_robot(pfd.robot_to_yaml(robot, frames=True))
        assert again == robot
        assert dict(again.frames) == dict(robot.frames)
        assert set(pfd.load_robot(pfd.robot_to_yaml(robot)).frames) == {robot.base, robot.tip}


TABLE = """
robot: arm
joints:
- {name: a, type: revolute, mass: 1, dh: {a: 1, d: 0, alpha_deg: 0, theta_deg: 0}}
frames:
"""


def test_a_file_may_name_frames() -> None:
    robot = pfd.load_robot(TABLE + '  grip: {link: 1, translation: [0, 0.5, 0]}')
    assert list(robot.frames) == ['base', 'grip', 'tip']
    np.testing.assert_allclose(pose(robot, 'grip', np.array([np.pi / 2]))[:3, 3], [-0.5, 1, 0])


@pytest.mark.parametrize(
    ('line', 'message'),
    [
        ('  - grip', "frames must be a table of frames by name, got ['grip']"),
        ('  grip: {}', "frame 'grip' has no 'link'"),
        ('  grip: {link: 1, size: 2}', "frame 'grip' has an unknown key 'size'"),
        ('  grip: {link: 0.5}', "link of frame 'grip' must be a whole number, got 0.5"),
        ('  grip: {link: -1}', 'link of a frame must be an integer of at least 0, got -1'),
        ('  grip: {link: 2}', "'arm': frames['grip'] must be a Frame on a link from 0 to 1"),
        ('  grip: {link: 1, translation: [0, 0]}', "translation in frame 'grip' must have shape"),
    ],
)
def test_a_wrong_frame_in_a_file_is_refused_and_named(line: str, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        pfd.load_robot(TABLE + line)


def test_frames_are_equal_when_their_numbers_are() -> None:
    frame = Frame(1, np.eye(3), np.zeros(3))
    assert frame == Frame(1, np.eye(3).tolist(), -np.zeros(3))
    assert hash(frame) == hash(copy.deepcopy(frame))
    others = [
        replace(frame, link=2),
        replace(frame, translation=[0, 0, 1e-300]),
        replace(frame, rotation=np.diag([1.0, -1.0, -1.0])),
    ]
    assert len({frame.digest, *(other.digest for other in others)}) == 4


def test_an_unknown_frame_is_named_with_the_known_frames() -> None:
    robot = pfd.load_robot(FORK, locked=FINGERS)
    known = "'base', 'arm', 'palm', 'left', 'right'"
    message = f"frame 'flange' is not carried by 'fork'; it carries {known}"
    for name in ('tip_pose', 'tip_jacobian', 'tip_velocity', 'wrench_torques'):
        with pytest.raises(ValueError, match=message):
            pfd.QUANTITIES[name](resolve_plant(robot), 'flange')


def test_the_list_of_known_frames_is_bounded() -> None:
    _, robot = carried(5)
    many = {f'{k:0200}': robot.frames['f0'] for k in range(1000)}
    with pytest.raises(ValueError, match='and 990 more') as caught:
        replace(robot, frames=many).frame('x' * 10_000)
    assert len(str(caught.value)) < 3000


@pytest.mark.parametrize(
    ('numbers', 'message'),
    [
        ((-1, np.eye(3), np.zeros(3)), 'an integer of at least 0, got -1'),
        ((1.0, np.eye(3), np.zeros(3)), 'an integer of at least 0, got 1.0'),
        ((1, np.eye(3), np.zeros(2)), 'translation of a frame on link 1 must have shape'),
        ((1, 2 * np.eye(3), np.zeros(3)), 'rotation of a frame on link 1 must be orthonormal'),
        ((1, np.eye(3), [0, 0, np.nan]), 'translation of a frame on link 1'),
    ],
)
def test_an_impossible_frame_is_refused(numbers: tuple[object, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Frame(*numbers)  # type: ignore[arg-type]


def test_a_link_may_be_an_integer_of_numpy() -> None:
    found = Frame(np.int64(1), np.eye(3), np.zeros(3))
    assert found == Frame(1, np.eye(3), np.zeros(3))
    assert type(found.link) is int


@pytest.mark.parametrize('frames', [{'x': Frame(6, np.eye(3), np.zeros(3))}, {'x': 3}, ['x']])
def test_a_frame_must_be_on_a_link_of_the_robot(frames: object) -> None:
    _, robot = carried(6)
    with pytest.raises(ValueError, match=r"'random5'.*Frame"):
        replace(robot, frames=frames)
