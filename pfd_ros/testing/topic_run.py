# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run over topics, as the arm sees it: commands in, rows of the motion and messages out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pfd_ros.arm.events import Output, Source
from pfd_ros.testing.engine_run import EngineRun
from pfd_ros.testing.rejections import STALE, RejectedError, rejection
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
    allowed
        Reasons for which a command may be rejected.
    rejected
        Why the last command was rejected, '' if it was not.
    repeats
        Number of repeated states, each of which may cause one stale command.
    """

    run: EngineRun
    rows: Rows
    allowed: frozenset[str] = frozenset()
    rejected: str = ''
    repeats: int = 0

    @property
    def time(self) -> float:
        """The stamp of the last state, s of simulated time."""
        return self.run.time

    @property
    def answers(self) -> int:
        """Number of states that were answered."""
        return self.rows.count

    def answer(self, source: Source, data: bytes, seconds: float) -> Sequence[Output] | None:
        """Take a command; return the messages up to the next state, None at the end of the run.

        There are no messages if the last state still waits for its answer.

        Parameters
        ----------
        source, data
            The command.
        seconds
            Wall time since the state was published.

        Raises
        ------
        RejectedError
            If it is rejected for a reason that is not allowed; the arm stays in its state.
        """
        run, engine, rows = self.run, self.run.engine, self.rows
        time, (q, qd, _) = run.time, run.measured()
        validation = run.send(source, data)
        found = rejection(source, data, validation, engine.arm.names, engine.arm.robot.joint_names)
        self.rejected = '' if found is None else str(found)
        if found is not None and found.reason not in self.allowed:
            if found.reason != STALE or not self.repeats:
                raise RejectedError(str(found))
            self.repeats -= 1
        if engine.state.pace.waits:
            return ()
        outputs = run.advance()
        k = rows.count
        rows.time[k], rows.compute_time[k] = time, seconds
        rows.q[k], rows.qd[k], rows.tau[k] = q, qd, run.measured()[2]
        rows.count += 1
        return None if rows.count == len(rows.time) else outputs

    def present(self) -> Sequence[Output]:
        """Return the last state and clock tick again."""
        return self.run.engine.present()
