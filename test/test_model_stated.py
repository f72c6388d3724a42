# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Values that a model states, or does not; and values of a scene for some joints by name."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
import pickle
import re
import warnings

from bridge import resolve_plant
import numpy as np
import pytest
from zoo import ODD_ARM

import pfd_core as pfd

UR5 = pfd.load_robot('ur5')
TABLE = """robot: bare
joints:
- {name: a, type: revolute, mass: 1, dh: {a: 1, d: 0, alpha_deg: 0, theta_deg: 0}}
- {name: b, type: revolute, mass: 1, dh: {a: 1, d: 0, alpha_deg: 0, theta_deg: 0}}
"""
BARE = pfd.load_robot(TABLE)
SILENT = [
    (UR5, 'friction', 'shoulder_pan_joint'),
    (UR5, 'damping', 'shoulder_pan_joint'),
    (pfd.load_robot('panda'), 'friction', 'panda_joint1'),
    *((BARE, key, 'a') for key in ('armature', 'effort_limits', 'torque_speed', 'joint_limits')),
]


@pytest.mark.parametrize(('robot', 'key', 'joint'), SILENT)
def test_values_of_a_model_that_states_none_are_refused_with_robot_and_cure(
    robot: pfd.Robot, key: str, joint: str
) -> None:
    cure = rf"{key}={{'{joint}': \.\.\.}} or {key}\.{joint}"
    cure += ", or 'estimated'" * (key == 'armature')
    with pytest.raises(ValueError, match=rf"{key} is 'model', .*'{robot.name}' .*: .*{cure}$"):
        resolve_plant(robot, pfd.Scene(**{key: 'model'}))


def test_a_stated_zero_is_a_value() -> None:
    stated = [
        pfd.load_robot(TABLE.replace('mass: 1,', 'mass: 1, friction: 0, damping: 0,')),
        replace(BARE, silent={}),
        pfd.load_robot(
            ODD_ARM.replace('<axis', '<dynamics damping="0" friction="0"/><axis').replace(
                '<dynamics damping="0.7" friction="0.3"/>', ''
            )
        ),
    ]
    bare = resolve_plant(stated[0]).digest
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        for robot in stated:
            plant = resolve_plant(robot, pfd.Scene(friction='model', damping='model'))
            assert plant.friction is plant.damping is None
    assert resolve_plant(stated[0], pfd.Scene(friction='model')).digest == bare


def test_numbers_given_to_a_robot_are_stated_and_its_defaults_are_not() -> None:
    fields = ('name', 'joint_names', 'joint_types', 'rotations', 'translations', 'masses')
    bodies = {key: getattr(BARE, key) for key in (*fields, 'centers', 'inertias')}
    robot = pfd.Robot(**bodies, friction=0.0, position_lower=[-1.0, -np.inf])
    assert 'friction' not in robot.silent
    assert 'position_lower' not in robot.silent
    assert robot.silent['damping'] == robot.silent['position_upper'] == ('a', 'b')
    # A value that is none of a silent joint is stated, however the robot was made.
    assert replace(BARE, damping=[0.0, 1.0]).silent['damping'] == ('a',)


def test_joints_without_a_value_are_named_in_one_warning() -> None:
    robot = pfd.load_robot(ODD_ARM)
    with pytest.warns(pfd.PhysicsWarning) as found:
        plant = resolve_plant(robot, pfd.Scene(friction='model'))
    (warning,) = found
    assert "'odd_arm' states none for 'j2', 'j3', 'j4', 'j5', 'j6'" in str(warning.message)
    assert plant.friction.tolist() == robot.friction.tolist() == [0.3, 0, 0, 0, 0, 0]
    # The cure keeps the joints that the model states.
    assert re.findall(r'friction\.(\w+)', str(warning.message)) == ['j1', 'j2']


@pytest.mark.parametrize('key', ['joint_limits', 'effort_limits', 'torque_speed'])
def test_a_continuous_joint_needs_no_limit(key: str) -> None:
    robot = pfd.load_robot(ODD_ARM)
    assert robot.silent['effort_limit'] == ('j2', 'j5')
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        assert getattr(resolve_plant(robot, pfd.Scene(**{key: 'model'})), key) is not None


def test_joints_without_a_value_stay_without_one_in_files_copies_and_edits() -> None:
    for robot in (UR5, pfd.load_robot('planar2'), pfd.load_robot(ODD_ARM), BARE):
        assert robot.silent
        ways = {
            'yaml': pfd.load_robot(pfd.robot_to_yaml(robot)),
            'urdf': pfd.load_robot(pfd.robot_to_urdf(robot)),
            'pickle': pickle.loads(pickle.dumps(robot)),
            'payload': pfd.with_payload(robot, pfd.Payload(1.0)),
        }
        for way, again in ways.items():
            assert dict(again.silent) == dict(robot.silent), way
        first, *others = robot.joint_names
        less = pfd.lock(robot, {first: 0.0})
        for key, joints in robot.silent.items():
            assert less.silent.get(key, ()) == tuple(j for j in joints if j in others)


