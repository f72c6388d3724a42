# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node as its users meet it on topics: commands, outputs, ros2_control, two arms."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from importlib import import_module
import random
import signal
from typing import Any

import gripper_arm
import numpy as np
import pytest
from ros_processes import (
    JOINTS,
    MILLISECOND,
    READER,
    Processes,
    Running,
    running,
    stamp_ns,
    trigger,
)

from pfd_ros.arm.engine import LARGEST as LARGEST_INPUT
from pfd_ros.arm.events import OPTIONAL as OPTIONAL_OUTPUTS
from pfd_ros.arm.events import ROLES as ARM_ROLES
from pfd_ros.replay.verify import verify as verify_log

pytestmark = pytest.mark.ros
NAN, INF = float('nan'), float('inf')
ONE = [1.0] * 6
# Of the commands of the arm; at depth 1 a busy machine would see some replaced by newer ones.
DEPTHS = tuple(
    part
    for topic in ('joint_commands', 'sim_arm/commands')
    for part in ('-p', f'qos_overrides./{topic}.subscription.depth:=20')
)


@pytest.fixture(scope='module')
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    """Return an arm for many tests, whose recording verifies in the end."""
    settings = ('recording:=arm.mcap', 'start_time:=100.0', 'frame_id:=base')
    settings = (*settings, 'external_wrench:=true')
    args = [*(part for one in settings for part in ('-p', one)), *DEPTHS]
    with running(tmp_path_factory.mktemp('topics'), *args) as found:
        yield found


def test_a_torque_goes_in_and_a_moving_arm_comes_out(arm: Running) -> None:
    peer = arm.peer
    first = peer.states[0]
    assert (list(first.name), first.header.frame_id) == (list(JOINTS), 'base')
    assert first.position.tolist() == first.velocity.tolist() == first.effort.tolist() == [0] * 6
    assert stamp_ns(first) > 100_000_000_000
    peer.command(JOINTS, [2.0] * 6)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [2.0] * 6)
    peer.let_pass()
    assert all(peer.states[-1].velocity)
    stamps = [stamp_ns(state) for state in peer.states]
    assert all(step % MILLISECOND == 0 and step > 0 for step in np.diff(stamps))
    ticks = [stamp_ns(clock) for clock in peer.clocks]
    assert len(ticks) > 1
    assert all(tick % MILLISECOND == 0 for tick in ticks)
    assert ticks == sorted(ticks)


# Label, names, efforts, and other fields, of messages that change nothing.
REJECTED: list[tuple[str, list[str], list[float], dict[str, Any]]] = [
    ('no_effort', list(JOINTS), [], {'position': ONE}),
    ('no_effort', list(JOINTS), [], {'velocity': ONE, 'position': ONE}),
    ('no_names', [], ONE, {}),
    ('ragged', list(JOINTS), [1.0] * 5, {}),
    ('ragged', list(JOINTS), ONE, {'position': [0.0]}),
    ('infinite', list(JOINTS), [INF] + [0.0] * 5, {}),
    ('stale', list(JOINTS), ONE, {'stamp': 99}),
    ('duplicate_names', ['joint1', 'joint1'], [1.0, 2.0], {}),
    *(('unknown_names', [name], [1.0], {}) for name in ('joint7', '{', '{0}', '%s%n', 'a\nb')),
    ('unknown_names', ['x' * 10_000], [1.0], {}),
]


