# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd replay --what-if --commands` of bags: commands of any arm into the simulated one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from bags import STORE, rosbag2
from bridge import LogError, WhatIf, pfd_main, what_if, what_if_lines
import numpy as np
import pytest
from ros_processes import example_robot

import pfd_core as pfd
from pfd_ros import read_log

JOINT_STATE, FLOATS = 'sensor_msgs/msg/JointState', 'std_msgs/msg/Float64MultiArray'
NAMES = ('shoulder', 'elbow')
H = 1e-3
Q0, QD0 = np.array([0.3, -0.4]), np.array([0.5, 1.5])
# Rounding of a run of half a second; kernels with brakes and limits have other operations.
ROUNDING = 1e-11


class Sent(NamedTuple):
    """A message of a bag: its topic, its time and its stamp [s], and its contents."""

    topic: str
    time: float
    message: Any


def joint_state(
    time: float, names: Any = NAMES, position: Any = (), velocity: Any = (), effort: Any = ()
) -> Any:
    types = STORE.types
    at = round(time * 1e9)
    stamp = types['builtin_interfaces/msg/Time'](at // 10**9, at % 10**9)
    header = types['std_msgs/msg/Header'](stamp, '')
    arrays = (np.array(values, float) for values in (position, velocity, effort))
    return types[JOINT_STATE](header, list(names), *arrays)


def floats(*values: float) -> Any:
    layout = STORE.types['std_msgs/msg/MultiArrayLayout']([], 0)
    return STORE.types[FLOATS](layout, np.array(values, float))


def write(path: Path, sent: list[Sent]) -> Path:
    with rosbag2.Writer(path, version=9) as writer:
        connections: dict[str, Any] = {}
        for item in sent:
            kind = item.message.__msgtype__
            if item.topic not in connections:
                connections[item.topic] = writer.add_connection(item.topic, kind, typestore=STORE)
            data = bytes(STORE.serialize_cdr(item.message, kind))
            writer.write(connections[item.topic], round(item.time * 1e9), data)
    return path


def taus(count: int) -> np.ndarray:
    return np.random.default_rng(4).uniform(-5.0, 5.0, (count, 2))


def motion(rows: np.ndarray) -> pfd.Trajectory:
    """Return the motion of planar2 under efforts for each step."""
    sim = pfd.Simulator(pfd.load_robot('planar2'), step_size=H)
    sim.reset(Q0, QD0)
    return sim.rollout(rows)


def states(every: int, count: int, start: float) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    """Yield times, positions and velocities under `taus`, each of which acts so many steps."""
    found = motion(np.repeat(taus(count), every, axis=0))
    yield start, Q0, QD0
    for k in range(every - 1, len(found.q) - 1, every):
        yield start + (k + 1) * H, found.q[k], found.qd[k]


def own_bag(path: Path, start: float = 100.0, prefix: str = '', **more: Any) -> Path:
    """Write a bag of planar2 with states and efforts in one topic, 4 steps apart."""
    names = [f'{prefix}{name}' for name in NAMES]
    sent = [
        Sent('/joint_states', t, joint_state(t, names, q, qd, tau))
        for (t, q, qd), tau in zip(states(4, 120, start), taus(120), strict=True)
    ]
    return write(path, sent, **more)


def largest(found: WhatIf, field: str = 'position') -> float:
    sizes = [item.largest for item in found.divergences if item.field == field]
    assert len(sizes) == len(found.joints)
    return max(size for size in sizes if size is not None)


def run(path: Path, commands: str = '/joint_states', *words: str, **given: Any) -> WhatIf:
    return what_if(path, ['robot=planar2', *words], commands=commands, **given)


@pytest.mark.parametrize('start', [0.0, 100.0, 1.7e9])
def test_an_arm_that_is_the_recorded_one_follows_it(tmp_path: Path, start: float) -> None:
    found = run(own_bag(tmp_path / 'bag', start))
    assert found.states == 120
    assert found.joints == NAMES
    assert largest(found) < ROUNDING
    assert largest(found, 'velocity') < 100 * ROUNDING
    assert not found.rejected
    assert not found.skipped
    assert found.log == tmp_path / 'bag_what_if.mcap'
    assert pfd_main(['replay', str(found.log), '--verify']) == 0
    # Its stamps continue the clock of the bag, as far as a float of seconds has it.
    new = read_log(found.log)['/joint_states']
    assert new.time[0] == pytest.approx(max(start, H), abs=1e-6)
    np.testing.assert_array_equal(new.position[0], Q0)


def test_another_payload_diverges_as_in_a_simulation(tmp_path: Path) -> None:
    bag = own_bag(tmp_path / 'bag')
    found = run(bag, '/joint_states', 'payload.mass=0.5')
    scene = pfd.Scene(payload=pfd.Payload(0.5))
    sim = pfd.Simulator(pfd.load_robot('planar2'), scene, step_size=H)
    sim.reset(Q0, QD0)
    new = sim.rollout(np.repeat(taus(120), 4, axis=0)).q[3:-1:4]
    sizes = np.abs(new - read_log(bag)['/joint_states'].position[1:])
    rows = [item for item in found.divergences if item.field == 'position']
    np.testing.assert_allclose([row.largest for row in rows], sizes.max(axis=0), atol=1e-9)


def test_efforts_without_names_act_in_the_order_of_the_joints(tmp_path: Path) -> None:
    start, sent = 5.0, []
    for (t, q, qd), tau in zip(states(4, 120, start), taus(120), strict=True):
        sent.append(Sent('/states', t, joint_state(t + 77.0, NAMES[::-1], q[::-1], qd[::-1])))
        sent.append(Sent('/efforts', t, floats(*tau[::-1])))
    found = run(write(tmp_path / 'bag', sent), '/efforts', 'joints=[elbow, shoulder]')
    # Without stamps of the commands the times are the log's.
    assert largest(found) < ROUNDING
    assert found.joints == NAMES[::-1]
    assert 'times      log times of the messages' in what_if_lines(found)


def test_efforts_between_two_steps_act_from_the_next_one_on(tmp_path: Path) -> None:
    sent = [Sent('/s', 1.0, joint_state(1.0, position=Q0, velocity=QD0))]
    # In steps 1, 3 (two of them, of which the newer one acts) and 8.
    for t, tau in ((0.2, 1.0), (1.0011, 2.0), (1.0015, 3.0), (1.0062, -4.0)):
        sent.append(Sent('/c', t, joint_state(t, effort=[tau, -tau])))
    sent += [Sent('/s', t, joint_state(t, position=Q0, velocity=QD0)) for t in (1.0052, 1.012)]
    found = run(write(tmp_path / 'bag', sent), '/c')
    rows = np.array([1.0, 1.0, 3.0, 3.0, 3.0, 3.0, 3.0, -4.0, -4.0, -4.0, -4.0, -4.0])
    wanted = motion(np.stack([rows, -rows], axis=1)).q
    new = read_log(found.log)['/joint_states']
    np.testing.assert_allclose(new.position[1:13], wanted, atol=ROUNDING)
    np.testing.assert_array_equal(new.effort[1:13, 0], rows)
    # At 5.2 ms the new run is between two steps.
    between = 0.8 * wanted[4] + 0.2 * wanted[5]
    _, positions, _ = found.curves
    np.testing.assert_allclose(positions[1, 1], between, atol=ROUNDING)


def test_messages_are_put_in_the_order_of_their_stamps(tmp_path: Path) -> None:
    sent = [Sent('/c', t, joint_state(t, effort=tau)) for t, tau in zip([1, 1.004], taus(2))]  # noqa: B905
    sent.insert(0, Sent('/s', 1.0, joint_state(1.0, position=Q0, velocity=QD0)))
    # States come late in the log.
    late = [Sent('/s', 1.02 + t, joint_state(t, position=Q0)) for t in (1.002, 1.008)]
    found = run(write(tmp_path / 'bag', [*sent, *late]), '/c')
    assert 'times      stamps of the messages' in what_if_lines(found)
    new = read_log(found.log)['/joint_states']
    wanted = motion(np.repeat(taus(2), 4, axis=0)).q
    np.testing.assert_allclose(new.position[1:9], wanted, atol=ROUNDING)


def test_joints_without_a_command_stay_braked(tmp_path: Path) -> None:
    names = ['elbow', 'finger']
    sent = [Sent('/s', 1.0, joint_state(1.0, [*NAMES, 'finger'], [*Q0, 9.0], [0, 0, 0]))]
    sent += [Sent('/c', 1 + k * H, joint_state(1 + k * H, names, effort=[2, 5])) for k in range(9)]
    sent += [Sent('/s', 1.009, joint_state(1.009, [*NAMES, 'finger'], [*Q0, 9.0]))]
    found = run(write(tmp_path / 'bag', sent), '/c')
    assert found.only_in_log == ('finger',)
    new = read_log(found.log)['/joint_states']
    assert (new.position[:, 0] == Q0[0]).all()
    assert new.position[-1, 1] != Q0[1]


def test_messages_that_cannot_be_used_are_counted(tmp_path: Path) -> None:
    sent = [Sent('/s', 1.0, joint_state(1.0, position=Q0, velocity=QD0))]
    for k, effort in enumerate(([1.0, 2.0], [1.0], [np.inf, 1.0], [np.nan, 3.0], [4.0, 5.0])):
        sent.append(Sent('/c', 1 + k * H, joint_state(1 + k * H, effort=effort)))
    sent.append(Sent('/s', 1.008, joint_state(1.008, position=Q0)))
    found = run(write(tmp_path / 'bag', sent), '/c')
    assert found.skipped == {
        'efforts and names differ in number': 1,
        'efforts that are infinite': 1,
    }
    new = read_log(found.log)['/joint_states']
    assert new.effort[1:7].tolist() == [[1, 2]] * 3 + [[1, 3], [4, 5], [4, 5]]


def test_names_of_joints_are_replaced_from_their_beginning(tmp_path: Path) -> None:
    bag = own_bag(tmp_path / 'bag', prefix='left_')
    with pytest.raises(LogError, match=r"none of its joints \['left_shoulder', 'left_elbow'\]"):
        run(bag)
    found = run(bag, rename={'left_': ''})
    assert found.joints == NAMES
    assert largest(found) < ROUNDING


@pytest.mark.parametrize(
    ('sent', 'message'),
    [
        ([Sent('/c', 1.0, joint_state(1.0, effort=[1, 2]))], 'name the topic of the recorded'),
        ([Sent('/c', 1.0, STORE.types['std_msgs/msg/String']('x'))], 'is std_msgs/msg/String'),
        (
            [
                Sent('/s', 1.0, joint_state(1.0, position=[np.inf, 0])),
                Sent('/c', 1.0, joint_state(1.0, effort=[1, 2])),
                Sent('/s', 1.01, joint_state(1.01, position=[0, 0])),
            ],
            'set_state 1 is infinite',
        ),
        (
            [
                Sent('/s', 1.0, joint_state(1.0, position=[1e9, 0])),
                Sent('/c', 1.0, joint_state(1.0, effort=[1, 2])),
                Sent('/s', 1.01, joint_state(1.01, position=[0, 0])),
            ],
            'set_state 1 is refused',
        ),
        (
            [
                Sent('/s', 1.0, joint_state(1.0, position=[0, 0])),
                Sent('/c', 2.0, joint_state(2.0, ['a', 'b'], effort=[1, 2])),
            ],
            'has efforts for joints',
        ),
        (
            [
                Sent('/s', 1.0, joint_state(1.0, position=[0, 0])),
                Sent('/c', 1.0, joint_state(1.0, effort=[1, 2])),
                Sent('/c', 1.7e9, joint_state(1.7e9, effort=[1, 2])),
            ],
            'its clock was changed',
        ),
        (
            [
                Sent('/s', 1.0, joint_state(1.0, position=[0, 0])),
                Sent('/t', 1.0, joint_state(1.0, position=[0, 0])),
                Sent('/c', 1.0, joint_state(1.0, effort=[1, 2])),
            ],
            r"name the topic of the recorded states with --states; .*\['/s', '/t'\]",
        ),
    ],
)
def test_a_bag_that_cannot_be_used_is_refused_by_name(
    tmp_path: Path, sent: list[Sent], message: str
) -> None:
    bag = write(tmp_path / 'bag', sent)
    with pytest.raises(LogError, match=message):
        run(bag, '/c')
    assert [path.name for path in tmp_path.iterdir()] == ['bag']


def test_a_bag_without_a_topic_of_commands_is_no_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = own_bag(tmp_path / 'bag')
    assert pfd_main(['replay', str(bag), '--what-if', 'robot=planar2']) == 1
    line = f'pfd replay: {bag} is not a recording of this node: name a topic with --commands\n'
    assert capsys.readouterr().err == line


@pytest.mark.parametrize(
    ('name', 'robot', 'rename'),
    [
        ('panda_exciting_trajectory', 'panda', {'fer_': 'panda_'}),
        ('ur10_exciting_trajectory', 'ur_description/urdf/ur10_robot.urdf', {}),
    ],
)
def test_efforts_of_real_arms_act_at_their_times(
    real_arms: Path, tmp_path: Path, name: str, robot: str, rename: dict[str, str]
) -> None:
    bag = real_arms / name
    source = robot if robot == 'panda' else str(example_robot(robot))
    words = [f'robot={source}', 'effort_limits=false', 'torque_speed=false', 'integrator=rk4']
    found = what_if(bag, words, commands='/joint_states', rename=rename, out=tmp_path / 'new.mcap')
    recorded = read_log(bag)['/joint_states']
    assert found.states == len(recorded)
    assert not found.rejected
    assert not found.skipped
    assert not found.only_in_log
    assert not found.only_in_arm
    assert pfd_main(['replay', str(found.log), '--verify']) == 0
    # The first tenth of a second, by a simulator whose efforts this test holds.
    steps = np.arange(100)
    times = recorded.time - recorded.time[0]
    held = np.searchsorted(np.ceil(times / H - 1e-6), steps, 'right') - 1
    model = pfd.load_robot(source)
    order = [found.joints.index(joint) for joint in model.joint_names]
    sim = pfd.Simulator(model, step_size=H, integrator='rk4')
    sim.reset(recorded.position[0, order], recorded.velocity[0, order])
    wanted = sim.rollout(recorded.effort[held][:, order])
    new = read_log(found.log)['/joint_states']
    back = [new.names.index(joint) for joint in model.joint_names]
    np.testing.assert_allclose(new.position[1:101, back], wanted.q, atol=1e-9)
    # Position, velocity; the last tells nothing about the model, and is finite all the same.
    assert len(found.divergences) == 2 * len(found.joints)
    assert all(item.first_at is not None for item in found.divergences)
