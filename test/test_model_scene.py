# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A scene becomes numbers for a robot: values stated or not, by joint, in files."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
import pickle
import re

import numpy as np
import pytest
from zoo import ODD_ARM, random_chain, to_pinocchio

import pfd_core as pfd
from pfd_core.model.plant import resolve as resolve_plant

# One product with a rotation: three products and two sums.
ROUNDING = 4 * np.finfo(float).eps


@pytest.fixture(scope='module')
def robot() -> pfd.Robot:
    return random_chain(np.random.default_rng(5), 4)


def test_gravity_is_given_in_the_axes_of_frame_0_and_exact_at_right_angles(
    robot: pfd.Robot,
) -> None:
    plant = resolve_plant(robot, pfd.Scene(gravity=[1.0, -2.0, 3.0]))
    joint = to_pinocchio(robot).jointPlacements[1].rotation
    np.testing.assert_allclose(joint @ plant.gravity, [1, -2, 3], rtol=ROUNDING)
    assert not resolve_plant(robot, pfd.Scene(gravity=None)).gravity.any()
    for name, gravity in (('puma560', [0, 0, -9.81]), ('planar2', [0, -9.81, 0])):
        np.testing.assert_array_equal(resolve_plant(pfd.load_robot(name)).gravity, gravity)


@pytest.mark.parametrize(
    ('key', 'of_robot'),
    [
        *(('damping', 'damping'), ('armature', 'armature'), ('friction', 'friction')),
        ('effort_limits', 'effort_limit'),
    ],
)
def test_an_effect_is_off_or_from_the_model_or_given(
    robot: pfd.Robot, key: str, of_robot: str
) -> None:
    numbers, given = np.array([3.0, 0.5, 2.0, 1.0]), np.array([1.0, 0.0, 2.0, 3.0])
    for model, choice, wanted in (
        (replace(robot, **{of_robot: numbers}), 'model', numbers),
        (robot, given, given),
    ):
        found = getattr(resolve_plant(model, pfd.Scene(**{key: choice})), key)
        np.testing.assert_array_equal(found, wanted)
    if key in ('damping', 'armature'):
        without = replace(robot, **{key: np.zeros(4)})
        assert getattr(resolve_plant(without, pfd.Scene(**{key: 'model'})), key) is None


@pytest.mark.parametrize(
    'arguments',
    [
        {'friction': (0, 0, 0, 0)},
        {'friction': (0, 0, 0, 0), 'static_friction': (0, 0, 0, 0)},
        {'motor_lag': (0, 0, 0, 0)},
        {'damping': (0, 0, 0, 0)},
        {'armature': (0, 0, 0, 0)},
        {'stiffness': (0, 0, 0, 0), 'rest_position': (1, 1, 1, 1)},
        {'effort_limits': [np.inf] * 4},
        {'joint_limits': [(-np.inf, np.inf)] * 4, 'restitution': 0.5},
        {'torque_speed': [None] * 4},
        {'gravity': None, 'gravity_compensation': True},
        {'gravity_compensation': pfd.Scene(gravity=None, payload=pfd.Payload(1.0))},
    ],
    ids=lambda arguments: '-'.join(arguments),
)
def test_an_effect_of_zeros_is_off(robot: pfd.Robot, arguments: dict[str, object]) -> None:
    bare = resolve_plant(robot, pfd.Scene(gravity=arguments.get('gravity', (0, 0, -9.81))))
    assert resolve_plant(robot, pfd.Scene(**arguments)).digest == bare.digest


def test_static_friction_is_coulomb_friction_unless_it_is_given(robot: pfd.Robot) -> None:
    sliding, resting, speed = (1.0, 0.0, 2.0, 3.0), (1.5, 0.5, 2.0, 3.0), (0.1, 0.1, 0.2, 0.3)
    plain = resolve_plant(robot, pfd.Scene(friction=sliding))
    np.testing.assert_array_equal(plain.static_friction, sliding)
    assert plain.stribeck_velocity is None
    scene = pfd.Scene(friction=sliding, static_friction=resting, stribeck_velocity=speed)
    plant = resolve_plant(robot, scene)
    np.testing.assert_array_equal(plant.friction, sliding)
    np.testing.assert_array_equal(plant.static_friction, resting)
    np.testing.assert_array_equal(plant.stribeck_velocity, speed)
    # Of some joints, it is so of the others.
    some = pfd.Scene(friction=sliding, static_friction={'joint2': 0.5})
    np.testing.assert_array_equal(resolve_plant(robot, some).static_friction, (1.0, 0.5, 2.0, 3.0))
    # Friction that does not fall has no velocity at which it falls.
    assert resolve_plant(robot, replace(scene, static_friction=sliding)).stribeck_velocity is None


