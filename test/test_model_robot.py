# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robot is checked once, cannot change, and its edits are rigid-body mechanics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import copy
from dataclasses import FrozenInstanceError, fields, replace
import pickle
from typing import Any

from bridge import (
    axis_rotation,
    cos_sin_degrees,
    matrix_product,
    merged_body,
    resolve_plant,
    snapped_rotation,
)
import numpy as np
import pinocchio as pin
import pytest
from tolerances import DYNAMICS
from zoo import ODD_ARM, random_chain, random_inertia, random_rotation, random_state, to_pinocchio

import pfd_core as pfd

# One square root and three products.
ROUNDING = 4 * np.finfo(float).eps
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


def test_bodies_weld_as_in_pinocchio() -> None:
    rng = np.random.default_rng(3)
    for m1, m2 in ((1.0, 2.0), (0.0, 3.0), (3.0, 0.0), (1e-9, 1.0)):
        bodies = [(m, rng.normal(size=3), random_inertia(rng, m)) for m in (m1, m2)]
        mass, center, J = merged_body(*bodies)
        sum_ = pin.Inertia(*bodies[0]) + pin.Inertia(*bodies[1])
        assert mass == sum_.mass
        np.testing.assert_allclose(center, sum_.lever, rtol=DYNAMICS)
        np.testing.assert_allclose(J, sum_.inertia, rtol=0, atol=DYNAMICS * J.max())


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


def test_products_are_summed_in_one_order_on_every_machine() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        A, B, v = rng.normal(size=(3, 3)), rng.normal(size=(3, 3)), rng.normal(size=3)
        a, b = A.tolist(), B.tolist()
        expected = [
            [a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j] for j in range(3)]
            for i in range(3)
        ]
        assert matrix_product(A, B).tolist() == expected
        tiled = matrix_product(A, np.tile(v, (3, 1)).T)
        assert matrix_product(A, v).tolist() == tiled[:, 0].tolist()
        assert matrix_product(A, B, v).tolist() == matrix_product(matrix_product(A, B), v).tolist()


def test_right_angles_and_coordinate_axes_are_exact() -> None:
    expected = {0: (1, 0), 90: (0, 1), 180: (-1, 0), 270: (0, -1), -90: (0, -1), 720: (1, 0)}
    assert {angle: cos_sin_degrees(angle) for angle in expected} == expected
    assert cos_sin_degrees(30) == (np.cos(np.radians(30)), np.sin(np.radians(30)))
    for axis in (*np.eye(3), *-np.eye(3)):
        R = axis_rotation(2.5 * axis)
        np.testing.assert_array_equal(R[:, 2], axis)
        np.testing.assert_array_equal(R.T @ R, np.eye(3))
        assert np.linalg.det(R) == 1
    np.testing.assert_array_equal(axis_rotation([0, 0, 3.0]), np.eye(3))


def test_any_axis_becomes_the_third_column_of_a_rotation() -> None:
    rng = np.random.default_rng(0)
    nearly = [(1e-9, 0, -1), (0, 1e-200, 1), (1e300, 1e300, 0), (1e-300, -2e-300, -1e-300)]
    for axis in [*rng.normal(size=(50, 3)), *nearly]:
        R = axis_rotation(axis)
        unit = np.array(axis) / np.abs(axis).max()
        np.testing.assert_allclose(R[:, 2], unit / np.linalg.norm(unit), atol=ROUNDING)
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=ROUNDING)
        assert np.linalg.det(R) > 0


def test_snapping_leaves_a_slightly_turned_frame_alone() -> None:
    turn = np.eye(3)
    turn[0, 1], turn[1, 0] = -1e-9, 1e-9
    np.testing.assert_array_equal(snapped_rotation(turn), turn)
    some = random_rotation(np.random.default_rng(0))
    np.testing.assert_array_equal(snapped_rotation(some), some)
    right = pin.rpy.rpyToMatrix(np.pi / 2, -np.pi, np.pi / 2)
    assert set(np.abs(snapped_rotation(right)).ravel().tolist()) == {0.0, 1.0}
