# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rotors behind gears: their inertia at the joint, from data sheets and from URDF."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from bridge import SPIN_UP_TIME
import numpy as np
import pinocchio as pin
import pytest
from urdf_models import example
from zoo import FORK

import pfd_core as pfd

DRAKE = '<robot xmlns:drake="http://drake.mit.edu" '
FINGERS = {'left_finger': 0.0, 'right_finger': 0.0}


def transmission(joints: str, *actuators: str) -> str:
    """Return a <transmission> with the names of joints, and the contents of its actuators."""
    inner = ''.join(f'<joint name="{name}"/>' for name in joints.split())
    inner += ''.join(f'<actuator name="motor">{content}</actuator>' for content in actuators)
    return f'<transmission name="gear">{inner}</transmission>'


def fork(*transmissions: str) -> str:
    text = FORK.replace('<robot ', DRAKE, 1)
    return text.replace('</robot>', ''.join(transmissions) + '</robot>')


def test_the_inertia_of_a_rotor_counts_with_the_square_of_its_gear_ratio() -> None:
    found = pfd.reflected_inertia([2e-4, 3e-5, 0.0], [100.0, -50.0, 1.0])
    np.testing.assert_allclose(found, [2.0, 0.075, 0.0], rtol=1e-15)
    np.testing.assert_array_equal(pfd.reflected_inertia([1.0, 2.0], 3.0), [9.0, 18.0])
    scene = pfd.Scene(armature=pfd.reflected_inertia(np.full(6, 1e-4), 101.0))
    assert scene.armature == pytest.approx([1e-4 * 101**2] * 6)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (([-1e-4], 100.0), 'rotor_inertia must not be negative'),
        (([1e-4], 0.0), 'gear_ratio must not be zero'),
        (([1e-4], [1.0, 2.0]), 'gear_ratio must have shape'),
        ((1e-4, 100.0), 'rotor_inertia must have shape'),
        (([np.nan], 100.0), 'rotor_inertia must be finite'),
    ],
)
def test_a_wrong_rotor_is_refused(arguments: tuple[object, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pfd.reflected_inertia(*arguments)


def test_a_urdf_states_rotors_by_elements_of_drake_or_a_motor_inertia() -> None:
    drake = '<drake:rotor_inertia value="1.5e-4"/><drake:gear_ratio value="-120"/>'
    plain = '<motorInertia>2e-4</motorInertia><mechanicalReduction>50</mechanicalReduction>'
    text = fork(transmission('shoulder', drake), transmission('wrist', plain, plain))
    robot = pfd.load_robot(text, locked=FINGERS)
    # Two motors turn the wrist.
    np.testing.assert_allclose(robot.armature, [1.5e-4 * 120**2, 2 * 2e-4 * 50**2], rtol=1e-15)
    direct = fork(transmission('shoulder', '<drake:rotor_inertia value="0.02"/>'))
    np.testing.assert_array_equal(pfd.load_robot(direct, locked=FINGERS).armature, [0.02, 0.0])
    # A rotor of a locked joint does not turn.
    locked = pfd.load_robot(text, locked=FINGERS | {'shoulder': 0.1})
    assert locked.armature == pytest.approx([2 * 2e-4 * 50**2])


def test_a_reduction_without_a_rotor_adds_no_armature() -> None:
    alone = '<mechanicalReduction>100</mechanicalReduction>'
    robot = pfd.load_robot(fork(transmission('shoulder wrist', alone)), locked=FINGERS)
    assert robot == pfd.load_robot(FORK, locked=FINGERS)
    text = example('ur_description/urdf/ur5_robot.urdf')
    assert 'mechanicalReduction' in text
    assert not pfd.load_robot(text, tip='ee_link').armature.any()


@pytest.mark.parametrize(
    ('joints', 'content', 'message'),
    [
        ('elbow', '<motorInertia>1</motorInertia>', "'gear' .* one joint .* got .'elbow'."),
        ('shoulder wrist', '<motorInertia>1</motorInertia>', "'gear' .* must have one joint"),
        ('', '<motorInertia>1</motorInertia>', "'gear' .* must have one joint of the URDF, got"),
        ('wrist', '<motorInertia>heavy</motorInertia>', "motorInertia of .*'gear' must be a num"),
        ('wrist', '<drake:rotor_inertia/>', "rotor_inertia of transmission 'gear' must be a num"),
        ('wrist', '<motorInertia>-1</motorInertia>', "'gear': rotor_inertia must not be neg"),
        (
            'wrist',
            '<motorInertia>1</motorInertia><mechanicalReduction>0</mechanicalReduction>',
            "'gear': gear_ratio must not be zero",
        ),
    ],
)
def test_a_wrong_transmission_is_named(joints: str, content: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pfd.load_robot(fork(transmission(joints, content)), locked=FINGERS)


def test_an_arm_with_rotors_moves_as_in_pinocchio() -> None:
    rotor = '<drake:rotor_inertia value="1.5e-4"/><drake:gear_ratio value="120"/>'
    text = fork(transmission('wrist', rotor))
    robot = pfd.load_robot(text, locked=FINGERS)
    whole = pin.buildModelFromXML(text)
    model = pin.buildReducedModel(
        whole, [whole.getJointId(name) for name in FINGERS], pin.neutral(whole)
    )
    model.rotorInertia = np.array([0.0, 1.5e-4])
    model.rotorGearRatio = np.array([1.0, 120.0])
    model.armature = model.rotorInertia * model.rotorGearRatio**2
    q, qd, tau = np.array([[0.3, -0.4], [1.0, 2.0], [3.0, -1.0]])
    with pytest.warns(pfd.PhysicsWarning, match="states none for 'shoulder'"):
        found = pfd.forward_dynamics(robot, q, qd, tau, scene=pfd.Scene(armature='model'))
    expected = pin.aba(model, model.createData(), q, qd, tau)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ('name', 'least', 'most'),
    [
        # The 13 joints that the rule is fitted to, by their geometric mean.
        ('panda', 0.33, 1.3),
        ('puma560', 1.1, 3.6),
        # A simulation's choice for every joint, which is not measured.
        ('ur5', 0.059, 0.33),
    ],
)
def test_estimated_rotors_are_off_by_the_stated_factors(
    name: str, least: float, most: float
) -> None:
    robot = pfd.load_robot(name)
    without = dataclasses.replace(robot, armature=np.zeros(robot.n))
    ratio = robot.armature / pfd.estimated_armature(without)
    assert (least <= ratio).all()
    assert (ratio <= most).all()


def test_the_time_of_the_estimate_is_the_mean_over_known_rotors() -> None:
    robots = [pfd.load_robot(name) for name in ('panda', 'puma560')]
    times = [r.armature * r.velocity_limit / r.effort_limit for r in robots]
    mean = np.exp(np.log(np.concatenate(times)).mean())
    # Stated with two digits.
    assert f'{mean:.2g}' == f'{SPIN_UP_TIME:g}'


def test_an_estimate_keeps_the_rotors_that_a_model_states_and_needs_both_limits() -> None:
    robot = dataclasses.replace(
        pfd.load_robot('ur5'),
        armature=np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0]),
        effort_limit=np.array([150.0, np.inf, 0.0, 28.0, 28.0, 28.0]),
        velocity_limit=np.array([3.0, 3.0, 3.0, 0.0, np.inf, 3.5]),
    )
    expected = [0.5, 0.0, 0.0, 0.0, 0.0, SPIN_UP_TIME * 8.0]
    np.testing.assert_allclose(pfd.estimated_armature(robot), expected, rtol=1e-15)


def test_a_scene_with_estimated_rotors_has_the_accelerations_of_one_with_their_numbers(
    tmp_path: Path,
) -> None:
    robot = pfd.load_robot('ur5')
    robot = dataclasses.replace(robot, armature=np.zeros(robot.n))
    scene = pfd.Scene(armature='estimated')
    scene.save(tmp_path / 'scene.yaml')
    assert pfd.load_scene(tmp_path / 'scene.yaml') == scene
    state = np.random.default_rng(5).normal(size=(3, robot.n))
    named, numbers = (
        pfd.compile_kernel(robot, scene=pfd.Scene(armature=armature))(*state)
        for armature in ('estimated', pfd.estimated_armature(robot))
    )
    assert named.tobytes() == numbers.tobytes()
    with pytest.raises(ValueError, match="damping must be None, 'model' or one number per joint"):
        pfd.Scene(damping='estimated')
    with pytest.raises(ValueError, match="armature must be None, 'model', 'estimated' or one"):
        pfd.Scene(armature='guessed')
