# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Chains from URDF agree with Pinocchio; trees and loops are refused, by the joint."""

from __future__ import annotations

import ast
from collections.abc import Mapping
import re

from bridge import resolve_plant, run_program
import numpy as np
from oracle import relative
import pinocchio as pin
import pytest
from tolerances import DYNAMICS
from urdf_models import ARM, assert_same_physics, exact_angles, example, positions_in
from zoo import BODY, FORK, ODD_ARM, STRAIGHT_ARM, TWO_ARMS, joint, link, urdf

import pfd_core as pfd


def assert_same_frames(robot: pfd.Robot, text: str, locked: Mapping[str, float]) -> None:
    """Compare pose and Jacobian of all frames with Pinocchio's, seen from the base link."""
    whole = pin.buildModelFromXML(exact_angles(text))
    data = whole.createData()
    v_at = [whole.joints[whole.getJointId(name)].idx_v for name in robot.joint_names]
    q = np.random.default_rng(8).uniform(-1.5, 1.5, robot.n)
    pin.computeJointJacobians(whole, data, positions_in(whole, robot, q, locked))
    pin.updateFramePlacements(whole, data)
    base = data.oMf[whole.getFrameId(robot.base, pin.FrameType.BODY)]
    plant = resolve_plant(robot)
    for name in robot.frames:
        index = whole.getFrameId(name, pin.FrameType.BODY)
        pose = run_program(pfd.QUANTITIES['tip_pose'](plant, name), {'q': q})['pose']
        wanted = (base.inverse() * data.oMf[index]).homogeneous
        assert relative(pose, wanted) < DYNAMICS, name
        J = pin.getFrameJacobian(whole, data, index, pin.LOCAL_WORLD_ALIGNED)[:, v_at]
        wanted = np.concatenate([base.rotation.T @ J[:3], base.rotation.T @ J[3:]])
        J = run_program(pfd.QUANTITIES['tip_jacobian'](plant, name), {'q': q})['jacobian']
        assert np.abs(J - wanted).max() < DYNAMICS * max(1.0, np.abs(wanted).max()), name


CHAINS = [
    pytest.param(ODD_ARM, {}, 6, id='odd axes'),
    pytest.param(ODD_ARM, {'tip': 'tool'}, 6, id='tip on a fixed joint'),
    pytest.param(ODD_ARM, {'base': 'turret', 'tip': 'camera', 'locked': {'j6': 0.4}}, 4, id='cut'),
    pytest.param(ODD_ARM, {'base': 'box', 'tip': 'hand'}, 5, id='base on a fixed joint'),
    pytest.param(ODD_ARM, {'locked': {'j2': 0.7, 'j3': -0.1}}, 4, id='locked inside'),
    pytest.param(ODD_ARM, {'locked': {'j1': 1.0, 'j6': -0.5}}, 4, id='locked at the ends'),
    pytest.param(STRAIGHT_ARM, {'tip': 'flange'}, 3, id='aligned'),
    pytest.param(FORK, {'locked': {'left_finger': 0.02, 'right_finger': 0.03}}, 2, id='gripper'),
    pytest.param(TWO_ARMS, {'base': 'column', 'tip': 'right_fore'}, 2, id='one of two arms'),
    # Published arms, by the file of example-robot-data.
    ('ur_description/urdf/ur5_robot.urdf', {'tip': 'ee_link'}, 6),
    ('kinova_description/robots/kinova.urdf', {}, 6),
    ('xarm_description/urdf/xarm7.urdf', {}, 7),
    ('z1_description/urdf/z1.urdf', {'locked': {'jointGripper': -0.3}}, 6),
    (
        'panda_description/urdf/panda.urdf',
        {'locked': {'panda_finger_joint1': 0.01, 'panda_finger_joint2': 0.02}},
        7,
    ),
    ('double_pendulum_description/urdf/double_pendulum_continuous.urdf', {}, 2),
]


