# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The lifecycle of a real node, and its end: by signals, by faults, by what hangs."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import gripper_arm
import pytest
from ros_processes import (
    FAULTY,
    JOINTS,
    NODE,
    PATIENCE,
    Peer,
    Process,
    Processes,
    call,
    description_publisher,
    environment,
    parameter,
    set_parameters,
    stamp_ns,
    transition,
    trigger,
    wait_until,
)
from rosbags.typesys import Stores, get_typestore
from zoo import one_fast

from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.replay.verify import verify as verify_log

WAITS = ('autostart:=false',)


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


def test_an_arm_is_configured_moved_stopped_and_configured_again(processes, peer_of):
    node = waiting(processes, 'robot:=r2d2', 'recording:=a.mcap')
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
):
    settings = ('lockstep:=true', 'wait_for_controller:=true')
    node = waiting(processes, *settings, 'robot:=planar2')
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
):
    from rcl_interfaces.srv import GetParameters

    given = ('friction.joint2:=0.25', 'bias.effort.elbow:=0.5')
    node = waiting(processes, *given, 'robot:=planar2')
    peer = peer_of(processes)

    def value(name):
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


def test_each_configuration_takes_the_model_of_its_time(processes, peer_of):
    settings = ('robot:=robot_description', 'description_timeout:=0.5', 'locked:=[finger]')
    node = waiting(processes, *settings)
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


def test_shutdown_ends_the_process_with_a_closed_file(processes, peer_of):
    node = processes.arm('recording:=arm.mcap')
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


def test_a_fault_in_a_transition_is_logged_and_the_node_continues(processes, peer_of):
    node = waiting(processes, fault='configuring_fails')
    peer = peer_of(processes)
    assert not transition(peer, 'configure')
    assert state(peer) == 'unconfigured'
    assert node.end(signal.SIGTERM) == 1
    assert "configure failed: KeyError: '{0}'" in node.text()


def test_an_arm_that_answers_too_late_does_not_become_active(processes, peer_of):
    # What takes the request back is the second input.
    node = waiting(processes, 'robot:=planar2', fault='first_step_after_2')
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
    processes, peer_of, fault, status
):
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    settings = ('robot:=planar2', 'recording:=a.mcap')
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


def test_an_arm_that_cannot_be_started_is_cleaned_up(processes, peer_of):
    node, peer = waiting(processes, 'recording:=0.mcap', fault='starts_fail'), peer_of(processes)
    # One after the other, as far as a start comes.
    for k, error in enumerate(('parameters', 'setter', 'introduction', 'start'), 1):
        assert not transition(peer, 'configure')
        assert f'no {error}' in node.text()
        assert set_parameters(peer, parameter('recording', f'{k}.mcap'))[0]
    assert transition(peer, 'configure')
    assert transition(peer, 'activate')
    peer.connect()
    assert node.end(signal.SIGINT) == 0, node.text()
    assert 'too: subscribers receive both' not in node.text()
    for path in processes.folder.glob('*.mcap'):
        assert verify_log(path).complete


INT, TERM, HUP = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
STATUS_BASE = 128  # of a shell, for a process that a signal ended
HANGS = ['stub_hangs', 'stub_hangs_in_c']


@pytest.mark.parametrize('fault', HANGS)
def test_a_third_signal_ends_a_process_that_hangs(programs, fault):
    process = programs.python(FAULTY, fault)
    process.wait_for_text('steps')
    process.process.send_signal(INT)
    process.wait_for_text('hangs')
    process.process.send_signal(TERM)
    time.sleep(0.05)
    assert process.process.poll() is None
    # Signals that are pending together may come in another order.
    assert process.end(INT) in (STATUS_BASE + TERM, STATUS_BASE + INT)
    assert 'ended by a third signal' in process.text()


