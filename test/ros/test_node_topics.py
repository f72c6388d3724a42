# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node as its users meet it on topics: commands, outputs, ros2_control, two arms."""

from __future__ import annotations

from collections import Counter
from importlib import import_module
from pathlib import Path
import random
import signal
from typing import Any

from bridge import (
    ARM_ROLES,
    LARGEST_INPUT,
    OPTIONAL_OUTPUTS,
    RecordedLog,
    decode_string,
    verify_log,
)
import gripper_arm
import numpy as np
import pytest
from replicas import ControllerManager, State, TopicHardware
from ros_processes import JOINTS, MILLISECOND, READER, Peer, Process, Processes, call, stamp_ns

import pfd_core as pfd

pytestmark = pytest.mark.ros
NAN, INF = float('nan'), float('inf')
# Of the commands of the arm; at depth 1 a busy machine would see some replaced by newer ones.
DEPTHS = tuple(
    part
    for topic in ('joint_commands', 'sim_arm/commands')
    for part in ('-p', f'qos_overrides./{topic}.subscription.depth:=20')
)


def received(path: Path) -> Counter[str]:
    """Return how many inputs a recording holds, by role and label of the verdict."""
    found: Counter[str] = Counter()
    for message in RecordedLog(path).messages():
        if ARM_ROLES[message.role].kind == 'input':
            found[f'{message.role} accepted'] += 1
        elif message.role == 'rejected':
            kind = decode_string(message.data).partition('\n')[0]
            found[kind] += 1
            found[f'{kind.split()[0]} accepted'] -= 1
    return +found


def test_a_torque_goes_in_and_a_moving_arm_comes_out(processes: Processes, peer_of) -> None:
    processes.arm('-p', 'start_time:=3.0', '-p', 'frame_id:=base')
    peer = peer_of(processes)
    peer.connect()
    peer.let_pass()
    first = peer.states[0]
    assert (list(first.name), first.header.frame_id) == (list(JOINTS), 'base')
    assert first.position.tolist() == first.velocity.tolist() == first.effort.tolist() == [0] * 6
    assert stamp_ns(first) > 3_000_000_000
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


def test_every_kind_of_command_is_answered_as_the_rules_say(processes: Processes, peer_of) -> None:
    from std_msgs.msg import String

    arm = processes.arm('-p', 'recording:=arm.mcap', '-p', 'start_time:=100.0', *DEPTHS)
    peer = peer_of(processes)
    heard: list[str] = []
    peer.node.create_subscription(
        String, '/sim_arm/rejected', lambda message: heard.append(message.data), 50
    )
    peer.connect()
    peer.wait(lambda: peer.node.count_publishers('/sim_arm/rejected') == 1)
    one, zero, wanted = [1.0] * 6, [0.0] * 6, Counter()

    def send(label: str, *args, plain: bool = False, **other) -> None:
        if plain:
            peer.plain_command(*args)
        else:
            peer.command(*args, **other)
        wanted['commands' * plain or 'joint_commands', label] += 1
        peer.let_pass()

    send('all_nan', JOINTS, [NAN] * 6)
    send('no_effort', JOINTS, [], position=one)
    send('no_effort', JOINTS, [], velocity=one, position=one)
    send('no_names', [], one)
    send('ragged', JOINTS, [1.0] * 5)
    send('ragged', JOINTS, one, position=[0.0])
    send('infinite', JOINTS, [INF] + [0.0] * 5)
    send('stale', JOINTS, one, stamp=99)
    send('duplicate_names', ['joint1', 'joint1'], [1.0, 2.0])
    send('unknown_names', ['joint7'], [1.0])
    send('wrong_size', [1.0] * 7, plain=True)
    send('not_finite', [1.0, NAN, 1.0, 1.0, 1.0, 1.0], plain=True)
    held = peer.states[-1]
    assert held.position.tolist() == held.velocity.tolist() == held.effort.tolist() == zero
    send('accepted', ['joint3', 'joint7', 'joint1'], [3.0, 7.0, 1.0])
    peer.wait(lambda: peer.states[-1].effort.tolist() == [1.0, 0, 3.0, 0, 0, 0])
    assert [bool(v) for v in peer.states[-1].velocity] == [True, False, True, False, False, False]
    send('accepted', ['joint1', 'joint3', 'joint2'], [NAN, 4.0, NAN], stamp=100)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [1.0, 0, 4.0, 0, 0, 0])
    assert peer.states[-1].velocity[1] == 0
    send('ragged', JOINTS, [9.0] * 2)
    assert peer.states[-1].effort.tolist() == [1.0, 0, 4.0, 0, 0, 0]
    send('accepted', [0.6, 0.5, 0.4, 0.3, 0.2, 0.1], plain=True)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [0.6, 0.5, 0.4, 0.3, 0.2, 0.1])
    assert all(np.isfinite(state.position).all() for state in peer.states)
    quiet = {'accepted', 'all_nan'}
    rejected = {kind: count for kind, count in wanted.items() if kind[1] not in quiet}
    peer.wait(lambda: len(heard) == sum(rejected.values()))
    assert Counter(tuple(text.split('\n')[0].split()) for text in heard) == rejected
    assert arm.end(signal.SIGTERM) == 0
    for text in ('ragged (6 names and', 'no_effort (expected', 'unknown joints in messages'):
        assert text in arm.text()
    path = processes.folder / 'arm.mcap'
    assert verify_log(path).complete
    # An input that is all NaN is recorded, but no rejection.
    found = received(path)
    assert found.pop('joint_commands accepted') == 3
    assert found.pop('commands accepted') == 1
    assert found == {' '.join(kind): count for kind, count in rejected.items()}


