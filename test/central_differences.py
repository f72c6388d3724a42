# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Central differences of programs on mpmath numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bridge import run_program
import mpmath
import numpy as np
from numpy.typing import ArrayLike

import pfd_core as pfd


def differences(
    program: pfd.Program,
    inputs: Mapping[str, ArrayLike],
    output: str,
    name: str,
    step: str = '1e-16',
    digits: int = 50,
) -> Any:
    """
    Return the derivatives of an output with respect to an input, (..., elements of the input).

    What is cut off are third derivatives times the square of the step.
    """
    with mpmath.workdps(digits):
        change = mpmath.mpf(step)
        n = program.inputs[name]
        moves = np.array([[change * (i == j) for j in range(n)] for i in range(n)])
        at = {
            key: np.broadcast_to(np.asarray(inputs[key], dtype=object), (2 * n, size))
            for key, size in program.inputs.items()
        }
        at[name] = at[name] + np.concatenate([moves, -moves])
        values = run_program(program, at, digits=digits)[output]
        return np.moveaxis((values[:n] - values[n:]) / (2 * change), 0, -1)
