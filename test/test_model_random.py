# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots and scenes, drawn or damaged at random: refused in a line, or written and read again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import copy
from dataclasses import fields, replace
import re
from typing import Any
from xml.dom import minidom

from hypothesis import find, given
from hypothesis import strategies as st
import numpy as np
import pytest
import yaml
from zoo import FORK, ODD_ARM, ROWS, STRAIGHT_ARM, exact_angles, random_chain

import pfd_core as pfd
from pfd_core.model.robot import JOINT_FIELDS as ROBOT_JOINT_FIELDS
from pfd_core.model.robot import LINK_FIELDS as ROBOT_LINK_FIELDS

# URDF texts, and the joints to lock in them.
FILES = (
    (ODD_ARM, {}),
    (exact_angles(STRAIGHT_ARM), {}),
    (FORK, {'left_finger': 0.02, 'right_finger': 0.03}),
)
# Attributes that hold numbers, and how many.
COUNTS = {
    ('mass', 'value'): 1,
    **{('inertia', key): 1 for key in ('ixx', 'iyy', 'izz', 'ixy', 'iyz', 'ixz')},
    **{('limit', key): 1 for key in ('lower', 'upper', 'velocity', 'effort')},
    **{('dynamics', key): 1 for key in ('damping', 'friction')},
    **{('origin', key): 3 for key in ('xyz', 'rpy')},
    ('axis', 'xyz'): 3,
}


# Around a number, and in its place.
ENDS = (' ', '\t', '\n', '\u00a0', '_0', 'e', 'kg', ',5', '.5.', 'd0', '\u0664', 'e1', '0' * 30)
STARTS = (' ', '\r\n', '\u3000', '\x85', '-', '+', '\u2212', '0')
OTHERS = (
    *('', 'nan', 'inf', '1e-310', '1e400', '0x1p3', '1_0', '\uff11', '5e-324', '1E-2', '1 1', '-'),
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


def load_or_refuse(text: str, locked: dict[str, float]) -> pfd.Robot | str:
    """Return the robot of a file, or the error that refuses it."""
    try:
        return pfd.load_robot(text, locked=locked)
    except ValueError as error:
        return str(error)


@pytest.mark.filterwarnings('ignore::pfd_core.PhysicsWarning')
@given(damaged_files())
def test_a_damaged_urdf_is_refused_in_a_line_that_names_a_part_or_comes_back_the_same(
    file: tuple[str, dict[str, float]],
) -> None:
    robot = load_or_refuse(*file)
    if isinstance(robot, str):
        assert '\n' not in robot
        assert re.search('link|joint|<robot>|_arm', robot)
    else:
        assert pfd.load_robot(pfd.robot_to_yaml(robot)) == robot


@pytest.mark.filterwarnings('ignore::pfd_core.PhysicsWarning')
@pytest.mark.parametrize('refused', [False, True])
def test_damaged_files_of_both_kinds_are_drawn(refused: bool) -> None:
    find(damaged_files(), lambda file: isinstance(load_or_refuse(*file), str) is refused)


SCENE_KEYS = [item.name for item in fields(pfd.Scene)]
NUMBERS = st.floats() | st.integers() | st.floats(0.0, 1.0)
SCALARS = NUMBERS | st.text(max_size=8) | st.booleans() | st.none()
WORDS = st.sampled_from(('model', 'estimated', 'input', 'true', '.inf', '-inf', '{0}', '%s'))
TREES = st.recursive(
    SCALARS | WORDS,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(('mass', 'xx', 'link')) | st.text(), inner, max_size=3)
    ),
    max_leaves=6,
)
# Of a robot with two joints: what most fields of a scene may be.
PAIRS = st.lists(st.floats(0.0, 1e3), min_size=2, max_size=2)
FITTING = PAIRS | PAIRS.map(sorted).map(lambda pair: [pair, pair]) | st.booleans() | st.none()


def written(value: Any) -> str:
    """Return a value as YAML in one line."""
    return yaml.safe_dump(value, default_flow_style=True, width=10**6).replace('\n...', '').strip()


def refusal(load: Callable[[str], object], text: str) -> str:
    """Return the error that refuses a file, checked to be a short line; '' if it is loaded."""
    try:
        load(text)
    except ValueError as error:
        found = str(error)
    else:
        found = ''
    assert '\n' not in found
    assert len(found) < 1000
    return found


def scenes(values: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, str]]:
    return st.dictionaries(st.sampled_from(SCENE_KEYS), values.map(written), max_size=3)


@given(scenes(FITTING) | scenes(FITTING | TREES))
def test_a_drawn_scene_is_refused_in_a_short_line_or_comes_back_the_same(
    values: dict[str, str],
) -> None:
    text = '\n'.join(['brakes: true', *(f'{k}: {v}' for k, v in values.items() if k != 'brakes')])
    if not refusal(pfd.load_scene, text + '\n'):
        scene = pfd.load_scene(text + '\n')
        again = pfd.load_scene(pfd.scene_to_yaml(scene))
        assert again == scene
        assert again.digest == scene.digest


