# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Outputs, payloads, wrenches and scenes of the arm, against Pinocchio; the noise of sensors."""

from __future__ import annotations

import itertools
from typing import Any

from arm_messages import (
    STEP_NS,
    UNLIMITED,
    change,
    decode_array,
    efforts,
    made,
    payload,
    request,
    same,
    state,
    told,
    verdict,
    wrench,
)
import numpy as np
from oracle import Oracle
import pinocchio as pin
import pytest
from ros_processes import example_robot
from test_arm_rules import PUSHED
from zoo import effect_example

import pfd_core as pfd
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import OPTIONAL as OPTIONAL_OUTPUTS
from pfd_ros.arm.events import ROLES as ARM_ROLES
from pfd_ros.arm.events import Message as ArmMessage
from pfd_ros.arm.noise import BLOCK as NOISE_BLOCK
from pfd_ros.arm.noise import LARGEST_SEED as NOISE_LARGEST_SEED
from pfd_ros.arm.noise import Channel as NoiseChannel
from pfd_ros.arm.noise import normal as noise_normal
from pfd_ros.arm.noise import philox
from pfd_ros.arm.noise import uniform as noise_uniform
from pfd_ros.arm.outputs import position_and_quaternion
from pfd_ros.arm.plant import scene_of, with_scene_text
from pfd_ros.arm.plant_settings import JOINT_EFFECTS, joint_settings
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.joints import decode_joints
from pfd_ros.messages.types import FLOAT_ARRAY as FLOAT_ARRAY_TYPE
from pfd_ros.messages.types import INERTIA as INERTIA_TYPE
from pfd_ros.messages.types import JOINT_STATE as JOINT_STATE_TYPE
from pfd_ros.messages.values import decode_numbers

# Not that of the model.
_FIRST = ('wrist_1_joint', 'shoulder_pan_joint', 'elbow_joint')
ORDER = (*_FIRST, 'wrist_3_joint', 'shoulder_lift_joint', 'wrist_2_joint')
TORQUES = efforts(1.0, 2.0, -3.0, 0.5, -4.0, 0.25)
UR5: dict[str, Any] = {
    'robot': 'ur5',
    'joints': ORDER,
    'initial_positions': (0.3, -1.2, 1.4, -0.6, 1.2, 0.3),
    'outputs': OPTIONAL_OUTPUTS,
    'armature': True,
}


def moved(engine: Engine, *messages: ArmMessage, cycles: int = 100) -> dict[str, bytes]:
    """Return the last outputs by role of an arm under torques, from its first step on."""
    engine.step([TORQUES, *messages], run=False)
    for _ in range(cycles):
        produced, _ = engine.step()
    return {m.role: m.data for m in produced}


def decoded(role: str, data: bytes) -> np.ndarray:
    """Return the numbers of an output."""
    kind = ARM_ROLES[role].type
    if kind == FLOAT_ARRAY_TYPE:
        array = decode_array(data)
        return array.values.reshape(array.sizes)
    if kind == JOINT_STATE_TYPE:
        return decode_joints(data).effort
    return np.array(decode_numbers(data, kind).values)


class Expected:
    """Pinocchio's numbers for the state of an engine, in model order."""

    def __init__(self, engine: Engine) -> None:
        self.order = engine.order.tolist()
        self.q, self.qd, self.tau = engine.state.rows[engine.state.now]
        self.oracle = Oracle(engine.robot, engine.robot.armature)

    def jacobian(self) -> np.ndarray:
        model, data = self.oracle.model, self.oracle.data
        tip = model.nframes - 1
        return pin.computeFrameJacobian(model, data, self.q, tip, pin.LOCAL_WORLD_ALIGNED)

    def pose(self) -> pin.SE3:
        model, data = self.oracle.model, self.oracle.data
        pin.framesForwardKinematics(model, data, self.q)
        return data.oMf[model.nframes - 1]


