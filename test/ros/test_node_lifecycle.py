# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The lifecycle of a real node: transitions that work, that fail, and that signals interrupt."""

from __future__ import annotations

from pathlib import Path
import signal

import gripper_arm
import pytest
from ros_processes import (
    JOINTS,
    PATIENCE,
    Peer,
    Process,
    Processes,
    call,
    description_publisher,
    parameter,
    set_parameters,
    stamp_ns,
    transition,
)
from rosbags.typesys import Stores, get_typestore

from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.replay.verify import verify as verify_log

pytestmark = pytest.mark.ros
WAITS = ('-p', 'autostart:=false')


def state(peer: Peer) -> str:
    from lifecycle_msgs.srv import GetState

    return str(call(peer, GetState, 'get_state').current_state.label)


def waiting(processes: Processes, *args: str, fault: str = '') -> Process:
    """Start a node that waits for transitions."""
    if fault:
        node = processes.faulty(fault, *WAITS, *args, ready=False)
    else:
        node = processes.arm(*WAITS, *args, ready=False)
    node.wait_for_text('waiting for lifecycle transitions')
    return node


def transitions(path: Path) -> list[tuple[int, str, str, str]]:
    """Return the recorded transitions: number, label, labels of start and goal."""
    store, found = get_typestore(Stores.ROS2_JAZZY), []
    for message in RecordedLog(path).messages():
        if message.role == 'transition_event':
            event = store.deserialize_cdr(message.data, 'lifecycle_msgs/msg/TransitionEvent')
            moved, ends = event.transition, (event.start_state, event.goal_state)
            found.append((moved.id, moved.label, *(end.label for end in ends)))
    return found


def test_an_arm_is_configured_moved_stopped_and_configured_again(processes, peer_of) -> None:
    node = waiting(processes, '-p', 'robot:=r2d2', '-p', 'recording:=a.mcap')
    peer = peer_of(processes)
    # A model that does not load, a transition that is not possible, one that does not exist.
    assert state(peer) == 'unconfigured'
    assert not transition(peer, 'configure')
    assert "configure failed: unknown robot 'r2d2'" in node.text()
    assert not transition(peer, 'activate')
    assert not transition(peer, '%s{0}')
    for number in (200, 255, 4):
        assert not transition(peer, number=number)
    assert state(peer) == 'unconfigured'
    node.wait_for_text('transitions refused, most recently 4 from the state unconfigured')
    assert 'RCLError' not in node.text()
    assert not (processes.folder / 'a.mcap').exists()

    assert set_parameters(peer, parameter('robot', 'puma560'))[0]
    assert transition(peer, 'configure')
    node.wait_for_text('each of the 6 joints is braked')
    successful, reason = set_parameters(peer, parameter('robot', 'ur5'))
    assert not successful
    assert "['robot'] cannot change until cleanup" in reason
    # Inactive: simulated time stands, commands are refused.
    peer.wait(peer.named.get_subscription_count)
    for _ in range(3):
        peer.command(JOINTS, [1.0] * 6)
        peer.executor.spin_once(timeout_sec=0.2)
    assert not peer.states
    node.wait_for_text('rejected: refused (the arm is inactive)')
    assert transition(peer, 'activate')
    peer.connect()
    peer.let_pass()
    assert not any(peer.states[-1].effort)

    peer.command(JOINTS, [1.0] * 6)
    peer.wait(lambda: any(peer.states[-1].velocity))
    assert transition(peer, 'deactivate')
    assert state(peer) == 'inactive'
    assert transition(peer, 'activate')
    stopped = len(peer.states)
    peer.let_pass()
    assert not any(peer.states[-1].velocity)
    assert not any(peer.states[-1].effort)
    stamps = [stamp_ns(one) for one in peer.states[stopped - 1 :]]
    assert stamps == sorted(stamps)

    assert transition(peer, 'deactivate')
    assert transition(peer, 'cleanup')
    # The file is closed and stays: the next arm needs another one.
    assert verify_log(processes.folder / 'a.mcap').complete
    assert transitions(processes.folder / 'a.mcap') == [
        (1, 'configure', 'unconfigured', 'inactive'),
        (3, 'activate', 'inactive', 'active'),
        (4, 'deactivate', 'active', 'inactive'),
        (3, 'activate', 'inactive', 'active'),
        (4, 'deactivate', 'active', 'inactive'),
    ]
    assert not transition(peer, 'configure')
    node.wait_for_text('a.mcap')
    assert set_parameters(peer, parameter('recording', 'b.mcap'))[0]
    assert transition(peer, 'configure')
    assert transition(peer, 'activate')
    peer.let_pass()
    peer.command(JOINTS, [1.0] * 6)
    peer.wait(lambda: any(peer.states[-1].velocity))
    node.stop()
    for name in ('a.mcap', 'b.mcap'):
        found = verify_log(processes.folder / name)
        assert found.complete
        assert found.compared['joint_states'] > 0


