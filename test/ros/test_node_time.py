# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated time of a real node: its services, the standard ones, lockstep, a followed clock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import importlib.util
import json
import os
from pathlib import Path
import signal
import time
from typing import Any

from answering import DAMPING, STIFFNESS
import numpy as np
import pytest
from ros_processes import (
    MILLISECOND,
    NODE,
    Peer,
    call,
    parameter,
    set_parameters,
    stamp_ns,
    transition,
    trigger,
    with_flags,
)

from pfd_ros.messages.joints import decode_joints
from pfd_ros.messages.values import decode_string
from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.replay.verify import verify as verify_log
from pfd_ros.testing import LockstepArm

ARM = ('robot:=planar2', 'recording:=arm.mcap', 'gravity:=[0.0, 0.0, 0.0]')
START = ('initial_positions:=[0.3, -0.2]',)
LOCKSTEP = ('lockstep:=true', 'real_time_factor:=0.0')
FOLLOWS = ('time_source:=clock', 'publish_clock:=false')
NAMES = ('shoulder', 'elbow')
SECOND = 1000 * MILLISECOND
# Looks of 0.1 s at most in which no state came.
QUIET_LOOKS = 5


def pause(peer: Peer, wanted: bool) -> Any:
    from std_srvs.srv import SetBool

    return call(peer, SetBool, 'pause', data=wanted)


def stamps(messages: Sequence[Any]) -> list[int]:
    return [stamp_ns(message) for message in messages]


def recorded(path: Path, *roles: str) -> list[Any]:
    """Return the recorded messages of some roles."""
    return [message for message in RecordedLog(path).messages() if message.role in roles]


def jump(peer: Peer, position: Sequence[float], arrived: Callable[[], bool]) -> None:
    """Ask for a state once a second until it has arrived: a first message may come too early."""
    from sensor_msgs.msg import JointState

    publisher = peer.node.create_publisher(JointState, '/sim_arm/set_state', 1)
    message = JointState(name=list(NAMES), position=list(position))
    due = [0.0]

    def asked() -> bool:
        if time.monotonic() >= due[0]:
            due[0] = time.monotonic() + 1.0
            publisher.publish(message)
        return arrived()

    peer.wait(asked)


def settled(peer: Peer) -> None:
    """Wait until no state has come for a while."""
    count, quiet = -1, 0
    for _ in range(1000):
        quiet = quiet + 1 if len(peer.states) == count else 0
        count = len(peer.states)
        if quiet == QUIET_LOOKS:
            return
        # One call may be over at once, for a tick or a service.
        peer.executor.spin_once(timeout_sec=0.1)
    raise AssertionError('states still come')


def check_never_back(peer: Peer) -> None:
    """No state and no tick is earlier than the one before it."""
    assert (np.diff(stamps(peer.states)) >= 0).all()
    assert (np.diff(stamps(peer.clocks)) >= 0).all()


def test_pause_step_reset_and_jump_while_a_controller_runs(processes, peer_of):
    arm = processes.arm(*ARM, *START, 'step_count:=7')
    peer = peer_of(processes)
    peer.connect()
    # It pulls with all its might, and every command is stamped with the state it answers.
    processes.forked('answering').wait_for_text('answers')
    peer.wait(lambda: any(peer.states[-1].velocity))

    assert pause(peer, True).success
    settled(peer)
    before = stamp_ns(peer.states[-1])
    told = trigger(peer, 'step')
    assert (told.success, told.message.startswith('accepted: step')) == (True, True)
    peer.wait(lambda: stamp_ns(peer.states[-1]) == before + 7 * MILLISECOND)
    settled(peer)
    assert stamp_ns(peer.states[-1]) == before + 7 * MILLISECOND
    assert pause(peer, False).success
    assert 'refused: step: the arm is not paused' in trigger(peer, 'step').message

    assert trigger(peer, 'reset').success
    peer.let_pass(20)
    # Farther than the controller lets the arm go by itself.
    jump(peer, [1.0, -1.5], lambda: peer.states[-1].position[0] > 0.6)
    peer.let_pass(20)
    check_never_back(peer)
    arm.stop()
    path = processes.folder / 'arm.mcap'
    assert verify_log(path).complete
    # The peer does not get every state; the recording has them.
    states = [decode_joints(message.data) for message in recorded(path, 'joint_states')]
    accepted = {message.role: message.cycle for message in recorded(path, 'set_state', 'requests')}
    refused = recorded(path, 'rejected')
    assert any(message.data[8:].startswith(b'requests refused') for message in refused)
    resets = [m.cycle for m in recorded(path, 'requests') if b'reset' in m.data]
    for cycle, place in ((resets[-1], [0.3, -0.2]), (accepted['set_state'], [1.0, -1.5])):
        there, after = states[cycle - 1], states[cycle]
        assert there.position.tolist() == place
        assert not any(there.velocity)
        # An effort that answered a state before the jump would show at once.
        assert np.abs(after.position - place).max() < 1e-3


