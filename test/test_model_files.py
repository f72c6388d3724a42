# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files of robots: paths, encodings, kinds; xacro; robots by name in other packages."""

from __future__ import annotations

from functools import cache
import os
from pathlib import Path
import re
import sys
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from zoo import ODD_ARM, ROWS

import pfd_core as pfd
from pfd_core.model.loading import LARGEST_FILE as LARGEST_MODEL_FILE


def test_missing_and_wrong_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no robot file '.*arm\.urdf'"):
        pfd.load_robot(tmp_path / 'arm.urdf')
    with pytest.raises(ValueError, match=r"no robot file 'arm\.yaml'"):
        pfd.load_robot('arm.yaml')
    known = re.escape(', '.join(pfd.known_robots()))
    with pytest.raises(ValueError, match=f"unknown robot 'puma': known are {known}"):
        pfd.load_robot('puma')
    with pytest.raises(ValueError, match="no robot file 'ur5'"):
        pfd.load_robot(Path('ur5'))
    with pytest.raises(ValueError, match="tip='wrist' cannot be chosen for 'ur5'"):
        pfd.load_robot('ur5', tip='wrist')
    (tmp_path / 'arm.yaml').write_bytes(b'\xff\xfe\x00')
    with pytest.raises(ValueError, match='cannot read'):
        pfd.load_robot(tmp_path / 'arm.yaml')
    with pytest.raises(ValueError, match='source must be a name, a path or a string, got 3'):
        pfd.load_robot(3)


def test_a_path_that_is_no_regular_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / 'pipe.urdf')
    (tmp_path / 'folder.yaml').mkdir()
    (tmp_path / 'zero.urdf').symlink_to('/dev/zero')
    for name in ('pipe.urdf', 'folder.yaml', 'zero.urdf'):
        with pytest.raises(ValueError, match=rf'cannot read .*{name}.: it is not a regular file'):
            pfd.load_robot(tmp_path / name)
        with pytest.raises(ValueError, match='it is not a regular file'):
            pfd.load_robot(str(tmp_path / name))
    with open(tmp_path / 'huge.urdf', 'wb') as file:
        file.truncate(LARGEST_MODEL_FILE + 1)
    with pytest.raises(ValueError, match=r'cannot read .*huge\.urdf.: it is larger than'):
        pfd.load_robot(tmp_path / 'huge.urdf')


@pytest.mark.parametrize(
    'source', ['x' * 1_000_000, 'zero\0.urdf', 'a/' * 5000, b'ur5', '\ud800', 'a.urdf\n']
)
def test_a_name_that_no_file_can_have_is_refused_in_a_short_line(source: object) -> None:
    with pytest.raises(ValueError, match=r'unknown robot|no robot file|source must be') as caught:
        pfd.load_robot(source)
    assert len(str(caught.value)) < 1000


def test_a_mark_of_byte_order_states_the_encoding_and_is_no_part_of_a_file(tmp_path: Path) -> None:
    for name, text in (('two.yaml', ROWS), ('odd.urdf', ODD_ARM)):
        for encoding in ('utf-8', 'utf-16-le', 'utf-16-be', 'utf-32-le', 'utf-32-be'):
            (tmp_path / name).write_text('\ufeff' + text, encoding=encoding)
            assert pfd.load_robot(tmp_path / name) == pfd.load_robot(text)


DECLARED = (
    '<?xml version="1.0" encoding="{}"?>\n<!-- {} -->\n' + ODD_ARM[ODD_ARM.index('<robot') :]
)


@pytest.mark.parametrize(
    ('encoding', 'word'),
    [
        *(('UTF-8', '\u673a\u68b0\u81c2'), ('iso-8859-1', 'bras \xe0 un axe')),
        *(('GB2312', '\u673a\u68b0\u81c2'), ('Shift_JIS', '\u8155'), ('windows-1252', '\u20ac')),
        *(('UTF-16', '\u673a\u68b0\u81c2'), ('utf-32', 'arm'), ('us-ascii', 'arm')),
    ],
)
@pytest.mark.usefixtures('expanded_here')
def test_a_file_is_read_in_the_encoding_that_it_declares(
    tmp_path: Path, encoding: str, word: str
) -> None:
    path = tmp_path / 'arm.urdf'
    path.write_bytes(DECLARED.format(encoding, word).encode(encoding))
    assert pfd.load_robot(path) == pfd.load_robot(ODD_ARM)
    if encoding in ('GB2312', 'UTF-16'):
        # xacro itself reads files in the encoding of the locale.
        macros = tmp_path / 'arm.urdf.xacro'
        macros.write_bytes(path.read_bytes())
        assert pfd.load_robot(macros) == pfd.load_robot(ODD_ARM)
    # The text is published, and written by others in UTF-8.
    text = pfd.urdf_of(path)
    assert word in text
    path.write_text(text, encoding='utf-8')
    assert pin.buildModelFromUrdf(str(path)).njoints == 7