@pytest.mark.parametrize('reader', one_fast(['is gone', 'hangs'], 'hangs'))
def test_a_third_signal_ends_a_process_with_an_output_that_takes_no_line(reader):
    code = (
        'import time; from pfd_ros.node.main import stop_on_signals; stop_on_signals()\n'
        "print('waits', flush=True); time.sleep(1e3)"
    )
    reading, writing = os.pipe()
    if reader == 'is gone':
        os.close(reading)
    else:
        os.set_blocking(writing, False)
        with suppress(BlockingIOError):
            while True:
                os.write(writing, bytes(1 << 12))
        # The process has the same end of the pipe.
        os.set_blocking(writing, True)
    with subprocess.Popen(
        [sys.executable, '-c', code], stdout=subprocess.PIPE, stderr=writing
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == b'waits\n'
            for number in (INT, TERM, HUP):
                process.send_signal(number)
                time.sleep(0.05)
            assert process.wait(PATIENCE) - STATUS_BASE in (INT, TERM, HUP)
        finally:
            process.kill()


def test_two_signals_are_a_clean_end(programs):
    for second in (INT, TERM, HUP):
        process = programs.python(FAULTY, 'stub_ends')
        process.wait_for_text('steps')
        process.process.send_signal(INT)
        time.sleep(0.005)
        process.process.send_signal(second)
        assert process.process.wait(PATIENCE) == 0


def test_an_ignored_hangup_stays_ignored_and_an_ignored_interrupt_does_not(programs):
    # As under nohup, and as a shell starts a process in the background.
    output = programs.folder / 'output.txt'
    with output.open('wb') as stream:
        started = subprocess.Popen(
            ['sh', '-c', 'trap "" HUP INT; exec "$@"', '-', sys.executable, FAULTY, 'stub_ends'],
            env=environment(programs.domain),
            stdout=stream,
            stderr=stream,
        )
    process = Process(started, output)
    programs.started.append(process)
    process.wait_for_text('steps')
    started.send_signal(HUP)
    time.sleep(0.2)
    assert started.poll() is None
    assert process.end(INT) == 0


@pytest.mark.parametrize(
    ('fault', 'robot', 'text'),
    [
        ('teardown_hangs', 'planar2', ' s of simulated time: '),
        ('exit_hangs', 'nobody', "unknown robot 'nobody'"),
    ],
)
def test_a_hang_at_the_end_of_a_run_and_of_a_start_that_fails_is_ended_by_an_alarm(
    processes, fault, robot, text
):
    arm = processes.faulty(fault, f'robot:={robot}', ready=robot != 'nobody')
    assert arm.end(*[INT] * (robot != 'nobody')) in (-signal.SIGALRM, 1)
    assert text in arm.text()


# Ways to start the node, without the arguments for ROS.
STARTS = (('-m', 'pfd_ros.cli.main', 'sim'), NODE)
# Processes that start at the same time.
AT_ONCE = 4


def wait_for_handlers(process: Process) -> None:
    """Wait until a process handles SIGHUP and SIGTERM, which Python by itself does not."""
    wanted = sum(1 << number - 1 for number in (INT, TERM, HUP))

    def handled() -> bool:
        status = Path(f'/proc/{process.process.pid}/status').read_text(encoding='ascii')
        caught = int(next(line for line in status.splitlines() if 'SigCgt' in line).split()[1], 16)
        found = caught & wanted == wanted
        assert found or process.process.poll() is None, process.text()
        return found

    wait_until(handled)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize('count', [3, pytest.param(240, marks=pytest.mark.long)])
def test_a_signal_while_the_node_starts_ends_it_like_a_later_one(processes, count):
    def once(k):
        process = processes.python(*STARTS[k % len(STARTS)], '--ros-args', '-p', 'robot:=planar2')
        wait_for_handlers(process)
        # Each time with another delay, up to three seconds.
        time.sleep(3.0 * k / count)
        assert process.end((INT, TERM, HUP)[k % 3]) == 0, process.text()
        text = process.text()
        assert 'Traceback' not in text
        # The nodes that run at the same time may find each other, and miss periods.
        usual = ('[INFO]', 'of the same name', 'periods missed')
        assert all(any(part in line for part in usual) for line in text.splitlines()), text

    with ThreadPoolExecutor(AT_ONCE) as pool:
        list(pool.map(once, range(count)))


def test_the_handlers_of_signals_come_before_every_import_that_takes_long():
    # What `pfd sim` has imported by then: nothing but the standard library and these.
    code = (
        'import sys, pfd_ros.cli.main, pfd_ros.node.main\n'
        "print(*sorted(m for m in sys.modules if m.partition('.')[0] in"
        " ('pfd_ros', 'pfd_core', 'numpy', 'rclpy', 'llvmlite', 'mcap', 'yaml')))\n"
    )
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, check=True, timeout=PATIENCE
    )
    assert done.stdout.split() == [
        *('pfd_ros', 'pfd_ros.cli', 'pfd_ros.cli.main', 'pfd_ros.cli.terminal'),
        *(
            'pfd_ros.extras',
            'pfd_ros.node',
            'pfd_ros.node.main',
            'pfd_ros.text',
            'pfd_ros.view',
            'pfd_ros.view.ports',
        ),
    ]


