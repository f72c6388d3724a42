# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The engine: from the events of a cycle to its messages.

No ROS, clock, thread or file: the node feeds it from its topics, the replay from a recording,
and the same events in the same cycles give the same bytes. One cycle is

    events since the last cycle   ->   a validation result for each, in order
    accepted commands             ->   the actuator command
    actuator command              ->   one step of the arm, or a change to another state
    outputs                       ->   validation rows, a new payload, state, outputs, clock

`take` validates events; `step` advances the simulation. While the arm waits (in a pause, or in
lockstep for an answer to the last state), events are taken and no cycle runs. Callers that need no
rows or no bytes use `accept` or `command`, `advance` and `measured` instead, for the same run.

Cycles are counted from 1 and never restart. States and clock ticks are numbered by the cycle
alone: the simulated time of a failed arm is stopped, and it continues to publish.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
import math
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm import actuators, command_link, wrench
from pfd_ros.arm.actuator_command import ActuatorCommand, Command, all_braked, free, zero_effort
from pfd_ros.arm.actuators import Actuators
from pfd_ros.arm.arm import Arm
from pfd_ros.arm.changes import payload_message
from pfd_ros.arm.command_link import CommandLink
from pfd_ros.arm.commands import Validation
from pfd_ros.arm.events import (
    ARM_STATE,
    CLOCK,
    COMMANDS,
    DROPPED_STATES,
    STATES,
    TAKEN,
    TAKEN_COLUMNS,
    TF,
    Arrival,
    ClockTick,
    Event,
    Output,
    Overflow,
    Request,
    SettingsChange,
    Source,
    StateChange,
    ValidationRow,
    Verdict,
    WrenchChange,
)
from pfd_ros.arm.link_frames import LinkFrames
from pfd_ros.arm.outputs import extra_outputs
from pfd_ros.arm.pace import Pace, needs_event
from pfd_ros.arm.sensors import Sensors
from pfd_ros.arm.settings import Settings
from pfd_ros.arm.state import ArmState, JointArrays
from pfd_ros.arm.validation import Validator
from pfd_ros.messages import convert

# Rows of one message: a flood may have dropped a million commands before a cycle.
MOST_ROWS = 4096
OVERFLOWED = Validation(Verdict.OVERFLOWED, 'newer ones came before the next step')


class Taken(NamedTuple):
    """The validation rows of some events, and the validations for counts and log lines.

    A validation comes with its source and the number of messages that were validated like that.
    """

    outputs: list[Output]
    validations: list[tuple[Source, Validation, int]]


