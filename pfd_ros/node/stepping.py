# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The stepping thread: one cycle of the engine per period, recorded, then published.

Short delays are made up for, so that the mean rate is exact. After a longer stall the periods that
passed are skipped and counted. The thread uses the steady clock alone.

See docs/decisions/0003-executor-and-stepping-thread.md.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
import time
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import NAMED, STATES, Message, Verdict
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.joints import decode_joints
from pfd_ros.node.inbox import Inbox

if TYPE_CHECKING:
    from pfd_ros.recording.recorder import Recorder

# Longest delay that is made up for, ns.
CATCH_UP_NS = 50_000_000
# Longest sleep, s: a slow or waiting arm still answers requests, and notices its end.
LONGEST_SLEEP = 0.05
# In lockstep, time until a state without an answer is sent again: a reader may miss a clock tick.
RESEND_SECONDS = 0.2
# Time without an answer until a command with the stamp of an earlier state is taken as one; and if
# that state was sent again, as it may be a second answer to it.
LAGGING_SECONDS, UNSURE_SECONDS = 0.02, 5.0
# Where a serialized JointState has its stamp, and the stamp of a command that is for now.
STAMP, NOW = slice(4, 12), bytes(8)
# At unlimited speed the arm waits for the disk from this share of the recorder's queue on, and
# looks so often, s.
MOST_BACKLOG, DISK_SECONDS = 0.25, 0.001
# Time after which it does not wait any longer for a disk that has written nothing, s: the queue
# fills, which ends the recording, and the arm goes on.
DEAD_SECONDS = 30.0
# Number of steps whose duration is kept.
LENGTHS = 1 << 13


