# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Outputs other than joint_states: their values against Pinocchio, and their recordings."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from bridge import (
    ARM_OUTPUTS,
    CLOCK_INPUT,
    FLOAT_ARRAY_TYPE,
    JOINT_STATE_TYPE,
    STATES_OUTPUT,
    ArmOutput,
    Arrival,
    DifferenceError,
    Engine,
    LogError,
    Settings,
    Source,
    decode_array,
    decode_joint_state,
    decode_stamped,
    load_arm_robot,
    position_and_quaternion,
    read_recording,
)
import numpy as np
from oracle import Oracle
import pinocchio as pin
import plant_messages
from plant_messages import UNLIMITED, change, efforts, validated, wrench
import pytest
from rewriting import Recording
from simulating import simulate

import pfd_core as pfd

ALL = tuple(ARM_OUTPUTS)
# Not that of the model.
_FIRST = ('wrist_1_joint', 'shoulder_pan_joint', 'elbow_joint')
ORDER = (*_FIRST, 'wrist_3_joint', 'shoulder_lift_joint', 'wrist_2_joint')
START = (0.3, -1.2, 1.4, -0.6, 1.2, 0.3)
TORQUES = (1.0, 2.0, -3.0, 0.5, -4.0, 0.25)


made = functools.partial(
    plant_messages.made,
    robot='ur5',
    joints=ORDER,
    initial_positions=START,
    outputs=ALL,
    armature=True,
)


PLANAR = {'robot': 'planar2', 'joints': (), 'initial_positions': (), 'armature': False}


def moved(engine: Engine, steps: int = 100) -> dict[str, bytes]:
    """Return the last outputs by role of an arm under torques, from its first step on."""
    engine.take([Arrival(Source.ARRAY, 1, efforts(*TORQUES))])
    for _ in range(steps):
        found = engine.step()
    return {output.role: output.data for output in found}


def decoded(role: str, data: bytes) -> np.ndarray:
    """Return the numbers of an output."""
    kind = ARM_OUTPUTS[role].type
    if kind == FLOAT_ARRAY_TYPE:
        array = decode_array(data)
        return array.values.reshape(array.sizes)
    if kind == JOINT_STATE_TYPE:
        return decode_joint_state(data).effort
    return decode_stamped(data, kind).values


class Expected:
    """Pinocchio's numbers for the state of an engine, in model order."""

    def __init__(self, engine: Engine) -> None:
        self.robot = robot = load_arm_robot(engine.settings)
        self.order = list(engine.arm.order)
        self.q, self.qd, self.tau = engine.arm.q, engine.arm.qd, engine.arm.tau
        self.oracle = Oracle(robot, robot.armature)

    def jacobian(self) -> np.ndarray:
        model, data = self.oracle.model, self.oracle.data
        tip = model.nframes - 1
        return pin.computeFrameJacobian(model, data, self.q, tip, pin.LOCAL_WORLD_ALIGNED)

    def pose(self) -> pin.SE3:
        model, data = self.oracle.model, self.oracle.data
        pin.framesForwardKinematics(model, data, self.q)
        return data.oMf[model.nframes - 1]


def test_the_model_quantities_of_the_true_state_equal_pinocchio() -> None:
    engine = made()
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
    placement = expected.pose()
    pose = decoded('tip_pose', found['tip_pose'])
    np.testing.assert_allclose(pose[:3], placement.translation, atol=1e-12)
    np.testing.assert_allclose(pin.Quaternion(pose[3:]).matrix(), placement.rotation, atol=1e-12)


def test_torques_come_as_joint_states_and_as_plain_arrays() -> None:
    names = ('external_torques', 'bias_torques', 'gravity_torques')
    both = (*names, *(f'{name}_array' for name in names))
    engine = made(external_wrench=True, outputs=both)
    validated(engine, wrench('tool0', [3.0, -2.0, 10.0], [0.1, 0.2, -0.3]))
    found = moved(engine)
    for name in names:
        plain = decode_array(found[f'{name}_array'])
        assert plain.sizes == (6,)
        assert plain.values.tolist() == decoded(name, found[name]).tolist()
        assert np.abs(plain.values).max() > 0


