# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The effects that a motion needs within a tolerance, and what each of them costs.

The full scene is taken for the truth. The motion is cut into short windows. At the start of each
window every scene begins at the state of the motion, and runs through the window under its
torques, without feedback: over long times a chaotic arm would turn any difference into one as
large as its motion. The error of a scene is its largest difference of a joint position from the
full scene, with the same integrator and step.

Errors of effects do not add, so the search simulates each candidate as a whole: it removes effects
one at a time, the one with the least error per operation saved first, while the error stays within
the tolerance. It may miss a smaller scene in which the errors of effects cancel.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise
import math
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pfd_core as pfd
from pfd_ros.advice.motions import Motion

# Length of a window [s].
WINDOW = 0.1
# Differences of positions [rad or m] are rounding up to this, and up to so many times the
# difference between two methods with nothing in common but the model.
ROUNDING, ROUNDINGS = 1e-12, 10
METHODS = ('composite_body', 'articulated_body')
# The integrator's error is the difference from steps so many times as short.
FINER = 4


class Row(NamedTuple):
    """An effect of the full scene, and the motion without it.

    `error` is the largest difference of a joint position from the full scene [rad or m], at a
    joint and a time [s]: infinite if the simulation overflows, or the arm cannot be simulated
    without the effect. `operations` are those that the effect adds to a step, as compiled, without
    events. `kept` is whether the smallest scene found has it. `note` says how near the motion
    comes to a limit that it does not reach, or why a simulation is impossible, or is ''.
    """

    name: str
    error: float
    joint: str
    time: float
    operations: int
    kept: bool
    note: str


@dataclass(frozen=True)
class Advice:
    """The smallest scene found for a motion, and what it rests on.

    Attributes
    ----------
    scene
        The smallest scene found.
    rows
        The effects of the full scene.
    unseen
        Effects that are left out although the motion does not test them: it is the same without.
    error
        Largest difference of a joint position in `scene` from the full scene [rad or m].
    operations
        Operations of a step in the full scene and in `scene`.
    floors
        Errors that every scene has: the same difference for the full scene by its cause,
        'integrator' (with steps a quarter as long) and 'rounding' (with another method).
    departure
        Largest difference of a position in the full scene, at the end of a window, from the
        motion's own [rad or m].
    windows
        Number of windows.
    """

    scene: pfd.Scene
    rows: tuple[Row, ...]
    unseen: tuple[str, ...]
    error: float
    operations: tuple[int, int]
    floors: Mapping[str, float]
    departure: float
    windows: int


def full_scene(
    robot: pfd.Robot, scene: pfd.Scene, settings: Mapping[str, Any]
) -> tuple[pfd.Scene, dict[str, str]]:
    """Add to a scene the effects that it lacks and the model of a robot states.

    `settings` are those of a Motion. Effects that cannot be simulated with them are not added, but
    returned by name with the reason.
    """
    refused = {}
    for effect in pfd.EFFECTS:
        if effect.from_model and getattr(scene, effect.field) == effect.fields[0].off:
            more: dict[str, Any] = {effect.field: 'model'}
            try:
                larger = replace(scene, **more)
                one, other = (pfd.Simulator(robot, each, **settings) for each in (scene, larger))
                if one.code_digest != other.code_digest:
                    scene = larger
            except ValueError as error:
                refused[effect.name] = str(error)
    return scene, refused


