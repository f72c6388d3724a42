# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of changed arms along a source: the new run, written as a log, and the rounding run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.events import CLOCK, STATES, TAKEN, TF, Output, Verdict
from pfd_ros.messages.convert import decode_joint_state, encode_clocks, encode_state
from pfd_ros.recording.format import ROLE_OF_SOURCE, SET_STATE
from pfd_ros.replay.new_log import LogTimes, NewLog
from pfd_ros.replay.ordering import RANKS, Columns, PlacedMessage
from pfd_ros.replay.playback import Playback, Stretch
from pfd_ros.text import cut

Array = NDArray[Any]
# The last bit of 1.
BIT = 2.0**-52


def one_bit(q: Array) -> Array:
    """Return positions plus the last bit of 1, or of the position itself above 1."""
    return np.where(np.abs(q) < 1.0, q + BIT, np.nextafter(q, np.inf))


@dataclass
class ChangedRun(Playback):
    """
    A run that follows a source.

    Attributes
    ----------
    rows
        Cycles (k,), and their measured positions, velocities and efforts, (k, 3, n), model
        order; NaN after a failure. Only the cycles next to recorded states are kept.
    failed_in, failure
        The cycle in which the simulation first failed, and why; 0 and '' without a failure.

    """

    rows: list[tuple[Array, Array]] = field(default_factory=list)
    failed_in: int = 0
    failure: str = ''

    def __post_init__(self) -> None:
        """Begin with the state before the first cycle."""
        self._keep_row()

    @property
    def reached(self) -> int:
        """The last cycle that was run."""
        return self.driver.engine.cycles

    def _keep_row(self) -> None:
        engine = self.driver.engine
        row = np.full((1, 3, engine.arm.robot.n), np.nan)
        if not engine.state.failure:
            row[0] = engine.measured()
        self.rows.append((np.array([engine.cycles]), row))

    def take_now(self, message: PlacedMessage) -> None:
        """Run to the cycle that took inputs, and apply them."""
        self.run_to(message.cycle - 1)
        self.driver.take(self.inbox.take(message))

    def output_now(self, message: PlacedMessage) -> None:
        """Run to the cycle of a recorded state."""
        self.run_to(message.cycle)

    def stretched(self, stretch: Stretch) -> bool:
        """Keep the states of a stretch."""
        states = stretch.outputs.cycles - stretch.first
        last = len(stretch.rows) - 1
        near = np.unique(np.concatenate([states - 1, states, [last - 1, last]]))
        near = near[near >= 0]
        self.rows.append((near + stretch.first, stretch.rows[near]))
        return True

    def aside(self, message: PlacedMessage) -> None:
        """Skip a message that is neither input nor output of a cycle."""

    def run_to(self, cycle: int) -> None:
        """Run the cycles up to this one, even after a failure of the arm."""
        engine = self.driver.engine
        while engine.cycles < cycle:
            self.driver.step()
            if engine.cycles >= cycle - 1:
                self._keep_row()
            if engine.state.failure and not self.failed_in:
                self.failed_in, self.failure = engine.cycles, engine.state.failure

    def at(self, places: Array) -> Array:
        """Return the states interpolated at `places` (k,), in cycles: (k, 3, n)."""
        cycles, rows = (np.concatenate(parts) for parts in zip(*self.rows, strict=True))
        low = np.floor(places).astype(int)
        share = (places - low)[:, None, None]
        before = rows[np.searchsorted(cycles, low)]
        after = rows[np.searchsorted(cycles, np.ceil(places).astype(int))]
        with np.errstate(over='ignore', invalid='ignore'):
            found: Array = np.where(share == 0.0, before, before + share * (after - before))
        kept = int(np.searchsorted(cycles, low[-1]))
        self.rows = [(cycles[kept:].copy(), rows[kept:].copy())]
        return found


@dataclass
class RoundingRun(ChangedRun):
    """The run in which each position that the arm is set to is changed by one bit."""

    def put(self, message: PlacedMessage) -> None:
        """Keep an input until its cycle."""
        if message.role == SET_STATE:
            message = message._replace(data=_nudged(message.data))
        super().put(message)


def _nudged(data: bytes) -> bytes:
    """Return a state to set with each position changed by one bit."""
    try:
        state = decode_joint_state(data)
    except ValueError:
        return data
    return encode_state(state.names, one_bit(state.position), state.velocity)