def test_every_kind_of_command_is_answered_as_the_rules_say(arm: Running) -> None:
    from std_msgs.msg import String

    peer, heard = arm.peer, list[str]()
    rejected = peer.node.create_subscription(
        String, '/sim_arm/rejected', lambda message: heard.append(message.data), 50
    )
    peer.wait(lambda: peer.node.count_publishers('/sim_arm/rejected') == 1)
    peer.plain_command([2.0] * 6)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [2.0] * 6)
    wanted: Counter[tuple[str, ...]] = Counter()
    for label, names, effort, other in REJECTED:
        peer.command(names, effort, **other)
        wanted['joint_commands', label] += 1
        peer.let_pass(10)
    # All NaN is no command, and no rejection.
    peer.command(JOINTS, [NAN] * 6)
    peer.let_pass(10)
    for label, effort in (
        ('wrong_size', [1.0] * 7),
        ('wrong_size', [0.0] * 1000),
        ('not_finite', [1.0, NAN, 1.0, 1.0, 1.0, 1.0]),
    ):
        peer.plain_command(effort)
        wanted['commands', label] += 1
        peer.let_pass(10)
    peer.command(['x' * 1_000_000], [0.0])
    wanted['joint_commands', 'malformed'] += 1
    peer.wait(lambda: len(heard) == sum(wanted.values()))
    assert Counter(tuple(text.split('\n')[0].split()) for text in heard) == wanted
    assert peer.states[-1].effort.tolist() == [2.0] * 6
    peer.command(['joint3', 'joint7', 'joint1'], [3.0, 7.0, 1.0])
    peer.wait(lambda: peer.states[-1].effort.tolist() == [1.0, 2.0, 3.0, 2.0, 2.0, 2.0])
    peer.command(['joint1', 'joint3', 'joint2'], [NAN, 4.0, NAN], stamp=100)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [1.0, 2.0, 4.0, 2.0, 2.0, 2.0])
    peer.plain_command([0.6, 0.5, 0.4, 0.3, 0.2, 0.1])
    peer.wait(lambda: peer.states[-1].effort.tolist() == [0.6, 0.5, 0.4, 0.3, 0.2, 0.1])
    for text in (
        *('ragged (6 names and', 'no_effort (expected', 'unknown joints in messages'),
        *('wrong_size (1000 numbers for 6 joints)', f'bytes, expected {LARGEST_INPUT} at most'),
    ):
        arm.process.wait_for_text(text)
    assert max(map(len, arm.process.text().splitlines())) < 700
    peer.node.destroy_subscription(rejected)


def test_a_trajectory_of_efforts_moves_the_arm_from_point_to_point(arm: Running) -> None:
    from builtin_interfaces.msg import Duration
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    peer, topic = arm.peer, '/sim_arm/joint_trajectory'
    publisher = peer.node.create_publisher(JointTrajectory, topic, 1)
    peer.wait(publisher.get_subscription_count)
    points = [
        JointTrajectoryPoint(effort=[effort] * 6, time_from_start=Duration(nanosec=at * 10**8))
        for at, effort in ((1, 1.0), (3, 0.25))
    ]
    publisher.publish(JointTrajectory(joint_names=list(JOINTS), points=points))
    peer.wait(lambda: peer.states[-1].effort.tolist() == [0.25] * 6)
    efforts = np.array([state.effort[0] for state in peer.states])
    assert ((efforts > 0.3) & (efforts < 0.95)).any()


def test_a_joint_without_a_command_is_braked_and_a_reset_brakes_all(arm: Running) -> None:

    peer = arm.peer
    assert trigger(peer, 'reset').success
    peer.wait(lambda: not any(peer.states[-1].position))
    peer.command(['joint3'], [3.0])
    peer.wait(lambda: peer.states[-1].effort.tolist() == [0, 0, 3.0, 0, 0, 0])
    assert [bool(v) for v in peer.states[-1].velocity] == [k == 2 for k in range(6)]


def test_bytes_of_any_kind_on_any_topic_do_not_stop_the_arm(arm: Running) -> None:
    from rclpy.qos import DurabilityPolicy, QoSProfile

    peer, ends = arm.peer, []
    for role in ('joint_commands', 'commands', 'set_state', 'external_wrench', 'payload'):
        package, _, kind = ARM_ROLES[role].type.split('/')
        topic = ARM_ROLES[role].topic.replace('~', '/sim_arm')
        latched = ARM_ROLES[role].latched
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        profile = QoSProfile(depth=10, durability=durability)
        ends.append(peer.node.create_publisher(kind_of(package, kind), topic, profile))
    peer.wait(lambda: all(end.get_subscription_count() for end in ends))
    chance = random.Random(7)
    for k in range(300):
        # A header of plain CDR, and bytes of which many are lengths that no message has.
        data = bytes(chance.choices((0, 1, 255, chance.randrange(256)), k=chance.randrange(200)))
        ends[k % len(ends)].publish(b'\0\1\0\0' + data + bytes(-len(data) % 4))
        peer.executor.spin_once(timeout_sec=0.01)
    for end in ends:
        peer.node.destroy_publisher(end)
    arm.process.wait_for_text('rejected: malformed (')
    peer.let_pass(10)
    assert 'Traceback' not in arm.process.text()


