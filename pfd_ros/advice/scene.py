# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The effects that a motion needs within a tolerance.

The full scene is taken for the truth. The motion is cut into short windows. At the start of each
window every scene begins at the state of the motion, and runs through the window under its
torques, without feedback: over long times a chaotic arm would turn any difference into one as
large as its motion. The error of a scene is its largest difference of a joint position from the
full scene, with the same integrator and step.

Errors of effects do not add, so the search simulates each candidate as a whole: it removes effects
one at a time, the one with the least error first, while the error stays within the tolerance. It
may miss a smaller scene in which the errors of effects cancel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
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
# An error up to this [rad or m] is rounding; no encoder resolves it.
ROUNDING = 1e-9
FULL, SMALLEST = 'full scene', 'smallest found'
# Of an effect without which the program is the same.
INERT = 'does not act in the full scene'


class Row(NamedTuple):
    """A scene compared with the full one.

    `error` is the largest difference of a joint position [rad or m], infinite if the simulation
    overflows or is impossible. `where` is its joint and time, or why the arm cannot be simulated,
    or INERT, or '' without an error.
    """

    error: float
    where: str


class Advice(NamedTuple):
    """The smallest scene found for a motion, and what it rests on.

    `rows` has the row of the full scene (FULL), of the full scene without an effect by the name of
    the effect, and of the smallest scene found (SMALLEST). `kept` are the effects in `scene`, and
    `unseen` those left out although the motion does not test them: it is the same without.
    """

    scene: pfd.Scene
    rows: Mapping[str, Row]
    kept: tuple[str, ...]
    unseen: tuple[str, ...]


def full_scene(
    robot: pfd.Robot, scene: pfd.Scene, settings: Mapping[str, Any]
) -> tuple[pfd.Scene, dict[str, str]]:
    """Add to a scene the effects that it lacks and the model of a robot states.

    `settings` are those of a Motion. Effects that cannot be simulated with them are not added, but
    returned by name with the reason.
    """
    refused = {}
    for effect in pfd.EFFECTS:
        stated = effect.from_model and len(effect.unstated(robot)) < robot.n
        if stated and getattr(scene, effect.field) == effect.off:
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
    """Find a small scene in which a motion of a robot stays close to the full scene.

    Parameters
    ----------
    scene
        The full scene.
    tolerance
        Largest error allowed [rad or m].
    window
        Seconds after which every scene starts again from the full one.
    progress
        Called now and then with the finished part, 0 to 1.

    Raises
    ------
    ValueError
        If tolerance or window is not above zero, or the full scene cannot be simulated.
    """
    for name, value in (('tolerance', tolerance), ('window', window)):
        if not isinstance(value, Real) or not 0 < value < math.inf:
            raise ValueError(f'{name} must be a number above zero, got {value!r}')
    whole = pfd.Simulator(robot, scene, **motion.settings)
    # The integrator that 'auto' selects in the full scene, so that all scenes have the same.
    settings = {**motion.settings, 'integrator': whole.integrator}
    length = max(1, round(window / whole.step_size))
    starts: dict[int, NDArray[Any] | None] = {}
    truth = _positions(whole, motion, length, starts)
    if not np.isfinite(truth).all():
        raise ValueError(
            f'{motion.name}: the simulation of the full scene overflows, so that no smaller scene '
            'can be compared with it'
        )
    rows = {scene: Row(0.0, '')}
    names = [effect.name for effect in pfd.EFFECTS if scene.without({effect.name}) != scene]

    def compared(smaller: pfd.Scene) -> Row:
        try:
            simulator = pfd.Simulator(robot, smaller, **settings)
        except ValueError as error:  # such as a massless link without the armature
            return Row(math.inf, str(error))
        # Native code with friction has brakes, too, which are an input.
        unbraked = motion.braked.any() and smaller.brakes != scene.brakes
        if simulator.code_digest == whole.code_digest and not unbraked:
            return Row(0.0, INERT)
        off = np.abs(_positions(simulator, motion, length, starts) - truth)
        off[np.isnan(off)] = math.inf
        k, joint = np.unravel_index(np.argmax(off), off.shape)
        where = f'{robot.joint_names[joint]}, {(k + 1) * simulator.step_size:.3f} s'
        return Row(float(off[k, joint]), where if off.any() else '')

    def row(smaller: pfd.Scene) -> Row:
        if smaller not in rows:
            rows[smaller] = compared(smaller)
            if progress is not None:
                # The search tries at most so many scenes.
                progress(min(1.0, len(rows) / (1 + len(names) * (len(names) + 1) // 2)))
        return rows[smaller]

    alone = {name: row(scene.without({name})) for name in names}
    small = scene
    while True:
        # In the order of the table: of effects whose errors are equal the first goes.
        smaller = [one for name in names if (one := small.without({name})) != small]
        errors = {one: row(one).error for one in smaller if row(one).error <= tolerance}
        if not errors:
            break
        small = min(errors, key=errors.__getitem__)
    kept = tuple(name for name in names if small.without({name}) != small)
    unseen = tuple(
        name
        for name, one in alone.items()
        if name not in kept and one.error <= ROUNDING and one.where != INERT
    )
    return Advice(small, {**alone, FULL: rows[scene], SMALLEST: rows[small]}, kept, unseen)


def _positions(
    simulator: pfd.Simulator,
    motion: Motion,
    length: int,
    starts: dict[int, NDArray[Any] | None],
) -> NDArray[Any]:
    """Return the positions (K, n) after the steps of a motion, in windows of `length` steps.

    A window starts from the state of the motion. `starts` has the torques of motors with a lag
    then, of each window; the first simulator, of the full scene, adds them.
    """
    q = np.empty_like(motion.taus)
    wrench = np.zeros(6) if simulator.scene.external_wrench else None
    lags = simulator.scene.motor_lag is not None
    # A rollout has the same brakes throughout.
    changes = 1 + np.flatnonzero((motion.braked[1:] != motion.braked[:-1]).any(axis=1))
    cuts = {*range(0, len(q), length), *changes.tolist(), len(q)}
    for first, end in pairwise(sorted(cuts)):
        if first % length == 0:
            state = motion.q[first], motion.qd[first]
            if first not in starts:
                # A simulation that is at this state continues with the torques of its motors.
                continues = lags and np.array_equal((simulator.q, simulator.qd), state)
                starts[first] = simulator.tau_motor if continues else None
            simulator.reset(*state, tau_motor=starts[first] if lags else None)
        brakes = motion.braked[first] if simulator.scene.brakes else None
        q[first:end] = simulator.rollout(motion.taus[first:end], wrench, brakes=brakes).q
    return q


def lines(advice: Advice) -> Iterator[str]:
    """Yield the table of effects as text, and the effects that the motion does not test."""
    yield f'{"without":20} {"error":>8}  kept  largest error at'
    for name, row in advice.rows.items():
        kept = 'yes' if name in advice.kept else '' if name in (FULL, SMALLEST) else 'no'
        yield f'{name:20} {row.error:8.1e}  {kept:4}  {row.where}'.rstrip()
    if advice.unseen:
        yield f'not tested: {", ".join(advice.unseen)}; the motion is the same without'
        yield 'test with a motion that needs them, or keep them'
