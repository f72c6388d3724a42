# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Motions that scenes are compared on: of a recording (`read_motion`), or sines (`sine`).

Torques, brakes and states of a recording come from a replay: torques and brakes may depend on the
state, and recorded states may have errors of sensors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.arm.description import load_robot
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.plant import simulator_settings
from pfd_ros.arm.state import BRAKE
from pfd_ros.recording.format import LogError, damage_named
from pfd_ros.recording.log import Log
from pfd_ros.replay.inputs import Fed, Input, recorded_inputs
from pfd_ros.text import cut, listed

# Of sines: arguments of the simulator, length [s], bandwidth of the controller [rad/s], and the
# largest amplitude [rad or m], share of a joint's range and share of its velocity limit.
SETTINGS: Mapping[str, Any] = {'step_size': 1e-3, 'substeps': 2}
SECONDS, BANDWIDTH = 4.0, 10.0
AMPLITUDE, RANGE_SHARE, VELOCITY_SHARE = 0.5, 0.25, 0.5


@dataclass(frozen=True, eq=False)
class Motion:
    """K steps of an arm with n joints."""

    name: str  # for a reader
    settings: Mapping[str, Any]  # step_size, substeps, integrator, method, as Simulator takes them
    taus: NDArray[Any]  # torques of each step, (K, n) [N m or N]
    braked: NDArray[Any]  # joints that a brake holds in each step, (K, n) of bool
    # Before each step, (K, n) [rad or m, and per s].
    q: NDArray[Any]
    qd: NDArray[Any]


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
    limited = np.isfinite([robot.position_lower, robot.position_upper]).all(axis=0)
    lower = np.where(limited, robot.position_lower, 0.0)
    upper = np.where(limited, robot.position_upper, 0.0)
    amplitude = np.minimum(AMPLITUDE, VELOCITY_SHARE * robot.velocity_limit / (2 * np.pi))
    amplitude = np.where(limited, np.minimum(amplitude, RANGE_SHARE * (upper - lower)), amplitude)
    w = 2 * np.pi * np.linspace(0.4, 1.0, robot.n)
    step = simulator.step_size
    phase = step * np.arange(round(SECONDS / step))[:, np.newaxis] * w
    y = (lower + upper) / 2 + amplitude * np.sin(phase)
    yd, ydd = amplitude * w * np.cos(phase), -amplitude * w**2 * np.sin(phase)
    taus, q, qd = np.empty((3, *y.shape))
    simulator.reset(y[0], yd[0])
    for k in range(len(y)):
        q[k], qd[k] = simulator.q, simulator.qd
        qdd = ydd[k] + BANDWIDTH**2 * (y[k] - q[k]) + 2 * BANDWIDTH * (yd[k] - qd[k])
        taus[k] = np.clip(
            inverse(q[k], qd[k], qdd, wrench), -robot.effort_limit, robot.effort_limit
        )
        simulator.step(taus[k], wrench)
    name = 'sine: the joints follow sines of 0.4 to 1 Hz'
    return Motion(name, SETTINGS, taus, np.zeros(taus.shape, bool), q, qd)


def read_motion(
    path: Path, robot_source: str | None = None
) -> tuple[pfd.Robot, pfd.Scene, Motion]:
    """Return the robot and the scene of a recording, and its motion.

    Parameters
    ----------
    path
        The file; a file that was cut off is read up to the cut.
    robot_source
        A robot to use in place of the recorded one, with the same joints, as `load_robot` takes
        it; base, tip and locked joints come from the settings of the recording.

    Raises
    ------
    ValueError
        If the file is not a recording, is damaged, or has no commands; if a wrench acts, the
        payload changes or the state is set; or if its robot has other joints than `robot_source`.
    OSError
        If it cannot be read.
    """
    log = Log(path)
    states: list[NDArray[Any]] = []
    brakes: list[NDArray[Any]] = []
    with damage_named(log.path):
        engine = Engine(log.settings, log.robot, ())
        scene, state = engine.plant.scene, engine.state

        def watched() -> Iterator[Input]:
            for each in recorded_inputs(log, engine):
                yield each
                # It was taken.
                jumps = state.jump is not None
                if jumps or engine.plant.scene != scene or state.wrench.any():
                    what = 'the state is set' if jumps else 'payload, scene or wrench change'
                    raise ValueError(f'{what} in cycle {each.cycle}: not one motion')

        fed = Fed(watched(), engine, lambda *_: None)
        while not fed.ended:
            before, step = state.rows[state.now].copy(), state.step
            fed.cycle()
            if state.step > step:
                before[2] = state.rows[state.now, 2]
                states.append(before)
                brakes.append(state.acting[BRAKE] > 0.0)
    if not states or np.all(brakes):
        raise LogError(
            f'{path} holds no torques: no command was accepted in its {len(states)} steps, and '
            'brakes hold every joint'
        )
    source = log.robot if robot_source is None else load_robot(log.settings, robot_source)
    if source.joint_names != log.robot.joint_names:
        raise ValueError(
            f'{path}: it has the joints {listed(log.robot.joint_names)}, but {cut(source.name)!r} '
            f'has {listed(source.joint_names)}'
        )
    q, qd, taus = np.array(states).transpose(1, 0, 2)
    name, settings = f'the recording {log.path.name}', simulator_settings(engine.state.settings)
    return source, scene, Motion(name, settings, taus, np.array(brakes), q, qd)
