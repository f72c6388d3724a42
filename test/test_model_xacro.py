# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Xacro files are expanded by the package xacro, within bounds, or refused with the reason."""

from __future__ import annotations

from pathlib import Path
import sys

import bridge
import pytest

import pfd_core as pfd

INCLUDED = """
<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="arm" params="name mass parent">
    <link name="${name}"><inertial><origin xyz="0 0 ${length / 2}"/><mass value="${mass}"/>
      <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
    <joint name="${name}_joint" type="revolute"><parent link="${parent}"/>
      <child link="${name}"/><origin xyz="0 0 ${length}"/><axis xyz="0 1 0"/>
      <limit lower="-3" upper="3" effort="9" velocity="9"/></joint>
  </xacro:macro>
</robot>
"""
ARM = """
<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="mass" default="2.5"/>
  <xacro:property name="length" value="0.4"/>
  <xacro:include filename="macros.xacro"/>
  <link name="base"/>
  <xacro:arm name="upper" mass="$(arg mass)" parent="base"/>
  <xacro:arm name="lower" mass="${2 * 0.5}" parent="upper"/>
</robot>
"""
EXPANDING = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'


def xacro_file(folder: Path, text: str) -> Path:
    path = folder / 'arm.urdf.xacro'
    path.write_text(text, encoding='utf-8')
    return path


def test_a_xacro_file_loads_with_its_includes_and_the_defaults_of_its_arguments(
    tmp_path: Path,
) -> None:
    pytest.importorskip('xacro')
    (tmp_path / 'macros.xacro').write_text(INCLUDED, encoding='utf-8')
    path = xacro_file(tmp_path, ARM)
    robot = pfd.load_robot(path)
    assert robot.joint_names == ('upper_joint', 'lower_joint')
    assert robot.masses.tolist() == [2.5, 1.0]
    # The frame of the robot has the joint's axis, here y, as its z.
    assert sorted(robot.translations[0].tolist()) == [0.0, 0.0, 0.4]
    assert robot.source == str(path)
    urdf = pfd.read_urdf(path)
    assert urdf is not None
    # What is published is the expanded text.
    assert urdf.text == pfd.urdf_of(path)
    assert 'xacro:' not in urdf.text
    assert pfd.load_robot(urdf) == robot


@pytest.mark.parametrize(
    ('inside', 'reason'),
    [
        ('<link name="${missing}"/>', "name 'missing' is not defined"),
        ('<xacro:include filename="absent.xacro"/>', 'No such file'),
        ('<xacro:unknown/>', 'unknown macro name: xacro:unknown'),
        ('<link', 'ExpatError'),
        (
            '<xacro:macro name="a"><link name="b"/><xacro:a/></xacro:macro><xacro:a/>',
            'RecursionError',
        ),
    ],
)
def test_a_file_that_xacro_cannot_expand_is_refused_with_its_reason(
    tmp_path: Path, inside: str, reason: str
) -> None:
    pytest.importorskip('xacro')
    path = xacro_file(tmp_path, f'<robot name="r" {EXPANDING}>{inside}</robot>')
    with pytest.raises(ValueError, match=rf"xacro cannot expand '.*arm\.urdf\.xacro': .*{reason}"):
        pfd.load_robot(path)


def test_time_and_length_of_an_expansion_are_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip('xacro')
    path = xacro_file(tmp_path, f'<robot name="${{\'a\' * 2**25}}" {EXPANDING}/>')
    with pytest.raises(ValueError, match='characters, more than the 16777216 supported'):
        pfd.load_robot(path)
    monkeypatch.setattr(*bridge.target('XACRO_MOST_SECONDS'), 0.001)
    with pytest.raises(ValueError, match=r'did not expand .* within 0\.001 s; it was stopped'):
        pfd.load_robot(path)


def test_without_the_package_a_xacro_file_is_refused_with_the_way_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, 'xacro', None)
    path = xacro_file(tmp_path, ARM)
    with pytest.raises(ValueError, match=r'needs the package xacro, .*`pip install xacro`'):
        pfd.load_robot(path)
