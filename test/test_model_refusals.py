# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Refusals of load_robot: by file, line and name; what they advise gives the arm of the file."""

from __future__ import annotations

import ast
from pathlib import Path
import re

import numpy as np
from oracle import DYNAMICS, assert_same_physics, positions_in
import pinocchio as pin
import pytest
from zoo import ARM, BODY, FORK, ODD_ARM, TWO_ARMS, changed, exact_angles, joint, link, urdf

import pfd_core as pfd

pytestmark = pytest.mark.filterwarnings('ignore::pfd_core.PhysicsWarning')
Choice = dict[str, object]
Edit = tuple[str, str]

LINKS = (link('base'), *(link(f'l{k}', 1.0, '0.1 0 0', J=BODY) for k in range(3)))
TURN = joint('turn', 'revolute', 'base', 'l0')
LIFT = joint('lift', 'revolute', 'l0', 'l1', '0 0 0.3', axis='0 1 0')
LEVEL = joint('level', 'revolute', 'l1', 'l2', '0.4 0 0', axis='0 1 0')
CHAIN = urdf('chain', *LINKS, TURN, LIFT, LEVEL)
AXIS = '<axis xyz="0 1 0"/>'


def edited(text: str, *edits: Edit) -> str:
    """Return a text with changes, each of which must be there to be made."""
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    return text


def follower(rule: str) -> str:
    """Return the chain in which the last joint mimics another."""
    return urdf('chain', *LINKS, TURN, LIFT, edited(LEVEL, (AXIS, f'{AXIS}<mimic {rule}/>')))


RULE = '<mimic joint="left_finger" multiplier="-1"/>'
FOLLOWS = edited(FORK, ('<axis xyz="0 -1 0"/>', f'<axis xyz="0 -1 0"/>{RULE}'))
UNLED = follower('joint="nobody"')
FLOATING = edited(CHAIN, ('"turn" type="revolute"', '"turn" type="floating"'))
AERIAL = urdf(
    'aerial', *LINKS, TURN, LIFT, edited(LEVEL, ('revolute', 'floating'), ('"l1"', '"l0"'))
)
LOOP = joint('loop', 'revolute', 'base', 'l2')
LOOPED = edited(CHAIN, ('</robot>', f'{LOOP}\n</robot>'))
BARE = edited(CHAIN, (link('l2', 1.0, '0.1 0 0', J=BODY), link('l2')))
OPEN = edited(CHAIN, (LEVEL, ''))
VERSION_7 = edited(CHAIN, ('name="chain"', 'name="chain" version="7"'))
HINGED = edited(CHAIN, ('name="lift" type="revolute"', 'name="lift" type="hinge"'))
END = '</robot>'


def test_the_arms_of_the_edits_are_those_that_load() -> None:
    assert pfd.load_robot(CHAIN).joint_names == ('turn', 'lift', 'level')


# Refusals that give code: the text, the choice that is refused, the argument that is advised, and
# the joints that move when it is copied.
CODE = [
    (follower('joint="lift" multiplier="0" offset="0.5"'), {}, 'locked', ('turn', 'lift')),
    (UNLED, {}, 'locked', ('turn', 'lift')),
    (FLOATING, {}, 'base', ('lift', 'level')),
]


@pytest.mark.parametrize(('text', 'refused', 'argument', 'moving'), CODE, ids=range(len(CODE)))
def test_an_argument_copied_from_a_refusal_loads_the_arm_of_the_file(
    text: str, refused: Choice, argument: str, moving: tuple[str, ...]
) -> None:
    with pytest.raises(ValueError, match=f'{argument}=') as error:
        pfd.load_robot(text, **refused)
    written = re.search(rf"{argument}=('[^']*'|{{[^}}]*}})", str(error.value))
    assert written is not None
    choice = {**refused, argument: ast.literal_eval(written[1])}
    robot = pfd.load_robot(text, **choice)
    assert robot.joint_names == moving
    assert_same_physics(robot, text, pfd.locked_joints(text, **choice))


