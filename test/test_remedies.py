# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a refusal of load_robot advises can be done, and gives the arm of the file."""

from __future__ import annotations

import ast
import re

from oracle import assert_same_physics
import pytest
from zoo import BODY, FORK, TWO_ARMS, joint, link, urdf

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


def test_the_arms_of_the_edits_are_those_that_load() -> None:
    assert pfd.load_robot(CHAIN).joint_names == ('turn', 'lift', 'level')


# Refusals that give code: the text, the choice that is refused, the argument that is advised, and
# the joints that move when it is copied.
CODE = [
    (FORK, {}, 'tip', ('shoulder', 'wrist')),
    (FORK, {}, 'locked', ('shoulder', 'wrist')),
    (TWO_ARMS, {}, 'tip', ('lift', 'left_shoulder', 'left_elbow')),
    (TWO_ARMS, {}, 'locked', ('lift', 'left_shoulder', 'left_elbow')),
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
    pytest.param(
        *("'right_finger' mimics 'left_finger'", FOLLOWS, {'tip': 'right'}, []),
        *({'tip': 'right', 'locked': {'left_finger': 0.2}}, ('shoulder', 'wrist')),
        id='lock the leader',
    ),
    pytest.param(
        *("'right_finger' mimics 'left_finger'", FOLLOWS, {'tip': 'right'}),
        *([(RULE, '')], {'tip': 'right'}, ('shoulder', 'wrist', 'right_finger')),
        id='take the mimic away',
    ),
    pytest.param(
        "'level'", UNLED, {}, [('<mimic joint="nobody"/>', '')], {}, ALL, id='mend the mimic'
    ),
    pytest.param(
        "'turn' is floating",
        FLOATING,
        {},
        [('floating', 'fixed')],
        {},
        ('lift', 'level'),
        id='make it fixed',
    ),
    pytest.param(
        *(
            "'level', off the chain",
            AERIAL,
            {'tip': 'l1'},
            [('floating', 'fixed')],
            {'tip': 'l1'},
            ('turn', 'lift'),
        ),
        id='make a joint off the chain fixed',
    ),
    pytest.param(
        "'l2' hangs on joints 'level' and 'loop'",
        LOOPED,
        {},
        [(LOOP, '')],
        {},
        ALL,
        id='cut a joint of the loop',
    ),
    pytest.param(
        *(
            "link 'l2', moved by joint 'level', has no <inertial>",
            BARE,
            {},
            [(link('l2'), link('l2', 0.5, J=BODY))],
            {},
            ALL,
        ),
        id='add an inertial',
    ),
    pytest.param(
        "one link without a parent.*'base', 'l2'",
        OPEN,
        {},
        [('</robot>', f'{LEVEL}\n</robot>')],
        {},
        ALL,
        id='one root',
    ),
    pytest.param(
        *("tip 'l9'.*'base'", CHAIN, {'tip': 'l9'}, [], {'tip': 'l1'}, ('turn', 'lift')),
        id='a link that it has',
    ),
    pytest.param(
        *(
            "'l0' is not below base 'l2'",
            CHAIN,
            {'base': 'l2', 'tip': 'l0'},
            [],
            {'base': 'l0', 'tip': 'l2'},
            ('lift', 'level'),
        ),
        id='a tip below the base',
    ),
    pytest.param(
        *(
            "'j9'.*no such joint.*'turn'",
            CHAIN,
            {'locked': {'j9': 0.0}},
            [],
            {'locked': {'turn': 0.1}},
            ('lift', 'level'),
        ),
        id='a joint that can be locked',
    ),
    pytest.param(
        *(
            "cannot lock joint 'lift' at 3.0: its limits are -2.0 and 2.5",
            CHAIN,
            {'locked': {'lift': 3.0}},
            [],
            {'locked': {'lift': 2.5}},
            ('turn', 'level'),
        ),
        id='a position within the limits',
    ),
    pytest.param(
        'version',
        edited(CHAIN, ('name="chain"', 'name="chain" version="7"')),
        *({}, [('version="7"', 'version="1.0"')], {}, ALL),
        id='a known version',
    ),
    pytest.param(
        "'lift' has type 'hinge'",
        edited(CHAIN, ('name="lift" type="revolute"', 'name="lift" type="hinge"')),
        *({}, [('"hinge"', '"revolute"')], {}, ALL),
        id='a known type',
    ),
    pytest.param(
        *('circle', follower('joint="level"'), {}, [('<mimic joint="level"/>', '')], {}, ALL),
        id='open the circle of mimics',
    ),
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


def test_the_advice_for_a_tree_of_many_joints_can_be_copied() -> None:
    far = '<limit lower="0.5" upper="1" velocity="3" effort="40"/>'
    fingers = [
        joint(f'f{k}', 'revolute', 'l2', f'tip{k}', f'0 0 {k}', extra=far) for k in range(20)
    ]
    tips = [link(f'tip{k}', 0.1, J=BODY) for k in range(20)]
    text = urdf('hand', *LINKS, TURN, LIFT, LEVEL, *tips, *fingers)
    with pytest.raises(pfd.TreeError, match='tip=') as error:
        pfd.load_robot(text)
    robot = pfd.load_robot(text, locked=error.value.positions)
    assert robot == pfd.load_robot(text, tip=error.value.tip)
    assert_same_physics(robot, text, error.value.positions)
    cure = re.search(r'locked=({.*?})', str(error.value))
    assert cure is not None
    assert ast.literal_eval(cure[1]) == dict.fromkeys(error.value.patterns) == {'f*': None}
    assert robot == pfd.load_robot(text, locked={'f*': None})
