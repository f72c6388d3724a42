# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Payload, gravity compensation and numbers for each joint: the plant of the settings."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

from bridge import (
    PAYLOAD_IN_USE,
    Arrival,
    Engine,
    MassKernels,
    Settings,
    Source,
    Verdict,
    decode_inertia,
    encode_inertia,
    encode_state,
    joint_values,
    load_arm_robot,
    read_motion,
    read_recording,
    scene_of,
)
import numpy as np
import pinocchio as pin
from plant_messages import UNLIMITED, change, efforts, made, payload, validated
import pytest
from ros_processes import example_robot
from simulating import rows_of, simulate

import pfd_core as pfd

PUSH = Source.ARRAY, efforts(1.0, -0.5)
TIP = 'tip_link'
CENTER, INERTIA = (0.1, -0.02, 0.05), (0.02, 0.001, -0.002, 0.03, 0.003, 0.025)
# Twenty steps of numbers below ten, in another order of operations.
ROUNDING = 1e-13
BODY = {'payload_mass': 2.5, 'payload_center': CENTER, 'payload_inertia': INERTIA}


def moving(**chosen) -> Engine:
    """Return an engine whose arm has moved for a while."""
    engine = made(**{'initial_positions': (0.3, -0.2), **chosen})
    validated(engine, PUSH)
    for _ in range(50):
        engine.step()
    return engine


def bits(engine: Engine) -> bytes:
    return engine.arm.q.tobytes() + engine.arm.qd.tobytes()


