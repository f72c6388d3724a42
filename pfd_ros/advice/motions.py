# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Motions that scenes are compared on: of a recording (`read_motion`), or sines (`sine`).

Torques, brakes and states of a recording come from a replay: torques and brakes may depend on the
state, and recorded states may have errors of sensors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.arm import load_robot, simulator_settings
from pfd_ros.arm.driver import Driver
from pfd_ros.arm.engine import Engine
from pfd_ros.recording.reader import Log, LogError, damage_named
from pfd_ros.replay.ordering import PlacedMessage, placed_blocks
from pfd_ros.replay.playback import Playback, Stretch
from pfd_ros.replay.verify import simulable
from pfd_ros.text import cut, listed

# Steps that a motion has at most: a hundred seconds at 1 kHz.
MOST_STEPS = 100_000
# Of sines: arguments of the simulator, length [s], bandwidth of the controller [rad/s], and the
# largest amplitude [rad or m], share of a joint's range and share of its velocity limit.
SETTINGS: Mapping[str, Any] = {
    'step_size': 1e-3,
    'substeps': 2,
    'integrator': 'auto',
    'method': 'auto',
}
SECONDS, BANDWIDTH = 4.0, 10.0
AMPLITUDE, RANGE_SHARE, VELOCITY_SHARE = 0.5, 0.25, 0.5


@dataclass(frozen=True, eq=False)
class Motion:
    """K steps of an arm with n joints.

    Attributes
    ----------
    name
        What it is, for a reader.
    joints
        Names of the joints, model order.
    settings
        step_size, substeps, integrator and method, as Simulator takes them.
    taus
        Torques of each step, (K, n) [N m or N].
    braked
        Joints that a brake holds in each step, (K, n) of bool.
    q, qd
        Positions and velocities before each step, (K, n) [rad or m, and per s].
    """

    name: str
    joints: tuple[str, ...]
    settings: Mapping[str, Any]
    taus: NDArray[Any]
    braked: NDArray[Any]
    q: NDArray[Any]
    qd: NDArray[Any]

    def check(self, robot: pfd.Robot) -> None:
        """Raise ValueError unless a robot has the joints of this motion."""
        if self.joints != robot.joint_names:
            raise ValueError(
                f'{self.name}: it has the joints {listed(self.joints)}, but '
                f'{cut(robot.name)!r} has {listed(robot.joint_names)}'
            )


def sine(robot: pfd.Robot, scene: pfd.Scene) -> Motion:
    """Simulate a robot whose joints follow sines of 0.4 to 1 Hz about the middle of their ranges.

    The controller is computed torque with a critically damped PD law (J. J. Craig, Introduction
    to Robotics, 3rd edition, chapter 10), within the effort limits of the robot:

        tau = ID(q, qd, qdd_ref + W^2 (q_ref - q) + 2 W (qd_ref - qd))

    with the inverse dynamics of the scene, except for friction, stops and motor lag.

    Raises
    ------
    ValueError
        If the robot cannot be simulated in the scene.
    """
    simulator = pfd.Simulator(robot, scene, **SETTINGS)
    instant = scene.without({effect.name for effect in pfd.EFFECTS if effect.acts == 'step'})
    inverse = pfd.compile_kernel(robot, scene=instant, quantity='inverse_dynamics')
    wrench = np.zeros(6) if scene.external_wrench else None
    limited = np.isfinite(robot.position_lower) & np.isfinite(robot.position_upper)
    lower = np.where(limited, robot.position_lower, 0.0)
    upper = np.where(limited, robot.position_upper, 0.0)
    # URDFs often write zero for an unknown limit.
    fastest, strongest = (
        np.where(limit > 0, limit, np.inf) for limit in (robot.velocity_limit, robot.effort_limit)
    )
    amplitude = np.minimum(AMPLITUDE, VELOCITY_SHARE * fastest / (2 * np.pi))
    amplitude = np.where(limited, np.minimum(amplitude, RANGE_SHARE * (upper - lower)), amplitude)
    count = round(SECONDS / simulator.step_size)
    w = 2 * np.pi * np.linspace(0.4, 1.0, robot.n)
    phase = simulator.step_size * np.arange(count)[:, np.newaxis] * w
    y = (lower + upper) / 2 + amplitude * np.sin(phase)
    yd, ydd = amplitude * w * np.cos(phase), -amplitude * w**2 * np.sin(phase)
    taus, q, qd = np.empty((3, count, robot.n))
    simulator.reset(y[0], yd[0])
    for k in range(count):
        q[k], qd[k] = simulator.q, simulator.qd
        qdd = ydd[k] + BANDWIDTH**2 * (y[k] - q[k]) + 2 * BANDWIDTH * (yd[k] - qd[k])
        taus[k] = np.clip(inverse(q[k], qd[k], qdd, wrench), -strongest, strongest)
        simulator.step(taus[k], wrench)
    name = 'sine: the joints follow sines of 0.4 to 1 Hz'
    braked = np.zeros(taus.shape, bool)
    return Motion(name, robot.joint_names, SETTINGS, taus, braked, q, qd)


