# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The stepping thread: one cycle of the engine per period, its outputs recorded and published.

An arm that waits and has no period (in lockstep as fast as possible, or with a followed clock) is
stepped by the executor's thread, in the callback of the message that ends the wait. To wake
another thread would take longer than the step. A lock determines which thread steps; the stepping
thread holds it except while it waits for an event.

See docs/decisions/0003-executor-and-stepping-thread.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import threading
import time

from pfd_ros.arm.driver import Driver
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import NUMBERED_AS_STATES, Output
from pfd_ros.arm.settings import Settings
from pfd_ros.node.endpoints import NonblockingPublisher
from pfd_ros.node.log_session import LogSession
from pfd_ros.node.receiving import Receiver
from pfd_ros.node.step_timer import StepLengths, StepTimer

# At unlimited speed the arm waits for the disk from this backlog on.
BACKLOG_LIMIT = 0.25
DISK_POLL_SECONDS = 0.001
# While the arm waits: period of checks for a stop, and, in lockstep, time until the state is sent
# again, since a reader may miss a clock tick.
LOOK_SECONDS = 0.05
RESEND_SECONDS = 0.2
# Steps on the executor's thread for one message; a message may let the arm do many more.
MOST_CYCLES_AT_ONCE = 100


@dataclass
class Stepper:
    """Runs an engine in real time, or as fast as possible.

    An output whose role has no publisher is only recorded.

    Attributes
    ----------
    states
        Number of the last state.
    resent
        How often a state was sent again, because no command answered it.
    lengths
        How long the newest cycles took.
    """

    engine: Engine
    receiver: Receiver
    session: LogSession
    publishers: Mapping[str, NonblockingPublisher]
    timer: StepTimer = field(init=False)
    _driver: Driver = field(init=False)
    states: int = 0
    resent: int = 0
    lengths: StepLengths = field(default_factory=StepLengths)
    _turn: threading.Lock = field(default_factory=threading.Lock)
    _runs: bool = False
    _error: Exception | None = None

    def __post_init__(self) -> None:
        """Set the period."""
        self._settings = self.engine.settings
        self.timer = StepTimer(_period_ns(self._settings))
        self._driver = Driver(self.engine, self._put_out)
        self._recorder = self.session.recorder
        self.receiver.at_once = self.step_at_once

    def run(self, stopped: Callable[[], bool]) -> None:
        """Run cycles until `stopped` returns True."""
        with self._turn:
            self._runs = True
            try:
                self._run(stopped)
            finally:
                self._runs = False

    def step_at_once(self) -> bool:
        """Run the cycles that the events in the queue let a waiting arm do, on any thread.

        Returns whether that is all: if not, the stepping thread has to go on.
        """
        if self.timer.period_ns or not self._turn.acquire(blocking=False):
            return False
        try:
            return self._runs and self._error is None and self._step_while_it_may()
        except Exception as error:
            self._error = error
            return False
        finally:
            self._turn.release()

    def _step_while_it_may(self) -> bool:
        if self.session.waiting_share > BACKLOG_LIMIT:
            return False
        self._take_events()
        for _ in range(MOST_CYCLES_AT_ONCE):
            if self.engine.waiting:
                return True
            self.run_cycle()
        return self.engine.waiting

    def _run(self, stopped: Callable[[], bool]) -> None:
        self.timer.start()
        while not stopped():
            self._keep_to_settings()
            if self.engine.waiting:
                self._wait(stopped)
            elif self.timer.period_ns == 0 and self.session.backlog > BACKLOG_LIMIT:
                time.sleep(DISK_POLL_SECONDS)
            elif self.timer.wait():
                self.run_cycle()
            else:
                # A slow arm answers requests long before its next step.
                self._take_events()

    def _keep_to_settings(self) -> None:
        """Take over another real-time factor, which is pacing only."""
        if self.engine.settings is not self._settings:
            self._settings = self.engine.settings
            self.timer.set_period(_period_ns(self._settings))

    def _wait(self, stopped: Callable[[], bool]) -> None:
        """Take events until one lets the arm go on."""
        shown, sent = self.states, time.monotonic()
        while self.engine.waiting and not stopped():
            self._wait_for_events()
            self._take_events()
            self._keep_to_settings()
            if self.states != shown:
                shown, sent = self.states, time.monotonic()
            elif self.engine.state.pace.waits and time.monotonic() - sent > RESEND_SECONDS:
                sent = time.monotonic()
                self.resent += 1
                for role, _, data in self.engine.present():
                    self._publish(role, data)
        self.timer.rebase()

    def _wait_for_events(self) -> None:
        self._turn.release()
        try:
            self.receiver.queue.wait(LOOK_SECONDS)
        finally:
            self._turn.acquire()
        if self._error is not None:
            raise self._error

    def run_cycle(self) -> None:
        """Run one cycle; every output is recorded first, so that no answer precedes it."""
        begun = time.perf_counter_ns()
        self._take_events()
        if not self.engine.waiting:
            self._driver.step()
            self.lengths.add(self.engine.cycles, time.perf_counter_ns() - begun)
            if self._recorder is not None:
                self._recorder.between_steps()

    def _take_events(self) -> None:
        events = self.receiver.queue.take()
        if not events:
            return
        validations = self._driver.take(events)
        for source, validation, count in validations:
            self.receiver.counts.add(source, validation, count)
        self.receiver.answer(events, [validation for _, validation, _ in validations])

    def _put_out(self, outputs: Sequence[Output]) -> None:
        if self._recorder is not None:
            self._recorder.record_all(outputs, self.engine.arm.stamp_ns)
        for role, number, data in outputs:
            if role in NUMBERED_AS_STATES:
                self.states = number
            self._publish(role, data)

    def _publish(self, role: str, data: bytes) -> None:
        if role in self.publishers:
            self.publishers[role].publish(data)


def _period_ns(settings: Settings) -> float:
    """Return the wall time of a step, ns; 0 where the arm steps as fast as it may."""
    if settings.follows_clock or settings.real_time_factor == 0.0:
        return 0.0
    return settings.step_ns / settings.real_time_factor
