# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A scene becomes numbers for a robot, without the effects that are off."""

from __future__ import annotations

import copy
from dataclasses import replace
import pickle

import numpy as np
import pytest
from zoo import random_chain, to_pinocchio

from pfd_core.algorithms.programs import record_forward_dynamics, record_inverse_dynamics
from pfd_core.model import (
    Payload,
    Robot,
    Scene,
    load_robot,
    resolve,
    with_payload,
    without_step_effects,
)

# One product with a rotation: three products and two sums.
ROUNDING = 4 * np.finfo(float).eps


@pytest.fixture(scope='module')
def robot() -> Robot:
    return random_chain(np.random.default_rng(5), 4)


def test_the_default_is_rigid_links_and_gravity_and_nothing_else(robot: Robot) -> None:
    plant = resolve(robot)
    assert plant.robot is robot
    assert plant.damping is None
    assert plant.armature is None
    assert not plant.external_wrench
    assert not plant.brakes
    assert Scene() == Scene(gravity=(0, 0, -9.81))


def test_gravity_is_given_in_the_axes_of_frame_0(robot: Robot) -> None:
    plant = resolve(robot, Scene(gravity=[1.0, -2.0, 3.0]))
    joint = to_pinocchio(robot).jointPlacements[1].rotation
    np.testing.assert_allclose(joint @ plant.gravity, [1, -2, 3], rtol=ROUNDING)
    assert not resolve(robot, Scene(gravity=None)).gravity.any()


def test_gravity_of_an_upright_and_of_a_turned_base_is_exact() -> None:
    np.testing.assert_array_equal(resolve(load_robot('puma560')).gravity, [0, 0, -9.81])
    np.testing.assert_array_equal(resolve(load_robot('planar2')).gravity, [0, -9.81, 0])


@pytest.mark.parametrize('key', ['damping', 'armature'])
def test_an_effect_is_off_or_from_the_model_or_given(robot: Robot, key: str) -> None:
    np.testing.assert_array_equal(
        getattr(resolve(robot, Scene(**{key: 'model'})), key), getattr(robot, key)
    )
    given = np.array([1.0, 0.0, 2.0, 3.0])
    np.testing.assert_array_equal(getattr(resolve(robot, Scene(**{key: given})), key), given)
    without = replace(robot, **{key: np.zeros(4)})
    assert getattr(resolve(without, Scene(**{key: 'model'})), key) is None


@pytest.mark.parametrize(
    ('key', 'of_robot'), [('friction', 'friction'), ('effort_limits', 'effort_limit')]
)
def test_friction_and_effort_limits_may_be_the_models(
    robot: Robot, key: str, of_robot: str
) -> None:
    numbers = np.array([3.0, 0.5, 2.0, 1.0])
    model = replace(robot, **{of_robot: numbers})
    np.testing.assert_array_equal(getattr(resolve(model, Scene(**{key: 'model'})), key), numbers)


@pytest.mark.parametrize(
    'arguments',
    [
        {'friction': (0, 0, 0, 0)},
        {'friction': (0, 0, 0, 0), 'static_friction': (0, 0, 0, 0)},
        {'motor_lag': (0, 0, 0, 0)},
        {'stiffness': (0, 0, 0, 0), 'rest_position': (1, 1, 1, 1)},
        {'effort_limits': [np.inf] * 4},
        {'joint_limits': [(-np.inf, np.inf)] * 4, 'restitution': 0.5},
        {'torque_speed': [None] * 4},
        {'gravity': None, 'gravity_compensation': True},
        {'gravity_compensation': Scene(gravity=None, payload=Payload(1.0))},
    ],
    ids=lambda arguments: '-'.join(arguments),
)
def test_an_effect_of_zeros_is_off(robot: Robot, arguments: dict[str, object]) -> None:
    bare = resolve(robot, Scene(gravity=arguments.get('gravity', (0, 0, -9.81))))
    assert resolve(robot, Scene(**arguments)).digest == bare.digest


