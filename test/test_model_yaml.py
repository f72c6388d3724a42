# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots in YAML: the ones that come along are the published ones, and storing loses no bit."""

from __future__ import annotations

import os
from pathlib import Path
import re
import subprocess
import sys
import zipfile

from bridge import LARGEST_MODEL_FILE
import numpy as np
from oracle import Oracle
import pinocchio as pin
import pytest
from tolerances import DYNAMICS
from zoo import ODD_ARM, ROWS, random_state, to_pinocchio

import pfd_core as pfd

# The book prints four digits after the point.
PRINTED = 0.5e-4 * 1.001


def tip_at(robot: pfd.Robot, q: np.ndarray) -> np.ndarray:
    model = to_pinocchio(robot)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[-1].homogeneous


@pytest.mark.parametrize('name', ['panda', 'planar2', 'puma560', 'ur5'])
def test_known_robots_load_without_a_warning_and_name_their_source(name: str) -> None:
    robot = pfd.load_robot(name)
    assert name in pfd.known_robots()
    assert robot.name == name
    assert f'{name}.yaml' in robot.source
    assert np.isfinite(robot.effort_limit).all()
    assert np.isfinite(robot.velocity_limit).all()


def test_every_known_robot_is_listed() -> None:
    folder = Path(__file__).resolve().parent.parent / 'config' / 'robots'
    assert pfd.known_robots() == sorted(path.stem for path in folder.glob('*.yaml'))


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


def test_the_puma_wrist_is_made_of_exact_right_angles() -> None:
    assert set(np.abs(pfd.load_robot('puma560').rotations).ravel().tolist()) == {0.0, 1.0}


def test_the_ur5_has_the_reach_of_its_table() -> None:
    # All angles zero: a2 + a3 along x, d4 + d6 along -y, d1 - d5 up.
    expected = [-0.425 - 0.39225, -0.10915 - 0.0823, 0.089159 - 0.09465]
    tip = tip_at(pfd.load_robot('ur5'), np.zeros(6))
    np.testing.assert_allclose(tip[:3, 3], expected, rtol=DYNAMICS)


def test_the_panda_is_the_urdf_without_its_hand() -> None:
    folder = Path(pin.__file__).parents[4] / 'share' / 'example-robot-data' / 'robots'
    text = (folder / 'panda_description/urdf/panda.urdf').read_text(encoding='utf-8')
    cut = text.index('<joint name="panda_hand_joint"')
    arm = text[:cut] + '</robot>'
    urdf, ours = pfd.load_robot(arm, tip='panda_link8'), pfd.load_robot('panda')
    assert urdf.joint_names == ours.joint_names
    keys = ('position_lower', 'position_upper', 'velocity_limit', 'effort_limit', 'damping')
    for key in keys:
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


def test_a_stored_robot_keeps_its_source_and_the_inertias_that_it_accepts() -> None:
    robot = pfd.load_robot('puma560')
    again = pfd.load_robot(pfd.robot_to_yaml(robot))
    assert (again, again.source, again.accepted) == (robot, robot.source, robot.accepted)


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
    # The same joints and bodies written both ways: Craig's row i holds the twist of row i-1.
    common = 'joints:\n- {name: a, type: revolute, mass: 1, center: [0.1, 0.2, 0.3]'
    second = '- {name: b, type: prismatic, mass: 2, center: [0.3, 0, 0.1]'
    modified = pfd.load_robot(
        'robot: m\nbase: {link: floor, translation: [0, 0, 0.3]}\n'
        'tip: {link: hand, rotation: [[1, 0, 0], [0, 0, -1], [0, 1, 0]]}\n'
        f'{common}, modified_dh: {{a: 0, d: 0.1, alpha_deg: 0, theta_deg: 30}}}}\n'
        f'{second}, modified_dh: {{a: 0.5, d: 0.2, alpha_deg: 35, theta_deg: 90}}}}\n'
    )
    q, qd, qdd = random_state(np.random.default_rng(2), 2)
    model = pin.Model()
    placement = pin.SE3(pin.rpy.rpyToMatrix(0, 0, np.pi / 6), np.array([0, 0, 0.4]))
    model.addJoint(0, pin.JointModelRZ(), placement, 'a')
    model.appendBodyToJoint(
        1, pin.Inertia(1.0, np.array([0.1, 0.2, 0.3]), np.zeros((3, 3))), pin.SE3.Identity()
    )
    twist = pin.SE3(pin.rpy.rpyToMatrix(np.radians(35), 0, 0), np.array([0.5, 0, 0]))
    shift = pin.SE3(pin.rpy.rpyToMatrix(0, 0, np.pi / 2), np.array([0, 0, 0.2]))
    model.addJoint(1, pin.JointModelPZ(), twist * shift, 'b')
    model.appendBodyToJoint(
        2, pin.Inertia(2.0, np.array([0.3, 0, 0.1]), np.zeros((3, 3))), pin.SE3.Identity()
    )
    tau = Oracle(modified).tau(q, qd, qdd)
    expected = pin.rnea(model, model.createData(), q, qd, qdd)
    np.testing.assert_allclose(tau, expected, rtol=DYNAMICS)
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    tip = data.oMi[2] * pin.SE3(pin.rpy.rpyToMatrix(np.pi / 2, 0, 0), np.zeros(3))
    np.testing.assert_allclose(tip_at(modified, q), tip.homogeneous, atol=DYNAMICS)
    assert (modified.base, modified.tip) == ('floor', 'hand')


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