# Refusals that give words: what they name, the text, the choice that is refused, the edits and
# the choice that carry the words out, and the joints that move then.
ALL = ('turn', 'lift', 'level')
WORDS = [
    # Lock the leader, or take the mimic away; of an unknown leader, or a circle, alike.
    (
        *("'right_finger' mimics 'left_finger'", FOLLOWS, {'tip': 'right'}, []),
        *({'tip': 'right', 'locked': {'left_finger': 0.2}}, ('shoulder', 'wrist')),
    ),
    (
        *("'right_finger' mimics 'left_finger'", FOLLOWS, {'tip': 'right'}),
        *([(RULE, '')], {'tip': 'right'}, ('shoulder', 'wrist', 'right_finger')),
    ),
    ("'level'", UNLED, {}, [('<mimic joint="nobody"/>', '')], {}, ALL),
    ('circle', follower('joint="level"'), {}, [('<mimic joint="level"/>', '')], {}, ALL),
    # Make a joint fixed, on the chain and off it.
    ("'turn' is floating", FLOATING, {}, [('floating', 'fixed')], {}, ('lift', 'level')),
    (
        *("'level', off the chain", AERIAL, {'tip': 'l1'}, [('floating', 'fixed')]),
        *({'tip': 'l1'}, ('turn', 'lift')),
    ),
    # Cut a joint of a loop; add an <inertial>; leave one root.
    ("'l2' hangs on joints 'level' and 'loop'", LOOPED, {}, [(LOOP, '')], {}, ALL),
    (
        *("link 'l2', moved by joint 'level', has no <inertial>", BARE, {}),
        *([(link('l2'), link('l2', 0.5, J=BODY))], {}, ALL),
    ),
    ("one link without a parent.*'base', 'l2'", OPEN, {}, [(END, f'{LEVEL}\n{END}')], {}, ALL),
    # Links and joints that it has, below the base, at positions within the limits.
    ("tip 'l9'.*'base'", CHAIN, {'tip': 'l9'}, [], {'tip': 'l1'}, ('turn', 'lift')),
    (
        *("'l0' is not below base 'l2'", CHAIN, {'base': 'l2', 'tip': 'l0'}, []),
        *({'base': 'l0', 'tip': 'l2'}, ('lift', 'level')),
    ),
    (
        *("'j9'.*no such joint.*'turn'", CHAIN, {'locked': {'j9': 0.0}}, []),
        *({'locked': {'turn': 0.1}}, ('lift', 'level')),
    ),
    (
        *(
            "lock joint 'lift' at 3.0: its limits are -2.0 and 2.5",
            CHAIN,
            {'locked': {'lift': 3.0}},
        ),
        *([], {'locked': {'lift': 2.5}}, ('turn', 'level')),
    ),
    # A known version and type.
    ('version', VERSION_7, {}, [('version="7"', 'version="1.0"')], {}, ALL),
    ("'lift' has type 'hinge'", HINGED, {}, [('"hinge"', '"revolute"')], {}, ALL),
]


@pytest.mark.parametrize(('about', 'text', 'refused', 'edits', 'choice', 'moving'), WORDS)
def test_words_of_a_refusal_carried_out_load_the_arm_of_the_file(
    about: str,
    text: str,
    refused: Choice,
    edits: list[Edit],
    choice: Choice,
    moving: tuple[str, ...],
) -> None:
    with pytest.raises(ValueError, match=about):
        pfd.load_robot(text, **refused)
    mended = edited(text, *edits)
    robot = pfd.load_robot(mended, **choice)
    assert robot.joint_names == moving
    assert_same_physics(robot, mended, pfd.locked_joints(mended, **choice))