def test_a_request_for_many_steps_is_done_to_its_end_and_services_answer_meanwhile(
    processes, peer_of
):
    # A step lasts ten seconds of wall time, until another factor counts at once.
    slow = ('step_size:=0.1', 'real_time_factor:=0.01', 'start_time:=5.0', 'step_count:=1234')
    arm = processes.arm(*ARM, *slow)
    peer = peer_of(processes)
    for _ in range(3):
        assert trigger(peer, 'step').message.startswith('refused')
        assert pause(peer, True).message == 'accepted: pause; simulated time 5.0 s'
        assert pause(peer, False).success
    assert pause(peer, True).success
    assert set_parameters(peer, parameter('real_time_factor', 0.0))[0]
    assert trigger(peer, 'step').success
    last = 5 * SECOND + 1234 * 100 * MILLISECOND
    peer.wait(lambda: peer.states and stamp_ns(peer.states[-1]) == last)
    settled(peer)
    assert stamp_ns(peer.states[-1]) == last
    arm.stop()
    assert verify_log(processes.folder / 'arm.mcap').cycles == 1234


@pytest.mark.slow
def test_lockstep_repeats_an_unanswered_state_and_goes_on_with_the_next_answer(processes, peer_of):
    arm = processes.faulty('reports_often', *ARM, *START, *LOCKSTEP)
    peer = peer_of(processes)
    peer.connect()
    controller = processes.forked('answering')
    controller.wait_for_text('answers')
    peer.wait(lambda: any(peer.states[-1].velocity))
    controller.process.kill()
    controller.process.wait()
    settled_at = 0
    while settled_at != stamp_ns(peer.states[-1]):
        settled_at = stamp_ns(peer.states[-1])
        peer.let_pass(2)
    # The same state again and again, never a step on an old command.
    peer.let_pass(3)
    assert stamp_ns(peer.states[-1]) == settled_at
    arm.wait_for_text('s of waiting for commands in lockstep, now for the state at t = ')
    # Services answer while nobody does, and a pause in lockstep ends with an answer only.
    assert pause(peer, True).success
    assert pause(peer, False).success
    assert trigger(peer, 'reset').success
    peer.wait(lambda: peer.states[-1].position.tolist() == [0.3, -0.2])
    assert not any(peer.states[-1].velocity)
    assert stamp_ns(peer.states[-1]) == settled_at + MILLISECOND
    # A stamp of another clock is no answer.
    peer.command(NAMES, [1.0, 1.0], stamp=1_700_000_000)
    arm.wait_for_text('messages on /joint_commands rejected: future (')
    assert 'use_sim_time' in arm.text()
    assert not any(peer.states[-1].effort)
    processes.forked('answering').wait_for_text('answers')
    peer.wait(lambda: stamp_ns(peer.states[-1]) > settled_at + 400 * MILLISECOND)
    check_never_back(peer)
    arm.stop()
    path = processes.folder / 'arm.mcap'
    assert verify_log(path).complete
    assert len(recorded(path, 'joint_commands')) > 300


def test_in_lockstep_an_answer_with_the_stamp_of_the_state_before_is_taken_in_the_end(
    processes, peer_of
):
    # The hardware of ros2_control stamps with a clock of its own, which may lag by a tick; then
    # its controller manager waits for the next one. The arm takes its command a little later.
    arm = processes.faulty('reports_often', *ARM, *START, *LOCKSTEP)
    peer = peer_of(processes)
    peer.connect()
    controller = processes.forked('answering', 'lagging')
    controller.wait_for_text('answers')
    peer.wait(lambda: any(peer.states[-1].velocity))
    first = stamp_ns(peer.states[-1])
    peer.wait(lambda: stamp_ns(peer.states[-1]) >= first + 5 * MILLISECOND)
    arm.wait_for_text('commands taken late in lockstep')
    controller.process.kill()
    arm.stop()
    path = processes.folder / 'arm.mcap'
    assert verify_log(path).complete
    rejected = [m.data for m in recorded(path, 'rejected')]
    assert len(rejected) >= 5
    assert all(b'joint_commands stale' in data for data in rejected)