def test_static_friction_is_coulomb_friction_unless_it_is_given(robot: Robot) -> None:
    sliding, resting, speed = (1.0, 0.0, 2.0, 3.0), (1.5, 0.5, 2.0, 3.0), (0.1, 0.1, 0.2, 0.3)
    plain = resolve(robot, Scene(friction=sliding))
    np.testing.assert_array_equal(plain.static_friction, sliding)
    assert plain.stribeck_velocity is None
    scene = Scene(friction=sliding, static_friction=resting, stribeck_velocity=speed)
    plant = resolve(robot, scene)
    np.testing.assert_array_equal(plant.friction, sliding)
    np.testing.assert_array_equal(plant.static_friction, resting)
    np.testing.assert_array_equal(plant.stribeck_velocity, speed)
    # Friction that does not fall has no velocity at which it falls.
    assert resolve(robot, replace(scene, static_friction=sliding)).stribeck_velocity is None


def test_stops_are_the_models_or_given_with_one_restitution_or_many(robot: Robot) -> None:
    limits = [(-1.0, 1.0), (-np.inf, 2.0), (0.0, np.inf), (-np.inf, np.inf)]
    lower, upper = np.transpose(limits)
    model = replace(robot, position_lower=lower, position_upper=upper)
    for plant in (
        resolve(model, Scene(joint_limits='model', restitution=0.5)),
        resolve(robot, Scene(joint_limits=limits, restitution=[0.5] * 4)),
    ):
        np.testing.assert_array_equal(plant.joint_limits, limits)
        np.testing.assert_array_equal(plant.restitution, [0.5] * 4)
    assert not resolve(robot, Scene(joint_limits=limits)).restitution.any()


def test_a_joint_without_cogging_has_some_period_and_one_with_it_needs_periods(
    robot: Robot,
) -> None:
    rows = [(0.5, 8.0, 0.1), (0.0, 0.0, 0.3), (-0.2, 3.0, 0.0), (0.1, 1.0, 0.0)]
    np.testing.assert_array_equal(
        resolve(robot, Scene(cogging=rows)).cogging, [rows[0], (0.0, 1.0, 0.0), *rows[2:]]
    )
    assert resolve(robot, Scene(cogging=[(0.0, 8.0, 1.0)] * 4)).cogging is None
    with pytest.raises(ValueError, match="periods of cogging of joint 'joint4' must not be 0"):
        resolve(robot, Scene(cogging=[*rows[:3], (0.1, 0.0, 0.0)]))


@pytest.mark.parametrize('periods', [1e-300, 1e-7, 1e7, -1e100])
def test_periods_whose_energy_or_angle_has_no_digits_are_refused(periods: float) -> None:
    scene = Scene(cogging=[(0.1, periods, 0.0), (0.0, 0.0, 0.0)])
    with pytest.raises(ValueError, match=r"cogging of joint 'shoulder' must be within 1e-06 and"):
        resolve(load_robot('planar2'), scene)


def test_tables_of_torque_and_speed_get_the_rows_of_the_longest(robot: Robot) -> None:
    tables = [None, [(1.0, 9.0), (2.0, 0.0)], [(0.5, 4.0)], None]
    inf = np.inf
    np.testing.assert_array_equal(
        resolve(robot, Scene(torque_speed=tables)).torque_speed,
        [
            [(inf, inf), (inf, inf)],
            [(1, 9), (2, 0)],
            [(0.5, 4), (inf, 4)],
            [(inf, inf), (inf, inf)],
        ],
    )


def test_motors_of_the_model_fall_off_beyond_its_velocity_limits(
    robot: Robot,
) -> None:
    model = replace(
        robot, velocity_limit=[2.0, 3.0, np.inf, 1.0], effort_limit=[10.0, np.inf, 5.0, 7.0]
    )
    inf = np.inf
    np.testing.assert_array_equal(
        resolve(model, Scene(torque_speed='model')).torque_speed,
        [
            [(2, 10), (4, 0)],
            [(inf, inf), (inf, inf)],
            [(inf, inf), (inf, inf)],
            [(1, 7), (2, 0)],
        ],
    )
    stuck = replace(model, velocity_limit=[2.0, 3.0, np.inf, 0.0])
    with pytest.raises(ValueError, match=r"velocity limits above zero, .* 'joint4' has 0\.0"):
        resolve(stuck, Scene(torque_speed='model'))


