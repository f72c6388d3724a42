# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Torque control as vendors document it: a test for each behaviour that the arm has."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from arm_messages import (
    INF,
    NAN,
    change,
    efforts,
    made,
    named,
    payload,
    placed,
    request,
    state,
    states,
    verdict,
    wrench,
)
import numpy as np
import pinocchio as pin
import pytest
from recordings import simulate
import yaml

import pfd_core as pfd
from pfd_ros import read_log
from pfd_ros.arm.conventions import CONVENTIONS
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Message as ArmMessage
from pfd_ros.arm.settings import FIELDS as SETTING_ROWS
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.joints import decode_joints
from pfd_ros.page.page import TYPES as PAGE_TYPES
from pfd_ros.page.page import page as page_of_log
from pfd_ros.replay.verify import verify as verify_log
from pfd_ros.replay.what_if import what_if
from pfd_ros.testing import LockstepArm, recorded

TABLE = yaml.load(
    (Path(__file__).parents[2] / 'docs/conventions.yaml').read_bytes(), yaml.CSafeLoader
)
ROBOTS = {'ur': 'ur5', 'franka': 'panda'}
BEHAVIOURS = {(name, row['name']): row for name in ROBOTS for row in TABLE[name]}
FIELDS = {row.field: row for row in SETTING_ROWS}
# Poses of the arm of a convention, inside of its limits.
POSES = {
    'ur': [(0.1, -1.2, 0.7, 0.3, 1.0, 0.0), (2.0, 0.4, -2.2, 5.0, -1.0, 3.0), (0.0,) * 6],
    'franka': [
        (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785),
        (1.0, 1.5, -2.0, -0.5, 2.0, 3.0, 0.0),
    ],
}
# An arm of two joints, which is compiled in a fraction of the time, with scales of its own.
SMALL: dict[str, dict[str, Any]] = {
    name: {
        'convention': name,
        'robot': 'planar2',
        'initial_positions': (0.3, -0.5),
        'viscous_scale': viscous,
        'coulomb_scale': coulomb,
    }
    for name, viscous, coulomb in (
        ('ur', (0.9, 0.8), (0.8, 0.7)),
        ('franka', (1.0, 1.0), (1.0, 1.0)),
    )
}
# Friction of joints, as much as an arm has.
VISCOUS, COULOMB = (12.0, 10.0, 8.0, 2.0, 2.0, 2.0, 1.0), (8.0, 8.0, 6.0, 2.0, 2.0, 2.0, 0.5)
covered: list[tuple[str, str]] = []
T = TypeVar('T', bound=Callable[..., None])


def of(convention: str, *names: str) -> Callable[[T], T]:
    """Note the behaviours that a test shows."""
    covered.extend((convention, name) for name in names)
    return lambda test: test


def arm(convention: str, **chosen: Any) -> Engine:
    """Return the engine of a convention's arm in its first pose."""
    start = POSES[convention][0]
    values = {'robot': ROBOTS[convention], 'initial_positions': start, 'armature': True}
    return made(**vars(Settings.from_values({'convention': convention, **values, **chosen})))


def small(convention: str, **chosen: Any) -> Engine:
    return made(**vars(Settings.from_values({**SMALL[convention], **chosen})))


def rubbing(convention: str, **chosen: Any) -> Engine:
    """Return such an arm with friction in its joints."""
    n = len(POSES[convention][0])
    return arm(convention, joint_damping=VISCOUS[:n], joint_friction=COULOMB[:n], **chosen)


def zeros(engine: Engine) -> ArmMessage:
    return efforts(*[0.0] * len(engine.names))


def commanded(engine: Engine, cycles: int, *tau: float) -> list[Any]:
    """Send a command in each of some cycles; return the published states."""
    command = efforts(*tau) if tau else zeros(engine)
    return [found for _ in range(cycles) for found in states(engine, command)]


def second(engine: Engine) -> int:
    return round(1.0 / engine.state.settings.step_size)


