# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The engine: events in, one cycle, messages out. No ROS, clock, thread or file.

    messages, verdicts = engine.step(events)

An event is a message with an input's role. Its rule checks it, and it takes effect in the cycle
that follows; the messages that come back are the events with that cycle, then the outputs of the
cycle. While the arm waits (in a pause, in lockstep for an answer, for a tick of a followed clock),
events are taken and no cycle runs. The same events in the same cycles give the same bytes: a
recording of the returned messages in their order is a proof of the run.

A rule changes nothing: it returns a verdict, or the function that changes the state with its
arguments. So whatever it raises, the state is as it was; and a rule that is called on another
thread ahead, with its result thrown away, has compiled all that the change needs.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from copy import deepcopy
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm import actuators, commands, events, other_inputs, refusals, wrench
from pfd_ros.arm.actuators import Actuators
from pfd_ros.arm.events import ACCEPTED, ALL, COMMANDS, INACTIVE, MOVING, Message, Verdict
from pfd_ros.arm.link import Link, stop
from pfd_ros.arm.outputs import Outputs
from pfd_ros.arm.plant import Plant, Plants, in_model_order
from pfd_ros.arm.plant_settings import check_joints_without_values
from pfd_ros.arm.sensors import Sensors
from pfd_ros.arm.settings import Settings, check_joint_counts, check_servo, joint_order
from pfd_ros.arm.state import ACTED, BRAKE, EFFORT, POSITION, State
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.text import cut

if TYPE_CHECKING:
    from pfd_ros.arm.frames import LinkFrames

# What a rule returns: a verdict, or a function of the engine and the arguments of its call.
Ruling: TypeAlias = Verdict | tuple[Callable[..., tuple[Verdict, ...] | None], tuple[Any, ...]]
RULES: dict[str, Callable[[Engine, bytes], Ruling]] = {
    events.NAMED: commands.named,
    events.ARRAY: commands.array,
    events.SET_STATE: other_inputs.set_state,
    events.REQUESTS: other_inputs.request,
    events.PARAMETERS: other_inputs.parameters,
    events.WRENCH: wrench.rule,
    events.PAYLOAD: other_inputs.payload,
    events.CLOCK_TICKS: other_inputs.tick,
}
# No message that means something is longer.
LARGEST = 1 << 16
# The largest time of a stamp, ns: its seconds have 31 bits.
LAST_NS = (1 << 31) * NANOSECONDS - 1
# Settings that may differ between the run that saved a state and the run that continues from it.
PER_RUN = frozenset({'start_time', 'real_time_factor', 'recording'})