@pytest.mark.slow
def test_an_inactive_arm_in_lockstep_sends_nothing_and_does_not_ask_for_answers(
    processes, peer_of
) -> None:
    settings = ('-p', 'lockstep:=true', '-p', 'wait_for_controller:=true')
    node = waiting(processes, *settings, '-p', 'robot:=planar2')
    peer = peer_of(processes)
    assert transition(peer, 'configure')
    assert transition(peer, 'activate')
    peer.connect()
    assert transition(peer, 'deactivate')
    # Those that are on their way; then some periods in which an active arm would send.
    for _ in range(5):
        peer.executor.spin_once(timeout_sec=0.1)
    peer.states.clear()
    for _ in range(10):
        peer.executor.spin_once(timeout_sec=0.1)
    assert not peer.states
    assert transition(peer, 'activate')
    peer.let_pass(2)
    node.stop()


def test_each_configuration_has_the_parameters_of_its_robot_and_leaves_no_topic_behind(
    processes, peer_of
) -> None:
    from rcl_interfaces.srv import GetParameters

    given = ('-p', 'friction.joint2:=0.25', '-p', 'bias.effort.elbow:=0.5')
    node = waiting(processes, *given, '-p', 'robot:=planar2')
    peer = peer_of(processes)

    def value(name: str) -> float | None:
        answer = call(peer, GetParameters, 'get_parameters', names=[name])
        return answer.values[0].double_value if answer.values else None

    assert transition(peer, 'configure')
    assert value('bias.effort.elbow') == 0.5
    peer.wait(lambda: peer.node.count_subscribers('/joint_commands') == 1)
    assert transition(peer, 'activate')
    peer.connect()
    assert transition(peer, 'deactivate')
    assert transition(peer, 'cleanup')
    peer.wait(lambda: peer.node.count_subscribers('/joint_commands') == 0)
    assert set_parameters(peer, parameter('robot', 'puma560'))[0]
    assert transition(peer, 'configure')
    assert value('friction.joint2') == 0.25
    assert value('bias.effort.elbow') is None
    # Simulated time continues after a cleanup.
    seen = len(peer.states)
    assert transition(peer, 'activate')
    peer.wait(lambda: len(peer.states) > seen)
    for received in (peer.states, peer.clocks):
        stamps = [stamp_ns(one) for one in received]
        assert stamps == sorted(set(stamps))
    node.stop()


def test_each_configuration_takes_the_model_of_its_time(processes, peer_of) -> None:
    settings = ('robot:=robot_description', 'description_timeout:=0.5', 'locked:=[finger]')
    node = waiting(processes, *(part for one in settings for part in ('-p', one)))
    peer, topic = peer_of(processes), '/robot_joint_commands'
    assert not transition(peer, 'configure')
    assert 'configure failed: no model received on /robot_description within 0.5 s' in node.text()
    publish = description_publisher(peer)
    publish(gripper_arm.urdf())
    assert transition(peer, 'configure')
    peer.wait(lambda: peer.node.count_subscribers(topic) == 1)
    assert transition(peer, 'cleanup')
    publish(gripper_arm.urdf(joint_commands_topic='/others'))
    assert transition(peer, 'configure')
    peer.wait(lambda: peer.node.count_subscribers('/others') == 1)
    assert peer.node.count_subscribers(topic) == 0
    node.stop()


