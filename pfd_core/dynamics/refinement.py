# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Iterative refinement: solve again for the torques that an answer misses, and add the correction.

    qdd    = a method's answer
    r      = tau of the motors - ID(q, qd, qdd)       link by link, in the same number format
    delta  = the same method at q, for r, at rest, without gravity and wrench:  H delta = r
    qdd    = qdd + delta

The last three lines are a step. The error of the answer before the last step is estimated by

    error = max |delta| / max |qdd + delta|       r with its rounding errors added

A residual in the number format is rounding where tau is close to the bias, and so is delta.
pfd_core.machine.rounding_errors makes it accurate, for several times the operations; only a
recording of the estimate has it.

A method is recorded once more for delta. Its part that depends on q alone, the inertia
matrix and its factors or the articulated inertias, consists of the same expressions as before, and
lowering keeps one of each: of the second recording only a solve with the factors is left.

The residual is computed as by Luh, Walker and Paul: each link about its centre of mass in the axes
of its joint, with the robot's parameters as given. Torques summed about the base, or from grouped
parameters, would have the same rounding that refinement removes
(docs/decisions/0005-refinement.md). Methods in the same axes share its angular velocities.

Wilkinson 1963; Skeel 1980: one step in the same precision is enough if the residual is accurate
relative to its own terms.

One register holds one number.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math

from pfd_core.dynamics.drives import motor_torques
from pfd_core.dynamics.interface import input_list, program_with_outputs
from pfd_core.dynamics.links import CENTERED, GIVEN
from pfd_core.dynamics.methods import record_forward_dynamics
from pfd_core.dynamics.newton_euler import record_link_torques
from pfd_core.forking import no_fork
from pfd_core.machine.lanes import absolute, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder, inline
from pfd_core.model import Plant
from pfd_core.model.effects import INERTIA


def record_refined(
    plant: Plant,
    method: str,
    steps: int,
    tolerance: float | None = None,
    estimate: str | None = 'float64',
) -> Program:
    """
    Return the sequential program of a method with steps of refinement.

    Parameters
    ----------
    plant : Plant
        Robot and scene.
    method : str
        A name in METHODS.
    steps : int
        Steps of refinement.
    tolerance : float, optional
        Relative residual at which an iterative method stops; default for double precision.
    estimate : {'float64', 'float32', None}
        Number format for which the error is estimated; None leaves the estimate out.

    Returns
    -------
    Program
        The outputs of the method, with qdd refined. With an estimate also `error`, (1,): the
        estimated relative error of qdd before the last step, without steps of qdd itself. It is
        infinite where the answer is not finite, a pivot is not positive or the iteration has not
        converged.

    """
    method_program = record_forward_dynamics(plant, method, 'sequential', tolerance)
    if steps == 0 and estimate is None:
        return method_program
    solve = record_forward_dynamics(plant.only(INERTIA), method, 'sequential', tolerance)
    residual = record_residual(plant)
    recorder = Recorder(1, 'sequential')
    zero = recorder.constant(0.0)
    results = inline(recorder, method_program, {})
    qdd = before = results['qdd']
    rest = {'qd': [zero] * plant.robot.n, 'wrench': [zero] * 6}
    for _ in range(steps):
        before = qdd
        r = inline(recorder, residual, {'qdd': qdd})['residual']
        delta = inline(recorder, solve, rest | {'tau': r})['qdd']
        with recorder.section('correction'):
            qdd = [a + d for a, d in zip(qdd, delta, strict=True)]
    if estimate is not None:
        with recorder.section('exact residual'):
            r = _exact_residual(recorder, plant, before, estimate)
        delta = inline(recorder, solve, rest | {'tau': r})['qdd']
        with recorder.section('error estimate'):
            right = [a + d for a, d in zip(before, delta, strict=True)]
            results['error'] = [_estimate(recorder, right, delta, results)]
    return program_with_outputs(recorder, **results | {'qdd': qdd})


def record_residual(plant: Plant, parameters: str = CENTERED) -> Program:
    """
    Return the sequential program of the torques that accelerations miss, from q, qd, qdd and tau.

    Its outputs are `residual`, tau of the motors - ID(q, qd, qdd), and `tau` of the motors, (n,).
    `parameters` are of the kind of pfd_core.dynamics.chain, not grouped.
    """
    recorder = Recorder(1, 'sequential')
    tau, qd = (input_list(recorder, name, plant.robot.n) for name in ('tau', 'qd'))
    tau = motor_torques(plant, tau, qd)
    needed = inline(recorder, record_link_torques(plant, parameters), {})['tau']
    with recorder.section('residual'):
        residual = [t - u for t, u in zip(tau, needed, strict=True)]
    return program_with_outputs(recorder, residual=residual, tau=tau)


def _exact_residual(
    recorder: Recorder, plant: Plant, qdd: Sequence[Lanes], dtype: str
) -> list[Lanes]:
    """Return the torques that an answer misses, accurate to the last digits of a number format."""
    with no_fork:
        from pfd_core.machine.rounding_errors import RoundingErrors

    # Links that vary are in the axes of centred parameters.
    program = record_residual(plant, CENTERED if plant.links else GIVEN)
    missing = RoundingErrors(recorder, dtype).record(program, {'qdd': qdd})['residual']
    return [x.value if x.error is None else x.value + x.error for x in missing]


def _estimate(
    recorder: Recorder,
    qdd: Sequence[Lanes],
    delta: Sequence[Lanes],
    results: Mapping[str, Sequence[Lanes]],
) -> Lanes:
    """Return max |delta| / max |qdd|; infinity for an answer that is not sound."""
    infinity = recorder.constant(math.inf)
    sizes = [absolute(d) for d in delta]
    change, scale = _largest(sizes), _largest([absolute(a) for a in qdd])
    error: Lanes = where(change, change / scale, 0.0)
    # Comparisons lose NaN, a sum keeps it: one over the sum is zero or NaN for the rest.
    total = sizes[0]
    for size in sizes[1:]:
        total = total + size
    error = where(1.0 / (1.0 + total), error, infinity)
    for name in ('pivots', 'converged'):
        for sound in results.get(name, ()):
            error = where(sound, error, infinity)
    return error


def _largest(values: Sequence[Lanes]) -> Lanes:
    result: Lanes = values[0]
    for value in values[1:]:
        result = where(value - result, value, result)
    return result
