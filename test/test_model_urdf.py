# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""URDFs: as Pinocchio reads them; rotors, right angles, limits, and what is not read."""

from __future__ import annotations

from collections.abc import Mapping
import re

import numpy as np
from oracle import DYNAMICS, assert_same_physics, positions_in, relative
import pinocchio as pin
import pytest
from zoo import (
    BODY,
    FORK,
    ODD_ARM,
    STRAIGHT_ARM,
    TWO_ARMS,
    changed,
    exact_angles,
    example_urdf,
    joint,
    link,
    urdf,
)

import pfd_core as pfd
from pfd_core.machine.emulator import run as run_program
from pfd_core.model.plant import resolve as resolve_plant


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


@pytest.mark.filterwarnings('ignore:URDF text. not read.*mu_coulomb:pfd_core.PhysicsWarning')
@pytest.mark.filterwarnings("ignore:'URDF text'. taken as unlimited:pfd_core.PhysicsWarning")
@pytest.mark.parametrize(('text', 'choice', 'n'), CHAINS)
def test_a_chain_has_the_inertia_the_torques_and_the_frames_of_pinocchio(
    text: str, choice: dict[str, object], n: int
) -> None:
    text = text if '<' in text else example_urdf(text)
    robot = pfd.load_robot(text, **choice)
    assert robot.n == n
    assert_same_physics(robot, text, choice.get('locked', {}))
    assert_same_frames(robot, text, choice.get('locked', {}))


def mounted(side: str, y: float, rpy: str) -> tuple[str, ...]:
    """Return links and joints of an arm on a tilted mount."""
    return (
        *(link(f'{side}_base'), link(f'{side}_1', 3, '0 0.02 0.15', J=BODY)),
        link(f'{side}_2', 2, '0 0 0.2', J=BODY),
        joint(f'{side}_mount', 'fixed', 'body', f'{side}_base', f'0 {y} 0.6', rpy),
        joint(f'{side}_j1', 'revolute', f'{side}_base', f'{side}_1', '0 0 0.1'),
        joint(f'{side}_j2', 'revolute', f'{side}_1', f'{side}_2', '0 0 0.3', axis='0 1 0'),
    )


# Two arms on the sides of a body, which is on a table that tilts.
MOUNTED = urdf(
    'mounted',
    *(link('world'), link('table'), link('body', 9, J=BODY)),
    joint('tilt', 'revolute', 'world', 'table', axis='0 1 0'),
    joint('lift', 'prismatic', 'table', 'body', rpy='0.1 0 0.3'),
    *mounted('left', 0.1, '-1.5707963267948966 0 0'),
    *mounted('right', -0.1, '1.3 0.2 -0.4'),
)


