# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The actuators: efforts and speeds stay within the limits of motors, and the run continues."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from bridge import (
    Actuators,
    Arrival,
    Engine,
    JointStateEncoder,
    Request,
    Settings,
    Source,
    Verdict,
    actuator_effort_limits,
    actuator_speed_limits,
    encode_request,
    read_recording,
    record_actuators,
    record_motor_torques,
    resolve_plant,
    run_program,
)
import numpy as np
from plant_messages import UNLIMITED, efforts, joint_state
import pytest
from sampling import one_fast
from simulating import simulate, states_of

import pfd_core as pfd

# As its file states them: 20 and 10 N m, both at 20 rad/s.
PLANAR2 = pfd.load_robot('planar2')
ROBOTS = ('planar2', 'puma560', 'ur5', 'panda')
NAN = float('nan')


def actuators(**settings: Any) -> Engine:
    """Return an arm without gravity, whose joints can be set to any velocity."""
    return Engine(Settings(robot='planar2', gravity=(0.0, 0.0, 0.0), **settings), PLANAR2)


def acted(engine: Engine, effort: tuple[float, ...], qd: tuple[float, ...]) -> list[float]:
    """Return the efforts that act on joints at these velocities, in the order of the model."""
    jump = JointStateEncoder(NAMES).encode(0, np.zeros(2), np.array(qd), np.zeros(2))
    engine.run_cycle([Arrival(Source.SET_STATE, 1, jump)])
    order = list(engine.arm.order)
    command = efforts(*np.array(effort)[order])
    engine.run_cycle([Arrival(Source.ARRAY, 1, command)])
    return engine.arm.tau.tolist()


def test_an_effort_beyond_the_limit_of_the_model_is_cut_to_it_and_counted() -> None:
    made = actuators()
    assert acted(made, (1e300, -10.5), (0.0, 0.0)) == [20.0, -10.0]
    assert acted(made, (-21.0, 3.0), (0.0, 0.0)) == [-20.0, 3.0]
    assert made.state.actuators.saturated == 2
    assert acted(made, (20.0, -10.0), (0.0, 0.0)) == [20.0, -10.0]
    assert made.state.actuators.saturated == 2


def test_efforts_within_the_limits_have_the_same_bits() -> None:
    wanted = (-0.0, 10.0)
    made = actuators()
    assert str(acted(made, wanted, (17.0, -17.0))) == str([*wanted])
    assert made.state.actuators.saturated == 0


@pytest.mark.parametrize(
    ('speed', 'left'), [(19.9, 20.0), (20.0, 20.0), (30.0, 10.0), (40.0, 0.0), (90.0, 0.0)]
)
def test_driving_torque_drops_beyond_the_speed_limit_and_braking_torque_does_not(
    speed: float, left: float
) -> None:
    made = actuators()
    for sign in (1.0, -1.0):
        effort, _ = acted(made, (sign * 20.0, 0.0), (sign * speed, 0.0))
        assert effort == pytest.approx(sign * left, rel=1e-12)
        assert acted(made, (sign * 20.0, 0.0), (-sign * speed, 0.0)) == [sign * 20.0, 0.0]
        # A bound, not a factor: less than that passes.
        assert acted(made, (sign * 0.9 * left, 0.0), (sign * speed, 0.0)) == pytest.approx(
            [sign * 0.9 * left, 0.0]
        )


def test_the_speed_of_one_joint_does_not_limit_another() -> None:
    assert acted(actuators(), (5.0, 10.0), (50.0, 0.1)) == [0.0, 10.0]


def test_the_limits_belong_to_the_joints_in_any_published_order() -> None:
    turned = actuators(joints=NAMES[::-1])
    assert acted(turned, (99.0, 99.0), (0.0, 40.0)) == [20.0, 0.0]


def test_limits_can_be_switched_off() -> None:
    assert acted(actuators(**UNLIMITED), (1e3, -11.0), (50.0, -50.0)) == [1e3, -11.0]
    # The first row of a table holds at any speed.
    assert acted(actuators(effort_limits=False), (99.0, 99.0), (30.0, 0.0)) == [10.0, 10.0]
    assert acted(actuators(torque_speed=False), (99.0, 9.0), (19.0, 50.0)) == [20.0, 9.0]


recorded = cache(record_actuators)


def limited(made: Actuators, wanted: np.ndarray, velocities: np.ndarray) -> np.ndarray:
    """Return the efforts within the limits of actuators, in model order."""
    n = len(wanted)
    given = {
        'q': np.zeros(n),
        'qd': velocities,
        'efforts': wanted,
        'wanted': np.full(n, NAN),
        'tau': np.zeros(n),
        'peaks': np.zeros(n),
        'motors': made.limits.ravel(),
        'targets': np.full(2 * n, NAN),
    }
    found: np.ndarray = run_program(recorded(n), given)['acting']
    return found


