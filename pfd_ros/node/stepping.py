# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The stepping thread: one cycle of the engine per period, its outputs recorded and published.

See docs/decisions/0003-executor-and-stepping-thread.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
import time

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import STATES
from pfd_ros.node.command_counts import CommandCounts
from pfd_ros.node.endpoints import NonblockingPublisher
from pfd_ros.node.log_session import LogSession
from pfd_ros.node.receiving import EventQueue
from pfd_ros.node.step_timer import StepTimer

# At unlimited speed the arm waits for the disk from this backlog on.
BACKLOG_LIMIT = 0.25
DISK_POLL_SECONDS = 0.001


@dataclass
class Stepper:
    """Runs an engine in real time, or as fast as possible.

    An output whose role has no publisher is only recorded.
    """

    engine: Engine
    queue: EventQueue
    session: LogSession
    publishers: Mapping[str, NonblockingPublisher]
    counts: CommandCounts
    timer: StepTimer = field(init=False)
    states: int = 0

    def __post_init__(self) -> None:
        """Set the period: at a real-time factor of 0 there is none."""
        settings = self.engine.settings
        factor = settings.real_time_factor
        self.timer = StepTimer(settings.step_ns / factor if factor else 0)

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
        return self.timer.period_ns == 0 and self.session.backlog > BACKLOG_LIMIT

    def run_cycle(self) -> None:
        """Run one cycle; every output is recorded first, so that no answer precedes it."""
        result = self.engine.run_cycle(self.queue.take())
        for source, judgement, count in result.judgements:
            self.counts.add(source, judgement, count)
        for role, number, data in result.outputs:
            if role == STATES:
                self.states = number
            self.session.record(role, number, data)
            if role in self.publishers:
                self.publishers[role].publish(data)
