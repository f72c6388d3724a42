# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
What if: simulate the recorded inputs with a changed arm, and compare the motions.

    new run         the changed arm takes the recorded inputs at the recorded cycles; a new log
    rounding run    the new run again, with each position that the arm is set to changed by the
                    last bit of 1 rad (or m): how fast motions diverge by rounding alone

Both runs follow the source in one pass. Measured states are compared at the times of the recorded
states. States after a failure of the simulation are not compared.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.driver import Driver
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.link_frames import link_frames
from pfd_ros.arm.settings import WALL, Settings
from pfd_ros.messages.convert import (
    JOINT_FIELDS,
    NANOSECONDS,
    JointColumns,
    decode_joint_state,
    decode_joint_states,
    decode_string,
)
from pfd_ros.recording.bags import DATABASES, DESCRIPTION
from pfd_ros.recording.reader import Log, LogError, damage_named
from pfd_ros.recording.run_parts import files_of, in_order
from pfd_ros.replay.bag_inputs import BagInputs
from pfd_ros.replay.changed_inputs import ChangedInputs, FedBlock, fed_blocks
from pfd_ros.replay.changed_runs import NewRun, RoundingRun, one_bit
from pfd_ros.replay.new_log import LogTimes, NewLog, free_path
from pfd_ros.replay.ordering import Block, PlacedMessage, placed_blocks
from pfd_ros.replay.state_comparison import StateComparison
from pfd_ros.replay.verify import simulable
from pfd_ros.replay.what_if_settings import (
    Changes,
    changed_arm,
    described_arm,
    published_names,
    read_changes,
)

Array = NDArray[Any]
# A run has diverged beyond these: positions [rad or m], velocities [rad/s or m/s], efforts [N m
# or N].
THRESHOLDS = (1e-3, 1e-2, 1e-1)
# Most missing states that may have the same stamp, as the states of a failed arm.
MOST_STOPPED = 10_000
# Share of the progress that the inspection of a recording gets.
INSPECTION_SHARE = 0.1


@dataclass(frozen=True)
class JointDivergence:
    """
    The divergence of one joint in one field, in the field's unit; times in s after the start.

    `largest`, `rms` and `first_at` compare the new run with the recorded states, `rounding_...`
    the rounding run with the new run. None: never beyond the threshold, or nothing compared.
    """

    field: str
    joint: str
    largest: float | None
    largest_at: float | None
    rms: float | None
    first_at: float | None
    rounding_largest: float | None
    rounding_rms: float | None
    rounding_first_at: float | None


@dataclass(frozen=True)
class WhatIf:
    """
    The result of a run with something changed.

    Attributes
    ----------
    source, log
        The recording or bag, and the log of the new run.
    changes
        As given.
    robot, settings
        Robot and settings of the new run, 'auto' resolved.
    seconds
        Simulated time of the new run, s.
    states
        Number of compared states.
    thresholds
        One for each field.
    joints
        Compared joints, in recorded order.
    divergences
        Divergences by field and joint.
    only_in_log, only_in_arm
        Joints that only the log, or only the arm has.
    failure, failed_at
        Why and when the simulation failed, '' and None without a failure.
    rounding_failed_at
        When the rounding run failed, or None.
    rejected
        Number of inputs whose validation result is not the recorded one, by result.
    first_rejected
        A line about the first of these inputs, or ''.
    skipped
        Number of unused messages of a bag, by reason.
    times
        Time base of a bag: 'stamps' or 'log times'; '' for a recording.
    complete
        Whether the source was closed properly.
    curves
        Times (k,), recorded and new positions (k, 2, m), absolute differences of the new run and
        of the rounding run (k, 2, m).

    """

    source: Path
    log: Path
    changes: tuple[str, ...]
    robot: str
    settings: Settings
    seconds: float
    states: int
    thresholds: tuple[float, ...]
    joints: tuple[str, ...]
    divergences: tuple[JointDivergence, ...]
    only_in_log: tuple[str, ...]
    only_in_arm: tuple[str, ...]
    failure: str
    failed_at: float | None
    rounding_failed_at: float | None
    rejected: Mapping[str, int]
    first_rejected: str
    skipped: Mapping[str, int]
    times: str
    complete: bool
    curves: tuple[Array, Array, Array] = field(repr=False, compare=False)


@dataclass
class _Case:
    """A changed arm, and the messages for it."""

    path: Path
    settings: Settings
    robot: pfd.Robot
    blocks: Iterator[FedBlock]
    # Time from one state of a recording to the next.
    state_ns: int = 0
    # The cycle that ends at time 0, and the last one of the source, 0 where states determine it.
    origin: int = 0
    last: int = 0
    started_ns: int = 0
    topics: Mapping[str, str] = field(default_factory=dict)
    # For the frames of the links; '' for no frames.
    urdf: str = ''
    rename: Callable[[str], str] = str
    skipped: Mapping[str, int] = field(default_factory=dict)
    times: str = ''
    progress: Callable[[], float] = lambda: 0.0
    complete: Callable[[], bool] = lambda: True


