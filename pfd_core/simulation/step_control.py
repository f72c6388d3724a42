# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Step size control: the programs of adaptive steps, which native code calls in turn.

    first_size    the size of the first step, from the slope at the start
    attempt       the size of the next attempt: whole steps up to the end
    stage1 ...    position and velocity of each stage of an embedded pair
    judge         error of the attempt, whether it is accepted, next size
    stiffness     whether stability, not accuracy, may have limited the step
    dense         coefficients of the dense output

The error of a step is the root mean square over the state of estimate / (atol + rtol |state|). A
step with an error above 1 is rejected and tried again with a smaller size; the size of the next
step follows from the error and the order (Hairer, Norsett, Wanner, section II.4). If a number is
not finite the error is NaN: the step is rejected, until its size is below the smallest. The order
is a power of two, so that its root is a sequence of square roots, with the same bits on every
processor.

The slope of the position is the velocity v of a stage (v0 = qd), the slope of the velocity its
acceleration a. Native code calls the programs (pfd_core.kernels.adaptive).

One register holds one number; flags are 1 or 0.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import numpy as np

from pfd_core.dynamics.interface import input_list, program_with_outputs
from pfd_core.machine.lanes import absolute, sqrt, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.simulation.embedded_pairs import EmbeddedPair, dense_coefficients
from pfd_core.simulation.flags import both, negated, sign_of

# The next step is this fraction of the step at which the error would be 1, and at least and at
# most these multiples of the last one (Hairer, Norsett, Wanner, equation II.4.13).
SAFETY, SHRINK, GROW = 0.9, 1 / 3, 6.0
# The smallest step as a fraction of the duration: 16 units of rounding of the last time.
SMALLEST_STEP = 2.0**-48
# Steps whose sum is rounded may be longer by this fraction, so that none is left over at the end.
ROUNDED_TIME = 1e-9
# Below this the rounding of a step is larger than the tolerance.
SMALLEST_RTOL = 1e-14
# Size of a step times the largest eigenvalue of the system at which DOP853 becomes unstable
# (Hairer, Wanner, Solving Ordinary Differential Equations II, section IV.2; program dop853.f).
STABLE = 6.1


def control_programs(pair: EmbeddedPair, n: int) -> dict[str, Program]:
    """Return the programs of adaptive steps of n joints by a pair, by name."""
    stages = {f'stage{k}': _stage(pair, n, k) for k in range(1, len(pair.nodes))}
    return {
        'first_size': _first_size(pair, n),
        'attempt': _attempt(),
        **stages,
        'judge': _judge(pair, n),
        'stiffness': _stiffness(pair, n),
        'dense': _dense(pair, n),
    }


def _read(recorder: Recorder, n: int, *names: str) -> Any:
    return np.array([input_list(recorder, name, n) for name in names], dtype=object)


def _single(recorder: Recorder, *names: str) -> list[Lanes]:
    return [input_list(recorder, name, 1)[0] for name in names]


def _velocities(stages: int) -> list[str]:
    """Return the names of the velocities of the first stages."""
    return ['qd', *(f'qd{k}' for k in range(1, stages))]


def _accelerations(stages: int) -> list[str]:
    """Return the names of the accelerations of the first stages."""
    return ['qdd', *(f'qdd{k}' for k in range(1, stages))]


def _weighted(weights: Any, rows: Any) -> Any:
    """Return weighted sums of rows, without rows of weight zero."""
    used = np.flatnonzero(weights)
    total = float(weights[used[0]]) * rows[used[0]]
    for j in used[1:]:
        total = total + float(weights[j]) * rows[j]
    return total


def _stage(pair: EmbeddedPair, n: int, k: int) -> Program:
    """Return the program of position `at` and velocity `qd<k>` of a stage."""
    recorder = Recorder(1, 'sequential')
    used = np.flatnonzero(pair.matrix[k, :k])
    weights = pair.matrix[k, used]
    q, qd = _read(recorder, n, 'q', 'qd')
    (h,) = _single(recorder, 'h')
    v = _read(recorder, n, *(_velocities(k)[j] for j in used))
    a = _read(recorder, n, *(_accelerations(k)[j] for j in used))
    at, end = q + h * _weighted(weights, v), qd + h * _weighted(weights, a)
    name = 'q.end' if k == pair.end else f'at{k}'
    return program_with_outputs(recorder, **{name: list(at), f'qd{k}': list(end)})


def _scales(recorder: Recorder, *states: Any) -> Any:
    """Return atol + rtol times the largest absolute value of states, for each element."""
    atol, rtol = _single(recorder, 'atol', 'rtol')
    largest = [absolute(x) for x in states[0]]
    for state in states[1:]:
        largest = [_larger(absolute(x), y) for x, y in zip(state, largest, strict=True)]
    return np.array([atol + rtol * x for x in largest], dtype=object)


def _mean_square(values: Sequence[Lanes]) -> Lanes:
    total: Lanes = values[0] * values[0]
    for x in values[1:]:
        total = total + x * x
    mean: Lanes = total * (1 / len(values))
    return mean


def _root(x: Lanes, order: int) -> Lanes:
    """Return the root of an order that is a power of two."""
    for _ in range(int(math.log2(order))):
        x = sqrt(x)
    return x


