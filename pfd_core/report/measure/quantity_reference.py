# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quantities other than forward dynamics in 50 digits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.acceleration_derivatives import record_acceleration_derivatives
from pfd_core.algorithms.programs import record_forward_dynamics
from pfd_core.algorithms.quantities import RECORDERS
from pfd_core.machine.emulator import run
from pfd_core.machine.program import Program
from pfd_core.model import Robot, resolve
from pfd_core.report.cases.quantities import LINEAR_STEP, STATE, linear_rk4
from pfd_core.report.cases.robots import Array
from pfd_core.report.measure.reference import DIGITS

States = Mapping[str, Array]


def exact(quantity: str, robot: Robot, states: States) -> NDArray[Any]:
    """Return a quantity of states in 50 digits, (S, size), as mpmath.mpf."""
    if quantity == 'linear_step':
        return _exact_linear_steps(robot, states)
    plant = resolve(robot)
    if quantity == 'derivatives':
        program = record_acceleration_derivatives(plant)
    else:
        program = RECORDERS[quantity](plant, None)
    (output,) = program.outputs
    return _run(program, output, states)


def _run(program: Program, output: str, states: States) -> NDArray[Any]:
    result = run(program, states, digits=DIGITS)[output]
    flat: NDArray[Any] = result.reshape(len(result), -1)
    return flat


def _exact_linear_steps(robot: Robot, states: States) -> NDArray[Any]:
    import mpmath

    plant, n = resolve(robot), robot.n
    accelerations = record_forward_dynamics(plant, 'articulated_body', 'parallel')
    derivatives = record_acceleration_derivatives(plant)

    def evaluate(q: NDArray[Any], qd: NDArray[Any], tau: NDArray[Any]) -> tuple[Any, Any]:
        state = {'q': q[None], 'qd': qd[None], 'tau': tau[None]}
        (qdd,) = _run(accelerations, 'qdd', state)
        (J,) = _run(derivatives, 'derivatives', state)
        return qdd, J.reshape(n, 3 * n)

    with mpmath.workdps(DIGITS):
        number = np.vectorize(mpmath.mpf, otypes=[object])
        step = mpmath.mpf(LINEAR_STEP)
        rows = zip(*(number(states[name]) for name in STATE), strict=True)
        return np.array([linear_rk4(evaluate, q, qd, tau, step).ravel() for q, qd, tau in rows])
