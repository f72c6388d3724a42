# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node as its users meet it on topics, and what it reports of other nodes and of itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from importlib import import_module
from itertools import cycle
import signal
import threading
import time
from types import SimpleNamespace
from typing import Any, NamedTuple

from arm_messages import tick
import gripper_arm
import numpy as np
import pytest
from ros_processes import (
    JOINTS,
    MILLISECOND,
    Peer,
    Process,
    Processes,
    description_publisher,
    qos,
    stamp_ns,
)

import pfd_core as pfd
from pfd_ros.arm.engine import LARGEST as LARGEST_INPUT
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import OPTIONAL as OPTIONAL_OUTPUTS
from pfd_ros.arm.events import ROLES as ARM_ROLES
from pfd_ros.arm.events import Verdict
from pfd_ros.arm.settings import Settings
from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.replay.verify import verify as verify_log

NAN, INF = float('nan'), float('inf')
ONE = [1.0] * 6
# Of the commands of the arm; at depth 1 a busy machine would see some replaced by newer ones.
DEPTHS = (
    'qos_overrides./joint_commands.subscription.depth:=20',
    'qos_overrides./sim_arm/commands.subscription.depth:=20',
)


class Running(NamedTuple):
    """A node, and a peer that is connected to it."""

    process: Process
    peer: Peer


def kind_of(package: str, name: str) -> Any:
    return getattr(import_module(f'{package}.msg'), name)


def test_a_simulation_that_overflows_is_logged_and_ends_the_node_with_status_1(processes, peer_of):
    settings = ('effort_limits:=false', 'recording:=arm.mcap')
    arm = processes.faulty('reports_often', *settings)
    peer = peer_of(processes)
    peer.connect()
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


READER = """
import rclpy
from sensor_msgs.msg import JointState
rclpy.init()
node = rclpy.create_node('reader')
node.create_subscription(JointState, 'joint_states', lambda _: print('heard', flush=True), 10)
rclpy.spin(node)
"""


@pytest.mark.slow
@pytest.mark.long
def test_a_stopped_reliable_reader_stops_neither_the_arm_nor_its_states(processes, peer_of):
    arm = processes.arm('real_time_factor:=100.0', 'step_size:=0.01')
    reader = processes.python('-c', READER)
    reader.wait_for_text('heard')
    reader.process.send_signal(signal.SIGSTOP)
    peer = peer_of(processes)
    peer.connect()
    first = stamp_ns(peer.states[-1])
    peer.wait(lambda: stamp_ns(peer.states[-1]) > first + 60_000 * MILLISECOND)
    arm.stop()
    reader.process.kill()


@pytest.mark.slow
def test_a_servo_holds_after_the_last_command_and_a_reflex_is_logged(processes, peer_of):
    joints = ('shoulder', 'elbow')
    gains = [f'servo_{k}.{joint}:={x}' for joint in joints for k, x in (('p', 50.0), ('d', 5.0))]
    arm = processes.faulty(
        *('reports_often', 'robot:=planar2', *gains, 'recording:=arm.mcap'),
        *('command_timeout:=0.2', 'on_timeout:=hold', 'reflex_effort_rate:=15000.0'),
    )
    peer = peer_of(processes)
    peer.connect()
    peer.command(joints, [], position=[0.1] * 2)
    peer.wait(lambda: np.any(peer.states[-1].effort))
    arm.wait_for_text('no command for 0.2 s (command_timeout): servos hold the position\n')
    # More than 18 N m from one step to the next, where 15 are allowed.
    peer.command(joints, [-18.0, 0.0])
    arm.wait_for_text("protective stop, all joints braked: the effort of 'shoulder' changed by")
    peer.let_pass()
    assert not np.any(peer.states[-1].effort)
    assert not np.any(peer.states[-1].velocity)
    arm.stop()
    assert verify_log(processes.folder / 'arm.mcap').complete


