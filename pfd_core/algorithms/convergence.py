# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Kernels of iterative methods answer NaN where the iteration has not converged.

    qdd = qdd where converged, else NaN

A kernel returns an array and no status (pfd_core.emulate has one); the last iterate of a run that
has not converged would look like an answer.

One register holds one number.
"""

from __future__ import annotations

import math

from pfd_core.algorithms.chain.interface import program_with_outputs
from pfd_core.algorithms.refinement import inline
from pfd_core.machine.lanes import where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Recorder


def with_nan_unless_converged(program: Program) -> Program:
    """Return a sequential program whose qdd, (n,), is NaN where its output `converged` is 0."""
    if 'converged' not in program.outputs:
        return program
    recorder = Recorder(1, 'sequential')
    results = inline(recorder, program, {})
    (converged,) = results['converged']
    with recorder.section('verdict'):
        nan = recorder.constant(math.nan)
        results['qdd'] = [where(converged, value, nan) for value in results['qdd']]
    return program_with_outputs(recorder, **results)
