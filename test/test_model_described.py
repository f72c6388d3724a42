# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots by name whose links are in another package, found in each place where one may be."""

from __future__ import annotations

from pathlib import Path
import sys

import numpy as np
import pinocchio as pin
import pytest

import pfd_core as pfd

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
    return folder


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv('ROS_PACKAGE_PATH', str(tmp_path))
    return make_package(tmp_path / 'bench_description')


@pytest.mark.parametrize('layout', LAYOUTS)
def test_a_described_robot_is_the_file_of_its_package_with_its_own_numbers(
    layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    variable, folder = LAYOUTS[layout]
    package = make_package(tmp_path / folder)
    if variable:
        monkeypatch.setenv(variable, str(tmp_path))
    else:
        monkeypatch.setattr(sys, 'path', [*sys.path, str(tmp_path)])
    robot = pfd.load_robot(BENCH + NUMBERS)
    assert (robot.name, robot.tip) == ('bench', 'flange')
    assert str(package / 'urdf/bench.urdf.xacro') in robot.source
    file = pfd.load_robot(package / 'urdf/bench.urdf.xacro', tip='flange', xacro={'length': 0.4})
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
    before, elbow = XACRO.split('<joint name="elbow" type="revolute">')
    text = f'{before}<joint name="elbow" type="continuous">{elbow}'
    (installed / 'urdf/bench.urdf.xacro').write_text(text)
    robot = pfd.load_robot(f'{BENCH}numbers: {rows}')
    assert robot.position_lower.tolist() == lower
    assert robot.position_upper.tolist() == upper


def test_each_way_to_read_a_described_robot_gives_the_same_one(
    installed: Path, tmp_path: Path
) -> None:
    path = tmp_path / 'bench.yaml'
    path.write_text(BENCH + NUMBERS)
    robot, urdf = pfd.load_robot(path), pfd.read_urdf(path)
    assert urdf is not None
    assert pfd.load_robot(urdf) == robot
    assert pfd.load_robot(pfd.urdf_of(path), tip='flange') == robot
    assert pfd.load_robot(path, tip='fore').tip == 'fore'
    assert pfd.locked_joints(path, locked={'el*': 0.5}) == {'elbow': 0.5}
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
        'words': (('0.4}', '0.4}, path: [1]'), "key 'path' occurs more than once"),
        'a list': (('package: bench_description', 'package: [b]'), 'must have words'),
        'another format': (('bench.urdf.xacro', '../package.yaml'), "must end in one of .*'urdf/"),
        'a missing file': (('bench.urdf.xacro', 'b.urdf'), 'urdf/b.urdf in '),
        'no words': (
            ('[apt install one, git clone another]', '[[1], {a: 2}]', 'bench_d', 'x'),
            'x',
        ),
        'no mapping': ((BENCH + NUMBERS, '"\n\ndescription: x"'), 'must be a mapping'),
        'a negative one': (('[1, 2]', '[1, -2]'), 'friction'),
    }.values(),
)
def test_a_described_robot_with_a_mistake_is_an_error_that_names_it(
    installed: Path, change: tuple[str, ...], problem: str
) -> None:
    text = BENCH + NUMBERS
    for old, new in zip(change[::2], change[1::2], strict=True):
        assert old in text
        text = text.replace(old, new)
    with pytest.raises(ValueError, match=problem):
        pfd.load_robot(text)


def test_arguments_of_xacro_are_refused_where_the_description_is_a_urdf(installed: Path) -> None:
    (installed / 'urdf/bench.urdf.xacro').rename(installed / 'urdf/bench.urdf')
    text = (installed / 'urdf/bench.urdf').read_text()
    start, end = text.index('<xacro:arg'), text.index('<link name="world"/>')
    text = (text[:start] + text[end:]).replace('$(arg length)', '0.4').split(' xmlns', 1)
    (installed / 'urdf/bench.urdf').write_text(text[0] + text[1][text[1].index(' name') :])
    bench = BENCH.replace('.xacro, tip: flange, xacro: {length: 0.4}', ', tip: flange')
    assert pfd.load_robot(bench).tip == 'flange'
    with pytest.raises(ValueError, match="arguments of xacro, 'length'"):
        pfd.load_robot(bench, xacro={'length': 1})


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
        found = pfd.forward_dynamics(robot, q, qd, tau, scene=scene)
        assert np.abs(found - expected).max() <= 1e-9 * np.abs(expected).max()
