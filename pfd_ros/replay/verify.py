# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs a recording again and compares every state and clock tick it published, bit for bit.

Needs the file alone, no ROS: settings and robot are in its head, the commands as they came in,
and for each of them the step before which it was taken. The file is read twice: first to see
that it is whole and can have happened (`survey.py`), then to simulate it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import pfd_core as pfd
from pfd_ros.arm.commands import Verdict
from pfd_ros.arm.plant import Plant
from pfd_ros.messages.convert import JointMessage, decode_clock, decode_joint_state
from pfd_ros.recording.format import ROBOT, ROLE_OF_SOURCE, SEQUENCE_MASK, SOURCE_OF_ROLE
from pfd_ros.recording.head import Ending
from pfd_ros.recording.reader import Log, LogError, damage_named
from pfd_ros.replay.events import Event, Row, events
from pfd_ros.replay.survey import Summary, Survey, survey

__all__ = ['DifferenceError', 'Summary', 'read']

FIELDS = ('position', 'velocity', 'effort')
# Part of the time that looking through the file takes when it is simulated too.
LOOKING = 0.1


class DifferenceError(LogError):
    """The first place where the recording and its replay differ."""


def read(
    path: Path, *, verify: bool = False, progress: Callable[[float], None] | None = None
) -> Summary:
    """Read a recording to its end, and with `verify` replay it.

    Parameters
    ----------
    path
        The file; a cut-off one is read up to the cut.
    verify
        Simulate everything again and compare all states and clock ticks.
    progress
        Called now and then with the part that is done, 0 to 1.

    Raises
    ------
    DifferenceError
        At the first differing bit; the text names step, joint, field and both values.
    LogError
        If the file is no recording, is damaged, or holds too little to be replayed.
    OSError
        If it cannot be read.
    """

    def part(start: float, share: float) -> Callable[[float], None] | None:
        return None if progress is None else lambda done: progress(start + share * done)

    path = Path(path)
    log = Log(path)
    with damage_named(path):
        found = survey(log, part(0.0, LOOKING if verify else 1.0))
        if verify:
            _replay(log, found, part(LOOKING, 1.0 - LOOKING))
        if found.altered:
            raise ValueError(found.altered)
    return found.summary


def _replay(log: Log, found: Survey, progress: Callable[[float], None] | None) -> None:
    """Simulate what a recording holds and compare."""
    if found.summary.states == 0:
        raise LogError(f'{log.path} holds no states, so there is nothing to verify')
    if found.summary.obstacle:
        raise LogError(f'{log.path} {found.summary.obstacle}')
    run = _Run(Plant(found.summary.settings, _robot(log, found.state)))
    for count, event in enumerate(events(log)):
        run.follow(event)
        if progress is not None and count % 1000 == 0:
            progress(log.position / log.size)
    if found.ending is not None:
        run.finish(found.ending)
    if run.plant.failure:
        found.summary.stopped_at = run.plant.step
        found.summary.failure = run.plant.failure


def _robot(log: Log, state: bytes) -> Any:
    """Return the robot of a recording; compiling one of other joints could take minutes."""
    text = log.robot_yaml
    # A single line would be taken for the name of a robot or a file, and `<` for URDF.
    if '\n' not in text or text.lstrip().startswith('<'):
        raise LogError(f'{log.path} has no robot in its attachment {ROBOT!r}')
    robot = pfd.load_robot(text)
    names = decode_joint_state(state).names
    if sorted(names) != sorted(robot.joint_names):
        raise DifferenceError(f'names: recorded {names!r}, its robot has {robot.joint_names!r}')
    return robot