@pytest.mark.sweep
@pytest.mark.parametrize('robot', ['puma560', 'ur5', 'panda'])
@pytest.mark.parametrize('limits', [('effort_limits',), ('torque_speed',), tuple(UNLIMITED)])
def test_limits_act_as_in_a_scene_with_the_limits_of_the_model(
    limits: tuple[str, ...], robot: str
) -> None:
    arm = pfd.load_robot(robot)
    program = record_motor_torques(resolve_plant(arm, pfd.Scene(**dict.fromkeys(limits, 'model'))))
    settings = Settings(robot=robot, **{name: name in limits for name in UNLIMITED})
    made = Actuators(settings, arm, range(arm.n))
    rng = np.random.default_rng(5)
    for _ in range(40):
        wanted = 3.0 * arm.effort_limit * rng.uniform(-1, 1, arm.n)
        velocities = 3.0 * arm.velocity_limit * rng.uniform(-1, 1, arm.n)
        given = {'tau': wanted, 'qd': velocities}
        motors = run_program(program, {key: given[key] for key in program.inputs})['tau']
        np.testing.assert_allclose(limited(made, wanted, velocities), motors, rtol=1e-13)


@pytest.mark.parametrize(
    ('scene', 'left'),
    [
        (pfd.Scene(effort_limits=(3.0, 1.0), torque_speed='model'), [1e300, -1e300]),
        (pfd.Scene(effort_limits=(3.0, 1.0)), [0.0, -10.0]),
        (pfd.Scene(torque_speed=[[(1.0, 5.0)]] * 2), [20.0, -10.0]),
    ],
)
def test_limits_of_the_scene_replace_the_parameters(scene: pfd.Scene, left: list[float]) -> None:
    engine = Engine(Settings(robot='planar2', scene=pfd.scene_to_yaml(scene)), PLANAR2)
    found = limited(engine.actuators, np.array([1e300, -1e300]), np.array([40.0, 40.0]))
    assert found.tolist() == left


@pytest.mark.parametrize('silent', [0.0, np.inf])
def test_a_joint_whose_model_states_no_limit_gets_a_wide_one(silent: float) -> None:
    robot = replace(
        PLANAR2,
        effort_limit=np.array([silent, 10.0]),
        velocity_limit=np.array([silent, 20.0]),
    )
    assert actuator_effort_limits(robot).tolist() == [1000.0, 10.0]
    assert actuator_speed_limits(robot).tolist() == [100.0, 20.0]
    # 50 N m for each of 2 kg is less; a heavy arm has the weight of its links at 5 m.
    heavy = replace(robot, masses=np.array([400.0, 100.0]))
    assert actuator_effort_limits(heavy).tolist() == [25_000.0, 10.0]


def run(robot: str, signs: np.ndarray, cycles: int, **settings: Any) -> Engine:
    chosen = Settings(robot=robot, **settings)
    engine = Engine(chosen, pfd.load_robot(robot))
    engine.run_cycle([Arrival(Source.ARRAY, 1, efforts(*(1e300 * signs)))])
    for _ in range(cycles):
        engine.step()
        if engine.arm.failure:
            break
    return engine


@pytest.mark.parametrize('robot', one_fast(ROBOTS))
def test_a_command_of_any_size_does_not_end_the_run_of_a_robot(robot: str) -> None:
    n = pfd.load_robot(robot).n
    for signs in (np.ones(n), (-1.0) ** np.arange(n)):
        engine = run(robot, signs, 2000)
        assert not engine.arm.failure
        assert engine.state.actuators.saturated == 2001
        limits = pfd.load_robot(robot).effort_limit
        assert (np.abs(engine.arm.tau) <= limits).all()


@pytest.mark.parametrize('settings', [UNLIMITED, {'torque_speed': False}], ids=str)
def test_without_limits_it_ends(settings: dict[str, Any]) -> None:
    assert 'is not finite' in run('puma560', np.ones(6), 3000, **settings).arm.failure


SERVO: dict[str, Any] = {'servo_p': (400.0, 200.0), 'servo_d': (40.0, 10.0)}
NAMES = ('shoulder', 'elbow')


def targeted(*args: Sequence[Any], **other: Any) -> tuple[Source, bytes]:
    return Source.NAMED, joint_state(*args, **other)


def test_a_servo_gives_the_effort_of_its_law_once_per_cycle_and_its_recording_verifies(
    tmp_path: Path,
) -> None:
    commands = {
        2: [targeted(NAMES, [0.1, -0.2], effort=[1.5, NAN])],
        200: [targeted(['elbow'], [NAN], [0.5])],
        400: [targeted(['shoulder'], effort=[3.0])],
    }
    path = simulate(600, commands, **SERVO).save(tmp_path / 'a.mcap')
    assert read_recording(path, verify=True).complete
    states = states_of(path)
    for k in range(1, 600):
        q, qd = states[k - 1].position, states[k - 1].velocity
        elbow = 200.0 * (-0.2 - q[1]) + 10.0 * ((0.5 if k >= 199 else 0.0) - qd[1])
        shoulder = 1.5 + 400.0 * (0.1 - q[0]) + 40.0 * (0.0 - qd[0]) if k < 399 else 3.0
        wanted = np.clip([shoulder, elbow], [-20.0, -10.0], [20.0, 10.0])
        assert states[k].effort.tolist() == wanted.tolist()