def test_stops_are_the_models_or_given_with_one_restitution_or_many(robot: pfd.Robot) -> None:
    limits = [(-1.0, 1.0), (-np.inf, 2.0), (0.0, np.inf), (-np.inf, np.inf)]
    lower, upper = np.transpose(limits)
    model = replace(robot, position_lower=lower, position_upper=upper)
    for plant in (
        resolve_plant(model, pfd.Scene(joint_limits='model', restitution=0.5)),
        resolve_plant(robot, pfd.Scene(joint_limits=limits, restitution=[0.5] * 4)),
    ):
        np.testing.assert_array_equal(plant.joint_limits, limits)
        np.testing.assert_array_equal(plant.restitution, [0.5] * 4)
    assert not resolve_plant(robot, pfd.Scene(joint_limits=limits)).restitution.any()


@pytest.mark.parametrize('periods', [0.0, 1e-300, 1e-7, 1e7, -1e100])
def test_periods_whose_energy_or_angle_has_no_digits_are_refused(periods: float) -> None:
    scene = pfd.Scene(cogging=[(0.1, periods, 0.0), (0.0, 0.0, 0.0)])
    with pytest.raises(ValueError, match=r"cogging of joint 'shoulder' must be within 1e-06 and"):
        resolve_plant(pfd.load_robot('planar2'), scene)


def test_motors_of_the_model_fall_off_beyond_its_velocity_limits(robot: pfd.Robot) -> None:
    model = replace(
        robot, velocity_limit=[2.0, 3.0, np.inf, 1.0], effort_limit=[10.0, np.inf, 5.0, 7.0]
    )
    inf = np.inf
    np.testing.assert_array_equal(
        resolve_plant(model, pfd.Scene(torque_speed='model')).torque_speed,
        [[(2, 10), (4, 0)], [(inf, inf), (inf, inf)], [(inf, inf), (inf, inf)], [(1, 7), (2, 0)]],
    )


