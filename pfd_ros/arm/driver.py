# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The driver of an engine: events in, cycles run, outputs passed on in their order.

The live node, a replay, and lockstep in this process and over topics all run an engine through a
Driver; they differ in where events come from and where outputs go.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.commands import Validation
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Event, Output, Source, Verdict

ANSWERED = Validation(Verdict.ACCEPTED)
# The only command of a control period comes at its start.
FIRST = (0,)


@dataclass
class Driver:
    """Runs an engine.

    Attributes
    ----------
    engine
        The arm and its rules.
    put
        Called with the outputs of each cycle, and with the validation rows of events. Without it
        no message is encoded; the arm moves with the same bits.
    """

    engine: Engine
    put: Callable[[Sequence[Output]], None] | None = None

    def take(self, events: Iterable[Event]) -> list[tuple[Source, Validation, int]]:
        """Validate events and apply them to the next cycle; return the validation results."""
        taken = self.engine.take(events)
        if self.put is not None and taken.outputs:
            self.put(taken.outputs)
        return taken.validations

    def step(self) -> None:
        """Run the next cycle."""
        if self.put is None:
            self.engine.advance()
        else:
            self.put(self.engine.step())

    def run_to(self, cycle: int) -> None:
        """Run the cycles up to this one, the cycles of a failed arm at once."""
        engine = self.engine
        while engine.cycles < cycle:
            if engine.state.failure:
                engine.skip_cycles(cycle - 1)
            self.step()

    def answer(self, efforts: NDArray[Any]) -> Validation:
        """Command efforts (n,), published order; if accepted, run to the next published state.

        For an arm in lockstep that neither records nor publishes: the command has no bytes.
        """
        engine = self.engine
        if engine.publish_every == 1:
            if engine.answer(efforts):
                return ANSWERED
        else:
            cycles = engine.publish_every - engine.state.cycle % engine.publish_every
            if engine.stretch(np.tile(efforts, (cycles, 1)), FIRST) is not None:
                return ANSWERED
        validation = engine.command(efforts)
        self.run_to_answer()
        return validation

    def run_to_answer(self) -> None:
        """Run to the next published state, if the last one has its answer, or to a failure."""
        state = self.engine.state
        while not state.pace.waits and not state.failure:
            self.step()