BAD = [
    (ODD_ARM, {'base': 'nowhere'}, "base 'nowhere'.*'world'"),
    (ODD_ARM, {'base': 'hand', 'tip': 'tool'}, 'no joint moves'),
    (ODD_ARM, {'base': 'hand'}, "no joint moves below 'hand'"),
    (ODD_ARM, {'locked': {'mount': 0.0}}, "'mount'.*fixed joint"),
    (ODD_ARM, {'locked': {'j1': np.nan}}, "'j1' is locked must be finite"),
    ('<robot name="x"><link', {}, 'not well-formed XML'),
    ('<model/>', {}, 'starts with <robot>'),
    ('<robot name="x"/>', {}, 'no <link>'),
    (urdf('x', *ARM, joint('hinge', 'planar', 'base', 'arm')), {}, "'hinge' is planar"),
]


@pytest.mark.parametrize(('text', 'choice', 'message'), BAD, ids=range(len(BAD)))
def test_a_robot_that_is_no_chain_is_refused_and_named(
    text: str, choice: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        pfd.load_robot(text, **choice)


# Trees: a gripper whose second finger follows, a hand of three fingers, a head, two arms.


def mimicking(text: str, follower: str, rule: str) -> str:
    """Return a URDF in which a joint mimics another."""
    return re.sub(
        rf'(name="{follower}".*?<axis [^>]*/>)', rf'\1<mimic {rule}/>', text, count=1, flags=re.S
    )


LIMITS = '<limit lower="{}" upper="{}" velocity="3" effort="40"/>'


MIMIC_FORK = mimicking(
    FORK, 'right_finger', 'joint="left_finger" multiplier="-1" offset="0.02"'
).replace('<axis xyz="0 1 0"/><limit lower="-2"', '<axis xyz="0 1 0"/><limit lower="0.01"')


HAND = urdf(
    'hand',
    *(link('base'), link('arm', 2.0, '0 0 0.1', '0 0 0', BODY)),
    *(link(f'l{k}', 1.0, '0 0.1 0.1', '0 0 0', BODY) for k in range(4)),
    *(link(f'{side}{k}', 0.1, '0 0 0.02', '0 0 0', BODY) for side in 'abc' for k in range(2)),
    joint('shoulder', 'revolute', 'base', 'arm', axis='0 1 0'),
    joint('w0', 'revolute', 'arm', 'l0', '0 0 0.4', axis='1 0 0'),
    *(joint(f'w{k}', 'revolute', f'l{k - 1}', f'l{k}', '0 0 .1', axis='1 1 0') for k in (1, 2, 3)),
    *(joint(f'f_{s}0', 'revolute', 'l3', f'{s}0', '0.1 0 0.1', axis='0 1 0') for s in 'abc'),
    *(joint(f'f_{s}1', 'revolute', f'{s}0', f'{s}1', '0 0 0.1', axis='0 1 0') for s in 'abc'),
)


HEAD = urdf(
    'head',
    *(link('base'), link('chest', 5.0, '0 0 0.1', '0 0 0', BODY), link('eye', 0.5, J=BODY)),
    *(link('upper', 2.0, '0.1 0 0', '0 0 0', BODY), link('fore', 1.0, '0.1 0 0', J=BODY)),
    joint('waist', 'continuous', 'base', 'chest', extra=''),
    joint(
        'nod', 'revolute', 'chest', 'eye', '0 0 0.5', axis='0 1 0', extra=LIMITS.format(0.2, 1.0)
    ),
    joint('shoulder', 'revolute', 'chest', 'upper', '0 0.2 0.3', axis='0 1 0'),
    joint('elbow', 'revolute', 'upper', 'fore', '0.3 0 0', axis='0 1 0'),
)


FINGERS = urdf(
    *('fingers', *LINKS, TURN, LIFT, LEVEL),
    *(link(f'tip{k}', 0.1, J=BODY) for k in range(20)),
    *(
        joint(f'f{k}', 'revolute', 'l2', f'tip{k}', f'0 0 {k}', extra=LIMITS.format(0.5, 1))
        for k in range(20)
    ),
)
EMPTY = link('hand') + joint('grip', 'revolute', 'fore', 'hand', axis='0 1 0')
TREES = [
    (FORK, 'palm', ('shoulder', 'wrist')),
    (MIMIC_FORK, 'palm', ('shoulder', 'wrist')),
    (HAND, 'l3', ('shoulder', 'w0', 'w1', 'w2', 'w3')),
    (HEAD, 'fore', ('waist', 'shoulder', 'elbow')),
    # No arm ends in a link without mass.
    (HEAD.replace('</robot>', f'{EMPTY}</robot>'), 'fore', ('waist', 'shoulder', 'elbow')),
    (TWO_ARMS, 'left_fore', ('lift', 'left_shoulder', 'left_elbow')),
    (FINGERS, 'l2', ('turn', 'lift', 'level')),
]


@pytest.mark.parametrize(('text', 'tip', 'moving'), TREES, ids=range(len(TREES)))
def test_tip_and_locks_of_a_refused_tree_give_the_arm_of_the_longest_chain(
    text: str, tip: str, moving: tuple[str, ...]
) -> None:
    with pytest.raises(pfd.TreeError) as refused:
        pfd.load_robot(text)
    assert refused.value.tip == tip
    with pytest.warns(pfd.PhysicsWarning, match='are locked') as said:
        robot = pfd.load_robot(text, tip=tip)
    assert len(said) == 1
    assert '\n' not in str(said[0].message)
    assert robot.joint_names == moving
    locked = pfd.locked_joints(text, tip=tip)
    few = [*locked][: 8 if len(locked) < 9 else 1]
    assert all(repr(name) in str(said[0].message) for name in few)
    assert pfd.load_robot(text, locked=refused.value.positions) == robot
    assert pfd.load_robot(text, tip=tip, locked=locked) == robot
    # What the message advises can be copied; many joints are named by a pattern.
    for argument in ('tip', 'locked'):
        written = re.search(rf"{argument}=('[^']*'|{{[^}}]*}})", str(refused.value))
        assert written is not None
        advice = ast.literal_eval(written[1])
        assert pfd.load_robot(text, **{argument: advice}) == robot
    assert text != FINGERS or advice == dict.fromkeys(refused.value.patterns) == {'f*': None}

    # The whole tree with the other joints locked, reduced by Pinocchio.
    whole = pin.buildModelFromXML(exact_angles(text))
    assert set(locked) == {*whole.names} - {'universe', *moving}
    for name, position in locked.items():
        place = whole.joints[whole.getJointId(name)]
        limits = whole.lowerPositionLimit[place.idx_q], whole.upperPositionLimit[place.idx_q]
        assert limits[0] <= position <= limits[1]
    fixed = [whole.getJointId(name) for name in locked]
    reduced = pin.buildReducedModel(
        whole, fixed, positions_in(whole, robot, np.zeros(robot.n), locked)
    )
    assert list(reduced.names[1:]) == list(moving)
    data = reduced.createData()
    rng = np.random.default_rng(44)
    for _ in range(5):
        q, qd, qdd = rng.uniform(-1.5, 1.5, (3, robot.n))
        tau = pin.rnea(reduced, data, positions_in(reduced, robot, q, {}), qd, qdd)
        got = pfd.inverse_dynamics(robot, q, qd, qdd)
        assert np.abs(got - tau).max() <= DYNAMICS * np.abs(tau).max()


@pytest.mark.parametrize(
    ('text', 'locked', 'found'),
    [
        (FORK, {'*_finger': 0.1}, {'left_finger': 0.1, 'right_finger': 0.1}),
        (FORK, {'*_finger': 0.1, 'left_*': 0.2}, {'left_finger': 0.1, 'right_finger': 0.1}),
        (FORK, {'*_finger': 0.1, 'left_finger': 0.2}, {'left_finger': 0.2, 'right_finger': 0.1}),
        (MIMIC_FORK, {'*_finger': 0.1}, {'left_finger': 0.1, 'right_finger': -0.1 + 0.02}),
        (MIMIC_FORK, {'left_*': 0.1}, {'left_finger': 0.1, 'right_finger': -0.1 + 0.02}),
        ('planar2', {'elb[o]w': 0.1}, {'elbow': 0.1}),
    ],
    ids=range(6),
)
def test_a_pattern_locks_the_joints_that_it_matches_and_names_have_precedence(
    text: str, locked: dict[str, float], found: dict[str, float]
) -> None:
    assert pfd.locked_joints(text, locked=locked) == found
    assert pfd.load_robot(text, locked=locked) == pfd.load_robot(text, locked=found)


@pytest.mark.parametrize('source', [FORK, 'planar2'])
def test_a_pattern_that_matches_no_joint_is_refused_by_name(source: str) -> None:
    with pytest.raises(ValueError, match=r"cannot lock 'thumb_\*': it matches no joint"):
        pfd.load_robot(source, locked={'thumb_*': 0.0})


NO_NUMBERS = (
    *('', 'nan', '1_0', '\u0664', '0x10', '1,5', '1 2', '4.0kg', '1e400', '1e101', '1e-400'),
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


# Line 1 is the declaration; link, joint and transmission begin in lines 5, 11 and 17.
LINED = """<?xml version="1.0"?>
<!-- an arm -->
<robot name="arm" version="1.1">
  <link name="base"/>
  <link name="arm">
    <inertial>
      <mass value="1"/>
      <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>
    </inertial>
  </link>
  <joint name="j" type="revolute">
    <parent link="base"/><child link="arm"/>
    <axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
    <dynamics damping="0"/>
  </joint>
  <transmission name="t"><type>SimpleTransmission</type>
    <joint name="j"/>
    <actuator name="m"><motorInertia>0</motorInertia></actuator>
  </transmission>
</robot>"""


MASS = '<mass value="1"/>'


INERTIA = 'ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"'


MIMICS = '<mimic joint="{}"/></joint>'


@pytest.mark.parametrize(
    ('old', 'new', 'line', 'words'),
    [
        (MASS, '<mass value="1,5"/>', 7, "<mass value> of link 'arm'"),
        (MASS, '<mass value="-1"/>', 6, "<mass value> of link 'arm'"),
        (MASS, '', 6, "<inertial> of link 'arm'"),
        ('iyz="0" ', '', 8, "<inertia iyz> of link 'arm'"),
        (INERTIA, INERTIA.replace('ixx="1"', 'ixx="-1"'), 6, "<inertia> of link 'arm'"),
        ('link name="arm"', 'link name="base"', 5, r"two links named 'base' \(line [45]\)"),
        ('type="revolute"', 'type="ball"', 11, "joint 'j' has type 'ball'"),
        ('<child link="arm"/>', '<child link="leg"/>', 11, "joint 'j' names link 'leg'"),
        ('xyz="0 0 1"', 'xyz="0 1"', 13, "<axis xyz> of joint 'j'"),
        ('xyz="0 0 1"', 'xyz="0 0 0"', 13, "<axis xyz> of joint 'j'"),
        ('effort="1"', 'effort="nan"', 14, "<limit effort> of joint 'j'"),
        ('damping="0"', 'damping="-1"', 15, "<dynamics damping> of joint 'j'"),
        ('</joint>', MIMICS.format('j'), 11, "<mimic> in a circle of joints: 'j'"),
        ('>SimpleT', '>pkg/WristT', 17, "transmission 't'.*'WristTransmission'"),
        ('>0</motor', '>a</motor', 19, "motorInertia of transmission 't'"),
        ('version="1.1"', 'version="2.0"', 3, "<robot version> must be one of 1.0, .* got '2.0'"),
        ('version="1.1"', 'version=""', 3, "<robot version> must be one of .* got ''"),
        (MASS, f'<origin quat_xyzw="0 0 0 0"/>{MASS}', 7, 'must be four numbers, not all 0'),
        (MASS, f'<origin quat_xyzw="1 0 0"/>{MASS}', 7, "must be four numbers, got '1 0 0'"),
        (MASS, f'<origin quat_xyzw="1 0 0 x"/>{MASS}', 7, "must be a number, got 'x'"),
        (MASS, f'<origin rpy="0 0 0" quat_xyzw="1 0 0 0"/>{MASS}', 7, 'has rpy and quat_xyzw'),
        (MASS, f'<origin xyz="0 0"/>{MASS}', 7, "<origin xyz> of link 'arm' must"),
        (MASS, MASS * 2, 7, "link 'arm' has 2 elements <mass>"),
        ('xyz="0 0 1"', '', 13, "<axis xyz> of joint 'j' must be three"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/>' * 2, 13, "joint 'j' has 2 elements <axis>"),
        ('<link name="base"/>', '<link/>', 4, 'a <link> without a name'),
        ('<robot', '<!DOCTYPE robot>\n<robot', 3, 'no <!DOCTYPE>'),
        ('<link name="base"/>', '<link name="base">', 21, 'not well-formed XML: mismatched tag'),
    ],
)
def test_an_error_about_an_element_starts_with_its_file_and_line(
    tmp_path: Path, old: str, new: str, line: int, words: str
) -> None:
    assert LINED.count(old) >= 1
    text = LINED.replace(old, new, 1)
    path = tmp_path / 'arm.urdf'
    path.write_text(text)
    for source, place in ((path, re.escape(str(path))), (f'\n{text}', 'URDF text')):
        number = line + (source is not path)
        with pytest.raises(ValueError, match=f'^{place}, line {number}: .*{words}') as caught:
            pfd.load_robot(source)
        assert '\n' not in str(caught.value)


def test_a_circle_of_mimics_is_named_wherever_it_is() -> None:
    links = [link(name, 1, J=BODY) for name in 'abcde']
    joints = [
        joint(f'j{k}', 'continuous', *pair) for k, pair in enumerate(('ab', 'bc', 'cd', 'de'))
    ]
    for k, leader in ((0, 'j1'), (1, 'j2'), (2, 'j3'), (3, 'j1')):
        joints[k] = joints[k].replace('</joint>', MIMICS.format(leader))
    with pytest.raises(ValueError, match=r"line 9: <mimic> in a circle.*: 'j1', 'j2', 'j3'$"):
        pfd.load_robot(urdf('arm', *links, *joints))


def test_a_transmission_of_an_unknown_type_is_named_with_its_line() -> None:
    text = LINED.replace('>0</motorInertia>', '/>').replace('<motorInertia', '<gain')
    with pytest.warns(pfd.PhysicsWarning, match=r"<transmission name='t'> of type 'Wr.*line 17\)"):
        pfd.load_robot(text.replace('>SimpleT', '>pkg/WristT'))
    for name in ('SimpleT', 'transmission_interface/DifferentialT'):
        assert pfd.load_robot(text.replace('>SimpleT', f'>{name}')).n == 1


BOMB = '<!DOCTYPE r [<!ENTITY a0 "x">{}]><robot name="&a30;"><link name="a"/></robot>'.format(
    ''.join(f'<!ENTITY a{i + 1} "&a{i};&a{i};">' for i in range(30))
)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        (BOMB, 'a URDF has no <!DOCTYPE>'),
        ('<robot>' + '<link name="a"/>' * 1_000_000 + '</robot>', 'than the 100000 elements'),
        (f'<robot><link name="{"x" * 16_000_000}"/></robot>', 'no joint moves'),
        (f'<robot version="{"1" * 16_000_000}"/>', '<robot version> must be one of 1.0, 1.1, 1.2'),
        (
            f'<robot><link name="a"/><joint name="j" type="{"x" * 16_000_000}"/></robot>',
            'has type',
        ),
        ('<!DOCTYPE robot SYSTEM "file:///etc/passwd"><robot/>', 'a URDF has no <!DOCTYPE>'),
        ('<robot>' + ''.join(f'<link name="{i}"/>' for i in range(501)) + '</robot>', '501 links'),
        ('<robot>' + '<a>' * 2_000_000 + '</a>' * 2_000_000 + '</robot>', 'more than 100 deep'),
        ('<robot name="\ud800"/>', 'not well-formed XML'),
        ('<robot name="\0"/>', 'not well-formed XML'),
        ('<robot>' + ' ' * (16 * 2**20) + '</robot>', 'characters, more than'),
    ],
    ids=range(11),
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