@pytest.mark.parametrize(
    'silent',
    [{'mass': ('a',)}, ['damping'], 3, {'damping': 3}],
    ids=['field', 'list', '3', 'joint'],
)
def test_a_wrong_list_of_silent_joints_is_refused(silent: object) -> None:
    with pytest.raises(ValueError, match='silent must map'):
        replace(BARE, silent=silent)


# ---- values by joint -------------------------------------------------------------------------

ELBOW = UR5.joint_names.index('elbow_joint')
ELBOW_ALONE = {'elbow_joint': 2.0}
VALUES = {
    'friction': 3.0,
    'damping': 0.5,
    'armature': 0.1,
    'effort_limits': 5.0,
    'joint_limits': (-1.0, 2.0),
    'torque_speed': [(1.0, 2.0), (2.0, 0.0)],
    'stiffness': 10.0,
    'cogging': (0.1, 3.0, 0.0),
    'motor_lag': 0.01,
}
NOTHING = {
    'effort_limits': np.inf,
    'joint_limits': (-np.inf, np.inf),
    'torque_speed': None,
    'cogging': (0.0, 0.0, 0.0),
}


@pytest.mark.parametrize('key', VALUES)
def test_values_of_some_joints_by_name_are_the_values_of_all_with_nothing_for_the_others(
    key: str,
) -> None:
    listed = [NOTHING.get(key, 0.0)] * UR5.n
    listed[ELBOW] = VALUES[key]
    scene = pfd.Scene(**{key: {'elbow_joint': VALUES[key]}})
    wanted = resolve_plant(UR5, pfd.Scene(**{key: listed})).digest
    text = pfd.scene_to_yaml(scene)
    flat = re.sub(r'(\w+):\s+{?elbow_joint: ?(.*?)}?\n', r'\1.elbow_joint: \2\n', text)
    assert flat != text
    ways = [
        scene,
        pfd.Scene(**{f'{key}.elbow_joint': VALUES[key]}),
        pfd.load_scene(text),
        pfd.load_scene(
            re.sub(rf'{key}:\s+{{?elbow_joint: ?(.*?)}}?\n', rf'{key}.elbow_joint: \1\n', text)
        ),
        replace(scene, brakes=False),
        pickle.loads(pickle.dumps(scene)),
    ]
    for each in ways:
        assert each == scene
        assert resolve_plant(UR5, each).digest == wanted


def test_one_restitution_may_differ() -> None:
    scene = pfd.Scene(joint_limits='model', restitution={'elbow_joint': 0.5})
    assert resolve_plant(UR5, scene).restitution.tolist() == [0, 0, 0.5, 0, 0, 0]


def test_both_forms_of_values_by_joint_may_be_mixed_in_any_order() -> None:
    both = [('friction.wrist_1_joint', 1.0), ('friction', ELBOW_ALONE)]
    for pairs in permutations(both):
        scene = pfd.Scene(**dict(pairs))
        assert scene.friction == (('elbow_joint', 2.0), ('wrist_1_joint', 1.0))


@pytest.mark.parametrize(
    ('fields', 'message'),
    [
        ({'friction': {'elbow': 1.0}}, "friction of the scene names joint 'elbow', but 'ur5' has"),
        ({'friction.elbow': 1.0}, "friction of the scene names joint 'elbow', but 'ur5' has"),
        ({'friction': {1: 1.0}}, 'friction must have names of joints as keys'),
        (
            {'joint_limits.a': [1.0]},
            r"joint_limits of joint 'a' must be \(lower, upper\), got \[1",
        ),
        *(
            ({f'{key}.elbow_joint': value}, f"{key} of joint 'elbow_joint'")
            for key, value in {
                'friction': -1.0,
                'damping': 'x',
                'joint_limits': 1.0,
                'restitution': 2.0,
                # Speeds that fall.
                'torque_speed': [(2.0, 1.0), (1.0, 0.0)],
            }.items()
        ),
        ({'friction': 'model', 'friction.elbow_joint': 1.0}, 'friction is given for all joints'),
        ({'friction.elbow_joint': 1.0, 'friction': 'model'}, 'friction is given for all joints'),
        *(
            (dict(pairs), "friction of joint 'elbow_joint' is given twice")
            for pairs in permutations([('friction.elbow_joint', 1.0), ('friction', ELBOW_ALONE)])
        ),
        (
            {f'{key}.elbow_joint': 1.0 for key in ('friction', 'static_friction')}
            | {'stribeck_velocity.elbow_joint': 1.0},
            "stribeck_velocity of the scene must have a value for each joint, not 'shoulder_pan",
        ),
    ],
)
def test_wrong_values_by_joint_are_refused_and_named(
    fields: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        resolve_plant(UR5, pfd.Scene(**fields))