@pytest.mark.slow
def test_readers_get_every_output_and_the_recording_verifies(processes, peer_of):
    chosen = {
        'outputs': f'[{", ".join(OPTIONAL_OUTPUTS)}]',
        'noise.position': '0.001',
        'bias.position.shoulder': '0.5',
        'drop.state': '0.25',
        'seed': '7',
        'publish_rate': '200.0',
        'recording': 'arm.mcap',
    }
    arm = processes.arm('robot:=planar2', *(f'{name}:={value}' for name, value in chosen.items()))
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
        assert tuple(got[name][0].name) == ('shoulder', 'elbow')
    assert [d.size for d in got['inertia_matrix'][0].layout.dim] == [2, 2]
    assert len(got['tip_jacobian'][0].data) == 12
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


# Some rounds of reports of a node that reports often: a second finding would be among them.
ROUNDS_SECONDS = 0.6
# Relative error of accelerations of an ordinary arm in float64, far above its rounding.
ROUNDING = 1e-13


def reporting_often(processes: Processes, *ros_args: str) -> Process:
    return processes.faulty('reports_often', *ros_args)


def wait_for_reports(arm: Process) -> None:
    time.sleep(ROUNDS_SECONDS)
    assert arm.process.poll() is None


def test_topics_types_and_the_order_of_joints_are_logged_and_once_that_nobody_commands(processes):
    arm = reporting_often(
        *(processes, 'robot:=planar2', 'joints:=[elbow, shoulder]'),
        *('-r', '__ns:=/left', '-r', 'joint_commands:=effort', 'publish_clock:=false'),
    )
    for text in (
        '/left/effort (sensor_msgs/msg/JointState: name and effort)',
        '/left/sim_arm/commands (std_msgs/msg/Float64MultiArray: efforts in the order '
        'elbow, shoulder)',
        '/left/sim_arm/rejected (std_msgs/msg/String)',
        '/left/joint_states (sensor_msgs/msg/JointState)\n',
    ):
        assert text in arm.text()
    wanted = 'no publisher of commands on /left/effort (sensor_msgs/msg/JointState) or '
    arm.wait_for_text(wanted)
    wait_for_reports(arm)
    assert arm.text().count(wanted) == 1


def test_a_good_peer_causes_no_log_line(processes, peer_of):
    # Without gravity the arm stays where it is, however long the reports take.
    peer = peer_of(processes)
    arm = reporting_often(processes, 'robot:=planar2', 'gravity:=[0.0, 0.0, 0.0]')
    peer.connect()
    peer.command(['shoulder', 'elbow'], [0.0] * 2)
    wait_for_reports(arm)
    assert '[ERROR]' not in arm.text()
    # Only the machine may be too slow.
    warned = [line for line in arm.text().splitlines() if '[WARN]' in line]
    assert all('periods missed' in line for line in warned), arm.text()


def test_a_best_effort_publisher_is_named_with_the_parameter_that_helps(processes, peer_of):
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import JointState

    override = 'qos_overrides./joint_commands.subscription.reliability:=best_effort'
    arm = reporting_often(processes)
    peer = peer_of(processes)
    commands = peer.node.create_publisher(JointState, 'joint_commands', qos_profile_sensor_data)
    arm.wait_for_text("node '/peer' publishes /joint_commands with incompatible QoS")
    assert f'-p {override}' in arm.text()
    wait_for_reports(arm)
    assert arm.text().count('incompatible QoS') == 1
    arm.stop()
    arm = reporting_often(processes, override)

    def heard():
        commands.publish(JointState(name=['joint1'], effort=[1.0]))
        return bool(peer.states) and peer.states[-1].effort[0] == 1.0

    peer.wait(heard)
    wait_for_reports(arm)
    assert 'incompatible QoS' not in arm.text()


