# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Convergence of iterative methods, decided by the equations of motion.

    r      = tau of the motors - ID(q, qd, qdd)                  the true residual
    delta  = H^-1 r,   y = H^-1 tau                              by composite bodies
    converged   the method's own flag, and  sum |delta| <= CORRECTION (sum |qdd| + sum |y|)

Conjugate gradients stop by a residual that they update and never compute again. With rounding it
falls to zero while the true residual does not: Greenbaum, Iterative Methods for Solving Linear
Systems, 1997, chapter 4. The true residual alone does not decide either, because with
ill-conditioned H a small r belongs to a large error. delta is an estimate of that error.

The check is no part of the counted algorithm. pfd_core.emulate runs it after the program and sets
the status; a kernel contains it and answers NaN, because it returns an array and no status. Where
H does not factor in the number format, delta is NaN, and the answer is rejected.

Cost: one inverse dynamics, one inertia matrix with its factors, two solves.
"""

from __future__ import annotations

from functools import reduce
import math
import operator

from pfd_core.dynamics.interface import input_list, program_with_outputs
from pfd_core.dynamics.refinement import record_residual, solver
from pfd_core.machine.lanes import absolute, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder, inline
from pfd_core.model.plant import Plant

# Largest correction of a converged answer, as a share of the accelerations. Ordinary states of the
# included arms need 1e-5 in single precision. With a payload of 1e6 kg, 0.005 accepts errors of up
# to 1.6 % and 0.01 up to 28 % (1000 states each of three arms; test_methods.py).
CORRECTION = 0.005


def record_small_correction(plant: Plant) -> Program:
    """
    Return the sequential program of `small`, (1,): 1 if delta is small, else 0, also for NaN.

    Inputs are the inputs of forward dynamics, and qdd, (n,).
    """
    recorder = Recorder(1, 'sequential')
    solve = solver(recorder, plant, 'composite_body')
    qdd = input_list(recorder, 'qdd', plant.robot.n)
    found = inline(recorder, record_residual(plant), {})
    delta, y = (solve(found[x])['qdd'] for x in ('residual', 'tau'))
    with recorder.section('convergence'):
        change = _size(delta)
        excess = change - CORRECTION * (_size(qdd) + _size(y))
        # 1/(1 + change) is above zero for finite numbers only.
        small = where(excess, 0.0, where(1.0 / (1.0 + change), 1.0, 0.0))
    return program_with_outputs(recorder, small=[small])


def with_nan_unless_converged(program: Program, plant: Plant) -> Program:
    """Return a sequential program whose qdd, (n,), is NaN where it has not converged."""
    if 'converged' not in program.outputs:
        return program
    recorder = Recorder(1, 'sequential')
    results = inline(recorder, program, {})
    small = inline(recorder, record_small_correction(plant), {'qdd': results['qdd']})['small']
    with recorder.section('convergence'):
        results['qdd'] = [
            where(results['converged'][0], where(small[0], value, math.nan), math.nan)
            for value in results['qdd']
        ]
    return program_with_outputs(recorder, **results)


def _size(values: list[Lanes]) -> Lanes:
    return reduce(operator.add, map(absolute, values))