def test_the_outputs_fulfil_the_equation_of_motion_with_a_wrench_on_the_tip() -> None:
    engine = made(joint_damping=(0.1,) * 6, external_wrench=True)
    k = [3.0, -2.0, 10.0, 0.1, 0.2, -0.3]
    validated(engine, wrench('tool0', k[:3], k[3:]))
    found = moved(engine)
    expected = Expected(engine)
    base = np.concatenate([expected.pose().rotation @ half for half in np.split(np.array(k), 2)])
    torques = decoded('external_torques', found['external_torques'])
    np.testing.assert_allclose(torques, expected.jacobian()[:, expected.order].T @ base)
    assert decoded('tip_wrench', found['tip_wrench']).tolist() == k
    inertia, qdd, bias = (
        decoded(role, found[role]) for role in ('inertia_matrix', 'acceleration', 'bias_torques')
    )
    np.testing.assert_allclose(
        inertia @ qdd + bias, engine.arm.tau[expected.order] + torques, atol=1e-9
    )


def test_a_payload_that_comes_while_the_arm_runs_is_in_the_model_from_the_next_cycle_on() -> None:
    engine, loaded = made(), made(payload_mass=2.0, payload_center=(0.0, 0.0, 0.1))
    before = moved(engine)
    moved(loaded)
    validated(engine, change(payload_mass=2.0, payload_center=[0.0, 0.0, 0.1]))
    after = {output.role: output.data for output in engine.step()}
    robot, scene = engine.arm.robot, pfd.Scene(armature='model', payload=engine.arm.scene.payload)
    q = Expected(engine).q
    order = list(engine.arm.order)
    for role, turned in (('inertia_matrix', np.ix_(order, order)), ('gravity_torques', order)):
        wanted = pfd.compile_kernel(robot, quantity=role, scene=scene)(q)[turned]
        # A payload that comes later is an input of the compiled code.
        np.testing.assert_allclose(decoded(role, after[role]), wanted, rtol=0, atol=1e-13)
        assert np.abs(decoded(role, after[role]) - decoded(role, before[role])).max() > 0.1


def test_compensated_gravity_is_no_part_of_the_model_and_dry_friction_is_left_out() -> None:
    numbers = []
    for compensated in (False, True):
        dry = {'joint_friction': (0.1,) * 6, 'motor_lag': (0.01,) * 6}
        engine = made(gravity_compensation=compensated, **dry)
        found = {output.role: output.data for output in engine.step()}
        numbers.append([found[role] for role in ('gravity_torques', 'bias_torques', 'energy')])
    assert numbers[0] == numbers[1]


def test_layouts_and_headers_name_joints_axes_and_frames() -> None:
    found = moved(made(frame_id='room'), 1)
    joints = ','.join(ORDER)
    layouts = {
        'acceleration': (f'joint: {joints}',),
        'inertia_matrix': (f'row: {joints}', f'column: {joints}'),
        'tip_jacobian': ('row: vx,vy,vz,wx,wy,wz', f'column: {joints}'),
        'energy': ('item: kinetic,potential,power',),
    }
    for role, labels in layouts.items():
        assert decode_array(found[role]).labels == labels
    stamp = decode_joint_state(found[STATES_OUTPUT]).stamp_ns
    for role in ('true_states', 'external_torques', 'bias_torques', 'gravity_torques'):
        message = decode_joint_state(found[role])
        assert (message.stamp_ns, message.frame_id, message.names) == (stamp, 'room', ORDER)
    for role, frame in (('tip_pose', 'base_link'), ('tip_wrench', 'tool0')):
        stamped = decode_stamped(found[role], ARM_OUTPUTS[role].type)
        assert (stamped.stamp_ns, stamped.frame_id) == (stamp, frame)