def test_nodes_that_disturb_the_arm_or_cannot_be_heard_are_named_once(processes, peer_of):
    import rclpy
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    arm = reporting_often(processes)
    peer, other = peer_of(processes), peer_of(processes, 'other')
    # A participant has one type for a topic, and a peer publishes commands itself.
    other.node.create_publisher(Float64MultiArray, '/joint_commands', 10)
    other.node.create_publisher(Float64MultiArray, '/sim_arm/commands', 10)
    other.node.create_publisher(Clock, '/clock', 10)
    # As the graph names a node that it does not know yet, or for good: not one of ROS.
    unnamed = rclpy.create_node('_NODE_NAME_UNKNOWN_', context=peer.context)
    twin = rclpy.create_node('sim_arm', context=peer.context, start_parameter_services=False)
    twin.create_publisher(JointState, 'joint_states', 10)
    for node in (peer.node, unnamed):
        node.create_subscription(JointState, 'joint_states', lambda state: None, qos())
    lines = (
        "node '/other/peer' publishes 'std_msgs/msg/Float64MultiArray' on /joint_commands, which "
        'has the type sensor_msgs/msg/JointState: no messages received; use /sim_arm/commands for '
        'this type',
        "node '/other/peer' publishes /clock too",
        'node of the same name publishes /joint_states too',
        "node '/peer' subscribes to /joint_states with incompatible QoS",
        "node '/_NODE_NAME_UNKNOWN_' subscribes to /joint_states with incompatible QoS",
        "2 nodes publish commands on /sim_arm/commands: ['/other/peer', '/peer']; the newest",
    )
    for line in lines:
        arm.wait_for_text(line)
    wait_for_reports(arm)
    assert [arm.text().count(line) for line in lines] == [1] * len(lines)


def test_diagnostics_report_each_task_of_the_node(processes, peer_of):
    from diagnostic_msgs.msg import DiagnosticArray
    from std_msgs.msg import String

    # At depth 1 a busy machine would see some commands replaced by newer ones.
    depth = 'qos_overrides./joint_commands.subscription.depth:=10'
    settings = ('recording:=arm.mcap', 'real_time_factor:=0.5', depth)
    arm = reporting_often(processes, *settings)
    peer = peer_of(processes)
    came: list[DiagnosticArray] = []
    peer.node.create_subscription(DiagnosticArray, '/diagnostics', came.append, 10)
    peer.connect()

    def of(task):
        (status,) = (one for one in came[-1].status if one.name == f'sim_arm: {task}')
        assert status.hardware_id == 'sim_arm'
        return status.level, status.message, {pair.key: pair.value for pair in status.values}

    def told(task, key):
        return of(task)[2].get(key, '') if came else ''

    peer.wait(lambda: len(came) > 1)
    level, message, values = of('lifecycle')
    assert (level, message) == (b'\x00', 'active')
    _, _, values = of('simulation')
    assert (values['robot'], values['integrator']) == ('puma560', 'rk4')
    # At rest, at 1 kHz: kp/kd below 2/T.
    assert float(values['kinetic_energy_J']) == 0.0
    assert 0.0 <= float(values['error_estimate']) < ROUNDING
    assert values['pd_limit.kp_over_kd'] == '2000'
    limits = np.array(values['pd_limit.kd'].split(), float)
    assert limits.shape == (6,)
    assert (limits > 0).all()
    _, message, values = of('stepping')
    assert float(values['step_p50_us']) <= float(values['step_p99_us'])
    assert float(values['requested_real_time_factor']) == 0.5
    assert 0.0 < float(values['real_time_factor']) < 1.0
    _, message, values = of('recording')
    assert (values['open'], message) == ('True', 'running')
    peer.wait(lambda: told('commands', 'joint_commands.publishers') == '/peer')
    assert of('commands')[0] == b'\x00'

    # A driver sends NaN until a controller has claimed the joint: that is no warning.
    peer.command(JOINTS, [float('nan')] * 6)
    peer.wait(lambda: told('commands', 'joint_commands.unclaimed') == '1')
    assert of('commands')[0] == b'\x00'
    # A foreign type, a wrong message, a name that is longer than any line.
    foreign = peer.node.create_publisher(String, '/sim_arm/set_state', 1)
    peer.wait(lambda: told('commands', 'endpoints_with_qos_or_type_mismatch') == '1')
    assert of('commands')[0] == b'\x01'
    assert told('commands', 'set_state.publishers') == '/peer'
    peer.node.destroy_publisher(foreign)
    peer.wait(lambda: told('commands', 'endpoints_with_qos_or_type_mismatch') == '0')
    peer.command(JOINTS, [1.0] * 5)
    peer.command(['x' * 10_000, '\n%s{0}'], [1.0, 1.0])
    peer.wait(lambda: told('commands', 'joint_commands.ragged') == '1')
    peer.wait(lambda: told('commands', 'joint_commands.unknown_names') == '1')
    peer.command(JOINTS, [1.0] * 6)
    peer.wait(lambda: told('commands', 'accepted') == '1')
    assert 0.0 <= float(told('commands', 'age_of_newest_s')) < 1000.0
    peer.wait(lambda: float(told('simulation', 'kinetic_energy_J')) > 0.0)

    def longer_period():
        peer.let_pass(3)
        peer.command(JOINTS, [1.0] * 6)
        return float(told('simulation', 'control_period_s')) > 0.0015

    # A controller that answers each third state has a longer period, and lower gains.
    peer.wait(longer_period)
    _, _, values = of('simulation')
    expected = 2.0 / float(values['control_period_s'])
    assert float(values['pd_limit.kp_over_kd']) == pytest.approx(expected, rel=1e-5)
    for status in came[-1].status:
        for text in (status.message, *(pair.value for pair in status.values)):
            assert len(text) < 250
            assert text.isprintable()
    arm.stop()


