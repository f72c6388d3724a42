# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
One step of size h of qdd = f(q, qd), with the torque held.

    rk4               classical Runge-Kutta, order 4, 4 evaluations
    velocity_verlet   order 2, 1 evaluation

Each is text over one lane per joint. One that ends with an acceleration with which the next step
begins is given it, so that nothing is evaluated twice at one place; a simulation then adds one
evaluation per change of the torque.

The velocity Verlet step predicts the velocity for its evaluation, because the forces of an arm
depend on it: q' = q + h qd + h^2/2 a, a' = f(q', qd + h a), qd' = qd + h/2 (a + a').
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Recorder
from pfd_core.model.checked_numbers import real_number

State = tuple[Any, ...]
Accelerations = Callable[[Any, Any], Any]
Step = Callable[..., State]


def rk4(f: Accelerations, h: float, q: Any, qd: Any) -> State:
    """Return q and qd after one step of the classical Runge-Kutta method."""
    half, sixth = h / 2, h / 6
    a = f(q, qd)
    v2 = qd + half * a
    a2 = f(q + half * qd, v2)
    v3 = qd + half * a2
    a3 = f(q + half * v2, v3)
    v4 = qd + h * a3
    a4 = f(q + h * v3, v4)
    q_end = q + sixth * ((qd + v4) + 2.0 * (v2 + v3))
    qd_end = qd + sixth * ((a + a4) + 2.0 * (a2 + a3))
    return q_end, qd_end


def velocity_verlet(f: Accelerations, h: float, q: Any, qd: Any, a: Any) -> State:
    """Return q, qd and a' after one step of velocity Verlet with a predicted velocity."""
    q_end = q + h * (qd + (h / 2) * a)
    a_end = f(q_end, qd + h * a)
    return q_end, qd + (h / 2) * (a + a_end), a_end


STEPS: dict[str, Step] = {'rk4': rk4, 'velocity_verlet': velocity_verlet}
# What a step of each carries on to the next.
CARRIED = {'rk4': ('q', 'qd'), 'velocity_verlet': ('q', 'qd', 'qdd')}
# What integrator='auto' stands for: the more accurate per evaluation at the steps an arm takes.
DEFAULT = 'rk4'
INTEGRATORS = ('auto', *STEPS)


def positive_seconds(name: str, value: float) -> float:
    """Return a duration [s]; ValueError unless it is a number above zero."""
    seconds = real_number(name, value)
    if seconds <= 0:
        raise ValueError(f'{name} must be above zero seconds, got {seconds}')
    return seconds


def record_step(integrator: str, n: int, h: float) -> Program:
    """
    Return the program of one step on n lanes, which calls the function `qdd`.

    Raises
    ------
    ValueError
        If there is no integrator of that name.

    """
    if integrator not in INTEGRATORS:
        raise ValueError(f'integrator must be one of {INTEGRATORS}, got {integrator!r}')
    name = DEFAULT if integrator == 'auto' else integrator
    recorder = Recorder(n)
    carried = [recorder.input(part, range(n)) for part in CARRIED[name]]
    end = STEPS[name](lambda x, v: recorder.call('qdd', x, v), h, *carried)
    for part, value in zip(CARRIED[name], end, strict=True):
        recorder.output(part, (n,), [(value, lane) for lane in range(n)])
    return recorder.program()