def test_an_unknown_name_lists_the_known_ones() -> None:
    known = ', '.join(pfd.known_robots())
    with pytest.raises(ValueError, match=f"unknown robot 'puma': known are {re.escape(known)}"):
        pfd.load_robot('puma')


def test_missing_and_wrong_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no robot file '.*arm\.urdf'"):
        pfd.load_robot(tmp_path / 'arm.urdf')
    with pytest.raises(ValueError, match=r"no robot file 'arm\.yaml'"):
        pfd.load_robot('arm.yaml')
    (tmp_path / 'arm.txt').write_text('robot: x')
    with pytest.raises(ValueError, match=r'must end in \.urdf'):
        pfd.load_robot(tmp_path / 'arm.txt')
    (tmp_path / 'arm.yaml').write_bytes(b'\xff\xfe\x00')
    with pytest.raises(ValueError, match='cannot read'):
        pfd.load_robot(tmp_path / 'arm.yaml')
    with pytest.raises(ValueError, match='source must be a name, a path or a string, got 3'):
        pfd.load_robot(3)


def test_a_path_that_is_no_regular_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / 'pipe.urdf')
    (tmp_path / 'folder.yaml').mkdir()
    (tmp_path / 'zero.urdf').symlink_to('/dev/zero')
    for name in ('pipe.urdf', 'folder.yaml', 'zero.urdf'):
        with pytest.raises(ValueError, match=rf'cannot read .*{name}.: it is not a regular file'):
            pfd.load_robot(tmp_path / name)
        with pytest.raises(ValueError, match='it is not a regular file'):
            pfd.load_robot(str(tmp_path / name))
    with open(tmp_path / 'huge.urdf', 'wb') as file:
        file.truncate(LARGEST_MODEL_FILE + 1)
    with pytest.raises(ValueError, match=r'cannot read .*huge\.urdf.: it is larger than'):
        pfd.load_robot(tmp_path / 'huge.urdf')


@pytest.mark.parametrize('source', ['x' * 1_000_000, 'zero\0.urdf', 'a/' * 5000, b'ur5', '\ud800'])
def test_a_name_that_no_file_can_have_is_refused_in_a_short_line(source: object) -> None:
    with pytest.raises(ValueError, match=r'unknown robot|no robot file|source must be') as caught:
        pfd.load_robot(source)
    assert len(str(caught.value)) < 1000


def test_a_mark_of_byte_order_is_no_part_of_a_file(tmp_path: Path) -> None:
    for name, text in (('two.yaml', ROWS), ('odd.urdf', ODD_ARM)):
        (tmp_path / name).write_text('\ufeff' + text, encoding='utf-8')
        assert pfd.load_robot(tmp_path / name) == pfd.load_robot(text)