@pytest.mark.slow
def test_names_of_any_kind_and_number_are_shown_short_and_change_nothing_else(
    processes: Processes, peer_of
) -> None:
    arm = processes.arm('-p', 'recording:=arm.mcap', *DEPTHS)
    peer = peer_of(processes)
    peer.connect()
    for names in (['{'], ['}'], ['{0}', 'joint1'], ['%s%n'], ['a\nb'], ['x' * 10_000]):
        peer.command(names, [0.0] * len(names))
        peer.let_pass()
    peer.plain_command([0.0] * 1000)
    arm.wait_for_text('wrong_size (1000 numbers for 6 joints)')
    peer.command(['x' * 1_000_000], [0.0])
    arm.wait_for_text(f'bytes, expected {LARGEST_INPUT} at most')
    peer.command(JOINTS, [1.0] * 6)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [1.0] * 6)
    arm.stop()
    assert "'{0}'" in arm.text()
    assert max(map(len, arm.text().splitlines())) < 700
    path = processes.folder / 'arm.mcap'
    assert verify_log(path).complete
    assert received(path) == {
        'joint_commands accepted': 2,
        'joint_commands unknown_names': 5,
        'joint_commands malformed': 1,
        'commands wrong_size': 1,
    }


@pytest.mark.slow
def test_bytes_of_any_kind_on_any_topic_do_not_stop_the_arm(processes: Processes, peer_of) -> None:
    arm = processes.arm('-p', 'recording:=arm.mcap', '-p', 'external_wrench:=true')
    peer = peer_of(processes)
    peer.connect()
    from rclpy.qos import DurabilityPolicy, QoSProfile

    topics = ('joint_commands', 'commands', 'set_state', 'external_wrench', 'payload')
    ends = []
    for role in topics:
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
    arm.wait_for_text('rejected: malformed (')
    count = len(peer.states)
    peer.wait(lambda: len(peer.states) > count + 10)
    assert arm.end(signal.SIGINT) in (0, 1), arm.text()
    assert 'Traceback' not in arm.text()
    assert 'unexpectedly' not in arm.text()
    assert verify_log(processes.folder / 'arm.mcap').complete


def kind_of(package: str, name: str) -> Any:
    return getattr(import_module(f'{package}.msg'), name)


def test_a_state_that_overflows_is_logged_once_and_the_node_continues(
    processes: Processes, peer_of
) -> None:
    arm = processes.arm('-p', 'recording:=arm.mcap', '-p', 'effort_limits:=false')
    peer = peer_of(processes)
    peer.connect()
    peer.command(JOINTS, [1e300] * 6)
    arm.wait_for_text('simulation stopped')
    peer.let_pass(100)
    last = peer.states[-1]
    assert stamp_ns(last) == stamp_ns(peer.states[-50])
    assert np.isfinite([last.position, last.velocity, last.effort]).all()
    assert arm.end(signal.SIGINT) == 1
    assert arm.text().count('simulation stopped') == 1
    assert 'the simulation failed before the end' in arm.text()
    assert verify_log(processes.folder / 'arm.mcap').complete


