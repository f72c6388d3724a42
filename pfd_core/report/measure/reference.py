# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Certified references of the hard cases, condition numbers, and errors relative to the references.

The reference is qdd in 50 digits by articulated bodies, in the axes of each link, on decimal
numbers of ten digits more. Two certificates in 50 digits, on mpmath's binary numbers: PCRBM, which
solves with an inertia matrix summed in other frames, and the residual torque of the Newton-Euler
equations.

    error      |x - qdd| / |qdd|, Euclidean; for an arm in equilibrium relative to |qdd| without
    torques
    kappa_j    condition number of D^-1/2 H D^-1/2, D the diagonal of H
    kappa_s    largest |change of qdd| / |qdd| when every number of the robot, scene and state
               changes by its 2^-40th part up or down, over 2^-40, in DIRECTIONS drawn signs. Of
               an angle the part within half a turn changes: its sine is reduced exactly

Rotations between the joints do not change in kappa_s.

`wide_reference` is for thousands of states, in the processor's numbers of 64 bits or more.
"""

from __future__ import annotations

from collections.abc import Iterator
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
from pfd_core.report.measure.decimals import on_mpmath_numbers

DIGITS = 50
WIDE = 'longdouble'
DIRECTIONS = 12
STEP = 2.0**-40

States = dict[str, Array]


@dataclass(frozen=True)
class Reference:
    """
    The answer in 50 digits and its certificate.

    Attributes
    ----------
    qdd, scale : ndarray of mpmath.mpf or longdouble
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


def wide_reference(problem: Problem) -> Reference:
    """
    Return the answer in longdouble without a certificate, for thousands of states.

    Its error is at most 2^-11 of the error of the same algorithm in float64. Compare it with
    `reference` at a few states.
    """
    qdd = _wide(problem.plant, problem.states)
    return Reference(qdd, _norm(qdd), np.nan, np.nan)


def _reference(problem: Problem, certified: bool) -> Reference:
    plant, states = problem.plant, problem.states
    qdd = _exact(plant, states)
    scale = _norm(qdd)
    if problem.at_hold:
        scale = _norm(_exact(plant, states | {'tau': 0 * states['tau']}))
    if not certified:
        return Reference(qdd, scale, np.nan, np.nan)
    difference = _norm(_second(plant, states) - qdd) / scale
    torques = record_inverse_dynamics(plant, 'parallel')
    needed, bias = (
        run(torques, states | {'qdd': x}, digits=DIGITS)['tau'] for x in (qdd, 0 * qdd)
    )
    largest = np.abs(states['tau']).max(axis=-1) + np.abs(bias).max(axis=-1)
    residual = np.abs(states['tau'] - needed).max(axis=-1) / largest
    return Reference(qdd, scale, float(difference.max()), float(residual.max()))


def _exact(plant: Plant, states: States) -> NDArray[Any]:
    """Return qdd of states, (S, n), with the digits that mpmath is set to."""
    # Without refinement, which a sequential program of other methods would need.
    program = record_forward_dynamics(plant, 'articulated_body', 'sequential')
    result: NDArray[Any] = on_mpmath_numbers(program, 'qdd')(states)
    return result


def _second(plant: Plant, states: States) -> NDArray[Any]:
    """Return qdd in DIGITS by another algorithm, on other lanes and in binary numbers."""
    program = record_forward_dynamics(plant, 'pcrbm', 'parallel')
    result: NDArray[Any] = run(program, states, digits=DIGITS)['qdd']
    return result


def _wide(plant: Plant, states: States) -> NDArray[Any]:
    """Return qdd of states, (S, n), in longdouble."""
    # Parallel: the sequential programs group constants of the robot in float64.
    program = record_forward_dynamics(plant, 'articulated_body', 'parallel')
    result: NDArray[Any] = run(program, states, WIDE)['qdd']
    return result


def _norm(values: NDArray[Any]) -> NDArray[Any]:
    squares: NDArray[Any] = (values * values).sum(axis=-1)
    return squares**0.5


def kappa_j(problem: Problem, wide: bool = False) -> Array:
    """Return the condition number of H after Jacobi scaling, (S,); in longdouble if `wide`."""
    program = record_terms(problem.plant, 'parallel')
    states = {name: problem.states[name] for name in program.inputs}
    H = run(program, states, *((WIDE, None) if wide else ('float64', DIGITS)))['H']
    scale = np.diagonal(H, axis1=-2, axis2=-1) ** 0.5
    scaled = (H / (scale[:, :, None] * scale[:, None, :])).astype(np.float64)
    result: Array = np.linalg.cond(scaled)
    return result


def kappa_s(problem: Problem, known: Reference) -> Array:
    """Return the structured condition number of each state, (S,)."""
    import mpmath

    with mpmath.workdps(DIGITS):
        return _kappa_s(problem, known)


def _kappa_s(problem: Problem, known: Reference) -> Array:
    largest = np.zeros(len(known.qdd))
    wide = known.qdd.dtype == np.longdouble
    for plant, states in neighbours(problem, wide):
        qdd = (_wide if wide else _exact)(plant, states)
        change = (_norm(qdd - known.qdd) / known.scale).astype(np.float64)
        largest = np.maximum(largest, change / STEP)
    return largest


def neighbours(problem: Problem, wide: bool = False) -> Iterator[tuple[Plant, States]]:
    """
    Yield DIRECTIONS plants and states whose numbers all differ by their 2^-40th part.

    Positions are mpmath numbers, or longdouble if `wide`: they have more digits than the change,
    since an angle may have many turns.
    """
    import mpmath

    rng = np.random.default_rng(SEED)
    q = problem.states['q']
    q_exact = q.astype(np.longdouble) if wide else np.vectorize(mpmath.mpf, otypes=[object])(q)
    turns = np.array([kind != 'prismatic' for kind in problem.plant.robot.joint_types])
    within = q - 2 * np.pi * np.round(q / (2 * np.pi)) * turns
    for _ in range(DIRECTIONS):
        changed = problem.states | {'q': within}
        states = {name: _changed(rng, x) for name, x in changed.items()}
        states['q'] = q_exact + (states['q'] - within)
        yield _neighbour(rng, problem.plant), states


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
    answer = np.where(sound[:, None], found, 0.0)
    # mpmath reads no more than float64: a wider answer is the sum of two.
    upper = answer.astype(np.float64)
    lower = (answer - upper).astype(np.float64)
    numbers = known.qdd.dtype
    difference = (upper.astype(numbers) - known.qdd) + lower.astype(numbers)
    return np.where(sound, (_norm(difference) / known.scale).astype(np.float64), np.inf)
