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
from functools import partial
import math
from typing import Any

from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Recorder
from pfd_core.model.checked_numbers import Array

State = tuple[Any, ...]
Accelerations = Callable[[Any, Any], Any]


@dataclass(frozen=True)
class Integrator:
    """
    A method of integration.

    Attributes
    ----------
    step : callable
        step(f, h, *carried) returns the carried parts for the next step; with `implicit`,
        step(f, solve, D, h, *carried), see below.
    carried : tuple of str
        Parts of the state that a step takes and returns: q, qd, and qdd if it needs it.
    order : int
        Power of h with which the error of a motion falls.
    evaluations : int
        Evaluations of f, and solutions, in a step.
    implicit : float
        Part c of h for which the damping D acts implicitly, or 0. If it is not 0, f is without
        damping, and solve(q, y) = (H + c h D)^-1 y, which is the forward dynamics of a torque y at
        rest, without gravity, of a plant with an armature larger by c h D. Without damping in the
        scene, solve is None.

    """

    step: Callable[..., State]
    carried: tuple[str, ...]
    order: int
    evaluations: int
    implicit: float = 0.0


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


# Diagonal coefficient of the two implicit stages, and weight of the first explicit one.
IMEX_DIAGONAL = 1 - 1 / math.sqrt(2)
IMEX_FIRST = 1 - 1 / (2 * IMEX_DIAGONAL)


def imex2(f: Accelerations, solve: Any, damping: Any, h: float, q: Any, qd: Any) -> State:
    """
    Return q and qd after one step of ARS(2, 2, 2), with the damping D implicit.

    An implicit stage (H + c h D) v = H w is v = w - c h (H + c h D)^-1 D w; its part of the
    acceleration, -H^-1 D v, is then (v - w) / (c h). Positions take the implicit weights. L-stable
    in D: U. M. Ascher, S. J. Ruuth, R. J. Spiteri, Implicit-explicit Runge-Kutta methods for
    time-dependent partial differential equations, Applied Numerical Mathematics 25 (1997), 2.6.
    """
    c, d = IMEX_DIAGONAL, IMEX_FIRST
    a = f(q, qd)
    w1 = qd + (c * h) * a
    v1 = w1
    if solve is not None:
        x = solve(q + (c * h) * qd, damping * w1)
        v1 = w1 - (c * h) * x
    a1 = f(q + (c * h) * v1, v1)
    w2 = qd + h * (d * a + (1 - d) * a1)
    v2 = w2
    if solve is not None:
        w2 = w2 - ((1 - c) * h) * x
        y = solve(q + h * (d * qd + (1 - d) * v1), damping * w2)
        v2 = w2 - (c * h) * y
    return q + h * ((1 - c) * v1 + c * v2), v2


TABLE = {
    'rk4': Integrator(rk4, ('q', 'qd'), order=4, evaluations=4),
    'velocity_verlet': Integrator(velocity_verlet, ('q', 'qd', 'qdd'), order=2, evaluations=1),
    'imex2': Integrator(imex2, ('q', 'qd'), order=2, evaluations=4, implicit=IMEX_DIAGONAL),
}
# The integrator that 'auto' stands for: the more accurate per evaluation at the steps of an arm.
DEFAULT = 'rk4'
INTEGRATORS = ('auto', *TABLE)


def integrator_named(name: str) -> Integrator:
    """Return an integrator of TABLE, or the default for 'auto'; ValueError for another name."""
    if name not in INTEGRATORS:
        raise ValueError(f'integrator must be one of {INTEGRATORS}, got {name!r}')
    return TABLE[DEFAULT if name == 'auto' else name]


def record_step(integrator: Integrator, n: int, h: float, damping: Array | None = None) -> Program:
    """
    Return the program of one step on n lanes, for a scene with a damping (n,) or none.

    It calls the function `qdd`; where damping is implicit, `undamped` and `solve` instead.
    """
    recorder = Recorder(n)
    carried = [recorder.input(part, range(n)) for part in integrator.carried]
    qdd, undamped, solve = (partial(recorder.call, name) for name in ('qdd', 'undamped', 'solve'))
    if not integrator.implicit:
        end = integrator.step(qdd, h, *carried)
    elif damping is None:
        end = integrator.step(qdd, None, None, h, *carried)
    else:
        end = integrator.step(undamped, solve, recorder.constant(damping), h, *carried)
    for part, value in zip(integrator.carried, end, strict=True):
        recorder.output(part, (n,), [(value, lane) for lane in range(n)])
    return recorder.program()
