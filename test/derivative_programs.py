# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The derivatives of accelerations as one program, which native code multiplies itself."""

from __future__ import annotations

from typing import Any

from bridge import (
    Plant,
    Recorder,
    fused_product,
    inline_program,
    record_derivatives,
    vector_array,
)


def record_acceleration_derivatives(plant: Plant, method: str = 'composite_body') -> Any:
    """
    Return the program of `derivatives`, d qdd / d(q, qd, tau), (n, 3 n), from q, qd and tau.

    Sums are in the order of the joints, each product after the first fused with the sum so far.
    """
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    parts = inline_program(recorder, record_derivatives(plant, method), {})
    X = vector_array(parts['X']).reshape(n, n)
    D = vector_array(parts['D']).reshape(n, 2 * n)
    with recorder.section('product'):
        by_tau = X * vector_array(parts['T']) if 'T' in parts else X
        rows = [
            [*(-fused_product(row, column) for column in D.T), *scaled]
            for row, scaled in zip(X, by_tau, strict=True)
        ]
    recorder.output('derivatives', (n, 3 * n), [(value, 0) for row in rows for value in row])
    return recorder.program()
