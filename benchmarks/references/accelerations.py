# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Accelerations in 50 digits, errors relative to them, condition numbers, and the bound of an error.

The reference is qdd by articulated bodies in the axes of each link. With `wide` it is computed in
the processor's numbers of 64 bits or more, for thousands of states.

    error      |x - qdd| / |qdd|, Euclidean; for an arm in equilibrium relative to |qdd| without
               torques
    kappa_j    condition number of D^-1/2 H D^-1/2, D the diagonal of H
    kappa_s    largest |change of qdd| / |qdd| when every number of the robot, scene and state
               changes by its 2^-40th part up or down, over 2^-40, in DIRECTIONS drawn signs. Of
               an angle the part within half a turn changes: its sine is reduced exactly.
               Rotations between the joints do not change

The bound of an error is FACTOR times the error that analysis predicts (predicted). No number in
the formula was chosen on a measured error. In units of rounding u:

    1                the last sum of the answer is rounded
    SPREAD kappa_s   each number enters ROUNDINGS operations of the Newton-Euler residual. A
                     rounding acts as a relative change of that number, with root mean square
                     RMS u; independent ones add up as the root of their number (Higham and Mary
                     2019)
    SPREAD kappa_J   without refinement also the roundings of H and of its factor (Demmel 1989;
                     Higham, Accuracy and Stability, theorem 10.6)

With refinement the error of the factor is multiplied by the error of the first answer, which the
kernel estimates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Any
import warnings

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.problems import ROUNDING, SEED, Problem
from benchmarks.cases.robots import Array
from pfd_core.dynamics.methods import record_forward_dynamics
from pfd_core.machine.emulator import run
from pfd_core.model.plant import Plant
from pfd_core.paper.composite import record_terms

DIGITS = 50
WIDE = 'longdouble'
DIRECTIONS = 12
STEP = 2.0**-40

FACTOR = 5.0
# Luh, Walker and Paul 1980: 150 n multiplications and 131 n additions; a link and its joint have
# mass, centre, inertia, offset of the next joint, position, velocity and torque.
NUMBERS = 1 + 3 + 6 + 3 + 3
ROUNDINGS = (150 + 131) / NUMBERS
# A rounding is uniform within half of the last place, the digits before it are distributed as
# in Benford's law: the mean of 1 / m^2 over 1 <= m < 2 is 3 / (8 ln 2).
RMS = math.sqrt(3 / (8 * math.log(2)) / 3)
SPREAD = RMS * math.sqrt(ROUNDINGS)

States = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Reference:
    """The answer qdd, (S, n) of mpmath.mpf or longdouble, and the scale of errors, (S,)."""

    qdd: NDArray[Any]
    scale: NDArray[Any]


def reference(problem: Problem, wide: bool = False) -> Reference:
    """Return the answer of a problem; ImportError without mpmath."""
    plant, states = problem.plant, problem.states
    qdd = scale = _qdd(plant, states, wide)
    if problem.at_hold:
        scale = _qdd(plant, states | {'tau': 0 * states['tau']}, wide)
    with _digits():
        return Reference(qdd, norm(scale))


def _digits() -> Any:
    """Return a context in which differences of mpmath numbers have DIGITS digits."""
    import mpmath

    return mpmath.workdps(DIGITS)


def _qdd(plant: Plant, states: States, wide: bool = False) -> NDArray[Any]:
    # Not by groups of parameters, which are rounded to float64.
    schedule = 'parallel' if wide else 'sequential'
    program = record_forward_dynamics(plant, 'articulated_body', schedule)
    result: NDArray[Any] = run(program, states, *((WIDE,) if wide else ('float64', DIGITS)))['qdd']
    return result


def norm(values: NDArray[Any]) -> NDArray[Any]:
    """Return the Euclidean norm along the last axis."""
    squares: NDArray[Any] = (values * values).sum(axis=-1)
    return squares**0.5


def errors(found: NDArray[Any], known: Reference) -> Array:
    """Return the error of each state, (S,); infinity where the answer is not finite."""
    sound = np.isfinite(found).all(axis=-1)
    answer = np.where(sound[:, None], found, 0.0)
    # mpmath reads no more than float64: a wider answer is the sum of two.
    upper = answer.astype(np.float64)
    lower = (answer - upper).astype(np.float64)
    numbers = known.qdd.dtype
    with _digits():
        difference = (upper.astype(numbers) - known.qdd) + lower.astype(numbers)
        return np.where(sound, (norm(difference) / known.scale).astype(np.float64), np.inf)


def kappa_j(problem: Problem) -> Array:
    """Return the condition number of H after Jacobi scaling, (S,)."""
    program = record_terms(problem.plant, 'parallel')
    states = {name: problem.states[name] for name in program.inputs}
    H = run(program, states, digits=DIGITS)['H']
    with _digits():
        scale = np.diagonal(H, axis1=-2, axis2=-1) ** 0.5
        scaled = (H / (scale[:, :, None] * scale[:, None, :])).astype(np.float64)
    result: Array = np.linalg.cond(scaled)
    return result


def kappa_s(problem: Problem, known: Reference) -> Array:
    """Return the structured condition number of each state, (S,)."""
    import mpmath

    rng = np.random.default_rng(SEED)
    largest, q = np.zeros(len(known.qdd)), problem.states['q']
    # Positions are mpmath numbers: an angle of many turns has more digits than the change leaves.
    exact_q = np.vectorize(mpmath.mpf, otypes=[object])(q)
    turns = np.array([kind != 'prismatic' for kind in problem.plant.robot.joint_types])
    within = q - 2 * np.pi * np.round(q / (2 * np.pi)) * turns
    for _ in range(DIRECTIONS):
        states = {name: _changed(rng, x) for name, x in (problem.states | {'q': within}).items()}
        with _digits():
            states['q'] = exact_q + (states['q'] - within)
        qdd = _qdd(_neighbour(rng, problem.plant), states)
        with _digits():
            change = (norm(qdd - known.qdd) / known.scale).astype(np.float64)
        largest = np.maximum(largest, change / STEP)
    return largest


def _changed(rng: np.random.Generator, values: Array) -> Array:
    result: Array = values * (1 + STEP * rng.choice([-1.0, 1.0], values.shape))
    return result


def _neighbour(rng: np.random.Generator, plant: Plant) -> Plant:
    """Return a plant whose numbers differ by their 2^-40th part; inertias stay symmetric."""
    robot = plant.robot
    names = ('masses', 'centers', 'translations')
    numbers: dict[str, Any] = {name: _changed(rng, getattr(robot, name)) for name in names}
    half = np.triu(_changed(rng, robot.inertias))
    numbers['inertias'] = half + np.triu(half, 1).transpose(0, 2, 1)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        robot = replace(robot, **numbers)
    gravity = _changed(rng, plant.gravity)
    plant = replace(plant, robot=robot, gravity=gravity)
    if plant.inertia is None:
        return plant
    return replace(plant, effects={**plant.effects, 'armature': _changed(rng, plant.inertia)})


def predicted(dtype: str, kappa_s: Array, kappa_j: Array, first: Array | None = None) -> Array:
    """Return the predicted error of each state, (S,); `first`: of a refined kernel's answer."""
    u = ROUNDING[dtype]
    factor = SPREAD * kappa_j * u
    rest = factor if first is None else np.minimum(factor, first) * first
    result: Array = u * (1 + SPREAD * kappa_s) + rest
    return result