@dataclass
class NewRun(ChangedRun):
    """
    The changed run, written as a log.

    Attributes
    ----------
    log
        The log.
    times
        Times of day of the cycles.
    accepted
        Number of inputs that the arm accepted.
    rejected
        Number of inputs whose validation result is not the recorded one, by result.
    first_rejected
        A line about the first of these inputs.

    """

    log: NewLog = field(kw_only=True)
    times: LogTimes = field(kw_only=True)
    accepted: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    first_rejected: str = ''
    _now_ns: int = 0
    # Of the last message.
    _cycle: int = 0

    def __post_init__(self) -> None:
        """Have the outputs written."""
        super().__post_init__()
        self.driver.put = self._keep

    def _keep(self, outputs: Sequence[Output]) -> None:
        if outputs and outputs[0].role != TAKEN:
            self._now_ns = self.times.at(self.reached)
        for output in outputs:
            stamp_ns = self.driver.engine.arm.stamp_ns
            self.log.add(output.role, self._now_ns, output.number, output.data, stamp_ns)

    def together(self, block: Columns) -> bool:
        """Return whether `stretched` writes all outputs of these cycles; note their times."""
        last = int(block.cycles[-1])
        if self._alone(last):
            return False
        self._cycle = last
        self.times.add_all(block.cycles - (block.ranks == RANKS[TAKEN]), block.wall_ns)
        return True

    def take(self, message: PlacedMessage) -> None:
        """Follow validation rows."""
        self.times.add(message.cycle - 1, message.wall_ns)
        alone, self._cycle = self._alone(message.cycle), message.cycle
        if alone:
            self.flush()
            self.take_now(message)
        else:
            super().take(message)

    def output(self, message: PlacedMessage) -> None:
        """Follow a recorded state."""
        self.times.add(message.cycle, message.wall_ns)
        alone, self._cycle = self._alone(message.cycle), message.cycle
        if alone:
            self.flush()
            self.output_now(message)
        else:
            super().output(message)

    def _alone(self, cycle: int) -> bool:
        """Return whether a cycle up to this one has an output that `stretched` does not write.

        These are a new payload, in its first cycle, and the recorded states of the whole arm.
        """
        engine, before = self.driver.engine, self._cycle
        every = engine.settings.save_every
        saved = every and (before // every < cycle // every or not cycle % every)
        return bool(saved) or engine.arm.plant.payload != engine.state.payload

    def take_now(self, message: PlacedMessage) -> None:
        """Run to the cycle that took inputs, apply them, and compare their validation."""
        self.run_to(message.cycle - 1)
        self._now_ns = message.wall_ns
        self._write_inputs(message, self.driver.engine.arm.stamp_ns)
        found = self.driver.take(self.inbox.take(message))
        self.accepted += sum(
            count for _, validation, count in found if validation.verdict is Verdict.ACCEPTED
        )
        if message.rows[0].verdict is Verdict.OVERFLOWED:
            return
        for row, (source, validation, _) in zip(message.rows, found, strict=True):
            if validation.verdict is row.verdict:
                continue
            self.rejected[validation.verdict.label] += 1
            if not self.first_rejected:
                self.first_rejected = (
                    f'step {message.cycle}: {ROLE_OF_SOURCE[source]} {row.sequence} is '
                    f'{validation.verdict.label} ({cut(validation.detail, 200)}), recorded '
                    f'as {row.verdict.label}'
                )

    def _write_inputs(self, message: PlacedMessage, stamp_ns: int) -> None:
        for row in message.rows:
            if self.inbox.has(row):
                role = ROLE_OF_SOURCE[row.source]
                payload = self.inbox.payload(row)
                self.log.add(role, message.wall_ns, row.sequence, payload, stamp_ns)

    def stretched(self, stretch: Stretch) -> bool:
        """Write the inputs and outputs of a stretch."""
        engine = self.driver.engine
        settings, count = engine.settings, len(stretch.rows)
        cycles = np.arange(stretch.first, stretch.first + count)
        every = settings.clock_every if settings.publish_clock else count + stretch.first
        published, ticks = cycles % engine.publish_every == 0, cycles % every == 0
        states = engine.encode_states(stretch.stamps_ns[published], stretch.rows[published])
        if states is None:
            return False
        state = _parts(states, int(published.sum()))
        tick = _parts(encode_clocks(stretch.stamps_ns[ticks]), int(ticks.sum()))
        # At most one command a cycle, and its row.
        taken = stretch.taken
        rows_ns, numbers = taken.wall_ns.tolist(), taken.rows[:, 0, 2].tolist()
        commands = zip(
            taken.cycles.tolist(), rows_ns, numbers, taken.data, stretch.payloads, strict=True
        )
        role_of_command = ROLE_OF_SOURCE[stretch.source]
        command = next(commands, None)
        number = engine.state.row_messages
        moving = engine.frames is not None and TF in engine.frames.roles
        frames = engine.frames if moving else None
        log_ns = self.times.of(stretch.first, count).tolist()
        stamps, add = stretch.stamps_ns.tolist(), self.log.add
        for cycle, at_ns, stamp_ns, with_state, with_tick in zip(
            cycles.tolist(), log_ns, stamps, published.tolist(), ticks.tolist(), strict=True
        ):
            if command is not None and command[0] == cycle:
                _, wall_ns, sequence, row, payload = command
                command, number = next(commands, None), number + 1
                before_ns = stamp_ns - settings.step_ns
                add(role_of_command, wall_ns, sequence, payload, before_ns)
                add(TAKEN, wall_ns, number, row, before_ns)
            if with_state:
                add(STATES, at_ns, cycle // engine.publish_every, next(state), stamp_ns)
            if with_tick:
                add(CLOCK, at_ns, cycle // every, next(tick), stamp_ns)
            if frames is not None and cycle % frames.every == 0:
                data = frames.encode(stamp_ns, stretch.rows[cycle - stretch.first, 0])
                add(TF, at_ns, cycle // frames.every, data, stamp_ns)
        self.accepted += len(numbers)
        return super().stretched(stretch)

    def finish(self) -> None:
        """Write the inputs that no cycle took, and the totals."""
        arm = self.driver.engine.arm
        for source, number, data in self.inbox.rest():
            self.log.add(ROLE_OF_SOURCE[source], self._now_ns, number, data, arm.stamp_ns)
        self.log.finish(
            {
                'steps': arm.step,
                'commands_accepted': self.accepted,
                'failure': arm.failure,
            }
        )


def _parts(data: bytes, count: int) -> Iterator[bytes]:
    """Yield `count` messages of equal size from their bytes."""
    size = len(data) // max(count, 1)
    return (data[k : k + size] for k in range(0, len(data), max(size, 1)))