def test_outputs_describe_the_true_state_and_not_the_measured_one() -> None:
    exact, measured = made(), made(noise_position=1.0, delay_state=0.01, drop_state=0.5)
    one, other = moved(exact), moved(measured)
    for role in ALL:
        assert one[role] == other[role], role
    assert one['true_states'] == one[STATES_OUTPUT]


def test_true_states_have_the_welded_joints_that_joint_states_have() -> None:
    welded = {'robot': 'puma560', 'joints': (), 'initial_positions': (0.1, 0.2, 0.3, 0.4)}
    locked = {'locked': ('joint6', 'joint5'), 'locked_positions': (0.25, -0.5)}
    for published in (True, False):
        engine = made(**welded, **locked, publish_locked=published, outputs=('true_states',))
        found = {output.role: output.data for output in engine.step()}
        assert found['true_states'] == found[STATES_OUTPUT]


def test_outputs_come_between_state_and_tick_with_the_number_of_the_state() -> None:
    engine = made(**PLANAR, publish_rate=200.0)
    found = [output for _ in range(20) for output in engine.step()]
    beside = [(output.role, output.number) for output in found if output.role != CLOCK_INPUT]
    assert beside == [(role, number) for number in (1, 2, 3, 4) for role in (STATES_OUTPUT, *ALL)]
    assert found[-1].role == CLOCK_INPUT
    again = [output.data for output in engine.present() if output.role in ALL]
    assert again == [output.data for output in found if output.role in ALL][-len(ALL) :]


def test_a_jump_and_a_failed_arm_have_no_acceleration_and_every_number_is_finite() -> None:
    engine = made(**PLANAR, **UNLIMITED)
    engine.take([Arrival(Source.ARRAY, 1, efforts(1e300, -1e300))])
    for _ in range(20):
        found: list[ArmOutput] = engine.step()
    assert engine.arm.failure
    outputs = {output.role: output.data for output in found}
    assert not decoded('acceleration', outputs['acceleration']).any()
    for role in ALL:
        assert np.isfinite(decoded(role, outputs[role])).all()


@pytest.mark.parametrize('turn', [0.0, 0.5, 2.0, 3.0, np.pi, 4.0])
@pytest.mark.parametrize('axis', [(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 2, 3), (1, -1, 0)])
def test_quaternions_have_unit_length_a_positive_w_and_turn_as_the_matrix(
    turn: float, axis: tuple[float, ...]
) -> None:
    unit = np.array(axis) / np.linalg.norm(axis)
    pose = np.eye(4)
    pose[:3, :3] = pin.AngleAxis(turn, unit).matrix()
    x, y, z, w = position_and_quaternion(pose)[3:]
    assert w >= 0
    assert abs(x * x + y * y + z * z + w * w - 1) < 1e-15
    np.testing.assert_allclose(pin.Quaternion(w, x, y, z).matrix(), pose[:3, :3], atol=1e-15)