def test_a_model_that_does_not_come_is_waited_for_until_a_signal(processes, peer_of):
    # A volatile one comes before the node, and is lost.
    description_publisher(peer_of(processes), durability='volatile')('<robot/>')
    arm = processes.arm('robot:=robot_description', ready=False)
    arm.wait_for_text('waiting for the model on /robot_description')
    assert arm.end(signal.SIGINT) == 1
    assert 'no model received on /robot_description until the node was stopped' in arm.text()


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('joints: []', "/robot_description is not a URDF: it starts with 'joints: []'"),
        ('<' + 'a' * (1 << 24), 'bytes, expected 16777216 at most'),
        ('<robot>' * 100_000, 'elements more than 100 deep'),
        ('<robot', 'not well-formed XML'),
        (gripper_arm.urdf(joint_states_topic='{} %s'), 'Invalid topic name'),
    ],
    ids=['yaml', 'large', 'deep', 'cut', 'name'],
)
@pytest.mark.slow
def test_a_hostile_model_is_refused_in_one_line(processes, peer_of, text, reason):
    description_publisher(peer_of(processes))(text)
    arm = processes.arm('robot:=robot_description', 'locked:=[finger]', ready=False)
    assert arm.end() == 1
    (line,) = (line for line in arm.text().splitlines() if line.startswith('sim_arm: '))
    assert reason in line
    assert len(line) < 700


