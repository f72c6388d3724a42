# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Services, jumps and lockstep over real topics, while a controller continues to publish."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
import time
from typing import Any

from bridge import Source, Verdict, read_recording
import numpy as np
import pytest
from ros_processes import MILLISECOND, Peer, Processes, call, stamp_ns
from simulating import rows_of, states_of

pytestmark = pytest.mark.ros

ANSWERING = str(Path(__file__).with_name('answering.py'))
ARM = ('-p', 'robot:=planar2', '-p', 'recording:=arm.mcap', '-p', 'gravity:=[0.0, 0.0, 0.0]')
NAMES = ('shoulder', 'elbow')
# Looks of 0.1 s at most in which no state came.
QUIET_LOOKS = 5
START = ('-p', 'initial_positions:=[0.3, -0.2]')


def pause(peer: Peer, wanted: bool) -> Any:
    from std_srvs.srv import SetBool

    return call(peer, SetBool, 'pause', data=wanted)


def trigger(peer: Peer, name: str) -> Any:
    from std_srvs.srv import Trigger

    return call(peer, Trigger, name)


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


def stamps(peer: Peer) -> list[int]:
    return [stamp_ns(state) for state in peer.states]


def at(position: Sequence[float]):
    """Return a test for a state that is exactly there, at rest."""
    return lambda state: state.position.tolist() == list(position) and not any(state.velocity)


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


def check_clock(peer: Peer) -> None:
    """No state and no tick is earlier than the one before it."""
    assert (np.diff(stamps(peer)) >= 0).all()
    assert (np.diff([stamp_ns(tick) for tick in peer.clocks]) >= 0).all()


def test_pause_step_reset_and_jump_while_a_controller_runs(processes: Processes, peer_of) -> None:
    arm = processes.arm(*ARM, *START, '-p', 'step_count:=7')
    peer = peer_of(processes)
    peer.connect()
    # It pulls with all its might, and every command is stamped with the state it answers.
    processes.python(ANSWERING).wait_for_text('answers')
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
    check_clock(peer)
    arm.stop()
    path = processes.folder / 'arm.mcap'
    summary = read_recording(path, verify=True)
    assert summary.verdicts[Verdict.REFUSED] == 1
    # The peer does not get every state; the recording has them.
    assert not summary.missing
    states = states_of(path)
    rows = rows_of(path)
    reset = [row.cycle for row in rows if row.source is Source.REQUEST][-1]
    jumped = next(row.cycle for row in rows if row.source is Source.SET_STATE)
    for cycle, place in ((reset, [0.3, -0.2]), (jumped, [1.0, -1.5])):
        there, after = states[cycle - 1], states[cycle]
        assert there.position.tolist() == place
        assert not any(there.velocity)
        # An effort that answered a state before the jump would show at once.
        assert np.abs(after.position - place).max() < 1e-3


@pytest.mark.slow
def test_lockstep_repeats_a_state_that_an_ended_controller_left_unanswered(
    processes: Processes, peer_of
) -> None:
    arm = processes.arm(*ARM, *START, '-p', 'lockstep:=true', '-p', 'real_time_factor:=0.0')
    peer = peer_of(processes)
    peer.connect()
    controller = processes.python(ANSWERING)
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
    # Services answer while nobody does, and a pause in lockstep ends with an answer only.
    assert pause(peer, True).success
    assert pause(peer, False).success
    assert trigger(peer, 'reset').success
    peer.wait(lambda: at([0.3, -0.2])(peer.states[-1]))
    assert stamp_ns(peer.states[-1]) == settled_at + MILLISECOND
    again = processes.python(ANSWERING)
    again.wait_for_text('answers')
    peer.wait(lambda: stamp_ns(peer.states[-1]) > settled_at + 100 * MILLISECOND)
    check_clock(peer)
    arm.stop()
    summary = read_recording(processes.folder / 'arm.mcap', verify=True)
    assert summary.verdicts[Verdict.ACCEPTED] > 100


def test_services_answer_while_the_arm_is_very_slow(processes: Processes, peer_of) -> None:
    # A step lasts ten seconds of wall time.
    arm = processes.arm(
        *ARM, '-p', 'step_size:=0.1', '-p', 'real_time_factor:=0.01', '-p', 'start_time:=5.0'
    )
    peer = peer_of(processes)
    for _ in range(3):
        assert trigger(peer, 'step').message.startswith('refused')
        assert pause(peer, True).message == 'accepted: pause; simulated time 5.0 s'
        assert pause(peer, False).success
    arm.stop()