@pytest.mark.parametrize(
    ('text', 'choice'),
    [
        (MOUNTED, {'base': 'left_base', 'tip': 'left_2'}),
        (MOUNTED, {'base': 'right_base', 'tip': 'right_2'}),
        (MOUNTED, {'base': 'left_base', 'tip': 'left_2', 'locked': {'tilt': 0.5}}),
        (MOUNTED, {'base': 'right_base', 'tip': 'right_2', 'locked': {'tilt': 0.5, 'lift': 0.2}}),
        (ODD_ARM, {'base': 'pedestal'}),
        (ODD_ARM, {'base': 'box', 'tip': 'hand', 'locked': {'j1': -0.7}}),
        (TWO_ARMS, {'base': 'column', 'tip': 'right_fore'}),
    ],
    ids=range(7),
)
def test_gravity_belongs_to_the_root_whatever_link_is_the_base(
    text: str, choice: dict[str, object]
) -> None:
    robot = pfd.load_robot(text, **choice)
    locked = choice.get('locked', {})
    assert_same_frames(robot, text, locked)
    whole = pin.buildModelFromXML(text)
    data = whole.createData()
    at = [whole.joints[whole.getJointId(name)].idx_v for name in robot.joint_names]
    rng = np.random.default_rng(3)
    # In YAML and in URDF the robot keeps the direction of gravity.
    again = pfd.load_robot(pfd.robot_to_yaml(robot))
    assert again == robot
    written = pfd.load_robot(pfd.robot_to_urdf(robot), base=robot.base, tip=robot.tip)
    np.testing.assert_allclose(written.root_rotation, robot.root_rotation, atol=1e-14)
    for gravity in ((0.0, 0.0, -9.81), (3.0, -2.0, 5.0)):
        whole.gravity.linear = np.array(gravity)
        plant = resolve_plant(robot, pfd.Scene(gravity=gravity))
        torques, energy = (pfd.QUANTITIES[name](plant) for name in ('gravity_torques', 'energy'))
        potential = []
        for q in rng.uniform(-1.5, 1.5, (2, robot.n)):
            whole_q = positions_in(whole, robot, q, locked)
            wanted = pin.computeGeneralizedGravity(whole, data, whole_q)[at]
            (found,) = run_program(torques, {'q': q}).values()
            np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12)
            wanted = pin.computePotentialEnergy(whole, data, whole_q)
            (found,) = run_program(energy, {'q': q, 'qd': 0 * q}).values()
            potential.append((found[1], wanted))
        (first, wanted_first), (second, wanted_second) = potential
        assert second - first == pytest.approx(wanted_second - wanted_first, abs=1e-11)


def test_right_angles_leave_exact_zeros_and_ones() -> None:
    robot = pfd.load_robot(STRAIGHT_ARM, tip='flange')
    elements = np.concatenate([robot.rotations.ravel(), robot.base_rotation.ravel()])
    assert set(np.abs(elements).tolist()) == {0.0, 1.0}
    # Each link lies along one coordinate axis, and each body but the last, which has two parts.
    assert ((robot.translations != 0).sum(axis=1) == 1).all()
    assert (robot.inertias[:2, [0, 0, 1], [1, 2, 2]] == 0).all()


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


def turned_by(*quaternions: str, version: str = ' version="1.1"') -> str:
    """Return a chain of one joint a quaternion, and its inertial frames turned by them too."""
    links = [link('base')]
    joints = []
    for k, turn in enumerate(quaternions):
        name = f'l{k}'
        body = link(name, 1.0 + k, '0.1 0.2 -0.3', J=BODY)
        links.append(body.replace('rpy="0 0 0"', f'quat_xyzw="{turn}"'))
        at = joint(f'j{k}', 'continuous', f'l{k - 1}' if k else 'base', name, '0.2 0.1 0.3')
        joints.append(at.replace('rpy="0 0 0"', f'quat_xyzw="{turn}"'))
    return urdf('turned', *links, *joints).replace('<robot', f'<robot{version}', 1)


# Any norm; at a pitch of 90 and -90 degrees; half a turn about each axis.
QUATERNIONS = (
    *('0.1 -0.7 0.3 0.9', '0 0.7071 0 0.7071', '0.5 -0.5 0.5 0.5', '0 0 3 0', '1 0 0 0'),
    *('0 -1 0 0', '-0.2 0.4 -1.1 -0.3'),
)


def test_orientations_of_version_1_1_may_be_quaternions() -> None:
    text = turned_by(*QUATERNIONS)
    robot = pfd.load_robot(text)
    assert_same_physics(robot, text, {})
    assert_same_frames(robot, text, {})


def test_a_quaternion_of_right_angles_leaves_exact_zeros_and_ones() -> None:
    h = '0.70710678118654752'
    text = turned_by(f'0 {h} 0 {h}', f'0 0 -{h} {h}', '0 0.7071 0.7071 0', '0.5 0.5 0.5 0.5')
    robot = pfd.load_robot(text)
    assert {0.0, 1.0} == set(np.abs(robot.rotations).ravel().tolist())