def test_a_lockstep_run_has_the_bits_of_the_arm_in_tests(processes, peer_of):
    arm = processes.arm(
        *('robot:=planar2', 'recording:=a.mcap', 'noise.position:=0.01'),
        *(*START, *LOCKSTEP, 'wait_for_controller:=true'),
    )
    controller = processes.forked('answering')
    peer = peer_of(processes)
    peer.wait(lambda: peer.states and stamp_ns(peer.states[-1]) > SECOND // 5)
    controller.process.kill()
    controller.process.wait()
    assert arm.end(signal.SIGINT) == 0, arm.text()
    paths = [processes.folder / name for name in ('a.mcap', 'b.mcap')]
    assert verify_log(paths[0]).complete
    settings = {'noise_position': 0.01, 'initial_positions': AT, 'torque_speed': False}
    with LockstepArm('planar2', recording=paths[1], **settings) as same:
        same.run(lambda t, q, qd: -STIFFNESS * q - DAMPING * qd, 0.2)
    over_topics, here = ([m.data for m in recorded(x, 'joint_states')][:200] for x in paths)
    assert len(here) == 200
    assert over_topics == here


class Leader:
    """A publisher of `/clock` in the hands of the test."""

    def __init__(self, peer: Peer) -> None:
        from rosgraph_msgs.msg import Clock

        self._kind = Clock
        self._publisher = peer.node.create_publisher(Clock, '/clock', 10)
        peer.wait(lambda: self._publisher.get_subscription_count() > 1)

    def tick(self, stamp: int) -> None:
        message = self._kind()
        message.clock.sec, message.clock.nanosec = divmod(stamp, SECOND)
        self._publisher.publish(message)


@pytest.mark.slow
def test_an_arm_follows_a_clock_forwards_only_and_logs_its_loss(processes, peer_of):
    settings = (*FOLLOWS, 'recording:=arm.mcap', 'step_size:=0.002')
    arm = processes.faulty('reports_often', *settings)
    peer = peer_of(processes)
    leader = Leader(peer)
    start = 490 * SECOND

    def reaches(stamp):
        def there():
            # Best effort: a tick may be lost.
            leader.tick(stamp)
            return bool(peer.states) and stamp_ns(peer.states[-1]) > stamp - 2 * MILLISECOND

        peer.wait(there)

    def begins():
        begun.append(start + len(begun) * MILLISECOND)
        leader.tick(begun[-1])
        return bool(peer.states)

    # The first tick that comes is where time begins; the next ones are stepped to.
    begun: list[int] = []
    peer.wait(begins)
    assert start < stamp_ns(peer.states[0]) <= begun[-1]
    start += 100 * SECOND // 10
    reaches(start + 100 * MILLISECOND)
    for wrong, text in (
        (start, 'messages on /clock rejected: stale (the clock is at 500.0 s and was at'),
        (start + 3600 * SECOND, 'more than 100000 steps behind: call ~/reset to set its time'),
    ):
        seen = len(peer.states)

        def refused(stamp=wrong, line=text):
            leader.tick(stamp)
            return line in arm.text()

        peer.wait(refused)
        assert len(peer.states) == seen
    reaches(start + 200 * MILLISECOND)
    assert (np.diff(stamps(peer.states)) > 0).all()
    assert set(np.diff(stamps(peer.states)) % (2 * MILLISECOND)) == {0}
    arm.wait_for_text(' s: simulation paused until one is received')
    arm.stop()
    path = processes.folder / 'arm.mcap'
    assert verify_log(path).complete
    found = [message.data[8:] for message in recorded(path, 'rejected')]
    for label in (b'stale', b'refused'):
        assert any(text.startswith(b'clock_ticks ' + label) for text in found)


@pytest.mark.slow
def test_two_arms_on_one_clock_have_the_same_stamps_and_separate_commands(processes, peer_of):
    follower = processes.faulty(
        'reports_often', *FOLLOWS, '-r', '__ns:=/right', 'recording:=right.mcap', ready=False
    )
    leader = processes.arm('-r', '__ns:=/left', 'recording:=left.mcap')
    peers = [peer_of(processes, name) for name in ('left', 'right')]
    for peer in peers:
        peer.connect()
    # Neither arm receives what is sent to the other.
    for peer, other, effort in ((*peers, 1.0), (*peers[::-1], 2.0)):
        peer.plain_command([effort] * 6)
        peer.wait(lambda p=peer, e=effort: p.states[-1].effort.tolist() == [e] * 6)
        other.let_pass(5)
        assert other.states[-1].effort.tolist() == [0.0 if effort == 1.0 else 1.0] * 6
    peers[1].let_pass(200)
    # Its clock ends, and it stands at a time that the leader has reached.
    assert leader.end(signal.SIGINT) == 0, leader.text()
    follower.wait_for_text('simulation paused until one is received')
    assert follower.end(signal.SIGINT) == 0, follower.text()
    found = {}
    for name in ('left', 'right'):
        path = processes.folder / f'{name}.mcap'
        assert verify_log(path).complete
        found[name] = [decode_joints(m.data).stamp_ns for m in recorded(path, 'joint_states')]
    assert len(found['right']) > 200
    assert set(found['right']) <= set(found['left'])
    assert set(np.diff(found['right'])) == {MILLISECOND}


@pytest.mark.slow
def test_the_time_of_day_continues_across_a_restart_with_a_live_reader(processes, peer_of):
    peer = peer_of(processes)
    for name in ('a.mcap', 'b.mcap'):
        before = time.time_ns()
        arm = processes.arm('start_time:=-1.0', f'recording:={name}')
        seen = len(peer.clocks)
        peer.wait(lambda seen=seen: len(peer.clocks) > seen + 10)
        arm.stop()
        path = processes.folder / name
        assert verify_log(path).complete
        assert before - SECOND < RecordedLog(path).settings.start_ns < time.time_ns()
    assert (np.diff(stamps(peer.clocks)) > 0).all()


AT = [0.3, -0.2]
STANDING = ('robot:=planar2', f'initial_positions:={AT}', 'recording:=arm.mcap')
# For which no state comes from an arm that stands.
QUIET_SECONDS = 1.0
INSTALLED = importlib.util.find_spec('simulation_interfaces') is not None


class Client:
    """Calls the standard services of a node in a namespace; each returns code and message."""

    def __init__(self, peer: Peer, namespace: str = '') -> None:
        msg = pytest.importorskip('simulation_interfaces.msg')
        srv = pytest.importorskip('simulation_interfaces.srv')
        self.peer, self._prefix, self._srv = peer, f'{namespace}/', srv
        self.states, self.results = msg.SimulationState, msg.Result
        self.set_codes, self.scopes = srv.SetSimulationState.Response, srv.ResetSimulation.Request
        self.features = msg.SimulatorFeatures

    def call(self, kind: str, name: str, **values: Any) -> Any:
        return call(self.peer, getattr(self._srv, kind), f'{self._prefix}{name}', **values)

    def offered(self) -> list[int]:
        found = self.call('GetSimulatorFeatures', 'get_simulator_features').features
        return list(found.features)

    def state(self) -> tuple[int, int]:
        found = self.call('GetSimulationState', 'get_simulation_state')
        return found.result.result, found.state.state

    def set(self, state: int) -> int:
        wanted = self.states(state=state)
        return self.call('SetSimulationState', 'set_simulation_state', state=wanted).result.result

    def step(self, count: int) -> tuple[int, str]:
        found = self.call('StepSimulation', 'step_simulation', steps=count).result
        return found.result, found.error_message

    def reset(self, scope: int) -> tuple[int, str]:
        found = self.call('ResetSimulation', 'reset_simulation', scope=scope).result
        return found.result, found.error_message


def newest(peer: Peer) -> int:
    """Return the stamp of an arm that stands, ns, once its last states have come."""
    quiet = time.monotonic() + QUIET_SECONDS
    while time.monotonic() < quiet:
        count = len(peer.states)
        peer.executor.spin_once(timeout_sec=0.05)
        if len(peer.states) > count:
            quiet = time.monotonic() + QUIET_SECONDS
    return stamp_ns(peer.states[-1])


def reaches(peer: Peer, stamp: int) -> None:
    """Wait for the state with a stamp, after which none comes."""
    peer.wait(lambda: stamp_ns(peer.states[-1]) >= stamp)
    assert newest(peer) == stamp


def requests(path: Path) -> list[tuple[str, int]]:
    """Return the recorded requests: name, count."""
    found = [
        json.loads(decode_string(message.data))
        for message in RecordedLog(path).messages()
        if message.role == 'requests'
    ]
    return [(values['request'], values.get('count', 1)) for values in found]


@pytest.mark.skipif(INSTALLED, reason='simulation_interfaces is installed')
def test_without_the_package_a_node_has_its_own_services_only(processes, peer_of):
    arm = processes.arm(*STANDING)
    peer = peer_of(processes)
    assert not trigger(peer, 'step').success
    names = [name for name, _ in peer.node.get_service_names_and_types()]
    assert '/sim_arm/step' in names
    assert not any('simulation' in name for name in names)
    assert 'simulation_interfaces' not in arm.text()
    arm.stop()


def test_another_package_of_that_name_is_named_and_the_arm_works_without(processes, monkeypatch):
    package = processes.folder / 'other' / 'simulation_interfaces'
    package.mkdir(parents=True)
    for name in ('__init__.py', 'msg.py', 'srv.py'):
        (package / name).touch()
    monkeypatch.setenv('PYTHONPATH', str(package.parent), prepend=os.pathsep)
    arm = processes.python(*NODE, '--ros-args', *with_flags(*STANDING))
    arm.wait_for_text('until its first command')
    found = [line for line in arm.text().splitlines() if 'simulation_interfaces' in line]
    assert [line.startswith('[WARN]') for line in found] == [True]
    arm.stop()
    assert verify_log(processes.folder / 'arm.mcap').complete


def test_an_arm_in_a_namespace_is_paused_stepped_reset_and_stopped_and_its_recording_verifies(
    processes, peer_of
):
    pytest.importorskip('simulation_interfaces')
    arm = processes.arm(*STANDING, '-r', '__ns:=/left')
    peer = peer_of(processes, 'left')
    client = Client(peer, '/left')
    states, codes, scopes = client.states, client.results, client.scopes
    ok, unsupported, failed = (
        codes.RESULT_OK,
        codes.RESULT_FEATURE_UNSUPPORTED,
        codes.RESULT_OPERATION_FAILED,
    )
    have = client.features
    assert sorted(client.offered()) == [
        have.SIMULATION_RESET,
        have.SIMULATION_RESET_STATE,
        have.SIMULATION_STATE_GETTING,
        have.SIMULATION_STATE_SETTING,
        have.SIMULATION_STATE_PAUSE,
        have.STEP_SIMULATION_SINGLE,
        have.STEP_SIMULATION_MULTIPLE,
    ]
    assert client.state() == (ok, states.STATE_PLAYING)
    assert client.step(10)[0] == failed
    peer.connect()
    peer.command(NAMES, [1.0, 1.0])
    peer.wait(lambda: any(peer.states[-1].velocity))

    assert client.set(states.STATE_PAUSED) == ok
    assert client.set(states.STATE_PAUSED) == client.set_codes.ALREADY_IN_TARGET_STATE
    assert client.state() == (ok, states.STATE_PAUSED)
    assert client.step(0)[0] == failed
    now = newest(peer)
    for count in (10, 1, 250):
        assert client.step(count) == (ok, '')
        now += count * MILLISECOND
        reaches(peer, now)
    assert client.state() == (ok, states.STATE_PAUSED)

    # Simulated time never restarts: what claims to restart it is refused, and changes nothing.
    for scope in (scopes.SCOPE_TIME, scopes.SCOPE_SPAWNED, scopes.SCOPE_ALL, 3):
        assert client.reset(scope)[0] == unsupported
    assert client.step(1)[0] == ok
    assert list(peer.states[-1].position) != AT
    now += MILLISECOND
    for scope in (scopes.SCOPE_STATE, scopes.SCOPE_DEFAULT):
        assert client.reset(scope) == (ok, '')
        now += MILLISECOND
        reaches(peer, now)
        assert list(peer.states[-1].position) == AT
        assert not any(peer.states[-1].velocity)
        assert client.state() == (ok, states.STATE_PAUSED)
        assert client.step(10)[0] == ok
        now += 10 * MILLISECOND
        reaches(peer, now)

    # Stopped is paused in the initial state, and a stopped simulation is not stepped.
    assert client.set(states.STATE_STOPPED) == ok
    now += MILLISECOND
    reaches(peer, now)
    assert client.state() == (ok, states.STATE_STOPPED)
    assert client.set(states.STATE_STOPPED) == client.set_codes.ALREADY_IN_TARGET_STATE
    assert client.step(1)[0] == failed
    assert client.set(states.STATE_PAUSED) == ok
    assert client.state() == (ok, states.STATE_PAUSED)
    reaches(peer, now)
    for state in (states.STATE_QUITTING, 4, 77):
        assert client.set(state) == unsupported
    assert client.set(states.STATE_PLAYING) == ok
    peer.wait(lambda: stamp_ns(peer.states[-1]) > now)
    assert client.state() == (ok, states.STATE_PLAYING)

    arm.stop()
    path = processes.folder / 'arm.mcap'
    assert verify_log(path).complete
    assert requests(path) == [
        *(('pause', 1), ('step', 0), ('step', 10), ('step', 1), ('step', 250), ('step', 1)),
        *[('reset', 1), ('step', 10)] * 2,
        *(('pause', 1), ('reset', 1), ('pause', 1), ('resume', 1)),
    ]
    log = RecordedLog(path).messages()
    stamps = [decode_joints(m.data).stamp_ns for m in log if m.role == 'joint_states']
    assert set(np.diff(stamps)) == {MILLISECOND}


def test_steps_in_lockstep_wait_for_their_commands_which_the_node_takes_meanwhile(
    processes, peer_of
):
    pytest.importorskip('simulation_interfaces')
    arm = processes.arm(*STANDING, 'lockstep:=true', 'real_time_factor:=0.0')
    peer = peer_of(processes)
    client = Client(peer)
    processes.forked('answering').wait_for_text('answers')
    peer.wait(lambda: peer.states and any(peer.states[-1].velocity))
    assert client.set(client.states.STATE_PAUSED) == client.results.RESULT_OK
    now = newest(peer)
    assert client.step(200) == (client.results.RESULT_OK, '')
    reaches(peer, now + 200 * MILLISECOND)
    arm.stop()
    assert verify_log(processes.folder / 'arm.mcap').complete


@pytest.mark.slow
def test_steps_that_another_request_ends_say_how_many_were_done_and_an_inactive_arm_has_none(
    processes, peer_of
):
    srv = pytest.importorskip('simulation_interfaces.srv')
    slow = ('step_size:=0.1', 'real_time_factor:=0.5')
    arm = processes.arm(*STANDING, *slow)
    peer = peer_of(processes)
    client = Client(peer)
    codes, states = client.results, client.states
    endless = peer.node.create_client(srv.StepSimulation, '/step_simulation')
    peer.wait(endless.service_is_ready)
    for end in (lambda: client.set(states.STATE_PLAYING), lambda: transition(peer, 'deactivate')):
        assert client.set(states.STATE_PAUSED) == codes.RESULT_OK
        future = endless.call_async(srv.StepSimulation.Request(steps=1_000_000))
        peer.let_pass(3)
        assert not future.done()
        assert end()
        peer.wait(future.done)
        found = future.result().result
        assert found.result == codes.RESULT_OPERATION_FAILED
        assert 'of 1000000 steps' in found.error_message
    for answer in (client.state, lambda: client.step(1), lambda: client.reset(2)):
        assert answer()[0] == codes.RESULT_INCORRECT_STATE
    assert client.set(states.STATE_PAUSED) == codes.RESULT_INCORRECT_STATE
    assert transition(peer, 'activate')
    assert client.state()[0] == codes.RESULT_OK
    # A signal ends the node in the middle of them.
    endless.call_async(srv.StepSimulation.Request(steps=1_000_000))
    peer.let_pass(3)
    arm.stop()
    assert verify_log(processes.folder / 'arm.mcap').complete


def test_a_simulation_that_has_failed_says_so_until_it_is_reset(processes, peer_of):
    pytest.importorskip('simulation_interfaces')
    damping = [f'damping.{name}:=1.0e6' for name in NAMES]
    arm = processes.arm(*STANDING, *damping, 'integrator:=rk4')
    peer = peer_of(processes)
    client = Client(peer)
    codes, states = client.results, client.states
    peer.connect()
    # The brakes open, and such damping is too stiff for this method.
    peer.command(NAMES, [1.0, 1.0])
    arm.wait_for_text('simulation stopped')
    failed = codes.RESULT_OPERATION_FAILED
    assert client.state() == (failed, states.STATE_PLAYING)
    assert client.set(states.STATE_PAUSED) == failed
    assert client.state() == (failed, states.STATE_PAUSED)
    code, text = client.step(10)
    assert (code, 'not finite' in text) == (failed, True)
    assert client.reset(client.scopes.SCOPE_DEFAULT) == (codes.RESULT_OK, '')
    assert client.step(10) == (codes.RESULT_OK, '')
    arm.stop()
    assert verify_log(processes.folder / 'arm.mcap').complete
