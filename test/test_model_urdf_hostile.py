# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A URDF that other readers get wrong: loaded right, or refused with its link or joint named."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
import re
import warnings
import xml.etree.ElementTree as ElementTree

import numpy as np
import pinocchio as pin
import pytest
from urdf_models import ARM, assert_same_physics, exact_angles, example
from zoo import BODY, ODD_ARM, joint, link, urdf

import pfd_core as pfd

ANYMAL = 'anymal_c_simple_description/urdf/anymal.urdf'
EXAMPLES = Path(pin.__file__).parents[4] / 'share' / 'example-robot-data' / 'robots'
TURRET = '<link name="turret"><inertial><origin xyz="0.01 -0.02 0.1" rpy="0.3 -0.2 0.5"/>'


def changed(old: str, new: str) -> str:
    assert old in ODD_ARM, old
    return ODD_ARM.replace(old, new, 1)


@pytest.mark.parametrize(
    'text',
    [
        changed('<mass value="4.0"/>', '<mass value="4.0 "/>'),
        changed('<mass value="4.0"/>', '<mass value="\t4.0\n"/>'),
        changed('<mass value="4.0"/>', '<mass value="+4."/>'),
        changed('<mass value="4.0"/>', '<mass value="0.4e1"/>'),
        changed('xyz="0.01 -0.02 0.1"', 'xyz="  0.01\t-0.02\n0.1 "'),
        ODD_ARM.replace('ixx="0.02"', 'ixx="0.02 "'),
        ODD_ARM.replace('lower="-1"', 'lower=" -1"').replace('effort="60"', 'effort="60 "'),
        ODD_ARM.replace('damping="0.7"', 'damping=" 0.7 "'),
        ODD_ARM.replace('<axis xyz="0 1 1"/>', '<axis xyz=" 0  1 1 "/>'),
    ],
)
def test_blanks_and_ways_to_write_a_number_change_nothing(text: str) -> None:
    assert text != ODD_ARM
    assert pfd.load_robot(text) == pfd.load_robot(ODD_ARM)


NO_NUMBERS = (
    *('', ' ', 'nan', 'inf', '-inf', '1_0', '\u0664', '\uff14.0', '\u00a04', '4\u2009', '0x10'),
    *('1,5', '1.5.2', '--1', '1e', 'e5', '1e5.0', '1 2', '4.0kg', '1e400', '1e-400', '.', '+'),
    *(str(10**400), '1e101', 'None', 'true', '4.0\x85', '4;', '{0}', '%s', '\u22121'),
)


@pytest.mark.parametrize('number', NO_NUMBERS)
def test_a_value_that_is_no_number_is_refused_and_the_link_or_joint_named(number: str) -> None:
    for old, new, where in (
        ('<mass value="4.0"/>', f'<mass value="{number}"/>', "<mass value> of link 'turret'"),
        ('ixx="0.02"', f'ixx="{number}"', "<inertia ixx> of link 'pedestal'"),
        (TURRET, TURRET.replace('-0.02', number), "<origin xyz> of link 'turret'"),
        (TURRET, TURRET.replace('-0.2', number), "<origin rpy> of link 'turret'"),
        ('damping="0.7"', f'damping="{number}"', "<dynamics damping> of joint 'j1'"),
        ('<axis xyz="0.3', f'<axis xyz="{number}', "<axis xyz> of joint 'j2'"),
    ):
        if number in ('', ' ') and 'xyz' in where:
            continue
        with pytest.raises(ValueError, match=re.escape(where)) as caught:
            pfd.load_robot(changed(old, new))
        assert len(str(caught.value)) < 500


@pytest.mark.parametrize('number', [n for n in NO_NUMBERS if 'inf' not in n and n != '1e101'])
def test_a_value_that_is_no_limit_is_refused_and_the_joint_named(number: str) -> None:
    for key, old in (('lower', '-1'), ('upper', '1.5'), ('velocity', '2'), ('effort', '60')):
        text = changed(f'{key}="{old}"', f'{key}="{number}"')
        with pytest.raises(ValueError, match=f"<limit {key}> of joint 'j1'"):
            pfd.load_robot(text)


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


