# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulate a recording again and compare every output of the arm, byte for byte.

Only the file is needed, no ROS: it holds the settings, the robot, the bytes of every input, and
the cycle that took it. It is read twice: to check that it is complete and possible
(`inspection.py`), and to feed the engine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import pfd_core as pfd
from pfd_ros.arm.driver import Driver
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import ARM_STATE, CLOCK, STATES, TAKEN, TF, TF_STATIC, Output
from pfd_ros.arm.link_frames import link_frames
from pfd_ros.arm.state import ArmState
from pfd_ros.messages.convert import (
    BYTE_ARRAY,
    FLOAT_ARRAY,
    TRANSFORMS,
    decode_bytes,
    decode_clock,
    decode_joint_state,
    decode_string,
    encode_clocks,
)
from pfd_ros.recording.format import CHANNELS
from pfd_ros.recording.head import Totals, read_robot
from pfd_ros.recording.provenance import COMMIT, PROGRAM, commit, versions
from pfd_ros.recording.reader import Log, LogError, damage_named
from pfd_ros.recording.run_parts import continues, in_order
from pfd_ros.replay.differences import difference
from pfd_ros.replay.inspection import Inspection, inspect
from pfd_ros.replay.ordering import Columns, PlacedMessage
from pfd_ros.replay.playback import Playback, Stretch, follow
from pfd_ros.replay.summary import RunSummary, Summary
from pfd_ros.text import cut

# Share of the progress that the inspection gets when the file is simulated too.
INSPECTION_SHARE = 0.1
# Types of outputs that do not begin with a stamp.
STAMPED_ELSEWHERE = frozenset({FLOAT_ARRAY, BYTE_ARRAY, TRANSFORMS})


class DifferenceError(LogError):
    """The first place where the recording and its replay differ."""


def read(
    path: Path, *, verify: bool = False, progress: Callable[[float], None] | None = None
) -> Summary:
    """Read one file of a recording to its end, and with `verify` replay it; as `read_run`."""
    return read_run([path], verify=verify, progress=progress).parts[0]


def read_run(
    paths: Sequence[Path],
    *,
    verify: bool = False,
    progress: Callable[[float], None] | None = None,
) -> RunSummary:
    """Read the files of a recording to their ends, and with `verify` replay it.

    Parameters
    ----------
    paths
        The files, in any order; a file that was cut off is read up to the cut.
    verify
        Simulate the run again and compare all outputs and validation results.
    progress
        Called now and then with the finished part, 0 to 1.

    Raises
    ------
    DifferenceError
        At the first differing bit; the text names step, joint, field and both values.
    LogError
        If a file is not a recording, is damaged, or holds too little to be replayed, or the files
        are from different runs.
    OSError
        If a file cannot be read.
    """
    logs = in_order([Log(Path(path)) for path in paths])
    share = (INSPECTION_SHARE if verify else 1.0) / len(logs)

    def part(start: float, share: float) -> Callable[[float], None] | None:
        return None if progress is None else _share_of(progress, start, share)

    parts: list[_FilePart] = []
    for k, log in enumerate(logs):
        with damage_named(log.path):
            found = _lean(inspect(log, part(k * share, share)), [one.found for one in parts])
            gapless = k > 0 and continues(logs[k - 1], log)
            parts.append(_FilePart(log, found, gapless))
    if verify:
        replay = _replay_of(parts)
        rest = (1.0 - INSPECTION_SHARE) / len(parts)
        for k, each in enumerate(parts):
            with damage_named(each.log.path):
                _replay(each, replay, part(INSPECTION_SHARE + k * rest, rest))
                _check_altered(each)
        _check_compared(parts)
    for each in parts:
        with damage_named(each.log.path):
            _check_altered(each)
    return RunSummary([each.found.summary for each in parts])


def _lean(found: Inspection, before: Sequence[Inspection]) -> Inspection:
    """Drop the state and the URDF of a file after the first with states: only its are used.

    Each may have 16 MiB, and a run 10 000 files.
    """
    if any(one.summary.states for one in before):
        found.state = found.description = b''
    return found


def _share_of(
    progress: Callable[[float], None], start: float, share: float
) -> Callable[[float], None]:
    """Return the progress of a part of the work."""
    return lambda done: progress(start + share * done)


class _FilePart(NamedTuple):
    """An inspected file of a run; `gapless` if it continues the file before it."""

    log: Log
    found: Inspection
    gapless: bool


def _check_altered(part: _FilePart) -> None:
    if part.found.altered:
        raise ValueError(part.found.altered)


def _check_compared(parts: Sequence[_FilePart]) -> None:
    """Raise LogError if no state could be compared."""
    summaries = [part.found.summary for part in parts]
    if not RunSummary(summaries).compared:
        why = next(summary for summary in summaries if summary.obstacle)
        raise LogError(f'{why.path} {why.obstacle}')


