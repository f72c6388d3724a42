# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Drawn robots and scenes come back from YAML the same; drawn values are loaded so or refused."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import copy
from dataclasses import fields, replace
from typing import Any

from hypothesis import event, given
from hypothesis import strategies as st
import numpy as np
import pytest
import yaml
from zoo import ROWS, random_chain

import pfd_core as pfd

SCENE_KEYS = [item.name for item in fields(pfd.Scene)]
# What no program writes, and a user might.
RAW = ('"\\ud800"', '9' * 5000, '1e400', '1e-400', '{? [a] : b}', '&a [*a]', '!!float 1', '[')
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
        event('refused')
        found = str(error)
    else:
        event('accepted')
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


@given(st.sampled_from(SCENE_KEYS), st.sampled_from(RAW))
def test_a_value_that_no_scene_has_is_refused_in_a_short_line(key: str, value: str) -> None:
    assert refusal(pfd.load_scene, f'{key}: {value}\n')


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
        effort_limit=each(st.floats(0.0)),
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
