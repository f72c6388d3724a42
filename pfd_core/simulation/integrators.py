# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Integrators: one step of size h of qdd = f(q, qd, t), with constant commanded torque.

These functions serve linearised steps alone: a simulation takes steps by the coefficients in
pfd_core.simulation.tableaux. They see the arm as a System, so they do not depend on where torques
come from.

An integrator that carries the acceleration at the end of a step on to the next does not evaluate
f twice at one state; a simulation then adds one evaluation when the torque changes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
import operator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.dynamics.numbers import PARAMETERS
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Recorder
from pfd_core.model.values import Array
from pfd_core.simulation.rows import LaggedTorque
from pfd_core.simulation.tableaux import IMEX_DIAGONAL, IMEX_FIRST

State = tuple[Any, ...]


@dataclass(frozen=True)
class System:
    """
    An arm for the length of a step, as its integrator sees it.

    Attributes
    ----------
    accelerations : callable
        f(q, qd, at), with the torque after the part `at` of the step: 0 its beginning, 1 its end.
    advance : callable
        advance(q, dq) returns q + dq, the position at the end of the step; for one call.
    solve : callable or None
        For an implicit integrator in a scene with damping: solve(q, y) = (H + c h D)^-1 y, which
        is the forward dynamics of a torque y at rest, without gravity, of a plant with an
        armature larger by c h D. `accelerations` are then without damping.
    damping : row or None
        D, with `solve`.

    """

    accelerations: Callable[[Any, Any, float], Any]
    advance: Callable[[Any, Any], Any] = operator.add
    solve: Callable[[Any, Any], Any] | None = None
    damping: Any = None


@dataclass(frozen=True)
class Integrator:
    """
    A method of integration.

    Attributes
    ----------
    step : callable
        step(system, h, *carried) returns the carried parts for the next step.
    carried : tuple of str
        Parts of the state that a step takes and returns: q, qd, and qdd if it needs it.
    order : int
        Power of h with which the error of a motion falls.
    evaluations : int
        Evaluations of f in a step.
    solutions : int
        Solutions with the damping in a step, in a scene that has any.
    implicit : float
        Part c of h for which the damping D acts implicitly, see System; 0 if it does not.

    """

    step: Callable[..., State]
    carried: tuple[str, ...]
    order: int
    evaluations: int
    solutions: int = 0
    implicit: float = 0.0


def rk4(system: System, h: float, q: Any, qd: Any) -> State:
    """Return q and qd after one step of the classical Runge-Kutta method."""
    f, half, sixth = system.accelerations, h / 2, h / 6
    a = f(q, qd, 0)
    v2 = qd + half * a
    a2 = f(q + half * qd, v2, 0.5)
    v3 = qd + half * a2
    a3 = f(q + half * v2, v3, 0.5)
    v4 = qd + h * a3
    a4 = f(q + h * v3, v4, 1)
    q_end = system.advance(q, sixth * ((qd + v4) + 2.0 * (v2 + v3)))
    qd_end = qd + sixth * ((a + a4) + 2.0 * (a2 + a3))
    return q_end, qd_end


def velocity_verlet(system: System, h: float, q: Any, qd: Any, a: Any) -> State:
    """
    Return q, qd and a' after one step of velocity Verlet.

    The forces of an arm depend on the velocity, so that it is predicted for the evaluation:
    q' = q + h qd + h^2/2 a, a' = f(q', qd + h a), qd' = qd + h/2 (a + a').
    """
    q_end = system.advance(q, h * (qd + (h / 2) * a))
    a_end = system.accelerations(q_end, qd + h * a, 1)
    return q_end, qd + (h / 2) * (a + a_end), a_end


def imex2(system: System, h: float, q: Any, qd: Any) -> State:
    """
    Return q and qd after one step of ARS(2, 2, 2), with the damping D implicit.

    An implicit stage (H + c h D) v = H w is v = w - c h (H + c h D)^-1 D w; its part of the
    acceleration, -H^-1 D v, is then (v - w) / (c h). Positions take the implicit weights. L-stable
    in D: U. M. Ascher, S. J. Ruuth, R. J. Spiteri, Implicit-explicit Runge-Kutta methods for
    time-dependent partial differential equations, Applied Numerical Mathematics 25 (1997), 2.6.
    """
    f, solve, damping = system.accelerations, system.solve, system.damping
    c, d = IMEX_DIAGONAL, IMEX_FIRST
    a = f(q, qd, 0)
    w1 = qd + (c * h) * a
    v1 = w1
    if solve is not None:
        x = solve(q + (c * h) * qd, damping * w1)
        v1 = w1 - (c * h) * x
    a1 = f(q + (c * h) * v1, v1, c)
    w2 = qd + h * (d * a + (1 - d) * a1)
    v2 = w2
    if solve is not None:
        w2 = w2 - ((1 - c) * h) * x
        y = solve(q + h * (d * qd + (1 - d) * v1), damping * w2)
        v2 = w2 - (c * h) * y
    return system.advance(q, h * ((1 - c) * v1 + c * v2)), v2


TABLE = {
    'rk4': Integrator(rk4, ('q', 'qd'), order=4, evaluations=4),
    'velocity_verlet': Integrator(velocity_verlet, ('q', 'qd', 'qdd'), order=2, evaluations=1),
    'imex2': Integrator(
        imex2, ('q', 'qd'), order=2, evaluations=2, solutions=2, implicit=IMEX_DIAGONAL
    ),
}


def record_step(
    integrator: Integrator,
    n: int,
    h: float,
    damping: Array | None = None,
    *,
    motor_lag: Array | None = None,
    carries: bool = True,
    places: NDArray[np.int64] | None = None,
) -> Program:
    """
    Return the program of one step on n lanes, for a scene with a damping (n,) or none.

    It calls the function `qdd`; where damping is implicit, `undamped` and `solve` instead. Rows
    are added for positions with `compensated` sums, for motors with a lag (n,) [s], and for steps
    that are cut at `events`, which may be too many. Damping that varies has `places` in the input
    of parameters (pfd_core.dynamics.numbers). A step that does not carry the acceleration
    evaluates it at its beginning, as steps with events do: other joints may be held then.
    """
    recorder = Recorder(n)
    rows = [part for part in integrator.carried if carries or part != 'qdd']
    carried = {part: recorder.input(part, range(n)) for part in rows}
    torque = None if motor_lag is None else LaggedTorque(recorder, motor_lag, h)
    solved = None
    if integrator.implicit and damping is not None:
        solved = recorder.constant(damping)
        if places is not None:
            solved = recorder.input(PARAMETERS, places.tolist())
    function = 'qdd' if solved is None else 'undamped'

    def accelerations(q: Any, qd: Any, at: float) -> Any:
        return recorder.call(function, q, qd, *([] if torque is None else [torque(at)]))

    system = System(
        accelerations,
        operator.add,
        None if solved is None else partial(recorder.call, 'solve'),
        solved,
    )
    jumps = torque is not None and torque.jumps
    if (jumps or not carries) and 'qdd' in integrator.carried:
        carried['qdd'] = accelerations(carried['q'], carried['qd'], 0)
    moved = dict(zip(carried, integrator.step(system, h, *carried.values()), strict=True))
    end = {part: moved[part] for part in rows}
    if torque is not None:
        end[torque.name] = torque.end()
    for name, value in end.items():
        recorder.output(name, (n,), [(value, lane) for lane in range(n)])
    return recorder.program()