class Engine:
    """The arm and the rules for its events, at the start of a run.

    Parameters
    ----------
    settings, robot
        Of the run.
    roles
        What anybody needs: nothing else is encoded, and the arm moves with the same bits.
    frames
        The frames of the links, for recordings; None for none.

    Attributes
    ----------
    state
        Everything that changes while the arm runs.
    names, order, place
        The name and the index in the model of each joint, in published order; index by name.
    locked
        The position of each joint that is published though it is welded, by name.
    start
        Positions (n,) in model order, rad or m, before the first step and after a reset.
    plant, actuators, sensors, link
        What follows from the settings now; no sensors where states are measured exactly.

    Raises
    ------
    ValueError
        If the settings do not go with the robot.
    """

    def __init__(
        self,
        settings: Settings,
        robot: pfd.Robot,
        roles: Collection[str] = ALL,
        frames: LinkFrames | None = None,
    ) -> None:
        check_joint_counts(settings, robot.n)
        check_servo(settings)
        self.robot, self.frames, self.roles = robot, frames, frozenset(roles)
        self.order = np.array(joint_order(settings.joints, robot))
        self.names = tuple(robot.joint_names[k] for k in self.order)
        self.place = {name: k for k, name in enumerate(robot.joint_names)}
        self.locked = settings.published_locks
        check_joints_without_values(settings, robot, self.names)
        same = list(self.order) == list(range(robot.n))
        self.all_joints: Any = slice(None) if same else self.order
        if len(settings.initial_positions) not in (0, robot.n):
            raise ValueError(
                f'initial_positions holds {len(settings.initial_positions)} numbers, expected '
                f'{robot.n}, one for each of {list(self.names)}, or none'
            )
        self.start = in_model_order(settings.initial_positions, self.order)
        self.plants = Plants(settings, robot, self.order)
        plant = self.plants.prepare(settings)
        simulator = plant.simulator
        settings = replace(
            settings,
            integrator=simulator.integrator,
            method=simulator.method,
            position_sums='compensated' if simulator.compensated else 'plain',
            recording_time=settings.log_time,
        )
        self.lockstep, self._step_ns = settings.lockstep, settings.step_ns
        self._follows = settings.follows_clock
        self._inputs = self.roles.intersection(events.INPUTS)
        self._every, self._delay = settings.publish_every, settings.state_delay_steps
        self._second = max(1, round(1.0 / settings.step_size))
        waits = settings.lockstep and settings.wait_for_controller
        count, none = robot.n, np.full(robot.n, np.nan)
        acting = np.array([np.zeros(count), np.ones(count), none, none])
        self.state = State(
            robot=robot.digest,
            first=settings,
            settings=settings,
            simulation=simulator.new_state(self.start),
            motors=pfd.MotorState(np.zeros(count)),
            acting=acting,
            newest=acting.copy() if settings.command_delay_steps else acting,
            rows=np.zeros((self._delay + 2, 3, count)),
            origin_ns=settings.start_ns,
            since_ns=settings.start_ns,
            reset_ns=settings.start_ns,
            active=settings.autostart,
            waits=waits,
            commanded=waits,
        )
        self.state.rows[0, 0] = self.start
        self.outputs = Outputs(self, frames)
        self._derive_all(plant)

    def _derive_all(self, plant: Plant) -> None:
        settings = self.state.settings
        driven = Actuators(settings, self.robot, self.order, plant.scene)
        self.derive(plant, driven, Sensors(settings, self.order))

    def derive(self, plant: Plant, driven: Actuators, sensors: Sensors) -> None:
        """Take over what follows from the settings, and bind native code to the state."""
        state = self.state
        self.plant, self.actuators, self.link = plant, driven, Link(state.settings)
        self.sensors = None if sensors.exact else sensors
        self._exact = sensors.exact and isinstance(self.all_joints, slice)
        self._watched, self._wrenched = not self.link.idle, plant.scene.external_wrench
        self._tells = plant.payload != state.told
        self.outputs.bind()
        self._bind()

    def _bind(self) -> None:
        state = self.state
        self._native = self.plant.simulator.bind(
            state.simulation, state.motors, self.actuators.limits, state.acting[POSITION:]
        )
        # Efforts and targets are read where they are, and rows are written where they are.
        self._effort_at, self.newest_effort = state.acting.ctypes.data, state.newest[EFFORT]
        at = [row.ctypes.data for row in state.rows]
        self._following = [((k + 1) % len(at), at[(k + 1) % len(at)]) for k in range(len(at))]
        self.note_inputs()

    def note_inputs(self) -> None:
        """Note that brakes or targets are others: native code gets them before the next step."""
        newest = self.state.newest
        self.braked = bool(newest[BRAKE].any())
        self.targets = bool((newest[POSITION:] == newest[POSITION:]).any())
        self._stale = True
        # Then an effort alone is written in place, and that is all.
        self.direct = not (self.braked or self.targets or self.link.drop or self.link.delay)

    @property
    def stamp_ns(self) -> int:
        """Simulated time, ns: whole steps, so that it never drifts."""
        return self.state.origin_ns + self.state.step * self._step_ns

    @property
    def waiting(self) -> bool:
        """Whether the next cycle has to wait for an event."""
        state = self.state
        if not state.active:
            return True
        if self._follows:
            # Simulated time of a failed arm is stopped; its cycles continue.
            following_ns = state.origin_ns + (state.cycle + 1) * self._step_ns
            if state.until_ns is None or following_ns > state.until_ns:
                return True
        return (state.waits or (state.paused and not state.left)) and state.jump is None

    @property
    def published(self) -> bool:
        """Whether the last cycle ended in a state that is published."""
        state = self.state
        due = state.cycle > 0 and state.cycle % self._every == 0
        return due and not (self.sensors is not None and self.sensors.drops(state))

    @property
    def program(self) -> str:
        """Digest of the compiled program of the plant and its outputs, the same everywhere."""
        return self.plant.program

    def measured(self) -> NDArray[Any]:
        """Return measured positions, velocities and efforts, (3, n), published order."""
        found: NDArray[Any] = self.shown().copy()
        return found

    def shown(self) -> NDArray[Any]:
        """Return the same, which may be a row that is overwritten."""
        state = self.state
        row: NDArray[Any] = state.rows[state.now]
        if self._exact:
            return row
        if self.sensors is not None:
            row = self.sensors.measured(state)
        published: NDArray[Any] = row[:, self.all_joints]
        return published

    def save(self) -> State:
        """Return a copy of the state: a run that is restored to it has the same bits."""
        return deepcopy(self.state)

    def restore(self, state: State) -> None:
        """Continue from a copy of a state.

        Raises
        ------
        ValueError
            If the state is of another robot, or of an arm with other settings at its start.
        """
        if state.robot != self.state.robot:
            raise ValueError(
                f'the state is of a robot with the digest {state.robot[:12]!r}, expected '
                f'{cut(self.robot.name)!r} with {self.state.robot[:12]!r}'
            )
        names = [f.name for f in fields(Settings) if f.name not in PER_RUN]
        theirs, ours = ([getattr(x.first, name) for name in names] for x in (state, self.state))
        for name, their, our in zip(names, theirs, ours, strict=True):
            if their != our and not name.startswith('recording_'):
                raise ValueError(
                    f'the state is of an arm with {name}={cut(repr(their))}, expected '
                    f'{cut(repr(our))}'
                )
        plant = self.plants.prepare(state.settings)
        self.state = deepcopy(state)
        self._derive_all(plant)

    def prepare(self, role: str, data: bytes) -> None:
        """Compile what an event needs, ahead and on any thread; it takes no effect."""
        try:
            RULES[role](self, data)
        except Exception:  # step will say so
            return

    def step(
        self, events: Sequence[Message] = (), run: bool = True
    ) -> tuple[list[Message], list[Verdict]]:
        """Take events, and with `run` do the next cycle if it need not wait.

        Returns
        -------
        list of Message
            The events with their cycle, what was refused, and the outputs, as far as they are
            among the roles, in the order in which they are to be recorded.
        list of Verdict
            One for each event.
        """
        messages: list[Message] = []
        verdicts = [self._take(event[0], event[1], messages) for event in events]
        if run and not self.waiting:
            self._cycle(self.state)
            self._add_outputs(self.state, messages)
        return messages, verdicts

    def _take(self, role: str, data: bytes, messages: list[Message]) -> Verdict:
        """Check an event and let it act; add its messages, and return its verdict."""
        state = self.state
        waited = state.waits
        ruling: Ruling
        if len(data) > LARGEST:
            ruling = Verdict('malformed', f'{len(data)} bytes, expected {LARGEST} at most')
            # As much of it as a replay needs to refuse it, too.
            data = data[: LARGEST + 1]
        elif not state.active and role in MOVING:
            ruling = INACTIVE
        else:
            try:
                ruling = RULES[role](self, data)
            except MemoryError:
                raise
            except Exception as error:  # a rule has changed nothing
                ruling = events.malformed(error)
        if isinstance(ruling, Verdict):
            verdict = ruling
        else:
            change, arguments = ruling
            remarks = change(self, *arguments)
            verdict = self._remarked(role, remarks) if remarks else ACCEPTED
        if self.lockstep and role in COMMANDS and verdict.label in events.ANSWERS:
            state.commanded |= verdict.accepted
            state.waits = False
        if not verdict.accepted:
            event, changed = Message(role, data, state.cycle + 1), state.waits != waited
            found = refusals.refusal(state, event, verdict, changed=changed)
            messages += [m for m in found if m.role in self.roles]
        elif role in self._inputs:
            messages.append(Message(role, data, state.cycle + 1))
        return verdict

    def _remarked(self, role: str, remarks: tuple[Verdict, ...]) -> Verdict:
        """Count the remarks about an accepted event; return its verdict."""
        noted = self.state.noted
        for remark in remarks:
            kind = f'{role} {remark.label}'
            noted[kind] = noted.get(kind, 0) + 1
        return Verdict(ACCEPTED.label, '; '.join(remark.detail for remark in remarks), remarks)

    def _cycle(self, state: State) -> None:
        state.cycle += 1
        if state.origin_ns + state.cycle * self._step_ns > LAST_NS:
            self._fail(f'simulated time is at its end: stamps hold {LAST_NS // NANOSECONDS} s')
        if self._watched and not state.failure and self.link.advance(state):
            self.note_inputs()
        if self._wrenched and wrench.advance(state):
            self._stale = True
        if state.jump is not None:
            self._jump(state)
        elif not state.failure:
            self._advance(state)
        if state.left:
            state.left -= 1

    def _advance(self, state: State) -> None:
        """Do one step; a reflex does it again, braked."""
        following, at = self._following[state.now]
        try:
            if self._stale:
                self._set_inputs(state)
            done = self._native.run_at(self._effort_at, at, 1)
        except (ValueError, ArithmeticError) as error:
            self._fail(f'step {state.step + 1} failed: {error}')
            return
        if done:
            state.step += 1
            state.now = following
            if state.age < self._delay:
                state.age += 1
        elif state.motors.jumped:
            # Native code has ended before the step; the efforts that it wanted are in the row.
            wanted = state.rows[following, 2]
            actuators.trip(state, wanted, self.robot.joint_names, self.actuators.largest_jump)
            stop(state, brake=True)
            self.note_inputs()
            self._advance(state)
        elif state.simulation.status == 'too_many_events':
            self._fail(f'step {state.step + 1} has too many impacts and reversals of joints')
        else:
            self._fail(f'the state after step {state.step + 1} is not finite')

    def _set_inputs(self, state: State) -> None:
        self.plant.simulator.set_inputs(
            state.simulation,
            wrench=state.wrench[ACTED] if self._wrenched else None,
            brakes=state.acting[BRAKE] > 0.0,
            **self.plant.inputs,
        )
        # Only once they are checked: an error must come again.
        self._stale = False

    def _fail(self, why: str) -> None:
        if not self.state.failure:
            self.state.failure = why
            self.state.failures += 1

    def _jump(self, state: State) -> None:
        """Do a step that ends in another state, unless the arm has failed."""
        target, state.jump = state.jump, None
        if state.failure or target is None:
            return
        state.step += 1
        state.now, state.age = (state.now + 1) % len(state.rows), 0
        state.simulation = self.plant.simulator.new_state(*target)
        arrays = state.simulation.arrays
        state.rows[state.now] = arrays['q'], arrays['qd'], np.zeros(len(self.order))
        self._bind()

    def discard_commands(self, *, brake: bool = False) -> None:
        """Drop all commands from before the next step; the brakes are closed or as they are."""
        stop(self.state, brake=brake)
        actuators.restart(self.state)
        self.state.since_ns = self.stamp_ns + self._step_ns
        self.note_inputs()

    def _add_outputs(self, state: State, messages: list[Message]) -> None:
        outputs = self.outputs
        if state.refused and state.cycle % self._second == 0:
            messages += self.counts()
        if self._tells and not state.failure:
            state.told, self._tells = self.plant.payload, False
            outputs.add_payload(messages)
        if state.cycle % self._every == 0:
            published = self.sensors is None or not self.sensors.drops(state)
            if outputs.shows:
                outputs.add_state(messages, published=published)
            if published and self.lockstep:
                state.waits = state.commanded
        if outputs.ticks:
            outputs.add_clock(messages)
        if state.waits:
            state.since_ns = state.origin_ns + state.step * self._step_ns

    def present(self) -> list[Message]:
        """Return the state, its other outputs and the tick again, for readers that missed them.

        They are not part of the run: no cycle, and nothing to record.
        """
        messages: list[Message] = []
        self.outputs.add_state(messages, published=True)
        self.outputs.add_clock(messages, again=True)
        return messages

    def counts(self) -> list[Message]:
        """Return asides about what was refused since the last second and is not recorded.

        The counts begin anew.
        """
        return [m for m in refusals.counts(self.state) if m.role in self.roles]
