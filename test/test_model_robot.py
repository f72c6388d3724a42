# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robot is checked once and cannot change: edits, frames, rotors, robots in YAML."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import copy
from dataclasses import FrozenInstanceError, fields, replace
from functools import reduce
from itertools import permutations
from pathlib import Path
import pickle
import re
from typing import Any

import numpy as np
from oracle import DYNAMICS, Oracle, relative
import pinocchio as pin
import pytest
from zoo import (
    FORK,
    ODD_ARM,
    ROWS,
    Array,
    example_urdf,
    random_chain,
    random_inertia,
    random_rotation,
    random_state,
    to_pinocchio,
)

import pfd_core as pfd
from pfd_core.machine.emulator import run as run_program
from pfd_core.model.limits import SPIN_UP_TIME
from pfd_core.model.plant import resolve as resolve_plant
from pfd_core.model.robot import Frame

SEEDS = range(2)
CHAIN_OF_3 = random_chain(np.random.default_rng(0), 3)


def rod(**changes: object) -> pfd.Robot:
    """Return a robot of one joint, with fields changed."""
    fields: dict[str, object] = {
        'name': 'rod',
        'joint_names': ('hinge',),
        'joint_types': ('revolute',),
        'rotations': [np.eye(3)],
        'translations': [[1.0, 0, 0]],
        'masses': [1.0],
        'centers': [[-0.5, 0, 0]],
        'inertias': [np.diag([0.0, 1 / 12, 1 / 12])],
    }
    return pfd.Robot(**{**fields, **changes})


def assert_same_dynamics(model: pin.Model, other: pin.Model, seed: int) -> None:
    """Compare mass matrix, torques and tip of two models of the same joints."""
    q, qd, qdd = random_state(np.random.default_rng(seed), model.nv)
    data, more = model.createData(), other.createData()
    tau, expected = pin.rnea(model, data, q, qd, qdd), pin.rnea(other, more, q, qd, qdd)
    assert np.abs(tau - expected).max() <= DYNAMICS * np.abs(expected).max()
    H, expected = np.triu(pin.crba(model, data, q)), np.triu(pin.crba(other, more, q))
    assert np.abs(H - expected).max() <= DYNAMICS * expected.max()
    pin.framesForwardKinematics(model, data, q)
    pin.framesForwardKinematics(other, more, q)
    tip, expected = (
        d.oMf[m.getFrameId('tip')].homogeneous for m, d in ((model, data), (other, more))
    )
    assert np.abs(tip - expected).max() <= DYNAMICS * np.abs(expected).max()


@pytest.mark.parametrize('seed', SEEDS)
@pytest.mark.parametrize('indices', [[0], [2], [6], [0, 1], [3, 5, 6], [0, 1, 2, 4, 5, 6]])
def test_locking_agrees_with_the_reduced_model_of_pinocchio(seed: int, indices: list[int]) -> None:
    rng = np.random.default_rng(seed)
    robot = random_chain(rng, 7)
    q = np.clip(rng.uniform(-2, 2, 7), robot.position_lower, robot.position_upper)
    less = pfd.lock(robot, {robot.joint_names[i]: q[i] for i in indices})
    kept = [i for i in range(7) if i not in indices]
    assert less.joint_names == tuple(robot.joint_names[i] for i in kept)
    np.testing.assert_array_equal(less.effort_limit, robot.effort_limit[kept])
    whole = to_pinocchio(robot)
    reduced = pin.buildReducedModel(whole, [i + 1 for i in indices], q)
    assert_same_dynamics(to_pinocchio(less), reduced, seed)