@pytest.mark.parametrize(
    ('fault', 'text'),
    [
        ('executor_returns', 'the executor ended unexpectedly'),
        ('executor_fails', 'the executor failed: RuntimeError: 3 callbacks failed'),
        ('executor_exits', 'the executor failed: SystemExit: 0'),
        ('stepping_fails', "stepping failed: KeyError: '{0}'"),
        ('reporting_fails', "reporting failed: KeyError: '{0}'"),
        ('companion_fails', 'starting the companion failed: PermissionError: no view'),
    ],
)
@pytest.mark.slow
def test_a_thread_that_ends_ends_the_node_with_a_closed_file(processes, fault, text):
    arm = processes.faulty(fault, 'recording:=arm.mcap', ready=False)
    assert arm.process.wait(PATIENCE) == 1, arm.text()
    assert text in arm.text()
    # Of a cycle that failed some is in the state of the arm, and nothing in the file.
    assert verify_log(processes.folder / 'arm.mcap').complete == (fault != 'stepping_fails')


@pytest.mark.slow
def test_a_step_that_never_ends_is_logged_and_the_file_is_closed(processes, peer_of):

    arm = processes.faulty('stepping_hangs', 'recording:=arm.mcap')
    arm.wait_for_text('hangs')
    # Nobody knows whether it will be done.
    answer = trigger(peer_of(processes), 'reset')
    assert not answer.success
    assert 'no answer within 0.5 s' in answer.message
    assert arm.end(INT) == 1
    assert 'stepping did not end within 1 s' in arm.text()
    assert verify_log(processes.folder / 'arm.mcap').cycles == 200


def test_a_node_ends_after_the_native_code_that_it_compiles_and_logs(
    processes, peer_of, tmp_path, monkeypatch
):
    monkeypatch.setenv('PFD_CACHE', str(tmp_path / 'cache'))
    arm = processes.faulty('preparing_lasts', 'robot:=planar2')
    assert set_parameters(peer_of(processes), parameter('payload.mass', 1.0))[0]
    arm.wait_for_text('compiles')
    assert arm.end(INT) == 0
    assert 'has compiled' in arm.text()
    assert arm.text().count("Compiled native code for 'planar2' in ") == 2  # at the start, too


def test_a_callback_that_fails_is_counted_and_the_arm_still_receives(processes, peer_of):
    from std_srvs.srv import Trigger

    arm = processes.faulty('requests_fail')
    peer = peer_of(processes)
    peer.connect()
    client = peer.node.create_client(Trigger, '/sim_arm/reset')
    peer.wait(client.service_is_ready)
    for _ in range(3):
        client.call_async(Trigger.Request())
    arm.wait_for_text('callbacks failed, most recently by KeyError')
    peer.command(JOINTS, [1.0] * 6)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [1.0] * 6)
    arm.stop()
