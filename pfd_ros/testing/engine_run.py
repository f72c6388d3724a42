# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The run of an engine in lockstep: numbered messages in, outputs out, optionally recorded.

A recorded run passes on every message as bytes; an unrecorded run avoids bytes, and is twice as
fast. Both have the same bits.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
import itertools
from typing import Any

from pfd_ros.arm.commands import Validation
from pfd_ros.arm.driver import Driver
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Arrival, Output, Source, Verdict
from pfd_ros.arm.state import ArmState
from pfd_ros.messages.convert import NANOSECONDS, encode_floats, permutation
from pfd_ros.motion.metrics import Array
from pfd_ros.recording.format import ROLE_OF_SOURCE
from pfd_ros.testing.journal import Input, Journal
from pfd_ros.testing.run_log import RunLog
from pfd_ros.testing.trajectory import Rows


class ArmError(Exception):
    """The simulation stopped, because its state is not finite."""


@dataclass
class EngineRun:
    """An engine in lockstep, and the recording of its run or the journal of its inputs.

    Every method that runs steps raises ArmError if the state does not stay finite.
    """

    engine: Engine
    log: RunLog | None = None
    journal: Journal | None = None
    _numbers: dict[Source, itertools.count[int]] = field(init=False)
    # None where published order is model order.
    _order: Any = field(init=False)
    _driver: Driver = field(init=False)
    _silent: Driver = field(init=False)
    _outputs: list[Output] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Begin to number the messages of each source."""
        self._numbers = {source: itertools.count(1) for source in Source}
        self._order = permutation(self.engine.arm.order)
        self._driver, self._silent = Driver(self.engine, self._put), Driver(self.engine)

    @property
    def time(self) -> float:
        """The stamp of the last state, s of simulated time."""
        return self.engine.arm.stamp_ns / NANOSECONDS

    def measured(self) -> tuple[Array, Array, Array]:
        """Return positions, velocities and efforts of the last state, (n,), published order."""
        measured, order = self.engine.measured(), self._order
        if order is None:
            return measured
        q, qd, tau = measured
        return q[order], qd[order], tau[order]

    def command(self, efforts: Array) -> Validation:
        """Command efforts (n,), published order; if accepted, run to the next published state."""
        if self.log is not None:
            validation = self.send(Source.ARRAY, encode_floats(efforts))
            self.advance()
            return validation
        validation = self._silent.answer(efforts)
        if self.engine.arm.state.failure:
            self._check()
        return validation

    def send(self, source: Source, data: bytes) -> Validation:
        """Send a serialized message to the arm, as on a topic; return the validation result."""
        if self.journal is not None:
            self.journal.add(self.engine.cycles, source, data)
        arrival = Arrival(source, next(self._numbers[source]), data)
        if self.log is not None:
            self.log.record(ROLE_OF_SOURCE[source], arrival.sequence, data)
        ((_, validation, _),) = self._driver.take([arrival])
        self._outputs.clear()
        if self.log is not None:
            self.log.accepted += validation.verdict is Verdict.ACCEPTED
        return validation

    def repeat(self, inputs: Iterable[Input], cycles: int) -> None:
        """Take inputs at their cycles and run `cycles` cycles, or until the arm fails."""
        with suppress(ArmError):
            for before, source, content in inputs:
                self._run_to(before)
                if isinstance(content, Rows):
                    for efforts in content.tau[: content.count]:
                        self.command(efforts)
                elif source is not None:
                    self.send(source, content)
            self._run_to(cycles)

    def _run_to(self, cycles: int) -> None:
        while self.engine.cycles < cycles:
            self.step()

    def restore(self, state: ArmState) -> None:
        """Continue from a saved state; ValueError for another arm's, or in a recorded run."""
        if self.log is not None:
            raise ValueError(
                f'this run is recorded in {self.engine.settings.recording!r}, and a recording '
                'holds one run from its start: restore a state in an arm without recording'
            )
        self.engine.restore(state)
        if self.journal is not None:
            self.journal.restart(state.copy())

    def demand(self, source: Source, data: bytes) -> None:
        """Send a message; ValueError if the arm does not accept it."""
        validation = self.send(source, data)
        if validation.verdict is not Verdict.ACCEPTED:
            raise ValueError(f'{validation.verdict.label}: {validation.detail}')

    def advance(self) -> list[Output]:
        """Run to the next published state, if the last one has its answer; return the messages."""
        self._driver.run_to_answer()
        return self._ended()

    def step(self) -> list[Output]:
        """Run one step; return its messages."""
        self._driver.step()
        return self._ended()

    def _ended(self) -> list[Output]:
        self._check()
        found, self._outputs = self._outputs, []
        return found

    def _put(self, outputs: Sequence[Output]) -> None:
        self._outputs += outputs
        if self.log is not None:
            self.log.record_all(outputs)

    def _check(self) -> None:
        if self.engine.arm.failure:
            raise ArmError(f't = {self.time:.6g} s: {self.engine.arm.failure}')

    def close(self) -> None:
        """Close the recording, if there is one; later messages are not recorded."""
        log, self.log = self.log, None
        if log is not None:
            log.close()