def test_a_quaternion_in_version_1_0_is_not_read_but_named_as_pinocchio_does() -> None:
    for version in ('', ' version="1.0"'):
        text = turned_by('0.1 -0.7 0.3 0.9', '0 0 1 1', version=version)
        with pytest.warns(
            pfd.PhysicsWarning, match=r'quat_xyzw= \(line 4\) and 3 more \(read in version 1.1'
        ):
            robot = pfd.load_robot(text)
        assert_same_physics(robot, text, {})


# Text of ODD_ARM, what replaces it, and how it is named.
UNREAD = [
    *(
        (old, f'{old} {attribute}="5"', f'{element} {attribute}=')
        for old, attribute, element in (
            ('<limit lower="-1"', 'acceleration', '<limit>'),
            ('<limit lower="-1"', 'jerk', '<limit>'),
            ('<dynamics damping="0.7"', 'mu_viscous', '<dynamics>'),
            ('<mass value="4.0"', 'unit', '<mass>'),
            ('<inertia ixx="0.02"', 'unit', '<inertia>'),
            ('<axis xyz="0.3 -0.5 0.8"', 'rpy', '<axis>'),
            ('<origin xyz="0.01 -0.02 0.1"', 'wxyz', '<origin>'),
            ('<transmission name="t"', 'reduction', "<transmission name='t'>"),
        )
    ),
    # Attributes in place of elements, and elements in place of attributes.
    ('<dynamics damping="0.7"', '<dynamics><damping>1</damping></dynamics><x', '<damping>'),
    ('<joint name="j1"', '<joint name="j1" axis="0 1 0"', 'axis='),
    ('<link name="turret">', '<link name="turret" mass="3">', 'mass='),
    ('<mass value="4.0"/>', '<mass value="4.0"><unit>g</unit></mass>', '<unit>'),
    # What acts on joints, or closes a loop.
    ('</robot>', '<loop_joint name="l" type="revolute"/></robot>', '<loop_joint>'),
    *(
        ('</robot>', f'<gazebo reference="j1"><{tag}>2</{tag}></gazebo></robot>', f'<{tag}>')
        for tag in ('springStiffness', 'springReference')
    ),
]


@pytest.mark.parametrize(('old', 'new', 'named'), UNREAD)
def test_physics_that_is_not_read_is_named(old: str, new: str, named: str) -> None:
    text = ODD_ARM.replace('</robot>', '<transmission name="t"/></robot>')
    assert old in text
    with pytest.warns(pfd.PhysicsWarning, match='not read.*' + re.escape(named)) as found:
        robot = pfd.load_robot(text.replace(old, new, 1))
    assert len(found) == 1
    assert (robot == pfd.load_robot(ODD_ARM)) == (named != '<damping>')


def test_attributes_of_many_joints_that_are_not_read_are_named_once_with_their_number() -> None:
    text = example_urdf('panda_description/urdf/panda.urdf')
    locked = {'panda_finger_joint1': 0.01, 'panda_finger_joint2': 0.02}
    with pytest.warns(pfd.PhysicsWarning) as found:
        pfd.load_robot(text, locked=locked)
    (warning,) = [item for item in found if 'not read' in str(item.message)]
    assert "<joint name='panda_joint1'> <dynamics> mu_coulomb= (line 48) and 6 more" in str(
        warning.message
    )


# ---- rotors ----


FINGERS = {'left_finger': 0.0, 'right_finger': 0.0}
ROTOR = '<motorInertia>2</motorInertia>'
RATIO = '<mechanicalReduction>50</mechanicalReduction>'
SHOULDER, WRIST = (f'<joint name="{name}"/>' for name in ('shoulder', 'wrist'))
# A rotor of the wrist, with a reduction in each place where one may be written.
PLACED = f'{{}}<joint name="wrist">{{}}</joint><actuator name="m">{{}}{ROTOR}</actuator>'


def motor(content: str, joints: str = WRIST) -> str:
    return f'{joints}<actuator name="motor">{content}</actuator>'


def geared(*transmissions: str) -> str:
    """Return FORK with transmissions of some contents."""
    end = ''.join(f'<transmission name="gear">{inner}</transmission>' for inner in transmissions)
    text = FORK.replace('<robot ', '<robot xmlns:drake="http://drake.mit.edu" ', 1)
    return text.replace('</robot>', f'{end}</robot>')


