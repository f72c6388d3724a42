# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
How far a motion exercises each effect, and the errors that no scene avoids.

A motion that never reaches a stop says nothing about stops: the error of a scene without them is
zero, and so it would be for any stop farther away. The margin of an effect states how far the
motion came. What a smaller scene loses is to be compared with the errors that all scenes share, of
the integrator and of rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import math

import numpy as np

from pfd_core.kernels.compile import compile_kernel
from pfd_core.model import EFFECTS, Plant, resolve
from pfd_core.model.checked_numbers import Array
from pfd_core.model.effects import BRAKES, STEP
from pfd_core.report.measure.scene_errors import FullRun, distances, roll_windows, simulator_of

# The integrator's error is the difference from steps so many times as short: with order 2 all but
# a sixteenth of it.
FINER = 4
# Effects without a torque at an instant.
OVER_A_STEP = frozenset(effect.name for effect in EFFECTS if effect.acts in (STEP, BRAKES))
# Two methods with nothing in common but the model: their difference is rounding.
METHODS = ('composite_body', 'articulated_body')


@dataclass(frozen=True)
class Margin:
    """
    How far a motion exercises an effect.

    Attributes
    ----------
    kind : str
        'torque': largest torque of the effect over the largest commanded torque of the joint;
        'limit': largest commanded torque over the limit at its velocity; 'stop': least distance
        to a stop [rad or m]; 'rest': share of the time at which the joint is at rest; 'held':
        share of the time at which a brake holds it; or '' for an effect without a measure.
    value : float
        That number, of the joint where it is largest (least, for a distance).
    joint : str
        The joint.

    """

    kind: str = ''
    value: float = math.nan
    joint: str = ''


@dataclass(frozen=True)
class Floor:
    """
    An error that every scene has.

    Attributes
    ----------
    cause : str
        What the positions are compared with.
    largest : float
        Largest difference of a joint position in a window [rad or m], as in SceneRow.

    """

    cause: str
    largest: float


def margin_of(full: FullRun, name: str) -> Margin:
    """Return how far the full run exercises one effect of its scene."""
    plant = resolve(full.robot, full.scene)
    kind, measure = MEASURES.get(name, ('torque', None))
    if measure is None:
        if name in OVER_A_STEP:
            return Margin()
        values = _torque_share(full, name)
    else:
        values = measure(full, plant)
    best = int(np.argmin(values) if kind == 'stop' else np.argmax(values))
    return Margin(kind, float(values[best]), full.robot.joint_names[best])


def floors(full: FullRun) -> list[Floor]:
    """Return the errors of the integrator and of rounding, in the windows of the full run."""
    settings = full.motion.settings
    rounded = next(name for name in METHODS if name != full.starts[0].method)
    ways = {
        f'integrator: {settings["integrator"]} with steps {FINER} times as short': {
            'substeps': FINER * settings['substeps']
        },
        f'rounding: method {rounded} instead of {full.starts[0].method}': {'method': rounded},
        'rounding in float32': {'dtype': 'float32'},
    }
    found = []
    for cause, changed in ways.items():
        motion = replace(full.motion, settings={**settings, **changed})
        try:
            simulator = simulator_of(full.robot, full.scene, motion)
        except ValueError:  # such as a payload as input under a method that has none
            continue
        q = roll_windows(simulator, full)[0]
        found.append(Floor(cause, float(distances(q, full.q).max())))
    return found


def _torque_share(full: FullRun, name: str) -> Array:
    """Return the effect's largest torque over the largest commanded torque of each joint."""
    step = full.motion.settings['step_size']
    states = full.q[:-1], full.qd[:-1], np.diff(full.qd, axis=0) / step
    # A window starts from a new state, so that the difference of velocities there is no motion.
    inside = np.ones(len(states[0]), bool)
    inside[full.windows[1:, 0] - 1] = False
    if not inside.any():
        return np.zeros(full.robot.n)
    both = [
        compile_kernel(full.robot, scene=full.scene.without(names), quantity='inverse_dynamics')
        for names in (OVER_A_STEP, {*OVER_A_STEP, name})
    ]
    tau, other = (kernel(*(array[inside] for array in states)) for kernel in both)
    effect, commanded = np.abs(tau - other).max(axis=0), np.abs(full.motion.taus).max(axis=0)
    share: Array = np.where(effect > 0, math.inf, 0.0)
    np.divide(effect, commanded, out=share, where=commanded > 0)
    return share


def _distance_to_stops(full: FullRun, plant: Plant) -> Array:
    limits = plant.joint_limits
    assert limits is not None
    return np.asarray(np.minimum(full.q - limits[:, 0], limits[:, 1] - full.q).min(axis=0))


def _share_of_limits(full: FullRun, plant: Plant) -> Array:
    limits = plant.effort_limits
    assert limits is not None
    return np.asarray((np.abs(full.motion.taus) / limits).max(axis=0))


def _share_of_tables(full: FullRun, plant: Plant) -> Array:
    tables = plant.torque_speed
    assert tables is not None
    taus = full.motion.taus
    drives = full.qd * taus > 0
    shares = np.zeros(full.robot.n)
    for i, table in enumerate(tables):
        speeds, torques = table[np.isfinite(table[:, 0])].T if len(table) else ((), ())
        if len(speeds):
            bounds = np.interp(np.abs(full.qd[:, i]), speeds, torques)
            shares[i] = np.divide(
                np.abs(taus[:, i]), bounds, out=np.full(len(taus), math.inf), where=bounds > 0
            )[drives[:, i]].max(initial=0.0)
    return shares


def _time_at_rest(full: FullRun, plant: Plant) -> Array:
    return np.asarray(np.mean(full.qd == 0, axis=0))


def _time_held(full: FullRun, plant: Plant) -> Array:
    return np.asarray(np.mean(full.motion.held, axis=0))


Measure = Callable[[FullRun, Plant], Array]
# The effects that are not a torque at an instant; of all others the torque is measured.
MEASURES: dict[str, tuple[str, Measure]] = {
    'joint stops': ('stop', _distance_to_stops),
    'restitution': ('stop', _distance_to_stops),
    'effort limits': ('limit', _share_of_limits),
    'torque-speed tables': ('limit', _share_of_tables),
    'friction': ('rest', _time_at_rest),
    'static friction': ('rest', _time_at_rest),
    'Stribeck velocity': ('rest', _time_at_rest),
    'brakes': ('held', _time_held),
}
