# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The programs of adaptive steps around the stages of an embedded pair.

    first_size  the size of the first step, from the slope at the start
    plan      the length of the next attempt: whole steps up to the end
    judge     its error, whether it is accepted, the next size, and whether it is stiff
    dense     rows of the dense output
    keep      whether all numbers at the end are finite
    clock     the time after the step

The error of a step is the root mean square over the state of estimate / (atol + rtol |state|). A
step with an error above 1 is rejected and tried again with a smaller size; the size of the next
step follows from the error and the order (Hairer, Norsett, Wanner, section II.4). If a number is
not finite the error is NaN: the step is rejected, until its size is below the smallest. The order
is a power of two, so that its root is a sequence of square roots, with the same bits on every
processor.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain, pairwise
import math

import numpy as np

from pfd_core.machine.lanes import absolute, sqrt, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes
from pfd_core.simulation.embedded_pairs import ROWS
from pfd_core.simulation.flags import (
    Inputs,
    Outputs,
    Row,
    both,
    either,
    largest,
    negated,
    record,
    sign_of,
    smallest,
    total,
)
from pfd_core.simulation.stages import added, plus, scaled
from pfd_core.simulation.tableaux import Tableau, of_stages

STATUSES = ('', 'ok', 'not_finite', 'step_too_small')
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
LARGEST, SMALL = float(np.finfo(float).max), 2.0**-100


def control_programs(pair: Tableau, n: int) -> dict[str, Program]:
    """Return the programs of adaptive steps of n joints by a pair, by name."""
    return {
        'first_size': record(n, _first_size, pair),
        'plan': record(n, _plan),
        'judge': record(n, _judge, pair),
        'dense': record(n, _dense, pair),
        'keep': record(n, _keep),
        'clock': record(n, _clock),
    }


def _first_size(pair: Tableau, at: Inputs) -> Outputs:
    """Return `size` and `grow` at the start (Hairer, Norsett, Wanner, II.4)."""
    longest, least, lost = at.single('longest', 'smallest', 'lost')
    speed = sqrt(_mean_square([*at.qd, *at.K0], _scales(at, [*at.q, *at.qd])))
    size = largest([least, _root(0.01 / speed, pair.order)])
    known = both(sign_of(speed), sign_of(LARGEST - speed))
    return {
        'size': where(known, smallest([longest, size]), longest),
        'grow': GROW,
        'status': _status(at, not_finite=negated(_finite([*at.q, *at.qd, *at.K0, lost]))),
    }


def _plan(at: Inputs) -> Outputs:
    """
    Return the length r and the end `time.end` of the next attempt.

    The last steps are equal, since a remainder might be below the smallest step. Output `goes` is
    0, and `status` says why, if there is none.
    """
    time, size, duration, least = at.single('time', 'size', 'duration', 'smallest')
    error, status, failed = at.single('error', 'status', 'failed')
    left = duration - time
    close = sign_of(2.0 * size - left)
    last = both(close, negated(left / size - (1.0 + ROUNDED_TIME)))
    r = where(last, left, where(close, 0.5 * left, size))
    small = both(sign_of(least - size), negated(status))
    known = sign_of(error + 1.0)
    ended = _status(at, step_too_small=both(small, known), not_finite=small)
    status = where(small, ended, status)
    return {
        'r': r,
        'length': r,
        'whole': r,
        'time.end': where(last, duration, time + r),
        'status': status,
        'goes': negated(either(status, failed)),
        'event': 0.0,
        'lost': 0.0,
    }


def _judge(pair: Tableau, at: Inputs) -> Outputs:
    """
    Return the error of an attempt, and `size` and `grow` of the next one.

    The two estimates are combined as in section II.10 of Hairer, Norsett, Wanner. A step is stiff
    if it is as long as stability permits: the last two stages, q.stage and q.end, have the same
    time, and their slopes and states differ by the largest eigenvalue (Hairer, Wanner, section
    IV.2). Outputs `rejected` and `stiff` are counts.
    """
    end = pair.end
    r, grow, longest, lost = at.single('r', 'grow', 'longest', 'lost')
    rejected, stiff = at.single('rejected', 'stiff')
    q_end, v_end = at.q_end, at.qd_end
    K = at.rows(*(f'K{j}' for j in range(end + 1)))
    scales = _scales(at, [*at.q, *at.qd], [*q_end, *v_end])
    high, low = (
        _mean_square([*_sum(r, of_stages(e, pair.A), K), *_sum(1.0, e, K)], scales)
        for e in pair.estimates
    )
    finite = _finite([*q_end, *v_end, *K[end], lost])
    error = where(finite, r * high / sqrt(where(high, high + 0.01 * low, 1.0)), math.nan)
    accepted = both(sign_of(2.0 - error), negated(error - 1.0))
    factor = SAFETY / _root(error, pair.order)
    factor = where(factor - SHRINK, factor, SHRINK)
    factor = where(error, factor, where(accepted, GROW, SHRINK))

    before = at.q_stage, at.qd_stage, K[end - 1]
    change = [
        [x - y for x, y in zip(*rows, strict=True)]
        for rows in zip((q_end, v_end, K[end]), before, strict=True)
    ]
    states, slopes = (_mean_square([*a, *b]) for a, b in pairwise(change))
    fast = sign_of((r * r) * slopes - STABLE**2 * states)
    return {
        'error': error,
        'accepted': accepted,
        'kept': accepted,
        'size': smallest([longest, r * smallest([factor, grow])]),
        'grow': where(accepted, GROW, 1.0),
        'rejected': rejected + negated(accepted),
        'stiff': stiff + both(accepted, fast),
    }