DRAKE = motor('<drake:rotor_inertia value="1.5e-4"/><drake:gear_ratio value="-120"/>', SHOULDER)
TWO_MOTORS = motor(f'{ROTOR}{RATIO}</actuator><actuator name="other">{ROTOR}{RATIO}')
ROTORS = [
    ((DRAKE, TWO_MOTORS), [1.5e-4 * 120**2, 2 * 2 * 50**2]),
    ((motor('<drake:rotor_inertia value="0.02"/>', SHOULDER),), [0.02, 0.0]),
    ((motor(RATIO, SHOULDER + WRIST),), [0.0, 0.0]),
    # Where ROS 1 and ROS 2 write it.
    *(
        ((PLACED.format(*places),), [0.0, 2 * 50**2])
        for places in (
            *((RATIO, '', ''), ('', RATIO, ''), ('', '', RATIO), (RATIO, RATIO, RATIO)),
            ('', RATIO.replace('alR', 'al_r'), ''),
        )
    ),
]


@pytest.mark.parametrize(('transmissions', 'armature'), ROTORS, ids=range(len(ROTORS)))
def test_rotors_of_a_urdf_are_seen_through_their_gears(
    transmissions: tuple[str, ...], armature: list[float]
) -> None:
    text = geared(*transmissions)
    found = pfd.load_robot(text, locked=FINGERS).armature
    np.testing.assert_allclose(found, armature, rtol=1e-15)
    # A rotor of a locked joint does not turn.
    locked = pfd.load_robot(text, locked=FINGERS | {'shoulder': 0.1})
    np.testing.assert_allclose(locked.armature, armature[1:], rtol=1e-15)


