# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quantities other than forward dynamics in 50 digits, and matrices also in longdouble."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.programs import record_forward_dynamics
from pfd_core.algorithms.quantities import RECORDERS
from pfd_core.machine.derivative import derivative
from pfd_core.machine.emulator import run
from pfd_core.model import Plant, Robot, resolve
from pfd_core.report.cases.quantities import LINEAR_STEP, STATE, Evaluation, linear_rk4
from pfd_core.report.cases.robots import Array
from pfd_core.report.measure.reference import DIGITS, WIDE

States = Mapping[str, Array]


def exact(quantity: str, robot: Robot, states: States) -> NDArray[Any]:
    """Return a quantity of states in 50 digits, (S, size), as mpmath.mpf."""
    plant = resolve(robot)
    if quantity not in RECORDERS:
        return matrices(quantity, plant, states, DIGITS)
    program = RECORDERS[quantity](plant, None)
    (output,) = program.outputs
    found = run(program, states, digits=DIGITS)[output]
    return np.asarray(found.reshape(len(found), -1))


def matrices(quantity: str, plant: Plant, states: States, digits: int | None) -> NDArray[Any]:
    """Return d qdd / d(q, qd, tau), or [A B], (S, size), in longdouble or in digits."""
    import mpmath

    evaluate = differentiated(plant, digits)
    with mpmath.workdps(digits or mpmath.mp.dps):
        number, kind = (np.longdouble, WIDE) if digits is None else (mpmath.mpf, 'object')
        q, qd, tau = (np.vectorize(number, otypes=[kind])(states[key]) for key in STATE)
        if quantity == 'derivatives':
            found = evaluate(q, qd, tau)[1]
        else:
            found = linear_rk4(evaluate, q, qd, tau, number(LINEAR_STEP))
    return np.asarray(found.reshape(len(found), -1))


def differentiated(plant: Plant, digits: int | None, **others: NDArray[Any]) -> Evaluation:
    """Return a function from q, qd, tau to qdd, (S, n), and its derivatives, (S, n, 3n)."""
    forward = record_forward_dynamics(plant, 'articulated_body', 'sequential')
    program = derivative(forward, ['qdd'], STATE)

    def evaluate(*state: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        given = others | dict(zip(STATE, state, strict=True))
        result = run(program, given, WIDE if digits is None else 'float64', digits)
        return result['qdd'], np.concatenate([result[f'd qdd/d {x}'] for x in STATE], axis=-1)

    return evaluate