def nested(levels: int) -> str:
    """Return YAML lists, each of which names the one before nine times: 9 ** levels."""
    lines = ['robot: x', 'l0: &l0 [1, 1]']
    lines += [f'l{i}: &l{i} [{", ".join([f"*l{i - 1}"] * 9)}]' for i in range(1, levels)]
    return '\n'.join([*lines, f'joints: *l{levels - 1}'])


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        (nested(20), 'more than 30000 nodes, aliases expanded'),
        ('joints: ' + '[' * 1000 + ']' * 1000 + '\n', 'is nested too deep'),
        ('joints: &a [*a]\n', 'recursive node'),
        ('joints: [' + '1, ' * 30_000 + ']\n', 'more than 30000 nodes'),
        ('#' * 1_000_000 + '\n', 'has 1000001 characters'),
        ('robot: x\njoints: !!python/name:os.system x\n', "joints of 'x' must be a list, got 'x'"),
        ('joints: 1\n? [a]\n: b\n', 'unhashable key'),
        ('joints: {<<: 3}\n', "<< takes tables, got '3'"),
        ('joints: 1\njoints: 2\n', "key 'joints' occurs more than once in line 1"),
        ('joints: 1\n---\njoints: 2\n', 'is not YAML: but found another document'),
        (ROWS.replace('mass: 1,', 'mass: 1, mass: 4,'), "key 'mass' occurs more than once"),
        (ROWS.replace('mass: 1,', f'mass: {10**400},'), "mass of joint 'a' must be finite"),
        (ROWS.replace('mass: 1,', 'mass: 1e-400,'), "mass of joint 'a' is too small"),
        (ROWS.replace('mass: 1,', 'mass: 1_0,'), "mass of joint 'a' must be a number, got '1_0'"),
        (ROWS.replace('mass: 1,', 'mass: .nan,'), "mass of joint 'a' must be a number"),
        (ROWS.replace('mass: 1,', 'mass: 1, accept_unphysical_inertia: maybe,'), 'true or false'),
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


def test_scalars_are_strings_until_they_are_read_as_numbers() -> None:
    robot = pfd.load_robot(ROWS.replace('name: a', 'name: no').replace('robot: two', 'robot: 012'))
    assert (robot.name, robot.joint_names) == ('012', ('no', 'b'))
    assert pfd.load_robot(pfd.robot_to_yaml(robot)) == robot


def test_anchors_and_merge_keys_may_be_used() -> None:
    text = ROWS.replace('mass: 1,', 'mass: 1, limits: &l {upper: 2, lower: -.inf},')
    robot = pfd.load_robot(text.replace('mass: 2,', 'mass: 2, limits: {<<: *l, lower: -3},'))
    assert robot.position_lower.tolist() == [-np.inf, -3.0]
    assert robot.position_upper.tolist() == [2.0, 2.0]


def test_a_urdf_file_remembers_its_path(tmp_path: Path) -> None:
    path = tmp_path / 'arm.urdf'
    path.write_text(ODD_ARM, encoding='utf-8')
    assert pfd.load_robot(str(path)).source == str(path)
    assert pfd.load_robot(path) == pfd.load_robot(ODD_ARM)


def test_base_and_tip_cannot_be_chosen_in_yaml() -> None:
    with pytest.raises(ValueError, match="tip='wrist' cannot be chosen for 'ur5'"):
        pfd.load_robot('ur5', tip='wrist')


def test_robots_are_known_by_name_in_an_installation_in_a_zip_file(tmp_path: Path) -> None:
    root = Path(pfd.__file__).resolve().parent.parent
    archive = tmp_path / 'site.zip'
    with zipfile.ZipFile(archive, 'w') as file:
        for path in (root / 'pfd_core').rglob('*.py'):
            file.write(path, path.relative_to(root))
        # In a checkout, and where it was installed.
        for path in [*(root / 'config').rglob('*.yaml'), *(root / 'pfd_core/config').rglob('*')]:
            file.write(path, Path('pfd_core', *path.parts[path.parts.index('config') :]))
    script = (
        'import pfd_core as pfd; assert ".zip" in pfd.__file__; '
        'print(*pfd.known_robots(), *(pfd.load_robot(name).digest for name in pfd.known_robots()))'
    )
    found = subprocess.run(
        [sys.executable, '-c', script],
        cwd=tmp_path,
        env=os.environ | {'PYTHONPATH': str(archive)},
        capture_output=True,
        text=True,
        check=True,
        timeout=200,
    )
    names = pfd.known_robots()
    assert found.stdout.split() == [*names, *(pfd.load_robot(name).digest for name in names)]
