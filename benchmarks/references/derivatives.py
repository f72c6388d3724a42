# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Derivatives of accelerations and linearised steps in 50 digits, and errors relative to them.

Five matrices of a state:

    q, qd, tau   d qdd / d q, d qdd / d qd, d qdd / d tau, (n, n) each
    A, B         derivatives of the state after a step of classical Runge-Kutta, by the state
                 before, (2n, 2n), and by the torque, (2n, n). Velocities are multiplied by the
                 step, so that both halves of a state are positions

The reference is the derivative of the recorded articulated bodies by the rules of each operation
(pfd_core.machine.derivative), multiplied stage by stage for a step. Norms are Frobenius norms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.problems import STATE
from benchmarks.cases.robots import Array
from benchmarks.references import accelerations
from benchmarks.references.accelerations import Reference, norm
from pfd_core.dynamics.methods import record_forward_dynamics
from pfd_core.machine.derivative import derivative
from pfd_core.machine.emulator import run
from pfd_core.model.plant import Plant

Matrices = dict[str, NDArray[Any]]
# d qdd / d (q, qd, tau), (S, n, 3n), and [A B] of a step, (S, 2n, 3n), if there is one.
Jacobians = tuple[NDArray[Any], NDArray[Any] | None]
Evaluation = Callable[[NDArray[Any], NDArray[Any], NDArray[Any]], tuple[Any, Any]]

DERIVATIVES, STEPS = ('q', 'qd', 'tau'), ('A', 'B')
# 50 digits are left where terms cancel; entries below ROUNDED of the largest are roundings.
DIGITS, ROUNDED = 75, '1e-50'
# No joint moves or accelerates by more than this in a step [rad or m].
MOVES = 2.0**-7


def step_length(known: Reference, states: Mapping[str, Array]) -> float:
    """Return the step [s], a power of two up to MOVES, in which no joint moves more than MOVES."""
    speed, acceleration = float(np.abs(states['qd']).max()), float(np.abs(known.qdd).max())
    by_speed = MOVES / speed if speed else math.inf
    by_acceleration = (MOVES / acceleration) ** 0.5 if acceleration else math.inf
    return float(2.0 ** np.floor(np.log2(min(MOVES, by_speed, by_acceleration))))


def jacobians(plant: Plant, states: Mapping[str, NDArray[Any]], h: float | None) -> Jacobians:
    """Return the derivatives of states, and [A B] of a step of h seconds, if any."""
    import mpmath

    forward = record_forward_dynamics(plant, 'articulated_body', 'sequential')
    program = derivative(forward, ['qdd'], STATE)
    others = {name: x for name, x in states.items() if name not in STATE}

    def evaluate(*state: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        given = others | dict(zip(STATE, state, strict=True))
        result = run(program, given, digits=DIGITS)
        J = np.concatenate([result[f'd qdd/d {x}'] for x in STATE], axis=-1)
        size = np.abs(J)
        least = mpmath.mpf(ROUNDED) * size.max(axis=(-2, -1), keepdims=True)
        return result['qdd'], np.where(size <= least, 0, J)

    with mpmath.workdps(DIGITS):
        number = np.vectorize(mpmath.mpf, otypes=[object])
        q, qd, tau = (number(states[key]) for key in STATE)
        _, J = evaluate(q, qd, tau)
        return J, None if h is None else linear_rk4(evaluate, q, qd, tau, mpmath.mpf(h))


def linear_rk4(
    evaluate: Evaluation, q: NDArray[Any], qd: NDArray[Any], tau: NDArray[Any], step: Any
) -> NDArray[Any]:
    """
    Return [A B], (..., 2n, 3n), of a step of classical Runge-Kutta, stage by stage.

    `evaluate` returns qdd, (..., n), and its derivatives by q, qd and tau, (..., n, 3n). The
    numbers may be of any type.
    """
    n = q.shape[-1]
    start = np.broadcast_to(np.eye(3 * n)[: 2 * n], (*q.shape[:-1], 2 * n, 3 * n))
    x, v, by_start = q, qd, start
    slopes = []
    for part in (0.5, 0.5, 1.0, 0.0):
        qdd, J = evaluate(x, v, tau)
        by_state = J[..., : 2 * n] @ by_start
        by_state[..., 2 * n :] += J[..., 2 * n :]
        slope = np.concatenate([by_start[..., n:, :], by_state], axis=-2)
        slopes.append(slope)
        x, v, by_start = q + part * step * v, qd + part * step * qdd, start + part * step * slope
    a, b, c, d = slopes
    result: NDArray[Any] = start + step / 6 * (a + 2 * b + 2 * c + d)
    return result


def named(found: Jacobians, h: float) -> Matrices:
    """Return the matrices by name; velocities of [A B] are multiplied by h, a power of two."""
    import mpmath

    J, AB = found
    matrices = dict(zip(DERIVATIVES, np.split(J, 3, axis=-1), strict=True))
    if AB is not None:
        n = J.shape[-2]
        AB = AB.copy()
        # mpmath numbers are rounded to the digits that are set.
        with mpmath.workdps(DIGITS):
            AB[..., n:, :] *= h
            AB[..., n : 2 * n] /= h
        matrices |= dict(zip(STEPS, np.split(AB, [2 * n], axis=-1), strict=True))
    return matrices


def errors(found: NDArray[Any], known: NDArray[Any]) -> Array:
    """
    Return |found - known| / |known| of each state, (S,); infinity where found is not finite.

    An error of a matrix that is zero is absolute.
    """
    import mpmath

    exact = known.reshape(len(known), -1)
    with mpmath.workdps(DIGITS):
        size = norm(exact)
    scale = np.where(size == 0, 1, size)
    return accelerations.errors(found.reshape(exact.shape), Reference(exact, scale))