def test_an_arm_under_its_servo_rests_where_spring_and_gravity_balance() -> None:
    settings = Settings(robot='planar2', **SERVO)
    engine = Engine(settings, PLANAR2)
    target = np.array([0.4, -0.3])
    source, data = targeted(NAMES, target)
    engine.run_cycle([Arrival(source, 1, data)])
    for _ in range(4000):
        engine.step()
    g = pfd.inverse_dynamics(PLANAR2, engine.arm.q, np.zeros(2), np.zeros(2))
    assert np.abs(g).max() > 1.0
    np.testing.assert_allclose(engine.arm.q, target - g / [400.0, 200.0], atol=1e-9)
    # With the gravity torque of the target fed forward it is there.
    g = pfd.inverse_dynamics(PLANAR2, target, np.zeros(2), np.zeros(2))
    source, data = targeted(NAMES, target, [0.0, 0.0], g)
    engine.run_cycle([Arrival(source, 2, data)])
    for _ in range(4000):
        engine.step()
    np.testing.assert_allclose(engine.arm.q, target, atol=1e-9)


def test_a_joint_that_no_target_names_stays_on_its_brake_and_the_order_is_a_view() -> None:
    settings = Settings(robot='planar2', joints=NAMES[::-1], servo_p=(200.0, 0.0), servo_d=(9, 0))
    engine = Engine(settings, PLANAR2)
    source, data = targeted(['elbow'], [0.5])
    for _ in range(3000):
        engine.run_cycle([Arrival(source, 1, data)] if engine.cycles == 0 else [])
    shoulder, elbow = engine.arm.q
    assert shoulder == 0.0
    assert abs(elbow - 0.5) < 0.1
    assert engine.arm.names == ('elbow', 'shoulder')


@pytest.mark.parametrize('event', ['reset', 'set_state'])
def test_a_jump_ends_the_servo(event: str) -> None:
    engine = Engine(Settings(robot='planar2', **SERVO), PLANAR2)
    source, data = targeted(NAMES, [1.0, 1.0])
    engine.run_cycle([Arrival(source, 1, data)])
    if event == 'reset':
        engine.run_cycle([Arrival(Source.REQUEST, 1, encode_request(Request('reset')))])
    else:
        engine.run_cycle([Arrival(Source.SET_STATE, 1, targeted(NAMES, [0.2, 0.2])[1])])
    engine.step()
    assert not engine.arm.tau.any()
    assert engine.state.link.actuation.position is None


def test_an_arm_without_gains_accepts_efforts_with_positions_and_rejects_positions_alone() -> None:
    engine = Engine(Settings(robot='planar2'), PLANAR2)
    source, data = targeted(NAMES, [1.0, 1.0], effort=[2.0, 1.0])
    assert engine.validate(Arrival(source, 1, data)).verdict is Verdict.ACCEPTED
    engine.run_cycle([Arrival(source, 1, data)])
    assert engine.arm.tau.tolist() == [2.0, 1.0]
    source, data = targeted(NAMES, [1.0, 1.0])
    assert engine.validate(Arrival(source, 1, data)).verdict is Verdict.NO_EFFORT


POSE = (0.4, -0.7)


def test_by_the_convention_of_franka_efforts_are_without_gravity(tmp_path: Path) -> None:
    commands = {2: [efforts(0.0, 0.0)], 50: [efforts(1.0, -0.3)]}
    chosen: dict[str, Any] = {'initial_positions': POSE}
    franka = simulate(100, commands, convention='franka', **chosen).save(tmp_path / 'a.mcap')
    assert read_recording(franka, verify=True).complete
    plain = simulate(100, commands, **chosen).save(tmp_path / 'b.mcap')
    weightless = simulate(100, commands, gravity=(0.0, 0.0, 0.0), **chosen)
    states = states_of(franka)
    # It stays where it is without an effort, and tells none; with one it is an arm in free space.
    assert states[48].position.tolist() == list(POSE)
    assert not states[48].effort.any()
    assert states[99].effort.tolist() == [1.0, -0.3]
    ours = [state.position.tobytes() for state in states]
    assert ours == [
        state.position.tobytes() for state in states_of(weightless.save(tmp_path / 'c.mcap'))
    ]
    assert states_of(plain)[48].velocity.all()


COMMANDS = {3: [efforts(1e300, -1e300)], 40: [efforts(15.0, 9.0)], 400: [efforts(0.0, 99.0)]}


def test_a_recording_with_saturated_efforts_verifies_and_has_the_efforts_that_acted(
    tmp_path: Path,
) -> None:
    path = simulate(600, COMMANDS).save(tmp_path / 'a.mcap')
    assert read_recording(path, verify=True).complete
    states = states_of(path)
    assert states[2].effort.tolist() == [20.0, -10.0]
    told = np.array([state.effort for state in states])
    assert (np.abs(told) <= [20.0, 10.0]).all()
    # Some were less than the commanded ones, at speed.
    assert (told[450:, 1] < 10.0).any()
