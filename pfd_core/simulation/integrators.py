# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Integrators: one step of size h of qdd = f(q, qd), with the torque held.

An integrator is a function, text over one lane per joint, and its row in TABLE: to add one, write
both. A simulation then offers it under its name, and the tests measure its order.

An integrator that carries the acceleration at the end of a step on to the next does not evaluate
f twice at one state; a simulation then adds one evaluation when the torque changes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Recorder

State = tuple[Any, ...]
Accelerations = Callable[[Any, Any], Any]


@dataclass(frozen=True)
class Integrator:
    """
    A method of integration.

    Attributes
    ----------
    step : callable
        step(f, h, *carried) returns the carried parts for the next step.
    carried : tuple of str
        Parts of the state that a step takes and returns: q, qd, and qdd if it needs it.
    order : int
        Power of h with which the error of a motion falls.
    evaluations : int
        Evaluations of f in a step.

    """

    step: Callable[..., State]
    carried: tuple[str, ...]
    order: int
    evaluations: int


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
    """
    Return q, qd and a' after one step of velocity Verlet.

    The forces of an arm depend on the velocity, so that it is predicted for the evaluation:
    q' = q + h qd + h^2/2 a, a' = f(q', qd + h a), qd' = qd + h/2 (a + a').
    """
    q_end = q + h * (qd + (h / 2) * a)
    a_end = f(q_end, qd + h * a)
    return q_end, qd + (h / 2) * (a + a_end), a_end


TABLE = {
    'rk4': Integrator(rk4, ('q', 'qd'), order=4, evaluations=4),
    'velocity_verlet': Integrator(velocity_verlet, ('q', 'qd', 'qdd'), order=2, evaluations=1),
}
# The integrator that 'auto' stands for: the more accurate per evaluation at the steps of an arm.
DEFAULT = 'rk4'
INTEGRATORS = ('auto', *TABLE)


def integrator_named(name: str) -> Integrator:
    """Return an integrator of TABLE, or the default for 'auto'; ValueError for another name."""
    if name not in INTEGRATORS:
        raise ValueError(f'integrator must be one of {INTEGRATORS}, got {name!r}')
    return TABLE[DEFAULT if name == 'auto' else name]


def record_step(integrator: Integrator, n: int, h: float) -> Program:
    """Return the program of one step on n lanes, which calls the function `qdd`."""
    recorder = Recorder(n)
    carried = [recorder.input(part, range(n)) for part in integrator.carried]
    end = integrator.step(lambda x, v: recorder.call('qdd', x, v), h, *carried)
    for part, value in zip(integrator.carried, end, strict=True):
        recorder.output(part, (n,), [(value, lane) for lane in range(n)])
    return recorder.program()
