# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd replay --what-if` of recordings: equal bits without a change, else what others compute."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import json
import math
from pathlib import Path
import re
import sys
from typing import Any

from bridge import (
    JointDivergence,
    LockstepArm,
    LogError,
    Source,
    TopicArrays,
    WhatIf,
    pfd_main,
    what_if,
)
import numpy as np
from oracle import Oracle
import pinocchio as pin
from plant_messages import efforts, joint_state
import pytest
from rewriting import GOLDEN, load
from ros_processes import example_robot
from sampling import one_fast
from simulating import simulate

import pfd_core as pfd
from pfd_ros import read_log

STATES, ARRAY = '/joint_states', '/sim_arm/commands'
BIT = 2.0**-52
# Of a trajectory of a second by Pinocchio and this test's Runge-Kutta: rounding, grown by motion.
PINOCCHIO = 1e-9
# Efforts are the commanded ones.
UNCUT: dict[str, Any] = {'effort_limits': False, 'torque_speed': False}


def swung(path: Path, robot: str = 'planar2', seconds: float = 1.0, **settings: Any) -> Path:
    """Record an arm in lockstep that is driven by efforts without names."""
    with LockstepArm(robot, recording=path, **settings) as arm:
        arm.run(lambda t, q, qd: 5.0 * np.sin(3 * t + np.arange(len(q))) - 8.0 * q - qd, seconds)
    return path


@pytest.fixture(scope='module')
def swing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return swung(tmp_path_factory.mktemp('swings') / 'swing.mcap', **UNCUT)


def eventful(path: Path) -> Path:
    """Record states that were set, requests, parameters and commands that were rejected."""
    with LockstepArm('planar2', recording=path, joints=('elbow', 'shoulder')) as arm:
        arm.run(lambda t, q, qd: 60.0 * (0.5 - q) - 6.0 * qd, 0.2)
        arm.set(servo_p=[1.0, 2.0])
        arm.set_state({'elbow': 0.3})
        arm.run(lambda t, q, qd: 30.0 * (0.2 - q) - 6.0 * qd, 0.2)
        arm.reset()
        arm.set(**{'payload_mass': 0.5})
        arm.run(lambda t, q, qd: 20.0 * np.sin(9 * t) - qd, 0.2)
    return path


def saving(path: Path) -> Path:
    """Record states of the whole arm, within cycles that have commands alone."""
    return swung(path, recording_state_period=0.15)


def noisy(path: Path) -> Path:
    """Record measured states, some of them dropped, with further outputs, and named commands."""
    commands = {
        3: [efforts(1.0, 2.0)],
        50: [(Source.SET_STATE, joint_state(['elbow'], [0.3]))],
        60: [efforts(1.0, 2.0, 3.0)],
        200: [(Source.NAMED, joint_state(['elbow', 'nobody'], effort=[1.0, 2.0]))],
    }
    settings = {
        'noise_position': 1e-3,
        'drop_state': 0.2,
        'outputs': ('energy', 'true_states'),
        'delay_state': 0.005,
        'publish_rate': 500.0,
    }
    return simulate(400, commands, **settings).save(path)


def failing(path: Path) -> Path:
    """Record a simulation that does not stay finite, and is reset."""
    reset = Source.REQUEST, b'\0\1\0\0\x15\0\0\0{"request": "reset"}\0'
    settings = {'joint_damping': (1e6, 1e6), 'integrator': 'rk4'}
    return simulate(300, {5: [efforts(1.0, 2.0)], 100: [reset]}, **settings).save(path)


def golden(path: Path) -> Path:
    path.write_bytes(GOLDEN.read_bytes())
    return path


