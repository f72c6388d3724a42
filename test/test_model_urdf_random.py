# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Damaged URDFs: an accepted robot has the masses and limits of its file, as a second reader finds.

The reader below shares nothing with the package's: another XML parser, numbers by the decimal
module, masses summed by walking down from the joints. Every file that is accepted is compared
with it in masses and limits, and with Pinocchio in everything else.
"""

from __future__ import annotations

from decimal import Decimal, InvalidOperation
import math
import re
from xml.dom import minidom

from hypothesis import event, find, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tolerances import DYNAMICS
from urdf_models import assert_same_physics, exact_angles
from zoo import FORK, ODD_ARM, STRAIGHT_ARM

import pfd_core as pfd

# URDF texts, and the joints to lock in them.
FILES = (
    (ODD_ARM, {}),
    (exact_angles(STRAIGHT_ARM), {}),
    (FORK, {'left_finger': 0.02, 'right_finger': 0.03}),
)
# Attributes that hold numbers, and how many; those of <limit> may be infinite.
COUNTS = {
    ('mass', 'value'): 1,
    **{('inertia', key): 1 for key in ('ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz')},
    **{('limit', key): 1 for key in ('lower', 'upper', 'velocity', 'effort')},
    **{('dynamics', key): 1 for key in ('damping', 'friction')},
    **{('origin', key): 3 for key in ('xyz', 'rpy')},
    ('axis', 'xyz'): 3,
}

ONCE = ('inertial', 'mass', 'inertia', 'origin', 'axis', 'limit', 'dynamics', 'parent', 'child')

# Around a number, and in its place.
ENDS = (
    *(' ', '\t', '\n', '   ', '\u00a0', '\u2009', '_0', 'e', 'kg', ',5', '.5.', 'd0', '\u0664'),
    *('f', ';', 'e1', '0' * 30),
)
STARTS = (' ', '\t', '\r\n', '\u3000', '\x85', '-', '+', '\u2212', '0')
OTHERS = (
    *('', 'nan', 'inf', '-inf', '1e-310', '1e400', '0x1p3', '1_0', '\u0661\u0662', '\uff11'),
    *('1e-400', '9' * 400, '-0.0', '5e-324', '.5', '1.', '+2', '1E-2', '007', '1 1'),
    *('-', '.', '+-1', '1-', '..', '1.2.3'),
)


@st.composite
def respelled(draw: st.DrawFn, word: str) -> str:
    """Draw what is written in the place of a number: most are numbers, most of them others."""
    return draw(
        st.sampled_from(ENDS).map(lambda end: word + end)
        | st.sampled_from(STARTS).map(lambda start: start + word)
        | st.sampled_from(OTHERS)
        | st.floats(-2.0, 2.0).map(repr)
        | st.sampled_from((word.replace('0', 'O'), word.replace('.', ',')))
    )


def respaced(value: str) -> st.SearchStrategy[str]:
    """Return what is written in the place of several numbers."""
    words = value.split()
    return st.sampled_from(
        (
            *(' '.join(words[:-1]), f'{value} 0', f'  {value}  ', ' '.join(reversed(words))),
            *(between.join(words) for between in (', ', '\t \n', '\u00a0')),
        )
    )


@st.composite
def damaged_files(draw: st.DrawFn) -> tuple[str, dict[str, float]]:
    """Draw a URDF with one to three attributes, elements or names changed, and what is locked."""
    text, locked = draw(st.sampled_from(FILES))
    document = minidom.parseString(text)
    for _ in range(draw(st.integers(1, 3))):
        elements = [e for e in document.getElementsByTagName('*') if e.parentNode is not document]
        spots = [
            (e, k) for e in elements for k, _ in e.attributes.items() if (e.tagName, k) in COUNTS
        ]
        # Most changes are those of a number.
        change = draw(st.sampled_from(('number',) * 8 + ('list', 'lose', 'cut', 'copy', 'name')))
        if change in ('number', 'list'):
            several = [(e, k) for e, k in spots if COUNTS[e.tagName, k] > 1]
            element, key = draw(st.sampled_from(spots if change == 'number' else several))
            value = element.getAttribute(key)
            if change == 'list':
                value = draw(respaced(value))
            else:
                words = value.split(' ')
                at = draw(st.integers(0, len(words) - 1))
                words[at] = draw(respelled(words[at]))
                value = ' '.join(words)
            element.setAttribute(key, value)
        elif change == 'lose':
            element, key = draw(st.sampled_from(spots))
            element.removeAttribute(key)
        elif change == 'cut':
            element = draw(st.sampled_from(elements))
            element.parentNode.removeChild(element)
        elif change == 'copy':
            element = draw(st.sampled_from(elements))
            element.parentNode.appendChild(element.cloneNode(True))
        else:
            named = [e for e in elements if e.hasAttribute('name')]
            names = [e.getAttribute('name') for e in named]
            chosen = draw(st.sampled_from(named))
            chosen.setAttribute('name', draw(st.sampled_from([*names, 'universe', '{0}', ''])))
    return document.toxml(), locked


def number(text: str, infinite: bool) -> float | None:
    """Return the number that a text is to a strict and exact reader, or None."""
    text = text.strip(' \t\r\n')
    if infinite and text in ('inf', '-inf'):
        return float(text)
    if not text.isascii() or '_' in text or not set(text) <= set('0123456789+-.eE'):
        return None
    try:
        exact = Decimal(text)
    except InvalidOperation:
        return None
    if abs(exact) > Decimal('1e100') or (exact and not float(exact)):
        return None
    return float(exact)


def meant(text: str) -> dict[str, object] | None:
    """Return the mass of each link and all joints, or None if the file does not say them."""
    root = minidom.parseString(text).documentElement
    for element in root.getElementsByTagName('*'):
        for key, value in element.attributes.items():
            count = COUNTS.get((element.tagName, key))
            words = value.replace('\t', ' ').replace('\n', ' ').replace('\r', ' ').split(' ')
            words = [word for word in words if word]
            if count and (len(words) != count):
                return None
            if count and None in [number(word, element.tagName == 'limit') for word in words]:
                return None
        moves = element.getAttribute('type') not in ('', 'fixed')
        axes = element.getElementsByTagName('axis')
        if moves and axes and not axes[0].hasAttribute('xyz'):
            return None
        children = [c for c in element.childNodes if c.nodeType == c.ELEMENT_NODE]
        tags = [child.tagName for child in children]
        if any(tags.count(tag) > 1 for tag in ONCE):
            return None
    links, joints = (
        [c for c in root.childNodes if c.nodeType == c.ELEMENT_NODE and c.tagName == tag]
        for tag in ('link', 'joint')
    )
    for group in (links, joints):
        names = [e.getAttribute('name') for e in group]
        if len(set(names)) < len(names) or '' in names:
            return None
    masses = {}
    for link in links:
        bodies, weights = link.getElementsByTagName('inertial'), link.getElementsByTagName('mass')
        inertias = link.getElementsByTagName('inertia')
        if bodies and not (weights and inertias and weights[0].hasAttribute('value')):
            return None
        if inertias and not all(inertias[0].hasAttribute(k) for t, k in COUNTS if t == 'inertia'):
            return None
        weight = number(weights[0].getAttribute('value'), False) if bodies else 0.0
        masses[link.getAttribute('name')] = weight
    return {'masses': masses, 'joints': joints}


def carried(robot: pfd.Robot, said: dict[str, object], locked: dict[str, float]) -> list[float]:
    """Return the mass that moves with each joint of a robot, found by walking outwards."""
    below: dict[str, list[minidom.Element]] = {}
    by_name = {j.getAttribute('name'): j for j in said['joints']}
    for joint in said['joints']:
        parent = joint.getElementsByTagName('parent')[0].getAttribute('link')
        below.setdefault(parent, []).append(joint)

    def rigid(joint: minidom.Element) -> float:
        link = joint.getElementsByTagName('child')[0].getAttribute('link')
        welded = (
            rigid(other)
            for other in below.get(link, [])
            if other.getAttribute('type') == 'fixed' or other.getAttribute('name') in locked
        )
        return said['masses'][link] + sum(welded)

    return [rigid(by_name[name]) for name in robot.joint_names]


def limits(joint: minidom.Element) -> list[float]:
    """Return lower, upper, velocity, effort, damping and friction of a joint."""
    found = []
    silent = {'velocity': math.inf, 'effort': math.inf}
    for tag, key in [place for place in COUNTS if place[0] in ('limit', 'dynamics')]:
        there = joint.getElementsByTagName(tag)
        written = bool(there) and there[0].hasAttribute(key)
        value = there[0].getAttribute(key) if written else ''
        found.append(number(value, True) if written else silent.get(key, 0.0))
    unlimited = not joint.getElementsByTagName('limit')
    if unlimited or joint.getAttribute('type') == 'continuous':
        found[:2] = [-math.inf, math.inf]
    return found


def normal(text: str) -> str:
    """Return a file with its numbers written as every reader can read them."""
    document = minidom.parseString(text)
    for element in document.getElementsByTagName('*'):
        for key, value in element.attributes.items():
            if (element.tagName, key) in COUNTS:
                numbers = [number(word, True) for word in value.split()]
                if element.tagName == 'axis':
                    # Its length says nothing, and a short one is none to Pinocchio.
                    longest = max(map(abs, numbers)) or 1.0
                    numbers = [x / longest for x in numbers]
                plain = [0.0 if abs(x) < 1e-300 else float(np.nan_to_num(x)) for x in numbers]
                element.setAttribute(key, ' '.join(map(repr, plain)))
    # Pinocchio refuses a joint without limits; its dynamics do not depend on them.
    for element in document.getElementsByTagName('joint'):
        if not element.getElementsByTagName('limit'):
            limit = document.createElement('limit')
            for key in ('velocity', 'effort'):
                limit.setAttribute(key, '1.0')
            element.appendChild(limit)
    return document.toxml()


def clashes(said: dict[str, object]) -> bool:
    """Return whether Pinocchio would take a link for a joint, or the world for either."""
    names = {joint.getAttribute('name') for joint in said['joints']}
    return bool(names & {'universe', *said['masses']})


def load_or_refuse(text: str, locked: dict[str, float]) -> pfd.Robot | str:
    """Return the robot of a file, or the error that refuses it."""
    try:
        return pfd.load_robot(text, locked=locked)
    except ValueError as error:
        return str(error)


@pytest.mark.filterwarnings('ignore::pfd_core.PhysicsWarning')
@settings(max_examples=4 * settings().max_examples)
@given(damaged_files())
def test_a_damaged_file_is_refused_in_a_line_that_names_a_part_or_loaded_as_written(
    file: tuple[str, dict[str, float]],
) -> None:
    text, locked = file
    robot = load_or_refuse(text, locked)
    if isinstance(robot, str):
        event('refused')
        assert '\n' not in robot
        assert re.search('link|joint|<robot>|_arm', robot)
        return
    event('accepted')
    said = meant(text)
    assert said is not None
    np.testing.assert_allclose(robot.masses, carried(robot, said, locked), rtol=DYNAMICS)
    by_name = {j.getAttribute('name'): j for j in said['joints']}
    keys = ('position_lower', 'position_upper', 'velocity_limit', 'effort_limit')
    ours = np.array([getattr(robot, key) for key in (*keys, 'damping', 'friction')]).T
    theirs = [limits(by_name[name]) for name in robot.joint_names]
    np.testing.assert_array_equal(ours, theirs)
    if not clashes(said):
        assert_same_physics(robot, normal(text), locked)


@pytest.mark.filterwarnings('ignore::pfd_core.PhysicsWarning')
@pytest.mark.parametrize('refused', [False, True])
def test_damaged_files_of_both_kinds_are_drawn(refused: bool) -> None:
    find(damaged_files(), lambda file: isinstance(load_or_refuse(*file), str) is refused)