def test_equal_scenes_are_equal_keys_and_others_are_not(robot: pfd.Robot) -> None:
    scene = pfd.Scene(damping=np.array([1.0, 2.0]), payload=pfd.Payload(1.0, [0, 0, 0.1]))
    same = pfd.Scene(damping=(1, 2), payload=pfd.Payload(1, (0, 0, 0.1), np.zeros((3, 3))))
    assert scene == same
    assert scene.digest == same.digest
    assert {scene: 1}[same] == 1
    body = pfd.Payload(1.0)
    changes = [{}, {'gravity': None}, {'payload': body}, {'brakes': True}]
    plants = [pfd.Scene(**x) for x in (*changes, {'external_wrench': True})]
    changes = [{'damping': (1, 2)}, {'armature': (1, 2)}, {'damping': 'model'}]
    scenes = [*plants, *(pfd.Scene(**x) for x in changes)]
    assert len({other.digest for other in scenes}) == len(scenes)
    assert len({resolve_plant(robot, other).digest for other in plants}) == len(plants)
    assert resolve_plant(robot, plants[2]).robot == pfd.with_payload(robot, body)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'gravity': 9.81}, r'gravity must have shape \(3,\), got \(\)'),
        ({'gravity': (0, 0, np.nan)}, 'gravity must be finite'),
        ({'damping': 'urdf'}, "damping must be None, 'model' or one number per joint, got 'urdf'"),
        ({'armature': [1, -1]}, 'armature must not be negative'),
        ({'payload': 2.0}, "payload must be a Payload, 'input' or None, got 2.0"),
        ({'brakes': 'yes'}, "brakes must be True or False, got 'yes'"),
        ({'motor_lag': 'model'}, "motor_lag must be None or one number per joint, got 'model'"),
        ({'static_friction': [1]}, 'static_friction was given without friction'),
        (
            {'friction': [1], 'stribeck_velocity': [1]},
            'stribeck_velocity was given without static_friction',
        ),
        (
            {'friction': [1], 'static_friction': [1], 'stribeck_velocity': [0]},
            'stribeck_velocity must be above 0',
        ),
        ({'rest_position': [1]}, 'rest_position was given without stiffness'),
        ({'restitution': 0.5}, 'restitution was given without joint_limits'),
        ({'restitution': 1.5, 'joint_limits': 'model'}, 'restitution must be from 0 to 1'),
        ({'joint_limits': True}, 'joint_limits must be None, .*got True'),
        ({'joint_limits': [1, 2]}, 'joint_limits must have shape'),
        ({'joint_limits': [(0, np.nan)]}, 'joint_limits must be .* or infinite'),
        ({'effort_limits': [1e200]}, 'effort_limits must be at most 1e[+]100'),
        (
            {'cogging': 5},
            r'cogging must be None or one row \(amplitude, periods, phase\) per joint',
        ),
        ({'cogging': [(1.0, 2.0)] * 4}, r'cogging must have shape \(n, 3\)'),
        ({'torque_speed': 5}, "torque_speed must be None, 'model' or one table with rows"),
        ({'torque_speed': [None, [1, 2]]}, 'torque_speed of joint 2 must have shape'),
        ({'torque_speed': [np.zeros((0, 2))]}, 'torque_speed of joint 1 must have .* one row'),
        ({'torque_speed': [[(0, 1), (0, 0)]]}, 'speeds of torque_speed of joint 1 must rise'),
        ({'torque_speed': [[(0, 1), (1, 2)]]}, 'torques of torque_speed .* must not rise'),
        ({'torque_speed': [[(0, 1), (1, -1)]]}, 'torque_speed .* must not be negative'),
        ({'gravity_compensation': 1}, 'gravity_compensation must be True, False or a Scene'),
        (
            {'gravity_compensation': pfd.Scene(damping=[1])},
            'the scene of gravity_compensation may have .* it has damping',
        ),
    ],
)
def test_a_wrong_scene_is_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pfd.Scene(**arguments)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'damping': (1, 2, 3)}, r"damping .* has 3 numbers, but 'random4' has 4 joints"),
        ({'torque_speed': [None]}, 'torque_speed .* has 1 tables, but .* has 4 joints'),
        ({'joint_limits': [(0, 1)]}, 'joint_limits .* has 1 rows, but .* has 4 joints'),
        (
            {'joint_limits': [(0, 1)] * 4, 'restitution': [0.5]},
            'restitution .* has 1 numbers, but .* has 4 joints',
        ),
        (
            {'joint_limits': [(0, 1), (2, 2), (0, 1), (0, 1)]},
            "joint_limits of joint 'joint2' must be .* below .*, got 2.0 and 2.0; lock a joint",
        ),
        (
            {'friction': (1, 1, 1, 1), 'static_friction': (1, 1, 0.5, 1)},
            "static_friction of joint 'joint3' must be at least its friction 1.0, got 0.5",
        ),
    ],
)
def test_a_scene_that_does_not_fit_names_the_joint(
    robot: pfd.Robot, arguments: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        resolve_plant(robot, pfd.Scene(**arguments))


# ---- files -----------------------------------------------------------------------------------


INF = float('inf')


def test_a_file_may_be_written_by_hand() -> None:
    text = """
        damping: &ours [0.1, 0.2]   # N m s/rad
        friction: *ours
        gravity: null
        payload: {mass: 2}
        joint_limits: [[-1, 1], [-inf, .inf]]
        brakes: True
        external_wrench: TRUE
        armature: ~
        stiffness: None
        torque_speed: [[[0, 1]], Null]
    """
    assert pfd.load_scene(text) == pfd.Scene(
        damping=(0.1, 0.2),
        friction=(0.1, 0.2),
        gravity=None,
        payload=pfd.Payload(2.0),
        joint_limits=[(-1, 1), (-INF, INF)],
        brakes=True,
        external_wrench=True,
        torque_speed=[[(0.0, 1.0)], None],
    )


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('dampnig: [1]', "the scene has an unknown key 'dampnig'; known keys are gravity"),
        ('damping: [1]\ndamping: [2]', "key 'damping' occurs more than once"),
        ('damping: [1, yes]', "damping must be a number, got 'yes'"),
        ('damping: [-1]', r"YAML text': damping must not be negative"),
        ('brakes: 1', 'brakes must be True or False, got 1.0'),
        ('brakes: off', "brakes must be True or False, got 'off'"),
        ('friction: none', "friction must be None, 'model' or .* got 'none'"),
        ('restitution: half', "restitution must be a number, got 'half'"),
        ('gravity: {x: 1}', 'gravity must be a number, a list or a word, got a table'),
        ('damping: {joint1: {a: 1}}', 'damping.joint1 must be a number, a list or a word'),
        ('payload: {center: [0, 0, 0]}', "payload has no 'mass'"),
        ('payload: {mass: 1, density: 2}', "payload has an unknown key 'density'"),
        ('payload: {mass: heavy}', "payload mass must be a number, got 'heavy'"),
        ('gravity_compensation: {damping: [1]}', 'gravity_compensation may have .* has damping'),
        ('gravity_compensation: {mass: 1}', 'gravity_compensation has an unknown key'),
        ('x' * 1_000_001, 'a YAML file may have 1000000'),
    ],
)
def test_a_wrong_file_is_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pfd.load_scene(text + '\n')


def test_a_path_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match='path must be a str or a PathLike, got 3'):
        pfd.Scene().save(3)  # type: ignore[arg-type]


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
    for robot in stated:
        plant = resolve_plant(robot, pfd.Scene(friction='model', damping='model'))
        assert plant.friction is plant.damping is None
    assert resolve_plant(stated[0], pfd.Scene(friction='model')).digest == bare


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
        pfd.load_scene(flat),
        replace(scene, brakes=False),
        pickle.loads(pickle.dumps(scene)),
    ]
    for each in ways:
        assert each == scene
        assert resolve_plant(UR5, each).digest == wanted


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