@st.composite
def robots(draw: st.DrawFn) -> pfd.Robot:
    """Draw a robot with any names and with numbers of any size."""
    n = draw(st.integers(1, 4))

    def each(numbers: st.SearchStrategy[float]) -> list[float]:
        return draw(st.lists(numbers, min_size=n, max_size=n))

    names = st.text(st.characters(codec='utf-8', exclude_categories=('Cc', 'Cs')), min_size=1)
    positive = st.floats(0.0, 1e100)
    limits = np.sort(np.array([each(st.floats(allow_nan=False)) for _ in range(2)]), axis=0)
    return replace(
        random_chain(np.random.default_rng(draw(st.integers(0, 2**32))), n),
        name=draw(names),
        joint_names=tuple(draw(st.lists(names, min_size=n, max_size=n, unique=True))),
        translations=np.array(
            draw(st.lists(st.floats(-1e100, 1e100), min_size=3 * n, max_size=3 * n))
        ).reshape(n, 3),
        position_lower=limits[0],
        position_upper=limits[1],
        effort_limit=each(st.floats(0.0, exclude_min=True)),
        **{key: each(positive) for key in ('damping', 'friction', 'armature')},
    )


@given(robots())
def test_storing_and_loading_a_robot_loses_no_bit(robot: pfd.Robot) -> None:
    again = pfd.load_robot(pfd.robot_to_yaml(robot))
    assert again == robot
    for item in fields(pfd.Robot):
        value = getattr(robot, item.name)
        if isinstance(value, np.ndarray):
            assert value.tobytes() == getattr(again, item.name).tobytes(), item.name


def places(node: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path to each value of a document."""
    below = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in below:
        yield (*way, key)
        if isinstance(value, dict | list):
            yield from places(value, (*way, key))


@st.composite
def damaged_robots(draw: st.DrawFn) -> str:
    """Draw a robot's YAML with one value replaced, removed or put under another key."""
    document = copy.deepcopy(yaml.safe_load(ROWS))
    *way, last = draw(st.sampled_from(sorted(places(document), key=str)))
    node = document
    for key in way:
        node = node[key]
    change = draw(st.sampled_from(('replace', 'replace', 'replace', 'remove', 'rename')))
    if change == 'replace':
        node[last] = draw(TREES)
    else:
        value = node.pop(last)
        if change == 'rename':
            *_, name = draw(st.sampled_from(sorted(places(document), key=str)))
            node.update({name: value}) if isinstance(node, dict) else node.append(value)
    return written(document)


@pytest.mark.filterwarnings('ignore::pfd_core.PhysicsWarning')
@given(damaged_robots())
def test_a_damaged_robot_is_refused_in_a_short_line_or_comes_back_the_same(text: str) -> None:
    if not refusal(pfd.load_robot, text + '\n'):
        robot = pfd.load_robot(text + '\n')
        assert pfd.load_robot(pfd.robot_to_yaml(robot)) == robot


# ---- written as URDF ----


# Angles and products of a few rotations, relative to numbers of about one.
ROUNDING = 1e-14


def known_and_random() -> list[pfd.Robot]:
    rng = np.random.default_rng(5)
    made = [random_chain(rng, n) for n in (1, 4, 7)]
    # Its joints have the names that fixed ones have by default, and its base is turned.
    turned = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    names = tuple(f'{link}_fixed' for link in (made[1].base, made[1].tip, 'a', 'b'))
    made.append(replace(made[1], name='fixed', joint_names=names, root_rotation=turned))
    return [*map(pfd.load_robot, pfd.known_robots()), pfd.load_robot(ODD_ARM), *made]


@pytest.mark.filterwarnings('ignore::pfd_core.PhysicsWarning')
@pytest.mark.parametrize('robot', known_and_random(), ids=lambda robot: f'{robot.name}-{robot.n}')
def test_a_robot_written_as_urdf_is_read_as_the_same_robot(robot: pfd.Robot) -> None:
    found = pfd.load_robot(pfd.robot_to_urdf(robot), base=robot.base, tip=robot.tip)
    for key in ('name', 'joint_names', 'joint_types', 'base', 'tip'):
        assert getattr(found, key) == getattr(robot, key)
    for key in (*ROBOT_LINK_FIELDS, *ROBOT_JOINT_FIELDS, 'base_rotation', 'base_position'):
        # A link without mass has no centre of mass.
        present = robot.masses > 0 if key == 'centers' else ...
        wanted = getattr(robot, key)[present]
        np.testing.assert_allclose(
            getattr(found, key)[present], wanted, rtol=ROUNDING, atol=ROUNDING, err_msg=key
        )
    for name, frame in robot.frames.items():
        assert found.frames[name].link == frame.link
        np.testing.assert_allclose(found.frames[name].rotation, frame.rotation, atol=ROUNDING)
        np.testing.assert_allclose(
            found.frames[name].translation, frame.translation, atol=ROUNDING
        )


def test_ends_of_a_continuous_joint_survive_a_urdf() -> None:
    robot = random_chain(np.random.default_rng(2), 2, joint_types=['continuous', 'revolute'])
    robot = replace(robot, position_lower=[-np.inf, -1.0], position_upper=[2.0, 1.0])
    again = pfd.load_robot(pfd.robot_to_urdf(robot), base=robot.base, tip=robot.tip)
    assert again.position_lower.tolist() == [-np.inf, -1.0]
    assert again.position_upper.tolist() == [2.0, 1.0]