@pytest.mark.parametrize(
    ('inner', 'message'),
    [
        (motor(ROTOR, '<joint name="elbow"/>'), "'gear' .* one joint .* got .'elbow'."),
        (motor(ROTOR, SHOULDER + WRIST), "'gear' .* must have one joint"),
        (motor(ROTOR, ''), "'gear' .* must have one joint of the URDF, got"),
        (motor(ROTOR.replace('2', 'heavy')), "motorInertia of .*'gear' must be a num"),
        (motor('<drake:rotor_inertia/>'), "rotor_inertia of transmission 'gear' must be a num"),
        (motor(ROTOR.replace('2', '-1')), "'gear': rotor_inertia must not be neg"),
        (motor(ROTOR + RATIO.replace('50', '0')), "'gear': gear_ratio must not be zero"),
        (
            PLACED.format('', RATIO, RATIO.replace('50', '1')),
            r"transmission 'gear' states 2 reductions, 1\.0, 50\.0",
        ),
    ],
    ids=range(8),
)
def test_a_wrong_transmission_is_named(inner: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pfd.load_robot(geared(inner), locked=FINGERS)


def test_a_rotor_outside_of_the_actuator_is_named() -> None:
    outside = f'{ROTOR}{motor("")}', f'<joint name="wrist">{ROTOR}</joint><actuator name="m"/>'
    for inner in outside:
        with pytest.warns(pfd.PhysicsWarning, match="not read: <transmission name='gear'> <motor"):
            assert not pfd.load_robot(geared(inner), locked=FINGERS).armature.any()


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


def test_angles_are_those_of_the_file_to_rounding_where_right_angle_is_negative() -> None:
    q, qd, qdd = np.random.default_rng(9).uniform(-1, 1, (3, 2))
    for angle, rounded in (('1.570796325', True), ('1.5708', False)):
        text = NEARLY.replace('1.570796325', angle)
        model = pin.buildModelFromXML(text)
        expected = pin.rnea(model, model.createData(), q, qd, qdd)
        for slack, exact in ((-1, True), (None, not rounded)):
            given = {} if slack is None else {'right_angle': slack}
            robot = pfd.load_robot(text, **given)
            assert robot.snapped_joints == (() if exact else ('second',))
            error = relative(pfd.inverse_dynamics(robot, q, qd, qdd), expected)
            assert (error < 1e-12) == exact


def test_a_limit_may_be_infinite_and_its_ends_be_left_out() -> None:
    text = changed(
        'lower="-1" upper="1.5" velocity="2"', 'lower="-inf" upper="inf" velocity="inf"'
    )
    robot = pfd.load_robot(text)
    assert robot.position_lower[0] == -np.inf
    assert (robot.position_upper[0], robot.velocity_limit[0]) == (np.inf, np.inf)
    # The format gives 0 to an end that is not there.
    robot = pfd.load_robot(changed('lower="-1" upper="1.5" ', ''))
    assert (robot.position_lower[0], robot.position_upper[0]) == (0.0, 0.0)


def test_a_body_that_cannot_be_is_not_hidden_by_the_one_it_is_welded_to() -> None:
    box = '<mass value="0.6"/><inertia ixx="0.02" iyy="0.03" izz="0.025"'
    with pytest.raises(ValueError, match="<mass value> of link 'box' must not be negative"):
        pfd.load_robot(changed(box, box.replace('0.6', '-0.6')))
    with pytest.raises(ValueError, match="<inertia> of link 'box' must not be negative in any"):
        pfd.load_robot(changed(box, box.replace('0.02', '-0.02')))
    # By rounding it may: in CAD, a link of 0.5 kg and 0.1 m whose smallest moment is below zero.
    text = urdf(
        *('x', link('base'), link('arm', 0.5, '0.1 0 0', '0 0 0', '-5e-20 1e-19 1e-19 0 0 0')),
        joint('j', 'revolute', 'base', 'arm'),
    )
    assert pfd.load_robot(text).masses[0] == 0.5


def test_a_massless_link_within_the_chain_is_loaded_and_warned_of() -> None:
    text = urdf(
        *('x', link('base'), link('virtual'), link('arm', 1, '0.1 0.2 0.3', J=BODY)),
        joint('yaw', 'revolute', 'base', 'virtual'),
        joint('pitch', 'revolute', 'virtual', 'arm', axis='0 1 0'),
    )
    with pytest.warns(
        pfd.PhysicsWarning, match="link 'virtual', moved by joint 'yaw', has no <in"
    ):
        robot = pfd.load_robot(text)
    assert robot.masses.tolist() == [0.0, 1.0]
    assert_same_physics(robot, text, {})
    explicit = text.replace('<link name="virtual"/>', link('virtual', J='0 0 0 0 0 0'))
    assert pfd.load_robot(explicit) == robot
    with pytest.raises(ValueError, match="link 'arm', moved by joint 'pitch', has no <inertial>"):
        pfd.load_robot(re.sub('<link name="arm">.*</link>', '<link name="arm"/>', explicit))


def test_the_other_half_of_an_inertia_may_be_written_and_must_be_the_same() -> None:
    inertia = 'ixx="0.1" ixy="0.01" ixz="-0.02" iyy="0.2" iyz="0.03" izz="0.25"'
    old = re.search(r'<inertia ([^/]*)/>', ODD_ARM[ODD_ARM.index('name="turret"') :])
    assert old is not None
    turret = ODD_ARM.index('name="turret"')
    text = ODD_ARM[:turret] + ODD_ARM[turret:].replace(old[1], inertia, 1)
    whole = text.replace(inertia, f'{inertia} iyx="0.01" izx="-0.02" izy="0.0300000001"')
    assert pfd.load_robot(whole) == pfd.load_robot(text)
    for key, same, value in (('iyx', 'ixy', 0.01), ('izx', 'ixz', -0.02), ('izy', 'iyz', 0.03)):
        with pytest.raises(
            ValueError, match=f"<inertia {key}> of link 'turret' must equal {same}, {value}, got 0"
        ):
            pfd.load_robot(text.replace(inertia, f'{inertia} {key}="0"'))


NAMED = """
<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro" xmlns:drake="http://drake.mit.edu">
  <link name="base"/>
  <link name="upper">
    <inertial>
      <origin xyz="0 0 1" rpy="0 0 0"/>
      <mass value="1"/>
      <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>
    </inertial>
    <visual name="v"><geometry><box size="1 1 1"/></geometry></visual>
    <collision><origin xzy="0 0 0"/></collision>
  </link>
  <joint name="shoulder" type="revolute">
    <origin xyz="0 0 0" rpy="0 0 0"/>
    <parent link="base"/>
    <child link="upper"/>
    <axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="9" velocity="9"/>
    <dynamics damping="1" friction="0.5"/>
    <safety_controller k_velocity="1" soft_lower_limit="-2"/>
    <calibration rising="0"/>
  </joint>
  <gazebo reference="upper"><links/></gazebo>
  <ros2_control name="arm" type="system"><joints/></ros2_control>
  <transmission name="t"><types>x</types><leftActuator/></transmission>
  <material name="blue"/>
</robot>
"""


def test_elements_of_other_tools_are_not_named() -> None:
    assert pfd.load_robot(NAMED).friction.tolist() == [0.5]


def arm_of(first: str, last: str = '', rpy: str = '0 0 0') -> str:
    """Return an arm of 0.5 m whose two links have bodies: mass, centre and three moments."""
    bodies = []
    for name, numbers in (('upper', first), ('fore', last or '1 0.1 0 0 0.01 0.01 0.01')):
        mass, x, y, z, *moments = numbers.split()
        bodies.append(link(name, float(mass), f'{x} {y} {z}', J=f'{" ".join(moments)} 0 0 0'))
    return urdf(
        *('arm', link('base'), *bodies, joint('shoulder', 'revolute', 'base', 'upper', rpy=rpy)),
        joint('elbow', 'revolute', 'upper', 'fore', '0.3 0.4 0'),
    )


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        (
            arm_of('51.3 0.1 0 0 16600 16600 10000'),
            "'upper' (line 4) has a radius of gyration of 18 m",
        ),
        # As in Doosan's a0509: in the frame of the base.
        (
            arm_of('3.785 -0.3 0.2 0.4 0.01 0.01 0.01'),
            "'upper' (line 4) has its centre 0.539 m from",
        ),
        (
            arm_of('1 0.1 0 0 0.01 0.01 0.01', '1 80 0 0 0.01 0.01 0.01'),
            "'fore' (line 5) has its centre",
        ),
        # As in Doosan's m1013, which is longer than its wrong centre is far.
        (
            urdf(
                *('arm', link('base'), link('upper', 3, '0.4 0 0', J=BODY)),
                *(link('wrist', 2, '1.1 0 0', J=BODY), link('hand', 1, J=BODY)),
                joint('shoulder', 'revolute', 'base', 'upper', '0 0 0.3'),
                joint('elbow', 'revolute', 'upper', 'wrist', '0.9 0 0', axis='0 1 0'),
                joint('roll', 'revolute', 'wrist', 'hand', '0.12 0 0', axis='1 0 0'),
            ),
            "'wrist' (line 5) has its centre 1.1 m from its frame (0.12 m of the arm are beyond",
        ),
        (arm_of('1 0.1 0 0 0.01 0.01 0.01', rpy='90 0 0'), "joint 'shoulder' has more than a who"),
    ],
    ids=['g', 'base frame', 'last', 'long arm', 'degrees'],
)
def test_a_size_that_no_body_of_the_arm_has_is_warned_of_and_taken_as_written(
    text: str, words: str
) -> None:
    with pytest.warns(pfd.PhysicsWarning) as found:
        robot = pfd.load_robot(text)
    (warning,) = found
    assert words in str(warning.message)
    assert warning.filename == __file__
    assert_same_physics(robot, text, {})