def test_subnormal_numbers_are_numbers() -> None:
    robot = pfd.load_robot(changed('<mass value="4.0"/>', '<mass value="1e-310"/>'))
    assert robot.masses[0] == 0.6
    robot = pfd.load_robot(changed('xyz="0.01 -0.02 0.1"', 'xyz="1e-310 -0.02 0.1"'))
    assert robot.masses[0] == 4.6


@pytest.mark.parametrize(
    ('old', 'new', 'message'),
    [
        (
            'xyz="0.01 -0.02 0.1"',
            'xyz="0.01 -0.02"',
            "<origin xyz> of link 'turret' must",
        ),
        ('xyz="0.01 -0.02 0.1"', 'xyz="0 0 0 0"', "<origin xyz> of link 'turret' must"),
        ('rpy="0.3 -0.2 0.5"', 'rpy=""', "<origin rpy> of link 'turret' must be three"),
        ('xyz="0.02 0 0.3"', 'xyz="0.02 0"', "<origin xyz> of joint 'j1' must be three"),
        ('<axis xyz="0.3 -0.5 0.8"/>', '<axis xyz="1 0"/>', "<axis xyz> of joint 'j2' must be"),
        ('<axis xyz="0.3 -0.5 0.8"/>', '<axis/>', "<axis xyz> of joint 'j2' must be three"),
        ('<mass value="4.0"/>', '', "<inertial> of link 'turret' must have a <mass>"),
        ('<mass value="4.0"/>', '<mass/>', "<mass value> of link 'turret' must be a number"),
        ('<mass value="4.0"/>', '<mass value="4"/><mass value="5"/>', "'turret' has 2 .*<mass>"),
        ('<mass value="4.0"/>', '<mass value="-4"/>', "<mass value> of link 'turret' must not be"),
        ('ixx="0.02" ', '', "<inertia ixx> of link 'pedestal' must be a number, got none"),
        ('velocity="2" ', '', "<limit velocity> of joint 'j1' must be a number, got none"),
        ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 -1"/>' * 2, "joint 'j1' has 2 elements <axis>"),
        ('<link name="box">', '<link name="turret">', "two links named 'turret'"),
        ('name="j2" type', 'name="j1" type', "two joints named 'j1'"),
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


def test_an_inertia_may_miss_zero_by_rounding() -> None:
    # As of CAD: a link of 0.5 kg and 0.1 m whose smallest moment came out below zero.
    text = urdf(
        *('x', link('base'), link('arm', 0.5, '0.1 0 0', '0 0 0', '-5e-20 1e-19 1e-19 0 0 0')),
        joint('j', 'revolute', 'base', 'arm'),
    )
    assert pfd.load_robot(text).masses[0] == 0.5
    with pytest.raises(ValueError, match="<inertia> of link 'arm' must not be negative"):
        pfd.load_robot(text.replace('-5e-20', '-5e-7'))


@pytest.mark.parametrize('name', ['universe', 'world', 'base', 'root_joint', '{', '{0}', 'a b'])
def test_a_joint_may_have_any_name(name: str) -> None:
    plain = pfd.load_robot(ODD_ARM)
    for old in ('j1', 'j3'):
        robot = pfd.load_robot(changed(f'<joint name="{old}"', f'<joint name="{name}"'))
        assert name in robot.joint_names
        for key in ('masses', 'centers', 'inertias', 'rotations', 'position_upper'):
            assert getattr(robot, key).tobytes() == getattr(plain, key).tobytes()


def test_links_may_be_named_as_joints_are() -> None:
    plain = pfd.load_robot(ODD_ARM)
    names = re.findall('<link name="(.*?)"', ODD_ARM)
    joints = [*re.findall('<joint name="(.*?)"', ODD_ARM)[::-1], 'universe']
    text = ODD_ARM
    for old, new in zip(names, joints, strict=True):
        text = re.sub(f'(<link name|parent link|child link)="{old}"', rf'\1="{new}"', text)
    robot = pfd.load_robot(text)
    for key in ('masses', 'centers', 'inertias', 'rotations', 'translations', 'base_position'):
        assert getattr(robot, key).tobytes() == getattr(plain, key).tobytes()


@pytest.mark.parametrize('leg', ['LF', 'RF', 'LH', 'RH'])
def test_the_legs_of_anymal_c_have_the_physics_of_pinocchio(leg: str) -> None:
    text = example(ANYMAL)
    robot = pfd.load_robot(text, tip=f'{leg}_FOOT')
    assert robot.joint_names == (f'{leg}_HAA', f'{leg}_HFE', f'{leg}_KFE')
    other = renamed(text)
    again = pfd.load_robot(other, tip=f'{leg}_FOOT_')
    for key in ('masses', 'centers', 'inertias', 'rotations', 'translations'):
        assert getattr(robot, key).tobytes() == getattr(again, key).tobytes()
    assert_same_physics(again, other, {})


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
        ('<robot>' + '<link name="a">' * 1000 + '</link>' * 1000 + '</robot>', 'than 50 deep'),
        ('<robot>' + '<link>' * 1_000_000, 'than 50 deep'),
        ('<robot>' + '<visual/>' * 200_001 + '</robot>', 'more than 200000 elements'),
        (
            '<robot>' + ''.join(f'<link name="{i}"/>' for i in range(501)) + '</robot>',
            '501 links',
        ),
        ('<robot name="\ud800"/>', 'not well-formed XML'),
        ('<robot name="\0"/>', 'not well-formed XML'),
        ('<' + 'x' * 100_000 + '/>', 'starts with <robot>'),
        ('<robot>' + ' ' * (16 * 2**20) + '</robot>', 'characters, more than'),
    ],
    ids=range(10),
)
def test_hostile_xml_is_refused_in_a_short_line(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        pfd.load_robot(text)
    assert len(str(caught.value)) < 500
    assert '\n' not in str(caught.value)


def test_long_names_make_short_errors() -> None:
    name = 'n' * 100_000
    for old, new, choice in (
        ('<child link="turret"/>', f'<child link="{name}"/>', {}),
        ('name="j1"', f'name="{name}"', {'locked': {'nothing': 0.0}}),
        ('name="j1" type="revolute"', f'name="{name}" type="{name}"', {}),
        ('name="odd_arm"', f'name="{name}"', {'base': name}),
        ('name="odd_arm"', f'name="{name}"', {'tip': 'world'}),
        ('name="j1"', f'name="{name}"', {'locked': {'mount': 0.0}}),
        ('<mass value="4.0"/>', f'<mass value="{name}"/>', {}),
    ):
        with pytest.raises(ValueError, match='nnn') as caught:
            pfd.load_robot(changed(old, new), **choice)
        assert len(str(caught.value)) < 3000


@pytest.mark.parametrize(
    ('choice', 'message'),
    [
        ({'locked': {'j1': True}}, "joint 'j1' is locked must be a number"),
        ({'locked': {'j1': '0'}}, "joint 'j1' is locked must be a number"),
        ({'locked': {'j1': 10**400}}, "joint 'j1' is locked must fit float64"),
        ({'locked': {'j1': 1j}}, "joint 'j1' is locked must be a number"),
        ({'locked': ['j1']}, 'locked must map names of joints to positions'),
        ({'base': ['hand']}, 'base must be the name of a link'),
        ({'tip': 3}, 'tip must be the name of a link .* got 3'),
        ({'right_angle': 'no'}, 'right_angle must be a number'),
        ({'right_angle': np.nan}, 'right_angle must be finite'),
    ],
)
def test_wrong_choices_are_refused_and_named(choice: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pfd.load_robot(ODD_ARM, **choice)


def test_a_joint_may_be_locked_at_any_kind_of_number() -> None:
    at = pfd.load_robot(ODD_ARM, locked={'j1': 1.0})
    for one in (1, np.int8(1), np.float32(1), np.uint64(1), np.array(1.0)):
        assert pfd.load_robot(ODD_ARM, locked={'j1': one}) == at


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


def renamed(text: str) -> str:
    """Return a URDF with other names for its links, for Pinocchio takes joints for them."""
    root = ElementTree.fromstring(text.strip())
    for element in root.findall('link'):
        element.set('name', element.get('name') + '_')
    for element in (end for tag in ('parent', 'child') for end in root.findall(f'joint/{tag}')):
        element.set('link', element.get('link') + '_')
    return ElementTree.tostring(root, encoding='unicode')


def chains(text: str) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield each link that ends a chain of a URDF, and every movable joint outside that chain."""
    root = ElementTree.fromstring(text.strip())
    joints = root.findall('joint')
    above = {j.find('child').get('link'): j for j in joints}
    parents = {j.find('parent').get('link') for j in joints}
    for element in root.findall('link'):
        link, way = element.get('name'), set()
        if link in parents:
            continue
        tip = link
        while link in above:
            way.add(above[link].get('name'))
            link = above[link].find('parent').get('link')
        movable = (j for j in joints if j.get('type') in ('revolute', 'continuous', 'prismatic'))
        yield tip, {j.get('name'): near(0.1, j) for j in movable if j.get('name') not in way}


def followed(text: str, locked: dict[str, float]) -> dict[str, float]:
    """Return the positions of locked joints and of those that mimic them, one after another."""
    found = dict(locked)
    for follower in ElementTree.fromstring(text.strip()).findall('joint') * len(locked):
        mimic = None if follower.get('type') == 'fixed' else follower.find('mimic')
        if mimic is not None and mimic.get('joint') in found:
            factor, offset = float(mimic.get('multiplier', 1)), float(mimic.get('offset', 0))
            found.setdefault(follower.get('name'), factor * found[mimic.get('joint')] + offset)
    return found


def near(position: float, joint: ElementTree.Element) -> float:
    """Return the position within the limits of a joint that is nearest to a position."""
    limit = joint.find('limit')
    if limit is None or joint.get('type') == 'continuous':
        return position
    lower, upper = (float(limit.get(key, '0')) for key in ('lower', 'upper'))
    return min(max(position, lower), upper)


# Of humanoids with many fingers, not all.
CHAINS_OF_A_FILE = 4
REFUSALS = 'no joint moves|mimics|must not be negative in any|has no <inertial>'


@pytest.mark.slow
@pytest.mark.filterwarnings('ignore::pfd_core.PhysicsWarning')
def test_every_chain_of_the_examples_has_the_physics_of_pinocchio_or_is_refused() -> None:
    loaded, refused = 0, []
    for file in sorted(EXAMPLES.rglob('*.urdf')):
        other = renamed(exact_angles(file.read_text(encoding='utf-8')))
        for tip, locked in islice(chains(other), CHAINS_OF_A_FILE):
            try:
                robot = pfd.load_robot(other, tip=tip, locked=locked, right_angle=-1.0)
            except ValueError as error:
                refused.append(f'{file.name} {tip}: {error}')
                continue
            loaded += 1
            assert_same_physics(robot, other, followed(other, locked))
    assert loaded > len(refused)
    assert not [line for line in refused if not re.search(REFUSALS, line)]


# ---- misspelt names, and names of other tools ------------------------------------------------


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
            pfd.load_robot(NAMED.replace(right, wrong))
        except ValueError:  # without its <inertial> the arm has no body
            assert right == 'inertial>'
    (warning,) = found
    assert re.search(text, str(warning.message))
    assert issubclass(warning.category, pfd.PhysicsWarning)
    assert warning.filename == __file__


def test_unexpanded_xacro_is_an_error_with_the_command_to_run() -> None:
    text = NAMED.replace('<link name="base"/>', '<xacro:arm/><link name="base"/>')
    with pytest.raises(ValueError, match=r'<xacro:arm>, which is not expanded: load the \.xacro'):
        pfd.load_robot(text)
