# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The engine: inputs in, one cycle, messages out. No ROS, clock, thread or file.

    messages, verdicts = engine.step(inputs)

The rule of an input checks it, and it takes effect in the cycle that follows; the messages that
come back are the inputs with that cycle, then the outputs of the cycle. While the arm waits (in a
pause, in lockstep for an answer, for a tick of a followed clock), inputs are taken and no cycle
runs. The same inputs in the same cycles give the same bytes: a recording of the returned messages
in their order is a proof of the run.

A rule changes nothing: it returns the function that changes the state, with its arguments. So
whatever it raises, the state is as it was; and a rule that is called on another thread ahead, with
its result thrown away, has compiled all that the change needs.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from copy import deepcopy

import pfd_core as pfd
from pfd_ros.arm import commands, events, other_inputs, trajectory
from pfd_ros.arm.arm import Arm
from pfd_ros.arm.events import ACCEPTED, ALL, Change, Message, RefusedError, Verdict
from pfd_ros.arm.frames import LinkFrames
from pfd_ros.arm.outputs import Outputs
from pfd_ros.arm.settings import Settings
from pfd_ros.arm.state import State
from pfd_ros.messages.cdr import LAST_SECOND, NANOSECONDS
from pfd_ros.messages.values import encode_string
from pfd_ros.text import cut

RULES: dict[str, Callable[[Arm, bytes], Change]] = {
    events.NAMED: commands.named,
    events.ARRAY: commands.array,
    events.TRAJECTORY: trajectory.rule,
    events.SET_STATE: other_inputs.set_state,
    events.REQUESTS: other_inputs.request,
    events.PARAMETERS: other_inputs.parameters,
    events.WRENCH: other_inputs.external_wrench,
    events.PAYLOAD: other_inputs.payload,
    events.CLOCK_TICKS: other_inputs.tick,
}
# What an arm waits for that has done the steps up to the last tick.
NO_CLOCK = 'waiting for the followed /clock'
# No message that means something is longer.
LARGEST = 1 << 16
# Refused inputs of a kind, role and label, are recorded up to so many bytes in a simulated second,
# with so many for each, and counted beyond that: no flood fills the disk.
REFUSED_BYTES, OVERHEAD = 1 << 16, 100
LAST_NS = (LAST_SECOND + 1) * NANOSECONDS - 1
# Settings that may differ between the run that saved a state and the run that continues from it.
PER_RUN = frozenset(
    {'start_time', 'real_time_factor', 'recording', 'recording_time', 'recording_tf_rate'}
)