def test_bodies_as_long_as_the_arm_and_a_last_one_that_is_longer_are_not_warned_of() -> None:
    cart = urdf(
        *('cart', link('rail'), link('cart', 1, J='0.2 0.2 0.2 0 0 0')),
        *(link('pole', 0.1, '0 0 0.5', J=BODY), joint('slide', 'prismatic', 'rail', 'cart')),
        joint('hinge', 'continuous', 'cart', 'pole', '0 0 0.1', axis='0 1 0', extra=''),
    )
    pendulum = urdf(
        'pendulum',
        link('base'),
        link('rod', 1, '0 0 4', J=BODY),
        joint('hinge', 'continuous', 'base', 'rod', axis='0 1 0', extra=''),
    )
    for text in (arm_of('2 0.5 0 0 0.4 0.4 0.4', '1 1.5 0 0 1 1 1'), cart, pendulum):
        assert pfd.load_robot(text).n > 0


ENDS, MOTOR = ('position_lower', 'position_upper'), ('velocity_limit', 'effort_limit')


@pytest.mark.parametrize(
    ('limit', 'text', 'unlimited'),
    [
        ('', 'no <limit>', (*ENDS, *MOTOR)),
        ('<limit lower="-1" upper="1.5" effort="60"/>', 'no velocity', MOTOR[:1]),
        ('<limit lower="-1" upper="1.5" velocity="2"/>', 'no effort', MOTOR[1:]),
        ('<limit lower="-1" upper="1.5" velocity="0" effort="60"/>', 'velocity 0.0', MOTOR[:1]),
        (
            '<limit lower="-1" upper="1.5" velocity="-1" effort="-1"/>',
            'velocity -1.0, effort -1.0',
            MOTOR,
        ),
        (
            '<limit lower="1.5" upper="-1" velocity="2" effort="60"/>',
            'lower 1.5 above upper',
            ENDS,
        ),
    ],
)
def test_limits_that_are_missing_or_mean_none_are_infinite_and_named_in_one_warning(
    limit: str, text: str, unlimited: tuple[str, ...]
) -> None:
    old = '<limit lower="-1" upper="1.5" velocity="2" effort="60"/>'
    with pytest.warns(pfd.PhysicsWarning) as found:
        robot = pfd.load_robot(changed(old, limit))
    (warning,) = found
    assert f"unlimited: 'j1' ({text}" in str(warning.message)
    assert warning.filename == __file__
    infinite = {key for key in (*ENDS, *MOTOR) if np.isinf(getattr(robot, key)[0])}
    assert infinite == set(unlimited)
    # What the warning proposes gives the same robot, without a warning.
    attribute = '([a-z]+)="([^"]+)"'
    repaired = dict(re.findall(attribute, limit + str(warning.message)))
    text = ' '.join(f'{key}="{value}"' for key, value in repaired.items())
    assert pfd.load_robot(changed(old, f'<limit {text}/>')) == robot


