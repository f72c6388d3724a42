# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The two threads that may step an arm that waits, without a node: one at a time, all is done."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
import sys
import threading
from typing import Any

import numpy as np
import pytest
from sampling import one_fast
from waiting import PATIENCE, wait_until

pytest.importorskip('rclpy')

from pfd_ros.arm.arm import load_robot
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import STATES, Request, Source
from pfd_ros.arm.requests import encode_request
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.convert import JointStateEncoder, decode_joint_state
from pfd_ros.node.command_counts import CommandCounts
from pfd_ros.node.log_session import LogSession
from pfd_ros.node.receiving import EventQueue, Receiver
from pfd_ros.node.stepping import Stepper
from pfd_ros.node.workers import Workers

NAMES = ('shoulder', 'elbow')


class Topic:
    """Keeps the states that are published on it."""

    def __init__(self) -> None:
        self.states: list[bytes] = []

    def publish(self, data: bytes) -> None:
        self.states.append(data)


class Bench:
    """A stepper, its thread, and a controller in the hands of the test."""

    def __init__(self, session: LogSession | None = None, **chosen: Any) -> None:
        settings = Settings(robot='planar2', initial_positions=(0.3, -0.2), **chosen)
        self.engine = Engine(settings, load_robot(settings))
        self.topic, session, counts = Topic(), session or LogSession(), CommandCounts()
        self.receiver = Receiver(EventQueue(), session.record, counts)
        self.stepper = Stepper(self.engine, self.receiver, session, {STATES: self.topic})
        self.workers = Workers(threading.Event())
        self._encoder = JointStateEncoder(NAMES)

    @contextmanager
    def running(self):
        thread = self.workers.start('stepping', lambda: self.stepper.run(self.workers.stop.is_set))
        try:
            yield
        finally:
            self.workers.stop.set()
            thread.join(PATIENCE)
            assert not thread.is_alive()

    def answer(self, data: bytes) -> None:
        """Answer a state with efforts that depend on it."""
        state = decode_joint_state(data)
        effort = -20.0 * state.position - 2.0 * state.velocity
        zeros = np.zeros(2)
        self.receiver.receive(
            Source.NAMED,
            self._encoder.encode(state.stamp_ns, zeros + np.nan, zeros + np.nan, effort),
        )

    def answer_each(self, count: int) -> list[bytes]:
        """Answer so many states, each once, as soon as it comes; return them."""
        states = self.topic.states
        wait_until(lambda: states)
        self.answer(states[-1])
        # It stands before the state it waits with is published.
        wait_until(
            lambda: self.engine.waiting and stamp(states[-1]) == self.engine.arm.stamp_ns,
        )
        answered = [states[-1]]
        while len(answered) < count:
            self.answer(answered[-1])
            wait_until(
                lambda: decode_joint_state(states[-1]).stamp_ns > stamp(answered[-1]), pause=1e-4
            )
            answered.append(states[-1])
        return answered


def stamp(data: bytes) -> int:
    return decode_joint_state(data).stamp_ns


@pytest.mark.parametrize('interval', one_fast([1e-6, 5e-3]))
def test_a_lockstep_run_is_the_same_to_the_bit_each_time_however_threads_are_switched(
    interval: float,
) -> None:
    before = sys.getswitchinterval()
    sys.setswitchinterval(interval)
    try:
        runs = []
        for _ in range(20):
            bench = Bench(lockstep=True, real_time_factor=0.0)
            with bench.running():
                states = [decode_joint_state(data) for data in bench.answer_each(60)]
            assert not bench.workers.failures
            # How long the arm was held before the first command is for the machine to say.
            first = states[0].stamp_ns
            assert [s.stamp_ns - first for s in states] == [k * 1_000_000 for k in range(60)]
            runs.append([(s.position.tobytes(), s.velocity.tobytes()) for s in states])
        assert all(run == runs[0] for run in runs)
    finally:
        sys.setswitchinterval(before)


def test_a_fault_in_a_step_on_another_thread_ends_the_stepping_thread() -> None:
    bench = Bench(lockstep=True, real_time_factor=0.0)

    def fail() -> None:
        raise KeyError('{0}')

    with bench.running():
        last = bench.answer_each(5)[-1]
        bench.stepper.run_cycle = fail
        bench.answer(last)
        wait_until(bench.workers.stop.is_set)
    assert bench.workers.failures[0].startswith("stepping failed: KeyError: '{0}'")


def test_another_real_time_factor_counts_at_once_for_a_slow_arm_and_for_one_that_waits() -> None:
    # A step would take 1000 s.
    slow = Bench(real_time_factor=1e-6)
    with slow.running():
        slow.engine.state.settings = replace(slow.engine.settings, real_time_factor=0.0)
        wait_until(lambda: slow.engine.cycles > 10)
    waiting = Bench(lockstep=True, real_time_factor=0.0)
    with waiting.running():
        last = waiting.answer_each(5)[-1]
        waiting.engine.state.settings = replace(waiting.engine.settings, real_time_factor=0.5)
        wait_until(lambda: waiting.stepper.timer.period_ns == 2_000_000)
        # From now on the stepping thread paces it.
        assert not waiting.stepper.step_at_once()
        waiting.answer(last)
        wait_until(lambda: stamp(waiting.topic.states[-1]) > stamp(last))


def test_a_request_for_many_steps_is_done_to_its_end() -> None:
    bench = Bench(real_time_factor=0.0)

    def ask(name: str, count: int = 1) -> None:
        answer = bench.receiver.ask(Source.REQUEST, encode_request(Request(name, count)))
        assert answer.result(PATIENCE).verdict == 0

    with bench.running():
        ask('pause')
        wait_until(lambda: bench.engine.waiting)
        before = bench.engine.cycles
        ask('step', 1234)
        wait_until(lambda: bench.engine.cycles == before + 1234)
        assert bench.engine.waiting
