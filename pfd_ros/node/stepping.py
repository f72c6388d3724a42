# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The stepping thread: one cycle of the engine per period, its outputs recorded and published.

See docs/decisions/0003-executor-and-stepping-thread.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import time

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import STATES
from pfd_ros.node.command_counts import CommandCounts
from pfd_ros.node.event_queue import EventQueue
from pfd_ros.node.log_session import LogSession
from pfd_ros.node.nonblocking_publisher import NonblockingPublisher
from pfd_ros.node.step_timer import StepTimer

# At unlimited speed the arm waits for the disk from this backlog on.
BACKLOG_LIMIT = 0.25
DISK_POLL_SECONDS = 0.001


class Stepper:
    """Runs an engine in real time, or as fast as possible.

    Parameters
    ----------
    engine
        The engine.
    queue
        Events from the executor's thread.
    log
        The recording.
    publishers
        By role; an output without a publisher is only recorded.
    counts
        Gets every judgement.

    Attributes
    ----------
    timer
        Counts the steps that were late and the periods that were missed.
    states
        States put out so far.
    """

    def __init__(
        self,
        engine: Engine,
        queue: EventQueue,
        log: LogSession,
        publishers: Mapping[str, NonblockingPublisher],
        counts: CommandCounts,
    ) -> None:
        self.engine = engine
        self.states = 0
        factor = engine.settings.real_time_factor
        self.timer = StepTimer(engine.settings.step_ns / factor if factor else 0)
        self._queue, self._log, self._publishers = queue, log, publishers
        self._counts = counts

    def run(self, stopped: Callable[[], bool]) -> None:
        """Run cycles until `stopped` says so."""
        self.timer.start()
        while True:
            self.timer.wait(stopped)
            while self._waits_for_disk() and not stopped():
                time.sleep(DISK_POLL_SECONDS)
            if stopped():
                return
            self.run_cycle()

    def _waits_for_disk(self) -> bool:
        return self.timer.period_ns == 0 and self._log.backlog > BACKLOG_LIMIT

    def run_cycle(self) -> None:
        """Run one cycle; every output is recorded first, so that no answer precedes it."""
        result = self.engine.run_cycle(self._queue.take())
        for source, judgement, count in result.judgements:
            self._counts.add(source, judgement, count)
        for role, number, data in result.outputs:
            if role == STATES:
                self.states = number
            self._log.record(role, number, data)
            if role in self._publishers:
                self._publishers[role].publish(data)