def test_the_model_quantities_of_the_true_state_equal_pinocchio():
    engine = made(**UR5)
    found = moved(engine)
    expected = Expected(engine)
    oracle, q, qd, order = expected.oracle, expected.q, expected.qd, expected.order
    zero = np.zeros(6)
    wanted = {
        'inertia_matrix': oracle.H(q)[np.ix_(order, order)],
        'bias_torques': oracle.tau(q, qd, zero)[order],
        'gravity_torques': oracle.tau(q, zero, zero)[order],
        'acceleration': oracle.qdd(q, qd, expected.tau)[order],
        'tip_jacobian': expected.jacobian()[:, order],
        'external_torques': zero,
        'tip_wrench': zero,
        'energy': [
            pin.computeKineticEnergy(oracle.model, oracle.data, q, qd),
            pin.computePotentialEnergy(oracle.model, oracle.data, q),
            expected.tau @ qd,
        ],
    }
    for role, numbers in wanted.items():
        np.testing.assert_allclose(
            decoded(role, found[role]), numbers, rtol=1e-9, atol=1e-9, err_msg=role
        )
    placement, pose = expected.pose(), decoded('tip_pose', found['tip_pose'])
    np.testing.assert_allclose(pose[:3], placement.translation, atol=1e-12)
    np.testing.assert_allclose(pin.Quaternion(pose[3:]).matrix(), placement.rotation, atol=1e-12)


TABLE = """<robot name="table"><link name="world"/><link name="top"/><link name="arm"><inertial>
<origin xyz="0.3 0 0"/><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
</inertial></link>{}<joint name="j" type="revolute"><parent link="top"/><child link="arm"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="3" effort="90"/></joint></robot>"""
TILT = """<joint name="tilt" type="revolute"><parent link="world"/><child link="top"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="3" effort="9"/></joint>"""


@pytest.mark.parametrize('base', ['', 'world', 'top'])
def test_gravity_is_given_in_axes_of_the_root_and_poses_in_axes_of_the_base_link(base):
    engine = made(
        robot=TABLE.format(TILT),
        base_link=base,
        locked=('tilt',),
        locked_positions=(0.5,),
        initial_positions=(np.pi / 2,),
        outputs=('gravity_torques', 'tip_pose'),
        tip_link='arm',
    )
    found = {m.role: m.data for m in engine.step()[0]}
    # Down along the tilted table is x of its top.
    torque = -2 * 9.81 * 0.3 * np.sin(0.5) * np.sin(np.pi / 2)
    np.testing.assert_allclose(decoded('gravity_torques', found['gravity_torques']), [-torque])
    numbers = decode_numbers(found['tip_pose'], ARM_ROLES['tip_pose'].type)
    assert numbers.frame_id == (base or 'world')
    turn = pin.Quaternion(np.array(numbers.values[3:])).matrix()
    wanted = pin.rpy.rpyToMatrix(0, 0.0 if base == 'top' else 0.5, 0) @ pin.rpy.rpyToMatrix(
        0, 0, np.pi / 2
    )
    np.testing.assert_allclose(turn, wanted, atol=1e-12)


def test_the_outputs_fulfil_the_equation_of_motion_with_a_wrench_on_the_tip():
    engine = made(**UR5, joint_damping=(0.1,) * 6, external_wrench=True)
    k = [3.0, -2.0, 10.0, 0.1, 0.2, -0.3]
    found = moved(engine, wrench('tool0', k[:3], k[3:]))
    expected = Expected(engine)
    base = np.concatenate([expected.pose().rotation @ half for half in np.split(np.array(k), 2)])
    torques = decoded('external_torques', found['external_torques'])
    np.testing.assert_allclose(torques, expected.jacobian()[:, expected.order].T @ base)
    assert decoded('tip_wrench', found['tip_wrench']).tolist() == k
    inertia, qdd, bias = (
        decoded(role, found[role]) for role in ('inertia_matrix', 'acceleration', 'bias_torques')
    )
    np.testing.assert_allclose(
        inertia @ qdd + bias, expected.tau[expected.order] + torques, atol=1e-9
    )
    for role in ('external_torques', 'bias_torques', 'gravity_torques'):
        plain = decode_array(found[f'{role}_array'])
        assert (plain.sizes, plain.values.tolist()) == ((6,), decoded(role, found[role]).tolist())
        assert plain.values.any()


