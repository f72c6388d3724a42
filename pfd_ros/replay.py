# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs a recording again and compares every state it published, bit for bit.

Needs the file alone, no ROS: settings and robot are in its head, the commands as they came in,
and for each of them the step before which it was taken.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import pfd_core as pfd
from pfd_ros import settings as settings_file
from pfd_ros.commands import Verdict
from pfd_ros.convert import JointMessage, decode_joint_state, decode_rows
from pfd_ros.log import Entry, Log, LogError
from pfd_ros.plant import Plant, Source
from pfd_ros.recording import SEQUENCE_MASK

# Columns of the channel that says which command was taken before which step.
TAKEN_COLUMNS = ('step', 'source', 'sequence', 'verdict')
ROLE_OF_SOURCE = {Source.NAMED: 'joint_commands', Source.ARRAY: 'commands'}
_SOURCE_OF_ROLE = {role: source for source, role in ROLE_OF_SOURCE.items()}
FIELDS = ('position', 'velocity', 'effort')


class DifferenceError(LogError):
    """The first place where the recording and its replay differ."""


@dataclass
class Summary:
    """What a file holds, and what the replay made of it."""

    path: Path
    complete: bool = False
    settings: settings_file.Settings | None = None
    versions: dict[str, str] = field(default_factory=dict)
    steps: int = 0
    states: int = 0
    missing: int = 0
    verdicts: Counter[Verdict] = field(default_factory=Counter)
    waiting: int = 0
    first_ns: int = 0
    last_ns: int = 0

    @property
    def seconds(self) -> float:
        """Wall time from the first recorded state to the last, s."""
        return (self.last_ns - self.first_ns) / 1e9

    @property
    def rate(self) -> float:
        """Recorded states per second of wall time, Hz; 0 if there are too few to say."""
        published = self.states + self.missing
        return (published - 1) / self.seconds if published > 1 and self.seconds > 0 else 0.0


@dataclass
class _Run:
    """A recording while it is read: its plant, and the commands not yet taken."""

    log: Log
    summary: Summary
    verify: bool
    plant: Plant | None = None
    cycle: int = 0
    published: int = 0
    taken_rows: int = 0
    commands: dict[tuple[int, int], bytes] = field(default_factory=dict)
    schedule: dict[int, list[list[int]]] = field(default_factory=lambda: defaultdict(list))


def read(
    path: Path, *, verify: bool = False, progress: Callable[[float], None] | None = None
) -> Summary:
    """Read a recording to its end, and with `verify` replay it.

    Parameters
    ----------
    path
        The file; a cut-off one is read up to the cut.
    verify
        Simulate everything again and compare all states.
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
    log = Log(path)
    run = _Run(log, Summary(path), verify)
    size = max(1, path.stat().st_size)
    for count, entry in enumerate(log.entries()):
        if run.summary.settings is None:
            _open(run)
        _take(run, entry)
        if progress is not None and count % 1000 == 0:
            progress(log.position / size)
    if run.summary.settings is None:
        _open(run)
    run.summary.complete = log.complete
    run.summary.waiting = len(run.commands)
    if verify and run.summary.states == 0:
        raise LogError(f'{path} holds no states, so there is nothing to verify')
    return run.summary


def _open(run: _Run) -> None:
    """Build what the head of the file describes."""
    settings = settings_file.from_values(run.log.json('settings'))
    run.summary.settings = settings
    run.summary.versions = dict(run.log.json('versions'))
    if run.verify:
        run.plant = Plant(settings, pfd.load_robot(run.log.robot_yaml))


def _take(run: _Run, entry: Entry) -> None:
    if entry.role in _SOURCE_OF_ROLE:
        run.commands[_SOURCE_OF_ROLE[entry.role], entry.sequence] = entry.data
    elif entry.role == 'taken':
        _take_rows(run, entry)
    elif entry.role == 'joint_states':
        _take_state(run, entry)


def _take_rows(run: _Run, entry: Entry) -> None:
    """Note which commands were taken before which step."""
    if entry.sequence != (run.taken_rows + 1) & SEQUENCE_MASK:
        raise LogError(
            f'{run.log.path} lacks {entry.sequence - run.taken_rows - 1} records of commands '
            f'taken before step {run.cycle + 1}: the disk was too slow, and what follows '
            'cannot be replayed'
        )
    run.taken_rows += 1
    for row in decode_rows(entry.data, len(TAKEN_COLUMNS)):
        run.summary.verdicts[Verdict(row[3])] += 1
        if run.plant is None:
            run.commands.pop((row[1], row[2]), None)
        else:
            run.schedule[row[0]].append(row)


def _take_state(run: _Run, entry: Entry) -> None:
    summary = run.summary
    skipped = (entry.sequence - run.published - 1) & SEQUENCE_MASK
    summary.missing += skipped
    run.published += skipped + 1
    summary.first_ns = summary.first_ns or entry.log_ns
    summary.last_ns = entry.log_ns
    assert summary.settings is not None
    target = run.published * summary.settings.publish_every
    if run.plant is not None:
        while run.cycle < target:
            _step(run, run.plant)
        _compare(run.plant, entry.data)
    summary.steps = target
    summary.states += 1


def _step(run: _Run, plant: Plant) -> None:
    """Do one step with the commands that were taken before it."""
    run.cycle += 1
    for _, source, sequence, verdict in run.schedule.pop(run.cycle, ()):
        data = run.commands.pop((source, sequence), None)
        if data is None:
            raise LogError(
                f'{run.log.path} lacks command {sequence} of {ROLE_OF_SOURCE[Source(source)]}, '
                f'taken before step {run.cycle}; what follows cannot be replayed'
            )
        judged = plant.receive(source, data).verdict
        if judged != verdict:
            raise DifferenceError(
                f'step {run.cycle}: command {sequence} of {ROLE_OF_SOURCE[Source(source)]}: '
                f'recorded as {Verdict(verdict).name}, replayed as {judged.name}'
            )
    plant.advance()


def _compare(plant: Plant, recorded: bytes) -> None:
    """Compare one published state with the plant's; almost always one comparison of bytes."""
    computed = plant.state()
    if recorded == computed:
        return
    try:
        ours, theirs = decode_joint_state(computed), decode_joint_state(recorded)
    except ValueError as error:
        raise DifferenceError(f'step {plant.step}: the recorded state: {error}') from error
    where = _first_difference(theirs, ours)
    if where:
        raise DifferenceError(f'step {plant.step}: {where}')


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