def kind_of(package: str, name: str) -> Any:
    return getattr(import_module(f'{package}.msg'), name)


def test_an_arm_that_runs_away_takes_no_state_of_one_joint_and_a_reset_restarts_it(
    processes: Processes, peer_of
) -> None:
    from sensor_msgs.msg import JointState

    settings = ('lockstep:=true', 'wait_for_controller:=true', 'effort_limits:=false')
    settings = (*settings, 'substeps:=1', 'recording:=arm.mcap')
    arm = processes.faulty('reports_often', *(p for one in settings for p in ('-p', one)))
    peer = peer_of(processes)
    peer.wait(peer.named.get_subscription_count)
    peer.command(JOINTS, [1e40] * 6)
    peer.wait(lambda: peer.states and abs(peer.states[-1].position[0]) > 1e10)
    jumps = peer.node.create_publisher(JointState, '/sim_arm/set_state', 1)
    peer.wait(jumps.get_subscription_count)
    jumps.publish(JointState(name=['joint4'], position=[0.0]))
    arm.wait_for_text('messages on /sim_arm/set_state rejected: refused (')
    assert trigger(peer, 'reset').success
    peer.wait(lambda: not any(peer.states[-1].position))
    # A state that overflows: the last finite one is sent on.
    peer.command(JOINTS, [1e300] * 6)
    arm.wait_for_text('simulation stopped')
    peer.let_pass(3)
    last = peer.states[-1]
    assert np.isfinite([last.position, last.velocity, last.effort]).all()
    assert arm.end(signal.SIGINT) == 1
    assert arm.text().count('simulation stopped') == 1
    assert 'the simulation failed before the end' in arm.text()
    assert verify_log(processes.folder / 'arm.mcap').complete


@pytest.mark.slow
@pytest.mark.long
def test_a_stopped_reliable_reader_stops_neither_the_arm_nor_its_states(
    processes: Processes, peer_of
) -> None:
    arm = processes.arm('-p', 'real_time_factor:=100.0', '-p', 'step_size:=0.01')
    reader = processes.python(READER)
    reader.wait_for_text('heard')
    reader.process.send_signal(signal.SIGSTOP)
    peer = peer_of(processes)
    peer.connect()
    first = stamp_ns(peer.states[-1])
    peer.wait(lambda: stamp_ns(peer.states[-1]) > first + 60_000 * MILLISECOND)
    arm.stop()
    reader.process.kill()


@pytest.mark.slow
def test_a_servo_holds_after_the_last_command_and_a_reflex_is_logged(
    processes: Processes, peer_of
) -> None:
    gains = [
        ('-p', f'servo_{kind}.{joint}:={gain}')
        for joint in JOINTS
        for kind, gain in (('p', '500.0'), ('d', '50.0'))
    ]
    arm = processes.faulty(
        'reports_often',
        *(part for pair in gains for part in pair),
        *('-p', 'armature:=true', '-p', 'torque_speed:=true', '-p', 'recording:=arm.mcap'),
        *('-p', 'command_timeout:=0.2', '-p', 'on_timeout:=hold'),
        *('-p', 'reflex_effort_rate:=50000.0'),
    )
    peer = peer_of(processes)
    peer.connect()
    peer.command(JOINTS, [], position=[0.1] * 6)
    peer.wait(lambda: np.any(peer.states[-1].effort))
    # It names the parameter of the stock hardware that is silent while nothing changes.
    arm.wait_for_text('no command for 0.2 s (command_timeout): servos hold the position; ')
    arm.wait_for_text('trigger_joint_command_threshold')
    # 180 N m from one step to the next, where 50 are allowed.
    peer.command(JOINTS, [0.0, -180.0, 0.0, 0.0, 0.0, 0.0])
    arm.wait_for_text("protective stop, all joints braked: the effort of 'joint2' changed by")
    peer.let_pass()
    assert not np.any(peer.states[-1].effort)
    assert not np.any(peer.states[-1].velocity)
    arm.stop()
    assert verify_log(processes.folder / 'arm.mcap').complete