@pytest.mark.parametrize('method', ['auto', 'pcrbm'])
def test_a_payload_that_comes_while_the_arm_runs_is_in_the_model_from_the_next_cycle_on(method):
    outputs = ('inertia_matrix', 'gravity_torques')
    engine = made(joints=('elbow', 'shoulder'), **START, outputs=outputs, method=method)
    before = told(engine, efforts(1.0, 2.0), cycles=100)
    assert verdict(engine, change(payload_mass=2.0, payload_center=[0.0, 0.0, 0.1])).accepted
    after = {m.role: m.data for m in engine.step()[0]}
    order, q = engine.order, engine.state.rows[engine.state.now, 0]
    scene = pfd.Scene(payload=engine.plant.scene.payload)
    for role, turned in (('inertia_matrix', np.ix_(order, order)), ('gravity_torques', order)):
        wanted = pfd.compile_kernel(engine.robot, quantity=role, scene=scene)(q)[turned]
        # A payload that comes later may be an input of the compiled code.
        np.testing.assert_allclose(decoded(role, after[role]), wanted, rtol=0, atol=1e-13)
        assert np.abs(decoded(role, after[role]) - decoded(role, before[role])).max() > 0.1


def test_compensated_gravity_is_no_part_of_the_model_and_dry_friction_is_left_out():
    model = {'outputs': ('inertia_matrix', 'bias_torques', 'gravity_torques', 'energy')}
    plain, _ = made(**model).step()
    dry = {'joint_friction': (0.1,) * 2, 'motor_lag': (0.01,) * 2}
    assert made(**model, gravity_compensation=True, **dry).step()[0] == plain


def test_layouts_and_headers_name_joints_axes_and_frames():
    found, joints = moved(made(**UR5, frame_id='room'), cycles=1), ','.join(ORDER)
    layouts = {
        'acceleration': (f'joint: {joints}',),
        'inertia_matrix': (f'row: {joints}', f'column: {joints}'),
        'tip_jacobian': ('row: vx,vy,vz,wx,wy,wz', f'column: {joints}'),
        'energy': ('item: kinetic,potential,power',),
    }
    for role, labels in layouts.items():
        assert decode_array(found[role]).labels == labels
    for role in ('joint_states', 'true_states', 'external_torques', 'bias_torques'):
        message = decode_joints(found[role])
        assert message.stamp_ns == 1_000_000
        assert (message.frame_id, message.names) == ('room', ORDER)
    for role, frame in (('tip_pose', 'base_link'), ('tip_wrench', 'tool0')):
        stamped = decode_numbers(found[role], ARM_ROLES[role].type)
        assert (stamped.stamp_ns, stamped.frame_id) == (1_000_000, frame)


def test_outputs_describe_the_true_state_and_come_for_states_that_are_dropped_too():
    exact, measured = (
        made(**UR5),
        made(**UR5, noise_position=1.0, delay_state=0.01, drop_state=0.5),
    )
    one, other = moved(exact), moved(measured)
    assert [role for role in OPTIONAL_OUTPUTS if one[role] != other[role]] == []
    assert one['true_states'] == one['joint_states']
    found = [[m.role for m in measured.step()[0]] for _ in range(50)]
    shown = ['joint_states' in roles for roles in found]
    assert set(shown) == {True, False}
    assert all('true_states' in roles for roles in found)


def test_true_states_have_the_locked_joints_that_joint_states_have():
    locked = {'robot': 'puma560', 'locked': ('joint6',), 'locked_positions': (0.25,)}
    for published in (True, False):
        engine = made(**locked, publish_locked=published, outputs=('true_states',))
        found = {m.role: m.data for m in engine.step()[0]}
        assert found['true_states'] == found['joint_states']


def test_a_jump_and_a_failed_arm_have_no_acceleration_and_every_number_is_finite():
    engine = made(outputs=OPTIONAL_OUTPUTS, **UNLIMITED)
    engine.step([efforts(1e300, -1e300)])
    for _ in range(20):
        produced, _ = engine.step()
    assert engine.state.failure
    found = {m.role: m.data for m in produced}
    assert not decoded('acceleration', found['acceleration']).any()
    for role in OPTIONAL_OUTPUTS:
        assert np.isfinite(decoded(role, found[role])).all()


