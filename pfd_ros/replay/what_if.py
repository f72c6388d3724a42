# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What if: simulate the inputs of a log with a changed arm, and compare the motions.

    new run         the changed arm takes the inputs at the times of the log; a new recording
    rounding run    the new run again, with each position that the arm is set to changed by the
                    last bit of 1 rad (or m): how fast motions diverge by rounding alone

The new run does not wait for answers: the inputs are known. With a `drive` for another loop a
controller computes the commands, and the other inputs stay.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
import os
from pathlib import Path
import tempfile
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm import events
from pfd_ros.arm.description import link_frames
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import STATES, Message
from pfd_ros.arm.settings import FIELDS, SIMULATED, Settings, with_convention
from pfd_ros.files import free_path
from pfd_ros.messages.cdr import LAST_SECOND, NANOSECONDS
from pfd_ros.messages.joints import JOINT_FIELDS
from pfd_ros.messages.types import FLOAT_ARRAY, JOINT_STATE
from pfd_ros.recording.arrays import read_log
from pfd_ros.recording.format import LogError, OtherLogError, damage_named
from pfd_ros.recording.log import Log
from pfd_ros.recording.recorder import Recorder, topic_names
from pfd_ros.recording.topic_arrays import TopicArrays
from pfd_ros.replay.bag_inputs import BagInputs
from pfd_ros.replay.changed_settings import Changes, changed_arm, described_arm, read_changes
from pfd_ros.replay.compare import Curves, Difference, aligned, difference, track
from pfd_ros.replay.inputs import Input, Put, Run, nudged, one_bit, recorded_inputs, run_inputs
from pfd_ros.text import listed

# Settings of an arm that waits for nobody, recorded in simulated time.
UNTIED: dict[str, Any] = {'lockstep': False, 'wait_for_controller': False, 'recording': ''}
UNTIED['recording_time'] = SIMULATED
# A run has diverged beyond these: positions [rad or m], velocities [rad/s or m/s], efforts [N m
# or N].
THRESHOLDS = (1e-3, 1e-2, 1e-1)


@dataclass(kw_only=True)
class WhatIf(Run):
    """What a changed arm did, compared with the log; times in s after the start."""

    source: Path
    # The log of the new run; the changes as given.
    log: Path
    changes: tuple[str, ...]
    # What another convention changes besides, NAME=VALUE.
    also: tuple[str, ...]
    # Of the new run, 'auto' resolved; its simulated time, s.
    robot: str
    settings: Settings
    seconds: float
    # Number of states in the source.
    states: int
    thresholds: tuple[float, ...]
    # Of the log and the new run, at the times of the log; of the new run and the rounding run.
    divergences: tuple[Difference, ...]
    rounding: tuple[Difference, ...]
    # Joints.
    only_in_log: tuple[str, ...]
    only_in_arm: tuple[str, ...]
    # When the simulation, or with `error` its controller, stopped.
    failed_at: float | None
    # Changed settings that inputs of the log change later, to the recorded values.
    replaced: tuple[str, ...]
    states_topic: str
    # Time base of a bag: 'stamps' or 'log times'; '' for a recording.
    times: str
    complete: bool
    # Lines about what could not be read.
    problems: list[str]
    # Both motions at the times of the log.
    curves: Curves = field(repr=False, compare=False)


class _States(NamedTuple):
    """States with their times since the start, (N,), s."""

    topic: str
    found: TopicArrays
    time: NDArray[np.float64]


class Case(NamedTuple):
    """A changed arm, the log whose inputs it takes, and the time at which its states begin, ns."""

    inputs: Callable[[Engine], Iterable[Input]]
    old: _States
    settings: Settings
    robot: pfd.Robot
    urdf: str
    start_ns: int
    complete: bool
    problems: list[str]
    # Topics of a recording by role; the inputs of a bag.
    topics: Mapping[str, str]
    bag: BagInputs | None = None
    also: tuple[str, ...] = ()


# Runs a changed arm before its first cycle to the end of the log; raises no error of a controller.
Drive: TypeAlias = Callable[[Case, Engine, Put], Run]


