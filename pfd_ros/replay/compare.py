# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Differences between two logs, of simulated or real arms: clocks aligned, joints matched by name.

    lag    the shift of the second log's time at which the positions differ least, by mean square

Positions are compared on a grid at the coarser of the two rates, for all shifts at once by FFT:
    sum (a - b)^2 = sum a^2 + sum b^2 - 2 sum a b, each over the overlap.
The best shift is refined by a parabola through its neighbours. The second log is then interpolated
linearly at the times of the first.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_ros.messages.convert import JOINT_STATE
from pfd_ros.recording.log_arrays import PER_JOINT, LogArrays, TopicArrays
from pfd_ros.text import listed

Array = NDArray[Any]
# Part of the shorter log that two logs overlap at least at any lag.
OVERLAP = 0.5
# Samples of the grid on which the lag is estimated: an hour at 250 Hz.
GRID = 1_000_000


@dataclass(frozen=True)
class Difference:
    """
    The difference a - b of one joint in one field of a topic, in the field's unit.

    `largest` is its largest size, at the time `largest_at` [s] of the first log; `first_at` is the
    first time at which it exceeds the tolerance, None if it never does.
    """

    topic: str
    field: str
    joint: str
    rms: float
    largest: float
    largest_at: float
    first_at: float | None


@dataclass(frozen=True)
class Comparison:
    """
    Two logs compared.

    Attributes
    ----------
    lag : float
        Time that was added to the first log's to get the second's [s], beyond `shift`.
    shift : float
        Difference of the starts [s] where the clocks have nothing in common, else 0.
    overlap : float
        Seconds that were compared.
    differences : tuple of Difference
        By topic, field and joint.
    only_in_a, only_in_b : tuple of str
        Joints without a partner, after their topic.
    unordered : tuple of str
        Topics whose stamps do not increase, such as commands without a stamp: they are left out.
    curves : dict
        Both logs at the compared times, for plots: time, a and b, (N,), by topic, field, joint.

    """

    lag: float
    shift: float
    overlap: float
    tolerance: float
    differences: tuple[Difference, ...]
    only_in_a: tuple[str, ...]
    only_in_b: tuple[str, ...]
    unordered: tuple[str, ...]
    curves: dict[tuple[str, str, str], tuple[Array, Array, Array]] = field(
        repr=False, compare=False
    )

    @property
    def within(self) -> bool:
        """Whether every difference is within the tolerance, and nothing lacks a partner."""
        alone = self.only_in_a or self.only_in_b
        return not alone and all(item.first_at is None for item in self.differences)


def compare(
    a: LogArrays,
    b: LogArrays,
    *,
    tolerance: float = 0.0,
    fields: Sequence[str] = PER_JOINT,
    topics: tuple[str, str] | None = None,
    lag: float | None = None,
) -> Comparison:
    """
    Compare the JointStates of two logs.

    Parameters
    ----------
    a, b : LogArrays
        From read_log.
    tolerance : float
        Largest difference that is none, in the unit of each field.
    fields : sequence of str
        Of 'position', 'velocity' and 'effort'.
    topics : (str, str), optional
        One topic of each log; default all topics of JointStates that both have, or the only one of
        each.
    lag : float, optional
        Lag [s]; default estimated from the first topic's positions.

    Raises
    ------
    ValueError
        If there is nothing to compare: no topic, no joint, or no common time.

    """
    if not tolerance >= 0:
        raise ValueError(f'tolerance must be 0 or more, got {tolerance}')
    unknown = sorted(set(fields) - set(PER_JOINT))
    if unknown or not fields:
        raise ValueError(f'fields must be some of {list(PER_JOINT)}, got {list(fields)}')
    pairs, unordered = ([topics], ()) if topics else _pairs(a, b)
    first = a[pairs[0][0]], b[pairs[0][1]]
    for log, states, topic in zip((a, b), first, pairs[0], strict=True):
        if states.type != JOINT_STATE:
            raise ValueError(f'{log.path}: topic {topic!r} is {states.type}, not {JOINT_STATE}')
        if not _increases(states):
            raise ValueError(
                f'{log.path}: the {len(states)} stamps of topic {topic!r} do not increase'
            )
    shift = _shift(*first)
    if lag is None:
        lag = estimated_lag(*first, shift)
    rows: list[Difference] = []
    curves = {}
    overlap = 0.0
    for topic, other in pairs:
        for item, joint, time, left, right in _aligned(a[topic], b[other], shift + lag, fields):
            rows.append(_difference(topic, item, joint, time, left - right, tolerance))
            curves[topic, item, joint] = time, left, right
            overlap = max(overlap, float(time[-1] - time[0]))
    if not rows:
        raise ValueError(
            f'{a.path} and {b.path} have no joint with values at common times: joints are '
            f'{listed(first[0].names)} and {listed(first[1].names)}, lag {lag:.6g} s'
        )
    only_in_a, only_in_b = _without_partner(a, b, pairs, 0), _without_partner(b, a, pairs, 1)
    return Comparison(
        lag, shift, overlap, tolerance, tuple(rows), only_in_a, only_in_b, unordered, curves
    )


def _pairs(a: LogArrays, b: LogArrays) -> tuple[list[tuple[str, str]], tuple[str, ...]]:
    """Return the topics to compare, and those whose stamps do not increase."""
    of_a, of_b = ([t for t in log if log.topics[t] == JOINT_STATE] for log in (a, b))
    both = [topic for topic in of_a if topic in of_b]
    unordered = tuple(t for t in both if not (_increases(a[t]) and _increases(b[t])))
    common = [(topic, topic) for topic in both if topic not in unordered]
    # Positions decide the lag, so the topic with most of them comes first.
    common.sort(key=lambda pair: -np.isfinite(a[pair[0]].position).sum())
    if common:
        return common, unordered
    if len(of_a) == len(of_b) == 1:
        return [(of_a[0], of_b[0])], ()
    raise ValueError(
        f'no topic of {JOINT_STATE} in both, name one of each: {a.path} has {listed(of_a)}, '
        f'{b.path} {listed(of_b)}'
    )