def _larger(a: Lanes, b: Lanes) -> Lanes:
    result: Lanes = where(a - b, a, b)
    return result


def _smaller(a: Lanes, b: Lanes) -> Lanes:
    result: Lanes = where(b - a, a, b)
    return result


def _first_size(pair: EmbeddedPair, n: int) -> Program:
    """Return the program of `size` and `grow` at the start (Hairer, Norsett, Wanner, II.4)."""
    recorder = Recorder(1, 'sequential')
    q, qd, a = _read(recorder, n, 'q', 'qd', 'qdd')
    longest, smallest = _single(recorder, 'longest', 'smallest')
    scales = _scales(recorder, [*q, *qd])
    speed = sqrt(_mean_square(np.array([*qd, *a], dtype=object) / scales))
    size = _smaller(longest, _larger(smallest, _root(0.01 / speed, pair.order)))
    known = both(sign_of(speed), sign_of(float(np.finfo(float).max) - speed))
    return program_with_outputs(
        recorder, size=[where(known, size, longest)], grow=[recorder.constant(GROW)]
    )


def _attempt() -> Program:
    """
    Return the program of the size `h` and the end `time.end` of the next attempt.

    The last steps are equal, since a remainder might be below the smallest step.
    """
    recorder = Recorder(1, 'sequential')
    time, size, duration = _single(recorder, 'time', 'size', 'duration')
    left = duration - time
    close = sign_of(2.0 * size - left)
    last = both(close, negated(left / size - (1.0 + ROUNDED_TIME)))
    h = where(last, left, where(close, 0.5 * left, size))
    return program_with_outputs(recorder, h=[h], **{'time.end': [where(last, duration, time + h)]})


def _judge(pair: EmbeddedPair, n: int) -> Program:
    """
    Return the program of `error`, `accepted`, and `size` and `grow` of the next attempt.

    The two estimates are combined as in section II.10 of Hairer, Norsett, Wanner. `finite` is 0,
    or NaN if a number of the end of the step is not finite.
    """
    recorder = Recorder(1, 'sequential')
    end = pair.end
    q, qd, q_end, qd_end = _read(recorder, n, 'q', 'qd', 'q.end', f'qd{end}')
    h, grow, longest, finite = _single(recorder, 'h', 'grow', 'longest', 'finite')
    scales = _scales(recorder, [*q, *qd], [*q_end, *qd_end])
    used = np.flatnonzero(pair.estimates.any(axis=0))
    slopes = [
        [*v, *a]
        for v, a in zip(
            _read(recorder, n, *(_velocities(end)[j] for j in used)),
            _read(recorder, n, *(_accelerations(end)[j] for j in used)),
            strict=True,
        )
    ]
    rows = np.array(slopes, dtype=object)
    high, low = (
        _mean_square(_weighted(weights[used], rows) / scales) for weights in pair.estimates
    )
    error = h * high / sqrt(where(high, high + 0.01 * low, 1.0)) + finite
    accepted = both(sign_of(2.0 - error), negated(error - 1.0))
    factor = SAFETY / _root(error, pair.order)
    factor = where(factor - SHRINK, _smaller(factor, recorder.constant(GROW)), SHRINK)
    factor = where(error, factor, where(accepted, GROW, SHRINK))
    return program_with_outputs(
        recorder,
        error=[error],
        accepted=[accepted],
        size=[_smaller(longest, h * _smaller(factor, grow))],
        grow=[where(accepted, GROW, 1.0)],
    )


def _stiffness(pair: EmbeddedPair, n: int) -> Program:
    """
    Return the program of `stiff`: whether the step is as long as stability permits.

    The last two stages have the same time; their slopes and states differ by the largest
    eigenvalue (Hairer, Wanner, section IV.2).
    """
    recorder = Recorder(1, 'sequential')
    end = pair.end
    before, after = (
        _read(recorder, n, *names)
        for names in (
            (f'at{end - 1}', f'qd{end - 1}', f'qdd{end - 1}'),
            ('q.end', f'qd{end}', f'qdd{end}'),
        )
    )
    (h,) = _single(recorder, 'h')
    change = after - before
    states = _mean_square([*change[0], *change[1]])
    slopes = _mean_square([*change[1], *change[2]])
    return program_with_outputs(recorder, stiff=[sign_of((h * h) * slopes - STABLE**2 * states)])


def _dense(pair: EmbeddedPair, n: int) -> Program:
    """Return the program of the rows `dense<k>.q` and `dense<k>.qd` of the dense output."""
    recorder = Recorder(1, 'sequential')
    stages = len(pair.nodes)
    (h,) = _single(recorder, 'h')
    outputs: dict[str, list[Lanes]] = {}
    for part, names in (('q', _velocities(stages)), ('qd', _accelerations(stages))):
        used = [j for j in range(stages) if pair.matrix[pair.end, j] or pair.dense[:, j].any()]
        used = sorted({0, pair.end, *used})
        rows = np.zeros((stages, n), dtype=object)
        rows[used] = _read(recorder, n, *(names[j] for j in used))
        for k, row in enumerate(dense_coefficients(pair, h, rows)):
            outputs[f'dense{k}.{part}'] = list(row)
    return program_with_outputs(recorder, **outputs)
