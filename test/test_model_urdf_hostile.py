# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A URDF that other readers get wrong: loaded right, or refused with its link or joint named."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest
from urdf_models import ARM, assert_same_physics
from zoo import BODY, ODD_ARM, joint, link, urdf

import pfd_core as pfd


def changed(old: str, new: str) -> str:
    assert old in ODD_ARM, old
    return ODD_ARM.replace(old, new, 1)


NO_NUMBERS = (
    '',
    'nan',
    '1_0',
    '\u0664',
    '0x10',
    '1,5',
    '1 2',
    '4.0kg',
    '1e400',
    '1e101',
    '1e-400',
)
# Where a number is, with %s in its place, and the words by which an error names it.
PLACES = {
    '<mass value="%s"/>': ('4.0', "<mass value> of link 'turret'"),
    'ixx="%s"': ('0.02', "<inertia ixx> of link 'pedestal'"),
    'xyz="0.01 %s 0.1"': ('-0.02', "<origin xyz> of link 'turret'"),
    'rpy="0.3 %s 0.5"': ('-0.2', "<origin rpy> of link 'turret'"),
    'damping="%s"': ('0.7', "<dynamics damping> of joint 'j1'"),
    '<axis xyz="%s -0.5 0.8': ('0.3', "<axis xyz> of joint 'j2'"),
    'lower="%s"': ('-1', "<limit lower> of joint 'j1'"),
    'upper="%s"': ('1.5', "<limit upper> of joint 'j1'"),
    'velocity="%s"': ('2', "<limit velocity> of joint 'j1'"),
    'effort="%s"': ('60', "<limit effort> of joint 'j1'"),
}


@pytest.mark.parametrize('number', NO_NUMBERS)
def test_a_value_that_is_no_number_is_refused_and_the_link_or_joint_named(number: str) -> None:
    for place, (value, where) in PLACES.items():
        # A limit may be large.
        if number == '1e101' and 'limit' in where:
            continue
        with pytest.raises(ValueError, match=re.escape(where)) as caught:
            pfd.load_robot(changed(place % value, place % number))
        assert len(str(caught.value)) < 500


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