def gravity(engine: Engine, q: Sequence[float], load: tuple[float, Any] | None = None) -> Any:
    """Return the gravity torques of the arm by Pinocchio, with a mass at a point of the tip."""
    model = pin.buildModelFromXML(pfd.robot_to_urdf(engine.robot))
    if load is not None:
        mass, center = load
        frame = model.frames[model.getFrameId(engine.robot.tip)]
        body = pin.Inertia(mass, np.array(center), np.zeros((3, 3)))
        model.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    turned = pin.integrate(model, pin.neutral(model), np.array(q, float))
    return pin.computeGeneralizedGravity(model, model.createData(), turned)


def joint(engine: Engine, place: int, value: float) -> list[float]:
    return [value if k == place else 0.0 for k in range(len(engine.names))]


# ---- the table


def test_each_behaviour_that_is_not_missing_has_a_test():
    wanted = [key for key, row in BEHAVIOURS.items() if 'missing' not in row]
    assert sorted(covered) == sorted(wanted)
    assert len(wanted) >= 30


@pytest.mark.parametrize(('convention', 'name'), BEHAVIOURS)
def test_a_behaviour_names_its_document_and_settings_that_exist(convention, name):
    row = BEHAVIOURS[convention, name]
    document, colon, place = row['source'].partition(': ')
    assert document in TABLE['documents']
    assert all((colon, place, row['text']))
    assert ('missing' in row) != ('here' in row or 'settings' in row)


@pytest.mark.parametrize('convention', ROBOTS)
def test_each_default_of_a_convention_is_a_setting_that_one_behaviour_names(convention):
    row = CONVENTIONS[convention]
    told = [name for behaviour in TABLE[convention] for name in behaviour.get('settings', ())]
    assert sorted(told) == sorted([*row.values, *row.numbers])
    for field, value in row.values.items():
        assert type(value) is type(FIELDS[field].default), field
        assert not FIELDS[field].per_joint
    assert all(FIELDS[field].per_joint for field in row.numbers)
    assert all(field in FIELDS for field in row.errors)


# ---- settings


@pytest.mark.parametrize('convention', ROBOTS)
def test_a_convention_gives_defaults_and_what_is_given_has_precedence(convention):
    found = Settings.from_values({'convention': convention})
    values = CONVENTIONS[convention].values
    assert {name: getattr(found, name) for name in values} == values
    given = {'convention': convention, 'command_timeout': 0.0, 'step_size': 0.004}
    found = Settings.from_values(given)
    assert (found.command_timeout, found.step_size, found.on_timeout) == (0.0, 0.004, 'stop')
    # A recording holds all values: it needs no defaults.
    assert Settings.from_json(found.to_json()) == found
    assert Settings.from_values({'convention': 'plain'}) == Settings()


@pytest.mark.parametrize(
    ('chosen', 'expected'),
    [
        ({'convention': 'ur'}, 'has viscous_scale for 6 joints, but .* has 2: give viscous_scale'),
        ({'convention': 'abb'}, "convention is 'abb', expected one of"),
        ({'state_effort': 'current'}, 'expected torque_constant above 0 for every joint, N m/A'),
        ({'load_mass': 1.0}, 'load.mass is 1.0, but nothing compensates it'),
        ({'reflex_external_effort': (1.0, 0.0)}, 'given, but external_wrench is false'),
        ({'viscous_scale': (1.1, 0.0)}, 'viscous_scale is 1.1, expected 0.0 to 1.0'),
    ],
)
def test_settings_that_do_not_go_with_a_convention_name_what_is_needed(chosen, expected):
    with pytest.raises(ValueError, match=expected):
        made(joint_damping=(1.0, 1.0), **chosen)


def test_an_arm_of_another_size_has_the_scales_that_are_given_for_each_joint():
    given = {'shoulder': 0.25, 'elbow': 0.5}
    arm = LockstepArm('planar2', convention='ur', viscous_scale=given, coulomb_scale=given)
    assert arm.settings.viscous_scale == (0.25, 0.5)


# ---- gravity, payload, friction


