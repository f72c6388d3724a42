# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs a recording again and compares every output of the arm, byte for byte.

Needs the file alone, no ROS: it holds settings, robot, the bytes of every input, and the cycle
that took it. The file is read twice: first to inspect whether it is whole and possible
(`inspection.py`), then to feed the engine from it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pfd_core as pfd
from pfd_ros.arm.driver import Driver
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import CLOCK, STATES, TAKEN, Output
from pfd_ros.messages.convert import FLOAT_ARRAY, decode_clock, decode_joint_state, encode_clocks
from pfd_ros.recording.format import CHANNELS
from pfd_ros.recording.head import Ending, read_robot
from pfd_ros.recording.reader import Log, LogError, damage_named
from pfd_ros.replay.differences import difference
from pfd_ros.replay.inspection import Inspection, inspect
from pfd_ros.replay.ordering import PlacedMessage
from pfd_ros.replay.playback import Playback, Stretch, follow
from pfd_ros.replay.summary import Summary

# Share of the progress that the inspection gets when the file is simulated too.
INSPECTION_SHARE = 0.1


class DifferenceError(LogError):
    """The first place where the recording and its replay differ."""


def read(
    path: Path, *, verify: bool = False, progress: Callable[[float], None] | None = None
) -> Summary:
    """Read a recording to its end, and with `verify` replay it.

    Parameters
    ----------
    path
        The file; a file that was cut off is read up to the cut.
    verify
        Run the engine again and compare all its outputs, verdicts too.
    progress
        Called now and then with the finished part, 0 to 1.

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
        found = inspect(log, part(0.0, INSPECTION_SHARE if verify else 1.0))
        if verify:
            _replay(log, found, part(INSPECTION_SHARE, 1.0 - INSPECTION_SHARE))
        if found.altered:
            raise ValueError(found.altered)
    return found.summary


def _replay(log: Log, found: Inspection, progress: Callable[[float], None] | None) -> None:
    """Feed an engine from a recording and compare its outputs with the recorded ones."""
    if found.summary.states == 0:
        raise LogError(f'{log.path} holds no states, so there is nothing to verify')
    if found.summary.obstacle:
        raise LogError(f'{log.path} {found.summary.obstacle}')
    engine = Engine(found.summary.settings, recorded_robot(log, found.state))
    replay = _Replay(Driver(engine))
    follow(log, replay, progress)
    replay.flush()
    if found.ending is not None:
        replay.finish(found.ending)
    arm = engine.arm
    if arm.failure:
        found.summary.stopped_at, found.summary.failure = arm.step, arm.failure


def recorded_robot(log: Log, state: bytes) -> pfd.Robot:
    """Return the robot of a recording; compiling one of other joints could take minutes."""
    robot = read_robot(log.robot_yaml)
    names = decode_joint_state(state).names
    expected = (*robot.joint_names, *log.settings.published_locks)
    if sorted(names) != sorted(expected):
        raise DifferenceError(f'names: recorded {names!r}, its robot has {expected!r}')
    return robot


@dataclass
class _Replay(Playback):
    """A playback that compares every output with the recorded one.

    Attributes
    ----------
    rows
        Data of the validation rows of the last events.
    outputs
        Data of the last cycle's outputs but validation rows, by role.
    """

    rows: list[bytes] = field(default_factory=list)
    outputs: dict[str, bytes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Have the outputs compared."""
        self.driver.put = self._keep

    def _keep(self, outputs: Sequence[Output]) -> None:
        if outputs and outputs[0].role == TAKEN:
            self.rows = [output.data for output in outputs]
        else:
            self.outputs = {output.role: output.data for output in outputs}

    def take_now(self, message: PlacedMessage) -> None:
        """Compare validation rows."""
        self.driver.run_to(message.cycle - 1)
        self.driver.take(self.inbox.take(message))
        for data in self.rows:
            self._compare(message, data)

    def output_now(self, message: PlacedMessage) -> None:
        """Compare an output of a cycle."""
        # An array has no stamp; if the states have the same gap, theirs says so.
        if message.lost and CHANNELS[message.role].type != FLOAT_ARRAY:
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
        return encode_clocks(stamps[places]) == b''.join(ticks)

    def finish(self, ending: Ending) -> None:
        """Run to where the node stopped, and compare whether it had failed by then."""
        # The cycle that failed follows the last good step.
        self.driver.run_to(ending.steps + bool(ending.failure))
        arm, theirs = self.driver.engine.arm, ending.failure
        if bool(arm.failure) != bool(theirs) or arm.step != ending.steps:
            raise DifferenceError(
                f'the end: recorded {ending.steps} steps and {theirs or "no failure"!r}, '
                f'replayed {arm.step} steps and {arm.failure or "no failure"!r}'
            )

    def _run_to_stamp(self, message: PlacedMessage) -> None:
        """Run through a gap only if the stamp behind it says that it was run through.

        A failed arm has an earlier stamp; then the next step cannot have been done.
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
                f'{stamp} ns, expected that of step {message.cycle}'
            )

    def _compare(self, message: PlacedMessage, computed: bytes) -> None:
        # Almost always one comparison of bytes.
        if message.data != computed:
            where = difference(message.role, message.data, computed)
            failure = self.driver.engine.arm.failure
            why = f'; the replay: {failure}' if failure else ''
            raise DifferenceError(f'step {message.cycle}: {where}{why}')