def what_if(
    path: Path | str,
    changes: Sequence[str] = (),
    *,
    commands: str = '',
    states: str = '',
    rename: Mapping[str, str] | None = None,
    out: Path | None = None,
    thresholds: Sequence[float] = THRESHOLDS,
    rounding: bool = False,
    progress: Callable[[float], None] | None = None,
    drive: Drive | None = None,
) -> WhatIf:
    """Simulate the inputs of a log with a changed arm, and compare the motions.

    `path` is a recording of the node, or with `commands` any bag, for which `states` and `rename`
    are as BagInputs takes them. `changes` are KEY=VALUE, parameters of the node; without any the
    run is repeated. `out` is the log of the new run, by default NAME_what_if.mcap in the current
    folder, `thresholds` are of positions, velocities and efforts, and `rounding` asks for the
    rounding run. `progress` is called with the finished share, 0 to 1. `drive` runs the changed
    arm with a controller, see pfd_ros.testing.again.

    ValueError if a setting is invalid, or the log (LogError) is damaged, no recording of this
    edition, or has no joint of the arm; no log is written then. If the new run has nothing to
    compare (LogError) it stays, and the text names it. OSError if a file cannot be read or
    written.
    """
    path = Path(path)
    if len(thresholds) != 3 or not all(0 <= x < np.inf for x in thresholds):
        raise ValueError(f'thresholds must be 3 numbers, 0 or more, got {list(thresholds)}')
    read = read_changes(changes)
    if commands:
        case = _of_bag(path, read, commands, states, rename or {})
    elif states or rename:
        raise ValueError('--states and --rename are for bags: name a topic with --commands')
    else:
        case = _of_recording(path, read)
    old = case.old.found
    stem = path.name if path.is_dir() else path.stem
    target = out or free_path(Path(f'{stem}_what_if.mcap'))
    engine = _engine(case, case.settings)
    limits = dict(zip(JOINT_FIELDS, map(float, thresholds), strict=True))
    with damage_named(path):
        run = _recorded_run(case, engine, target, progress, drive)
        new = _new_states(case, target)
        if not len(new.time) and not run.error:
            raise LogError(f'the new run, in {target}, has no states: there is nothing to compare')
        failed_at = (run.failed_ns - case.start_ns) / NANOSECONDS if run.failure else None
        if failed_at is not None and failed_at < case.old.time[0] and not run.error:
            raise LogError(
                f'the simulation failed before the first recorded state: {run.failure}; the '
                f'new run is in {target}'
            )
        # A reset may let the new run go on.
        until = np.inf if failed_at is None else failed_at
        # Without a command of the controller there is nothing to say of it.
        silent = run.error is not None and not run.accepted
        curves = {} if silent else _curves(case.old, new, until)
        alone = _curves(new, _rounded_states(case, engine, drive), until) if rounding else {}
    own = {*engine.names, *engine.locked}
    first, last = engine.state.first, engine.state.settings
    given = [row for row in FIELDS if row.field in {*read.values, *read.of_joints}]
    return WhatIf(
        **vars(run),
        source=path,
        log=target,
        changes=tuple(changes),
        also=case.also,
        robot=case.robot.name,
        settings=first,
        seconds=(engine.stamp_ns - engine.state.origin_ns) / NANOSECONDS,
        states=len(old),
        thresholds=tuple(limits.values()),
        divergences=tuple(difference(at, curve, limits[at[1]]) for at, curve in curves.items()),
        rounding=tuple(difference(at, curve, limits[at[1]]) for at, curve in alone.items()),
        only_in_log=tuple(name for name in old.names if name not in own),
        only_in_arm=tuple(name for name in engine.names if name not in old.names),
        failed_at=failed_at,
        replaced=tuple(
            row.name for row in given if getattr(first, row.field) != getattr(last, row.field)
        ),
        states_topic=case.old.topic,
        times=case.bag.times if case.bag else '',
        complete=case.complete,
        problems=case.problems,
        curves=curves,
    )


def _curves(one: _States, two: _States, until: float) -> Curves:
    """Return both motions at the times of the first, up to one of them.

    Between two of them efforts jump, and interpolated ones would differ. Nothing is interpolated
    where the second has a lower rate: all its times are times of the first.
    """
    found: Curves = {}
    names = [name for name in one.found.names if name in two.found.names]
    both = [[track(x.found, name, x.time) for x in (one, two)] for name in names]
    for item in JOINT_FIELDS:
        for name, (left, right) in zip(names, both, strict=True):
            (times, x, y), _ = aligned(left, right, item)
            inside = (right.time >= left.time[0]) & (right.time <= left.time[-1])
            rarer = inside.any() and np.isin(right.time[inside], left.time).all()
            chosen = np.isin(times, right.time if rarer else left.time) & (times <= until)
            if chosen.any():
                found[one.topic, item, name] = times[chosen], x[chosen], y[chosen]
    return found