def advise(
    robot: pfd.Robot,
    scene: pfd.Scene,
    motion: Motion,
    tolerance: float,
    window: float = WINDOW,
    progress: Callable[[float], None] | None = None,
) -> Advice:
    """Find a small scene in which a motion stays close to the full scene.

    Parameters
    ----------
    robot
        The arm.
    scene
        The full scene.
    motion
        The torques, and states to start from.
    tolerance
        Largest difference allowed of a joint position from the full scene [rad or m].
    window
        Seconds after which every scene starts again from the full one.
    progress
        Called now and then with the finished part, 0 to 1.

    Raises
    ------
    ValueError
        If tolerance or window is not above zero, the robot has other joints than the motion, or
        the full scene cannot be simulated.
    """
    for name, value in (('tolerance', tolerance), ('window', window)):
        if not isinstance(value, Real) or not 0 < value < math.inf:
            raise ValueError(f'{name} must be a number above zero, got {value!r}')
    motion.check(robot)
    full = _run_full(robot, scene, motion, window)
    on = [effect.name for effect in pfd.EFFECTS if scene.without({effect.name}) != scene]
    trials: dict[pfd.Scene, _Trial] = {}

    def trial(candidate: pfd.Scene) -> _Trial:
        if candidate not in trials:
            trials[candidate] = _try(full, candidate)
            if progress is not None:
                # The search tries at most so many scenes.
                progress(min(1.0, len(trials) / (1 + len(on) * (len(on) + 1) // 2)))
        return trials[candidate]

    whole = trial(scene)
    smallest = _smallest_found(scene, on, trial, tolerance)
    small = trial(smallest)
    other = next(name for name in METHODS if name != full.starts[0].method)
    found = {
        'integrator': _try(full, scene, substeps=FINER * full.starts[0].substeps),
        'rounding': _try(full, scene, method=other),
    }
    floors = {cause: one.error for cause, one in found.items() if not one.refused}
    lost = max(ROUNDING, ROUNDINGS * floors.get('rounding', 0.0))
    rows, unseen = [], []
    for name in on:
        one, kept = trial(scene.without({name})), smallest.without({name}) != smallest
        note = one.refused
        if one.digest == whole.digest:
            note = 'does not act on this robot in the full scene'
        elif one.error <= lost:
            note = _nearness(full, name)
            unseen += [] if kept else [name]
        added = whole.operations - one.operations
        rows.append(Row(name, one.error, one.joint, one.time, added, kept, note))
    return Advice(
        smallest,
        tuple(rows),
        tuple(unseen),
        small.error,
        (whole.operations, small.operations),
        floors,
        full.departure,
        len(full.windows),
    )


class _Trial(NamedTuple):
    """A scene: its cost, its error, the digest of its code, or why it cannot be simulated."""

    operations: int
    error: float
    joint: str
    time: float
    digest: str
    refused: str


def _smallest_found(
    scene: pfd.Scene,
    on: Sequence[str],
    trial: Callable[[pfd.Scene], _Trial],
    tolerance: float,
) -> pfd.Scene:
    """Remove effects greedily while the error stays within the tolerance."""

    def fits(smaller: pfd.Scene) -> bool:
        found = trial(smaller)
        return found.error <= tolerance and found.operations <= trial(scene).operations

    def price(smaller: pfd.Scene) -> tuple[float, float]:
        found = trial(smaller)
        saved = trial(scene).operations - found.operations
        return (found.error / saved if saved else math.inf), found.error

    while True:
        candidates = [scene.without({name}) for name in on]
        fitting = [smaller for smaller in candidates if smaller != scene and fits(smaller)]
        if not fitting:
            return scene
        scene = min(fitting, key=price)


class _Full(NamedTuple):
    """The motion in the full scene: its simulation at the start of each window, and q (K, n)."""

    robot: pfd.Robot
    scene: pfd.Scene
    motion: Motion
    settings: Mapping[str, Any]
    windows: list[tuple[int, int]]
    starts: list[pfd.Simulator]
    q: NDArray[Any]
    departure: float


def _run_full(robot: pfd.Robot, scene: pfd.Scene, motion: Motion, seconds: float) -> _Full:
    simulator = pfd.Simulator(robot, scene, **motion.settings)
    # The integrator that 'auto' selects in the full scene, so that all scenes have the same.
    settings = {**motion.settings, 'integrator': simulator.integrator}
    steps, length = len(motion.taus), max(1, round(seconds / simulator.step_size))
    windows = [(first, min(first + length, steps)) for first in range(0, steps, length)]
    starts, q, departure = [], np.empty_like(motion.taus), 0.0
    for first, end in windows:
        state = motion.q[first], motion.qd[first]
        departure = max(departure, float(np.abs(simulator.q - state[0]).max()) if first else 0.0)
        # A simulation that is at this state goes on with the rest of its state, too.
        if not np.array_equal((simulator.q, simulator.qd), state):
            simulator.reset(*state)
        starts.append(copy(simulator))
        q[first:end] = _roll(simulator, motion, first, end)
        if simulator.status != 'ok':
            raise ValueError(
                f'{motion.name}: the simulation of the full scene overflows by step {end}, so '
                'that no smaller scene can be compared with it'
            )
    return _Full(robot, scene, motion, settings, windows, starts, q, departure)


def _roll(simulator: pfd.Simulator, motion: Motion, first: int, end: int) -> NDArray[Any]:
    """Return the positions after steps [first, end) of a motion, from the simulator's state."""
    wrench = np.zeros(6) if simulator.scene.external_wrench else None
    if not simulator.scene.brakes:
        return simulator.rollout(motion.taus[first:end], wrench).q
    # A rollout has the same brakes throughout.
    braked = motion.braked[first:end]
    changes = first + 1 + np.flatnonzero((braked[1:] != braked[:-1]).any(axis=1))
    runs = [
        simulator.rollout(motion.taus[a:b], wrench, brakes=motion.braked[a]).q
        for a, b in pairwise([first, *changes.tolist(), end])
    ]
    return np.concatenate(runs)


def _try(full: _Full, scene: pfd.Scene, **changed: Any) -> _Trial:
    """Simulate the windows of the full run in a scene, perhaps with changed settings."""
    try:
        simulator = pfd.Simulator(full.robot, scene, **{**full.settings, **changed})
    except ValueError as error:  # such as a massless link without the armature that moved it
        return _Trial(full.starts[0].operations, math.inf, '', math.nan, '', str(error))
    off = np.empty_like(full.q)
    for (first, end), start in zip(full.windows, full.starts, strict=True):
        simulator.take_state(start)
        q = _roll(simulator, full.motion, first, end)
        off[first:end] = np.abs(q - full.q[first:end])
    off[~np.isfinite(off)] = math.inf
    step, joint = np.unravel_index(np.argmax(off), off.shape)
    largest = float(off[step, joint])
    name = full.robot.joint_names[joint] if largest else ''
    time = float((step + 1) * simulator.step_size) if largest else math.nan
    return _Trial(simulator.operations, largest, name, time, simulator.code_digest, '')


def _nearness(full: _Full, name: str) -> str:
    """Return how near the motion comes to the stops or to the effort limits; or ''."""
    robot, scene = full.robot, full.scene
    if name == 'joint stops':
        stops = np.stack([robot.position_lower, robot.position_upper], axis=1)
        stops = stops if scene.joint_limits == 'model' else np.asarray(scene.joint_limits)
        distance = np.minimum(full.q - stops[:, 0], stops[:, 1] - full.q).min(axis=0)
        k = int(np.argmin(distance))
        return f'{robot.joint_names[k]} comes within {distance[k]:.2g} of a stop'
    # Gravity compensation and a lag change the torques that the limits act on.
    if name == 'effort limits' and not scene.gravity_compensation and scene.motor_lag is None:
        model = scene.effort_limits == 'model'
        limits = robot.effort_limit if model else np.asarray(scene.effort_limits)
        share = np.abs(full.motion.taus).max(axis=0) / limits
        k = int(np.argmax(share))
        return f'{robot.joint_names[k]} comes to {100 * share[k]:.3g} % of its limit'
    return ''