def test_drives_compensate_the_robot_without_its_payload_or_a_model(robot: Robot) -> None:
    payload, other = Payload(1.0, (0, 0, 0.1)), Payload(2.0)
    scene = Scene(gravity=(1.0, 0.0, -9.0), payload=payload, gravity_compensation=True)
    drives = resolve(robot, scene).gravity_compensation
    assert drives is not None
    assert drives.robot == robot
    np.testing.assert_array_equal(drives.gravity, resolve(robot, scene).gravity)
    model = Scene(gravity=(0, 0, -1.6), payload=other)
    drives = resolve(robot, replace(scene, gravity_compensation=model)).gravity_compensation
    assert drives is not None
    assert drives.robot == with_payload(robot, other)
    np.testing.assert_array_equal(drives.gravity, resolve(robot, model).gravity)


OVER_A_STEP = {
    'friction': {'friction': (1, 1, 1, 1)},
    'static_friction': {'friction': (0, 0, 0, 0), 'static_friction': (1, 1, 1, 1)},
    'joint_limits': {'joint_limits': [(-1, 1)] * 4},
    'motor_lag': {'motor_lag': (0.01, 0.01, 0.01, 0.01)},
}


@pytest.mark.parametrize('key', OVER_A_STEP)
def test_effects_over_a_step_are_refused_at_an_instant(robot: Robot, key: str) -> None:
    plant = resolve(robot, Scene(**OVER_A_STEP[key]))
    with pytest.raises(ValueError, match=f"'{key}'.* act over a step of time.*Simulator"):
        record_forward_dynamics(plant, 'pcrbm', 'parallel')
    with pytest.raises(ValueError, match=f"'{key}'.* act over a step of time.*Simulator"):
        record_inverse_dynamics(plant, 'parallel')
    assert without_step_effects(plant).digest == resolve(robot).digest


def test_the_payload_is_welded_on(robot: Robot) -> None:
    payload = Payload(1.5, (0.1, 0, 0))
    assert resolve(robot, Scene(payload=payload)).robot == with_payload(robot, payload)


def test_scenes_can_be_compared_and_hashed(robot: Robot) -> None:
    scene = Scene(damping=np.array([1.0, 2.0]), payload=Payload(1.0, [0, 0, 0.1]))
    same = Scene(damping=(1, 2), payload=Payload(1, (0, 0, 0.1), np.zeros((3, 3))))
    assert scene == same
    assert scene.digest == same.digest
    assert {scene: 1}[same] == 1
    others = [
        Scene(),
        Scene(gravity=None),
        Scene(damping=(1, 2)),
        Scene(armature=(1, 2)),
        Scene(damping='model'),
        Scene(payload=Payload(1.0)),
        Scene(brakes=True),
        Scene(external_wrench=True),
    ]
    assert len({other.digest for other in others}) == len(others)
    plants = [other for other in others if other.damping is None and other.armature is None]
    assert len({resolve(robot, other).digest for other in plants}) == len(plants)


def test_scenes_and_plants_stay_frozen_through_pickle_and_copies(robot: Robot) -> None:
    scene = Scene(damping='model', armature=[1, 2, 3, 4], payload=Payload(1.0, [0, 0, 0.1]))
    plant = resolve(robot, scene)
    for again in (pickle.loads(pickle.dumps(scene)), copy.deepcopy(scene), copy.copy(scene)):
        assert again == scene
        assert again.digest == scene.digest
        assert isinstance(again.payload.inertia, tuple)
    ways = (lambda p: pickle.loads(pickle.dumps(p)), copy.deepcopy, copy.copy, replace)
    for again in (way(plant) for way in ways):
        for values in (again.gravity, again.damping, again.armature, again.robot.masses):
            with pytest.raises(ValueError, match='read-only'):
                values[0] = 1.0
        assert again.digest == plant.digest


def test_a_plant_with_other_numbers_is_frozen_too(robot: Robot) -> None:
    mine = np.array([1.0, 2.0, 3.0])
    plant = replace(resolve(robot), gravity=mine)
    mine[0] = 5.0
    assert plant.gravity[0] == 1.0
    with pytest.raises(ValueError, match='read-only'):
        plant.gravity[0] = 1.0


