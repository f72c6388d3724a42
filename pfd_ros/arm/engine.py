# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The engine: from the events of a cycle to its messages, and nothing but these two.

No ROS, clock, thread or file: the node feeds it from its topics, the replay from a recording,
and the same events in the same cycles give the same bytes. One cycle is

    events that came since the cycle before   ->   a verdict on each, in the order of the events
    accepted commands                         ->   the drive of the joints
    drive                                     ->   one step of the arm, or a jump to another state
    outputs     ->   verdict rows, a new payload, state, what is asked beside, clock

`take` does the first half and `step` the second: while the arm stands (a pause, or lockstep
without an answer to the last state), events are taken and no cycle runs. A caller that
wants no rows or no bytes uses `accept` or `command`, `advance` and `measured` in their place: the
same run.

Cycles are counted from 1 and never restart. States and clock ticks are numbered by the cycle
alone: a failed arm stands still in simulated time and goes on publishing.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

import pfd_core as pfd
from pfd_ros.arm.actuators import Actuators
from pfd_ros.arm.arm import Arm
from pfd_ros.arm.changes import PayloadEcho
from pfd_ros.arm.command_link import CommandLink
from pfd_ros.arm.commands import Judgement
from pfd_ros.arm.drive import Command, Drive, held, let_go
from pfd_ros.arm.effects import ClockTick, SettingsChange, StateChange, WrenchChange
from pfd_ros.arm.events import (
    CLOCK,
    COMMANDS,
    DROPPED_STATES,
    STATES,
    Arrival,
    Event,
    Output,
    Overflow,
    Source,
    Verdict,
    VerdictRow,
)
from pfd_ros.arm.followed_clock import FollowedClock
from pfd_ros.arm.judging import Judge
from pfd_ros.arm.outputs import extra_outputs
from pfd_ros.arm.pace import Pace
from pfd_ros.arm.sensors import JointArrays, sensors_of
from pfd_ros.arm.settings import Settings
from pfd_ros.arm.verdict_rows import VerdictRows
from pfd_ros.arm.wrench import ExternalWrench
from pfd_ros.messages import convert

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
    settings
        As they are now: events change the dynamic ones.
    cycles
        Number of the last cycle, 0 before the first.
    pace
        Whether there may be a next one.
    link
        The way of commands to the actuators.
    actuators
        From the commands that arrived to the efforts that act.
    applied
        The efforts and brakes of the last step.
    wrench
        The wrench on the last link, None in a scene without one.
    jumps
        The states that the next step jumps to, one after the other.
    sensors
        From the true state to the measured one, None where these are the same.

    Raises
    ------
    ValueError
        If the settings do not go with the robot.
    """

    def __init__(self, settings: Settings, robot: pfd.Robot, *, rows: bool = True) -> None:
        self.arm = Arm(settings, robot)
        self.settings = self.arm.settings
        self.cycles = 0
        # The cycle of the start or the last reset, from which noise counts.
        self._begun = 0
        self._role = ''
        clock = FollowedClock(settings.step_ns) if settings.follows_clock else None
        self.pace = Pace(
            settings.lockstep, settings.autostart, clock, settings.wait_for_controller
        )
        self._rows = VerdictRows() if rows else None
        self._publish_every = settings.publish_every
        self._clock_every = settings.clock_every if settings.publish_clock else 0
        self.applied = held(robot.n)
        self.link = CommandLink(self.settings, self.arm.order)
        self.actuators = Actuators(self.settings, robot, self.arm.order, self.arm.scene)
        self._rules = Judge(self.arm, self.pace, self.actuators)
        self.wrench = ExternalWrench(settings) if self.arm.scene.external_wrench else None
        self._payload_echo = PayloadEcho(self.arm)
        self.jumps: list[StateChange | None] = []
        self.sensors = sensors_of(self.settings, self.arm)
        self._extra = extra_outputs(self.settings, self.arm)
        self._encoder = convert.JointStateEncoder(
            self.arm.names, settings.frame_id, settings.published_locks
        )

    @property
    def newest_command_ns(self) -> int | None:
        """Stamp of the newest command by name, accepted or not, ns; None before the first."""
        return self._rules.newest_ns

    @property
    def stands(self) -> bool:
        """Whether the next cycle has to wait for an event."""
        # Of an arm that failed simulated time stands still; cycles go on as if it did not.
        steps = self.cycles + 1 - self.arm.step
        if self.pace.forbids(self.arm.stamp_ns + steps * self.settings.step_ns):
            return True
        return self.pace.stands and not self.jumps

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
                if self._rows is not None:
                    outputs.extend(self._rows.of_overflow(event, cycle))
                continue
            judgement = self.accept(event)
            judgements.append((event.source, judgement, 1))
            if self._rows is not None:
                rows.append(VerdictRow(cycle, event.source, event.sequence, judgement.verdict))
        if self._rows is not None and rows:
            outputs.append(self._rows.message(rows))
        return Taken(outputs, judgements)

    def accept(self, event: Arrival) -> Judgement:
        """Judge one message and apply it to the next cycle, without a row."""
        judgement = self.judge(event)
        self._apply(event.source, judgement)
        return judgement

    def judge(self, event: Arrival) -> Judgement:
        """Return the verdict on a message and its effect, which is not applied."""
        return self._rules.judge(event)

    def _apply(self, source: Source, judgement: Judgement) -> None:
        effect = judgement.effect
        if self.pace.lockstep and source in COMMANDS:
            self.pace.answer(judgement.verdict)
        if isinstance(effect, Command):
            self.link.send(effect, self.cycles + 1)
        elif isinstance(effect, StateChange):
            self.jumps.append(effect)
            self._forget_commands(let_go(self.link.drive))
        elif isinstance(effect, SettingsChange):
            self._set(effect)
        elif isinstance(effect, ClockTick):
            self._follow(effect)
        elif isinstance(effect, WrenchChange):
            if self.wrench is not None:
                self.wrench.put(effect, self.settings.external_wrench_timeout)
        elif effect is not None:
            if effect.name == 'reset':
                self._reset()
            elif effect.name == 'deactivate':
                self._forget_commands(held(len(self.arm.order)))
            elif effect.name == 'clear_wrench':
                self._clear_wrench()
            self.pace.request(effect)

    def _reset(self) -> None:
        """Let the next step end in the initial state, without anything from before."""
        self.arm.revive(self.cycles)
        self.jumps = [None]
        self.link.sent = 0
        self._forget_commands(held(len(self.arm.order)))
        self._rules.reset_ns = self._rules.since_ns
        self._clear_wrench()

    def _forget_commands(self, drive: Drive) -> None:
        """Go on with a drive, and without all commands from before the next step."""
        self.link.clear(drive)
        self.actuators.restart()
        self._rules.since_ns = self.arm.stamp_ns + self.settings.step_ns

    def command(self, efforts: np.ndarray) -> Judgement:
        """Judge and apply efforts (n,) in published order, as a command without names has them.

        For callers that neither record nor publish the command: it has no bytes.
        """
        judgement = self._rules.judge_efforts(efforts)
        self._apply(Source.ARRAY, judgement)
        return judgement

    def _clear_wrench(self) -> None:
        if self.wrench is not None:
            self.wrench.clear()

    def _set(self, change: SettingsChange) -> None:
        """Take over other values of dynamic settings; all others are as before."""
        self.settings = change.settings
        self.arm.change(change.settings, change.plant)
        self.link.set(self.settings)
        self.actuators.set(self.settings)
        self.sensors = sensors_of(self.settings, self.arm, self.sensors)
        if change.plant is not None:
            self._extra = extra_outputs(self.settings, self.arm)

    def _follow(self, tick: ClockTick) -> None:
        clock = self.pace.clock
        assert clock is not None
        if clock.until_ns is None:
            self.arm.leap(tick.stamp_ns)
            self._rules.since_ns = tick.stamp_ns
        clock.until_ns = tick.stamp_ns

    def step(self) -> list[Output]:
        """Run the next cycle on the events that were taken; return its state and its tick."""
        self.advance()
        outputs: list[Output] = []
        self._add_state_and_tick(outputs)
        new_payload = self._payload_echo.output()
        if new_payload is not None:
            outputs.insert(0, new_payload)
        return outputs

    def advance(self) -> None:
        """Run the next cycle on the events that were taken, without a message of its outputs."""
        self.cycles += 1
        if self.jumps and self.jumps[0] is None:
            self._begun = self.cycles
        if not self.arm.failure:
            self._actuate()
        if self.wrench is not None:
            self.arm.wrench = self.wrench.next()
        if self.jumps:
            self.arm.jump(self.jumps)
            self.jumps = []
            if self.sensors is not None:
                self.sensors.restart()
        else:
            self.arm.advance(self.applied)
            if self.sensors is not None:
                self.sensors.sample()
        self._role = self._state_role()
        self.pace.stepped(published=self._role == STATES)
        if self.pace.waits:
            self._rules.since_ns = self.arm.stamp_ns

    def _state_role(self) -> str:
        """Return the role of this cycle's state, '' if it has none."""
        if self.cycles % self._publish_every:
            return ''
        dropped = self.sensors is not None and self.sensors.drops(self.cycles - self._begun)
        return DROPPED_STATES if dropped else STATES

    def _actuate(self) -> None:
        """Let the commands that are due reach the drives, and the drives decide on their efforts.

        A failed arm has no drives: a gap in its cycles changes nothing.
        """
        if self.link.advance(self.cycles, self.arm.q):
            # The watchdog is no controller: a reflex does not look at its jump.
            self.actuators.restart()
        if self.jumps:
            self.applied = let_go(self.link.drive)
            return
        self.applied = self.actuators.applied(self.link.drive, self.arm.q, self.arm.qd)
        if self.actuators.tripped:
            self.link.clear(self.applied)

    def measured(self) -> JointArrays:
        """Return the positions, velocities and efforts that the state of this cycle tells."""
        if self.sensors is None:
            return self.arm.q, self.arm.qd, self.arm.tau
        return self.sensors.measured(self.cycles - self._begun)

    def present(self) -> list[Output]:
        """Return the state, the outputs beside it and the tick, for readers that missed them.

        They are not part of the run: no cycle, and nothing to record.
        """
        arm = self.arm
        state = self._encoder.encode(arm.stamp_ns, *self.measured())
        found = [Output(STATES, 0, state), *self._beside_the_state(0)]
        if self._clock_every:
            found.append(Output(CLOCK, 0, convert.encode_clock(arm.stamp_ns)))
        return found

    def stand_still(self, cycle: int) -> None:
        """Pass over the cycles up to `cycle`, for an arm that failed and gets no events.

        The arm is the same in each of them: a gap of any length costs nothing.
        """
        if not self.arm.failure:
            raise RuntimeError('only an arm that failed stands still')
        self.cycles = max(self.cycles, cycle)

    def _add_state_and_tick(self, outputs: list[Output]) -> None:
        """Add the state of this cycle, the outputs beside it, and the clock tick."""
        arm, cycle = self.arm, self.cycles
        if self._role:
            state = self._encoder.encode(arm.stamp_ns, *self.measured())
            number = cycle // self._publish_every
            outputs.append(Output(self._role, number, state))
            if self._extra is not None:
                outputs.extend(self._beside_the_state(number))
        if self._clock_every and cycle % self._clock_every == 0:
            tick = convert.encode_clock(arm.stamp_ns)
            outputs.append(Output(CLOCK, cycle // self._clock_every, tick))

    def _beside_the_state(self, number: int) -> list[Output]:
        messages = [] if self._extra is None else self._extra.messages()
        return [Output(role, number, data) for role, data in messages]