@pytest.mark.slow
def test_the_arm_takes_everything_from_the_topic_and_its_ros2_control(processes, peer_of):
    from sensor_msgs.msg import JointState

    peer = peer_of(processes, 'left')
    publish = description_publisher(peer)
    arm = processes.arm(
        *('-r', '__ns:=/left', 'robot:=robot_description', 'locked:=[finger]'),
        'recording:=arm.mcap',
        ready=False,
    )
    arm.wait_for_text('waiting for the model on /left/robot_description')
    publish(gripper_arm.urdf(joint_states_topic='seen'))
    arm.wait_for_text('until its first command')
    for text in (
        'joint_commands is /robot_joint_commands, from <ros2_control>',
        'joint_states is seen, from <ros2_control>',
        'initial_positions from <ros2_control>: [0.5, -0.25]',
        'locked_positions from <ros2_control>: [0.04]',
        'trigger_joint_command_threshold is 1e-05: the hardware compares',
    ):
        assert text in arm.text()
    states: list[JointState] = []
    peer.node.create_subscription(JointState, '/left/seen', states.append, 10)
    commands = peer.node.create_publisher(JointState, '/robot_joint_commands', 10)
    peer.wait(lambda: states and commands.get_subscription_count())
    assert states[0].name == [*gripper_arm.ARM, *gripper_arm.FINGERS]
    # The thumb mimics the locked finger.
    assert states[0].position.tolist() == [*gripper_arm.START, 0.04, -0.04]
    # A command for the finger, which is locked, has no effect.
    commands.publish(JointState(name=['elbow', 'finger'], effort=[1.0, 1.0]))
    peer.wait(lambda: states[-1].effort.tolist() == [0.0, 1.0, 0.0, 0.0])
    commands.publish(JointState(name=['finger'], effort=[1.0]))
    arm.wait_for_text('commands for locked joints have no effect: ')
    arm.wait_for_text('1 messages on /robot_joint_commands rejected: refused (locked: ')
    arm.stop()
    path = processes.folder / 'arm.mcap'
    assert verify_log(path).complete
    settings = RecordedLog(path).settings
    assert settings.initial_positions == gripper_arm.START
    assert settings.locks == {'finger': 0.04, 'thumb': -0.04}


@pytest.mark.slow
def test_remappings_and_parameters_count_before_the_ros2_control(processes, peer_of):
    from std_msgs.msg import Float64MultiArray, String

    (processes.folder / 'arm.urdf').write_text(gripper_arm.urdf())
    arm = processes.arm(
        *('robot:=arm.urdf', 'locked:=[finger]', 'locked_positions:=[0.0]'),
        *('initial_positions:=[1.0, 1.0]', '-r', 'joint_commands:=mine'),
        *('-r', '/robot_joint_states:=joint_states', 'publish_description:=true'),
        'command_topic:=/effort_controllers/commands',
    )
    for text in (
        'joint_commands is remapped to /mine, ignoring /robot_joint_commands of <ros2_control>',
        "initial positions of ['shoulder', 'elbow', 'finger'] differ between <ros2_control> and ",
        'subscribed to /mine (',
        '/effort_controllers/commands (std_msgs/msg/Float64MultiArray: efforts in the order ',
        '/joint_states (',
    ):
        assert text in arm.text()
    peer = peer_of(processes)
    texts: list[String] = []
    peer.node.create_subscription(String, 'robot_description', texts.append, qos())
    efforts = peer.node.create_publisher(Float64MultiArray, '/effort_controllers/commands', 10)
    peer.wait(lambda: peer.states and texts and efforts.get_subscription_count())
    assert texts[0].data == gripper_arm.urdf()
    assert peer.states[0].position.tolist() == [1.0, 1.0, 0.0, 0.0]
    efforts.publish(Float64MultiArray(data=[2.0, 3.0]))
    peer.wait(lambda: peer.states[-1].effort.tolist() == [2.0, 3.0, 0.0, 0.0])


@pytest.mark.ros
def test_the_reported_energy_excludes_gravity_compensation():
    from pfd_ros.arm.engine import Engine
    from pfd_ros.arm.settings import Settings
    from pfd_ros.node.diagnostics import MassKernels

    told = []
    for compensated in (False, True):
        more = {'gravity_compensation': True, 'external_wrench': True} if compensated else {}
        kernels = MassKernels(Engine(Settings(robot='planar2', **more), pfd.load_robot('planar2')))
        told.append(kernels.energy(np.array([0.3, -0.2]), np.ones(2)).tolist())
        assert 0.0 <= kernels.error_estimate(*np.ones((3, 2)), {}) < ROUNDING
    assert told[0] == told[1]
    assert all(told[0])


