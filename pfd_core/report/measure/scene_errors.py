# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors of a trajectory in a smaller scene, against the same torques in the full one.

The trajectory is cut into short windows. At the start of each, every scene begins at the state of
the full one (of the recording, where that has a state), and runs through the window under the
recorded torques, without feedback. An error is the difference of the joint positions: over long
times a chaotic arm would make any difference as large as the arm's motion. Both sides have the
same integrator and step, whose error is excluded.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise
import math

import numpy as np

from pfd_core.model import Robot, Scene
from pfd_core.model.checked_numbers import Array
from pfd_core.report.cases.excitations import DrivenMotion
from pfd_core.report.measure.scene_effects import effects_on, spelled
from pfd_core.simulation.simulator import Simulator


@dataclass(frozen=True)
class SceneRow:
    """
    A scene, its cost and its errors.

    Attributes
    ----------
    effects : tuple of str
        The effects that are on.
    scene : str
        The call that makes it.
    operations : int
        Operations of one step of the integrator, as compiled (Simulator.operations). For a scene
        that cannot be simulated: of the full scene.
    largest, rms : float
        Largest and root mean square difference of a joint position from the full scene's, over
        all joints and steps [rad or m]; infinite where the simulation overflows.
    joint, time : str, float
        Joint and time [s] of the largest difference.
    refused : str
        The reason why the scene cannot be simulated, or ''.

    """

    effects: tuple[str, ...]
    scene: str
    operations: int
    largest: float
    rms: float
    joint: str = ''
    time: float = 0.0
    refused: str = ''


@dataclass(frozen=True, eq=False)
class FullRun:
    """
    The trajectory in the full scene.

    Attributes
    ----------
    robot, scene, motion : Robot, Scene, DrivenMotion
        The arm, its full scene and the torques.
    windows : ndarray of int
        (W, 2), first step of each window and of the next.
    starts : list of Simulator
        The simulation at the start of each window, with all of its state.
    q, qd : ndarray
        (K, n), positions and velocities after each step.
    departure : float
        Largest difference of a position at the end of a window from the next state of the
        motion [rad or m].

    """

    robot: Robot
    scene: Scene
    motion: DrivenMotion
    windows: Array
    starts: list[Simulator]
    q: Array
    qd: Array
    departure: float


def cut(motion: DrivenMotion, seconds: float) -> Array:
    """
    Return windows of at most so many seconds, (W, 2): the first step of each and of the next.

    A window ends with the motion, or at its last state in reach, from which the next starts.
    """
    most = max(1, round(seconds / motion.settings['step_size']))
    bounds = [0]
    while bounds[-1] < len(motion.taus):
        end = min(bounds[-1] + most, len(motion.taus))
        last_known = int(motion.after[np.searchsorted(motion.after, end, 'right') - 1])
        reaches = end < len(motion.taus) and last_known > bounds[-1]
        bounds.append(last_known if reaches else end)
    return np.array(list(pairwise(bounds)))


def simulator_of(robot: Robot, scene: Scene, motion: DrivenMotion) -> Simulator:
    """Return the simulator of a scene with the settings of a motion."""
    return Simulator(robot, scene, **motion.settings)


def run_full(robot: Robot, scene: Scene, motion: DrivenMotion, seconds: float) -> FullRun:
    """
    Simulate a motion in the full scene, from a state of the motion at each window that has one.

    Raises
    ------
    ValueError
        If the simulation overflows, or the robot cannot be simulated in the scene.

    """
    simulator = simulator_of(robot, scene, motion)
    # The name that 'auto' selects in the full scene, so that all scenes have the same.
    motion = replace(motion, settings={**motion.settings, 'integrator': simulator.integrator})
    windows = cut(motion, seconds)
    starts = []
    q, qd = np.empty_like(motion.taus), np.empty_like(motion.taus)
    departure = 0.0
    for k, (first, end) in enumerate(windows):
        found = int(np.searchsorted(motion.after, first))
        if found < len(motion.after) and motion.after[found] == first:
            known = motion.q[found], motion.qd[found]
            departure = max(departure, float(np.abs(simulator.q - known[0]).max()) if k else 0.0)
            # An existing simulation continues with its complete state.
            if not np.array_equal((simulator.q, simulator.qd), known):
                simulator.reset(*known)
        starts.append(copy(simulator))
        q[first:end], qd[first:end] = roll(simulator, motion, first, end)
        if simulator.status != 'ok':
            raise ValueError(
                f'{motion.name} in {spelled(scene)} overflows by step {end}: without a finite '
                'full scene there is nothing to compare a smaller one with'
            )
    return FullRun(robot, scene, motion, windows, starts, q, qd, departure)


def roll(simulator: Simulator, motion: DrivenMotion, first: int, end: int) -> tuple[Array, Array]:
    """Return q and qd after steps [first, end) of a motion, from the simulator's state."""
    wrench = np.zeros(6) if simulator.scene.external_wrench else None
    if not simulator.scene.brakes:
        run = simulator.rollout(motion.taus[first:end], wrench)
        return run.q, run.qd
    # A rollout has the same brakes throughout.
    held = motion.held[first:end]
    changes = first + 1 + np.flatnonzero((held[1:] != held[:-1]).any(axis=1))
    bounds = [first, *changes.tolist(), end]
    runs = [
        simulator.rollout(motion.taus[a:b], wrench, brakes=motion.held[a])
        for a, b in pairwise(bounds)
    ]
    return np.concatenate([run.q for run in runs]), np.concatenate([run.qd for run in runs])


def roll_windows(simulator: Simulator, full: FullRun) -> tuple[Array, Array]:
    """Return q and qd after all steps, each window from the start of the full run's."""
    q, qd = np.empty_like(full.q), np.empty_like(full.q)
    for (first, end), start in zip(full.windows, full.starts, strict=True):
        simulator.take_state(start)
        q[first:end], qd[first:end] = roll(simulator, full.motion, first, end)
    return q, qd


def distances(q: Array, reference: Array) -> Array:
    """Return the differences of positions; infinite where one is not finite."""
    off: Array = np.abs(q - reference)
    off[~np.isfinite(off)] = math.inf
    return off


def measure(full: FullRun, scene: Scene) -> SceneRow:
    """Return the cost of a scene and its errors over all windows of the full run."""
    effects, text = effects_on(full.robot, scene), spelled(scene)
    try:
        simulator = simulator_of(full.robot, scene, full.motion)
    except ValueError as error:  # such as a massless link without the armature that moved it
        count = full.starts[0].operations
        return SceneRow(effects, text, count, math.inf, math.inf, refused=str(error))
    off = distances(roll_windows(simulator, full)[0], full.q)
    step, joint = np.unravel_index(np.argmax(off), off.shape)
    return SceneRow(
        effects,
        text,
        simulator.operations,
        float(off[step, joint]),
        _root_mean_square(off),
        full.robot.joint_names[joint],
        float((step + 1) * simulator.step_size),
    )


def _root_mean_square(values: Array) -> float:
    largest = float(values.max())
    if not 0 < largest < math.inf:
        return largest
    # Scaled, so that no square overflows or is lost.
    return largest * float(np.sqrt(np.mean((values / largest) ** 2)))