def test_a_payload_at_run_time_acts_as_a_payload_from_the_start() -> None:
    engine, other = moving(), made(**BODY)
    before = bits(engine)
    assert validated(engine, payload(TIP, 2.5, CENTER, INERTIA)).verdict is Verdict.ACCEPTED
    assert bits(engine) == before
    assert engine.arm.scene == other.arm.scene
    names, q, qd = engine.arm.names, engine.arm.q, engine.arm.qd
    validated(other, (Source.SET_STATE, encode_state(names, q, qd)))
    other.step()
    validated(other, PUSH)
    unloaded = moving()
    for one in (engine, other, unloaded):
        for _ in range(20):
            one.step()
    # The one is an input of the compiled step, the other a constant.
    np.testing.assert_allclose(engine.arm.q, other.arm.q, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(engine.arm.qd, other.arm.qd, rtol=0, atol=ROUNDING)
    assert np.abs(engine.arm.qd - unloaded.arm.qd).max() > 1e-3


def test_a_payload_in_a_carried_frame_moves_the_arm_as_in_pinocchio() -> None:
    path = str(example_robot('ur_description/urdf/ur5_robot.urdf'))
    tau = (1.0, -60.0, -5.0, 0.3, -0.2, 0.1)
    engine = made(robot=path, initial_positions=(0.3, -1.2, 0.9, 0.4, -0.7, 1.1), step_size=1e-4)
    message = payload('tool0', 2.5, CENTER, INERTIA)
    assert validated(engine, (Source.ARRAY, efforts(*tau)), message).verdict is Verdict.ACCEPTED
    for _ in range(200):
        engine.step()
    model = pin.buildModelFromUrdf(path)
    place = model.frames[model.getFrameId('tool0')]
    xx, xy, xz, yy, yz, zz = INERTIA
    body = pin.Inertia(2.5, np.array(CENTER), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    arm = engine.arm
    without = pin.aba(model, model.createData(), arm.q, arm.qd, np.array(tau))
    model.appendBodyToJoint(place.parentJoint, body, place.placement)
    wanted = pin.aba(model, model.createData(), arm.q, arm.qd, np.array(tau))
    assert np.abs(wanted - without).max() > 0.1
    np.testing.assert_allclose(arm.acceleration, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize(
    ('values', 'verdict', 'reason'),
    [
        ({'payload_mass': -1.0}, Verdict.REFUSED, 'payload.mass is -1.0'),
        ({'payload_mass': float('nan')}, Verdict.REFUSED, 'payload.mass holds nan'),
        ({'payload_mass': 1e300}, Verdict.REFUSED, 'payload.mass is 1e+300'),
        ({'payload_mass': 1.0, 'payload_center': [0.0, 0.0]}, Verdict.REFUSED, 'needs 3 numbers'),
        (
            {'payload_mass': 1.0, 'payload_inertia': [1.0, 0.0, 0.0, -1.0, 0.0, 1.0]},
            Verdict.REFUSED,
            'must not be negative in any direction',
        ),
        (
            {'payload_mass': 1.0, 'payload_inertia': [1.0, 0.0, 0.0, 1.0, 0.0, 3.0]},
            Verdict.REFUSED,
            'payload.inertia is not physically consistent',
        ),
        ({'payload_inertia': [0.0] * 10_000}, Verdict.MALFORMED, 'holds 10000 values'),
    ],
    ids=lambda value: str(value)[:40],
)
def test_a_payload_that_is_no_body_is_refused_with_the_reason(
    values: dict, verdict: Verdict, reason: str
) -> None:
    engine = moving()
    scene = engine.arm.scene
    found = validated(engine, change(**values))
    assert found.verdict is verdict
    assert reason in found.detail
    assert engine.arm.scene is scene


@pytest.mark.parametrize(
    ('message', 'verdict', 'reason'),
    [
        (payload('base_link', 1.0), Verdict.UNKNOWN_NAMES, 'does not move with the last link'),
        (payload(TIP, np.inf), Verdict.REFUSED, 'payload.mass holds inf'),
        (payload(TIP, 1.0, (np.nan, 0.0, 0.0)), Verdict.REFUSED, 'payload.center holds nan'),
        (payload(TIP, 1.0, inertia=[0.0, 1.0, 0.0, 0.0, 0.0, 0.0]), Verdict.REFUSED, 'negative'),
        ((Source.PAYLOAD, b'\0\1\0\0'), Verdict.MALFORMED, 'message ends'),
    ],
    ids=lambda value: str(value)[:40],
)
def test_a_wrong_payload_message_is_refused_with_the_reason(message, verdict, reason) -> None:
    found = validated(made(), message)
    assert found.verdict is verdict
    assert reason in found.detail


def test_the_payload_in_use_is_published_with_the_first_state_it_acts_on() -> None:
    engine = made(**BODY)

    def told() -> list[tuple[int, float]]:
        found = [output for output in engine.step() if output.role == PAYLOAD_IN_USE]
        messages = [decode_inertia(output.data) for output in found]
        assert all(message.frame_id == TIP for message in messages)
        return [(message.stamp_ns // 1_000_000, message.mass) for message in messages]

    assert told() == [(1, 2.5)]
    assert told() == []
    validated(engine, change(real_time_factor=0.5), change(payload_mass=2.5))
    assert told() == []
    validated(engine, change(payload_mass=1.0), payload(TIP, 3.0))
    assert told() == [(4, 3.0)]
    validated(engine, payload(TIP, 0.0))
    assert engine.arm.scene.payload is None
    assert told() == [(5, 0.0)]


def test_gravity_compensation_holds_the_robot_and_not_its_payload() -> None:
    engine = made(initial_positions=(0.3, -0.2))
    validated(engine, (Source.ARRAY, efforts(0.0, 0.0)), change(gravity_compensation=True))
    for _ in range(500):
        engine.step()
    np.testing.assert_allclose(engine.arm.q, (0.3, -0.2), rtol=0, atol=1e-12)
    validated(engine, payload(TIP, 1.0))
    for _ in range(50):
        engine.step()
    assert np.abs(engine.arm.qd).max() > 0.1
    validated(engine, payload(TIP, 0.0), change(gravity_compensation=False))
    assert engine.arm.scene == made().arm.scene


def test_changes_replace_the_effects_of_a_scene_file() -> None:
    heavy = pfd.Payload(2.0, (0.1, 0.0, 0.0))
    scene = pfd.Scene(payload=heavy, gravity_compensation=True, damping=(0.5, 0.2))
    engine = moving(scene=pfd.scene_to_yaml(scene))
    assert engine.arm.scene.payload == heavy
    validated(engine, change(payload_mass=1.0))
    assert engine.arm.scene.payload == pfd.Payload(1.0, (0.1, 0.0, 0.0))
    assert engine.arm.scene.gravity_compensation
    validated(engine, change(payload_mass=0.0, gravity_compensation=False))
    assert engine.arm.scene == pfd.Scene(damping=(0.5, 0.2), brakes=True)


def test_only_the_first_of_many_payloads_compiles_code(emitted: list[str]) -> None:
    outputs = ('acceleration', 'inertia_matrix', 'gravity_torques', 'energy', 'tip_pose')
    engine = moving(outputs=outputs)
    validated(engine, payload(TIP, 1.0), change(gravity_compensation=True))
    validated(engine, change(gravity_compensation=False))
    native = len(emitted)
    for k in range(100):
        validated(engine, payload(TIP, 0.01 * k, (0.1, 0.001 * k, 0.0), INERTIA))
        validated(engine, change(gravity_compensation=bool(k % 2)))
        engine.step()
    assert len(emitted) == native
    assert engine.arm.scene.payload.mass == 0.99


def test_outputs_and_diagnostics_see_a_payload_that_is_an_input() -> None:
    outputs = ('inertia_matrix', 'bias_torques', 'gravity_torques', 'energy', 'acceleration')
    engine, other = moving(outputs=outputs), moving(outputs=outputs, payload_changes='constant')
    masses = MassKernels(engine.arm)
    published = []
    for one in (engine, other):
        validated(one, payload(TIP, 2.5, CENTER, INERTIA))
        published.append({role: data for role, _, data in one.step()})
    for name in ('inertia_matrix', 'bias_torques', 'gravity_torques', 'energy', 'acceleration'):
        found, wanted = (one[name] for one in published)
        size = 8 * (4 if name == 'inertia_matrix' else 2)
        a, b = (np.frombuffer(data[-size:]) for data in (found, wanted))
        np.testing.assert_allclose(a, b, rtol=1e-12, err_msg=name)
    assert masses.scene is not engine.arm.plant.compiled.scene
    masses = MassKernels(engine.arm)
    wanted = MassKernels(other.arm)
    given = engine.arm.plant.payload_input
    q = engine.arm.q
    np.testing.assert_allclose(masses.inertia(q, **given), wanted.inertia(q), rtol=1e-12)
    assert 0 < masses.error_estimate(q, q, q, given) < 1e-12


def test_a_method_that_takes_no_payload_as_an_input_compiles_it_as_a_constant() -> None:
    engine = moving(method='pcrbm')
    assert engine.settings.payload_changes == 'constant'
    assert validated(engine, payload(TIP, 1.0)).verdict is Verdict.ACCEPTED
    with pytest.raises(ValueError, match="'input', but pcrbm takes no payload as an input"):
        made(method='pcrbm', payload_changes='input')


def test_a_scene_file_gives_the_node_a_payload_of_numbers() -> None:
    with pytest.raises(ValueError, match="payload of the scene is 'input', expected a table"):
        made(scene=pfd.scene_to_yaml(pfd.Scene(payload='input')))


def test_a_recording_with_payloads_verifies(tmp_path: Path) -> None:
    events = {
        2: [efforts(1.0, 2.0), payload(TIP, 1.5, (0.1, 0.0, 0.0))],
        9: [payload(TIP, -1.0), change(gravity_compensation=True)],
        15: [change(payload_mass=0.5), payload(TIP, 0.25)],
        20: [payload(TIP, 0.0)],
    }
    made = simulate(30, events, initial_positions=(0.3, -0.2), publish_rate=500.0, **BODY)
    path = made.save(tmp_path / 'a.mcap')
    assert read_recording(path, verify=True).complete
    verdicts = [row.verdict for row in rows_of(path) if row.source is Source.PAYLOAD]
    assert [verdict.name for verdict in verdicts] == ['ACCEPTED', 'REFUSED', *['ACCEPTED'] * 2]
    told = [decode_inertia(sent.data).mass for sent in made.on('/sim_arm/payload_in_use')]
    assert told == [2.5, 1.5, 0.25, 0.0]
    with pytest.raises(ValueError, match='payload or gravity compensation changes before step 2'):
        read_motion(path)
    second = made.on('/sim_arm/payload_in_use')[1]
    second.data = encode_inertia(replace(decode_inertia(second.data), mass=1.25))
    made.recount()
    with pytest.raises(ValueError, match='step 2: payload_in_use: mass: recorded'):
        read_recording(made.save(tmp_path / 'b.mcap'), verify=True)


def test_a_failed_arm_rejects_a_payload_with_the_reason(tmp_path: Path) -> None:
    events = {2: [efforts(1e308, 1e308)], 9: [payload(TIP, 1.0)]}
    made = simulate(20, events, **UNLIMITED)
    path = made.save(tmp_path / 'a.mcap')
    summary = read_recording(path, verify=True)
    assert summary.failure
    (row,) = (row for row in rows_of(path) if row.source is Source.PAYLOAD)
    assert row.verdict is Verdict.REFUSED


def test_numbers_for_each_joint_in_published_order_override_the_model() -> None:
    chosen = Settings(robot='planar2', joints=('elbow', 'shoulder'), joint_damping=(0.5, 0.25))
    robot = load_arm_robot(chosen)
    engine = Engine(chosen, robot)
    assert engine.arm.scene.damping == (0.25, 0.5)
    assert engine.arm.names == ('elbow', 'shoulder')
    with pytest.raises(ValueError, match='damping holds 3 numbers, expected 2, one for each'):
        made(joint_damping=(1.0, 2.0, 3.0))
    with pytest.raises(ValueError, match=r'armature is -1\.0, expected 0\.0 to'):
        made(joint_armature=(-1.0, 2.0))


def test_the_default_of_a_number_for_each_joint_is_the_one_in_use() -> None:
    path = str(example_robot('panda_description/urdf/panda.urdf'))
    chosen = {'robot': path, 'locked': ('panda_finger_joint1', 'panda_finger_joint2')}
    (field,) = (f for f in fields(Settings) if f.name == 'joint_damping')
    for switch in (False, True):
        settings = Settings(**chosen, damping=switch)
        robot = load_arm_robot(settings)
        order = tuple(reversed(range(robot.n)))
        found = joint_values(field, settings, robot, order)
        assert found == tuple((robot.damping * switch)[::-1].tolist())
    assert any(found)


def test_every_effect_of_the_settings_is_in_the_scene() -> None:
    settings = Settings(
        robot='puma560',
        friction=True,
        joint_limits=True,
        restitution=0.5,
        joint_armature=(0.1,) * 6,
        motor_lag=(0.0, 0.01, 0.0, 0.0, 0.0, 0.0),
        gravity_compensation=True,
        external_wrench=True,
        payload_mass=1.0,
    )
    found = scene_of(settings, tuple(range(6)))
    assert found == pfd.Scene(
        friction='model',
        joint_limits='model',
        restitution=0.5,
        armature=(0.1,) * 6,
        motor_lag=(0.0, 0.01, 0.0, 0.0, 0.0, 0.0),
        gravity_compensation=True,
        external_wrench=True,
        payload=pfd.Payload(1.0),
        brakes=True,
    )
    assert made(joint_friction=(0.1, 0.2), joint_limits=True, motor_lag=(0.0, 0.01)).step()


def test_an_engine_without_effects_moves_as_a_plain_simulator() -> None:
    engine = made()
    wanted = pfd.Simulator(pfd.load_robot('planar2'), pfd.Scene(brakes=True))
    engine.take([Arrival(Source.ARRAY, 1, efforts(1.0, 0.5))])
    for _ in range(20):
        engine.step()
        wanted.step([1.0, 0.5], brakes=np.zeros(2, bool))
    assert engine.arm.q.tobytes() == wanted.q.tobytes()


def test_friction_stops_and_motor_lag_continue_with_a_new_payload(tmp_path: Path) -> None:
    events = {1: [efforts(4.0, 1.0)], 40: [payload(TIP, 1.5, (0.1, 0.0, 0.0))]}
    chosen = {
        'joint_friction': (0.3, 0.1),
        'motor_lag': (0.05, 0.0),
        'joint_limits': True,
        'initial_positions': (0.3, -0.2),
    }
    path = simulate(80, events, **chosen).save(tmp_path / 'a.mcap')
    assert read_recording(path, verify=True).complete
    engine = made(**chosen)
    validated(engine, (Source.ARRAY, efforts(4.0, 1.0)))
    for _ in range(40):
        engine.step()
    lagging = engine.state.simulation.arrays['tau_motor'].copy()
    assert 0.5 < lagging[0] < 3.5
    validated(engine, payload(TIP, 1.5))
    assert engine.state.simulation.arrays['tau_motor'].tolist() == lagging.tolist()