def test_one_joint_of_an_arm_that_has_run_away_is_not_set_and_the_node_continues(
    processes: Processes, peer_of
) -> None:
    from sensor_msgs.msg import JointState
    from std_srvs.srv import Trigger

    settings = ('lockstep:=true', 'wait_for_controller:=true', 'effort_limits:=false')
    settings = (*settings, 'substeps:=1', 'recording:=arm.mcap')
    arm = processes.arm(*(part for one in settings for part in ('-p', one)))
    peer = peer_of(processes)
    peer.wait(peer.named.get_subscription_count)
    peer.command(JOINTS, [1e40] * 6)
    peer.wait(lambda: peer.states and abs(peer.states[-1].position[0]) > 1e10)
    jumps = peer.node.create_publisher(JointState, '/sim_arm/set_state', 1)
    peer.wait(jumps.get_subscription_count)
    jumps.publish(JointState(name=['joint4'], position=[0.0]))
    arm.wait_for_text('messages on /sim_arm/set_state rejected: refused (')
    assert call(peer, Trigger, 'reset').success
    peer.wait(lambda: not any(peer.states[-1].position))
    arm.stop()
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
    arm = processes.arm(
        *(part for pair in gains for part in pair),
        *('-p', 'armature:=true', '-p', 'torque_speed:=true', '-p', 'recording:=arm.mcap'),
        *('-p', 'command_timeout:=0.2', '-p', 'on_timeout:=hold'),
        *('-p', 'reflex_effort_rate:=50000.0'),
    )
    peer = peer_of(processes)
    peer.connect()
    peer.command(JOINTS, [], position=[0.1] * 6)
    peer.let_pass(100)
    assert np.any(peer.states[-1].effort)
    # It names the parameter of the stock hardware that is silent while nothing changes.
    arm.wait_for_text('no command for 0.2 s (command_timeout): servos hold the position; ')
    arm.wait_for_text('trigger_joint_command_threshold')
    peer.let_pass(1500)
    held = np.array(peer.states[-1].position)
    assert np.abs(peer.states[-1].velocity).max() < 1e-3
    peer.let_pass(200)
    np.testing.assert_allclose(peer.states[-1].position, held, atol=1e-4)
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


ARM = gripper_arm.ARM
EFFORTS = dict.fromkeys((*ARM, 'finger'), ('effort',))
GOAL = np.array([0.3, 0.4])
PERIOD = 10 * MILLISECOND


def arm_with(processes: Processes, *args: str, **params: str) -> Process:
    (processes.folder / 'arm.urdf').write_text(gripper_arm.urdf(**params))
    return processes.arm('-p', 'robot:=arm.urdf', '-p', 'locked:=[finger]', *args)


def managed(peer: Peer, hardware: TopicHardware) -> ControllerManager:
    """Return a controller manager whose hardware is connected."""
    manager = ControllerManager(peer, hardware, PERIOD)
    manager.start()
    peer.wait(lambda: hardware.latest.name and hardware.publisher.get_subscription_count())
    return manager


def computed_torque(robot: pfd.Robot):
    """Return a controller that holds GOAL; its fingers push without effect."""

    def update(states: State) -> State:
        q, qd = ([states[joint][kind] for joint in ARM] for kind in ('position', 'velocity'))
        qdd = 100.0 * (GOAL - q) - 20.0 * np.array(qd)
        efforts = pfd.inverse_dynamics(robot, q, qd, qdd).tolist()
        return {
            joint: {'effort': effort}
            for joint, effort in zip((*ARM, 'finger'), (*efforts, 1.0), strict=True)
        }

    return update


def off(hardware: TopicHardware) -> float:
    """Return how far the arm is off the goal, or on its way at 1 rad/s."""
    q, qd = ([hardware.states[joint][kind] for joint in ARM] for kind in ('position', 'velocity'))
    return float(np.abs([np.array(q) - GOAL, qd]).max())