@pytest.mark.parametrize(
    ('wrong', 'text'),
    [
        (('colour',), r"outputs is 'colour', expected one of \['true_states'"),
        (('energy', 'energy'), 'outputs has duplicates'),
    ],
)
def test_outputs_that_there_are_not_are_refused(wrong: tuple[str, ...], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Settings(outputs=wrong)


# In recordings.


def recorded(**chosen: Any) -> Recording:
    return simulate(60, {5: [efforts(1.0, -0.5)]}, **{'outputs': ALL, **chosen})


@pytest.fixture(scope='module')
def usual() -> Recording:
    return recorded()


@pytest.mark.parametrize('closed', [True, False], ids=['closed', 'cut-off'])
@pytest.mark.parametrize('sensors', [{}, {'drop_state': 0.3, 'noise_position': 0.1}])
def test_a_recording_with_every_output_verifies(
    tmp_path: Path, closed: bool, sensors: dict[str, float]
) -> None:
    summary = read_recording(
        recorded(**sensors).save(tmp_path / 'log.mcap', closed=closed), verify=True
    )
    assert summary.states + summary.unpublished == 60
    assert not summary.lost


@pytest.mark.parametrize(
    ('role', 'place'),
    [
        ('true_states', "joint 'elbow', effort"),
        ('acceleration', 'joint elbow'),
        ('external_torques', "joint 'elbow', effort"),
        ('inertia_matrix', 'row elbow, column elbow'),
        ('bias_torques', "joint 'elbow', effort"),
        ('gravity_torques', "joint 'elbow', effort"),
        ('tip_jacobian', 'row wz, column elbow'),
        ('tip_pose', 'qw'),
        ('tip_wrench', 'tz'),
        ('energy', 'item power'),
    ],
)
def test_one_changed_bit_of_an_output_is_found_with_its_element(
    usual: Recording, tmp_path: Path, role: str, place: str
) -> None:
    made = usual.copy()
    # The last bit of the lowest byte of the last number.
    made.on(f'/sim_arm/{role}')[29].flip(-8)
    made.recount()
    with pytest.raises(DifferenceError, match=f'step 30: {role}: {place}: recorded '):
        read_recording(made.save(tmp_path / 'log.mcap'), verify=True)


def test_an_output_that_is_no_such_message_is_a_difference(
    usual: Recording, tmp_path: Path
) -> None:
    made = usual.copy()
    sent = made.on('/sim_arm/tip_pose')[3]
    sent.data = sent.data[:-1]
    made.recount()
    with pytest.raises(DifferenceError, match=r'tip_pose: the recorded message: .* ends at byte'):
        read_recording(made.save(tmp_path / 'log.mcap'), verify=True)


def test_a_recording_needs_the_channels_of_its_outputs_and_no_others(tmp_path: Path) -> None:
    for outputs in ([], [*ALL[1:]]):
        made = recorded()
        made.edit('pfd_ros', 'settings', lambda s, new=outputs: {**s, 'outputs': new})
        with pytest.raises(LogError, match=r'outputs is .*, its topics are'):
            read_recording(made.save(tmp_path / 'log.mcap'))


def test_a_recording_with_a_wrench_and_a_new_payload_verifies(tmp_path: Path) -> None:
    events = {
        5: [efforts(1.0, -0.5)],
        20: [wrench('tip_link', (1.0, 2.0, 0.0), (0.0, 0.0, 1.0))],
        40: [change(payload_mass=0.5)],
    }
    made = simulate(60, events, outputs=ALL, external_wrench=True, noise_position=0.1)
    read_recording(made.save(tmp_path / 'log.mcap'), verify=True)
    torques = [decoded('external_torques', m.data) for m in made.on('/sim_arm/external_torques')]
    assert [bool(each.any()) for each in torques] == [False] * 19 + [True] * 41


def test_lost_arrays_need_no_stamp(tmp_path: Path) -> None:
    made = recorded()
    gone = made.on('/sim_arm/acceleration')[10:30]
    made.lose(gone)
    summary = read_recording(made.save(tmp_path / 'cut.mcap', closed=False), verify=True)
    assert summary.lost == {'acceleration': 20}


def test_lost_outputs_are_counted(tmp_path: Path) -> None:
    made = recorded()
    poses = made.on('/sim_arm/tip_pose')
    gone = poses[20:23] + poses[-5:]
    made.lose(gone)
    summary = read_recording(made.save(tmp_path / 'cut.mcap', closed=False), verify=True)
    # The last one may belong to a cycle that was cut off.
    assert summary.lost == {'tip_pose': 7}
    with pytest.raises(LogError, match='21 to 23 are missing'):
        read_recording(made.save(tmp_path / 'log.mcap'))