def test_a_joint_may_be_locked_at_its_limits_and_not_beyond() -> None:
    robot = random_chain(np.random.default_rng(0), 2, joint_types=['revolute', 'prismatic'])
    for name, lower, upper in zip(
        robot.joint_names, robot.position_lower, robot.position_upper, strict=True
    ):
        assert pfd.lock(robot, {name: lower}).n == pfd.lock(robot, {name: upper}).n == 1
        for beyond in (np.nextafter(lower, -np.inf), np.nextafter(upper, np.inf)):
            with pytest.raises(ValueError, match=f"lock joint '{name}' at .*: its limits are"):
                pfd.lock(robot, {name: beyond})


def test_joints_locked_in_any_order_or_one_by_one_give_the_same_bits() -> None:
    robot = random_chain(np.random.default_rng(3), 5)
    at = {'joint2': 0.3, 'joint3': -0.2, 'joint5': 0.1}
    less = pfd.lock(robot, at)
    assert all(pfd.lock(robot, dict(order)) == less for order in permutations(at.items()))
    for name, position in at.items():
        robot = pfd.lock(robot, {name: position})
    assert robot == less


@pytest.mark.parametrize('seed', SEEDS)
def test_a_payload_agrees_with_a_body_added_in_pinocchio(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = random_chain(rng, 4)
    payload = pfd.Payload(2.0, rng.uniform(-0.2, 0.2, 3), random_inertia(rng, 2.0))
    model = to_pinocchio(robot)
    body = pin.Inertia(payload.mass, np.array(payload.center), np.array(payload.inertia))
    model.appendBodyToJoint(4, body, model.frames[-1].placement)
    assert_same_dynamics(to_pinocchio(pfd.with_payload(robot, payload)), model, seed)
    assert pfd.with_payload(robot, pfd.Payload(0.0)) == robot


def test_arrays_are_copies_that_cannot_change() -> None:
    masses = np.array([1.0])
    robot = rod(masses=masses)
    masses[0] = 2.0
    assert robot.masses[0] == 1.0
    for name in ('masses', 'rotations', 'damping', 'base_position'):
        with pytest.raises(ValueError, match='read-only'):
            getattr(robot, name)[...] = 0


def arrays(value: Any) -> Iterator[np.ndarray]:
    """Yield all arrays in a record, also those of its records and mappings."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, Mapping):
        with pytest.raises(TypeError, match='does not support item assignment'):
            value['other'] = 0  # type: ignore[index]
        for item in value.values():
            yield from arrays(item)
    elif hasattr(value, 'digest'):
        for item in fields(value):
            yield from arrays(getattr(value, item.name))


@pytest.mark.filterwarnings('ignore::pfd_core.PhysicsWarning')
@pytest.mark.parametrize('kind', ['robot', 'frame', 'scene', 'plant'])
def test_records_stay_frozen_through_pickle_and_copies(kind: str) -> None:
    arm = pfd.load_robot(ODD_ARM)
    payload = pfd.Payload(1.0, [0, 0, 1])
    loads = pfd.Scene(damping='model', armature=[1, 2, 3, 4, 5, 6], payload=payload)
    value = {
        'robot': arm,
        'frame': arm.frame('tool'),
        'scene': loads,
        'plant': resolve_plant(arm, loads),
    }[kind]
    ways = (
        lambda x: pickle.loads(pickle.dumps(x)),
        lambda x: pickle.loads(pickle.dumps(x, protocol=0)),
        *(copy.deepcopy, copy.copy, replace),
    )
    for again in (way(value) for way in ways):
        assert (again, again.digest) == (value, value.digest)
        for mine, other in zip(arrays(again), arrays(value), strict=True):
            assert mine.tobytes() == other.tobytes()
            with pytest.raises(ValueError, match='read-only'):
                mine[...] = 0.0
        with pytest.raises(FrozenInstanceError):
            setattr(again, fields(again)[0].name, None)


def test_equal_numbers_make_equal_robots_and_any_other_number_or_name_another() -> None:
    robot = rod()
    assert robot == rod(source='elsewhere')
    assert hash(robot) == hash(rod(translations=[[1.0, -0.0, 0]]))
    assert len(robot.digest) == 64
    for changes in (
        *({'name': 'rud'}, {'joint_names': ('elbow',)}, {'joint_types': ('prismatic',)}),
        *({'masses': [np.nextafter(1.0, 2)]}, {'damping': 1e-300}, {'base': 'floor'}),
        *({'position_upper': 3.0}, {'root_rotation': np.diag([1.0, -1.0, -1.0])}),
    ):
        assert rod(**changes) != robot
        assert rod(**changes).digest != robot.digest


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'name': ''}, 'needs a name'),
        ({'joint_names': (), 'joint_types': ()}, 'no moving joint'),
        ({'joint_types': ()}, 'joint_types must have 1'),
        ({'joint_types': ('ball',)}, "joint 'hinge': type must be one of .*'ball'"),
        ({'joint_names': ('a', 'a'), 'joint_types': ('revolute',) * 2}, "'a' occurs more than"),
        ({'masses': [1.0, 2.0]}, r'masses must have shape \(1,\) for 1 joints, got \(2,\)'),
        ({'masses': ['heavy']}, 'masses must be an array of numbers'),
        ({'masses': [-1.0]}, "masses of joint 'hinge' must not be negative, got -1.0"),
        ({'masses': [np.nan]}, "masses of joint 'hinge' must be finite"),
        ({'centers': [[0, np.inf, 0]]}, "centers of joint 'hinge' must be finite"),
        ({'position_lower': [np.nan]}, "position_lower of joint 'hinge' must be a number"),
        ({'position_lower': 1.0, 'position_upper': 0.5}, 'must not exceed position_upper'),
        ({'effort_limit': 0.0}, 'effort_limit .* must be above 0, infinite for no limit, got 0'),
        ({'damping': -1.0}, 'damping .* must not be negative'),
        ({'base_position': [0, 0, np.nan]}, 'base_position must be finite'),
        ({'rotations': [np.diag([1, 1, 1.001])]}, "joint 'hinge' must be orthonormal"),
        ({'rotations': [np.diag([1, 1, -1])]}, "joint 'hinge' must be right-handed"),
        ({'rotations': [np.full((3, 3), 1e200)]}, "joint 'hinge' must be finite and at most"),
        ({'base_rotation': np.diag([1, 1, -1])}, "base_rotation of 'rod' must be right-handed"),
        ({'root_rotation': np.eye(3) * 2}, "root_rotation of 'rod' must be orthonormal"),
        ({'inertias': [[[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]]}, "'hinge'.* must be symmetric"),
        ({'inertias': [np.diag([1, 1, -0.1])]}, "'hinge'.* must not be negative in any direction"),
    ],
)
def test_a_wrong_robot_is_refused_and_the_cause_named(
    changes: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        rod(**changes)


def test_a_broken_triangle_rule_is_warned_of_and_the_link_named() -> None:
    with pytest.warns(pfd.PhysicsWarning, match="link 1 of 'rod' .*'hinge'.* triangle rule"):
        robot = rod(inertias=[np.diag([1.0, 1.0, 2.1])])
    assert robot.inertias[0, 2, 2] == 2.1


def test_warnings_of_a_loaded_robot_name_the_line_that_loads_it() -> None:
    text = pfd.robot_to_yaml(rod()).replace('zz: 0.08', 'zz: 9.08')
    with pytest.warns(pfd.PhysicsWarning, match='triangle rule') as found:
        pfd.load_robot(text)
    assert found[0].filename == __file__


@pytest.mark.parametrize(
    ('call', 'message'),
    [
        (
            lambda: pfd.lock(CHAIN_OF_3, {'j9': 0.0}),
            "'random3' has no such joint; .*: 'joint1', ",
        ),
        (lambda: pfd.lock(CHAIN_OF_3, {'joint1': np.inf}), "'joint1' is locked must be finite"),
        (lambda: pfd.lock(CHAIN_OF_3, {'joint*': 0.0}), 'cannot lock all 3 joints'),
        (lambda: pfd.Payload(-1.0), 'payload mass must not be negative'),
        (lambda: pfd.Payload(np.nan), 'payload mass must be finite'),
        (lambda: pfd.Payload(1.0, (0, 0)), r'payload center must have shape \(3,\), got \(2,\)'),
        (lambda: pfd.Payload(1.0, inertia=np.diag([1, 1, -1])), 'inertia must not be negative'),
        (lambda: pfd.Payload(1.0, inertia=1.0), r'inertia must have shape \(3, 3\), got \(\)'),
    ],
    ids=range(8),
)
def test_a_lock_or_a_payload_that_cannot_be_is_refused(
    call: Callable[[], object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize('locked', [{'nobody': 0.0}, {'elbow_joint': 99.0}])
def test_locks_that_a_robot_by_name_refuses_are_not_listed_for_tools(
    locked: dict[str, float],
) -> None:
    for read in (pfd.load_robot, pfd.locked_joints):
        with pytest.raises(ValueError, match=f"cannot lock .*'{next(iter(locked))}'"):
            read('ur5', locked=locked)


HELD_FINGERS = {'left_finger': 0.02, 'right_finger': 0.03}


def pose(robot: pfd.Robot, frame: str | None, q: Array) -> Array:
    found: Array = run_program(pfd.QUANTITIES['tip_pose'](resolve_plant(robot), frame), {'q': q})[
        'pose'
    ]
    return found


def carried(seed: int) -> tuple[np.random.Generator, pfd.Robot]:
    """Return a random chain with a frame on each link."""
    rng = np.random.default_rng(seed)
    robot = random_chain(rng, 5)
    frames = {f'f{k}': Frame(k, random_rotation(rng), rng.uniform(-1, 1, 3)) for k in range(6)}
    return rng, replace(robot, frames=frames)


def test_a_urdf_gives_all_links_that_move_with_the_chain_and_those_below_it() -> None:
    robot = pfd.load_robot(ODD_ARM)
    below = {'world': 0, 'pedestal': 0, 'turret': 1, 'box': 1, 'upper': 2, 'slide': 3, 'elbow': 4}
    below |= {'fore': 5, 'bracket': 5, 'camera': 5, 'wrist': 6, 'hand': 6, 'tool': 6}
    assert {name: frame.link for name, frame in robot.frames.items()} == below
    fork = pfd.load_robot(FORK, locked=HELD_FINGERS)
    assert set(fork.frames) == {'base', 'arm', 'palm', 'left', 'right'}


@pytest.mark.parametrize('indices', [[0], [2], [4], [0, 1], [1, 3, 4], [0, 1, 2, 4]])
def test_frames_keep_their_poses_when_joints_are_locked(indices: list[int]) -> None:
    rng, robot = carried(3)
    q = np.clip(rng.uniform(-1, 1, 5), robot.position_lower, robot.position_upper)
    less = pfd.lock(robot, {robot.joint_names[i]: q[i] for i in indices})
    assert list(less.frames) == list(robot.frames)
    for name in robot.frames:
        found = pose(less, name, np.delete(q, indices))
        assert relative(found, pose(robot, name, q)) < DYNAMICS, name


def test_storing_and_loading_frames_loses_no_bit() -> None:
    for robot in (pfd.load_robot(ODD_ARM), carried(7)[1]):
        again = pfd.load_robot(pfd.robot_to_yaml(robot, frames=True))
        assert again == robot == replace(robot, frames={})
        assert dict(again.frames) == dict(robot.frames)
        assert set(pfd.load_robot(pfd.robot_to_yaml(robot)).frames) == {robot.base, robot.tip}


FRAMES_TABLE = """
robot: arm
joints:
- {name: a, type: revolute, mass: 1, dh: {a: 1, d: 0, alpha_deg: 0, theta_deg: 0}}
frames:
"""


@pytest.mark.parametrize(
    ('line', 'message'),
    [
        ('  - grip', "frames must be a table of frames by name, got ['grip']"),
        ('  grip: {}', "frame 'grip' has no 'link'"),
        ('  grip: {link: 1, size: 2}', "frame 'grip' has an unknown key 'size'"),
        ('  grip: {link: 0.5}', "link of frame 'grip' must be a whole number, got 0.5"),
        ('  grip: {link: -1}', 'link of a frame must be an integer of at least 0, got -1'),
        ('  grip: {link: 2}', "'arm': frames['grip'] must be a Frame on a link from 0 to 1"),
        ('  grip: {link: 1, translation: [0, 0]}', "translation in frame 'grip' must have shape"),
    ],
)
def test_a_wrong_frame_in_a_file_is_refused_and_named(line: str, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        pfd.load_robot(FRAMES_TABLE + line)


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
    without = replace(robot, armature=np.zeros(robot.n))
    ratio = robot.armature / pfd.estimated_armature(without)
    assert (least <= ratio).all()
    assert (ratio <= most).all()


def test_an_estimate_keeps_the_rotors_that_a_model_states_and_needs_both_limits() -> None:
    robot = replace(
        pfd.load_robot('ur5'),
        armature=np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0]),
        effort_limit=np.array([150.0, np.inf, np.inf, 28.0, 28.0, 28.0]),
        velocity_limit=np.array([3.0, 3.0, np.inf, np.inf, np.inf, 3.5]),
    )
    expected = [0.5, 0.0, 0.0, 0.0, 0.0, SPIN_UP_TIME * 8.0]
    np.testing.assert_allclose(pfd.estimated_armature(robot), expected, rtol=1e-15)


def test_a_scene_with_estimated_rotors_has_the_accelerations_of_one_with_their_numbers(
    tmp_path: Path,
) -> None:
    robot = pfd.load_robot('ur5')
    robot = replace(robot, armature=np.zeros(robot.n))
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


# The book prints four digits after the point.
PRINTED = 0.5e-4 * 1.001


def tip_at(robot: pfd.Robot, q: np.ndarray) -> np.ndarray:
    return pfd.compile_kernel(robot, quantity='tip_pose')(q)


@pytest.mark.parametrize('name', ['panda', 'planar2', 'puma560', 'ur5'])
def test_known_robots_load_without_a_warning_and_name_their_source(name: str) -> None:
    robot = pfd.load_robot(name)
    assert name in pfd.known_robots()
    assert robot.name == name
    assert f'{name}.yaml' in robot.source
    assert np.isfinite(robot.effort_limit).all()
    assert np.isfinite(robot.velocity_limit).all()


def test_the_puma_has_the_inertia_and_gravity_load_that_corke_prints() -> None:
    # Corke, Robotics, Vision and Control (2011), section 9.1, at pose qn.
    puma = pfd.load_robot('puma560')
    q = np.pi * np.array([0, 1 / 4, 1, 0, 1 / 4, 0])
    upper = [
        *([3.6594, -0.4044, 0.1006, -0.0025, 0, 0], [4.4137, 0.3509, 0, 0.0024, 0]),
        *([0.9378, 0, 0.0015, 0], [0.1925, 0, 0], [0.1713, 0], [0.1941]),
    ]
    H = Oracle(puma, puma.armature).H(q)
    printed = np.concatenate(upper)
    np.testing.assert_allclose(H[np.triu_indices(6)], printed, rtol=0, atol=PRINTED)
    load = Oracle(puma).tau(q, np.zeros(6), np.zeros(6))
    np.testing.assert_allclose(load, [0, 31.6399, 6.0351, 0, 0.0283, 0], rtol=0, atol=PRINTED)


@pytest.mark.filterwarnings('ignore:URDF text. not read.*mu_coulomb:pfd_core.PhysicsWarning')
def test_the_panda_is_the_urdf_without_its_hand() -> None:
    text = example_urdf('panda_description/urdf/panda.urdf')
    arm = text[: text.index('<joint name="panda_hand_joint"')] + '</robot>'
    urdf, ours = pfd.load_robot(arm, tip='panda_link8'), pfd.load_robot('panda')
    assert urdf.joint_names == ours.joint_names
    for key in ('position_lower', 'position_upper', 'velocity_limit', 'effort_limit', 'damping'):
        np.testing.assert_array_equal(getattr(ours, key), getattr(urdf, key))
    for key in ('rotations', 'translations', 'masses', 'centers', 'inertias', 'base_position'):
        np.testing.assert_allclose(getattr(ours, key), getattr(urdf, key), atol=DYNAMICS)


def test_planar2_is_the_double_pendulum_of_the_textbook() -> None:
    # Two rods of mass m and length l from the horizontal: H and gravity in closed form.
    robot, m, l, g = pfd.load_robot('planar2'), 1.0, 0.5, 9.81  # noqa: E741
    q = np.array([0.3, -1.1])
    c2, c1, c12 = np.cos(q[1]), np.cos(q[0]), np.cos(q[0] + q[1])
    H12 = m * l**2 * (1 / 3 + c2 / 2)
    expected = [[m * l**2 * (5 / 3 + c2), H12], [H12, m * l**2 / 3]]
    np.testing.assert_allclose(Oracle(robot).H(q), expected, rtol=DYNAMICS)
    load = Oracle(robot).tau(q, np.zeros(2), np.zeros(2))
    outer = m * g * l * c12 / 2
    np.testing.assert_allclose(load, [1.5 * m * g * l * c1 + outer, outer], rtol=DYNAMICS)


def dh(a: float, d: float, alpha: float, theta: float) -> np.ndarray:
    """Return the homogeneous matrix of a standard DH row, angles in degrees."""
    turn = pin.SE3(pin.rpy.rpyToMatrix(0, 0, np.radians(theta)), np.array([0, 0, d]))
    twist = pin.SE3(pin.rpy.rpyToMatrix(np.radians(alpha), 0, 0), np.array([a, 0, 0]))
    return (turn * twist).homogeneous


def test_standard_rows_are_turn_shift_shift_twist() -> None:
    robot = pfd.load_robot(ROWS)
    q = np.array([0.7, -0.4])
    expected = dh(0.5, 0.1, 90, 30 + np.degrees(0.7)) @ dh(0, 0.2 - 0.4, -20, 90)
    np.testing.assert_allclose(tip_at(robot, q), expected, atol=DYNAMICS)
    assert robot.inertias[1].tolist() == [[1, 0.1, 0], [0.1, 1, 0], [0, 0, 1]]
    assert robot.centers[1, 2] == 1e-3
    assert robot.position_lower.tolist() == [-np.inf, -np.inf]


def test_modified_rows_are_twist_shift_turn_shift() -> None:
    # The same joints and bodies in both ways: Craig's row i holds the twist of row i - 1.
    common = 'joints:\n- {name: a, type: revolute, mass: 1, center: [0.1, 0.2, 0.3]'
    second = '- {name: b, type: prismatic, mass: 2, center: [0.3, 0, 0.1]'
    robot = pfd.load_robot(
        'robot: m\nbase: {link: floor, translation: [0, 0, 0.3]}\n'
        'tip: {link: hand, rotation: [[1, 0, 0], [0, 0, -1], [0, 1, 0]]}\n'
        f'{common}, modified_dh: {{a: 0, d: 0.1, alpha_deg: 0, theta_deg: 30}}}}\n'
        f'{second}, modified_dh: {{a: 0.5, d: 0.2, alpha_deg: 35, theta_deg: 90}}}}\n'
    )
    q, qd, qdd = random_state(np.random.default_rng(2), 2)
    model = pin.Model()
    places = (
        pin.SE3(pin.rpy.rpyToMatrix(0, 0, np.pi / 6), np.array([0, 0, 0.4])),
        pin.SE3(pin.rpy.rpyToMatrix(np.radians(35), 0, 0), np.array([0.5, 0, 0]))
        * pin.SE3(pin.rpy.rpyToMatrix(0, 0, np.pi / 2), np.array([0, 0, 0.2])),
    )
    bodies = (1.0, np.array([0.1, 0.2, 0.3])), (2.0, np.array([0.3, 0, 0.1]))
    for i, kind in enumerate((pin.JointModelRZ(), pin.JointModelPZ())):
        model.addJoint(i, kind, places[i], 'ab'[i])
        body = pin.Inertia(*bodies[i], np.zeros((3, 3)))
        model.appendBodyToJoint(i + 1, body, pin.SE3.Identity())
    data = model.createData()
    tau = Oracle(robot).tau(q, qd, qdd)
    np.testing.assert_allclose(tau, pin.rnea(model, data, q, qd, qdd), rtol=DYNAMICS)
    pin.forwardKinematics(model, data, q)
    tip = data.oMi[2] * pin.SE3(pin.rpy.rpyToMatrix(np.pi / 2, 0, 0), np.zeros(3))
    # The base link lies 0.3 m below the world's origin of the model.
    np.testing.assert_allclose(tip_at(robot, q), tip.homogeneous, atol=DYNAMICS)
    assert (robot.base, robot.tip) == ('floor', 'hand')


def test_a_rotor_is_carried_through_its_gear() -> None:
    rotor = 'rotor: {inertia: 2e-4, gear_ratio: -50, damping: 1e-3, friction: 0.1}'
    robot = pfd.load_robot(ROWS.replace('mass: 1,', f'mass: 1, damping: 0.5, {rotor},'))
    np.testing.assert_allclose(robot.armature, [0.5, 0], rtol=DYNAMICS)
    np.testing.assert_allclose(robot.damping, [0.5 + 2.5, 0], rtol=DYNAMICS)
    np.testing.assert_allclose(robot.friction, [5, 0], rtol=DYNAMICS)


def test_locking_while_loading_is_locking_after() -> None:
    assert pfd.load_robot('ur5', locked={'elbow_joint': 0.5}) == pfd.lock(
        pfd.load_robot('ur5'), {'elbow_joint': 0.5}
    )
    assert pfd.load_robot('ur5', base='base_link', tip='tool0') == pfd.load_robot('ur5')


def changed(old: str, new: str) -> str:
    assert old in ROWS
    return ROWS.replace(old, new)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('robot: [\n', 'is not YAML'),
        ('- a\n- b\n', 'must be a mapping with robot, joints'),
        ('robot: x\n', "has no 'joints'"),
        ('robot: x\njoints: []\n', 'no moving joint'),
        ('robot: x\njoints: {}\n', "joints of 'x' must be a list"),
        ('robot: x\njoints: [3]\n', 'joint 1 must be a mapping'),
        (changed('robot: two', 'robot: two\ncolour: red'), "unknown key 'colour'; known"),
        (changed('mass: 1, ', ''), "joint 'a' has no 'mass'"),
        (changed('mass: 1', 'mass: heavy'), "mass of joint 'a' must be a number, got 'heavy'"),
        (changed('xy: 0.1', 'yx: 0.1'), "inertia of joint 'b' has an unknown key 'yx'"),
        (changed('[0, 0, 1e-3]', '[0, 0]'), r"center of joint 'b' must have shape \(3,\)"),
        (changed('alpha_deg: 90', 'alpha: 90'), "dh of joint 'a' has no 'alpha_deg'"),
        (changed('dh: {a: 0.5', 'craig: {a: 0.5'), "joint 'a' has an unknown key 'craig'"),
        (changed(', dh: {a: 0.5, d: 0.1, alpha_deg: 90, theta_deg: 30}', ''), 'exactly one of dh'),
        (changed('dh: {a: 0.5', 'modified_dh: {a: 0.5'), 'all be placed the same way'),
        (changed('name: a', 'name: b'), "joint name 'b' occurs more than once"),
        (changed('type: revolute', 'type: ball'), "joint 'a': type must be one of"),
        (changed('robot: two', 'robot: two\ntip: {link: t, translation: [0, 0, 1]}'), 'tip of'),
        (changed('mass: 1', 'mass: 1, armature: 1, rotor: {}'), "'a' has both rotor and armature"),
        (changed('mass: 1', 'mass: 1, rotor: {inertia: 1}'), "rotor of joint 'a' has no 'gear_"),
        (
            changed('mass: 1', 'mass: 1, limits: {max: 1}'),
            "limits of joint 'a' has an unknown key",
        ),
    ],
)
def test_a_wrong_file_is_refused_and_the_key_named(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pfd.load_robot(text)


# Each list holds the one before nine times.
ALIASES = reduce(lambda inner, i: f'[&l{i} {inner}{f", *l{i}" * 8}]', range(11), '[1]')


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('joints: ' + '[' * 1000 + ']' * 1000 + '\n', 'nest(ed too deep|ing depth)'),
        ('joints: &a [*a]\n', 'recursive node'),
        ('#\n' * 500_000 + '#', 'has 1000001 characters'),
        ('robot: x\njoints: !!python/name:os.system x\n', "joints of 'x' must be a list, got 'x'"),
        (ROWS.replace('[0, 0, 1e-3]', ALIASES), 'more than 1000000 values, aliases expanded'),
        ('joints: 1\n? [a]\n: b\n', 'unhashable key'),
        ('joints: {<<: 3}\n', "<< takes tables, got '3'"),
        ('joints: 1\njoints: 2\n', "key 'joints' occurs more than once in line 1"),
        ('joints: 1\n---\njoints: 2\n', 'is not YAML: but found another document'),
        (ROWS.replace('mass: 1,', 'mass: 1, mass: 4,'), "key 'mass' occurs more than once"),
        (ROWS.replace('mass: 1,', f'mass: {10**400},'), "mass of joint 'a' must be finite"),
        (ROWS.replace('mass: 1,', 'mass: 1e-400,'), "mass of joint 'a' is too small"),
        (ROWS.replace('mass: 1,', 'mass: 1_0,'), "mass of joint 'a' must be a number, got '1_0'"),
        (ROWS.replace('mass: 1,', 'mass: .nan,'), "mass of joint 'a' must be a number"),
        (ROWS.replace('mass: 1,', 'mass: 1, accept_unphysical_inertia: maybe,'), 'True or False'),
        (ROWS.replace('[0, 0, 1e-3]', '{x: 1}'), "center of joint 'b' must be a number, a list"),
        (ROWS.replace('name: a', 'name: [a]'), 'joint_names must be'),
        (ROWS.replace('robot: two', 'robot: two\ntip: {link: [a]}'), 'tip must be a string'),
        (ROWS.replace('name: a', f'name: {"a" * 100_000}').replace('mass: 1', 'mass: x'), 'mass'),
        (ROWS.replace('mass: 1', 'mass: ' + 'x' * 100_000), 'mass of joint'),
    ],
)
def test_a_hostile_yaml_is_refused_in_a_short_line(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        pfd.load_robot(text)
    assert len(str(caught.value)) < 1000
    assert '\n' not in str(caught.value)


def test_anchors_and_merge_keys_may_be_used() -> None:
    text = ROWS.replace('mass: 1,', 'mass: 1, limits: &l {upper: 2, lower: -.inf},')
    robot = pfd.load_robot(text.replace('mass: 2,', 'mass: 2, limits: {<<: *l, lower: -3},'))
    assert robot.position_lower.tolist() == [-np.inf, -3.0]
    assert robot.position_upper.tolist() == [2.0, 2.0]