@pytest.mark.parametrize(
    ('encoding', 'message'),
    [
        ('utf-8', r"arm\.urdf', line 2: 'utf-8' codec can't decode byte 0xe0"),
        ('GB2312', r"arm\.urdf', line 2: 'gb2312' codec can't decode"),
        *((name, f', line 1: unknown encoding: {name}') for name in ('klingon',)),
        ('base64', "'base64' is not a text encoding"),
    ],
)
def test_a_wrong_encoding_is_refused_and_named(
    tmp_path: Path, encoding: str, message: str
) -> None:
    path = tmp_path / 'arm.urdf'
    path.write_bytes(DECLARED.format(encoding, '\xe0').encode('latin-1'))
    with pytest.raises(ValueError, match=message) as caught:
        pfd.load_robot(path)
    assert len(str(caught.value)) < 500


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


XACRO_ARM = """
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


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """Return a file of XACRO_ARM, beside the file that it includes."""
    (tmp_path / 'macros.xacro').write_text(INCLUDED, encoding='utf-8')
    return xacro_file(tmp_path, XACRO_ARM)


@cache
def expanded() -> str:
    """Return the URDF of XACRO_ARM."""
    with TemporaryDirectory() as folder:
        (Path(folder) / 'macros.xacro').write_text(INCLUDED, encoding='utf-8')
        return pfd.urdf_of(xacro_file(Path(folder), XACRO_ARM))


@pytest.mark.parametrize(
    ('name', 'macros', 'before'),
    [
        ('ARM.URDF', False, ''),
        ('arm', False, '<!-- <sdf> --><?note <mujoco>?>\n'),
        ('arm.yaml', False, '<?xml version="1.0"?>\n'),
        ('arm.urdf', True, ''),
        ('arm.XACRO', True, '<?xml version="1.0"?>\n'),
        ('arm.txt', True, '\n'),
    ],
)
@pytest.mark.usefixtures('expanded_here')
def test_the_content_of_a_file_decides_what_it_is(
    arm: Path, name: str, macros: bool, before: str
) -> None:
    # Where the included file is, in case the file is a xacro.
    path = arm.parent / name
    text = XACRO_ARM if macros else expanded()
    path.write_text(before + text[text.index('<robot') :])
    assert pfd.load_robot(path) == pfd.load_robot(expanded())


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('<?xml version="1.0"?>\n<sdf version="1.9"/>', 'starts with <robot>, this with <sdf>'),
        ('<!DOCTYPE html>\n<HTML lang="en"></HTML>', 'has no <!DOCTYPE>'),
        ('<!--' * 20_000, 'not well-formed XML'),
        ('<?a?>' * 20_000 + '<', 'not well-formed XML'),
        ('version https://git-lfs.github.com/spec/v1\n', 'run `git lfs pull`'),
    ],
)
@pytest.mark.parametrize('name', ['arm.urdf', 'arm.xacro', 'arm.yaml', 'arm.sdf'])
@pytest.mark.usefixtures('expanded_here')
def test_a_file_of_another_kind_is_named(tmp_path: Path, name: str, text: str, words: str) -> None:
    (tmp_path / name).write_text(text)
    if name == 'arm.xacro':
        words = f'{words}|xacro cannot expand'
    with pytest.raises(ValueError, match=words) as caught:
        pfd.load_robot(tmp_path / name)
    assert name in str(caught.value)


def test_the_text_of_a_model_of_mujoco_is_refused_as_its_files_are_unknown() -> None:
    with pytest.raises(ValueError, match='the text is MJCF'):
        pfd.load_robot(' <mujoco/>')


@pytest.mark.parametrize('name', ['arm.urdf', 'arm.xml', 'ARM.URDF'])
def test_the_name_decides_where_the_content_is_neither_xml_nor_a_robot_in_yaml(
    tmp_path: Path, name: str
) -> None:
    path = tmp_path / name
    path.write_text('note: the file is on the other disk\n')
    with pytest.raises(ValueError, match=f'{name}, line 1: not well-formed XML'):
        pfd.load_robot(path)
    path.write_text(pfd.robot_to_yaml(pfd.load_robot('planar2')))
    assert pfd.load_robot(path) == pfd.load_robot('planar2')


# ---- xacro ----


def test_a_xacro_file_loads_with_its_includes_and_the_defaults_of_its_arguments(arm: Path) -> None:
    robot = pfd.load_robot(arm)
    assert robot.joint_names == ('upper_joint', 'lower_joint')
    assert robot.masses.tolist() == [2.5, 1.0]
    # The frame of the robot has the joint's axis, here y, as its z.
    assert sorted(robot.translations[0].tolist()) == [0.0, 0.0, 0.4]
    assert robot.source == str(arm)
    urdf = pfd.read_urdf(arm)
    assert urdf is not None
    # What is published is the expanded text.
    assert urdf.text == pfd.urdf_of(arm)
    assert 'xacro:' not in urdf.text
    assert pfd.load_robot(urdf) == robot


# The cause is whole, however long it is.
FAR = '/'.join(['folder'] * 60) + '.xacro'


@pytest.mark.parametrize(
    ('inside', 'reason'),
    [
        ('<link name="${missing}"/>', "name 'missing' is not defined"),
        ('<xacro:unknown/>', 'unknown macro name: xacro:unknown'),
        (f'<xacro:include filename="{FAR}"/>', f'No such file.*{FAR}'),
        (
            '<xacro:arg name="of" default="b"/><xacro:include filename="../$(arg of)/a.xacro"/>',
            "argument 'of' is 'b', not in ",
        ),
        ('<link', 'ExpatError'),
        (
            '<xacro:macro name="a"><link name="b"/><xacro:a/></xacro:macro><xacro:a/>',
            'RecursionError',
        ),
    ],
)
@pytest.mark.usefixtures('expanded_here')
def test_a_file_that_xacro_cannot_expand_is_refused_with_its_reason(
    tmp_path: Path, inside: str, reason: str
) -> None:
    path = xacro_file(tmp_path, f'<robot name="r" {EXPANDING}>{inside}</robot>')
    with pytest.raises(ValueError, match=rf"xacro cannot expand '.*arm\.urdf\.xacro': .*{reason}"):
        pfd.load_robot(path)


@pytest.mark.usefixtures('expanded_here')
def test_an_error_in_an_expanded_xacro_starts_with_its_file_alone(arm: Path) -> None:
    arm.write_text(XACRO_ARM.replace('2 * 0.5', "'1,5'"))
    with pytest.raises(ValueError, match=f"^{re.escape(str(arm))}: <mass value> of link 'lower'"):
        pfd.load_robot(arm)


def test_unexpanded_xacro_is_an_error_with_the_command_to_run() -> None:
    text = XACRO_ARM[XACRO_ARM.index('<robot') :]
    with pytest.raises(ValueError, match=r'<xacro:arg>, which is not expanded: load the \.xacro'):
        pfd.load_robot(text)


def test_time_and_length_of_an_expansion_are_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = xacro_file(tmp_path, f'<robot name="${{\'a\' * 2**25}}" {EXPANDING}/>')
    with pytest.raises(ValueError, match='characters, more than the 16777216 supported'):
        pfd.load_robot(path)
    monkeypatch.setattr('pfd_core.model.apart.SECONDS', 0.001)
    with pytest.raises(ValueError, match=r'did not expand .* within 0\.001 s; it was stopped'):
        pfd.load_robot(path)


def test_without_the_package_a_xacro_file_is_refused_with_the_way_to_get_it(
    arm: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, 'xacro', None)
    with pytest.raises(ValueError, match=r'needs the package xacro, .*`pip install xacro`'):
        pfd.load_robot(arm)


def test_arguments_of_a_xacro_file_replace_their_defaults(arm: Path) -> None:
    robot = pfd.load_robot(arm, xacro={'mass': 4.0})
    assert robot.masses.tolist() == [4.0, 1.0]
    assert pfd.load_robot(pfd.urdf_of(arm, {'mass': '4'})).masses.tolist() == [4.0, 1.0]
    assert pfd.load_robot(pfd.read_urdf(arm, {'mass': 4})) == robot


@pytest.mark.parametrize(
    ('default', 'xacro', 'message'),
    [
        ('', {}, r"argument 'mass' has no value .*xacro=\{'mass': 'VALUE'\}"),
        ('default="2"', {'mas': 1}, r"has no argument 'mas'; its arguments are 'mass:=2'"),
        ('default="none"', {'mas': 1}, r"'mass:=none', 'mas' is none of them; give others by"),
        ('default="2"', {'mass': None}, r"xacro\['mass'\] must be a text or a number, got None"),
        ('default="2"', {'': 1}, 'names of arguments as keys'),
        ('default="2"', 'mass:=1', "xacro must be a mapping, got 'mass:=1'"),
    ],
)
@pytest.mark.usefixtures('expanded_here')
def test_a_missing_and_an_unknown_argument_of_a_xacro_file_is_named(
    arm: Path, default: str, xacro: Any, message: str
) -> None:
    declared = f'<xacro:arg name="mass" {default}/>' if default else ''
    text = XACRO_ARM.replace('<xacro:arg name="mass" default="2.5"/>', declared)
    arm.write_text(text.replace('"$(arg mass)"', '"${1.0 * $(arg mass)}"'))
    with pytest.raises(ValueError, match=message):
        pfd.load_robot(arm, xacro=xacro)


def test_arguments_of_xacro_for_another_source_are_refused() -> None:
    for source in ('puma560', ODD_ARM, pfd.read_urdf(ODD_ARM)):
        with pytest.raises(ValueError, match=r"xacro, 'mass', are for a xacro file"):
            pfd.load_robot(source, xacro={'mass': 1})


PACKAGE = '<package format="3"><name> {} </name></package>'


def checkout(folder: Path, *packages: str) -> None:
    """Write packages whose folders do not have their names."""
    for name in packages:
        (folder / f'{name}_folder' / 'urdf').mkdir(parents=True)
        (folder / f'{name}_folder' / 'package.xml').write_text(PACKAGE.format(name))


def found_arm(folder: Path, find: str) -> Path:
    """Return a file of package 'arm', whose included file of 'macros' includes one by `find`."""
    macros = f'<robot {EXPANDING}><xacro:include filename="{find}/urdf/mass.xacro"/></robot>'
    (folder / 'macros_folder/urdf/macros.xacro').write_text(macros)
    text = XACRO_ARM.replace('"macros.xacro"', '"$(find macros)/urdf/macros.xacro"')
    return xacro_file(folder / 'arm_folder' / 'urdf', text)


@pytest.mark.parametrize('installed', [False, True], ids=['checkout', 'installed'])
@pytest.mark.usefixtures('expanded_here')
def test_xacro_finds_packages_installed_above_the_file_and_beside_its_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, installed: bool
) -> None:
    checkout(tmp_path / 'src' / 'vendor', 'arm', 'macros')
    checkout(tmp_path / 'src' / 'other', 'masses')
    path = found_arm(tmp_path / 'src' / 'vendor', '$(find masses)')
    own = INCLUDED.replace('${mass}', '7')
    (tmp_path / 'src/other/masses_folder/urdf/mass.xacro').write_text(own)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path / 'install') if installed else '')
    share = tmp_path / 'install' / 'share' / 'masses'
    (share / 'urdf').mkdir(parents=True)
    (share / 'package.xml').write_text(PACKAGE.format('masses'))
    (share / 'urdf' / 'mass.xacro').write_text(INCLUDED)
    assert pfd.load_robot(path).masses.tolist() == ([2.5, 1.0] if installed else [7.0, 7.0])
    # Of sources only: where folders are installed elsewhere, they lack a file.
    (share / 'urdf' / 'mass.xacro').unlink()
    (tmp_path / 'src/other/masses_folder/urdf/mass.xacro').unlink()
    with pytest.raises(ValueError, match='No such file') as lost:
        pfd.load_robot(path)
    assert ('source its workspace' in str(lost.value)) == (not installed)


@pytest.mark.usefixtures('expanded_here')
def test_a_package_that_is_not_found_is_named_with_the_file_that_names_it(tmp_path: Path) -> None:
    checkout(tmp_path, 'arm', 'macros')
    path = found_arm(tmp_path, '$(find masses)')
    # A folder of that name is no package, and a package.xml that is no XML no error.
    (tmp_path / 'masses').mkdir()
    (tmp_path / 'masses' / 'package.xml').write_text('masses')
    inner = re.escape(str(tmp_path / 'macros_folder/urdf/macros.xacro'))
    with pytest.raises(ValueError, match=rf"package 'masses' is not found: .*{inner}") as lost:
        pfd.load_robot(path)
    assert str(lost.value).count('is not found') == 1


# ---- robots by name whose links are in another package ----


PLACES = ('AMENT_PREFIX_PATH', 'ROS_PACKAGE_PATH', 'ROBOT_DESCRIPTIONS_CACHE')
# Of folders that contain the package: one for each way to get it.
LAYOUTS = {
    'installed by apt or built by colcon': ('AMENT_PREFIX_PATH', 'share/bench_description'),
    'a clone in a folder': ('ROS_PACKAGE_PATH', 'a_repository'),
    'a package of a clone': ('ROS_PACKAGE_PATH', 'a_repository/bench_description'),
    'the clone itself': ('ROS_PACKAGE_PATH', ''),
    'cache of robot_descriptions': ('ROBOT_DESCRIPTIONS_CACHE', 'bench_description'),
    'cache of one commit': ('ROBOT_DESCRIPTIONS_CACHE', 'repo-1a2b/repo/bench_description'),
    'default cache': ('HOME', '.cache/robot_descriptions/repo/bench_description'),
    'wheel built by CMake': ('', 'cmeel.prefix/share/bench_description'),
}
LINK = (
    '<link name="{0}"><inertial><mass value="{1}"/><origin xyz="0.1 0.02 {2}"/>'
    '<inertia ixx="0.1" iyy="0.2" izz="0.15" ixy="0.01" ixz="0" iyz="0"/></inertial></link>'
)
JOINT = (
    '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><axis xyz="0 1 0"/>'
    '<origin xyz="0 0 $(arg length)" rpy="0.3 0 0.2"/>'
    '<limit lower="-1" upper="2" velocity="3" effort="4"/><dynamics damping="9"/></joint>'
)
XACRO = f"""<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="a_file">
<xacro:arg name="length" default="$(find bench_description)"/><link name="world"/>
{LINK.format('upper', 2, 0.2)}{LINK.format('fore', 1, '$(arg length)')}
{JOINT.format('shoulder', 'world', 'upper')}{JOINT.format('elbow', 'upper', 'fore')}
<link name="flange"><visual><geometry><mesh
filename="file:///$(find bench_description)/a.stl"/></geometry></visual></link>
<joint name="end" type="fixed"><parent link="fore"/><child link="flange"/>
<origin xyz="0 0 0.1"/></joint>
<transmission name="t"><type>transmission_interface/SimpleTransmission</type>
<joint name="elbow"/><actuator name="m"><motorInertia>7</motorInertia>
<mechanicalReduction>10</mechanicalReduction></actuator></transmission></robot>"""
# The same without macros, which are expanded in another process.
PLAIN = (
    '<robot name="a_file">'
    + XACRO.partition('name="length" default="$(find bench_description)"/>')[2]
)
PLAIN = PLAIN.replace('$(arg length)', '0.4')
NUMBERS = """numbers:
  friction: [1, 2]
  armature: [0.5, 0.25]
  effort: [40, .inf]