def _replay_of(parts: Sequence[_FilePart]) -> _Replay:
    """Return an engine at the start of a run, with the gaps in which it skips steps."""
    log, found, _ = next((part for part in parts if part.found.summary.states), parts[0])
    if found.summary.states == 0:
        raise LogError(f'{log.path} holds no states, so there is nothing to verify')
    gaps: list[tuple[int, int]] = []
    # First step without inputs at the end of the previous file, and that file.
    blocked, blocking = 0, log
    for part in parts:
        summary = part.found.summary
        if blocked and not summary.start:
            break
        if blocked or (summary.start and not part.gapless):
            gaps.append((blocked or summary.start, summary.start))
        gaps += summary.gaps
        blocked, blocking = part.found.blocked, part.log
    if blocked:
        obstacle = next(p.found.summary.obstacle for p in parts if p.log is blocking)
        raise LogError(f'{blocking.path} {obstacle}')
    settings, frames = found.summary.settings, None
    with damage_named(log.path):
        robot = recorded_robot(log, found.state)
        if found.description:
            frames = link_frames(decode_string(found.description), settings, robot)
        return _Replay(Driver(Engine(settings, robot, frames=frames)), gaps=gaps)


def _replay(part: _FilePart, replay: _Replay, progress: Callable[[float], None] | None) -> None:
    """Feed an engine from a file and compare its outputs with the recorded ones."""
    log, found, _ = part
    arm, before = replay.driver.engine.arm, replay.uncompared
    try:
        follow(log, replay.follow, progress)
        replay.flush()
        if found.ending is not None and found.ending.totals is not None:
            replay.finish(found.ending.totals)
    except DifferenceError as error:
        raise DifferenceError(f'{error}; {_cause(found, arm.program)}') from error
    found.summary.uncompared = replay.uncompared - before
    if arm.failure:
        found.summary.stopped_at, found.summary.failure = arm.step, arm.failure


def simulable(
    logs: Sequence[Log], progress: Callable[[float], None] | None = None
) -> tuple[list[Inspection], pfd.Robot]:
    """Inspect the files of a recording, in their order; return the results, and its robot.

    Raises
    ------
    ValueError
        If it is damaged, or holds too little to be simulated to its end (LogError).
    OSError
        If it cannot be read.
    """
    results: list[Inspection] = []
    for k, log in enumerate(logs):
        share = None if progress is None else _share_of(progress, k / len(logs), 1 / len(logs))
        with damage_named(log.path):
            found = _lean(inspect(log, share), results)
            if found.altered:
                raise ValueError(found.altered)
        results.append(found)
        if k and not continues(logs[k - 1], log):
            raise LogError(f'{log.path} does not continue {logs[k - 1].path}: a part is missing')
        if not k and found.summary.part > 1:
            raise LogError(
                f'{log.path} is part {found.summary.part} of a run: expected a log from its start'
            )
        if found.summary.obstacle:
            raise LogError(f'{log.path} {found.summary.obstacle}')
    states = [found.state for found in results if found.summary.states]
    if not states:
        raise LogError(f'{logs[0].path} holds no states, so there is nothing to simulate')
    return results, recorded_robot(logs[0], states[0])


def recorded_robot(log: Log, state: bytes) -> pfd.Robot:
    """Return the robot of a recording; DifferenceError if its joints are not those recorded."""
    robot = read_robot(log.robot_yaml)
    names = decode_joint_state(state).names
    expected = (*robot.joint_names, *log.settings.published_locks)
    if sorted(names) != sorted(expected):
        raise DifferenceError(f'names: recorded {names!r}, its robot has {expected!r}')
    return robot


def _cause(found: Inspection, program: str) -> str:
    """Return why a recording and its replay differ: other data, program or processor."""
    if found.altered:
        return f'cause: other data, {found.altered}'
    there, here = found.summary.versions, versions()

    def both(name: str, label: str = '') -> str:
        return f'{label or name} {cut(there.get(name, "unknown"))}, here {cut(here[name])}'

    here |= {COMMIT: commit() or 'unknown', PROGRAM: program}
    if there.get(PROGRAM) != program:
        named = (name for name in ('pfd', COMMIT, 'llvmlite') if there.get(name) != here[name])
        others = ''.join(f'; {both(name)}' for name in named)
        digests = both(PROGRAM, 'recorded with digest')
        return f'cause: another program, {digests}{others}'
    if found.ending is None:
        return 'cause: other data; the program is the same'
    return f'cause: not the program, the settings or the data; {both("cpu", "processor")}'