@of('ur', 'gravity', 'zero torque')
@of('franka', 'gravity')
@pytest.mark.parametrize(('convention', 'pose'), [(c, pose) for c in POSES for pose in POSES[c]])
def test_without_effort_an_arm_with_all_friction_compensated_stays_at_rest(convention, pose):
    full = {'viscous_scale': (1.0,) * len(pose), 'coulomb_scale': (1.0,) * len(pose)}
    load = {'payload_mass': 1.5, 'load_mass': 1.5}
    engine = rubbing(convention, initial_positions=pose, **full, **load)
    found = commanded(engine, second(engine))
    assert not engine.state.tripped
    assert max(np.abs(each.velocity).max() for each in found) < 1e-6
    # Nothing brakes it: it would go on from a small velocity.
    engine.step([placed(engine.names, pose, joint(engine, 0, 0.01))])
    found = commanded(engine, second(engine) // 10)
    assert found[-1].velocity[0] == pytest.approx(0.01, rel=1e-2)


@of('ur', 'gravity vector')
def test_gravity_of_another_mounting_is_compensated():
    engine = small('ur', gravity=(9.81, 0.0, 0.0))
    found = commanded(engine, 200)
    assert found[-1].position.tolist() == [0.3, -0.5]


@of('ur', 'payload')
@of('franka', 'setLoad')
@pytest.mark.parametrize('convention', ROBOTS)
def test_a_payload_is_compensated_if_the_controller_knows_of_it(convention):
    engine, start = small(convention), (0.3, -0.5)
    engine.step([payload(engine.robot.tip, 1.5, (0.0, 0.0, 0.1))])
    assert np.abs(commanded(engine, 20)[-1].velocity).max() > 1e-2
    engine.step([placed(engine.names, start), change(load_mass=1.5, load_center=(0.0, 0.0, 0.1))])
    found = commanded(engine, 200)
    assert np.abs(found[-1].velocity).max() < 1e-9
    added = engine.plant.scene.gravity_compensation.payload
    assert (added.mass, added.center) == (1.5, (0.0, 0.0, 0.1))


@of('franka', 'end effector')
def test_a_gripper_of_the_model_is_compensated():
    engine = made(**vars(Settings.from_values({'convention': 'franka', 'robot': GRIPPER})))
    assert sum(engine.robot.masses) == pytest.approx(1.75)
    assert not np.any(commanded(engine, 200)[-1].velocity)


GRIPPER = """<robot name="held"><link name="base"/>
<link name="arm"><inertial><mass value="1"/><origin xyz="0.5 0 0"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="hand"><inertial><mass value="0.75"/><origin xyz="0.1 0 0"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="elbow" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="2" effort="80"/></joint>
<joint name="wrist" type="fixed"><parent link="arm"/><child link="hand"/>
<origin xyz="1 0 0"/></joint></robot>"""


@of('ur', 'viscous scale', 'Coulomb scale')
@of('franka', 'friction')
@pytest.mark.parametrize(
    ('convention', 'viscous', 'coulomb'),
    [
        ('ur', (0.9, 0.9, 0.8, 0.9, 0.9, 0.9), (0.8, 0.8, 0.7, 0.8, 0.8, 0.8)),
        ('franka', (1.0,) * 7, (1.0,) * 7),
    ],
)
def test_the_documented_share_of_friction_is_compensated(convention, viscous, coulomb):
    n = len(viscous)
    resting = tuple(1.5 * x for x in COULOMB[:n])
    engine = rubbing(convention, static_friction=resting)
    scene = engine.plant.scene
    for found, all_of, share in (
        (scene.damping, VISCOUS, viscous),
        (scene.friction, COULOMB, coulomb),
        (scene.static_friction, resting, coulomb),
    ):
        np.testing.assert_allclose(found, np.array(all_of[:n]) * (1.0 - np.array(share)))
    # In another order of joints each keeps its own.
    turned = arm(
        convention,
        joints=engine.names[::-1],
        initial_positions=POSES[convention][0][::-1],
        joint_damping=VISCOUS[:n][::-1],
        joint_friction=COULOMB[:n][::-1],
        static_friction=resting[::-1],
    )
    assert turned.plant.scene == scene
    # A scene file is treated in the same way.
    friction = {'damping': VISCOUS[:n], 'friction': COULOMB[:n], 'static_friction': resting}
    text = pfd.scene_to_yaml(pfd.Scene(armature='model', **friction))
    assert arm(convention, armature=False, scene=text).plant.scene == scene


def stopping(engine: Engine, cycles: int = 40) -> float:
    """Return the velocity of the first joint some cycles after 0.5 rad/s, without effort."""
    engine.step([placed(engine.names, (0.3, -0.5), joint(engine, 0, 0.5)), zeros(engine)])
    return float(commanded(engine, cycles)[-1].velocity[0])


@of('ur', 'no friction compensation', 'scales at run time', 'range of scales')
def test_scales_of_0_leave_all_friction_and_change_at_run_time():
    chosen = {'joint_damping': VISCOUS[3:5], 'joint_friction': COULOMB[3:5]}
    plain = made(gravity_compensation=True, **chosen)
    off = small('ur', viscous_scale=(0.0,) * 2, coulomb_scale=(0.0,) * 2, **chosen)
    assert off.plant.scene == plain.plant.scene
    usual = small('ur', **chosen)
    rates = [stopping(engine) for engine in (off, usual)]
    assert rates[0] < rates[1] < 0.5
    assert verdict(off, change(viscous_scale=[1.0] * 2, coulomb_scale=[1.0] * 2)).accepted
    assert not any(off.plant.scene.damping)
    assert stopping(off) > rates[1]
    wrong = verdict(off, change(coulomb_scale=[1.5] * 2))
    assert (wrong.label, 'coulomb_scale is 1.5, expected 0.0 to 1.0' in wrong.detail) == (
        'refused',
        True,
    )


# ---- time and commands


@of('ur', 'period')
@of('franka', 'period')
@pytest.mark.parametrize(('convention', 'rate'), [('ur', 500), ('franka', 1000)])
def test_a_command_acts_for_the_period_of_the_vendor(convention, rate):
    engine = arm(convention)
    first, then = commanded(engine, 2)
    assert then.stamp_ns - first.stamp_ns == 10**9 // rate
    # The integrator has steps of half a millisecond.
    settings = engine.state.settings
    assert settings.step_size / settings.substeps == 0.0005


@of('ur', 'before the first command')
def test_an_arm_is_held_until_its_first_command():
    engine = arm('ur')
    found = state(engine, cycles=500)
    assert (found.position.tolist(), any(found.velocity)) == (list(POSES['ur'][0]), False)
    assert not engine.state.tripped


@of('ur', 'repeated command', 'receive timeout', 'end of external control')
@of('franka', 'lost packets', 'twenty lost packets')
@pytest.mark.parametrize(
    ('convention', 'cycles', 'text'),
    [
        ('ur', 20, 'external control ended: no command for 0.04 s'),
        ('franka', 20, 'communication_constraints_violation: no command for 0.02 s'),
    ],
)
def test_the_last_effort_acts_until_too_many_commands_are_missing(convention, cycles, text):
    engine = arm(convention)
    effort = joint(engine, 0, 0.5)
    commanded(engine, 3, *effort)
    found = states(engine, cycles=cycles - 1)
    assert all(each.effort[0] == 0.5 for each in found)
    assert np.diff([each.velocity[0] for each in found]).min() > 0.0
    # One more command in time, and it goes on.
    commanded(engine, 1, *effort)
    assert states(engine, cycles=cycles - 1)[-1].effort[0] == 0.5
    stopped = state(engine)
    assert (engine.state.tripped, any(stopped.velocity)) == (text, False)
    assert verdict(engine, efforts(*effort)) == ('refused', text, ())
    assert engine.state.timeouts == engine.state.trips == 1


@of('ur', 'limit violation')
@of('franka', 'error recovery')
@pytest.mark.parametrize('convention', ROBOTS)
def test_an_activation_or_a_reset_lets_control_continue(convention):
    engine = arm(convention)
    for ending in (['deactivate', 'activate'], ['reset']):
        commanded(engine, 1)
        at = state(engine, cycles=100).position
        assert engine.state.tripped
        engine.step([request(name) for name in ending])
        assert not engine.state.tripped
        assert verdict(engine, zeros(engine)).accepted
        assert state(engine).position.tolist() == at.tolist()


@of('ur', 'other modes')
def test_positions_are_rejected_without_servo_gains():
    engine = arm('ur')
    found = verdict(engine, named(engine.names, position=[0.0] * 6))
    assert (found.label, found.accepted) == ('no_effort', False)


@of('franka', 'commands that are not finite')
def test_infinite_efforts_are_rejected_and_nan_by_name_is_no_command():
    engine = arm('franka')
    for value, label in ((INF, 'infinite'), (NAN, 'unclaimed')):
        assert verdict(engine, named(engine.names, [value] * 7)).label == label
    assert verdict(engine, efforts(*[NAN] * 7)).label == 'not_finite'


# ---- what states show


@of('ur', 'effort as torque', 'effort as current')
@of('franka', 'tau_J', 'tau_J_d')
@pytest.mark.parametrize('convention', ROBOTS)
def test_efforts_of_states_are_as_the_driver_publishes_them(convention):
    start, constants, load = (0.3, -0.5), (10.0, 11.0), (0.8, (0.0, 0.05, 0.1))
    chosen = {'load_mass': load[0], 'load_center': load[1], 'payload_mass': load[0]}
    chosen |= {'payload_center': load[1], 'outputs': ('true_states',)}
    shown = {}
    for kind in ('command', 'torque', 'current'):
        engine = small(convention, state_effort=kind, torque_constant=constants, **chosen)
        weight = gravity(engine, start, load)
        # Held by its controller, too.
        braked = state(engine).effort
        effort = joint(engine, 1, 0.5)
        messages, _ = engine.step([efforts(*effort)])
        found = {role: decode_joints(data) for role, data, _ in messages if 'states' in role}
        assert found['true_states'].effort.tolist() == effort
        shown[kind] = found['joint_states'].effort
        wanted = {'command': 0.0 * weight, 'torque': weight, 'current': weight / constants}[kind]
        np.testing.assert_allclose(braked, wanted, rtol=0, atol=1e-9)
    assert shown['command'].tolist() == effort
    # The arm has moved by a step since then.
    np.testing.assert_allclose(shown['torque'], weight + effort, rtol=0, atol=1e-3)
    np.testing.assert_allclose(shown['current'] * constants, shown['torque'], rtol=1e-12)
    usual = small(convention).state.settings.state_effort
    assert usual == {'ur': 'command', 'franka': 'torque'}[convention]


def test_the_current_is_that_of_the_compensated_friction_too():
    chosen = {'joint_damping': (12.0,) * 2, 'joint_friction': (8.0,) * 2}
    chosen |= {'static_friction': (20.0,) * 2, 'stribeck_velocity': (0.3,) * 2}
    chosen |= {'state_effort': 'current', 'torque_constant': (2.0,) * 2, 'gravity': (0.0,) * 3}
    engine = small('ur', **chosen)
    engine.step([placed(engine.names, (0.3, -0.5), joint(engine, 0, 0.5)), zeros(engine)])
    found = commanded(engine, 1)[-1]
    speed = found.velocity[0]
    dry = 8.0 + (20.0 - 8.0) / (1.0 + (speed / 0.3) ** 2)
    assert found.effort[0] == pytest.approx((0.9 * 12.0 * speed + 0.8 * dry) / 2.0, rel=1e-12)


@of('franka', 'external torques', 'joint_reflex')
def test_an_external_torque_beyond_its_threshold_stops_the_robot():
    chosen = {'external_wrench': True, 'outputs': ('external_torques',)}
    engine = small('franka', reflex_external_effort=(20.0, 12.0), **chosen)
    push = wrench(engine.robot.tip, torque=(0.0, 0.0, 11.9))
    messages, _ = engine.step([zeros(engine), push])
    (data,) = (data for role, data, _ in messages if role == 'external_torques')
    assert decode_joints(data).effort[1] == pytest.approx(11.9)
    assert not engine.state.tripped
    # Another payload is an input of native code.
    engine.step([zeros(engine), payload(engine.robot.tip, 0.1), change(load_mass=0.1)])
    assert not engine.state.tripped
    engine.step([zeros(engine), wrench(engine.robot.tip, torque=(0.0, 0.0, 12.1))])
    assert engine.state.tripped == (
        "joint_reflex: the external effort of 'elbow' is 12.1, limit 12"
    )
    assert not any(state(engine).velocity)


# ---- limits


@of('ur', 'torque limits')
@of('franka', 'torque limits')
@pytest.mark.parametrize(
    ('convention', 'limits'),
    [('ur', (150, 150, 150, 28, 28, 28)), ('franka', (87, 87, 87, 87, 12, 12, 12))],
)
def test_torques_are_limited_to_the_documented_ones(convention, limits):
    engine = arm(convention, state_effort='command', reflex_effort_rate=0.0)
    assert commanded(engine, 1, *[1e3] * len(limits))[0].effort.tolist() == list(limits)


@of('ur', 'speed limit', 'position limit')
@of('franka', 'velocity limits', 'position limits')
@pytest.mark.parametrize(
    ('convention', 'kind', 'text'),
    [
        ('ur', 'velocity', "joint speed limit, stop category 0: the velocity of 'shoulder_pan_"),
        ('ur', 'position', "joint position limit, stop category 0: the position of 'shoulder_p"),
        ('franka', 'velocity', "joint_velocity_violation: the velocity of 'panda_joint1' is 2."),
        ('franka', 'position', "joint_position_limits_violation: the position of 'panda_joint1"),
    ],
)
def test_a_joint_beyond_its_limit_stops_the_robot(convention, kind, text):
    engine = arm(convention)
    start, robot = np.array(POSES[convention][0]), engine.robot
    speed = np.zeros(robot.n)
    if kind == 'velocity':
        speed[0] = 0.99 * robot.velocity_limit[0]
    else:
        start[0], speed[0] = robot.position_upper[0] - 0.01, 0.5
    engine.step([placed(engine.names, start, speed), zeros(engine)])
    # A joint that its brake holds may be anywhere.
    assert not engine.state.tripped
    bound = {'velocity': robot.velocity_limit[0], 'position': robot.position_upper[0]}[kind]
    for _ in range(100):
        before = commanded(engine, 1, *joint(engine, 0, 0.9))[-1]
        if engine.state.tripped:
            break
        assert abs(getattr(before, kind)[0]) <= bound
    assert engine.state.tripped.startswith(text)
    assert abs(getattr(before, kind)[0]) > bound
    assert not any(state(engine).velocity)
    assert verdict(engine, zeros(engine)).label == 'refused'


@of('franka', 'torque rate', 'backward difference', 'initial torque')
@pytest.mark.parametrize(
    ('sent', 'trips'),
    [
        # N m in cycles of a millisecond.
        ([1.0, 2.0, 1.0, 0.0], 0),
        ([0.9, 1.95], 1),
        # Two commands in a cycle or cycles without any: it is the step that counts.
        ([0.0, None, None, 1.5], 1),
        ([1.1], 1),
    ],
)
def test_a_torque_that_changes_by_more_than_1_nm_in_a_cycle_stops_the_robot(sent, trips):
    engine = arm('franka')
    for value in sent:
        engine.step([] if value is None else [efforts(*joint(engine, 2, value))])
    assert engine.state.trips == trips
    wanted = "controller_torque_discontinuity: the effort of 'panda_joint3' changed by "
    assert engine.state.tripped.startswith(wanted if trips else '')


def test_a_reflex_at_the_start_compares_a_released_joint_alone_with_zero():
    engine = arm('franka')
    name = engine.names[0]
    for value in np.arange(0.9, 5.0, 0.9):
        engine.step([named([name], [value])])
    # The other joints are released later.
    engine.step([named(engine.names, [value, *[0.5] * 6])])
    engine.step()
    assert not engine.state.tripped
    # A jump to a state starts anew, and so does a change of the limit.
    engine.step([placed(engine.names, POSES['franka'][0]), change(reflex_effort_rate=500.0)])
    engine.step([efforts(*[4.0] * 7)])
    assert engine.state.tripped


# ---- recordings and what-if


@pytest.mark.parametrize('convention', ROBOTS)
def test_a_recording_of_a_convention_verifies_and_another_one_is_a_what_if(convention, tmp_path):
    settings = {**SMALL[convention], 'joint_friction': (1.0, 0.5)}
    settings |= {'state_effort': 'torque', 'noise_effort': 0.1}
    events = {k: [efforts(0.5 * np.sin(0.1 * k), 0.0)] for k in range(1, 51)}
    events[20].append(change(load_mass=0.5, coulomb_scale=[0.5] * 2))
    chosen = vars(Settings.from_values({'start_time': 1.0, **settings}))
    path = tmp_path / 'run.mcap'
    run = simulate(path, 90, events, **{**chosen, 'recording': str(path)})
    assert run.engine.state.tripped
    assert verify_log(path).cycles == 90
    found = what_if(path, ['convention=plain'], out=tmp_path / 'plain.mcap').settings
    plain = Settings()
    for name in CONVENTIONS[convention].values:
        # What was given is kept, unless it is the value of the convention.
        kept = name == 'state_effort' and convention == 'ur'
        assert getattr(found, name) == ('torque' if kept else getattr(plain, name))
    assert verify_log(tmp_path / 'plain.mcap').cycles
    again = what_if(tmp_path / 'plain.mcap', [f'convention={convention}'], out=tmp_path / 'b.mcap')
    assert again.settings.command_timeout == chosen['command_timeout']
    assert again.settings.step_size == chosen['step_size']


def test_the_motion_of_a_test_has_efforts_in_the_units_of_their_limits(tmp_path):
    usual = {**SMALL['franka'], 'torque_constant': (10.0,) * 2}
    for kind, unit in (('torque', 1.0), ('current', 10.0)):
        path = tmp_path / f'{kind}.mcap'
        with LockstepArm(**usual, state_effort=kind, recording=path) as arm:
            motion = arm.run(lambda t, q, qd: np.full(2, 0.5), 0.02)
            assert (motion.tau == 0.5).all()
            assert np.diff(motion.time) == pytest.approx(0.001)
            shown = arm.engine.measured()[2]
            weight = gravity(arm.engine, motion.q[-1])
        np.testing.assert_allclose(shown * unit, weight + 0.5, rtol=0, atol=1e-2)
        titles = {plot.title for plot in page_of_log(read_log(path, types=PAGE_TYPES)).plots}
        assert f'effort [{"A" if kind == "current" else "N m"}]' in titles


def test_limits_of_efforts_are_those_of_the_motors_where_states_show_torques_with_gravity(
    tmp_path,
):
    # Gravity takes 9 N m at the first joint, whose limit is 20 N m.
    usual = {**SMALL['franka'], 'reflex_effort_rate': 0.0}
    runs = ('cut', 200.0, ['true_states']), ('far', 15.0, []), ('unseen', 200.0, [])
    for name, tau, outputs in runs:
        path = tmp_path / f'{name}.mcap'
        with LockstepArm(**usual, outputs=outputs, recording=path) as arm:
            arm.run(lambda t, q, qd, tau=tau: np.array([tau, 0.0]), 0.02)
        page, motion = page_of_log(read_log(path, types=PAGE_TYPES)), recorded(path)
        limited = [(x.joint, x.time) for x in page.findings if x.kind == 'effort limit']
        hits = [x.joint for x in motion.limits_hit() if x.kind == 'effort']
        assert limited == ([('shoulder', pytest.approx(0.002))] if outputs else [])
        assert hits == (['shoulder'] if outputs else [])
        assert any('true_states' in note for note in page.run.notes) == (not outputs)