@pytest.mark.parametrize(
    ('old', 'new', 'message'),
    [
        ('xyz="0.01 -0.02 0.1"', 'xyz="0.01 -0.02"', "<origin xyz> of link 'turret' must"),
        ('<axis xyz="0.3 -0.5 0.8"/>', '<axis/>', "<axis xyz> of joint 'j2' must be three"),
        ('<mass value="4.0"/>', '', "<inertial> of link 'turret' must have a <mass>"),
        ('<mass value="4.0"/>', '<mass value="4"/><mass value="5"/>', "'turret' has 2 .*<mass>"),
        ('ixx="0.02" ', '', "<inertia ixx> of link 'pedestal' must be a number, got none"),
        ('velocity="2" ', '', "<limit velocity> of joint 'j1' must be a number, got none"),
        ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 -1"/>' * 2, "joint 'j1' has 2 elements <axis>"),
        ('<link name="box">', '<link name="turret">', "two links named 'turret'"),
        ('<link name="box">', '<link>', 'a <link> without a name'),
        ('effort="60"', 'effort="-60"', "<effort> of joint 'j1' must not be negative"),
        ('lower="-1" upper="1.5"', 'lower="2" upper="1"', "position_lower of joint 'j1' must not"),
    ],
)
def test_elements_that_the_format_does_not_allow_are_refused_and_named(
    old: str, new: str, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        pfd.load_robot(changed(old, new))


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


def test_a_loop_apart_from_the_rest_is_named() -> None:
    text = urdf(
        *('x', *ARM, link('c', 1, J=BODY), link('d', 1, J=BODY)),
        *(joint('j', 'revolute', 'base', 'arm'), joint('k', 'revolute', 'c', 'd')),
        joint('l', 'fixed', 'd', 'c'),
    )
    with pytest.raises(ValueError, match="joints 'k', 'l' form a closed loop apart from the rest"):
        pfd.load_robot(text)
    with pytest.raises(ValueError, match=r'closed loop|without a parent'):
        pfd.load_robot(urdf('x', *ARM, joint('j', 'revolute', 'arm', 'arm')))


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


BOMB = '<!DOCTYPE r [<!ENTITY a0 "x">{}]><robot name="&a30;"><link name="a"/></robot>'.format(
    ''.join(f'<!ENTITY a{i + 1} "&a{i};&a{i};">' for i in range(30))
)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        (BOMB, 'a URDF has no <!DOCTYPE>'),
        ('<!DOCTYPE robot SYSTEM "file:///etc/passwd"><robot/>', 'a URDF has no <!DOCTYPE>'),
        (
            '<robot>' + ''.join(f'<link name="{i}"/>' for i in range(501)) + '</robot>',
            '501 links',
        ),
        ('<robot>' + '<a>' * 200_000 + '</a>' * 200_000 + '</robot>', 'the URDF has no <link>'),
        ('<robot name="\ud800"/>', 'not well-formed XML'),
        ('<robot name="\0"/>', 'not well-formed XML'),
        ('<robot>' + ' ' * (16 * 2**20) + '</robot>', 'characters, more than'),
    ],
    ids=range(7),
)
def test_hostile_xml_is_refused_in_a_short_line(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        pfd.load_robot(text)
    assert len(str(caught.value)) < 500
    assert '\n' not in str(caught.value)


def test_a_long_chain_is_loaded_and_a_longer_one_refused() -> None:
    def chain(n: int) -> str:
        links = [link(f'l{i}', 1.0, '0.1 0 0', J=BODY) for i in range(n + 1)]
        joints = [
            joint(f'j{i}', 'continuous', f'l{i}', f'l{i + 1}', '0.2 0 0', '1.5 0 0')
            for i in range(n)
        ]
        return urdf('long', *links[::-1], *joints[::-1])

    robot = pfd.load_robot(chain(499))
    assert robot.n == 499
    assert robot.joint_names[0] == 'j0'
    assert pfd.load_robot(chain(499), locked={f'j{i}': 0.1 for i in range(1, 499)}).n == 1
    with pytest.raises(ValueError, match='501 links'):
        pfd.load_robot(chain(500))


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
    <drake:inertials/>
  </link>
  <joint name="shoulder" type="revolute">
    <origin xyz="0 0 0" rpy="0 0 0"/>
    <parent link="base"/>
    <child link="upper"/>
    <axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="9" velocity="9" acceleration="5" drake:efforts="2"/>
    <dynamics damping="1" friction="0.5"/>
    <safety_controller k_velocity="1" soft_lower_limit="-2"/>
    <calibration rising="0"/>
  </joint>
  <gazebo reference="upper"><links/></gazebo>
  <ros2_control name="arm" type="system"><joints/></ros2_control>
  <transmission name="t"><types>x</types></transmission>
  <material name="blue"/>
</robot>
"""


def test_names_of_other_tools_are_no_misspelt_ones() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        assert pfd.load_robot(NAMED).friction.tolist() == [0.5]


def test_misspelt_names_are_named_in_one_warning_at_the_line_that_loads() -> None:
    text = NAMED.replace(' friction=', ' Friction=').replace('transmission', 'transmision')
    with pytest.warns(pfd.PhysicsWarning) as found:
        pfd.load_robot(text.replace('xyz="0 0 1"', 'xzy="0 0 1"'))
    (warning,) = found
    for place in ('<origin> xzy=', '<dynamics> Friction=', '<transmision>'):
        assert place in str(warning.message)
    assert warning.filename == __file__


def test_unexpanded_xacro_is_an_error_with_the_command_to_run() -> None:
    text = NAMED.replace('<link name="base"/>', '<xacro:arm/><link name="base"/>')
    with pytest.raises(ValueError, match=r'<xacro:arm>, which is not expanded: load the \.xacro'):
        pfd.load_robot(text)
