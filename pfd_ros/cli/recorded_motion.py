# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The motion of a recording: the efforts and brakes of every step, and the recorded states.

Efforts and brakes come from a replay, since they may depend on the state. States are the recorded
ones; with errors of sensors in them, they come from the replay too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_core.report.cases.excitations import DrivenMotion
from pfd_ros.arm.arm import load_robot, simulator_settings
from pfd_ros.arm.driver import Driver
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import STATES
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.convert import decode_joint_state
from pfd_ros.recording.reader import Log, LogError, damage_named
from pfd_ros.replay.ordering import Columns, PlacedMessage
from pfd_ros.replay.playback import Playback, Stretch, follow
from pfd_ros.replay.verify import simulable
from pfd_ros.text import cut, listed

# Steps that a motion has at most: a hundred seconds at 1 kHz.
MOST_STEPS = 100_000


class RecordedMotion(NamedTuple):
    """The robot and the scene of a recording, and its motion."""

    robot: pfd.Robot
    scene: pfd.Scene
    motion: DrivenMotion


def read_motion(
    path: Path,
    robot_source: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> RecordedMotion:
    """Return the motion of a recording, of its first MOST_STEPS steps at most.

    Parameters
    ----------
    path
        The file; a file that was cut off is read up to the cut.
    robot_source
        A robot to use in place of the recorded one, with the same joints, as `load_robot` takes
        it; base, tip and locked joints come from the settings of the recording.
    progress
        Called now and then with the finished part, 0 to 1.

    Raises
    ------
    LogError
        If the file is not a recording, is damaged, lacks commands or their records, or its robot
        has other joints than `robot_source`.
    OSError
        If it cannot be read.
    """
    path = Path(path)
    log = Log(path)
    with damage_named(path):
        (found,), recorded = simulable([log], progress)
        summary, settings = found.summary, found.summary.settings
        steps = min(summary.simulated, MOST_STEPS)
        engine = Engine(settings, recorded, rows=False)
        if engine.state.wrench is not None:
            raise ValueError(
                'its arm has an external wrench, so its torques do not determine the motion'
            )
        reading = _Reading(Driver(engine), scene=engine.arm.scene, steps=steps)
        follow(log, reading.follow)
        reading.flush()
        reading.run_to(steps)
        motion = _motion(path, settings, reading, steps)
        shortened = f'the first {steps} steps of ' if steps < summary.simulated else ''
        motion = replace(motion, source=f'{shortened}the torques of the recording {path.name}')
    robot = recorded
    if robot_source is not None:
        robot = load_robot(settings, robot_source)
        if list(robot.joint_names) != list(recorded.joint_names):
            raise LogError(
                f'{path} is a recording of {cut(recorded.name)!r} with the joints '
                f'{listed(recorded.joint_names)}, but {cut(robot.name)!r} has '
                f'{listed(robot.joint_names)}'
            )
    return RecordedMotion(robot, reading.scene, motion)


@dataclass
class _Reading(Playback):
    """The efforts and the states of a recording, up to the last message read.

    Attributes
    ----------
    scene
        Scene of the arm, which must not change.
    steps
        Number of steps to read.
    efforts, braked
        Efforts and brakes of each step, (n,) in model order.
    states
        For each state the step that it follows, positions and velocities, (n,) in model order.
    """

    scene: pfd.Scene = field(kw_only=True)
    steps: int = field(kw_only=True)
    efforts: list[NDArray[Any]] = field(default_factory=list)
    braked: list[NDArray[Any]] = field(default_factory=list)
    states: list[tuple[int, NDArray[Any], NDArray[Any]]] = field(default_factory=list)

    def together(self, block: Columns) -> bool:
        """Return whether no output comes after the last step."""
        return bool(block.cycles[-1] <= self.steps)

    def take(self, message: PlacedMessage) -> None:
        """Follow validation rows, up to the last step."""
        if message.cycle <= self.steps:
            super().take(message)

    def output(self, message: PlacedMessage) -> None:
        """Follow an output, up to the last step."""
        if message.cycle <= self.steps:
            super().output(message)

    def take_now(self, message: PlacedMessage) -> None:
        """Run to the cycle that took inputs, and apply them."""
        self.run_to(message.cycle - 1)
        self.driver.take(self.inbox.take(message))

    def aside(self, message: PlacedMessage) -> None:
        """Skip a message that does not move the arm."""

    def output_now(self, message: PlacedMessage) -> None:
        """Read a state."""
        if message.role != STATES:
            return
        self.run_to(message.cycle)
        arm = self.driver.engine.arm
        self._add_state(message.cycle, message.data, arm.q, arm.qd)

    def stretched(self, stretch: Stretch) -> bool:
        """Read the states of a stretch."""
        if self.driver.engine.arm.scene is not self.scene:
            return False
        self.efforts += [*stretch.rows[:, 2]]
        self.braked += [np.zeros(stretch.rows.shape[2], bool)] * len(stretch.rows)
        for place, data in zip(*stretch.of(STATES), strict=True):
            self._add_state(int(place) + stretch.first, data, *stretch.rows[place, :2])
        return True

    def _add_state(self, cycle: int, data: bytes, q: NDArray[Any], qd: NDArray[Any]) -> None:
        """Add a recorded state; a measured one is replaced by the true one, q and qd."""
        engine = self.driver.engine
        if engine.sensors is None:
            state = decode_joint_state(data)
            order, count = list(engine.arm.order), len(engine.arm.order)
            q, qd = np.empty((2, count))
            # Locked joints come after the moving ones.
            q[order], qd[order] = state.position[:count], state.velocity[:count]
        self.states.append((cycle, q, qd))

    def run_to(self, cycle: int) -> None:
        """Do the steps up to this one."""
        engine = self.driver.engine
        while engine.cycles < cycle and not engine.arm.failure:
            if engine.state.jumps:
                raise ValueError(
                    f'its arm is set to another state before step {engine.cycles + 1}: '
                    'not a continuous motion'
                )
            if engine.arm.scene is not self.scene:
                raise ValueError(
                    f'its payload or gravity compensation changes before step '
                    f'{engine.cycles + 1}: not a motion of one scene'
                )
            self.driver.step()
            self.efforts.append(engine.state.tau)
            self.braked.append(engine.state.braked)


def _motion(path: Path, settings: Settings, reading: _Reading, steps: int) -> DrivenMotion:
    """Return the motion of the first steps of a recording that was read whole."""
    n = reading.driver.engine.arm.q.size
    taus = np.array(reading.efforts[:steps]).reshape(-1, n)
    braked = np.array(reading.braked[:steps]).reshape(-1, n)
    if braked.all():
        raise LogError(
            f'{path} holds no torques: no command was accepted in its {steps} steps, and brakes '
            'hold every joint'
        )
    known = [
        (0, reading.driver.engine.arm.start, np.zeros(n)),
        *(state for state in reading.states if state[0] < steps),
    ]
    after, q, qd = zip(*known, strict=True)
    return DrivenMotion(
        path.name,
        '',
        simulator_settings(settings),
        taus,
        braked,
        np.array(after),
        np.array(q),
        np.array(qd),
    )