class RecordedMotion(NamedTuple):
    """The robot and the scene of a recording, and its motion."""

    robot: pfd.Robot
    scene: pfd.Scene
    motion: Motion


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
    ValueError
        If the file is not a recording, is damaged, lacks commands or their records, its payload
        changes, or its robot has other joints than `robot_source`.
    OSError
        If it cannot be read.
    """
    path = Path(path)
    log = Log(path)
    with damage_named(path):
        (found,), recorded = simulable([log], progress)
        settings, simulated = found.summary.settings, found.summary.simulated
        steps = min(simulated, MOST_STEPS)
        engine = Engine(settings, recorded, rows=False)
        if engine.state.wrench is not None:
            raise ValueError(
                'its arm has an external wrench, so its torques do not determine the motion'
            )
        start = np.stack([engine.arm.start, *np.zeros((2, recorded.n))])
        reading = _Reading(Driver(engine), steps=steps, scene=engine.arm.scene, rows=[start])
        for block in placed_blocks(log):
            reading.follow(block)
            if engine.cycles >= steps:
                break
        reading.flush()
        reading.run_to(steps)
    rows, braked = np.array(reading.rows[: steps + 1]), np.array(reading.braked[:steps])
    if braked.all():
        raise LogError(
            f'{path} holds no torques: no command was accepted in its {steps} steps, and brakes '
            'hold every joint'
        )
    motion = Motion(
        f'{f"the first {steps} steps of " if steps < simulated else ""}the recording {path.name}',
        recorded.joint_names,
        simulator_settings(settings),
        taus=rows[1:, 2],
        braked=braked,
        q=rows[:-1, 0],
        qd=rows[:-1, 1],
    )
    robot = recorded if robot_source is None else load_robot(settings, robot_source)
    motion.check(robot)
    return RecordedMotion(robot, reading.scene, motion)


@dataclass
class _Reading(Playback):
    """The first `steps` steps of a recording; its scene must not change.

    `rows` has q, qd and tau, (3, n) in model order, at the start and after each step; `braked` has
    the brakes in each step, (n,).
    """

    steps: int = field(kw_only=True)
    scene: pfd.Scene = field(kw_only=True)
    rows: list[NDArray[Any]] = field(kw_only=True)
    braked: list[NDArray[Any]] = field(default_factory=list)

    def take_now(self, message: PlacedMessage) -> None:
        if message.cycle <= self.steps:
            self.run_to(message.cycle - 1)
            self.driver.take(self.inbox.take(message))

    def output_now(self, message: PlacedMessage) -> None:
        self.run_to(message.cycle)

    def aside(self, message: PlacedMessage) -> None:
        pass

    def stretched(self, stretch: Stretch) -> bool:
        if self.driver.engine.arm.scene is not self.scene:
            return False
        self.rows += [*stretch.rows]
        self.braked += [np.zeros(stretch.rows.shape[2], bool)] * len(stretch.rows)
        return True

    def run_to(self, cycle: int) -> None:
        engine = self.driver.engine
        while engine.cycles < min(cycle, self.steps) and not engine.arm.failure:
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
            self.rows.append(np.stack([engine.arm.q, engine.arm.qd, engine.state.tau]))
            self.braked.append(engine.state.braked)