@dataclass
class _Replay(Playback):
    """A playback that compares every output with the recorded one.

    Attributes
    ----------
    rows
        Data of the validation rows of the last events.
    outputs
        Data of the last cycle's other outputs, by role.
    gaps
        The gaps that are still ahead, as in Summary.
    uncompared
        Number of states within gaps.
    """

    rows: list[bytes] = field(default_factory=list)
    outputs: dict[str, bytes] = field(default_factory=dict)
    gaps: list[tuple[int, int]] = field(default_factory=list)
    uncompared: int = 0

    def __post_init__(self) -> None:
        """Have the outputs compared."""
        self.driver.put = self._keep

    def _keep(self, outputs: Sequence[Output]) -> None:
        if outputs and outputs[0].role == TAKEN:
            self.rows = [output.data for output in outputs]
        else:
            self.outputs = {output.role: output.data for output in outputs}

    def _in_gap(self, message: PlacedMessage) -> bool:
        if not self.gaps or message.cycle < self.gaps[0][0]:
            return False
        self.flush()
        return True

    def together(self, block: Columns) -> bool:
        """Return whether no output is in a gap."""
        return not self.gaps or block.cycles[-1] < self.gaps[0][0]

    def take(self, message: PlacedMessage) -> None:
        """Follow validation rows; discard them in a gap."""
        if self._in_gap(message):
            self.inbox.take(message)
        else:
            super().take(message)

    def output(self, message: PlacedMessage) -> None:
        """Follow an output; the recorded state of the whole arm ends a gap."""
        if not self._in_gap(message):
            super().output(message)
        elif message.role == ARM_STATE and message.cycle == self.gaps[0][1]:
            del self.gaps[0]
            self._continue_from(ArmState.from_bytes(decode_bytes(message.data)))
        else:
            self.uncompared += message.role == STATES

    def _continue_from(self, saved: ArmState) -> None:
        engine = self.driver.engine
        if saved.first != engine.state.first:
            raise ValueError(f'the state after step {saved.cycle} was saved with other settings')
        engine.restore(saved)

    def take_now(self, message: PlacedMessage) -> None:
        """Compare validation rows."""
        self.driver.run_to(message.cycle - 1)
        self.driver.take(self.inbox.take(message))
        for data in self.rows:
            self._compare(message, data)

    def output_now(self, message: PlacedMessage) -> None:
        """Compare an output of a cycle."""
        if message.role == TF and self.driver.engine.frames is None:
            return  # the URDF is missing, which the inspection has noted
        # Arrays have no stamp, and frames have it at another place. Where states are missing too,
        # the stamp of the next state is checked.
        if message.lost and CHANNELS[message.role].type not in STAMPED_ELSEWHERE:
            self._run_to_stamp(message)
        self.driver.run_to(message.cycle)
        if message.role not in self.outputs:
            raise DifferenceError(
                f'step {message.cycle}: recorded {message.role} {message.number}, '
                f'replayed {" and ".join(self.outputs) or "nothing"}'
            )
        self._compare(message, self.outputs[message.role])

    def stretched(self, stretch: Stretch) -> bool:
        """Compare the states and ticks of a stretch, all at once."""
        stamps, rows = stretch.stamps_ns, stretch.rows
        places, states = stretch.of(STATES)
        replayed = self.driver.engine.encode_states(stamps[places], rows[places])
        if replayed != b''.join(states):
            return False
        places, ticks = stretch.of(CLOCK)
        if encode_clocks(stamps[places]) != b''.join(ticks):
            return False
        frames, (places, recorded) = self.driver.engine.frames, stretch.of(TF)
        return frames is None or all(
            frames.encode(stamp, row[0]) == data
            for stamp, row, data in zip(
                stamps[places].tolist(), rows[places], recorded, strict=True
            )
        )

    def aside(self, message: PlacedMessage) -> None:
        """Compare the frames that never move."""
        engine = self.driver.engine
        if message.role == TF_STATIC and engine.frames is not None:
            opening = engine.frames.opening(engine.settings.start_ns)
            replayed = {output.role: output.data for output in opening}
            self._compare(message, replayed.get(TF_STATIC, b''))

    def finish(self, ending: Totals) -> None:
        """Run to the node's last step; DifferenceError if only one of both runs failed there."""
        # The failed cycle follows the last good step.
        self.driver.run_to(ending.steps + bool(ending.failure))
        arm, theirs = self.driver.engine.arm, ending.failure
        if bool(arm.failure) != bool(theirs) or arm.step != ending.steps:
            raise DifferenceError(
                f'the end: recorded {ending.steps} steps and {theirs or "no failure"!r}, '
                f'replayed {arm.step} steps and {arm.failure or "no failure"!r}'
            )

    def _run_to_stamp(self, message: PlacedMessage) -> None:
        """Check the stamp of a message after missing ones.

        An earlier stamp than its cycle's is possible only if the arm failed, so the engine must
        fail in the step after the stamp.
        """
        settings = self.driver.engine.settings
        stamp = decode_clock(message.data)
        done = (stamp - settings.start_ns) // settings.step_ns
        if done >= message.cycle:
            return
        self.driver.run_to(done + 1)
        if not self.driver.engine.arm.failure:
            raise DifferenceError(
                f'step {message.cycle}: {message.role} {message.number}: recorded stamp '
                f'{stamp} ns, expected the stamp of step {message.cycle}'
            )

    def _compare(self, message: PlacedMessage, computed: bytes) -> None:
        if message.data != computed:
            where = difference(message.role, message.data, computed)
            failure = self.driver.engine.arm.failure
            why = f'; the replay: {failure}' if failure else ''
            raise DifferenceError(f'step {message.cycle}: {where}{why}')