def test_limits_of_a_yaml_file_mean_none_as_those_of_a_urdf() -> None:
    text = pfd.robot_to_yaml(pfd.load_robot(ODD_ARM)).replace('effort: 60.0', 'effort: 0.0')
    with pytest.warns(pfd.PhysicsWarning, match=r"'j1' \(effort 0\.0\)\. .* effort: \.inf$"):
        assert pfd.load_robot(text).effort_limit[0] == np.inf


def test_a_joint_with_crossed_ends_may_be_locked_anywhere() -> None:
    text = changed('lower="-1" upper="1.5"', 'lower="1.5" upper="-1"')
    assert pfd.load_robot(text, locked={'j1': 3.0}).n == pfd.load_robot(ODD_ARM).n - 1


def test_names_that_are_not_read_are_named_in_one_warning_at_the_line_that_loads() -> None:
    text = NAMED.replace(' friction=', ' Friction=').replace('transmission', 'transmision')
    with pytest.warns(pfd.PhysicsWarning) as found:
        pfd.load_robot(text.replace('xyz="0 0 1"', 'xzy="0 0 1"'))
    (warning,) = found
    for place in ('<origin> xzy=', '<dynamics> Friction=', '<transmision>'):
        assert place in str(warning.message)
    assert warning.filename == __file__