def what_if(
    path: Path | Sequence[Path],
    words: Sequence[str] = (),
    *,
    commands: str = '',
    states: str = '',
    rename: Mapping[str, str] | None = None,
    out: Path | None = None,
    thresholds: Sequence[float] = THRESHOLDS,
    progress: Callable[[float], None] | None = None,
) -> WhatIf:
    """
    Simulate the inputs of a log with a changed arm, and compare the motions.

    Parameters
    ----------
    path : Path or sequence of Path
        A recording of the node, all files of its run or their folder; with `commands` any bag.
    words : sequence of str
        KEY=VALUE, parameters of the node; without any the run is repeated.
    commands : str
        Topic of commands, for a bag: JointStates with efforts, or Float64MultiArrays.
    states : str
        Topic of the bag's states; default as BagInputs chooses it.
    rename : mapping of str to str, optional
        New prefix of joint names of the bag, by old prefix.
    out : Path, optional
        The log of the new run, by default next to the source.
    thresholds : sequence of float
        Thresholds of positions, velocities and efforts.
    progress : callable, optional
        Called with the finished share, 0 to 1.

    Raises
    ------
    ValueError
        If a setting is invalid, or the log (LogError) is damaged, holds too little to be
        replayed, or has no joint of the arm. No log is written then.
    OSError
        If a file cannot be read or written; the log exists.

    """
    paths = [Path(path)] if isinstance(path, str | Path) else [*path]
    path = paths[0]
    if len(thresholds) != len(JOINT_FIELDS) or not all(0 <= x < np.inf for x in thresholds):
        raise ValueError(f'thresholds must be 3 numbers, 0 or more, got {list(thresholds)}')
    changes = read_changes(words)
    if commands:
        case = _of_bag(path, changes, BagInputs(path, commands, states, rename or {}))
    elif states or rename:
        raise ValueError('--states and --rename are for bags: name a topic with --commands')
    else:
        case = _of_recording(paths, changes, progress)
    target = out or free_path(path)
    frames = link_frames(case.urdf, case.settings, case.robot) if case.urdf else None
    engine = Engine(case.settings, case.robot, frames=frames)
    # Both engines share compiled code; only the start differs.
    start = one_bit(np.array(engine.settings.initial_positions or (0.0,) * case.robot.n))
    nudged = replace(engine.settings, initial_positions=tuple(start.tolist()))
    others = Engine(nudged, case.robot, rows=False)
    log = NewLog(target, engine, case.topics, case.started_ns)
    try:
        runs = (
            NewRun(Driver(engine), log=log, times=LogTimes(case.started_ns)),
            RoundingRun(Driver(others)),
        )
        with damage_named(path):
            found = _follow(case, runs, tuple(thresholds), progress)
        runs[0].finish()
        return _result(case, changes, runs, found, target)
    except BaseException:
        log.discard()
        raise


def _of_recording(
    paths: Sequence[Path], changes: Changes, progress: Callable[[float], None] | None
) -> _Case:
    path = paths[0]
    if path.suffix in DATABASES or (path / DESCRIPTION).is_file():
        raise LogError(f'{path} is not a recording of this node: name a topic with --commands')
    part = None if progress is None else lambda done: progress(INSPECTION_SHARE * done)
    files = files_of(paths)
    logs = in_order([Log(file) for file in files]) if len(files) > 1 else [Log(files[0])]
    with damage_named(path):
        results, robot = simulable(logs, part)
        found = results[0]
        recorded = found.summary.settings
        topics = {role: topic for topic, role in logs[0].roles.items()}
        started_ns = logs[0].started_ns
    settings, new, urdf = changed_arm(recorded, robot, changes)
    if 'robot' not in changes.values and found.description:
        urdf = decode_string(found.description)
    names = published_names(recorded, robot), published_names(settings, new)
    inputs = ChangedInputs(recorded, settings, *names)
    last, ending = 0, results[-1].ending
    if ending is not None and ending.totals is not None:
        last = ending.totals.steps + bool(ending.totals.failure)
    reading = _Files(logs)
    return _Case(
        path,
        settings,
        new,
        inputs.blocks(reading.blocks()),
        state_ns=recorded.publish_every * recorded.step_ns,
        # The last new cycle that ends by the last one of the recording.
        last=last * recorded.step_ns // settings.step_ns,
        started_ns=started_ns,
        topics=topics,
        urdf=urdf,
        progress=reading.progress,
        complete=lambda: all(log.complete for log in logs),
    )


@dataclass
class _Files:
    """The files of a recording, read one after the other."""

    logs: Sequence[Log]
    place: int = 0

    def blocks(self) -> Iterator[Block]:
        for place, log in enumerate(self.logs):
            self.place = place
            yield from placed_blocks(log)

    def progress(self) -> float:
        log = self.logs[self.place]
        return (self.place + log.position / log.size) / len(self.logs)


