# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of single joints by name: in the fixture, in what-if, and a model without any."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bridge import LockstepArm, read_recording, scene_of, what_if
import numpy as np
import pytest

import pfd_core as pfd

# A number of one joint in each spelling.
SPELLINGS: list[dict[str, Any]] = [
    {'friction': {'elbow_joint': 3.0}},
    {'friction.elbow_joint': 3.0},
    {'joint_friction': {'elbow_joint': 3.0}},
    {'joint_friction': (0.0, 0.0, 3.0, 0.0, 0.0, 0.0)},
]


@pytest.mark.parametrize('settings', SPELLINGS)
def test_the_number_of_one_joint_is_a_setting_of_an_arm_in_each_spelling(
    settings: dict[str, Any],
) -> None:
    with LockstepArm('ur5', **settings) as arm:
        assert arm.settings.joint_friction == (0.0, 0.0, 3.0, 0.0, 0.0, 0.0)
        scene = scene_of(arm.settings, range(6))
        assert scene == pfd.Scene(friction=arm.settings.joint_friction, brakes=True)


def test_the_other_joints_keep_the_numbers_of_the_model() -> None:
    robot = pfd.load_robot('puma560')
    with LockstepArm('puma560', friction=True, **{'friction.joint2': 3.0}) as arm:
        expected = robot.friction.copy()
        expected[1] = 3.0
        assert arm.settings.joint_friction == tuple(expected.tolist())


def test_joints_without_static_friction_of_their_own_have_their_friction() -> None:
    friction = {'elbow_joint': 2.0, 'wrist_1_joint': 1.0}
    with LockstepArm('ur5', friction=friction, **{'static_friction.elbow_joint': 3.0}) as arm:
        assert arm.settings.joint_friction == (0.0, 0.0, 2.0, 1.0, 0.0, 0.0)
        assert arm.settings.static_friction == (0.0, 0.0, 3.0, 1.0, 0.0, 0.0)


def test_static_friction_of_no_number_of_its_own_changes_with_the_friction_of_a_run(
    tmp_path: Path,
) -> None:
    path = tmp_path / 'run.mcap'
    given = {'friction.elbow_joint': 2.0, 'static_friction.elbow_joint': 3.0}
    with LockstepArm('ur5', recording=path, **given) as arm:
        arm.run(lambda t, q, qd: np.full(6, 5.0), 0.01)
    found = what_if(path, ['friction.wrist_1_joint=1.0', 'friction.elbow_joint=1.5']).settings
    assert found.joint_friction == (0.0, 0.0, 1.5, 1.0, 0.0, 0.0)
    assert found.static_friction == (0.0, 0.0, 3.0, 1.0, 0.0, 0.0)


def test_joints_with_neither_a_number_of_the_model_nor_their_own_are_warned_of() -> None:
    with (
        pytest.warns(pfd.PhysicsWarning, match=r"for \['shoulder_pan_joint', .*wrist_3_joint'\]"),
        LockstepArm('ur5', friction=True, **{'friction.elbow_joint': 3.0}) as arm,
    ):
        assert arm.settings.joint_friction[2] == 3.0


def test_the_cure_in_the_error_of_a_switch_is_a_setting() -> None:
    with pytest.raises(ValueError, match='states none for any joint') as refused:
        LockstepArm('ur5', friction=True)
    cure = str(refused.value).rpartition(' or ')[2]
    with LockstepArm('ur5', **{cure: 3.0}) as arm:
        assert arm.settings.joint_friction == (3.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize('word', ['friction.elbow_joint=3.0', 'friction={"elbow_joint": 3.0}'])
def test_a_number_of_one_joint_is_a_change_of_a_recorded_run(word: str, tmp_path: Path) -> None:
    path = tmp_path / 'run.mcap'
    with LockstepArm('ur5', recording=path, armature=True) as arm:
        arm.run(lambda t, q, qd: np.full(6, 5.0), 0.05)
    found = what_if(path, [word]).settings
    assert found.joint_friction == (0.0, 0.0, 3.0, 0.0, 0.0, 0.0)


def test_a_run_with_load_friction_verifies_and_may_have_another_share(tmp_path: Path) -> None:
    path, ends = tmp_path / 'run.mcap', []
    for share in (0.0, 0.2):
        given = {'armature': 'estimated', 'load_friction.elbow_joint': share}
        with LockstepArm('ur5', recording=path if share else '', **given) as arm:
            ends.append(arm.run(lambda t, q, qd: np.full(6, 20.0), 0.05).qd[-1, 2])
    assert abs(ends[1] - ends[0]) > 1e-3
    summary = read_recording(path, verify=True)
    assert summary.complete
    assert summary.settings is not None
    assert summary.settings.load_friction == (0.0, 0.0, 0.2, 0.0, 0.0, 0.0)
    found = what_if(path, ['load_friction.elbow_joint=0.1']).settings
    assert found.load_friction == (0.0, 0.0, 0.1, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ('settings', 'message'),
    [
        ({'friction': True}, "friction is 'model', but the model of 'ur5' states none"),
        ({'friction': {'elbow': 3.0}}, r'friction\.elbow: no such joint'),
        ({'friction.elbow': 3.0}, r'friction\.elbow: no such joint'),
        ({'friction.elbow_joint': 'much'}, r"friction\.elbow_joint is 'much', expected a number"),
        ({'friction.elbow_joint': -1.0}, r'friction is -1\.0, expected 0\.0'),
        (
            {'stribeck_velocity.elbow_joint': 0.1},
            r"stribeck_velocity must be above 0 for each joint, but is 0 for \['shoulder_pan_j",
        ),
        (
            {'friction': {'elbow_joint': 1.0}, 'friction.elbow_joint': 1.0},
            r'friction\.elbow_joint is given twice',
        ),
    ],
)
def test_wrong_numbers_of_single_joints_are_refused_and_named(
    settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        LockstepArm('ur5', **settings)