@dataclass
class _Run:
    """A plant that follows a recording, and the commands not yet taken."""

    plant: Plant
    cycle: int = 0
    commands: dict[tuple[int, int], bytes] = field(default_factory=dict)

    def follow(self, event: Event) -> None:
        """Do what the node did, and compare what it published."""
        if event.role in SOURCE_OF_ROLE:
            key = SOURCE_OF_ROLE[event.role], event.number & SEQUENCE_MASK
            self.commands[key] = event.data
        elif event.role == 'taken':
            self._advance(event.step - 1)
            for row in event.rows:
                self._receive(row)
        else:
            self._advance_to_stamp(event)
            states = event.role == 'joint_states'
            computed = self.plant.state() if states else self.plant.clock()
            # Almost always one comparison of bytes.
            if event.data != computed:
                where = (_state_difference if states else _tick_difference)(event.data, computed)
                why = f'; the replay: {self.plant.failure}' if self.plant.failure else ''
                raise DifferenceError(f'step {event.step}: {where}{why}')

    def finish(self, ending: Ending) -> None:
        """Go on to where the node stopped, and compare whether it had failed by then."""
        # The failure itself is one step behind the last good one.
        self._advance(ending.steps + bool(ending.failure))
        ours, theirs = self.plant.failure, ending.failure
        if bool(ours) != bool(theirs) or self.plant.step != ending.steps:
            raise DifferenceError(
                f'the end: recorded {ending.steps} steps and {theirs or "no failure"!r}, '
                f'replayed {self.plant.step} steps and {ours or "no failure"!r}'
            )

    def _advance(self, step: int) -> None:
        while self.cycle < step:
            self.cycle += 1
            self.plant.advance()
            if self.plant.failure:
                # It stands still from here on, however long.
                self.cycle = step

    def _advance_to_stamp(self, event: Event) -> None:
        """Advance to the step of an event, through a gap only if its stamp says the same.

        A failed arm has an earlier stamp; then no step behind that stamp can have been done.
        """
        settings = self.plant.settings
        if event.lost:
            stamp = decode_clock(event.data)
            done = (stamp - settings.start_ns) // settings.step_ns
            if done < event.step:
                self._advance(done + 1)
                if not self.plant.failure:
                    raise DifferenceError(
                        f'step {event.step}: {event.role} {event.number}: recorded stamp '
                        f'{stamp} ns, expected that of step {event.step}'
                    )
        self._advance(event.step)

    def _receive(self, row: Row) -> None:
        data = self.commands.pop((row.source, row.number), b'')
        if row.verdict is Verdict.OVERFLOWED:
            return
        judged = self.plant.receive(row.source, data).verdict
        if judged != row.verdict:
            raise DifferenceError(
                f'step {self.cycle + 1}: command {row.number} of {ROLE_OF_SOURCE[row.source]}: '
                f'recorded as {row.verdict.name}, replayed as {judged.name}'
            )


def _tick_difference(recorded: bytes, computed: bytes) -> str:
    try:
        theirs = f'{decode_clock(recorded)} ns'
    except ValueError as error:
        theirs = str(error)
    return f'clock: recorded {theirs}, replayed {decode_clock(computed)} ns'


def _state_difference(recorded: bytes, computed: bytes) -> str:
    try:
        ours, theirs = decode_joint_state(computed), decode_joint_state(recorded)
    except ValueError as error:
        return f'the recorded state: {error}'
    return _first_difference(theirs, ours) or 'the same numbers, in other bytes'


def _first_difference(recorded: JointMessage, computed: JointMessage) -> str:
    """Return the first field that differs, with both values, or '' if none does."""
    for name in ('stamp_ns', 'frame_id', 'names'):
        one, other = getattr(recorded, name), getattr(computed, name)
        if one != other:
            return f'{name}: recorded {one!r}, replayed {other!r}'
    for name in FIELDS:
        one, other = getattr(recorded, name), getattr(computed, name)
        if len(one) != len(other):
            return f'{name}: recorded {len(one)} numbers, replayed {len(other)}'
        differing = np.flatnonzero(one.view(np.uint64) != other.view(np.uint64))
        if len(differing):
            i = differing[0]
            return (
                f'joint {computed.names[i]!r}, {name}: recorded {float(one[i])!r} '
                f'({one.view(np.uint64)[i]:#018x}), replayed {float(other[i])!r} '
                f'({other.view(np.uint64)[i]:#018x})'
            )
    return ''
