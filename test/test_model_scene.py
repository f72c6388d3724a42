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

from pfd_core.model import Payload, Robot, Scene, load_robot, resolve, with_payload

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
        ({'damping': 'urdf'}, "damping must be None, 'model' or one number a joint, got 'urdf'"),
        ({'damping': 0.1}, "damping must be None, 'model' or one number a joint, got 0.1"),
        ({'armature': [1, -1]}, 'armature must not be negative'),
        ({'armature': [1, np.inf]}, 'armature must be finite'),
        ({'armature': [1, True]}, 'armature must be an array of numbers'),
        ({'damping': [[1], [1, 2]]}, r'damping must be .* numbers, got \[\[1\], \[1, 2\]\]'),
        ({'damping': np.array(1.0)}, "damping must be None, 'model' or one number a joint"),
        ({'gravity': (0, 0, 10**400)}, 'gravity must fit float64'),
        ({'gravity': np.array([0, 0, 1j])}, 'gravity must be an array of numbers'),
        ({'damping': np.ma.array([1.0, 2.0], mask=[1, 0])}, 'damping must be .* a masked array'),
        ({'payload': 2.0}, 'payload must be a Payload or None, got 2.0'),
        ({'brakes': 'yes'}, "brakes must be True or False, got 'yes'"),
        ({'external_wrench': 1}, 'external_wrench must be True or False, got 1'),
        ({'friction': 'model'}, 'friction is not modelled yet'),
        ({'joint_limits': True}, 'joint_limits is not modelled yet'),
    ],
)
def test_a_wrong_scene_is_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Scene(**arguments)


def test_a_wrong_length_names_the_robot_and_its_joints(robot: Robot) -> None:
    with pytest.raises(ValueError, match=r"damping .* has 3 numbers, but 'random4' has 4 joints"):
        resolve(robot, Scene(damping=(1, 2, 3)))


def test_other_things_than_robots_and_scenes_are_refused(robot: Robot) -> None:
    with pytest.raises(ValueError, match=r"robot must be a Robot, got 'puma560'; load_robot\(\)"):
        resolve('puma560')
    with pytest.raises(ValueError, match='scene must be a Scene or None'):
        resolve(robot, {'gravity': None})
