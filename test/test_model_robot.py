# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robot is checked once and cannot change; its edits, frames and rotors are mechanics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import copy
import dataclasses
from dataclasses import FrozenInstanceError, fields, replace
from pathlib import Path
import pickle
import re
from typing import Any

from bridge import SPIN_UP_TIME, Frame, resolve_plant, run_program
import numpy as np
from oracle import relative
import pinocchio as pin
import pytest
from tolerances import DYNAMICS
from urdf_models import example
from zoo import (
    FORK,
    ODD_ARM,
    Array,
    random_chain,
    random_inertia,
    random_rotation,
    random_state,
    to_pinocchio,
)

import pfd_core as pfd

SEEDS = range(5)


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
    with pytest.raises(FrozenInstanceError):
        robot.name = 'other'


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


ARM = pfd.load_robot(ODD_ARM)
LOADS = pfd.Scene(
    damping='model', armature=[1, 2, 3, 4, 5, 6], payload=pfd.Payload(1.0, [0, 0, 1])
)


@pytest.mark.filterwarnings('ignore::pfd_core.PhysicsWarning')
@pytest.mark.parametrize('kind', ['robot', 'frame', 'scene', 'plant'])
def test_records_stay_frozen_through_pickle_and_copies(kind: str) -> None:
    value = {
        'robot': ARM,
        'frame': ARM.frame('tool'),
        'scene': LOADS,
        'plant': resolve_plant(ARM, LOADS),
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


def test_an_unpickled_robot_is_not_warned_of_twice() -> None:
    with pytest.warns(pfd.PhysicsWarning):
        robot = rod(inertias=[np.diag([1.0, 1.0, 2.1])])
    assert pickle.loads(pickle.dumps(robot)) == robot


def test_equal_numbers_make_equal_robots_and_any_other_number_or_name_another() -> None:
    robot = rod()
    assert robot == rod(source='elsewhere')
    assert hash(robot) == hash(rod(translations=[[1.0, -0.0, 0]]))
    assert len(robot.digest) == 64
    for changes in (
        *({'name': 'rud'}, {'joint_names': ('elbow',)}, {'joint_types': ('prismatic',)}),
        *({'masses': [np.nextafter(1.0, 2)]}, {'damping': 1e-300}, {'base': 'floor'}),
        {'position_upper': 3.0},
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
        ({'effort_limit': -1.0}, 'effort_limit .* must not be negative'),
        ({'damping': -1.0}, 'damping .* must not be negative'),
        ({'base_position': [0, 0, np.nan]}, 'base_position must be finite'),
        ({'rotations': [np.diag([1, 1, 1.001])]}, "joint 'hinge' must be orthonormal"),
        ({'rotations': [np.diag([1, 1, -1])]}, "joint 'hinge' must be right-handed"),
        ({'rotations': [np.full((3, 3), 1e200)]}, "joint 'hinge' must be finite and at most"),
        ({'base_rotation': np.diag([1, 1, -1])}, "base_rotation of 'rod' must be right-handed"),
        ({'inertias': [[[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]]}, "'hinge'.* must be symmetric"),
        ({'inertias': [np.diag([1, 1, -0.1])]}, "'hinge'.* must not be negative in any direction"),
    ],
)
def test_a_wrong_robot_is_refused_and_the_cause_named(
    changes: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        rod(**changes)


@pytest.mark.parametrize(
    'value',
    [
        np.array([1 + 1j]),
        np.ma.array([1.0], mask=[True]),
        np.ma.array([1.0]),
        np.array([True]),
        [True],
        ['1.0'],
        [10**400],
        [-(10**400)],
        [1e101],
        [[[[[1.0]]]]],
        [np.timedelta64(1, 's')],
        None,
    ],
    ids=repr,
)
def test_values_other_than_real_numbers_are_refused(value: object) -> None:
    for key in ('masses', 'damping', 'armature'):
        with pytest.raises(ValueError, match=key):
            rod(**{key: value})
    with pytest.raises(ValueError, match='payload mass'):
        pfd.Payload(value)
    with pytest.raises(ValueError, match="joint 'joint1' is locked"):
        pfd.lock(random_chain(np.random.default_rng(0), 2), {'joint1': value})


@pytest.mark.parametrize('kind', [int, np.int8, np.uint64, np.float32, np.longdouble, np.array])
def test_numbers_of_python_and_numpy_are_numbers(kind: type) -> None:
    robot = rod(masses=[kind(2)], damping=kind(3), effort_limit=[kind(4)])
    assert (robot.masses[0], robot.damping[0], robot.effort_limit[0]) == (2.0, 3.0, 4.0)
    assert robot.masses.dtype == np.float64
    chain = random_chain(np.random.default_rng(0), 2)
    assert pfd.lock(chain, {'joint1': kind(2)}) == pfd.lock(chain, {'joint1': 2.0})
    assert pfd.Payload(kind(2)) == pfd.Payload(2.0)


def test_an_inertia_may_miss_zero_by_the_rounding_of_the_parallel_axes() -> None:
    # 0.5 kg half a metre away: 1e-16 of m d^2 is 1e-17.
    tiny = np.diag([-5e-20, 0.0, 0.0])
    assert rod(masses=[0.5], inertias=[tiny]).inertias[0, 0, 0] == -5e-20
    with pytest.raises(ValueError, match='must not be negative in any direction'):
        rod(masses=[0.5], inertias=[np.diag([-1e-9, 1e-9, 1e-9])])
    with pytest.raises(ValueError, match='must not be negative in any direction'):
        rod(masses=[0.0], inertias=[tiny])


def test_an_error_stays_short_whatever_the_names_are() -> None:
    name = 'j' * 1_000_000
    for call in (
        lambda: rod(name=name, masses=-1),
        lambda: rod(joint_names=(name,), masses=-1),
        lambda: rod(joint_types=(name,)),
        lambda: pfd.Payload(name),
        lambda: rod(masses=name),
    ):
        with pytest.raises(ValueError, match='must') as caught:
            call()
        assert len(str(caught.value)) < 1000
        assert '\n' not in str(caught.value)


def test_a_broken_triangle_rule_is_warned_of_and_the_link_named() -> None:
    with pytest.warns(pfd.PhysicsWarning, match="link 1 of 'rod' .*'hinge'.* triangle rule"):
        robot = rod(inertias=[np.diag([1.0, 1.0, 2.1])])
    assert robot.inertias[0, 2, 2] == 2.1


def test_the_published_puma_breaks_the_triangle_rule_where_its_file_states_it() -> None:
    puma = pfd.load_robot('puma560')
    assert puma.accepted == ('joint1', 'joint3')
    with pytest.warns(pfd.PhysicsWarning) as warned:
        replace(puma, accepted=())
    assert [str(w.message).split(' (')[0] for w in warned] == [
        "link 1 of 'puma560'",
        "link 3 of 'puma560'",
    ]


@pytest.mark.parametrize(
    ('positions', 'message'),
    [
        (
            {'j9': 0.0},
            "cannot lock 'j9': 'random3' has no such joint, only 'joint1', 'joint2', 'joint3'",
        ),
        ({'joint1': np.inf}, "joint 'joint1' is locked must be finite"),
        ({'joint1': 0, 'joint2': 0, 'joint3': 0}, 'cannot lock all 3 joints'),
    ],
)
def test_a_lock_that_cannot_be_is_refused(positions: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pfd.lock(random_chain(np.random.default_rng(0), 3), positions)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ((-1.0,), 'payload mass must not be negative'),
        ((np.nan,), 'payload mass must be finite'),
        ((1.0, (0, 0)), r'payload center must have shape \(3,\), got \(2,\)'),
        ((1.0, (0, 0, 0), np.diag([1, 1, -1])), 'payload inertia must not be negative'),
        ((1.0, (0, 0, 0), 1.0), r'payload inertia must have shape \(3, 3\), got \(\)'),
    ],
)
def test_a_wrong_payload_is_refused(arguments: tuple[object, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pfd.Payload(*arguments)


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
    everything = {'world', 'pedestal', 'turret', 'box', 'upper', 'slide', 'elbow', 'fore'}
    everything |= {'bracket', 'camera', 'wrist', 'hand', 'tool'}
    robot = pfd.load_robot(ODD_ARM)
    assert set(robot.frames) == everything
    assert robot.frames['world'].link == robot.frames['pedestal'].link == 0
    assert robot.frames['box'].link == robot.frames['turret'].link == 1
    assert robot.frames['tool'].link == robot.n
    fork = pfd.load_robot(FORK, locked=HELD_FINGERS)
    assert set(fork.frames) == {'base', 'arm', 'palm', 'left', 'right'}


def test_a_table_gives_its_base_and_its_tip() -> None:
    robot = pfd.load_robot('ur5')
    assert list(robot.frames) == [robot.base, robot.tip]
    assert robot.frame() == robot.frame(robot.tip) == Frame(6, np.eye(3), np.zeros(3))


@pytest.mark.parametrize('indices', [[0], [2], [4], [0, 1], [1, 3, 4], [0, 1, 2, 4]])
def test_frames_keep_their_poses_when_joints_are_locked(indices: list[int]) -> None:
    rng, robot = carried(3)
    q = np.clip(rng.uniform(-1, 1, 5), robot.position_lower, robot.position_upper)
    less = pfd.lock(robot, {robot.joint_names[i]: q[i] for i in indices})
    assert list(less.frames) == list(robot.frames)
    for name in robot.frames:
        found = pose(less, name, np.delete(q, indices))
        assert relative(found, pose(robot, name, q)) < DYNAMICS, name


def test_frames_make_no_other_robot() -> None:
    robot = pfd.load_robot(ODD_ARM)
    assert replace(robot, frames={}) == robot
    assert replace(robot, frames={}).digest == robot.digest


def test_storing_and_loading_frames_loses_no_bit() -> None:
    for robot in (pfd.load_robot(ODD_ARM), carried(7)[1]):
        again = pfd.load_robot(pfd.robot_to_yaml(robot, frames=True))
        assert again == robot
        assert dict(again.frames) == dict(robot.frames)
        assert set(pfd.load_robot(pfd.robot_to_yaml(robot)).frames) == {robot.base, robot.tip}


TABLE = """
robot: arm
joints:
- {name: a, type: revolute, mass: 1, dh: {a: 1, d: 0, alpha_deg: 0, theta_deg: 0}}
frames:
"""


def test_a_file_may_name_frames() -> None:
    robot = pfd.load_robot(TABLE + '  grip: {link: 1, translation: [0, 0.5, 0]}')
    assert list(robot.frames) == ['base', 'grip', 'tip']
    np.testing.assert_allclose(pose(robot, 'grip', np.array([np.pi / 2]))[:3, 3], [-0.5, 1, 0])


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
        pfd.load_robot(TABLE + line)


def test_an_unknown_frame_is_named_with_the_known_frames() -> None:
    robot = pfd.load_robot(FORK, locked=HELD_FINGERS)
    known = "'base', 'arm', 'palm', 'left', 'right'"
    message = f"frame 'flange' is not carried by 'fork'; it carries {known}"
    for name in ('tip_pose', 'tip_jacobian', 'tip_velocity', 'wrench_torques'):
        with pytest.raises(ValueError, match=message):
            pfd.QUANTITIES[name](resolve_plant(robot), 'flange')


def test_the_list_of_known_frames_is_bounded() -> None:
    _, robot = carried(5)
    many = {f'{k:0200}': robot.frames['f0'] for k in range(1000)}
    with pytest.raises(ValueError, match='and 990 more') as caught:
        replace(robot, frames=many).frame('x' * 10_000)
    assert len(str(caught.value)) < 3000


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
