# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node as its users meet it on topics: commands, outputs, ros2_control, two arms."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from itertools import cycle
import signal
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from ros_processes import JOINTS, MILLISECOND, Peer, Process, Processes, stamp_ns, trigger

import pfd_core as pfd
from pfd_ros.arm.engine import LARGEST as LARGEST_INPUT
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import OPTIONAL as OPTIONAL_OUTPUTS
from pfd_ros.arm.events import ROLES as ARM_ROLES
from pfd_ros.arm.settings import Settings
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


class Running(NamedTuple):
    """A node, and a peer that is connected to it."""

    process: Process
    peer: Peer


@pytest.fixture(scope='module')
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    """Return an arm for many tests, whose recording verifies in the end."""
    settings = ('recording:=arm.mcap', 'start_time:=100.0', 'frame_id:=base')
    settings = (*settings, 'external_wrench:=true')
    args = [*(part for one in settings for part in ('-p', one)), *DEPTHS]
    processes, peer = Processes(tmp_path_factory.mktemp('topics')), None
    try:
        process = processes.faulty('reports_often', *args)
        peer = Peer(processes.domain)
        peer.connect()
        yield Running(process, peer)
        process.stop()
        assert verify_log(processes.folder / 'arm.mcap').complete
    finally:
        if peer is not None:
            peer.close()
        processes.close()


def test_a_torque_goes_in_and_a_moving_arm_comes_out(arm) -> None:
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


def test_commands_are_taken_or_rejected_with_a_reason_on_a_topic_and_in_the_log(arm) -> None:
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
        *('wrong_size (1000 numbers for 6 joints)', f'bytes, expected {LARGEST_INPUT} at most'),
    ):
        arm.process.wait_for_text(text)
    assert max(map(len, arm.process.text().splitlines())) < 700
    peer.node.destroy_subscription(rejected)


def test_a_trajectory_of_efforts_moves_the_arm_from_point_to_point(arm) -> None:
    from builtin_interfaces.msg import Duration
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    peer = arm.peer
    points = [
        JointTrajectoryPoint(effort=[effort] * 6, time_from_start=Duration(nanosec=at * 10**8))
        for at, effort in ((1, 1.0), (3, 0.25))
    ]
    plan = JointTrajectory(joint_names=list(JOINTS), points=points)
    peer.send('/sim_arm/joint_trajectory', plan)
    peer.wait(lambda: peer.states[-1].effort.tolist() == [0.25] * 6)
    efforts = np.array([state.effort[0] for state in peer.states])
    assert ((efforts > 0.3) & (efforts < 0.95)).any()


def test_a_joint_without_a_command_is_braked_and_a_reset_brakes_all(arm) -> None:

    peer = arm.peer
    assert trigger(peer, 'reset').success
    peer.wait(lambda: not any(peer.states[-1].position))
    peer.command(['joint3'], [3.0])
    peer.wait(lambda: peer.states[-1].effort.tolist() == [0, 0, 3.0, 0, 0, 0])
    assert [bool(v) for v in peer.states[-1].velocity] == [k == 2 for k in range(6)]


def kind_of(package: str, name: str) -> Any:
    return getattr(import_module(f'{package}.msg'), name)


def test_a_simulation_that_overflows_is_logged_and_ends_the_node_with_status_1(
    processes, peer_of
) -> None:
    settings = ('effort_limits:=false', 'recording:=arm.mcap')
    arm = processes.faulty('reports_often', *(p for one in settings for p in ('-p', one)))
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
def test_a_stopped_reliable_reader_stops_neither_the_arm_nor_its_states(
    processes, peer_of
) -> None:
    arm = processes.arm('-p', 'real_time_factor:=100.0', '-p', 'step_size:=0.01')
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
def test_a_servo_holds_after_the_last_command_and_a_reflex_is_logged(processes, peer_of) -> None:
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
def test_readers_get_every_output_and_the_recording_verifies(processes, peer_of) -> None:
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


def test_a_misspelt_parameter_among_many_of_other_nodes_is_named(processes) -> None:
    others = [part for k in range(20) for part in ('-p', f'another_{k}:=1')]
    wrong = ('--ros-args', *others, '-p', 'step_siz:=0.002')
    process = processes.forked('pfd_ros.node.main', *wrong)
    assert process.end() == 1
    assert "unknown parameters ['step_siz']; similar names: ['step_size']" in process.text()


def test_diagnostics_are_of_one_plant_while_the_arm_takes_over_another() -> None:
    from pfd_ros.node.diagnostics import ArmDiagnostics, MassKernels
    from pfd_ros.node.inbox import Inbox
    from pfd_ros.node.report import Report
    from pfd_ros.node.stepping import Stepper

    class Changing(Engine):
        """An arm whose plant is another one whenever it is read."""

        plants_in_turn: Any = ()

        @property
        def plant(self) -> Any:
            return next(self.plants_in_turn) if self.plants_in_turn else self.first_plant

        @plant.setter
        def plant(self, plant: Any) -> None:
            self.first_plant = plant

    settings = Settings(robot='planar2')
    engine = Changing(settings, pfd.load_robot('planar2'))
    # As an input of native code, and as a constant.
    other = engine.plants.prepare(replace(settings, payload_mass=1.0))
    assert (bool(other.inputs), bool(engine.plant.inputs)) == (True, False)
    kernels, report = MassKernels(engine), Report(None)
    engine.plants_in_turn = cycle([engine.plant, other])
    stepper = Stepper(engine, Inbox(report.count), {}, report.count)
    graph = SimpleNamespace(mismatched=0, publishers={})
    diagnostics = ArmDiagnostics(stepper, graph, report, kernels)
    for _ in range(4):
        names = [status.name for status in diagnostics.tasks()]
        assert names == ['stepping', 'commands', 'simulation', 'recording']