def test_a_plant_cannot_change(robot: Robot) -> None:
    plant = resolve(robot, Scene(damping='model'))
    for values in (plant.gravity, plant.damping):
        with pytest.raises(ValueError, match='read-only'):
            values[0] = 1.0


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'gravity': 9.81}, r'gravity must have shape \(3,\), got \(\)'),
        ({'gravity': (0, 0, np.nan)}, 'gravity must be finite'),
        ({'gravity': 'down'}, "gravity must be an array of numbers, got 'down'"),
        ({'damping': 'urdf'}, "damping must be None, 'model' or one number per joint, got 'urdf'"),
        ({'damping': 0.1}, "damping must be None, 'model' or one number per joint, got 0.1"),
        ({'armature': [1, -1]}, 'armature must not be negative'),
        ({'armature': [1, np.inf]}, 'armature must be finite'),
        ({'armature': [1, True]}, 'armature must be an array of numbers'),
        ({'damping': [[1], [1, 2]]}, r'damping must be .* numbers, got \[\[1\], \[1, 2\]\]'),
        ({'damping': np.array(1.0)}, "damping must be None, 'model' or one number per joint"),
        ({'gravity': (0, 0, 10**400)}, 'gravity must fit float64'),
        ({'gravity': np.array([0, 0, 1j])}, 'gravity must be an array of numbers'),
        ({'damping': np.ma.array([1.0, 2.0], mask=[1, 0])}, 'damping must be .* a masked array'),
        ({'payload': 2.0}, "payload must be a Payload, 'input' or None, got 2.0"),
        ({'brakes': 'yes'}, "brakes must be True or False, got 'yes'"),
        ({'external_wrench': 1}, 'external_wrench must be True or False, got 1'),
        ({'friction': 0.1}, "friction must be None, 'model' or one number per joint, got 0.1"),
        ({'friction': [1, -1]}, 'friction must not be negative'),
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
        ({'restitution': [0.0, 0.0]}, 'restitution was given without joint_limits'),
        ({'restitution': 1.5, 'joint_limits': 'model'}, 'restitution must be from 0 to 1'),
        ({'restitution': 'full'}, "restitution must be a number, got 'full'"),
        ({'restitution': np.nan}, 'restitution must be finite'),
        ({'joint_limits': True}, 'joint_limits must be None, .*got True'),
        ({'joint_limits': [1, 2]}, 'joint_limits must have shape'),
        ({'joint_limits': [(0, np.nan)]}, 'joint_limits must be .* or infinite'),
        ({'effort_limits': [1, np.nan]}, 'effort_limits must be .* or infinite'),
        ({'effort_limits': [1e200]}, 'effort_limits must be at most 1e[+]100'),
        ({'effort_limits': [-1]}, 'effort_limits must not be negative'),
        ({'cogging': 5}, 'cogging must be None or an amplitude, periods a turn and a phase'),
        ({'cogging': [(1.0, 2.0)] * 4}, r'cogging must have shape \(n, 3\)'),
        ({'torque_speed': 5}, "torque_speed must be None, 'model' or one table a joint"),
        ({'torque_speed': [None, [1, 2]]}, 'torque_speed of joint 2 must have shape'),
        ({'torque_speed': [np.zeros((0, 2))]}, 'torque_speed of joint 1 must have .* one row'),
        ({'torque_speed': [[(0, 1), (0, 0)]]}, 'speeds of torque_speed of joint 1 must rise'),
        ({'torque_speed': [[(0, 1), (1, 2)]]}, 'torques of torque_speed .* must not rise'),
        ({'torque_speed': [[(0, 1), (1, -1)]]}, 'torque_speed .* must not be negative'),
        ({'gravity_compensation': 1}, 'gravity_compensation must be True, False or a Scene'),
        (
            {'gravity_compensation': Scene(damping=[1])},
            'the scene of gravity_compensation may have .* it has damping',
        ),
    ],
)
def test_a_wrong_scene_is_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Scene(**arguments)


def test_a_wrong_length_names_the_robot_and_its_joints(robot: Robot) -> None:
    with pytest.raises(ValueError, match=r"damping .* has 3 numbers, but 'random4' has 4 joints"):
        resolve(robot, Scene(damping=(1, 2, 3)))


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
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
    robot: Robot, arguments: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        resolve(robot, Scene(**arguments))


def test_other_things_than_robots_and_scenes_are_refused(robot: Robot) -> None:
    with pytest.raises(ValueError, match=r"robot must be a Robot, got 'puma560'; load_robot\(\)"):
        resolve('puma560')
    with pytest.raises(ValueError, match='scene must be a Scene or None'):
        resolve(robot, {'gravity': None})