def test_a_misspelt_parameter_among_many_of_other_nodes_is_named(processes):
    others = [part for k in range(20) for part in ('-p', f'another_{k}:=1')]
    wrong = ('--ros-args', *others, '-p', 'step_siz:=0.002')
    process = processes.forked('pfd_ros.node.main', *wrong)
    assert process.end() == 1
    assert "unknown parameters ['step_siz']; similar names: ['step_size']" in process.text()


@pytest.mark.ros
def test_diagnostics_are_of_one_plant_while_the_arm_takes_over_another(monkeypatch):
    from pfd_ros.node.diagnostics import ArmDiagnostics, MassKernels
    from pfd_ros.node.inbox import COMPILATION, Inbox
    from pfd_ros.node.report import Report
    from pfd_ros.node.stepping import Stepper

    class Changing(Engine):
        """An arm whose plant is another one whenever it is read."""

        plants_in_turn: Any = ()

        @property
        def plant(self):
            return next(self.plants_in_turn) if self.plants_in_turn else self.first_plant

        @plant.setter
        def plant(self, plant):
            self.first_plant = plant

    settings = Settings(robot='planar2')
    engine = Changing(settings, pfd.load_robot('planar2'))
    # As an input of native code, and as a constant.
    other = engine.plants.prepare(replace(settings, payload_mass=1.0))
    assert (bool(other.inputs), bool(engine.plant.inputs)) == (True, False)
    kernels, report = MassKernels(engine, other), Report(None)
    engine.plants_in_turn = cycle([engine.plant, other])
    stepper = Stepper(engine, Inbox(report.count), {}, report.count)
    graph = SimpleNamespace(mismatched=0, publishers={})
    diagnostics, alone = ArmDiagnostics(stepper, graph, report, kernels), list[bool]()

    def compiled(*given):
        alone.append(COMPILATION.locked())
        return MassKernels(*given)

    monkeypatch.setattr('pfd_ros.node.diagnostics.MassKernels', compiled)
    for _ in range(4):
        names = [status.name for status in diagnostics.tasks()]
        assert names == ['stepping', 'commands', 'simulation', 'recording']
    assert {*alone} == {True}


@pytest.mark.ros
def test_an_arm_that_catches_up_with_a_followed_clock_has_not_lost_it():
    from pfd_ros.node.inbox import Inbox
    from pfd_ros.node.report import Report, report_arm
    from pfd_ros.node.stepping import Stepper

    settings = Settings(robot='planar2', time_source='clock', publish_clock=False)
    engine, lines = Engine(settings, pfd.load_robot('planar2')), list[str]()
    engine.step([tick(0), tick(9 * MILLISECOND)])
    report = Report(SimpleNamespace(warning=lines.append))
    stepper = Stepper(engine, Inbox(report.count), {}, report.count)
    stepper.started -= 100.0
    for expected in (0, 1):
        report_arm(report, stepper, SimpleNamespace(topic=str))
        assert [line[:36] for line in lines] == ['no new time on clock_ticks for 100 s'] * expected
        while not engine.waiting:
            engine.step()


@pytest.mark.ros
def test_a_change_is_prepared_for_the_arm_that_the_change_before_it_made():
    from pfd_ros.node.inbox import COMPILATION, Changes, Inbox

    inbox, stop, prepared = Inbox(print), threading.Event(), list[bool]()
    engine: Any = SimpleNamespace(prepare=lambda *_: prepared.append(COMPILATION.locked()))
    changes = Changes(engine, inbox, print, nullcontext)
    for data in (b'1', b'2'):
        changes.put('parameters', data)
    thread = threading.Thread(target=changes.run, args=(stop.is_set,))
    thread.start()
    for count in (1, 2):
        ((_, verdict),) = inbox.take(5.0)
        time.sleep(0.05)  # for the second one, if it were prepared at once
        # None of the diagnostics is compiled meanwhile.
        assert prepared == [True] * count
        verdict.set_result(Verdict('accepted'))
    stop.set()
    thread.join()


