# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Iterative refinement: solve again for the torques that an answer misses, and add the correction.

    qdd    = a method's answer
    r      = tau of the motors - ID(q, qd, qdd)       link by link, in the same number format
    delta  = the same method at q, for r, at rest, without gravity and wrench:  H delta = r
    qdd    = qdd + delta

The last three lines are a step. The error of accelerations, refined or not, is estimated by

    error = max |delta| / max |qdd + delta|       r with its rounding errors added

A residual in the number format is rounding where tau is close to the bias, and so is delta.
pfd_core.machine.rounding_errors makes it accurate, for several times the operations. It is the
residual of the robot as it is given: axes of links at other than right angles are rounded anew by
the methods, and their answers are wrong by that. Links that vary, or follow, are taken as rounded.

A method is recorded once more for delta. Its part that depends on q alone, the inertia
matrix and its factors or the articulated inertias, consists of the same expressions as before, and
lowering keeps one of each: of the second recording only a solve with the factors is left.

The residual is computed as by Luh, Walker and Paul: each link about its centre of mass in the axes
of its joint, with the robot's parameters as given. Torques summed about the base, or from grouped
parameters, would have the same rounding that refinement removes
(docs/decisions/0005-refinement.md). Methods in the same axes share its angular velocities.

An iterative method has converged by its own flag and the equations of motion,

    y         = H^-1 tau                                        delta and y by composite bodies
    converged   sum |delta| <= CORRECTION (sum |qdd| + sum |y|)

Conjugate gradients stop by a residual that they update and never compute again. With rounding it
falls to zero while the true residual does not: Greenbaum, Iterative Methods for Solving Linear
Systems, 1997, chapter 4. The true residual alone does not decide either, because with
ill-conditioned H a small r belongs to a large error. delta is an estimate of that error. The check
is no part of the counted algorithm. pfd_core.emulate has one of its own; a kernel contains it and
answers NaN, because it returns an array and no status. Where H does not factor in the number
format, delta is NaN, and the answer is rejected.

Wilkinson 1963; Skeel 1980: one step in the same precision is enough if the residual is accurate
relative to its own terms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import reduce
import math
import operator

import numpy as np

from pfd_core.dynamics.drives import motor_torques
from pfd_core.dynamics.links import CENTERED, GIVEN
from pfd_core.dynamics.methods import record_forward_dynamics
from pfd_core.dynamics.newton_euler import record_link_torques
from pfd_core.forking import load
from pfd_core.machine.iteration import TOLERANCES
from pfd_core.machine.lanes import absolute, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder, inline
from pfd_core.model.effects import INERTIA
from pfd_core.model.plant import Plant

# Largest correction of a converged answer, as a share of the accelerations. Ordinary states of the
# included arms need 1e-5 in single precision. With a payload of 1e6 kg, 0.005 accepts errors of up
# to 1.6 % and 0.01 up to 28 % (1000 states each of three arms; test_methods.py).
CORRECTION = 0.005


def record_refined(
    plant: Plant, method: str, steps: int, tolerance: float | None = None, first: bool = False
) -> Program:
    """
    Return the sequential program of a method, with its qdd after steps of refinement.

    An iterative method stops at the tolerance, by default for double precision. With `first` the
    qdd before refinement is an output, too.
    """
    method_program = record_forward_dynamics(plant, method, 'sequential', tolerance)
    if steps == 0:
        return method_program
    recorder = Recorder(1, 'sequential')
    solved = solver(recorder, plant, method, tolerance)
    results = inline(recorder, method_program, {})
    qdd = refined(plant, results['qdd'], lambda torques: solved(torques)['qdd'], steps)
    before = {'first': results['qdd']} if first else {}
    return recorder.program(**results | {'qdd': qdd} | before)


def record_answer(plant: Plant, method: str, steps: int, dtype: str) -> Program:
    """Return record_refined for a number format, with NaN for a qdd that has not converged."""
    program = record_refined(plant, method, steps, TOLERANCES[dtype])
    if 'converged' not in program.outputs:
        return program
    recorder = Recorder(1, 'sequential')
    results = inline(recorder, program, {})
    solve = solver(recorder, plant, 'composite_body')
    found = inline(recorder, record_residual(plant), {'qdd': results['qdd']})
    delta, y = (solve(found[x])['qdd'] for x in ('residual', 'tau'))
    with recorder.section('convergence'):
        change = _size(delta)
        excess = change - CORRECTION * (_size(results['qdd']) + _size(y))
        # 1/(1 + change) is above zero for finite numbers only.
        small = where(excess, 0.0, where(1.0 / (1.0 + change), 1.0, 0.0))
        results['qdd'] = [
            where(results['converged'][0], where(small, value, math.nan), math.nan)
            for value in results['qdd']
        ]
    return recorder.program(**results)


