# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The engine: from the events of a cycle to its messages, and nothing but these two.

No ROS, clock, thread or file: the node feeds it from its topics, the replay from a recording,
and the same events in the same cycles give the same bytes. One cycle is

    events that came since the cycle before   ->   a verdict on each, in the order of the events
    accepted commands                         ->   the drive of the joints
    drive                                     ->   one step of the arm
    outputs                                   ->   verdict rows, then the state, then the clock

Cycles are counted from 1 and never restart. States and clock ticks are numbered by the cycle
alone: a failed arm stands still in simulated time and goes on publishing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from pfd_ros.arm.arm import Arm
from pfd_ros.arm.commands import Judgement, held, judge_array, judge_named, merge
from pfd_ros.arm.events import (
    CLOCK,
    STATES,
    TAKEN,
    TAKEN_COLUMNS,
    Arrival,
    Event,
    Output,
    Overflow,
    Source,
    Verdict,
    VerdictRow,
)
from pfd_ros.arm.settings import Settings
from pfd_ros.messages import convert
from pfd_ros.text import one_line

# Rows of one message: a flood may have dropped a million commands before a cycle.
MOST_ROWS = 4096
OVERFLOWED = Judgement(Verdict.OVERFLOWED, 'newer ones came before the next step')


class CycleResult(NamedTuple):
    """The outputs of one cycle in their order, and its judgements for counts and log lines.

    A judgement comes with its source and the number of messages that were judged like that.
    """

    outputs: list[Output]
    judgements: list[tuple[Source, Judgement, int]]


class Engine:
    """The arm and the rules for its events, at the start of a run.

    `robot` comes from `load_robot` or out of a recording; `cycles` is the number of the last
    cycle, 0 before the first.

    Raises
    ------
    ValueError
        If the settings do not go with the robot.
    """

    def __init__(self, settings: Settings, robot: Any) -> None:
        self.arm = Arm(settings, robot)
        self.settings = self.arm.settings
        self.cycles = 0
        self._row_messages = 0
        self._publish_every = settings.publish_every
        self._clock_every = settings.clock_every if settings.publish_clock else 0
        self._index = {name: i for i, name in enumerate(robot.joint_names)}
        self._drive = held(robot.n)
        self._encoder = convert.JointStateEncoder(self.arm.names, settings.frame_id)

    def run_cycle(self, events: Iterable[Event] = ()) -> CycleResult:
        """Run the next cycle on the events since the last one, and return its outputs."""
        self.cycles += 1
        outputs: list[Output] = []
        judgements: list[tuple[Source, Judgement, int]] = []
        rows: list[VerdictRow] = []
        for event in events:
            if isinstance(event, Overflow):
                judgements.append((event.source, OVERFLOWED, len(event.sequences)))
                outputs.extend(self._overflow_rows(event))
                continue
            judgement = self.judge(event)
            self._drive = merge(self._drive, judgement)
            judgements.append((event.source, judgement, 1))
            rows.append(VerdictRow(self.cycles, event.source, event.sequence, judgement.verdict))
        if rows:
            outputs.append(self._row_message(rows))
        self.arm.advance(self._drive)
        self._add_state_and_tick(outputs)
        return CycleResult(outputs, judgements)

    def judge(self, event: Arrival) -> Judgement:
        """Return the verdict on a message and its effect, which is not applied."""
        try:
            if event.source is Source.NAMED:
                message = convert.decode_joint_state(event.payload)
                return judge_named(message, self._index, self.settings.start_ns)
            return judge_array(convert.decode_floats(event.payload), self.arm.order)
        except ValueError as error:
            return Judgement(Verdict.MALFORMED, one_line(error))

    def stand_still(self, cycle: int) -> None:
        """Pass over the cycles up to `cycle`, for an arm that failed and gets no events.

        State and tick are the same in each of them: a gap of any length costs nothing.
        """
        if not self.arm.failure:
            raise RuntimeError('only an arm that failed stands still')
        self.cycles = max(self.cycles, cycle)

    def _overflow_rows(self, event: Overflow) -> Iterator[Output]:
        for start in range(0, len(event.sequences), MOST_ROWS):
            yield self._row_message(
                [
                    VerdictRow(self.cycles, event.source, sequence, Verdict.OVERFLOWED)
                    for sequence in event.sequences[start : start + MOST_ROWS]
                ]
            )

    def _row_message(self, rows: list[VerdictRow]) -> Output:
        self._row_messages += 1
        return Output(TAKEN, self._row_messages, convert.encode_rows(rows, TAKEN_COLUMNS))

    def _add_state_and_tick(self, outputs: list[Output]) -> None:
        """Add the state and the clock tick of this cycle; the state precedes its tick."""
        arm, cycle = self.arm, self.cycles
        if cycle % self._publish_every == 0:
            state = self._encoder.encode(arm.stamp_ns, arm.q, arm.qd, arm.tau)
            outputs.append(Output(STATES, cycle // self._publish_every, state))
        if self._clock_every and cycle % self._clock_every == 0:
            tick = convert.encode_clock(arm.stamp_ns)
            outputs.append(Output(CLOCK, cycle // self._clock_every, tick))
