# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The services of `simulation_interfaces`, of a real node; most need that package."""

from __future__ import annotations

import importlib.util
import json
import os
from pathlib import Path
import time
from typing import Any

import numpy as np
import pytest
from ros_processes import MILLISECOND, NODE, Peer, call, stamp_ns, transition, trigger

from pfd_ros.messages.joints import decode_joints
from pfd_ros.messages.text_and_arrays import decode_string
from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.replay.verify import verify as verify_log

pytestmark = pytest.mark.ros

ANSWERING = str(Path(__file__).with_name('answering.py'))
NAMES = ('shoulder', 'elbow')
START = [0.3, -0.2]
ARM = ('-p', 'robot:=planar2', '-p', f'initial_positions:={START}', '-p', 'recording:=arm.mcap')
# For which no state comes from an arm that stands.
QUIET_SECONDS = 0.3
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
def test_without_the_package_a_node_has_its_own_services_only(processes, peer_of) -> None:
    arm = processes.arm(*ARM)
    peer = peer_of(processes)
    assert not trigger(peer, 'step').success
    names = [name for name, _ in peer.node.get_service_names_and_types()]
    assert '/sim_arm/step' in names
    assert not any('simulation' in name for name in names)
    assert 'simulation_interfaces' not in arm.text()
    arm.stop()


def test_another_package_of_that_name_is_named_and_the_arm_works_without(
    processes, monkeypatch
) -> None:
    package = processes.folder / 'other' / 'simulation_interfaces'
    package.mkdir(parents=True)
    for name in ('__init__.py', 'msg.py', 'srv.py'):
        (package / name).touch()
    monkeypatch.setenv('PYTHONPATH', str(package.parent), prepend=os.pathsep)
    arm = processes.python(*NODE, '--ros-args', *ARM)
    arm.wait_for_text('until its first command')
    found = [line for line in arm.text().splitlines() if 'simulation_interfaces' in line]
    assert [line.startswith('[WARN]') for line in found] == [True]
    arm.stop()
    assert verify_log(processes.folder / 'arm.mcap').complete


def test_an_arm_in_a_namespace_is_paused_stepped_reset_and_stopped_and_its_recording_verifies(
    processes, peer_of
) -> None:
    pytest.importorskip('simulation_interfaces')
    arm = processes.arm(*ARM, '-r', '__ns:=/left')
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
    assert list(peer.states[-1].position) != START
    now += MILLISECOND
    for scope in (scopes.SCOPE_STATE, scopes.SCOPE_DEFAULT):
        assert client.reset(scope) == (ok, '')
        now += MILLISECOND
        reaches(peer, now)
        assert list(peer.states[-1].position) == START
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
) -> None:
    pytest.importorskip('simulation_interfaces')
    arm = processes.arm(*ARM, '-p', 'lockstep:=true', '-p', 'real_time_factor:=0.0')
    peer = peer_of(processes)
    client = Client(peer)
    processes.python(ANSWERING).wait_for_text('answers')
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
) -> None:
    srv = pytest.importorskip('simulation_interfaces.srv')
    slow = ('-p', 'step_size:=0.1', '-p', 'real_time_factor:=0.5')
    arm = processes.arm(*ARM, *slow)
    peer = peer_of(processes)
    client = Client(peer)
    codes, states = client.results, client.states
    endless = peer.node.create_client(srv.StepSimulation, '/step_simulation')
    peer.wait(endless.service_is_ready)
    for end in (
        lambda: client.set(states.STATE_PLAYING),
        lambda: transition(peer, 'deactivate'),
    ):
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


def test_a_simulation_that_has_failed_says_so_until_it_is_reset(processes, peer_of) -> None:
    pytest.importorskip('simulation_interfaces')
    damping = [part for name in NAMES for part in ('-p', f'damping.{name}:=1.0e6')]
    arm = processes.arm(*ARM, *damping, '-p', 'integrator:=rk4')
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