@pytest.mark.slow
def test_readers_get_every_output_and_the_recording_verifies(
    processes: Processes, peer_of
) -> None:
    chosen = {
        'outputs': f'[{", ".join(OPTIONAL_OUTPUTS)}]',
        'noise.position': '0.001',
        f'bias.position.{JOINTS[0]}': '0.5',
        'drop.state': '0.25',
        'seed': '7',
        'publish_rate': '200.0',
        'recording': 'arm.mcap',
    }
    arm = processes.arm(*(p for k, v in chosen.items() for p in ('-p', f'{k}:={v}')))
    peer = peer_of(processes)
    got: dict[str, list[Any]] = {name: [] for name in OPTIONAL_OUTPUTS}
    for name in OPTIONAL_OUTPUTS:
        package, _, kind = ARM_ROLES[name].type.split('/')
        peer.node.create_subscription(
            kind_of(package, kind), f'sim_arm/{name}', got[name].append, 10
        )
    peer.connect()
    peer.wait(lambda: all(got.values()) and len(got['true_states']) > 40)
    arm.stop()

    for name in ('external_torques', 'bias_torques', 'gravity_torques', 'true_states'):
        assert tuple(got[name][0].name) == JOINTS
    assert [d.size for d in got['inertia_matrix'][0].layout.dim] == [6, 6]
    assert len(got['tip_jacobian'][0].data) == 36
    # A brake holds the joints: values in joint_states other than 0 are sensor errors.
    assert not any(got['true_states'][-1].position)
    assert all(abs(state.position[0] - 0.5) < 0.01 for state in peer.states)
    assert any(state.position[0] != 0.5 for state in peer.states)
    true = {stamp_ns(message) for message in got['true_states']}
    measured = {stamp_ns(message) for message in peer.states}
    assert len(true & measured) < len(true)
    found = verify_log(processes.folder / 'arm.mcap')
    assert found.complete
    assert found.compared['joint_states'] < found.compared['true_states']


@pytest.mark.slow
def test_topics_of_a_urdf_follow_the_namespace_unless_they_are_absolute(
    processes: Processes, peer_of
) -> None:
    text = gripper_arm.urdf(joint_commands_topic='commands', joint_states_topic='/shared/states')
    (processes.folder / 'arm.urdf').write_text(text)
    override = 'qos_overrides./right/commands.subscription.reliability:=best_effort'
    args = ('-p', 'robot:=arm.urdf', '-p', 'locked:=[finger]')
    left = processes.faulty('reports_often', *args, '-r', '__ns:=/left', ready=False)
    right = processes.faulty(
        'reports_often',
        *(*args, '-r', '__ns:=/right', '-p', 'publish_clock:=false', '-p', override),
    )
    left.wait_for_text('until its first command')
    assert 'subscribed to /left/commands (' in left.text()
    assert 'subscribed to /right/commands (' in right.text()
    # A mistake: one absolute topic for the states of both.
    right.wait_for_text(
        "node '/left/sim_arm' publishes /shared/states too: subscribers receive both"
    )
    peer = peer_of(processes, 'right')
    for side, reliability in (('left', 'RELIABLE'), ('right', 'BEST_EFFORT')):
        topic = f'/{side}/commands'
        peer.wait(lambda topic=topic: peer.node.get_subscriptions_info_by_topic(topic))
        (info,) = peer.node.get_subscriptions_info_by_topic(topic)
        assert info.qos_profile.reliability.name == reliability
    assert left.end(signal.SIGINT) == right.end(signal.SIGINT) == 0