@pytest.mark.parametrize(('text', 'choice', 'n'), CHAINS)
def test_a_chain_has_the_inertia_the_torques_and_the_frames_of_pinocchio(
    text: str, choice: dict[str, object], n: int
) -> None:
    text = text if '<' in text else example(text)
    robot = pfd.load_robot(text, **choice)
    assert robot.n == n
    assert_same_physics(robot, text, choice.get('locked', {}))
    assert_same_frames(robot, text, choice.get('locked', {}))


def test_right_angles_leave_exact_zeros_and_ones() -> None:
    robot = pfd.load_robot(STRAIGHT_ARM, tip='flange')
    elements = np.concatenate([robot.rotations.ravel(), robot.base_rotation.ravel()])
    assert set(np.abs(elements).tolist()) == {0.0, 1.0}
    # Each link lies along one coordinate axis, and each body but the last, which has two parts.
    assert ((robot.translations != 0).sum(axis=1) == 1).all()
    assert (robot.inertias[:2, [0, 0, 1], [1, 2, 2]] == 0).all()


def test_an_axis_along_z_adds_no_turn() -> None:
    text = urdf(
        'plain', link('base'), link('arm', 1, J=BODY), joint('j', 'revolute', 'base', 'arm')
    )
    robot = pfd.load_robot(text)
    np.testing.assert_array_equal(robot.base_rotation, np.eye(3))
    np.testing.assert_array_equal(robot.rotations[0], np.eye(3))