def test_quaternions_have_unit_length_a_positive_w_and_turn_as_the_matrix():
    axes = (1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 2, 3), (1, -1, 0)
    for turn, axis in itertools.product((0.0, 0.5, 2.0, 3.0, np.pi, 4.0), np.array(axes)):
        pose = np.eye(4)
        pose[:3, :3] = pin.AngleAxis(turn, axis / np.linalg.norm(axis)).matrix()
        x, y, z, w = position_and_quaternion(pose)[3:]
        assert w >= 0
        assert abs(x * x + y * y + z * z + w * w - 1) < 1e-15
        np.testing.assert_allclose(pin.Quaternion(w, x, y, z).matrix(), pose[:3, :3], atol=1e-15)


# Noise, by counters.


# From the file kat_vectors of Random123, the authors' own implementation.
@pytest.mark.parametrize(
    ('counter', 'key', 'words'),
    [
        ([0] * 4, [0, 0], [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]),
        ([0xFFFFFFFF] * 4, [0xFFFFFFFF] * 2, [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD]),
        (
            [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344],
            [0xA4093822, 0x299F31D0],
            [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1],
        ),
    ],
)
def test_the_bits_equal_the_published_vectors(counter, key, words):
    got = philox(np.array(counter, np.uint64)[:, None], key[0] | key[1] << 32)
    assert got[:, 0].tolist() == words


def samples(draw, seed: int, channel: NoiseChannel, cycles: int = 4000, n: int = 6) -> np.ndarray:
    return np.array([draw(seed, channel, cycle, n) for cycle in range(cycles)])


# The deviates are fixed numbers: a p-value is one too, and a limit of 1e-3 is no game of chance.
def test_deviates_have_their_distributions():
    # Not in every worker that collects this file: it takes 0.7 s.
    from scipy import stats

    for seed in (0, 1, NOISE_LARGEST_SEED):
        flat = samples(noise_uniform, seed, NoiseChannel.POSITION).ravel()
        assert ((flat >= 0) & (flat < 1)).all()
        assert stats.kstest(flat, 'uniform').pvalue > 1e-3
        bell = samples(noise_normal, seed, NoiseChannel.VELOCITY).ravel()
        assert stats.kstest(bell, 'norm').pvalue > 1e-3
        share = (np.abs(bell) > 3).mean()
        assert abs(share - 2 * stats.norm.sf(3)) < 5 * np.sqrt(0.0027 / bell.size)


@pytest.mark.parametrize(
    ('seed', 'channel', 'cycle', 'element'),
    [
        (7, NoiseChannel.VELOCITY, 0, 0),
        (8, NoiseChannel.POSITION, 0, 0),
        (7 + 2**32, NoiseChannel.POSITION, 0, 0),
        (7, NoiseChannel.POSITION, 1, 0),
        (7, NoiseChannel.POSITION, 0, 1),
    ],
)
def test_neighbours_are_independent(seed, channel, cycle, element):
    one = samples(noise_normal, 7, NoiseChannel.POSITION)
    other = samples(noise_normal, seed, channel, 4000 + cycle, 6 + element)[cycle:, element:]
    for a, b in ((one, other), (one**2, other**2)):
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4 / np.sqrt(one.size)


def test_an_element_depends_neither_on_the_number_of_elements_nor_on_earlier_requests():
    cycle, far = 5 * NOISE_BLOCK + 3, 2**40 + 1
    few, many = (noise_normal(3, NoiseChannel.EFFORT, cycle, n) for n in (4, 7))
    assert many[:4].tolist() == few.tolist()
    assert set(noise_normal(3, NoiseChannel.EFFORT, far, 4)).isdisjoint(
        noise_normal(3, NoiseChannel.EFFORT, 1, 4)
    )
    with pytest.raises(ValueError, match='read-only'):
        few[0] = 0.0


TIP = 'tip_link'
START = {'initial_positions': (0.3, -0.2)}


# The wrench and the payload, against Pinocchio.