"""
BENCH = """robot: bench
description:
- {package: absent_description, path: urdf/bench.urdf, tip: tool}
- {package: bench_description, path: urdf/bench.urdf.xacro, tip: flange, xacro: {length: 0.4}}
get: [apt install one, git clone another]
"""
PLAIN_BENCH = BENCH.replace('.xacro, tip: flange, xacro: {length: 0.4}', ', tip: flange')


@pytest.fixture(autouse=True)
def nowhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Hide packages of this computer."""
    for variable in PLACES:
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv('HOME', str(tmp_path / 'home'))


def make_package(folder: Path) -> Path:
    (folder / 'urdf').mkdir(parents=True)
    (folder / 'package.xml').write_text('<package><name>bench_description</name></package>')
    (folder / 'urdf/bench.urdf.xacro').write_text(XACRO)
    (folder / 'urdf/bench.urdf').write_text(PLAIN)
    return folder


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv('ROS_PACKAGE_PATH', str(tmp_path))
    return make_package(tmp_path / 'bench_description')


@pytest.mark.parametrize('layout', LAYOUTS)
def test_a_described_robot_is_found_in_each_place(
    layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    variable, folder = LAYOUTS[layout]
    package = make_package(tmp_path / folder)
    if variable:
        monkeypatch.setenv(variable, str(tmp_path))
    else:
        monkeypatch.setattr(sys, 'path', [*sys.path, str(tmp_path)])
    robot = pfd.load_robot(PLAIN_BENCH)
    assert (robot.name, robot.tip) == ('bench', 'flange')
    assert str(package / 'urdf/bench.urdf') in robot.source


@pytest.mark.usefixtures('expanded_here')
def test_a_described_robot_is_the_file_of_its_package_with_its_own_numbers(
    installed: Path,
) -> None:
    robot, path = pfd.load_robot(BENCH + NUMBERS), installed / 'urdf/bench.urdf.xacro'
    file = pfd.load_robot(path, tip='flange', xacro={'length': 0.4})
    for key in ('rotations', 'translations', 'masses', 'centers', 'inertias', 'damping'):
        np.testing.assert_array_equal(getattr(robot, key), getattr(file, key))
    assert file.armature.tolist() == [0, 700]
    assert robot.armature.tolist() == [0.5, 0.25]
    assert robot.friction.tolist() == [1, 2]
    assert robot.effort_limit.tolist() == [40, np.inf]
    assert robot.velocity_limit.tolist() == [3, 3]
    assert '"package://bench_description/a.stl"' in pfd.urdf_of(BENCH)


@pytest.mark.parametrize(
    ('rows', 'lower', 'upper'),
    [
        ('{lower: [-2, -3]}', [-2, -3], [2, np.inf]),
        ('{lower: [-2, -3], upper: [1, 3]}', [-2, -3], [1, 3]),
        ('{upper: [1, .inf]}', [-1, -np.inf], [1, np.inf]),
    ],
)
def test_a_range_that_is_given_to_a_continuous_joint_is_its_range(
    installed: Path, rows: str, lower: list[float], upper: list[float]
) -> None:
    before, elbow = PLAIN.split('<joint name="elbow" type="revolute">')
    text = f'{before}<joint name="elbow" type="continuous">{elbow}'
    (installed / 'urdf/bench.urdf').write_text(text)
    robot = pfd.load_robot(f'{PLAIN_BENCH}numbers: {rows}')
    assert robot.position_lower.tolist() == lower
    assert robot.position_upper.tolist() == upper


@pytest.mark.usefixtures('expanded_here')
def test_each_way_to_read_a_described_robot_gives_the_same_one(
    installed: Path, tmp_path: Path
) -> None:
    path = tmp_path / 'bench.yaml'
    path.write_text(BENCH + NUMBERS)
    robot, urdf = pfd.load_robot(path), pfd.read_urdf(path)
    assert urdf is not None
    assert pfd.load_robot(urdf) == robot
    assert pfd.load_robot(pfd.urdf_of(path), tip='flange') == robot
    assert pfd.load_robot(PLAIN_BENCH, tip='fore').tip == 'fore'
    assert pfd.locked_joints(PLAIN_BENCH, locked={'el*': 0.5}) == {'elbow': 0.5}
    longer = pfd.load_robot(path, xacro={'length': 0.6})
    assert longer.base_position[2] == pytest.approx(0.6)


def test_without_a_description_the_error_names_each_package_and_each_way_to_get_one() -> None:
    with pytest.raises(ValueError, match="no description of 'bench' is on disk") as found:
        pfd.load_robot(BENCH)
    words = 'absent_description', 'bench_description', 'apt install one', 'git clone another'
    assert all(word in str(found.value) for word in words)


@pytest.mark.parametrize(
    ('change', 'problem'),
    {
        'numbers': (('[1, 2]', '[1, 2, 3]'), r"friction in numbers of 'YAML text' must .*\(2,\)"),
        'a number': (
            ('[1, 2]', '[1, two]'),
            "friction in numbers of 'YAML text' must be a number",
        ),
        'a table': (('[1, 2]', '{a: 1}'), "friction in numbers of 'YAML text' must be a number"),
        'keys': (('friction', 'fricton'), "unknown key 'fricton'"),
        'more keys': (('numbers:', 'numbr:'), "unknown key 'numbr'"),
        'tip': (('flange', 'hand'), 'friction in numbers'),
        'no numbers and a tip': (('flange', 'hand', NUMBERS, ''), "tip 'hand' is not a link"),
        'words': (('flange}', 'flange, path: [1]}'), "key 'path' occurs more than once"),
        'a list': (('package: bench_description', 'package: [b]'), 'must have words'),
        'another format': (('bench.urdf', '../package.yaml'), "must end in one of .*'urdf/"),
        'a missing file': (('bench.urdf', 'b.urdf'), 'urdf/b.urdf in '),
        'no words': (
            ('[apt install one, git clone another]', '[[1], {a: 2}]', 'bench_d', 'x'),
            'x',
        ),
        'no mapping': ((PLAIN_BENCH + NUMBERS, '"\n\ndescription: x"'), 'must be a mapping'),
        'a negative one': (('[1, 2]', '[1, -2]'), 'friction'),
    }.values(),
)
def test_a_described_robot_with_a_mistake_is_an_error_that_names_it(
    installed: Path, change: tuple[str, ...], problem: str
) -> None:
    text = PLAIN_BENCH + NUMBERS
    for old, new in zip(change[::2], change[1::2], strict=True):
        assert old in text
        text = text.replace(old, new)
    with pytest.raises(ValueError, match=problem):
        pfd.load_robot(text)


def test_arguments_of_xacro_are_refused_where_the_description_is_a_urdf(installed: Path) -> None:
    with pytest.raises(ValueError, match="arguments of xacro, 'length'"):
        pfd.load_robot(PLAIN_BENCH, xacro={'length': 1})


def test_a_description_that_is_no_urdf_is_refused_and_named(installed: Path) -> None:
    (installed / 'urdf/bench.xml').write_text(pfd.robot_to_yaml(pfd.load_robot('planar2')))
    with pytest.raises(ValueError, match=r"bench\.xml' must be a URDF, got a robot in YAML"):
        pfd.load_robot(BENCH.replace('.urdf.xacro', '.xml').replace(', xacro: {length: 0.4}', ''))


def test_the_arms_that_people_own_have_names() -> None:
    arms = {'ur3e', 'ur5e', 'ur10e', 'ur16e', 'fr3', 'xarm6', 'xarm7', 'gen3', 'iiwa7', 'iiwa14'}
    assert {*pfd.known_robots(described=True)} == arms
    assert arms.isdisjoint(pfd.known_robots())
    with pytest.raises(ValueError, match="name must be the name of a robot, got 'ur99'"):
        pfd.find_description('ur99')


@pytest.mark.filterwarnings('ignore::pfd_core.PhysicsWarning')
@pytest.mark.parametrize('name', pfd.known_robots(described=True))
def test_a_robot_by_name_that_is_on_disk_moves_as_pinocchio_says(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()  # what this computer has counts
    if pfd.find_description(name) is None:
        pytest.skip(f'no description of {name} on this computer')
    robot, model = pfd.load_robot(name, right_angle=-1), pin.buildModelFromXML(pfd.urdf_of(name))
    assert robot.name == name
    assert robot.joint_names == tuple(model.names[1:])
    model.armature[:] = robot.armature
    scene = pfd.Scene(armature='model' if robot.armature.any() else None)
    rng = np.random.default_rng(3)
    data = model.createData()
    for _ in range(20):
        q, qd, tau = rng.uniform(-1, 1, (3, robot.n)) * [[1], [1], [20]]
        pairs = [
            [x] if joint.nq == 1 else [np.cos(x), np.sin(x)]
            for joint, x in zip(model.joints[1:], q, strict=True)
        ]
        expected = pin.aba(model, data, np.concatenate(pairs), qd, tau)
        found = pfd.forward_dynamics(robot, q, qd, tau, scene=scene, method='composite_body')
        assert np.abs(found - expected).max() <= 1e-9 * np.abs(expected).max()