class Engine(Arm):
    """The arm, the rules for its inputs, and its outputs, at the start of a run.

    Nothing but the messages of `roles` is encoded, and the arm moves with the same bits. Optional
    outputs are among them as far as the settings enable them, the wrench on the tip if there is
    one. `frames` are those of the links, for recordings. ValueError if the settings do not go with
    the robot.
    """

    def __init__(
        self,
        settings: Settings,
        robot: pfd.Robot,
        roles: Collection[str] = ALL,
        frames: LinkFrames | None = None,
    ) -> None:
        super().__init__(settings, robot)
        disabled = set(events.OPTIONAL).difference(settings.outputs)
        disabled -= {events.TIP_WRENCH} if self.wrenched else set()
        self.roles, self.frames = frozenset(roles) - disabled, frames
        self.outputs = Outputs(self, self.roles, frames)
        self._inputs = self.roles.intersection(events.INPUTS)
        self._every, self._follows = settings.publish_every, settings.follows_clock
        self._second = max(1, round(1.0 / settings.step_size))

    @property
    def awaited(self) -> str:
        """What the next cycle has to wait for, in words; '' for nothing."""
        state = self.state
        if not state.active:
            return 'inactive'
        if state.paused and not state.left and state.jump is None:
            return 'paused'
        if self._follows:
            # Simulated time of a failed arm is stopped; its cycles continue.
            following_ns = state.origin_ns + (state.cycle + 1) * self._step_ns
            if state.until_ns is None or following_ns > state.until_ns:
                return NO_CLOCK
        return 'waiting for a command (lockstep)' if state.waits and state.jump is None else ''

    @property
    def waiting(self) -> bool:
        """Whether the next cycle has to wait for an event."""
        return bool(self.awaited)

    @property
    def published(self) -> bool:
        """Whether the last cycle ended in a state that is published."""
        state = self.state
        due = state.cycle > 0 and state.cycle % self._every == 0
        return due and not (self.sensors is not None and self.sensors.drops(state))

    def save(self) -> State:
        """Return a copy of the state: a run that is restored to it has the same bits."""
        return deepcopy(self.state)

    def restore(self, state: State) -> None:
        """Continue from a copy of a state; ValueError for one of another arm."""
        theirs, ours = ({**vars(x.first), 'digest': x.robot} for x in (state, self.state))
        for name, value in ours.items():
            if name not in PER_RUN and theirs[name] != value:
                found, wanted = cut(repr(theirs[name])), cut(repr(value))
                raise ValueError(f'the state is of an arm with {name}={found}, expected {wanted}')
        plant = self.plants.prepare(state.settings)
        self.state = deepcopy(state)
        self.derive(plant)

    def prepare(self, role: str, data: bytes) -> None:
        """Compile what an event needs, ahead and on any thread; it takes no effect."""
        with suppress(Exception):  # step will say so
            RULES[role](self, data)

    def step(
        self, inputs: Sequence[Message] = (), run: bool = True
    ) -> tuple[list[Message], list[Verdict]]:
        """Take inputs, and with `run` do the next cycle if it need not wait.

        Returns the inputs with their cycle, what was refused, and the outputs, as far as they are
        among the roles, in the order in which they are to be recorded; and a verdict on each
        input.
        """
        messages: list[Message] = []
        verdicts = [self._take(event[0], event[1], messages) for event in inputs]
        if run and not self.awaited:
            self._cycle(self.state)
            self._add_outputs(self.state, messages)
        return messages, verdicts

    def _take(self, role: str, data: bytes, messages: list[Message]) -> Verdict:
        """Check an event and let it act; add its messages, and return its verdict."""
        state = self.state
        waited, verdict = state.waits, ACCEPTED
        try:
            if len(data) > LARGEST:
                raise RefusedError('malformed', f'more than {LARGEST} bytes')
            if not state.active and role in events.MOVING:
                raise RefusedError(*events.INACTIVE)
            change, arguments = RULES[role](self, data)
        except RefusedError as error:
            verdict = Verdict(*error.args)
        except MemoryError:
            raise
        except Exception as error:  # a rule has changed nothing
            why = ' '.join(str(error).split())[:200] or type(error).__name__
            verdict = Verdict('malformed', why)
        else:
            remarks = change(self, *arguments)
            if remarks:
                details = '; '.join(remark.detail for remark in remarks)
                verdict = Verdict(ACCEPTED.label, details, remarks)
        if self.lockstep and role in events.COMMANDS and verdict.label in events.ANSWERS:
            state.commanded |= verdict.accepted
            state.waits = False
        if verdict is not ACCEPTED and not verdict.accepted:
            self._add_refused(role, data, verdict, messages, changed=state.waits != waited)
        elif role in self._inputs:
            messages.append(Message(role, data, state.cycle + 1))
        return verdict

    def _add_refused(
        self, role: str, data: bytes, verdict: Verdict, messages: list[Message], *, changed: bool
    ) -> None:
        """Count a refused event; add it and its rejection, unless they are of a flood.

        One that changes the arm, since lockstep goes on after it, is always added: a replay needs
        it.
        """
        state, kind = self.state, f'{role} {verdict.label}'
        used, more = state.refused.get(kind, (0, 0))
        if used > REFUSED_BYTES and not changed:
            state.refused[kind] = used, more + 1
            return
        # Of a long one as much as a replay needs to refuse it, too.
        data = data[: LARGEST + 1]
        state.refused[kind] = used + len(data) + OVERHEAD, more
        if role not in self._inputs:
            return
        messages.append(Message(role, data, state.cycle + 1))
        if verdict.label != events.UNCLAIMED.label and events.REJECTED in self.roles:
            # The first line is verified; the rest has words of libraries, which change.
            rejection = encode_string(f'{kind}\n{verdict.detail}')
            messages.append(Message(events.REJECTED, rejection, state.cycle + 1))

    def _cycle(self, state: State) -> None:
        if state.trajectory is not None:
            trajectory.advance(self)
        state.cycle += 1
        if state.origin_ns + state.cycle * self._step_ns > LAST_NS:
            self.fail(f'simulated time is at its end: stamps hold {LAST_SECOND} s')
        if self.watched and not state.failure and self.link.advance(state):
            self.note_inputs()
        if self.wrenched and other_inputs.advance_wrench(state):
            self.stale = True
        if state.jump is not None:
            self.jump()
        elif not state.failure:
            self.advance()
        if state.left:
            state.left -= 1

    def _add_outputs(self, state: State, messages: list[Message]) -> None:
        outputs = self.outputs
        if state.refused and state.cycle % self._second == 0:
            messages += self.counts()
        if self.tells and not state.failure:
            state.told, self.tells = self.plant.payload, False
            outputs.add_payload(messages)
        if state.cycle % self._every == 0:
            published = self.published
            if outputs.shows:
                outputs.add_state(messages, published=published)
            if published and self.lockstep:
                plan = state.trajectory
                state.waits = state.commanded and (plan is None or self.stamp_ns >= plan.end_ns)
        if outputs.timed:
            outputs.add_timed(messages)
        if state.waits:
            state.since_ns = state.origin_ns + state.step * self._step_ns

    def present(self) -> list[Message]:
        """Return the state, its other outputs and the tick again, for readers that missed them.

        They are not part of the run: no cycle, and nothing to record.
        """
        messages: list[Message] = []
        self.outputs.add_state(messages, published=True)
        self.outputs.add_timed(messages, again=True)
        return messages

    def counts(self) -> list[Message]:
        """Return asides about what was refused in this second and not recorded; count anew."""
        found = [
            Message(events.REJECTED_COUNTS, encode_string(f'{kind}\n{more} more in this second'))
            for kind, (_, more) in self.state.refused.items()
            if more and events.REJECTED_COUNTS in self.roles
        ]
        self.state.refused.clear()
        return found