UR5_URDF = str(example_robot('ur_description/urdf/ur5_robot.urdf'))
POSE = (0.3, -1.2, 0.9, 0.4, -0.7, 1.1)
TAU = (1.0, -20.0, 5.0, 0.3, -0.2, 0.1)
CENTER, INERTIA = (0.1, -0.02, 0.05), (0.02, 0.001, -0.002, 0.03, 0.003, 0.025)


def moving_ur5(*messages: ArmMessage, **settings: Any) -> tuple[Any, np.ndarray]:
    """Return the last state of an arm that has moved, and its accelerations."""
    given = {'robot': UR5_URDF, 'initial_positions': POSE, 'step_size': 1e-4, **settings}
    engine = made(**given, outputs=('acceleration',))
    assert all(engine.step([efforts(*TAU), *messages], run=False)[1])
    last = state(engine, cycles=199)
    qdd = decode_array(told(engine)['acceleration']).values
    row = engine.state.rows[engine.state.now]
    assert np.abs(last.velocity).max() > 0.05
    return row, qdd


def test_a_wrench_and_a_payload_in_carried_frames_move_the_arm_as_in_pinocchio():
    for frame in ('wrist_3_link', 'tool0', 'ee_link'):
        pushed = wrench(frame, (12.0, -7.0, 20.0), (0.8, -1.5, 0.6))
        loaded = payload(frame, 2.5, CENTER, INERTIA)
        (q, qd, _), qdd = moving_ur5(pushed, loaded, external_wrench=True)
        model = pin.buildModelFromUrdf(UR5_URDF)
        place = model.frames[model.getFrameId(frame)]
        xx, xy, xz, yy, yz, zz = INERTIA
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        without = pin.aba(model, model.createData(), q, qd, np.array(TAU))
        body = pin.Inertia(2.5, np.array(CENTER), inertia)
        model.appendBodyToJoint(place.parentJoint, body, place.placement)
        # Force and torque at the frame's origin, brought to the frame of its joint.
        force = pin.Force(np.array([12.0, -7.0, 20.0]), np.array([0.8, -1.5, 0.6]))
        forces = pin.StdVec_Force()
        forces.extend([pin.Force.Zero() for _ in range(model.njoints)])
        forces[place.parentJoint] = place.placement.act(force)
        wanted = pin.aba(model, model.createData(), q, qd, np.array(TAU), forces)
        assert np.abs(wanted - without).max() > 1.0
        np.testing.assert_allclose(qdd, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())


def pushes(engine: Engine, *messages: ArmMessage) -> list[bool]:
    """Return whether each of the next ten steps is pushed, as ~/tip_wrench tells."""
    found = []
    for k in range(10):
        data = told(engine, *(messages if k == 0 else ()))['tip_wrench']
        found.append(any(decode_numbers(data, 'geometry_msgs/msg/WrenchStamped').values))
    return found


def test_a_wrench_holds_until_it_is_replaced_cleared_or_the_arm_reset():
    engine, on = made(**PUSHED), wrench(TIP, (0.0, 3.0, 0.0))
    assert pushes(engine) == [False] * 10
    assert pushes(engine, efforts(0.0, 0.0), on) == [True] * 10
    assert state(engine).velocity.all()
    assert pushes(engine, wrench(TIP)) == [False] * 10
    assert pushes(engine, on, request('clear_wrench')) == [False] * 10
    assert pushes(engine, on, request('reset')) == [False] * 10
    assert not state(engine).velocity.any()
    # One stamped before the reset, which came after 41 steps, is stale.
    assert verdict(engine, wrench(TIP, stamp_ns=41 * STEP_NS)).label == 'stale'
    assert verdict(engine, wrench(TIP, stamp_ns=42 * STEP_NS)).accepted
    scene = pfd.scene_to_yaml(pfd.Scene(gravity=None, external_wrench=True))
    assert pushes(made(scene=scene), on) == [True] * 10