def contents(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Return number and bytes of the messages of each topic that has some."""
    found: dict[str, list[tuple[int, bytes]]] = {}
    for message in load(path).messages:
        # Reports of the node about itself are not outputs of the arm.
        if message.topic in ('/diagnostics', '/sim_arm/transition_event'):
            continue
        found.setdefault(message.topic, []).append((message.sequence, message.data))
    return found


def times_of(path: Path) -> list[tuple[str, int, int]]:
    """Return topic, number and log time of the messages."""
    return [(m.topic, m.sequence, m.log_ns) for m in load(path).messages]


def of(found: WhatIf, field: str) -> list[JointDivergence]:
    return [item for item in found.divergences if item.field == field]


def numbers(found: WhatIf, field: str, name: str) -> list[float]:
    return [getattr(item, name) for item in of(found, field)]


@pytest.mark.parametrize('record', [golden, swung, eventful, saving, noisy, failing])
def test_a_run_without_a_change_has_the_bits_of_the_log(
    record: Callable[[Path], Path], tmp_path: Path
) -> None:
    log = record(tmp_path / 'a.mcap')
    found = what_if(log)
    assert found.log == tmp_path / 'a_what_if.mcap'
    assert contents(found.log) == contents(log)
    if record in (swung, eventful, saving, failing):
        before, after = (sorted(times_of(path)) for path in (log, found.log))
        assert len({log_ns for *_, log_ns in before}) > 100
        assert after == before
    assert found.states > 0
    assert {item.largest for item in found.divergences} == {0.0}
    assert {item.first_at for item in found.divergences} == {None}
    assert not found.rejected
    assert pfd_main(['replay', str(found.log), '--verify']) == 0


@pytest.mark.ros
def test_a_run_of_the_node_without_a_change_has_its_bits(recorded: Path, tmp_path: Path) -> None:
    found = what_if(recorded, out=tmp_path / 'b.mcap')
    assert contents(found.log) == contents(recorded)
    changed = what_if(recorded, ['payload.mass=1.5'], out=tmp_path / 'c.mcap')
    assert min(numbers(changed, 'velocity', 'largest')) > 0
    assert pfd_main(['replay', str(changed.log), '--verify']) == 0


def by_pinocchio(
    robot: pfd.Robot, payload: pfd.Payload, taus: np.ndarray, h: float, substeps: int
) -> np.ndarray:
    """Return positions and velocities after each step, (k, 2, n), by aba and Runge-Kutta 4."""
    oracle = Oracle(robot)
    body = pin.Inertia(payload.mass, np.array(payload.center), np.array(payload.inertia))
    oracle.model.appendBodyToJoint(robot.n, body, oracle.tip)
    oracle.data = oracle.model.createData()
    state, rows, dt = np.zeros((2, robot.n)), [], h / substeps

    def rate(x: np.ndarray, tau: np.ndarray) -> np.ndarray:
        return np.array([x[1], oracle.qdd(x[0], x[1], tau)])

    for tau in taus:
        for _ in range(substeps):
            k1 = rate(state, tau)
            k2 = rate(state + dt / 2 * k1, tau)
            k3 = rate(state + dt / 2 * k2, tau)
            k4 = rate(state + dt * k3, tau)
            state = state + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        rows.append(state)
    return np.array(rows)


@pytest.mark.parametrize('robot', one_fast(['planar2', 'ur5']))
def test_a_payload_diverges_as_pinocchio_says(robot: str, tmp_path: Path) -> None:
    log = swung(tmp_path / 'a.mcap', robot, 0.4, armature=robot == 'ur5', **UNCUT)
    words = ['payload.mass=0.7', 'payload.center=[0.05, -0.02, 0.1]', 'armature=false']
    found = what_if(log, [*words, 'substeps=3', 'integrator=rk4'])
    body = pfd.Payload(0.7, (0.05, -0.02, 0.1))
    recorded = read_log(log)
    states: TopicArrays = recorded[STATES]
    motion = by_pinocchio(pfd.load_robot(robot), body, recorded[ARRAY].data, 1e-3, 3)
    for k, field in enumerate(('position', 'velocity')):
        sizes = np.abs(motion[:, k] - states[field])
        np.testing.assert_allclose(numbers(found, field, 'largest'), sizes.max(0), atol=PINOCCHIO)
        rms = np.sqrt(np.mean(sizes**2, axis=0))
        np.testing.assert_allclose(numbers(found, field, 'rms'), rms, atol=PINOCCHIO)
        at = (1 + sizes.argmax(0)) * 1e-3
        np.testing.assert_allclose(numbers(found, field, 'largest_at'), at, atol=1e-12)
        first = [1e-3 * (1 + int(np.argmax(column > found.thresholds[k]))) for column in sizes.T]
        np.testing.assert_allclose(numbers(found, field, 'first_at'), first, atol=1e-12)
    assert numbers(found, 'effort', 'largest') == [0.0] * motion.shape[2]
    new = read_log(found.log)[STATES]
    np.testing.assert_allclose(new.position, motion[:, 0], atol=PINOCCHIO)


def test_the_rounding_run_starts_one_bit_away(swing: Path, tmp_path: Path) -> None:
    found = what_if(swing, ['payload.mass=0.5'], out=tmp_path / 'b.mcap')
    taus = read_log(swing)[ARRAY].data
    motions = []
    for start in ((), (BIT, BIT)):
        with LockstepArm('planar2', payload_mass=0.5, initial_positions=start, **UNCUT) as arm:
            rows = iter(taus)
            arm.run(lambda t, q, qd: next(rows), 1.0)  # noqa: B023
            motions.append(arm.save())
    last = np.abs(motions[1].q - motions[0].q)
    assert 0 < last.max() < 1e-12
    largest = np.array(numbers(found, 'position', 'rounding_largest'))
    assert (largest >= last).all()
    assert (largest < 1e-12).all()
    _, _, sizes = found.curves
    np.testing.assert_array_equal(sizes[-1, 1], last)


def test_a_state_that_is_set_is_one_bit_away_too(tmp_path: Path) -> None:
    path = eventful(tmp_path / 'a.mcap')
    found = what_if(path)
    time, _, sizes = found.curves
    # After the state that was set in step 201, and after the reset.
    assert (sizes[time > 0.21, 1] > 0).mean() > 0.9


def test_sensors_of_another_seed_change_what_is_measured_alone(tmp_path: Path) -> None:
    path = noisy(tmp_path / 'a.mcap')
    found = what_if(path, ['seed=3', 'drop.state=0', 'outputs=[]'])
    # Dropped states are recorded, and compared.
    assert found.states == 200
    assert numbers(found, 'position', 'rms') == pytest.approx([math.sqrt(2) * 1e-3] * 2, rel=0.2)
    assert numbers(found, 'velocity', 'largest') == [0.0, 0.0]
    new = read_log(found.log)
    assert '/sim_arm/energy' not in new
    assert pfd_main(['replay', str(found.log), '--verify']) == 0


@pytest.mark.parametrize(
    ('word', 'share'), one_fast([('step_size=0.0005', 2), ('step_size=0.00025', 4)])
)
def test_other_steps_take_the_commands_at_their_times(
    word: str, share: int, swing: Path, tmp_path: Path
) -> None:
    found = what_if(swing, [word, 'payload.mass=0.5'], out=tmp_path / 'b.mcap')
    recorded = read_log(swing)
    scene = pfd.Scene(payload=pfd.Payload(0.5), armature=None)
    sim = pfd.Simulator(pfd.load_robot('planar2'), scene, step_size=1e-3 / share)
    motion = sim.rollout(np.repeat(recorded[ARRAY].data, share, axis=0))
    sizes = np.abs(motion.q[share - 1 :: share] - recorded[STATES].position)
    # The kernels have brakes as inputs or not: other rounding.
    expected = sizes.max(axis=0)
    np.testing.assert_allclose(numbers(found, 'position', 'largest'), expected, rtol=1e-9)
    assert not found.rejected
    assert pfd_main(['replay', str(found.log), '--verify']) == 0


def test_steps_that_are_longer_end_between_recorded_states(swing: Path, tmp_path: Path) -> None:
    found = what_if(swing, ['step_size=0.004'], out=tmp_path / 'b.mcap')
    # At most a step late, and interpolated between steps.
    assert max(numbers(found, 'position', 'largest')) < 0.1
    assert found.seconds == pytest.approx(1.0)
    assert found.states == 1000


def test_stamped_commands_act_in_other_steps(tmp_path: Path) -> None:
    def command(step: int, late: int = 0) -> tuple[Source, bytes]:
        stamp = (step - 1 - late) * 1_000_000 + 1_000_000_000
        return Source.NAMED, joint_state(['shoulder', 'elbow'], effort=[1, 2], stamp_ns=stamp)

    commands = {1: [command(1)], 3: [command(3, late=1)], 5: [command(5, late=3000)]}
    log = simulate(20, commands, start_time=1.0).save(tmp_path / 'a.mcap')
    assert not what_if(log, ['start_time=7']).rejected
    found = what_if(log, ['step_size=0.0005'])
    assert not found.rejected
    # The stale one is omitted.
    assert len(read_log(found.log)['/joint_commands']) == 2


def with_wrist(path: Path) -> Path:
    """Write planar2 with one more joint."""
    text = pfd.robot_to_urdf(pfd.load_robot('planar2'))
    (tip,) = re.findall(r'<link name="(tip_link)"', text)
    more = (
        f'<joint name="wrist" type="revolute"><parent link="{tip}"/><child link="hand"/>'
        '<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
        '<link name="hand"><inertial><mass value="0.2"/><inertia ixx="0.01" iyy="0.01" '
        'izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>'
    )
    path.write_text(text.replace('</robot>', more))
    return path


def test_efforts_without_names_reach_the_joints_of_another_robot_by_name(
    swing: Path, tmp_path: Path
) -> None:
    robot = with_wrist(tmp_path / 'three.urdf')
    found = what_if(swing, [f'robot={robot}'], out=tmp_path / 'b.mcap')
    assert found.only_in_arm == ('wrist',)
    assert found.joints == ('shoulder', 'elbow')
    assert not found.rejected
    commands = {
        step: [(Source.NAMED, joint_state(['shoulder', 'elbow'], effort=tau))]
        for step, tau in enumerate(read_log(swing)[ARRAY].data.tolist(), 1)
    }
    settings = {'start_time': 1e-3, 'lockstep': True, 'real_time_factor': 0.0, **UNCUT}
    alone = simulate(len(commands), commands, robot=str(robot), **settings)
    assert contents(found.log)[STATES] == [
        (sent.sequence, sent.data) for sent in alone.messages if sent.topic == STATES
    ]
    assert pfd_main(['replay', str(found.log), '--verify']) == 0


def test_the_order_of_the_joints_permutes_efforts_without_names(
    swing: Path, tmp_path: Path
) -> None:
    found = what_if(swing, ['joints=[elbow, shoulder]'], out=tmp_path / 'b.mcap')
    assert {item.largest for item in found.divergences} == {0.0}
    np.testing.assert_array_equal(
        read_log(found.log)[ARRAY].data, read_log(swing)[ARRAY].data[:, ::-1]
    )


def test_start_and_numbers_for_each_joint_follow_their_joints(tmp_path: Path) -> None:
    settings = {'initial_positions': (0.1, 0.2), 'joint_friction': (0.3, 0.4)}
    log = simulate(50, {3: [efforts(1.0, 2.0)]}, **settings).save(tmp_path / 'a.mcap')
    robot = with_wrist(tmp_path / 'three.urdf')
    found = what_if(log, [f'robot={robot}', 'friction.wrist=0.5']).settings
    assert found.initial_positions == (0.1, 0.2, 0.0)
    assert found.joint_friction == (0.3, 0.4, 0.5)


def test_a_real_robot_takes_the_place_of_another_one_with_its_joints(tmp_path: Path) -> None:
    log = swung(tmp_path / 'a.mcap', 'ur5', 0.1)
    urdf = example_robot('ur_description/urdf/ur10_robot.urdf')
    found = what_if(log, [f'robot={urdf}'])
    assert (found.robot, len(found.joints)) == ('ur10', 6)
    assert min(numbers(found, 'velocity', 'largest')) > 0
    assert pfd_main(['replay', str(found.log), '--verify']) == 0


def test_a_scene_file_takes_the_place_of_all_effects(tmp_path: Path) -> None:
    log = simulate(80, {3: [efforts(1.0, 2.0)]}, joint_friction=(0.3, 0.4), gravity=(0, 0, -1))
    path = log.save(tmp_path / 'a.mcap')
    scene = pfd.Scene(friction=(0.1, 0.2))
    scene.save(tmp_path / 'scene.yaml')
    found = what_if(path, [f'scene={tmp_path / "scene.yaml"}'])
    other = simulate(80, {3: [efforts(1.0, 2.0)]}, scene=pfd.scene_to_yaml(scene))
    assert contents(found.log)[STATES] == [
        (sent.sequence, sent.data) for sent in other.messages if sent.topic == STATES
    ]
    with pytest.raises(ValueError, match=r'friction cannot be changed by itself.*scene=FILE'):
        what_if(found.log, ['friction=[1, 2]'])


def test_inputs_that_are_validated_otherwise_are_counted(tmp_path: Path) -> None:
    position = {2: [(Source.NAMED, joint_state(['elbow'], position=[1.0]))]}
    servo = simulate(20, position, servo_p=(9.0, 9.0)).save(tmp_path / 'b.mcap')
    found = what_if(servo, ['servo_p=[]'])
    assert found.rejected == {'no_effort': 1}
    assert found.first_rejected.startswith('step 2: joint_commands 1 is no_effort')


def test_a_run_that_overflows_says_when(
    swing: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'b.mcap'
    words = ['damping=[1e6, 1e6]', 'integrator=rk4']
    arguments = ['replay', str(swing), '--what-if', *words, '--out', str(out)]
    assert pfd_main([*arguments, '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert found['failed_at'] == pytest.approx(0.002)
    assert found['failure'] == 'the state after step 2 is not finite'
    assert found['states'] == 1
    assert pfd_main(['replay', str(out), '--verify']) == 0
    assert 'FAILED     simulation stopped after step 1' in capsys.readouterr().out
    # The other way round: the states of the failed arm are there, and the new run continues.
    back = what_if(out, ['damping=[0, 0]'], out=tmp_path / 'c.mcap')
    assert (back.failure, back.states) == ('', 1000)


def test_a_log_that_was_cut_off_is_compared_up_to_the_cut(swing: Path, tmp_path: Path) -> None:
    path = load(swing).save(tmp_path / 'a.mcap', closed=False)
    found = what_if(path)
    assert not found.complete
    assert contents(found.log) == contents(swing)


def test_a_log_that_lacks_commands_is_refused(swing: Path, tmp_path: Path) -> None:
    lacking = load(swing)
    lacking.lose([lacking.on(ARRAY)[7]])
    path = lacking.save(tmp_path / 'a.mcap', closed=False)
    with pytest.raises(LogError, match='lacks command 8 of commands'):
        what_if(path)
    assert [file.name for file in tmp_path.iterdir()] == ['a.mcap']


def test_the_command_prints_a_row_for_each_joint_and_draws_both_runs(
    swing: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'b.mcap'
    words = ['payload.mass=0.5', 'payload.center=[0.1, 0, 0]']
    assert pfd_main(['replay', str(swing), '--what-if', *words, '--out', str(out)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith('planar2, payload.mass=0.5 payload.center=[0.1, 0, 0]')
    assert '1000 recorded states compared' in lines[1]
    rows = [line for line in lines if line.startswith(('position', 'velocity', 'effort'))]
    assert len(rows) == 6
    assert all(' from 0.' in line and line.endswith(' never') for line in rows[:4])
    assert all(line.count('equal') == 2 for line in rows[4:])
    assert (tmp_path / 'b.png').read_bytes().startswith(b'\x89PNG')


def test_without_matplotlib_there_is_a_line_and_no_picture(
    swing: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, 'matplotlib.figure', None)
    arguments = ['replay', str(swing), '--what-if', '--out']
    assert pfd_main([*arguments, str(tmp_path / 'b.mcap')]) == 0
    (line,) = (x for x in capsys.readouterr().out.splitlines() if x.startswith('no plot'))
    assert "a plot needs matplotlib: pip install 'pfd_ros[report]'" in line
    # Before the run, if a picture was requested.
    assert pfd_main([*arguments, str(tmp_path / 'c.mcap'), '--plot', str(tmp_path / 'c.png')]) == 1
    assert [path.name for path in tmp_path.iterdir()] == ['b.mcap']


def test_a_picture_of_an_unknown_format_is_refused_before_the_run(
    swing: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ['replay', str(swing), '--what-if', '--out', str(tmp_path / 'b.mcap')]
    assert pfd_main([*arguments, '--plot', str(tmp_path / 'b.xyz')]) == 1
    assert 'b.xyz has no suffix of a picture' in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_wall_times_of_a_source_without_them_are_interpolated(swing: Path, tmp_path: Path) -> None:
    found = what_if(swing, ['recording_time=wall'], out=tmp_path / 'b.mcap')
    wall = [message.log_ns for message in load(found.log).on(STATES)]
    source = [message.published_ns for message in load(swing).on(STATES)]
    assert wall == pytest.approx(source, abs=1)
    stamps = read_log(found.log)['/joint_states'].time
    assert stamps[-1] - stamps[0] == pytest.approx(0.999)


def test_nothing_is_overwritten(
    swing: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / 'a.mcap'
    log.write_bytes(swing.read_bytes())
    assert [what_if(log).log.name for _ in range(2)] == ['a_what_if.mcap', 'a_what_if_2.mcap']
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    for option, name in (('--out', 'a.mcap'), ('--plot', 'a_what_if.mcap')):
        assert pfd_main(['replay', str(log), '--what-if', option, str(tmp_path / name)]) == 1
        assert 'exists and is not overwritten' in capsys.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['payload.mas=2'], "unknown setting 'payload.mas': did you mean 'payload.mass'?"),
        (['payload_mass=2'], "unknown setting 'payload_mass': did you mean 'payload.mass'?"),
        (['zzzzzzzz=2'], "unknown setting 'zzzzzzzz': `pfd info LOG` lists all"),
        (['payload.mass'], "--what-if takes KEY=VALUE, got 'payload.mass'"),
        (['=2'], "--what-if takes KEY=VALUE, got '=2'"),
        (['substeps=1', 'substeps=2'], 'substeps is given twice'),
        (['friction=[1,2]', 'friction.elbow=2'], 'is given for all joints and for one'),
        (['payload.mass=NaN'], "payload.mass is 'NaN', expected a number"),
        (['payload.mass=1e999'], 'payload.mass holds inf, expected finite numbers'),
        (['payload.mass=-1'], 'payload.mass is -1.0, expected 0.0 to 100000.0'),
        (['substeps=1.5'], 'substeps is 1.5, expected a whole number'),
        (['substeps=true'], 'substeps is True, expected a whole number'),
        (['damping=1'], 'damping is 1, expected true or false'),
        (['damping=[a]'], "damping is '[a]', expected numbers as [0.1, 0.2]"),
        (['damping=' + '[' * 100_000], 'expected numbers as [0.1, 0.2]'),
        (['damping=[1, 2, 3]'], 'damping holds 3 numbers, expected 2, one for each joint'),
        (['damping.wrist=2'], "damping.wrist: no such joint; joints are ['shoulder', 'elbow']"),
        (['integrator=euler'], "integrator is 'euler', expected one of ['auto', 'rk4'"),
        (['method=newton'], "method is 'newton', expected one of"),
        (['step_size=1'], 'step_size is 1.0, expected 1e-05 to 0.1'),
        (['publish_rate=300'], 'expected a whole number of steps'),
        (['robot=ur6'], "unknown robot 'ur6'"),
        (['robot=ur5'], "'ur5' has none of the joints ['shoulder', 'elbow'] of the log"),
        (['tip_link=hand'], 'tip_link needs robot='),
        (['scene=/nowhere.yaml'], "no scene file '/nowhere.yaml'"),
        (['recording=b.mcap'], 'recording cannot be changed: --out names the log'),
        (['seed=-1'], 'seed is -1, expected 0 to'),
        (['on_timeout=hold'], "on_timeout is 'hold', expected servo_p above 0"),
        (['substeps=2', '--states', '/a'], '--states and --rename are for bags'),
        (['substeps=2', '--commands', '/a'], "has no messages on '/a'; its topics are"),
        (['substeps=2', '--commands', ARRAY], '--commands needs robot='),
        (['substeps=2', '--thresholds', '1', '-1', '1'], 'thresholds must be 3 numbers'),
        (['substeps=2', '--rename', 'a'], "--rename takes OLD=NEW, got 'a'"),
        (['substeps=2', '--out', '/nowhere/b.mcap'], '/nowhere/b.mcap cannot be written'),
    ],
    ids=lambda value: value[:40] if isinstance(value, str) else None,
)
def test_a_wrong_word_is_one_line_and_writes_nothing(
    words: Sequence[str],
    message: str,
    swing: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    log = tmp_path / 'a.mcap'
    log.write_bytes(swing.read_bytes())
    assert pfd_main(['replay', str(log), '--what-if', *words]) == 1
    said = capsys.readouterr()
    assert said.out == ''
    assert len(said.err.splitlines()) == 1
    assert message in said.err
    assert len(said.err) < 800
    assert [path.name for path in tmp_path.iterdir()] == ['a.mcap']


@pytest.mark.parametrize('option', ['--out', '--commands', '--plot'])
def test_options_of_what_if_need_it(
    option: str, swing: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert pfd_main(['replay', str(swing), option, 'a']) == 2
    assert capsys.readouterr().err == f'pfd replay: {option} requires --what-if\n'


def test_a_log_is_published_or_run_with_a_change(
    swing: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert pfd_main(['replay', str(swing), '--publish', '--what-if']) == 2
    assert 'pfd replay: --publish and --what-if exclude each other' in capsys.readouterr().err


def test_a_hole_in_the_states_is_not_simulated_through(swing: Path, tmp_path: Path) -> None:
    hostile = load(swing)
    last = hostile.on(STATES)[-1]
    # Without frames, whose times would be below the last state's.
    hostile.keep(lambda m: m is last or (m.sequence < 900 and m.topic != '/tf'))
    last.sequence += 1 << 30
    last.log_ns += 10_000 * 10**9
    path = hostile.save(tmp_path / 'a.mcap', closed=False)
    with pytest.raises(LogError, match='states are missing, but the stamp is'):
        what_if(path)
