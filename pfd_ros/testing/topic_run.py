# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run over topics, as the arm sees it: commands in, rows of the motion and messages out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pfd_ros.arm.commands import Judgement
from pfd_ros.arm.events import Output, Source
from pfd_ros.testing.engine_run import EngineRun
from pfd_ros.testing.trajectory import Rows


@dataclass
class TopicRun:
    """The arm as pfd_ros.testing.exchange uses it.

    Attributes
    ----------
    run
        The engine and its recording.
    rows
        The motion so far.
    refused
        The verdict on the last command, if it was no answer to its state.
    """

    run: EngineRun
    rows: Rows
    refused: Judgement | None = None

    def answer(self, source: Source, data: bytes) -> Sequence[Output] | None:
        """Take a command; return the messages up to the next state, None at the end of the run.

        There are no messages if the last state still waits for its answer.
        """
        run, engine, rows = self.run, self.run.engine, self.rows
        time, (q, qd, _) = run.time, engine.measured()
        judgement = run.send(source, data)
        if engine.pace.waits:
            self.refused = judgement
            return ()
        self.refused = None
        outputs = run.advance()
        k = rows.count
        rows.time[k] = time
        rows.q[k], rows.qd[k], rows.tau[k] = q, qd, engine.measured()[2]
        rows.count += 1
        return None if rows.count == len(rows.time) else outputs

    def present(self) -> Sequence[Output]:
        """Return the last state and clock tick again."""
        return self.run.engine.present()