def _dense(pair: Tableau, at: Inputs) -> Outputs:
    """Return the rows `dense<k>.q` and `dense<k>.qd` of the dense output."""
    A, b = pair.A, pair.b
    v, v_end, (r,) = at.qd, at.qd_end, at.single('r')
    K = at.rows(*(f'K{j}' for j in range(len(A))))
    outputs: dict[str, Row] = {'length': [r]}
    parts = (
        ('q', added(scaled(r, v), _sum(r * r, of_stages(b, A), K)), v, v_end, r * r, A),
        ('qd', _sum(r, b, K), K[0], K[pair.end], r, np.eye(len(A))),
    )
    for part, rise, first, last, factor, weights in parts:
        a, z = scaled(r, first), scaled(r, last)
        rows = [rise, [x - y for x, y in zip(a, rise, strict=True)]]
        rows.append([2.0 * x - (y + w) for x, y, w in zip(rise, a, z, strict=True)])
        rows += [_sum(factor, of_stages(row, weights), K) for row in pair.tail]
        outputs |= {f'dense{k}.{part}': row for k, row in enumerate(rows)}
    return outputs


def _keep(at: Inputs) -> Outputs:
    """Return `kept`: whether all numbers of a step are finite."""
    names = [f'dense{k}.{part}' for k in range(ROWS) for part in ('q', 'qd')]
    r, size, error, rejected, lost = at.single('r', 'size', 'error', 'rejected', 'lost')
    kept = _finite([lost, *chain.from_iterable(at.rows('q.end', 'qd.end', *names))])
    return {
        'kept': kept,
        'size': where(kept, size, r * SHRINK),
        'error': where(kept, error, math.nan),
        'rejected': rejected + negated(kept),
    }


def _clock(at: Inputs) -> Outputs:
    """
    Return the time after a step, the size of the next one, and the status.

    A step that an event cuts does not let the next one grow: a step in a parabola has no error,
    and the search resolves a part of a step. Output `moved` flags a step that takes time. The
    others have put joints to rest.
    """
    time, end, r, whole, duration = at.single('time', 'time.end', 'r', 'whole', 'duration')
    rejected, size, event = at.single('rejected', 'size', 'event')
    new = where(whole - r, smallest([time + r, end]), end)
    moved = sign_of(new - time)
    return {
        'time': new,
        'moved': moved,
        'size': where(event, smallest([size, whole]), size),
        'rejected': rejected + negated(moved),
        'status': _status(at, ok=negated(duration - new)),
    }


def _status(at: Inputs, **flags: Lanes) -> Lanes:
    """Return the number of the first status whose flag is set, or 0."""
    number = at.recorder.constant(0.0)
    for name, flag in reversed(flags.items()):
        number = where(flag, float(STATUSES.index(name)), number)
    return number


def _finite(values: Sequence[Lanes]) -> Lanes:
    return sign_of(LARGEST - absolute(total([x * SMALL for x in values])))


def _sum(factor: Lanes | float, weights: Iterable[float], K: Sequence[Row]) -> Row:
    """Return a factor times a weighted sum of rows, without rows of weight zero."""
    (w, first), *others = [(w, row) for w, row in zip(weights, K, strict=False) if w]
    return scaled(factor, plus(scaled(float(w), first), 1.0, others))


def _scales(at: Inputs, *states: Row) -> Row:
    """Return atol + rtol times the largest absolute value of states, for each element."""
    atol, rtol = at.single('atol', 'rtol')
    sizes = [largest([absolute(x) for x in each]) for each in zip(*states, strict=True)]
    return [atol + rtol * x for x in sizes]


def _mean_square(values: Sequence[Lanes], scales: Sequence[Lanes] = ()) -> Lanes:
    """Return the mean square of some numbers, as multiples of scales if there are any."""
    if scales:
        values = [x / scale for x, scale in zip(values, scales, strict=True)]
    square = values[0] * values[0]
    for x in values[1:]:
        square = square + x * x
    mean: Lanes = square * (1 / len(values))
    return mean


def _root(x: Lanes, order: int) -> Lanes:
    """Return the root of an order that is a power of two."""
    for _ in range(int(math.log2(order))):
        x = sqrt(x)
    return x
