# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Certified references of the hard cases, condition numbers, and errors relative to the references.

The reference is qdd in 50 digits by articulated bodies, in the axes of each link. It is certified
by PCRBM, which solves with an inertia matrix of sums in other frames, and by the torque that
Newton and Euler's equations miss, both in 50 digits.

    error      |x - qdd| / |qdd|, Euclidean; for an arm in equilibrium relative to |qdd| without
    torques
    kappa_j    condition number of D^-1/2 H D^-1/2, D the diagonal of H
    kappa_s    largest |change of qdd| / |qdd| when every number of the robot, scene and state
               changes by its 2^-40th part up or down, over 2^-40, in DIRECTIONS drawn signs

Rotations between the joints do not enter kappa_s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any
import warnings

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.programs import (
    record_forward_dynamics,
    record_inverse_dynamics,
    record_terms,
)
from pfd_core.machine.emulator import run
from pfd_core.model import Plant, with_inertia
from pfd_core.report.cases.problems import SEED, Problem
from pfd_core.report.cases.robots import Array

DIGITS = 50
DIRECTIONS = 12
STEP = 2.0**-40

States = dict[str, Array]


@dataclass(frozen=True)
class Reference:
    """
    The answer in 50 digits and its certificate.

    Attributes
    ----------
    qdd, scale : ndarray of mpmath.mpf
        (S, n), and the norm to which errors are relative, (S,).
    difference : float
        Largest error of the second evaluation, NaN without one.
    residual : float
        Largest missed torque, relative to the largest torque or bias, NaN without a certificate.

    """

    qdd: NDArray[Any]
    scale: NDArray[Any]
    difference: float
    residual: float


def reference(problem: Problem, certified: bool = True) -> Reference:
    """Return the answer of a problem, by default certified; ImportError without mpmath."""
    import mpmath

    # Differences of the emulator's numbers are rounded to the digits that are set here.
    with mpmath.workdps(DIGITS):
        return _reference(problem, certified)


def _reference(problem: Problem, certified: bool) -> Reference:
    plant, states = problem.plant, problem.states
    qdd = _exact(plant, states, 'articulated_body')
    scale = _norm(qdd)
    if problem.at_hold:
        scale = _norm(_exact(plant, states | {'tau': 0 * states['tau']}, 'articulated_body'))
    if not certified:
        return Reference(qdd, scale, np.nan, np.nan)
    difference = _norm(_exact(plant, states, 'pcrbm') - qdd) / scale
    torques = record_inverse_dynamics(plant, 'parallel')
    needed, bias = (
        run(torques, {'q': states['q'], 'qd': states['qd'], 'qdd': x}, digits=DIGITS)['tau']
        for x in (qdd, 0 * qdd)
    )
    largest = np.abs(states['tau']).max(axis=-1) + np.abs(bias).max(axis=-1)
    residual = np.abs(states['tau'] - needed).max(axis=-1) / largest
    return Reference(qdd, scale, float(difference.max()), float(residual.max()))


def _exact(plant: Plant, states: States, method: str) -> NDArray[Any]:
    program = record_forward_dynamics(plant, method, 'parallel')
    result: NDArray[Any] = run(program, states, digits=DIGITS)['qdd']
    return result


def _norm(values: NDArray[Any]) -> NDArray[Any]:
    squares: NDArray[Any] = (values * values).sum(axis=-1)
    return squares**0.5


def kappa_j(problem: Problem) -> float:
    """Return the largest condition number of H after Jacobi scaling, over the states."""
    program = record_terms(problem.plant, 'parallel')
    states = {name: problem.states[name] for name in ('q', 'qd')}
    H = run(program, states, digits=DIGITS)['H']
    scale = np.diagonal(H, axis1=-2, axis2=-1) ** 0.5
    scaled = (H / (scale[:, :, None] * scale[:, None, :])).astype(np.float64)
    return float(np.linalg.cond(scaled).max())


def kappa_s(problem: Problem, known: Reference) -> Array:
    """Return the structured condition number of each state, (S,)."""
    rng = np.random.default_rng(SEED)
    largest = np.zeros(len(known.qdd))
    for _ in range(DIRECTIONS):
        states = {name: _changed(rng, x) for name, x in problem.states.items()}
        change = _norm(
            _exact(_neighbour(rng, problem.plant), states, 'articulated_body') - known.qdd
        )
        largest = np.maximum(largest, (change / known.scale).astype(np.float64) / STEP)
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
    return plant if plant.inertia is None else with_inertia(plant, _changed(rng, plant.inertia))


def errors(found: NDArray[Any], known: Reference) -> Array:
    """Return the error of each state, (S,); infinity where the answer is not finite."""
    sound = np.isfinite(found).all(axis=-1)
    difference = np.where(sound[:, None], found, 0.0).astype(object) - known.qdd
    return np.where(sound, (_norm(difference) / known.scale).astype(np.float64), np.inf)