def refined(
    plant: Plant, qdd: Sequence[Lanes], solve: Callable[[list[Lanes]], list[Lanes]], steps: int
) -> Sequence[Lanes]:
    """Return accelerations after steps of refinement; `solve` gives those by torques at rest."""
    recorder = qdd[0].recorder
    for _ in range(steps):
        delta = solve(inline(recorder, record_residual(plant), {'qdd': qdd})['residual'])
        with recorder.section('correction'):
            qdd = [a + d for a, d in zip(qdd, delta, strict=True)]
    return qdd


def record_error(plant: Plant, method: str, dtype: str, tolerance: float | None = None) -> Program:
    """
    Return the sequential program of the error of accelerations, from q, qd, tau and qdd.

    Its output `error`, (1,), is max |difference| / max |exact qdd|, estimated for a number format
    by a solve with the method. It is infinite where the correction is not finite, a pivot is not
    positive or the iteration has not converged; an iterative method stops at the tolerance, by
    default that of the number format.
    """
    recorder = Recorder(1, 'sequential')
    qdd = recorder.input_list('qdd', plant.robot.n)
    with recorder.section('exact residual'):
        r = _exact_residual(recorder, plant, dtype)
    stop = TOLERANCES[dtype] if tolerance is None else tolerance
    results = solver(recorder, plant, method, stop)(r)
    with recorder.section('error estimate'):
        right = [a + d for a, d in zip(qdd, results['qdd'], strict=True)]
        error = _estimate(right, results)
    return recorder.program(error=[error])


def solver(
    recorder: Recorder, plant: Plant, method: str, tolerance: float | None = None
) -> Callable[[Sequence[Lanes]], Mapping[str, list[Lanes]]]:
    """Return a function that records a method for torques at rest: its qdd is H^-1 of them."""
    solve = record_forward_dynamics(plant.only(INERTIA), method, 'sequential', tolerance)
    zero = recorder.constant(0.0)
    rest = {'qd': [zero] * plant.robot.n, 'wrench': [zero] * 6}
    return lambda torques: inline(recorder, solve, rest | {'tau': torques})


def record_residual(plant: Plant) -> Program:
    """
    Return the sequential program of the torques that accelerations miss, from q, qd, qdd and tau.

    Its outputs are `residual`, tau of the motors - ID(q, qd, qdd), and `tau` of the motors, (n,).
    """
    return _residual(plant, record_link_torques(plant))


def _residual(plant: Plant, torques: Program) -> Program:
    recorder = Recorder(1, 'sequential')
    tau, qd = (recorder.input_list(name, plant.robot.n) for name in ('tau', 'qd'))
    tau = motor_torques(plant, tau, qd)
    needed = inline(recorder, torques, {})['tau']
    with recorder.section('residual'):
        residual = [t - u for t, u in zip(tau, needed, strict=True)]
    return recorder.program(residual=residual, tau=tau)


def _exact_residual(recorder: Recorder, plant: Plant, dtype: str) -> list[Lanes]:
    """Return the torques that the input qdd misses, with nearly twice the digits of a format."""
    if plant.links or plant.robot.followers:
        # Links that vary are in the axes of centred parameters; in axes of the base none follows.
        torques = record_link_torques(plant, CENTERED)
    elif np.isin(plant.robot.rotations, (-1.0, 0.0, 1.0)).all():
        torques = record_link_torques(plant, GIVEN)
    else:
        # In axes of the base, so that the rotations are those of the robot, not angles.
        motors = replace(plant, gravity_compensation=None)
        record = load('paper.newton_euler.record_inverse_dynamics')
        torques = record(motors, 'sequential')
    errors = load('machine.rounding_errors.RoundingErrors')(recorder, dtype)
    return [x.value + x.error for x in errors.record(_residual(plant, torques))['residual']]


def _estimate(qdd: Sequence[Lanes], results: Mapping[str, Sequence[Lanes]]) -> Lanes:
    """Return max |delta| / max |qdd|; infinity for a correction that is not sound."""
    sizes = [absolute(d) for d in results['qdd']]
    change, scale = _largest(sizes), _largest([absolute(a) for a in qdd])
    error: Lanes = where(change, change / scale, 0.0)
    # Comparisons lose NaN, a sum keeps it: one over the sum is zero or NaN for the rest.
    total = reduce(operator.add, sizes)
    error = where(1.0 / (1.0 + total), error, math.inf)
    for name in ('pivots', 'converged'):
        for sound in results.get(name, ()):
            error = where(sound, error, math.inf)
    return error


def _largest(values: Sequence[Lanes]) -> Lanes:
    return reduce(lambda most, value: where(value - most, value, most), values)


def _size(values: list[Lanes]) -> Lanes:
    return reduce(operator.add, map(absolute, values))