# One arm for several tests, the last ones: it runs until the module ends.


@pytest.fixture(scope='module')
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    """Return an arm for many tests, whose recording verifies in the end."""
    # Without damping it would run away in a minute, on a slow machine.
    settings = ('recording:=arm.mcap', 'start_time:=100.0', 'frame_id:=base', *DEPTHS)
    processes, peer = Processes(tmp_path_factory.mktemp('topics')), None
    try:
        process = processes.faulty(
            'reports_often', *settings, 'external_wrench:=true', 'damping:=true'
        )
        peer = Peer(processes.domain)
        peer.connect()
        yield Running(process, peer)
        process.stop()
        assert verify_log(processes.folder / 'arm.mcap').complete
    finally:
        if peer is not None:
            peer.close()
        processes.close()


def test_a_torque_goes_in_and_a_moving_arm_comes_out(arm):
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


# Label, names, efforts, and other fields, of messages that change nothing; test_arm_rules has all.
REJECTED: list[tuple[str, list[str], list[float], dict[str, Any]]] = [
    ('ragged', list(JOINTS), [1.0] * 5, {}),
    ('no_effort', list(JOINTS), [], {'velocity': ONE, 'position': ONE}),
    ('stale', list(JOINTS), ONE, {'stamp': 99}),
    *(('unknown_names', [name], [1.0], {}) for name in ('{0}', '%s%n', 'a\nb', 'x' * 10_000)),
]


def test_commands_are_taken_or_rejected_with_a_reason_on_a_topic_and_in_the_log(arm):
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
    peer.command(JOINTS, [NAN] * 6)
    wanted['joint_commands', 'all_nan'] += 1
    peer.let_pass(10)
    peer.plain_command([0.0] * 1000)
    peer.command(['x' * 1_000_000], [0.0])
    wanted |= Counter({('commands', 'wrong_size'): 1, ('joint_commands', 'malformed'): 1})
    peer.wait(lambda: len(heard) == sum(wanted.values()))
    assert Counter(tuple(text.split('\n')[0].split()) for text in heard) == wanted
    assert peer.states[-1].effort.tolist() == [2.0] * 6
    peer.command(['joint1', 'joint7', 'joint3', 'joint2'], [1.0, 7.0, 4.0, NAN], stamp=100)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [1.0, 2.0, 4.0, 2.0, 2.0, 2.0])
    peer.plain_command([0.6, 0.5, 0.4, 0.3, 0.2, 0.1])
    peer.wait(lambda: peer.states[-1].effort.tolist() == [0.6, 0.5, 0.4, 0.3, 0.2, 0.1])
    for text in (
        *('ragged (6 names and', 'no_effort (expected', 'unknown joints in messages'),
        *('all_nan (NaN for', "have NaN for ['joint2']: the last command is kept"),
        *('wrong_size (1000 numbers for 6 joints)', f'(more than {LARGEST_INPUT} bytes)'),
    ):
        arm.process.wait_for_text(text)
    assert max(map(len, arm.process.text().splitlines())) < 700
    peer.node.destroy_subscription(rejected)


def test_a_trajectory_of_efforts_moves_the_arm_from_point_to_point(arm):
    from builtin_interfaces.msg import Duration
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    peer = arm.peer
    points = [
        JointTrajectoryPoint(effort=[effort] * 6, time_from_start=Duration(nanosec=at * 10**8))
        # No number of the way from 0 to the first point, by steps of 0.01.
        for at, effort in ((1, 1.0), (3, 0.2525))
    ]
    plan = JointTrajectory(joint_names=list(JOINTS), points=points)
    peer.send('/sim_arm/joint_trajectory', plan)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [0.2525] * 6)
    efforts = np.array([state.effort[0] for state in peer.states])
    assert ((efforts > 0.3) & (efforts < 0.95)).any()