def test_shutdown_ends_the_process_with_a_closed_file(processes, peer_of) -> None:
    node = processes.arm('-p', 'recording:=arm.mcap')
    peer = peer_of(processes)
    peer.connect()
    assert state(peer) == 'active'
    assert transition(peer, 'deactivate')
    # By itself no arm starts twice: read-only parameters name the same file. A transition that
    # failed for good is no success.
    assert transition(peer, 'cleanup')
    assert not transition(peer, 'configure')
    assert transition(peer, 'shutdown')
    assert node.process.wait(PATIENCE) == 1
    assert node.text().count('configure failed: arm.mcap: the file exists') == 2
    assert verify_log(processes.folder / 'arm.mcap').complete


def test_a_fault_in_a_transition_is_logged_and_the_node_continues(processes, peer_of) -> None:
    node = waiting(processes, fault='configuring_fails')
    peer = peer_of(processes)
    assert not transition(peer, 'configure')
    assert state(peer) == 'unconfigured'
    assert node.end(signal.SIGTERM) == 1
    assert "configure failed: KeyError: '{0}'" in node.text()


def test_an_arm_that_answers_too_late_does_not_become_active(processes, peer_of) -> None:
    # What takes the request back is the second input.
    node = waiting(processes, '-p', 'robot:=planar2', fault='first_step_after_2')
    peer = peer_of(processes)
    assert transition(peer, 'configure')
    assert not transition(peer, 'activate')
    assert 'activate failed: the arm did not answer within 0.5 s' in node.text()
    peer.wait(peer.plain.get_subscription_count)
    peer.plain_command([1.0, 1.0])
    node.wait_for_text('rejected: refused (the arm is inactive)')
    assert transition(peer, 'activate')
    peer.let_pass(1)
    node.stop()


@pytest.mark.parametrize(('fault', 'status'), [('configuring_lasts', 0), ('configuring_hangs', 1)])
def test_a_signal_waits_for_the_transition_and_closes_the_file_before_the_next_one(
    processes, peer_of, fault: str, status: int
) -> None:
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    settings = ('-p', 'robot:=planar2', '-p', 'recording:=a.mcap')
    node, peer = waiting(processes, *settings, fault=fault), peer_of(processes)
    client = peer.node.create_client(ChangeState, '/sim_arm/change_state')
    peer.wait(client.service_is_ready)
    for label in ('configure', 'activate', 'deactivate', 'cleanup'):
        client.call_async(ChangeState.Request(transition=Transition(label=label)))
    node.wait_for_text('configures')
    assert node.end(signal.SIGINT) == status, node.text()
    assert ('a transition did not end within 1 s' in node.text()) == (status == 1)
    if status == 0:
        assert verify_log(processes.folder / 'a.mcap').complete


@pytest.mark.parametrize(
    ('fault', 'error'),
    [
        ('first_start_fails', "can't start new thread"),
        ('first_reading_fails', 'no parameters'),
        ('first_setter_fails', 'no setter'),
        ('first_introduction_fails', 'no introduction'),
    ],
)
def test_an_arm_that_cannot_be_started_is_cleaned_up(
    processes, peer_of, fault: str, error: str
) -> None:
    node = waiting(processes, '-p', 'recording:=a.mcap', fault=fault)
    peer = peer_of(processes)
    assert not transition(peer, 'configure')
    assert error in node.text()
    assert set_parameters(peer, parameter('recording', 'b.mcap'))[0]
    assert transition(peer, 'configure')
    assert transition(peer, 'activate')
    peer.connect()
    assert node.end(signal.SIGINT) == 0, node.text()
    assert 'too: subscribers receive both' not in node.text()
    for path in processes.folder.glob('*.mcap'):
        assert verify_log(path).complete
