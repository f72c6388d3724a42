# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The stepping thread: one cycle of the engine per period, its outputs recorded and published.

See docs/decisions/0003-executor-and-stepping-thread.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import time

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import NUMBERED_AS_STATES, Output
from pfd_ros.arm.settings import Settings
from pfd_ros.node.command_counts import CommandCounts
from pfd_ros.node.endpoints import NonblockingPublisher
from pfd_ros.node.log_session import LogSession
from pfd_ros.node.receiving import Receiver
from pfd_ros.node.step_timer import StepLengths, StepTimer

# At unlimited speed the arm waits for the disk from this backlog on.
BACKLOG_LIMIT = 0.25
DISK_POLL_SECONDS = 0.001
# While the arm stands: between two looks at the signal to stop, and, in lockstep, until the state
# is sent again, since the reader of a clock may miss ticks.
LOOK_SECONDS = 0.05
RESEND_SECONDS = 0.2


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
    counts: CommandCounts
    timer: StepTimer = field(init=False)
    states: int = 0
    resent: int = 0
    lengths: StepLengths = field(default_factory=StepLengths)

    def __post_init__(self) -> None:
        """Set the period."""
        self._settings = self.engine.settings
        self.timer = StepTimer(_period_ns(self._settings))

    def run(self, stopped: Callable[[], bool]) -> None:
        """Run cycles until `stopped` says so."""
        self.timer.start()
        while not stopped():
            if self.engine.settings is not self._settings:
                self._settings = self.engine.settings
                self.timer.set_period(_period_ns(self._settings))
            if self.engine.stands:
                self._stand(stopped)
            elif self._waits_for_disk():
                time.sleep(DISK_POLL_SECONDS)
            elif self.timer.wait():
                self.run_cycle()
            else:
                # A slow arm answers requests long before its next step.
                self._take_events()

    def _waits_for_disk(self) -> bool:
        return self.timer.period_ns == 0 and self.session.backlog > BACKLOG_LIMIT

    def _stand(self, stopped: Callable[[], bool]) -> None:
        """Take events until one lets the arm go on."""
        queue, sent = self.receiver.queue, time.monotonic()
        while self.engine.stands and not stopped():
            queue.wait(LOOK_SECONDS)
            self._take_events()
            if self.engine.pace.waits and time.monotonic() - sent > RESEND_SECONDS:
                sent = time.monotonic()
                self.resent += 1
                for role, _, data in self.engine.present():
                    self._publish(role, data)
        self.timer.forgive()

    def run_cycle(self) -> None:
        """Run one cycle; every output is recorded first, so that no answer precedes it."""
        begun = time.perf_counter_ns()
        self._take_events()
        if not self.engine.stands:
            self._put_out(self.engine.step())
            self.lengths.add(self.engine.cycles, time.perf_counter_ns() - begun)

    def _take_events(self) -> None:
        events = self.receiver.queue.take()
        if not events:
            return
        taken = self.engine.take(events)
        self._put_out(taken.outputs)
        for source, judgement, count in taken.judgements:
            self.counts.add(source, judgement, count)
        self.receiver.answer(events, [judgement for _, judgement, _ in taken.judgements])

    def _put_out(self, outputs: Sequence[Output]) -> None:
        for role, number, data in outputs:
            if role in NUMBERED_AS_STATES:
                self.states = number
            self.session.record(role, number, data)
            self._publish(role, data)

    def _publish(self, role: str, data: bytes) -> None:
        if role in self.publishers:
            self.publishers[role].publish(data)


def _period_ns(settings: Settings) -> float:
    """Return the wall time of a step, ns; 0 where the arm steps as fast as it may."""
    if settings.follows_clock or settings.real_time_factor == 0.0:
        return 0.0
    return settings.step_ns / settings.real_time_factor