def _increases(states: TopicArrays) -> bool:
    return len(states) > 1 and bool((np.diff(states.time) > 0).all())


def _without_partner(
    log: LogArrays, other: LogArrays, pairs: Sequence[tuple[str, str]], side: int
) -> tuple[str, ...]:
    found = []
    for pair in pairs:
        joints = set(other[pair[1 - side]].names)
        found += [f'{pair[side]}: {name}' for name in log[pair[side]].names if name not in joints]
    return tuple(found)


def _shift(a: TopicArrays, b: TopicArrays) -> float:
    """Return the difference of the starts, or 0 where both logs have the same clock."""
    common = min(a.time[-1], b.time[-1]) - max(a.time[0], b.time[0])
    shorter = min(a.time[-1] - a.time[0], b.time[-1] - b.time[0])
    return 0.0 if common >= OVERLAP * shorter else float(b.time[0] - a.time[0])


def estimated_lag(a: TopicArrays, b: TopicArrays, shift: float = 0.0) -> float:
    """
    Return the lag of b [s]: a at a time t resembles b at t + shift + lag the most.

    It is 0 where nothing moves, and where both logs are equal without one.
    """
    joints = [name for name in a.names if name in b.names]
    one, other = (_by_name(log, 'position', joints) for log in (a, b))
    moving = [k for k in range(len(joints)) if np.isfinite(one[:, k]).sum() > 1]
    moving = [k for k in moving if np.isfinite(other[:, k]).sum() > 1]
    if not moving:
        return 0.0
    begin = min(a.time[0], b.time[0] - shift)
    end = max(a.time[-1], b.time[-1] - shift)
    step = max(np.median(np.diff(a.time)), np.median(np.diff(b.time)), (end - begin) / GRID)
    if not step > 0:
        return 0.0
    grid = np.arange(begin, end + step, step)
    total, count = np.zeros((2, 2 * len(grid) - 1))
    norm = 0.0
    for k in moving:
        x, y = _on_grid(grid, a.time, one[:, k]), _on_grid(grid, b.time - shift, other[:, k])
        known, seen = np.isfinite(x), np.isfinite(y)
        middle = float(np.mean(x[known]))
        x, y = np.where(known, x - middle, 0.0), np.where(seen, y - middle, 0.0)
        total = total + _sums(x**2, seen) + _sums(known, y**2) - 2 * _sums(x, y)
        count = count + _sums(known, seen)
        norm += float(np.sum(x**2) + np.sum(y**2))
    enough = count >= OVERLAP * np.max(count)
    mean = np.where(enough, np.maximum(total, 0.0) / np.maximum(count, 1.0), np.inf)
    best = int(np.argmin(mean))
    zero = len(grid) - 1  # of the lags from -(len - 1) to len - 1
    # Below the rounding of the FFT differences are none.
    rounding = 1e-12 * norm / np.max(count)
    if mean[zero] <= rounding:
        return 0.0
    if mean[zero] <= mean[best] + rounding:
        best = zero
    vertex = 0.0
    if 0 < best < len(mean) - 1 and np.isfinite(mean[best - 1 : best + 2]).all():
        left, low, right = mean[best - 1 : best + 2]
        curvature = left - 2 * low + right
        vertex = 0.5 * (left - right) / curvature if curvature > rounding else 0.0
    return float((best - zero + vertex) * step)


def _sums(x: Array, y: Array) -> Array:
    """Return sum_t x(t) y(t + k) for all k from -(N - 1) to N - 1, by FFT."""
    n = len(x)
    size = 1 << (2 * n - 1).bit_length()
    product = np.conj(np.fft.rfft(x, size)) * np.fft.rfft(y, size)
    found = np.fft.irfft(product, size)
    return np.concatenate([found[size - n + 1 :], found[:n]])


def _on_grid(grid: Array, time: Array, values: Array) -> Array:
    """Return values on a grid, NaN outside their times."""
    known = np.isfinite(values)
    found: Array = np.interp(grid, time[known], values[known], np.nan, np.nan)
    return found


def _by_name(states: TopicArrays, item: str, joints: Sequence[str]) -> Array:
    columns = [states.names.index(name) for name in joints]
    values: Array = states[item][:, columns]
    return values


def _aligned(
    a: TopicArrays, b: TopicArrays, offset: float, fields: Sequence[str]
) -> Iterator[tuple[str, str, Array, Array, Array]]:
    """Yield field, joint, times of a, and the values of both at these times."""
    for item in fields:
        for joint in (name for name in a.names if name in b.names):
            one, other = (_by_name(log, item, [joint])[:, 0] for log in (a, b))
            known = np.isfinite(other)
            if known.sum() < 1:
                continue
            right = np.interp(a.time + offset, b.time[known], other[known], np.nan, np.nan)
            common = np.isfinite(one) & np.isfinite(right)
            if common.any():
                yield item, joint, a.time[common], one[common], right[common]


def _difference(
    topic: str, item: str, joint: str, time: Array, difference: Array, tolerance: float
) -> Difference:
    sizes = np.abs(difference)
    worst = int(np.argmax(sizes))
    beyond = np.flatnonzero(sizes > tolerance)
    return Difference(
        topic,
        item,
        joint,
        rms=math.sqrt(float(np.mean(difference**2))),
        largest=float(sizes[worst]),
        largest_at=float(time[worst]),
        first_at=float(time[beyond[0]]) if len(beyond) else None,
    )
