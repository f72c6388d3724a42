# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The engine: from the events of a cycle to its messages, and nothing but these two.

No ROS, clock, thread or file: the node feeds it from its topics, the replay from a recording,
and the same events in the same cycles give the same bytes. One cycle is

    events that came since the cycle before   ->   a verdict on each, in the order of the events
    accepted commands                         ->   the drive of the joints
    drive                                     ->   one step of the arm, or a jump to another state
    outputs                                   ->   verdict rows, then the state, then the clock

`take` does the first half and `step` the second: while the arm stands (a pause, or lockstep
without an answer to the last state), events are taken and no cycle runs. A caller that wants
numbers and no bytes uses `command`, `advance` and `measured` in their place: the same run.

Cycles are counted from 1 and never restart. States and clock ticks are numbered by the cycle
alone: a failed arm stands still in simulated time and goes on publishing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from pfd_ros.arm.arm import Arm
from pfd_ros.arm.commands import Judgement, held, judge_array, judge_named, let_go, merge
from pfd_ros.arm.effects import StateChange
from pfd_ros.arm.events import (
    CLOCK,
    COMMANDS,
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
from pfd_ros.arm.pace import Pace
from pfd_ros.arm.requests import judge_request, judge_state
from pfd_ros.arm.settings import Settings
from pfd_ros.messages import convert
from pfd_ros.text import one_line

# Rows of one message: a flood may have dropped a million commands before a cycle.
MOST_ROWS = 4096
OVERFLOWED = Judgement(Verdict.OVERFLOWED, 'newer ones came before the next step')


class Taken(NamedTuple):
    """The verdict rows of some events, and the judgements for counts and log lines.

    A judgement comes with its source and the number of messages that were judged like that.
    """

    outputs: list[Output]
    judgements: list[tuple[Source, Judgement, int]]


class Engine:
    """The arm and the rules for its events, at the start of a run.

    Parameters
    ----------
    settings
        Settings of the run.
    robot
        From `load_robot` or out of a recording.
    rows
        Whether `take` encodes verdict rows, which only recordings hold.

    Attributes
    ----------
    cycles
        Number of the last cycle, 0 before the first.
    pace
        Whether there may be a next one.
    drive
        The efforts and brakes of the next step.
    jumps
        The states that the next step jumps to, one after the other.

    Raises
    ------
    ValueError
        If the settings do not go with the robot.
    """

    def __init__(self, settings: Settings, robot: Any, *, rows: bool = True) -> None:
        self.arm = Arm(settings, robot)
        self.settings = self.arm.settings
        self.cycles = 0
        self.pace = Pace(settings.lockstep, from_start=settings.wait_for_controller)
        self._rows = rows
        self._row_messages = 0
        self._publish_every = settings.publish_every
        self._clock_every = settings.clock_every if settings.publish_clock else 0
        self._index = {name: i for i, name in enumerate(robot.joint_names)}
        self.drive = held(robot.n)
        # Stamped commands from before are left-overs.
        self._since_ns = settings.start_ns
        self.jumps: list[StateChange | None] = []
        self._encoder = convert.JointStateEncoder(self.arm.names, settings.frame_id)

    @property
    def stands(self) -> bool:
        """Whether the next cycle has to wait for an event."""
        return self.pace.stands and not self.jumps and not self.arm.failure

    def run_cycle(self, events: Iterable[Event] = ()) -> Taken:
        """Run the next cycle on the events since the last one; return all outputs of it."""
        taken = self.take(events)
        return Taken(taken.outputs + self.step(), taken.judgements)

    def take(self, events: Iterable[Event]) -> Taken:
        """Judge events and apply them to the next cycle; return their verdict rows."""
        outputs: list[Output] = []
        judgements: list[tuple[Source, Judgement, int]] = []
        rows: list[VerdictRow] = []
        cycle = self.cycles + 1
        for event in events:
            if isinstance(event, Overflow):
                judgements.append((event.source, OVERFLOWED, len(event.sequences)))
                if self._rows:
                    outputs.extend(self._overflow_rows(event))
                continue
            judgement = self.judge(event)
            self._apply(event.source, judgement)
            judgements.append((event.source, judgement, 1))
            if self._rows:
                rows.append(VerdictRow(cycle, event.source, event.sequence, judgement.verdict))
        if rows:
            outputs.append(self._row_message(rows))
        return Taken(outputs, judgements)

    def judge(self, event: Arrival) -> Judgement:
        """Return the verdict on a message and its effect, which is not applied."""
        source, payload = event.source, event.payload
        try:
            if source is Source.ARRAY:
                return judge_array(convert.decode_floats(payload), self.arm.order)
            if source is Source.NAMED:
                message = convert.decode_joint_state(payload)
                return judge_named(message, self._index, self._since_ns)
            if source is Source.SET_STATE:
                message = convert.decode_joint_state(payload)
                return judge_state(message, self._index, self._since_ns)
            return judge_request(convert.decode_string(payload), self.pace.paused)
        except ValueError as error:
            return Judgement(Verdict.MALFORMED, one_line(error))

    def _apply(self, source: Source, judgement: Judgement) -> None:
        effect = judgement.effect
        if source in COMMANDS:
            self.drive = merge(self.drive, judgement)
            self.pace.answer(judgement.verdict)
        elif isinstance(effect, StateChange):
            self.jumps.append(effect)
            self.drive = let_go(self.drive)
            self._since_ns = self.arm.stamp_ns + self.settings.step_ns
        elif effect is not None and effect.name == 'reset':
            self.jumps = [None]
            self.drive = held(len(self.arm.order))
            self._since_ns = self.arm.stamp_ns + self.settings.step_ns
        elif effect is not None:
            self.pace.request(effect)

    def command(self, efforts: np.ndarray) -> Judgement:
        """Judge and apply efforts (n,) in published order, as a command without names has them.

        For callers that neither record nor publish the command: it has no bytes and no number.
        """
        judgement = judge_array(efforts, self.arm.order)
        self._apply(Source.ARRAY, judgement)
        return judgement

    def step(self) -> list[Output]:
        """Run the next cycle on the events that were taken; return its state and its tick."""
        self.advance()
        outputs: list[Output] = []
        self._add_state_and_tick(outputs)
        return outputs

    def advance(self) -> None:
        """Run the next cycle on the events that were taken, without a message of its outputs."""
        self.cycles += 1
        if self.jumps:
            self.arm.jump(self.jumps)
            self.jumps = []
        else:
            self.arm.advance(self.drive)
        self.pace.stepped(published=self.cycles % self._publish_every == 0)
        if self.pace.waits:
            self._since_ns = self.arm.stamp_ns

    def measured(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the positions, velocities and efforts (n,) that states tell, published order."""
        return self.arm.q, self.arm.qd, self.arm.tau

    def present(self) -> list[Output]:
        """Return the state and the clock tick as they are now, for readers that missed them.

        They are not part of the run: no cycle, and nothing to record.
        """
        arm = self.arm
        state = self._encoder.encode(arm.stamp_ns, *self.measured())
        found = [Output(STATES, 0, state)]
        if self._clock_every:
            found.append(Output(CLOCK, 0, convert.encode_clock(arm.stamp_ns)))
        return found

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
                    VerdictRow(self.cycles + 1, event.source, sequence, Verdict.OVERFLOWED)
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
            state = self._encoder.encode(arm.stamp_ns, *self.measured())
            outputs.append(Output(STATES, cycle // self._publish_every, state))
        if self._clock_every and cycle % self._clock_every == 0:
            tick = convert.encode_clock(arm.stamp_ns)
            outputs.append(Output(CLOCK, cycle // self._clock_every, tick))