class Stepper:
    """Steps an engine in real time, at a multiple of it, or as fast as possible.

    `recorder` is set before `run`, and an output without a publisher is only recorded. `count` is
    called with role and verdict of each input that the engine has taken. `late` steps came more
    than a period late, `missed` periods were skipped, `resent` states were sent again, because no
    command answered them, and `lagging` commands answered with an earlier stamp.
    `whole` is whether `run` has returned: otherwise the arm may be in the middle of a cycle.
    """

    def __init__(
        self,
        engine: Engine,
        inbox: Inbox,
        publishers: Mapping[str, Any],
        count: Callable[[str, Verdict], None],
    ) -> None:
        self.engine = engine
        self.recorder: Recorder | None = None
        self.started = time.monotonic()
        self.states = self.late = self.missed = self.resent = self.lagging = 0
        self._inbox, self._publishers, self._count = inbox, publishers, count
        self._settings: Settings | None = None
        self._period = 0.0
        self._unpaced = self.whole = False
        self._due = 0.0
        # When the disk was last known to keep up, s.
        self._kept_up = 0.0
        # The stamp of the last state that was sent again; a command that came with the stamp of an
        # earlier state than the one that waits, and when it may be taken.
        self._again_ns: int | None = None
        self._lagged: tuple[Message, float] | None = None
        # Written by this thread, read by another, without a lock: faster than a NumPy array.
        self._lengths = array('q', bytes(8 * LENGTHS))

    def run(self, stopped: Callable[[], bool]) -> None:
        """Step until `stopped` returns True."""
        engine = self.engine
        while not stopped():
            if engine.state.settings is not self._settings:
                self._keep_to(engine.state.settings)
            if self._unpaced and self._waits_for_disk():
                self._take(self._inbox.take(DISK_SECONDS), run=False)
            elif engine.waiting:
                self._wait(stopped)
            elif self._period:
                self._step_when_due()
            else:
                self._take(self._inbox.take(), run=True)
                # Yields to other threads.
                time.sleep(0)
        self.whole = True

    def _waits_for_disk(self) -> bool:
        recorder, now = self.recorder, time.monotonic()
        if recorder is None or recorder.waiting_share <= MOST_BACKLOG:
            self._kept_up = now
        return 0.0 < now - self._kept_up < DEAD_SECONDS

    def _keep_to(self, settings: Settings) -> None:
        """Take over another real-time factor, which is pacing only."""
        self._settings, self._kept_up = settings, time.monotonic()
        factor = 0.0 if settings.follows_clock else settings.real_time_factor
        self._unpaced = not settings.follows_clock and not factor
        period = settings.step_ns / factor if factor else 0.0
        if period != self._period:
            self._period = period
            self._due = time.monotonic_ns() + period

    def _step_when_due(self) -> None:
        behind = time.monotonic_ns() - self._due
        if behind < -1e9 * LONGEST_SLEEP:
            # Requests are answered long before the next step of a slow arm.
            self._take(self._inbox.take(LONGEST_SLEEP), run=False)
            return
        if behind > self._period:
            self.late += 1
        if behind > max(CATCH_UP_NS, self._period):
            skipped = int(behind / self._period)
            self.missed += skipped
            self._due += skipped * self._period
        while behind < 0.0:
            time.sleep(-behind / 1e9)
            behind = time.monotonic_ns() - self._due
        self._due += self._period
        self._take(self._inbox.take(), run=True)

    def _wait(self, stopped: Callable[[], bool]) -> None:
        """Take inputs until one lets the arm go on; in lockstep, send its state again.

        A sender whose clock lags stamps its answer with the time of an earlier state, and then
        waits for the next tick: the hardware of ros2_control has a clock beside that of its
        controller manager. If nothing else came, that is the answer, without its stamp.
        """
        engine, sent = self.engine, time.monotonic()
        cycle, settings = engine.state.cycle, engine.state.settings
        while engine.waiting and not stopped():
            # Without a period, the answer is followed by its step at once.
            patience = LONGEST_SLEEP if self._lagged is None else LAGGING_SECONDS
            self._take(self._inbox.take(patience), run=not self._period)
            if engine.state.cycle != cycle or engine.state.settings is not settings:
                break
            # An arm that is inactive sends nothing.
            if not (engine.state.active and engine.state.waits):
                continue
            now = time.monotonic()
            if self._lagged is not None and now > self._lagged[1]:
                (role, data, _), _ = self._lagged
                # Its sender does not answer states that come again.
                self._lagged = self._again_ns = None
                self.lagging += 1
                answer = Message(role, data[: STAMP.start] + NOW + data[STAMP.stop :])
                self._take([(answer, Future())], run=not self._period)
            elif now - sent > RESEND_SECONDS:
                sent, self.resent, self._again_ns = now, self.resent + 1, engine.stamp_ns
                self._publish(engine.present())
        # A step that had to wait is due at once.
        self._due = max(self._due, time.monotonic_ns())

    def _take(self, taken: Sequence[tuple[Message, Future[Verdict]]], *, run: bool) -> None:
        """Pass inputs to the engine; record its messages before anybody can answer them."""
        engine = self.engine
        before, begun = engine.state.cycle, time.perf_counter_ns()
        messages, verdicts = engine.step([message for message, _ in taken], run)
        if messages and self.recorder is not None:
            self.recorder.put(messages, engine.stamp_ns)
        for (message, future), verdict in zip(taken, verdicts, strict=True):
            self._count(message.role, verdict)
            future.set_result(verdict)
            if verdict.label == 'stale' and message.role == NAMED and engine.state.waits:
                self._keep_lagged(message)
        self._publish(messages)
        if engine.state.cycle != before:
            self._lagged = None
            self._lengths[engine.state.cycle % LENGTHS] = time.perf_counter_ns() - begun

    def _keep_lagged(self, message: Message) -> None:
        """Keep a stale command if it may answer the state that waits.

        Its stamp is of a state since the last reset. If that state or a later one was sent again,
        the command may be a second answer to it.
        """
        stamp_ns, again_ns = decode_joints(message.data).stamp_ns, self._again_ns
        if stamp_ns >= self.engine.state.reset_ns:
            unsure = again_ns is not None and stamp_ns <= again_ns
            after = UNSURE_SECONDS if unsure else LAGGING_SECONDS
            self._lagged = message, time.monotonic() + after

    def _publish(self, messages: Sequence[Message]) -> None:
        for role, data, _ in messages:
            if role in self._publishers:
                self._publishers[role].publish(data)
                self.states += role == STATES

    def newest_lengths(self, count: int) -> NDArray[Any]:
        """Return the durations of the newest cycles, ns, LENGTHS at most."""
        last = self.engine.state.cycle
        cycles = np.arange(last - min(count, LENGTHS), last) + 1
        lengths: NDArray[Any] = np.frombuffer(self._lengths, np.int64)
        return lengths[cycles % LENGTHS]