def _new_states(case: Case, path: Path) -> _States:
    topic = topic_names([STATES], case.topics)[STATES]
    found = read_log(path, topics=[topic])[topic]
    assert found.stamp_ns is not None
    return _States(topic, found, (found.stamp_ns - case.start_ns) / NANOSECONDS)


def _rounded_states(case: Case, engine: Engine, drive: Drive | None) -> _States:
    first = engine.state.first
    start = one_bit(np.array(first.initial_positions or (0.0,) * case.robot.n))
    other = _engine(case, replace(first, initial_positions=tuple(start.tolist())))
    inputs = case.inputs
    case = case._replace(inputs=lambda engine: nudged(inputs(engine)))
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder, 'rounding.mcap')
        _recorded_run(case, other, target, None, drive)
        return _new_states(case, target)


def _of_recording(path: Path, changes: Changes) -> Case:
    try:
        log = Log(path)
    except OtherLogError as error:
        raise LogError(
            f'{error}; for the commands of a bag name their topic with --commands'
        ) from None
    settings, robot, urdf = changed_arm(log, changes)
    topic = log.topics.get(STATES, '')
    arrays = read_log(path, topics=[topic], unreadable='count')
    states = arrays.required(topic, JOINT_STATE)
    stamps = states.stamp_ns
    assert stamps is not None
    begins = log.settings.start_ns, settings.start_ns
    if settings.follows_clock:
        # The ticks say the time of both.
        begins = int(stamps[0]), int(stamps[0])
    return Case(
        lambda engine: recorded_inputs(log, engine),
        _States(topic, states, (stamps - begins[0]) / NANOSECONDS),
        replace(settings, **UNTIED),
        robot,
        urdf if 'robot' in changes.values else log.description,
        begins[1],
        arrays.complete,
        arrays.lost([topic]),
        log.topics,
        also=tuple(
            f'{name}={value}'
            for name, value in with_convention(log.settings, changes.values).items()
            if name not in changes.values and value != getattr(log.settings, name)
        ),
    )


def _of_bag(
    path: Path, changes: Changes, commands: str, states: str, rename: Mapping[str, str]
) -> Case:
    settings, robot, urdf = described_arm(changes)
    log = read_log(path, types=(JOINT_STATE, FLOAT_ARRAY), unreadable='count')
    bag = BagInputs(log, commands, states, rename, robot.joint_names)
    settings = replace(settings, **UNTIED)
    start = (bag.start_ns - settings.step_ns) / NANOSECONDS
    if 'start_time' not in changes.values and 0.0 <= start <= LAST_SECOND:
        settings = replace(settings, start_time=start)
    start_ns = settings.start_ns + settings.step_ns
    old = _States(bag.topic, bag.states, (bag.times_ns - bag.start_ns) / NANOSECONDS)
    problems = log.lost(dict.fromkeys((bag.topic, commands)))
    return Case(bag.inputs, old, settings, robot, urdf, start_ns, log.complete, problems, {}, bag)


def _engine(case: Case, settings: Settings) -> Engine:
    frames = link_frames(case.urdf, settings, case.robot) if case.urdf else None
    roles = {*events.INPUTS, events.REJECTED, events.REJECTED_COUNTS, events.PAYLOAD_IN_USE}
    roles |= {STATES, *events.OPTIONAL, *(frames.roles if frames is not None else ())}
    roles |= {events.CLOCK} if settings.publish_clock else set()
    return Engine(settings, case.robot, roles, frames)


