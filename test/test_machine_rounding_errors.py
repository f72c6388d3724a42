# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Values with their rounding errors against the same program in 50 digits."""

from __future__ import annotations

from typing import Any

from bridge import (
    Recorder,
    RoundingErrors,
    lane_cos,
    lane_sin,
    lane_sqrt,
    lane_where,
    lower_program,
    run_program,
)
import numpy as np
import pytest

import pfd_core as pfd

UNIT = {'float64': 2.0**-53, 'float32': 2.0**-24}
# Value plus error is off by a small share of the unit of rounding: terms of the series that are
# left out, and products of two errors. Seen up to 2e-4.
SHARE = 1e-2


def record_everything() -> pfd.Program:
    """Return a program with each operation, of x, y and an angle, of numbers of order one."""
    recorder = Recorder(1, 'sequential')
    x, y, angle = (recorder.input('x', [k]) for k in range(3))
    third = recorder.constant(1 / 3)
    results = [
        x + y,
        (x - y) * third,
        x * y - y * x * third,
        (x * third) / (y + 2.0),
        -lane_sqrt(x * x + y),
        lane_where(x - y, x * third, y + third),
        lane_sin(angle),
        lane_cos(angle),
        lane_sin(angle) * x + lane_cos(angle) * y,
        1.0 * x + 0.0 * y,
        (third + recorder.constant(0.7)) * x,
        third * recorder.constant(0.7) - y,
    ]
    recorder.output('z', (len(results),), [(value, 0) for value in results])
    return recorder.program()


def with_errors(program: pfd.Program, dtype: str) -> pfd.Program:
    """Return a program whose outputs are the values and their errors."""
    recorder = Recorder(1, 'sequential')
    found = RoundingErrors(recorder, dtype).record(program)['z']
    for k, name in enumerate(('value', 'error')):
        recorder.output(name, (len(found),), [(z[k], 0) for z in found])
    return recorder.program()


@pytest.mark.parametrize('reach', [1.0, 1e3, 1e5])
@pytest.mark.parametrize('dtype', UNIT)
def test_a_value_with_its_error_has_more_digits_than_the_number_format(
    dtype: str, reach: float
) -> None:
    rng = np.random.default_rng(4)
    x = rng.uniform(0.5, 2.0, (200, 3))
    x[:, 2] = rng.uniform(-reach, reach, 200)
    x = x.astype(dtype)
    x[0, 2] = np.pi / 2
    state: dict[str, Any] = {'x': x}
    program = record_everything()
    # As in a kernel, where constants are folded.
    found = run_program(lower_program(with_errors(program, dtype), dtype).compiled, state, dtype)
    exact = run_program(program, {'x': x.astype('float64')}, digits=50)['z']
    difference = (found['value'].astype(np.float64).astype(object) - exact).astype(np.float64)
    unit = UNIT[dtype]
    # The values alone are rounded.
    assert np.abs(difference).max() > 0.2 * unit
    rest = np.abs(difference + found['error'].astype(np.float64))
    assert rest.max() <= SHARE * unit


def test_an_operation_without_a_known_rounding_error_is_an_error() -> None:
    recorder = Recorder(1, 'sequential')
    x = recorder.input('x', [0])
    recorder.output('z', (1,), [(recorder.apply('fma', x, x, x), 0)])
    with pytest.raises(ValueError, match='rounding error of fma is not known'):
        with_errors(recorder.program(), 'float64')