class Engine:
    """The arm and the rules for its events, at the start of a run.

    Parameters
    ----------
    settings
        Settings of the run.
    robot
        From `load_robot` or out of a recording.
    rows
        Whether validation rows and the whole state are encoded, which only recordings hold.
    frames
        The frames of the links, which only recordings hold; None for none.

    Attributes
    ----------
    arm
        The simulated arm, which holds the state.
    publish_every
        Cycles from one state to the next.
    frames
        As given.

    Raises
    ------
    ValueError
        If the settings do not go with the robot.
    """

    def __init__(
        self,
        settings: Settings,
        robot: pfd.Robot,
        *,
        rows: bool = True,
        frames: LinkFrames | None = None,
    ) -> None:
        self.arm = Arm(settings, robot)
        self._rows, self.frames = rows, frames
        self._frames_every = 0 if frames is None or TF not in frames.roles else frames.every
        self._save_every = settings.save_every if rows else 0
        self.publish_every = settings.publish_every
        self._clock_every = settings.clock_every if settings.publish_clock else 0
        self._step_ns = settings.step_ns
        self.pace = Pace(settings.lockstep, settings.wait_for_controller, settings.follows_clock)
        self._rules = Validator(self.arm, self.pace)
        # Place in published order of each joint of the model, None if the two are the same.
        place = np.argsort(self.arm.order)
        self._free = free(robot.n)
        self._zero_effort = ActuatorCommand(np.zeros(robot.n), self._free)
        self._published = None if list(place) == list(range(robot.n)) else place
        self._encoder = convert.JointStateEncoder(
            self.arm.names, settings.frame_id, settings.published_locks, self.arm.order
        )
        self._derive()
        state = self.state
        state.pace.active = settings.autostart
        self.pace.begin(state.pace)
        if self.sensors is not None:
            self.sensors.restart(state)

    def _derive(self) -> None:
        """Set the constants that follow from the settings as they are now."""
        settings, arm = self.settings, self.arm
        self._link = CommandLink(settings)
        self.actuators = Actuators(settings, arm.robot, arm.order, arm.scene)
        arm.set_limits(self.actuators.limits)
        sensors = Sensors(settings, arm.order)
        # None where states are measured as they are.
        self.sensors = None if sensors.exact else sensors
        self._extra = extra_outputs(settings, arm)
        self._plain = self.sensors is None and not self.pace.follows_clock

    @property
    def state(self) -> ArmState:
        """Everything that changes while the arm runs."""
        return self.arm.state

    @property
    def settings(self) -> Settings:
        """The settings as they are now: events change the dynamic ones."""
        return self.arm.state.settings

    @property
    def cycles(self) -> int:
        """Number of the last cycle, 0 before the first."""
        return self.arm.state.cycle

    @property
    def waiting(self) -> bool:
        """Whether the next cycle has to wait for an event."""
        # Simulated time of a failed arm is stopped; its cycles continue.
        state = self.arm.state
        steps = state.cycle + 1 - state.step
        if self.pace.forbids(state.pace, self.arm.stamp_ns + steps * self._step_ns):
            return True
        return needs_event(state.pace) and not state.jumps

    def save(self) -> ArmState:
        """Return a copy of the state: a run that is restored to it has the same bits."""
        return self.state.copy()

    def restore(self, state: ArmState) -> None:
        """Continue from a copy of a state.

        Raises
        ------
        ValueError
            If the state is of another robot, or of an arm with other settings at its start.
        """
        self.arm.restore(state)
        self._derive()

    def run_cycle(self, events: Iterable[Event] = ()) -> Taken:
        """Run the next cycle on the events since the last one; return all outputs of it."""
        taken = self.take(events)
        return Taken(taken.outputs + self.step(), taken.validations)

    def take(self, events: Iterable[Event]) -> Taken:
        """Validate events and apply them to the next cycle; return their validation rows."""
        outputs: list[Output] = []
        validations: list[tuple[Source, Validation, int]] = []
        rows: list[ValidationRow] = []
        cycle = self.state.cycle + 1
        for event in events:
            if isinstance(event, Overflow):
                validations.append((event.source, OVERFLOWED, len(event.sequences)))
                if self._rows:
                    outputs.extend(self._overflow_messages(event, cycle))
                continue
            validation = self.accept(event)
            validations.append((event.source, validation, 1))
            if self._rows:
                checksum, verdict = crc32(event.payload), validation.verdict
                rows.append(ValidationRow(cycle, event.source, event.sequence, verdict, checksum))
        if rows:
            outputs.append(self._rows_message(rows))
        return Taken(outputs, validations)

    def _rows_message(self, rows: Sequence[ValidationRow]) -> Output:
        self.state.row_messages += 1
        return Output(TAKEN, self.state.row_messages, convert.encode_rows(rows, TAKEN_COLUMNS))

    def _overflow_messages(self, event: Overflow, cycle: int) -> Iterator[Output]:
        """Yield the messages about events that were dropped before a cycle."""
        for start in range(0, len(event.sequences), MOST_ROWS):
            some = event.sequences[start : start + MOST_ROWS]
            yield self._rows_message(
                [ValidationRow(cycle, event.source, x, Verdict.OVERFLOWED) for x in some]
            )

    def accept(self, event: Arrival) -> Validation:
        """Validate one message and apply it to the next cycle, without a row."""
        validation = self.validate(event)
        self._apply(event.source, validation)
        return validation

    def validate(self, event: Arrival) -> Validation:
        """Return the validation result of a message, without applying its effect."""
        return self._rules.validate(event, self.actuators.gains)

    def command(self, efforts: NDArray[Any]) -> Validation:
        """Validate and apply efforts (n,) in published order.

        For callers that neither record nor publish the command: it has no bytes.
        """
        validation = self._rules.validate_efforts(efforts)
        self._apply(Source.ARRAY, validation)
        return validation

    def stretch(self, efforts: NDArray[Any], commands: Sequence[int]) -> NDArray[Any] | None:
        """Run a cycle for each row of efforts, in one native call.

        Equal to `command` and `advance` in turn, bit for bit. Nothing is done if anything besides
        effort commands acts: delay, drop-out, errors of sensors, pause, jump, followed clock, or
        a wrench with an end.

        Parameters
        ----------
        efforts
            (cycles, n), published order.
        commands
            Indices of the rows that begin with a command, from 0 on; each other row repeats the
            row before it.

        Returns
        -------
        numpy.ndarray or None
            q, qd and the applied efforts, (cycles, 3, n), model order. If the arm fails, there
            are fewer rows, and the last is not finite. None if nothing was done.
        """
        if not self._may_stretch(_longest_gap(commands, len(efforts))):
            return None
        if not np.isfinite(efforts).all():
            return None
        if self._published is not None:
            efforts = efforts[:, self._published]
        state = self.arm.state
        begin, step = state.cycle, state.step
        if state.wrench is not None:
            wrench.advance(state.wrench)
        rows = self.arm.run(efforts, self._zero_effort)
        jumped = self.arm.jumped is not None
        state.cycle = cycle = begin + len(rows) + jumped
        taken = bisect_left(commands, cycle - begin)
        last = commands[taken - 1]
        self._end_stretch(efforts[last].copy(), begin + 1 + last, taken)
        if jumped:
            self._trip()
            rows = np.append(rows, [(state.q, state.qd, state.tau)], axis=0)
        published = cycle - cycle % self.publish_every
        if self.pace.lockstep:
            state.pace.commanded = True
            state.pace.waits = published == cycle
            if published > begin:
                ended = step + min(published - begin, state.step - step)
                state.since_ns = state.origin_ns + ended * self._step_ns
        return rows

    def encode_states(self, stamps_ns: NDArray[Any], rows: NDArray[Any]) -> bytes | None:
        """Return the messages of the states of a stretch, one after the other.

        None if cycles have other messages too, but for clock ticks and frames.

        Parameters
        ----------
        stamps_ns, rows
            (k,) and (k, 3, n), as `stretch` returns them.
        """
        if self._extra is not None or self.arm.plant.payload != self.arm.state.payload:
            return None
        return self._encoder.encode_all(stamps_ns, *np.moveaxis(rows, 1, 0))

    def answer(self, efforts: NDArray[Any]) -> bool:
        """Command efforts (n,), published order, and run one cycle, as `stretch` does.

        Returns whether it was possible; if not, nothing was done.
        """
        # For a few joints faster than NumPy; the terms of a finite sum are finite.
        if not self._may_stretch(1) or not math.isfinite(sum(efforts.tolist())):
            return False
        if self._published is not None:
            efforts = efforts[self._published]
        arm = self.arm
        state = arm.state
        if state.wrench is not None:
            wrench.advance(state.wrench)
        state.cycle = cycle = state.cycle + 1
        wanted = arm.advance(efforts, self._zero_effort)
        self._end_stretch(wanted, cycle, 1)
        if arm.jumped is not None:
            self._trip()
        if self.pace.lockstep:
            pace = state.pace
            pace.commanded = True
            pace.waits = not cycle % self.publish_every
            if pace.waits:
                state.since_ns = arm.stamp_ns
        return True

    def _end_stretch(self, effort: NDArray[Any], heard: int, commands: int) -> None:
        state = self.arm.state
        link = state.link
        link.actuation = link.newest = ActuatorCommand(effort, self._free)
        link.heard, link.timed_out = heard, False
        link.sent += commands

    def _may_stretch(self, gap: int) -> bool:
        """Return whether nothing but commands, with at most `gap` cycles between, will act."""
        if not self._plain:
            return False
        state = self.arm.state
        pace = state.pace
        return not (
            state.failure
            or pace.paused
            or not pace.active
            or state.jumps
            or state.link.line
            or state.actuators.tripped
            or (state.wrench is not None and state.wrench.left is not None)
            or not self._link.passes_all(gap)
        )

    def _apply(self, source: Source, validation: Validation) -> None:
        effect, state = validation.effect, self.state
        if source in COMMANDS:
            self.pace.answer(state.pace, validation.verdict)
        if isinstance(effect, Command):
            self._link.send(state.link, effect, state.cycle + 1)
        elif isinstance(effect, StateChange):
            state.jumps.append(effect)
            self._discard_commands(zero_effort(state.link.actuation))
        elif isinstance(effect, SettingsChange):
            self._set(effect)
        elif isinstance(effect, ClockTick):
            self._follow(effect)
        elif isinstance(effect, WrenchChange):
            if state.wrench is not None:
                wrench.put(state.wrench, effect, state.settings)
        elif effect is not None:
            self._request(effect)

    def _request(self, request: Request) -> None:
        state = self.state
        if request.name == 'reset':
            self._reset()
        elif request.name == 'deactivate':
            self._discard_commands(all_braked(len(state.q)))
        elif request.name == 'clear_wrench' and state.wrench is not None:
            wrench.clear(state.wrench)
        self.pace.request(state.pace, request)

    def _reset(self) -> None:
        """Let the next step end in the initial state, without anything from before."""
        state = self.state
        self.arm.clear_failure(state.cycle)
        state.jumps = [None]
        state.link.sent = 0
        self._discard_commands(all_braked(len(state.q)))
        state.reset_ns = state.since_ns
        if state.wrench is not None:
            wrench.clear(state.wrench)

    def _discard_commands(self, actuation: ActuatorCommand) -> None:
        """Continue with an actuator command; drop all commands from before the next step."""
        state = self.state
        command_link.clear(state.link, actuation)
        actuators.restart(state.actuators)
        state.since_ns = self.arm.stamp_ns + self._step_ns

    def _set(self, change: SettingsChange) -> None:
        """Take over other values of dynamic settings; all others are as before."""
        measured, jump = self.sensors is not None, self.actuators.largest_jump
        self.arm.change(change.settings, change.plant)
        self._derive()
        state = self.state
        if np.isinf(jump):
            # A reflex looks at efforts from the next one on.
            state.actuators.motors.before[:] = np.nan
        if self.sensors is None:
            state.sensed = []
        elif not measured:
            state.sensed = [(state.q, state.qd, state.tau)]

    def _follow(self, tick: ClockTick) -> None:
        state = self.state
        if state.pace.until_ns is None:
            # Simulated time continues there, without a step.
            state.origin_ns = tick.stamp_ns - state.step * self._step_ns
            state.since_ns = tick.stamp_ns
        state.pace.until_ns = tick.stamp_ns

    def step(self) -> list[Output]:
        """Run the next cycle on the events that were taken; return its state and its tick."""
        role = self.advance()
        outputs: list[Output] = []
        new_payload = payload_message(self.arm)
        if new_payload is not None:
            outputs.append(new_payload)
        self._add_state_and_tick(outputs, role)
        if self._save_every and self.cycles % self._save_every == 0:
            saved = convert.encode_bytes(self.state.to_bytes())
            outputs.append(Output(ARM_STATE, self.cycles // self._save_every, saved))
        return outputs

    def advance(self) -> str:
        """Run the next cycle on the events that were taken, without a message of its outputs.

        Returns the role of this cycle's state, '' if it has none.
        """
        state = self.state
        state.cycle += 1
        if state.jumps and state.jumps[0] is None:
            state.epoch = state.cycle
        actuation = state.link.actuation if state.failure else self._actuate(state)
        if state.wrench is not None:
            wrench.advance(state.wrench)
        if state.jumps:
            state.braked = actuation.braked
            self.arm.jump(state.jumps)
            state.jumps = []
            if self.sensors is not None:
                self.sensors.restart(state)
        else:
            self.arm.advance(actuation.effort, actuation)
            if self.arm.jumped is not None:
                self._trip()
            if self.sensors is not None:
                self.sensors.sample(state)
        role = self._state_role(state)
        self.pace.stepped(state.pace, published=role == STATES)
        if state.pace.waits:
            state.since_ns = self.arm.stamp_ns
        return role

    def _state_role(self, state: ArmState) -> str:
        """Return the role of this cycle's state, '' if it has none."""
        if state.cycle % self.publish_every:
            return ''
        dropped = self.sensors is not None and self.sensors.drops(state)
        return DROPPED_STATES if dropped else STATES

    def _actuate(self, state: ArmState) -> ActuatorCommand:
        """Let the commands that are due reach the actuators; return what these want.

        A failed arm has no actuators: a gap in its cycles changes nothing.
        """
        link, driven = state.link, state.actuators
        if self._link.advance(link, state.cycle, state.q):
            # The reflex ignores jumps that the watchdog causes.
            actuators.restart(driven)
        if state.jumps:
            return zero_effort(link.actuation)
        return link.actuation

    def _trip(self) -> None:
        """Let the reflex brake all joints for the step that was not done."""
        state, wanted, brakes = self.state, self.arm.jumped, all_braked(len(self._free))
        assert wanted is not None
        self.arm.jumped = None
        names = self.arm.robot.joint_names
        actuators.trip(state.actuators, wanted, names, self.actuators.largest_jump)
        command_link.clear(state.link, brakes)
        self.arm.advance(brakes.effort, brakes)

    def measured(self) -> JointArrays:
        """Return the positions, velocities and efforts of this cycle's state, in model order."""
        state = self.state
        if self.sensors is None:
            return state.q, state.qd, state.tau
        return self.sensors.measured(state)

    def present(self) -> list[Output]:
        """Return the state, its other outputs and the tick again, for readers that missed them.

        They are not part of the run: no cycle, and nothing to record.
        """
        arm = self.arm
        state = self._encoder.encode(arm.stamp_ns, *self.measured())
        found = [Output(STATES, 0, state), *self._further_outputs(0)]
        if self._clock_every:
            found.append(Output(CLOCK, 0, convert.encode_clock(arm.stamp_ns)))
        return found

    def skip_cycles(self, cycle: int) -> None:
        """Pass over the cycles up to `cycle`, for an arm that failed and gets no events.

        The arm is the same in each of them: a gap of any length costs nothing.
        """
        if not self.state.failure:
            raise RuntimeError('only a failed arm skips cycles')
        state, skipped = self.state, cycle - self.state.cycle
        if skipped > 0:
            state.cycle = cycle
            state.pace.left = max(0, state.pace.left - skipped)
            if state.wrench is not None:
                wrench.advance(state.wrench, skipped)

    def _add_state_and_tick(self, outputs: list[Output], role: str) -> None:
        """Add the state of this cycle, its further outputs, the clock tick and the frames."""
        arm, cycle = self.arm, self.state.cycle
        if role:
            state = self._encoder.encode(arm.stamp_ns, *self.measured())
            number = cycle // self.publish_every
            outputs.append(Output(role, number, state))
            if self._extra is not None:
                outputs.extend(self._further_outputs(number))
        if self._clock_every and cycle % self._clock_every == 0:
            tick = convert.encode_clock(arm.stamp_ns)
            outputs.append(Output(CLOCK, cycle // self._clock_every, tick))
        if self._frames_every and cycle % self._frames_every == 0:
            assert self.frames is not None
            data = self.frames.encode(arm.stamp_ns, arm.q)
            outputs.append(Output(TF, cycle // self._frames_every, data))

    def _further_outputs(self, number: int) -> list[Output]:
        messages = [] if self._extra is None else self._extra.messages()
        return [Output(role, number, data) for role, data in messages]


def _longest_gap(commands: Sequence[int], cycles: int) -> int:
    """Return the largest number of cycles from a command to the next one, or to the end."""
    if len(commands) == cycles:
        return 1
    return max(int(gap) for gap in np.diff([*commands, cycles]))
