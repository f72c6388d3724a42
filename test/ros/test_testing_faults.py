# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of a controller fail its test, with a text that says what happened, where and when."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
import re
import signal
import socket
import sys
import threading
import time
from typing import Any

from bridge import (
    REJECTION_REASONS,
    ChildProcess,
    ComputationTime,
    ControllerError,
    ControllerProcess,
    LockstepArm,
    NoAnswerError,
    ProcessArm,
    RunLimits,
    RunTrajectory,
    Verdict,
    checked_reasons,
)
from controller_faults import FAULTS, UR5, WAYS, command_of, failure_of, node_of, pd
import numpy as np
import pytest
from ros_processes import ROOT
from sampling import one_fast
from waiting import PATIENCE

# Short, for a callback that blocks, s.
SHORT = 0.3
# Above the time in which a node of this process answers on a busy machine, s.
LOADED = 6.0


@pytest.fixture
def sender_of(domain: int) -> Iterator[Callable[..., Any]]:
    """Return a function that makes a node; `answer` gives its message for the state of k ms.

    By the stamp: on a busy machine a state comes more than once.
    """
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    made = []

    def make(answer: Callable[[int, Any], Any], name: str = 'controller') -> Any:
        node = Node(name)
        made.append(node)
        named = node.create_publisher(JointState, 'joint_commands', 10)
        plain = node.create_publisher(Float64MultiArray, 'sim_arm/commands', 10)

        def on_state(state: Any) -> None:
            message = answer(state.header.stamp.nanosec // 1_000_000, state)
            if message is not None:
                (named if isinstance(message, JointState) else plain).publish(message)

        node.create_subscription(JointState, 'joint_states', on_state, 10)
        return node

    yield make
    for node in made:
        node.destroy_node()


def good(state: Any) -> Any:
    from sensor_msgs.msg import JointState

    command = JointState(name=list(state.name), effort=[0.0] * 6)
    command.header.stamp = state.header.stamp
    return command


def plain(*efforts: float) -> Any:
    from std_msgs.msg import Float64MultiArray

    return Float64MultiArray(data=efforts)


def with_effort(state: Any, *efforts: float) -> Any:
    command = good(state)
    command.effort = list(efforts)
    return command


def with_names(state: Any, *names: str) -> Any:
    command = good(state)
    command.name = list(names)
    return command


def old(state: Any) -> Any:
    command = good(state)
    command.header.stamp.nanosec -= 1_000_000
    return command


def without_effort(state: Any) -> Any:
    from sensor_msgs.msg import JointState

    return JointState(name=list(state.name), velocity=[0.0] * 6)


NAN, INF = float('nan'), float('inf')
REJECTED: dict[str, tuple[str, Callable[[Any], Any]]] = {
    'NaN without names': ('not_finite', lambda state: plain(0, 0, NAN, 0, 0, 0)),
    'infinity without names': ('not_finite', lambda state: plain(0, 0, 0, 0, 0, -INF)),
    'five numbers': ('wrong_size', lambda state: plain(0, 0, 0, 0, 0)),
    'infinity by name': ('infinite', lambda state: with_effort(state, 0, INF, 0, 0, 0, 0)),
    'ragged': ('ragged', lambda state: with_effort(state, 0, 0)),
    'NaN for all': ('all_nan', lambda state: with_effort(state, *[NAN] * 6)),
    'NaN for one': ('all_nan', lambda state: with_effort(state, 0, NAN, 0, 0, 0, 0)),
    'unknown names': ('unknown_names', lambda state: with_names(state, *'abcdef')),
    'one unknown name': (
        'unknown_names',
        lambda state: with_names(state, *state.name[:5], 'wrist_4_joint'),
    ),
    'no names': ('no_names', lambda state: with_names(state)),
    'a name twice': ('duplicate_names', lambda state: with_names(state, *[state.name[0]] * 6)),
    'stale': ('stale', old),
    'no effort': ('no_effort', without_effort),
}


@pytest.mark.ros
@pytest.mark.parametrize('case', REJECTED)
def test_a_single_rejected_command_fails_the_run_with_its_reason_time_and_node(
    case: str, sender_of: Callable[..., Any]
) -> None:
    reason, message = REJECTED[case]
    node = sender_of(lambda k, state: message(state) if k == 11 else good(state))
    text = rf"command of node '/controller' on .* at t = 0\.011 s, after 10 answers: {reason}: "
    with LockstepArm(**UR5) as arm, pytest.raises(ControllerError, match=text):
        arm.spin(0.05, node)


@pytest.mark.ros
@pytest.mark.parametrize('case', ['NaN for one', 'one unknown name', 'NaN for all'])
def test_a_rejected_command_that_is_allowed_by_name_fails_nothing(
    case: str, sender_of: Callable[..., Any]
) -> None:
    reason, message = REJECTED[case]
    node = sender_of(lambda k, state: message(state))
    with LockstepArm(**UR5) as arm:
        assert len(arm.spin(0.01, node, allow_rejected={reason}).time) == 10


def test_reasons_have_the_names_of_validation_results_and_a_misspelt_one_is_named() -> None:
    assert {reason.upper() for reason in REJECTION_REASONS} | {'ACCEPTED'} == {
        each.name for each in Verdict
    }
    assert checked_reasons('stale') == {'stale'}
    with pytest.raises(ValueError, match="has 'allnan': did you mean 'all_nan'"):
        checked_reasons({'allnan'})


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.long
def test_a_rejected_command_fails_the_run_of_an_arm_in_another_process(
    sender_of: Callable[..., Any],
) -> None:
    bad: list[int] = []

    def answer(k: int, state: Any) -> Any:
        if k == 11 and not bad:
            bad.append(k)
            return plain(*[NAN] * 6)
        return good(state)

    with ProcessArm(**UR5) as arm:
        node = sender_of(answer)
        arm.spin(0.005, node)
        with pytest.raises(ControllerError, match=r'rejected commands .*: not_finite \(1 times\)'):
            arm.spin(0.02, node)
        motion = arm.spin(0.02, node)
        assert (motion.compute_time > 0.0).all()


def lock() -> None:
    once = threading.Lock()
    once.acquire()
    once.acquire()


def read_a_socket() -> None:
    one, other = socket.socketpair()
    with one, other:
        one.recv(1)


def loop() -> None:
    while True:
        pass


def catch_all() -> None:
    while True:
        try:
            time.sleep(1e6)
        except Exception:
            continue


@pytest.mark.parametrize(
    'wait', one_fast([lambda: time.sleep(1e6), lock, read_a_socket, loop, catch_all], lock)
)
def test_a_callback_that_blocks_fails_with_its_stack_and_the_arm_continues(
    wait: Callable[[], None],
) -> None:
    def blocking(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        if t > 0.01:
            wait()
        return pd(t, q, qd)

    text = (
        r'blocks: no answer for 0\.3 s to the state at t = 0\.011 s, after 10 answers; it is here'
    )
    with LockstepArm(**UR5) as arm:
        with pytest.raises(ControllerError, match=text) as failed:
            arm.run(blocking, 1.0, patience=SHORT)
        lines = str(failed.value).splitlines()
        assert lines[1].endswith('in blocking')
        assert lines[2].strip() == 'wait()'
        assert arm.time == 0.011
        # The next run works, and a slow callback that answers in time is none that blocks.
        assert arm.run(lambda t, q, qd: time.sleep(0.2) or 0 * q, 0.002, patience=10.0).q.any()


@pytest.mark.ros
def test_a_node_that_blocks_fails_with_its_stack_and_the_next_run_works(
    sender_of: Callable[..., Any],
) -> None:
    blocked: list[int] = []

    def answer(k: int, state: Any) -> Any:
        if k == 3 and not blocked:
            blocked.append(k)
            lock()
        return good(state)

    node = sender_of(answer)
    with LockstepArm(**UR5) as arm:
        with pytest.raises(ControllerError, match=r'after 2 answers; it is here:(.|\n)*in lock'):
            arm.spin(0.05, node, patience=LOADED)
        assert len(arm.spin(0.05, node, patience=LOADED).time) == 50


def test_patience_is_above_zero_and_a_run_outside_of_the_main_thread_works() -> None:
    with LockstepArm(**UR5) as arm:
        with pytest.raises(ValueError, match=r'patience is 0\.0, expected above zero'):
            arm.run(pd, 0.01, patience=0.0)
        found: list[RunTrajectory] = []
        thread = threading.Thread(target=lambda: found.append(arm.run(pd, 0.01)))
        thread.start()
        thread.join(PATIENCE)
        assert len(found[0].time) == 10


@pytest.mark.ros
def test_the_error_on_silence_names_who_never_published_and_who_stopped(
    sender_of: Callable[..., Any], domain: int
) -> None:
    with LockstepArm(**UR5) as arm:
        mute = sender_of(lambda k, state: None)
        text = r"to the state at t = 0\.001 s: node '/controller' never published a command"
        with pytest.raises(NoAnswerError, match=text):
            arm.spin(0.1, mute)
        mute.destroy_node()
        stops = sender_of(lambda k, state: good(state) if k <= 7 else None, 'stops')
        text = r"t = 0\.008 s: commands stopped after 7 answers, and node '/stops' still runs"
        with pytest.raises(NoAnswerError, match=text):
            arm.spin(0.1, stops)


@pytest.mark.ros
def test_the_error_on_silence_names_who_left_beside_who_still_runs(
    sender_of: Callable[..., Any], domain: int
) -> None:
    other = sender_of(lambda k, state: None, 'other')

    def answer(k: int, state: Any) -> Any:
        if k == 8:
            other.destroy_node()
        return good(state) if k <= 7 else None

    with LockstepArm(**UR5) as arm:
        text = r"after 7 answers, and node '/stops' still runs, node '/other' left the ROS graph"
        with pytest.raises(NoAnswerError, match=text):
            arm.spin(0.1, sender_of(answer, 'stops'), other)


@pytest.mark.ros
@pytest.mark.slow
def test_a_process_that_ends_is_named_with_its_status_and_its_output(domain: int) -> None:
    command = [sys.executable, '-c', 'raise SystemExit("no such gain")']
    with LockstepArm(**UR5) as arm, ControllerProcess(command) as process:
        text = r'the process .* \(pid \d+\) ended with status 1 after 0 answers(.|\n)*no such gain'
        with pytest.raises(NoAnswerError, match=text):
            arm.spin(0.1, process)


@pytest.mark.ros
@pytest.mark.slow
def test_a_process_moves_the_arm_with_the_bits_of_a_node_of_the_test(domain: int) -> None:
    fault = 'no gravity compensation'
    with LockstepArm(**UR5) as arm:
        node = node_of(FAULTS[fault][0])
        expected = arm.spin(0.3, node)
        node.destroy_node()
    with LockstepArm(**UR5) as arm, ControllerProcess(command_of(fault)) as process:
        found = arm.spin(0.3, process, patience=LOADED, start_patience=PATIENCE)
    assert found.q.tobytes() == expected.q.tobytes()


def test_the_time_of_a_controller_is_reported_and_can_be_asserted() -> None:
    seconds = np.full(100, 0.0004)
    seconds[7] = 0.005
    names, zeros, bounds = ('a',), np.zeros((100, 1)), np.full(1, np.inf)
    limits = RunLimits(-bounds, bounds, bounds, bounds)
    motion = RunTrajectory(
        np.arange(1, 101) / 1e3, zeros, zeros, zeros, names, limits, seconds, 0.001
    )
    median, p99, longest, period = motion.computation_time()
    assert (median, longest, period) == (0.0004, 0.005, 0.001)
    assert 0.0004 < p99 < 0.005
    assert str(ComputationTime(0.0004, 0.0005, 0.005, 0.001)) == (
        'median 0.4 ms (40 %), p99 0.5 ms (50 %), longest 5 ms (500 %) of the control period of '
        '1 ms'
    )
    motion.assert_computes_within(0.0004, quantile=0.9)
    with pytest.raises(
        AssertionError, match=r'takes 5 ms .* \(quantile 1\), expected at most 1 ms'
    ):
        motion.assert_computes_within(0.001, quantile=1.0)
    with pytest.raises(ValueError, match='quantile is 99'):
        motion.assert_computes_within(0.001, quantile=99)


@pytest.mark.ros
def test_five_milliseconds_a_command_are_seen_as_a_callback_and_over_topics(
    sender_of: Callable[..., Any],
) -> None:
    def slow(t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        time.sleep(0.005)
        return 0 * q

    def answer(k: int, state: Any) -> Any:
        time.sleep(0.005)
        return good(state)

    with LockstepArm(**UR5) as arm:
        motions = [arm.run(slow, 0.02), arm.spin(0.02, sender_of(answer))]
    for motion in motions:
        assert motion.computation_time().median >= 0.005
        assert motion.period == 0.001
        with pytest.raises(AssertionError, match='expected at most 1 ms'):
            motion.assert_computes_within(0.001)


EXPECTED = {
    'sign error': 'elbow_joint: moves away from its target, growing by',
    'gain too high': r'elbow_joint: oscillates at (49\d|500)',
    'no gravity compensation': 'elbow_joint: rests .* above its target with a torque',
    '5 ms late': r'elbow_joint: oscillates at 4\d',
    'NaN': r"nan for joint 'elbow_joint' at t = 0\.101|not_finite: effort of joint 'elbow_joint'",
    'wrong length': r'expected 6 numbers|wrong_size: 5 numbers for 6 joints',
    'blocks': r'blocks: .* after 100 answers(.|\n)*time\.sleep|stopped after 100 answers',
    'crashes': r"raised at t = 0\.101 s.*KeyError: 'gain'|SIGSEGV after 100 answers",
    'never publishes': r'returned None at t = 0\.001 s|never published a command',
    'stops after 100 commands': r'returned None at t = 0\.101 s|stopped after 100 answers',
}


def test_the_table_of_the_guide_has_each_fault_in_each_way_with_its_text() -> None:
    page = (ROOT / 'docs' / 'guides' / 'testing-a-controller.md').read_text(encoding='utf-8')
    for fault in FAULTS:
        for way in WAYS:
            (text,) = re.findall(rf'^\| {fault} \| {way} \| [0-9.]+ \| (.*) \|$', page, re.M)
            assert re.search(EXPECTED[fault], text), text


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize('way', WAYS)
@pytest.mark.parametrize('fault', FAULTS)
def test_each_fault_fails_its_test_in_each_way_with_its_text(
    fault: str, way: str, domain: int
) -> None:
    _, text = failure_of(fault, way)
    assert re.search(EXPECTED[fault], text), text


def test_a_signal_without_a_name_ends_a_process_like_others(tmp_path: Path) -> None:
    number = int(signal.SIGRTMIN) + 1
    code = f'import os; os.kill(os.getpid(), {number})'
    child = ChildProcess([sys.executable, '-c', code], tmp_path / 'output.txt')
    child.process.wait(PATIENCE)
    assert child.end() == f'ended by signal {number}'