@pytest.mark.parametrize(
    ('timeout', 'steps'), [(0.003, 3), (0.0031, 4), (1e-9, 1), (0.1 + 0.2 - 0.297, 3)]
)
def test_a_wrench_with_a_timeout_acts_for_so_much_simulated_time(timeout, steps):
    engine, on = made(**PUSHED, external_wrench_timeout=timeout), wrench(TIP, (0.0, 3.0, 0.0))
    assert pushes(engine, on) == [True] * steps + [False] * (10 - steps)
    # The timeout counts for the wrenches that come after it.
    changed = change(external_wrench_timeout=0.0)
    assert pushes(engine, on, changed) == [True] * steps + [False] * (10 - steps)
    assert pushes(engine, on) == [True] * 10


BODY = {'payload_mass': 2.5, 'payload_center': CENTER, 'payload_inertia': INERTIA}


def test_the_payload_in_use_is_told_with_the_first_state_it_acts_on():
    engine = made(**BODY)

    def news(*messages):
        produced, _ = engine.step(messages)
        bodies = [decode_numbers(m.data, INERTIA_TYPE) for m in produced if 'in_use' in m.role]
        assert all(body.frame_id == TIP for body in bodies)
        return [(body.stamp_ns // STEP_NS, body.values[0]) for body in bodies]

    assert news() == [(1, 2.5)]
    assert news() == []
    assert news(change(real_time_factor=0.5), change(payload_mass=2.5)) == []
    assert news(change(payload_mass=1.0), payload(TIP, 3.0)) == [(4, 3.0)]
    assert news(payload(TIP, 0.0)) == [(5, 0.0)]
    assert engine.plant.scene.payload is None


def test_only_the_first_of_many_payloads_compiles_code(emitted):
    outputs = ('acceleration', 'inertia_matrix', 'gravity_torques', 'energy', 'tip_pose')
    engine = made(**START, outputs=outputs)
    state(engine, payload(TIP, 1.0), change(gravity_compensation=True))
    state(engine, change(gravity_compensation=False))
    native = len(emitted)
    for k in range(100):
        body = payload(TIP, 0.01 * k, (0.1, 0.001 * k, 0.0), INERTIA)
        compensated = change(gravity_compensation=bool(k % 2))
        assert state(engine, body, compensated).stamp_ns == (k + 3) * STEP_NS
    assert len(emitted) == native
    assert engine.plant.scene.payload.mass == 0.99


def test_a_change_that_was_prepared_compiles_nothing_and_has_had_no_effect(emitted):
    engine, message = made(**START), payload(TIP, 1.25, CENTER)
    before = engine.save()
    engine.prepare(message.role, message.data)
    engine.prepare('payload', b'no message')
    assert same(before, engine.save())
    native = len(emitted)
    assert verdict(engine, message).accepted
    assert len(emitted) == native


def test_gravity_compensation_holds_the_robot_and_not_its_payload():
    engine = made(**START)
    held = state(engine, efforts(0.0, 0.0), change(gravity_compensation=True), cycles=500)
    np.testing.assert_allclose(held.position, (0.3, -0.2), rtol=0, atol=1e-12)
    assert np.abs(state(engine, payload(TIP, 1.0), cycles=50).velocity).max() > 0.1
    engine.step([payload(TIP, 0.0), change(gravity_compensation=False)])
    assert engine.plant.scene == made().plant.scene


def test_friction_stops_and_motor_lag_continue_with_a_new_payload():
    chosen = {'joint_friction': (0.3, 0.1), 'motor_lag': (0.05, 0.0), 'joint_limits': True}
    engine = made(**chosen, **START)
    state(engine, efforts(4.0, 1.0), cycles=40)
    lagging = engine.state.simulation.arrays['tau_motor'].copy()
    assert 0.5 < lagging[0] < 3.5
    assert verdict(engine, payload(TIP, 1.5)).accepted
    assert engine.state.simulation.arrays['tau_motor'].tolist() == lagging.tolist()


# The scene of the settings.

SCENE = pfd.Scene(
    damping=(0.5, 0.2),
    armature=(0.1, 0.1),
    effort_limits=(3.0, 1.0),
    gravity_compensation=True,
    payload=pfd.Payload(0.5, (0.1, 0.0, 0.0)),
    friction=(0.3, 0.1),
    static_friction=(0.4, 0.1),
    joint_limits=((-0.02, 2.0), (-2.0, 2.0)),
    restitution=(0.5, 0.5),
    motor_lag=(0.002, 0.0),
)


def test_settings_keep_the_content_of_a_scene_file(tmp_path):
    path, text = tmp_path / 'scene.yaml', pfd.scene_to_yaml(SCENE)
    path.write_text('# by hand\n' + text)
    settings = with_scene_text(Settings(robot='planar2', scene=str(path)))
    assert settings.scene == text
    path.unlink()
    assert with_scene_text(settings) == settings
    engine, braked = made(scene=text, substeps=3), pfd.Scene(**{**vars(SCENE), 'brakes': True})
    assert engine.plant.scene.digest == braked.digest
    wanted = pfd.Simulator(pfd.load_robot('planar2'), braked, substeps=3)
    for _ in range(20):
        wanted.step([2.0, 5.0])
    assert state(engine, efforts(2.0, 5.0), cycles=20).position.tobytes() == wanted.q.tobytes()


def test_changes_replace_the_effects_of_a_scene_file():
    heavy = pfd.Payload(2.0, (0.1, 0.0, 0.0))
    scene = pfd.Scene(payload=heavy, gravity_compensation=True, damping=(0.5, 0.2))
    engine = made(scene=pfd.scene_to_yaml(scene))
    assert engine.plant.scene.payload == heavy
    engine.step([change(payload_mass=1.0)])
    assert engine.plant.scene.payload == pfd.Payload(1.0, (0.1, 0.0, 0.0))
    assert engine.plant.scene.gravity_compensation
    engine.step([change(payload_mass=0.0, gravity_compensation=False)])
    assert engine.plant.scene == pfd.Scene(damping=(0.5, 0.2), brakes=True)


def test_the_numbers_of_each_joint_make_the_scene_of_the_table_of_effects():
    order = np.array([1, 0])
    wanted, settings = {}, {}
    for effect in JOINT_EFFECTS:
        names = list(joint_settings(effect))
        if names:
            wanted[effect.field] = np.array(effect_example(effect, 2))
            columns = wanted[effect.field].reshape(2, -1).T
            for name, column in zip(names, columns, strict=True):
                settings[name] = tuple(column[order].tolist())
    found = scene_of(Settings(robot='planar2', **settings), order)
    assert found == pfd.Scene(**wanted, brakes=True)
    assert pfd.load_scene(pfd.scene_to_yaml(found)) == found


@pytest.mark.parametrize(
    ('wrong', 'text'),
    [
        ({'scene': '/etc/passwd'}, "scene is '/etc/passwd', expected the YAML of a scene"),
        ({'scene': 'damping: [1, 2, 3]\n'}, "has 3 numbers, but 'planar2' has 2 joints"),
        ({'scene': 'damping: 5\n'}, 'damping must be None'),
        ({'scene': 'payload: input\n'}, "'input', expected a table"),
        ({'joint_damping': (1.0, 2.0, 3.0)}, 'damping holds 3 numbers, expected 2, one for each'),
        ({'bias_effort': (1.0,)}, r'bias\.effort holds 1 numbers, expected 2'),
        ({'joints': ('shoulder', 'wrist')}, r"joints is \['shoulder', 'wrist'\], expected each"),
        ({'joints': ('shoulder',) * 2}, 'expected each joint of .* once'),
        ({'joints': ('x' * 9999,) * 1000}, '9999 characters.*and 992 more'),
        ({'initial_positions': (0.0,)}, 'initial_positions holds 1 numbers, expected 2'),
        ({'robot': 'r2d2'}, 'r2d2'),
        ({'robot': ''}, 'robot is empty'),
        ({'tip_link': 'nowhere'}, 'nowhere'),
        ({'locked': ('{0}',)}, r'\{0\}'),
        ({'start_time': -1.0}, 'only a node knows'),
        *(
            ({'on_timeout': 'hold', **gains}, "'hold', expected servo_p above 0")
            for gains in ({}, {'servo_p': (1.0, 0.0)}, {'servo_d': (1.0, 1.0)})
        ),
    ],
)
def test_settings_that_do_not_go_with_the_robot_are_refused(wrong, text):
    with pytest.raises(ValueError, match=text):
        made(**wrong)
