# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names in a URDF: xacro that was not expanded, misspelt names and those of other tools."""

from __future__ import annotations

import re
import warnings

import pytest

import pfd_core as pfd

ARM = """
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
        assert pfd.load_robot(ARM).friction.tolist() == [0.5]


@pytest.mark.parametrize(
    ('right', 'wrong', 'text'),
    [
        (
            ' friction=',
            ' Friction=',
            'has an attribute Friction, .*is an attribute friction meant',
        ),
        ('xyz="0 0 1"', 'xyzs="0 0 1"', 'has an attribute xyzs, .*is an attribute xyz meant'),
        ('xyz="0 0 1"', 'xzy="0 0 1"', 'has an attribute xzy, .*is an attribute xyz meant'),
        ('dynamics ', 'dynamic ', r'has an element <dynamic>, .*is an element <dynamics> meant'),
        ('inertial>', 'Inertial>', r'<link name=.upper.> has an element <Inertial>'),
        ('transmission', 'transmision', r'has an element <transmision>'),
    ],
)
def test_a_misspelt_name_is_warned_of_with_the_likely_one(
    right: str, wrong: str, text: str
) -> None:
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter('always')
        try:
            pfd.load_robot(ARM.replace(right, wrong))
        except ValueError:  # without its <inertial> the arm is no body
            assert right == 'inertial>'
    (warning,) = found
    assert re.search(text, str(warning.message))
    assert issubclass(warning.category, pfd.PhysicsWarning)
    assert warning.filename == __file__


def test_xacro_that_was_not_expanded_is_an_error_that_says_what_to_run() -> None:
    text = ARM.replace('<link name="base"/>', '<xacro:arm/><link name="base"/>')
    with pytest.raises(ValueError, match=r'<xacro:arm>, which is not expanded: load the \.xacro'):
        pfd.load_robot(text)