@pytest.mark.slow
def test_a_controller_manager_with_the_stock_hardware_brings_the_arm_to_its_goal(
    processes: Processes, peer_of
) -> None:
    arm = arm_with(processes, '-p', 'recording:=arm.mcap', trigger_joint_command_threshold='-1')
    peer = peer_of(processes)
    hardware = TopicHardware(peer, EFFORTS, threshold=-1.0)
    manager = managed(peer, hardware)
    # No controller has claimed the joints: NaN is sent, and the brakes hold them.
    manager.run(20)
    assert hardware.sent == 20
    assert [hardware.states[joint]['position'] for joint in ARM] == list(gripper_arm.START)
    # On a busy machine the arm runs on while the manager waits, and then it takes longer.
    manager.update = computed_torque(pfd.load_robot(gripper_arm.urdf(), locked={'finger': 0.04}))
    peer.wait(lambda: manager.run(20) or off(hardware) < 5e-3)
    assert hardware.states['finger'] == {'position': 0.04, 'velocity': 0.0, 'effort': 0.0}
    # A controller of efforts writes zeros when it is deactivated.
    manager.update = lambda states: {joint: {'effort': 0.0} for joint in EFFORTS}
    peer.wait(lambda: manager.run(20) or off(hardware) > 0.05)
    assert [hardware.states[joint]['effort'] for joint in ARM] == [0.0, 0.0]
    assert manager.times == sorted(manager.times)
    arm.stop()
    for text in ('messages on', 'unknown', 'trigger_joint_command_threshold'):
        assert text not in arm.text()
    assert verify_log(processes.folder / 'arm.mcap').complete


@pytest.mark.slow
def test_hardware_with_the_default_threshold_sends_nothing_at_a_steady_effort_and_the_arm_runs(
    processes: Processes, peer_of
) -> None:
    arm = arm_with(processes, '-p', 'gravity:=[0.0, 0.0, 0.0]')
    assert 'sends none while an effort is steady' in arm.text()
    peer = peer_of(processes)
    hardware = TopicHardware(peer, dict.fromkeys(ARM, ('effort',)))
    manager = managed(peer, hardware)
    manager.update = lambda states: {'shoulder': {'effort': 0.5}, 'elbow': {'effort': -0.25}}
    peer.wait(lambda: manager.run(1) or hardware.states['shoulder']['effort'] == 0.5)
    sent, before = hardware.sent, hardware.states['shoulder']['velocity']
    manager.run(30)
    assert hardware.sent == sent
    assert hardware.states['elbow']['effort'] == -0.25
    assert hardware.states['shoulder']['velocity'] != before
    # A cycle in which the effort changes is heard.
    manager.update = lambda states: {'shoulder': {'effort': 0.25}, 'elbow': {'effort': -0.25}}
    manager.run(1)
    assert hardware.sent == sent + 1


def test_ragged_arrays_of_joints_with_different_interfaces_are_dropped_and_counted(
    processes: Processes, peer_of
) -> None:
    arm = arm_with(processes)
    peer = peer_of(processes)
    interfaces = {'shoulder': ('position', 'effort'), 'elbow': ('effort',)}
    hardware = TopicHardware(peer, interfaces, threshold=-1.0)
    manager = managed(peer, hardware)
    manager.update = lambda states: {
        'shoulder': {'position': 0.0, 'effort': 1.0},
        'elbow': {'effort': 1.0},
    }
    manager.run(20)
    arm.wait_for_text('ragged (2 names and 1 numbers in position)')
    assert [hardware.states[joint]['velocity'] for joint in ARM] == [0.0, 0.0]


@pytest.mark.slow
def test_two_arms_in_two_namespaces_receive_nothing_from_each_other(
    processes: Processes, peer_of
) -> None:
    processes.arm('-r', '__ns:=/left', ready=False)
    right = processes.arm('-r', '__ns:=/right', '-p', 'publish_clock:=false')
    peers = [peer_of(processes, name) for name in ('left', 'right')]
    for peer in peers:
        peer.connect()
    peers[0].command(JOINTS, [1.0] * 6)
    peers[0].wait(lambda: any(peers[0].states[-1].effort))
    peers[1].let_pass()
    assert peers[1].states[-1].effort.tolist() == [0] * 6
    peers[1].plain_command([2.0] * 6)
    peers[1].wait(lambda: peers[1].states[-1].effort.tolist() == [2.0] * 6)
    peers[0].let_pass()
    assert peers[0].states[-1].effort.tolist() == [1.0] * 6
    # One clock: it belongs to the left arm and continues without the right one.
    assert right.end(signal.SIGINT) == 0
    count = len(peers[0].clocks)
    peers[0].wait(lambda: len(peers[0].clocks) > count + 10)


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