def _recorded_run(
    case: Case,
    engine: Engine,
    target: Path,
    progress: Callable[[float], None] | None,
    drive: Drive | None,
) -> Run:
    """Run an arm under the inputs of the log, and record it; without a result no file is left."""
    topics = topic_names(engine.roles, case.topics)
    recorder = Recorder(target, engine, topics, lambda line: None)
    first, whole = engine.stamp_ns, max(1.0, NANOSECONDS * float(np.ptp(case.old.time)))

    def put(messages: Sequence[Message], stamp_ns: int) -> None:
        recorder.put_slowly(messages, stamp_ns)
        if recorder.error:
            raise OSError(recorder.error)
        if progress is not None and engine.state.cycle % 1024 == 0:
            progress(min(1.0, (stamp_ns - first) / whole))

    try:
        run = drive(case, engine, put) if drive else run_inputs(case.inputs(engine), engine, put)
        if case.bag is not None and not run.error:
            case.bag.check(run)
        recorder.close()
        if recorder.error:
            raise OSError(recorder.error)
    except BaseException:
        recorder.close()
        # After a fault of the disk the part that was written stays, as in a recording.
        if not recorder.error:
            os.unlink(target)
        raise
    return run


def as_json(found: WhatIf) -> dict[str, Any]:
    """Return a result without settings and curves, ready for JSON."""
    left_out = {'settings', 'curves', 'error', 'accepted', 'failed_ns'}
    values = {name: value for name, value in vars(found).items() if name not in left_out}
    return values | {
        'source': str(found.source),
        'log': str(found.log),
        'thresholds': dict(zip(JOINT_FIELDS, found.thresholds, strict=True)),
        'divergences': [asdict(item) for item in found.divergences],
        'rounding': [asdict(item) for item in found.rounding],
    }


def lines(found: WhatIf) -> list[str]:
    """Return a result as lines for people."""
    position, velocity, effort = found.thresholds
    rows = [
        f'{found.source}: {found.robot}, {" ".join(found.changes) or "nothing changed"}',
        f'new run    {found.log}, {found.seconds:.3f} s, compared with {found.states} states',
    ]
    if found.also:
        rows.append(
            f'besides    the convention changes {" ".join(found.also)}; name what is to stay'
        )
    rows.append(f'loop       {found.loop}')
    if found.times:
        rows.append(f'times      {found.times} of the messages; states of {found.states_topic}')
    if found.failed_at is not None:
        who = 'simulation' if found.error is None else 'controller'
        until = 'compared up to there' if found.divergences else 'nothing is compared'
        rows.append(
            f'FAILED     {who} stopped at {found.failed_at:.6f} s, {until}: {found.failure}'
        )
    if found.rejected:
        counts = ', '.join(f'{count} {name}' for name, count in sorted(found.rejected.items()))
        what = 'rejected' if found.times else 'accepted or rejected differently'
        rows.append(f'inputs     {what}: {counts}; {found.first_rejected}')
    if found.replaced:
        rows.append(
            f'replaced   {listed(found.replaced)}: the log sets it while it runs; the value of '
            '--what-if acts until then'
        )
    for text, joints in (('log', found.only_in_log), ('arm', found.only_in_arm)):
        if joints:
            rows.append(f'joints     only in the {text}: {listed(joints)}')
    rows += [f'unread     {problem}' for problem in found.problems]
    if not found.complete:
        rows.append('cut off    the log was not closed; compared up to the cut')
    if not found.divergences:
        return rows
    rows.append(
        f'diverged   beyond {position:g} rad or m, {velocity:g} rad/s or m/s, {effort:g} N m or '
        'N; times in s after the start'
    )
    width = max((len(item.joint) for item in found.divergences), default=0)
    head = f'{"":9}  {"":{width}}  {"new run - log":49}'
    alone = {(item.field, item.joint): item for item in found.rounding}
    if alone:
        rows.append(
            'rounding   the new run again, with 2.2e-16 added to each position that the arm is '
            'set to'
        )
        head += '  rounding alone'
    rows.append(head.rstrip())
    for item in found.divergences:
        row = (
            f'{item.field:9}  {item.joint:{width}}  max {item.largest:.2e} at '
            f'{item.largest_at:.3f} s rms {item.rms:.2e} {_from(item):16}'
        )
        if last := alone.get((item.field, item.joint)):
            row += f'  max {last.largest:.2e} rms {last.rms:.2e} {_from(last)}'
        rows.append(row.rstrip())
    return rows


def _from(item: Difference) -> str:
    if item.largest == 0:
        return 'equal'
    return 'never' if item.first_at is None else f'from {item.first_at:.3f} s'
