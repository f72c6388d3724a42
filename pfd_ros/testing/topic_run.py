# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run over topics, as the arm sees it: commands in, rows of the motion and messages out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pfd_ros.arm.commands import Judgement
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Output, Source
from pfd_ros.messages.convert import NANOSECONDS
from pfd_ros.testing.trajectory import Rows


@dataclass
class TopicRun:
    """The arm as pfd_ros.testing.exchange uses it.

    Attributes
    ----------
    engine, send, advance
        Of the arm: its engine, and how to give it a message and to go on to the next state.
    rows
        The motion so far.
    refused
        The verdict on the last command, if it was no answer to its state.
    """

    engine: Engine
    send: Callable[[Source, bytes], Judgement]
    advance: Callable[[], Sequence[Output]]
    rows: Rows
    refused: Judgement | None = None

    def answer(self, source: Source, data: bytes) -> Sequence[Output] | None:
        """Take a command; return the messages up to the next state, None at the end of the run."""
        engine, rows = self.engine, self.rows
        now_ns, (q, qd, _) = engine.arm.stamp_ns, engine.measured()
        judgement = self.send(source, data)
        if engine.pace.waits:
            self.refused = judgement
            return ()
        self.refused = None
        outputs = self.advance()
        k = rows.count
        rows.time[k] = (now_ns - engine.settings.start_ns) / NANOSECONDS
        rows.q[k], rows.qd[k], rows.tau[k] = q, qd, engine.measured()[2]
        rows.count += 1
        return None if rows.count == len(rows.time) else outputs

    def present(self) -> Sequence[Output]:
        """Return the last state and clock tick again."""
        return self.engine.present()