def test_limits_and_friction_come_from_the_file() -> None:
    robot = pfd.load_robot(ODD_ARM)
    assert robot.joint_types == (
        *('revolute', 'continuous', 'prismatic', 'revolute', 'continuous', 'revolute'),
    )
    free = np.inf
    np.testing.assert_array_equal(robot.position_lower, [-1, -free, -2, -2, -free, -2])
    np.testing.assert_array_equal(robot.position_upper, [1.5, free, 2.5, 2.5, free, 2.5])
    np.testing.assert_array_equal(robot.velocity_limit, [2, free, 3, 3, free, 3])
    np.testing.assert_array_equal(robot.effort_limit, [60, free, 40, 40, free, 40])
    np.testing.assert_array_equal(robot.damping, [0.7, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(robot.friction, [0.3, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(robot.armature, np.zeros(6))


def test_links_fixed_beyond_the_tip_keep_their_mass() -> None:
    whole, cut = pfd.load_robot(ODD_ARM, tip='hand'), pfd.load_robot(ODD_ARM, tip='wrist')
    assert cut.masses[-1] == whole.masses[-1] == pytest.approx(0.8 + 0.5, rel=DYNAMICS)


def test_the_positions_at_which_an_error_proposes_to_lock_are_within_the_limits() -> None:
    limits = '<limit lower="{}" upper="{}" velocity="3" effort="40"/>'
    joints = (
        joint('a', 'revolute', 'base', 'one'),
        joint('b', 'revolute', 'one', 'two', extra=limits.format(-2.0, -0.5)),
        joint('c', 'revolute', 'one', 'three', extra=limits.format(0.25, 2.0)),
    )
    links = (link('base'), *(link(name, 1.0, J=BODY) for name in ('one', 'two', 'three')))
    text = urdf('fork', *links, *joints)
    with pytest.raises(pfd.TreeError) as refused:
        pfd.load_robot(text)
    cure = re.search(r'locked=({.*})', str(refused.value))
    assert cure is not None
    locked = ast.literal_eval(cure[1])
    assert locked == {'b': -0.5, 'c': 0.25}
    assert pfd.load_robot(text, locked=locked).joint_names == ('a',)


def test_a_mimic_joint_may_be_locked() -> None:
    text = FORK.replace('<axis xyz="0 -1 0"/>', '<axis xyz="0 -1 0"/><mimic joint="left_finger"/>')
    assert pfd.load_robot(text, locked={'left_finger': 0.0, 'right_finger': 0.0}).n == 2


def test_joints_that_mimic_a_locked_joint_are_locked_at_positions_that_follow() -> None:
    left = '<mimic joint="right_finger" multiplier="-2" offset="0.05"/>'
    right = '<mimic joint="wrist"/>'
    # The finger that follows a follower stands before it in the file.
    text = re.sub(r'(name="left_finger".*?<axis [^>]*/>)', rf'\1{left}', FORK, flags=re.S)
    text = re.sub(r'(name="right_finger".*?<axis [^>]*/>)', rf'\1{right}', text, flags=re.S)
    robot = pfd.load_robot(text, locked={'wrist': 0.01})
    at = {'wrist': 0.01, 'right_finger': 0.01, 'left_finger': -2 * 0.01 + 0.05}
    assert robot == pfd.load_robot(FORK, locked=at)
    assert pfd.load_robot(text, locked={'wrist': 0.01, 'left_finger': 0.0}) == pfd.load_robot(
        FORK, locked=at | {'left_finger': 0.0}
    )


BAD = [
    pytest.param(FORK, {}, "'left_finger', 'right_finger'.*tip='left'.*locked=", id='tree'),
    pytest.param(
        FORK, {'tip': 'palm'}, "'left_finger', 'right_finger' also move.*lock", id='beyond the tip'
    ),
    pytest.param(
        TWO_ARMS, {'tip': 'left_fore'}, "'right_shoulder', 'right_elbow' also move", id='two arms'
    ),
    pytest.param(ODD_ARM, {'base': 'nowhere'}, "base 'nowhere'.*'world'", id='unknown base'),
    pytest.param(ODD_ARM, {'tip': 'nowhere'}, "tip 'nowhere'.*'world'", id='unknown tip'),
    pytest.param(ODD_ARM, {'base': 'hand', 'tip': 'upper'}, 'not below base', id='upside down'),
    pytest.param(ODD_ARM, {'base': 'hand', 'tip': 'tool'}, 'no joint moves', id='rigid'),
    pytest.param(ODD_ARM, {'base': 'hand'}, "no joint moves below 'hand'", id='nothing below'),
    pytest.param(ODD_ARM, {'locked': {'j9': 0.0}}, "'j9'.*no such joint.*'j1'", id='lock unknown'),
    pytest.param(ODD_ARM, {'locked': {'mount': 0.0}}, "'mount'.*fixed joint", id='lock a weld'),
    pytest.param(
        ODD_ARM, {'locked': {'j1': np.nan}}, "'j1' is locked must be finite", id='lock at nan'
    ),
    pytest.param(
        ODD_ARM,
        {'locked': {'j1': 1.6}},
        "cannot lock joint 'j1' at 1.6: its limits are -1.0 and 1.5",
        id='lock beyond a limit',
    ),
    pytest.param('<robot name="x"><link', {}, 'not well-formed XML', id='malformed'),
    pytest.param('<model/>', {}, 'starts with <robot>', id='not a robot'),
    pytest.param('<robot name="x"/>', {}, 'no <link>', id='empty'),
    pytest.param(
        urdf('x', *ARM, joint('hinge', 'floating', 'base', 'arm')),
        *({}, "'hinge' is floating.*base='arm'"),
        id='floating',
    ),
    pytest.param(
        urdf('x', *ARM, joint('hinge', 'planar', 'base', 'arm')),
        {},
        "'hinge' is planar",
        id='plane',
    ),
    pytest.param(
        urdf('x', *ARM, joint('hinge', 'ball', 'base', 'arm')),
        {},
        "'hinge' has type 'ball'",
        id='b',
    ),
    pytest.param(
        FORK.replace('<axis xyz="1 0 0"/>', '<axis xyz="1 0 0"/><mimic joint="shoulder"/>'),
        *({'locked': {'left_finger': 0, 'right_finger': 0}}, "'wrist' mimics 'shoulder'.*lock"),
        id='mimic',
    ),
    pytest.param(
        urdf('x', link('base'), link('arm'), joint('j', 'continuous', 'base', 'arm', extra='')),
        *({}, "link 'arm', moved by joint 'j', has no <inertial>"),
        id='weightless',
    ),
    pytest.param(
        urdf('x', *ARM, joint('j', 'revolute', 'base', 'arm', axis='0 0 0')),
        {},
        "<axis xyz> of joint 'j'",
        id='axis',
    ),
    pytest.param(
        urdf('x', *ARM, joint('j', 'revolute', 'base', 'leg')), {}, "link 'leg'", id='no such link'
    ),
    pytest.param(urdf('x', *ARM), {}, "one link without a parent.*'base', 'arm'", id='two roots'),
    pytest.param(
        urdf(
            *('x', *ARM, link('c', 1, J=BODY), joint('j', 'revolute', 'base', 'arm')),
            *(joint('k', 'revolute', 'arm', 'c'), joint('l', 'revolute', 'base', 'c')),
        ),
        *({}, "'c' hangs on joints 'k' and 'l'"),
        id='loop',
    ),
    pytest.param(
        urdf(
            'x', link('base'), link('arm', 1, J='a 1 1 0 0 0'), joint('j', 'fixed', 'base', 'arm')
        ),
        *({}, "<inertia ixx> of link 'arm'.*'a'"),
        id='inertia of letters',
    ),
    pytest.param(
        urdf('x', link('base'), link('arm', -1, J=BODY), joint('j', 'revolute', 'base', 'arm')),
        *({}, "<mass value> of link 'arm' must not be negative"),
        id='negative mass',
    ),
]


@pytest.mark.parametrize(('text', 'choice', 'message'), BAD)
def test_a_robot_that_is_no_chain_is_refused_and_named(
    text: str, choice: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        pfd.load_robot(text, **choice)


def test_a_floating_joint_above_the_base_is_cut_off() -> None:
    text = urdf(
        *('x', *ARM, link('fore', 1, J=BODY), joint('free', 'floating', 'base', 'arm')),
        joint('j', 'revolute', 'arm', 'fore', '0.1 0 0'),
    )
    assert pfd.load_robot(text, base='arm').joint_names == ('j',)


def test_the_physics_check_finds_a_wrong_robot() -> None:
    robot = pfd.lock(pfd.load_robot(ODD_ARM), {'j2': 0.7})
    with pytest.raises(AssertionError):
        assert_same_physics(robot, ODD_ARM, {'j2': 0.7001})


# The second joint is 1.8e-9 short of a right angle.
NEARLY = urdf(
    'nearly',
    *(link('base'), link('arm', 1, '0.1 0 0', J=BODY), link('hand', 1, '0.1 0 0', J=BODY)),
    joint('first', 'revolute', 'base', 'arm', '0 0 1', '0 0 1.5707963267948966'),
    joint('second', 'revolute', 'arm', 'hand', '1 0 0', '1.570796325 0 0'),
)


def test_a_nearly_right_angle_is_made_exact_and_its_joint_named() -> None:
    robot = pfd.load_robot(NEARLY)
    assert robot.snapped_joints == ('second',)
    assert set(np.abs(robot.rotations[0]).ravel().tolist()) == {0.0, 1.0}


def test_right_angles_can_be_left_as_written() -> None:
    robot = pfd.load_robot(NEARLY, right_angle=-1.0)
    assert robot.snapped_joints == ()
    # 1.8e-9 short of a right angle: so large is the cosine.
    off = np.pi / 2 - 1.570796325
    assert np.abs(robot.rotations[0]).max() <= 1
    assert np.isclose(np.abs(robot.rotations[0][1, 1]), np.sin(off), rtol=1e-6)
    assert pfd.load_robot(NEARLY, right_angle=1e-9).snapped_joints == ()