def _of_bag(path: Path, changes: Changes, inputs: BagInputs) -> _Case:
    settings, robot, urdf = described_arm(changes)
    settings = inputs.settled(settings, given='start_time' in changes.values)
    if 'recording_time' not in changes.values:
        # The times of the bag, which need not be simulated time.
        settings = replace(settings, recording_time=WALL)
    return _Case(
        path,
        settings,
        robot,
        fed_blocks(inputs.messages(settings, robot)),
        origin=1,
        started_ns=max(0, inputs.start_ns - settings.step_ns),
        urdf=urdf,
        rename=inputs.renamed,
        skipped=inputs.skipped,
        times=inputs.times,
    )


def _follow(
    case: _Case,
    runs: tuple[NewRun, RoundingRun],
    thresholds: tuple[float, ...],
    progress: Callable[[float], None] | None,
) -> StateComparison:
    """Run both arms along the messages of a source, and compare their states."""
    found: StateComparison | None = None
    newest_ns: int | None = None
    for block in case.blocks:
        decoded = list(_decoded(block, case))
        stamps_ns = [stamp for columns, *_ in decoded for stamp in columns.stamps_ns.tolist()]
        for k, message in block.lost:
            before_ns = stamps_ns[k - 1] if k else newest_ns
            if before_ns is not None:
                _check_gap(message, stamps_ns[k] - before_ns, case)
        newest_ns = stamps_ns[-1] if stamps_ns else newest_ns
        for run in runs:
            run.follow(block.block)
        for columns, places, times in decoded:
            found = found or StateComparison(runs, columns.names, thresholds)
            found.add(columns, places, times, of_bag=bool(case.origin))
        if found is not None:
            found.drain()
        if progress is not None:
            progress(INSPECTION_SHARE + (1 - INSPECTION_SHARE) * case.progress())
    for run in runs:
        run.flush()
        run.run_to(case.last)
    if found is None:
        raise LogError(f'{case.path} holds no states, so there is nothing to compare')
    found.drain(all_of_them=True)
    if case.origin and runs[0].first_rejected.startswith('step 1:'):
        raise LogError(f'{case.path}: {runs[0].first_rejected}')
    return found


def _decoded(block: FedBlock, case: _Case) -> Iterator[tuple[JointColumns, Array, Array]]:
    """Yield recorded states with renamed joints, and their `at` and `time`.

    In a bag, states that cannot be decoded are skipped.
    """
    columns = None
    if block.states:
        with suppress(ValueError):
            columns = decode_joint_states(block.states)
    if columns is not None:
        yield _renamed(columns, case), block.at, block.time
        return
    for k, data in enumerate(block.states):
        try:
            state = decode_joint_state(data)
        except ValueError:
            if case.origin:
                continue
            raise
        arrays = (x[None] for x in (state.position, state.velocity, state.effort))
        columns = JointColumns(state.names, np.array([state.stamp_ns]), *arrays)
        yield _renamed(columns, case), block.at[k : k + 1], block.time[k : k + 1]


def _renamed(columns: JointColumns, case: _Case) -> JointColumns:
    return columns._replace(names=tuple(map(case.rename, columns.names)))


def _check_gap(message: PlacedMessage, after_ns: int, case: _Case) -> None:
    """Raise ValueError if many states are missing and the next stamp is too early for that."""
    if message.lost > MOST_STOPPED and after_ns < message.lost * case.state_ns:
        raise ValueError(
            f'step {message.cycle}: {message.lost} states are missing, but the stamp is '
            f'{after_ns / NANOSECONDS:.6g} s after the last one'
        )


def _result(
    case: _Case,
    changes: Changes,
    runs: tuple[NewRun, RoundingRun],
    found: StateComparison,
    target: Path,
) -> WhatIf:
    new, rounding = runs
    engine = new.driver.engine
    step = engine.settings.step_ns / NANOSECONDS
    moving = engine.arm.robot.joint_names
    locked = case.settings.published_locks

    def when(cycle: int) -> float | None:
        return (cycle - case.origin) * step if cycle else None

    return WhatIf(
        case.path,
        target,
        changes.words,
        engine.arm.robot.name,
        engine.settings,
        (new.reached - case.origin) * step,
        found.states,
        tuple(float(x) for x in found.divergence.thresholds),
        found.joints,
        tuple(_divergences(found)),
        tuple(x for x in found.recorded_names if x not in moving and x not in locked),
        tuple(x for x in moving if x not in found.recorded_names),
        new.failure,
        when(new.failed_in),
        when(rounding.failed_in),
        dict(new.rejected),
        new.first_rejected,
        dict(case.skipped),
        case.times,
        case.complete(),
        found.curves.arrays(),
    )


def _divergences(found: StateComparison) -> Iterator[JointDivergence]:
    new, rounding = found.divergence, found.rounding
    for k, kind in enumerate(JOINT_FIELDS):
        for m, joint in enumerate(found.joints):
            columns = (
                new.largest,
                new.largest_at,
                new.rms,
                new.first_at,
                rounding.largest,
                rounding.rms,
                rounding.first_at,
            )
            if new.count[k, m]:
                yield JointDivergence(kind, joint, *(_number(x[k, m]) for x in columns))


def _number(value: Any) -> float | None:
    """Return a number, None for NaN, and the largest float for an infinity (an overflow)."""
    return None if np.isnan(value) else float(np.nan_to_num(value))
