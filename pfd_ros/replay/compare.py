# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Differences between two logs, of simulated or real arms: clocks aligned, joints matched by name.

    lag    the shift of the second log's time at which the positions differ least, by mean square

Positions are compared on a grid at the coarser of the two rates, for all shifts at once by FFT:
    sum (a - b)^2 = sum a^2 + sum b^2 - 2 sum a b, each over the overlap.
The best shift is refined by a parabola through its neighbours. Both logs are then interpolated
linearly at the times of either.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfd_ros.messages.convert import JOINT_FIELDS, JOINT_STATE
from pfd_ros.recording.arrays import LogArrays, TopicArrays
from pfd_ros.text import listed

Array = NDArray[Any]
# Part of the shorter log that two logs overlap at least at any lag.
OVERLAP = 0.5
# Intervals between samples, as multiples of the median one, that are gaps.
GAP = 5.0
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
        Missing in the other log: topics; joints, fields of a joint and values after their topic.
    unordered : tuple of str
        Topics whose stamps do not increase, such as commands without a stamp, and which are not
        equal message by message: they have no times at which they could be compared.
    uncovered : float
        Seconds of the longer log that the other one does not cover, beyond the lag.
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
    uncovered: float
    curves: dict[tuple[str, str, str], tuple[Array, Array, Array]] = field(
        repr=False, compare=False
    )

    @property
    def within(self) -> bool:
        """Whether all of both logs was compared, and no difference exceeds the tolerance."""
        missing = self.only_in_a or self.only_in_b or self.unordered or self.uncovered
        return not missing and all(item.first_at is None for item in self.differences)


def compare(
    a: LogArrays,
    b: LogArrays,
    *,
    tolerance: float = 0.0,
    fields: Sequence[str] = JOINT_FIELDS,
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
        Largest allowed difference, in the unit of each field.
    fields : sequence of str
        Of 'position', 'velocity' and 'effort'.
    topics : (str, str), optional
        One topic of each log; default all topics of JointStates that both have, or the only one of
        each.
    lag : float, optional
        Time added to stamps of a to get stamps of b [s]; by default estimated from the first
        topic's positions, after a shift if the stamps do not overlap.

    Raises
    ------
    ValueError
        If there is nothing to compare: no topic, no joint, or no common time.

    """
    if not 0 <= tolerance < math.inf:
        raise ValueError(f'tolerance must be 0 or more and finite, got {tolerance}')
    unknown = sorted(set(fields) - set(JOINT_FIELDS))
    if unknown or not fields:
        raise ValueError(f'fields must be some of {list(JOINT_FIELDS)}, got {list(fields)}')
    pairs, unordered = ([topics], ()) if topics else _pairs(a, b)
    first = a[pairs[0][0]], b[pairs[0][1]]
    for log, states, topic in zip((a, b), first, pairs[0], strict=True):
        if states.type != JOINT_STATE:
            raise ValueError(f'{log.path}: topic {topic!r} is {states.type}, not {JOINT_STATE}')
        if not _increases(states):
            raise ValueError(
                f'{log.path}: the {len(states)} stamps of topic {topic!r} do not increase'
            )
    shift = 0.0
    if lag is None:
        shift = _shift(*first)
        lag = _estimated_lag(*first, shift)
    rows: list[Difference] = []
    curves = {}
    overlap = 0.0
    only_in_a, only_in_b = _without_partner(a, b, pairs, 0), _without_partner(b, a, pairs, 1)
    for topic, other in pairs:
        for found in _aligned(a[topic], b[other], shift + lag, fields):
            name = f'{found.field} of {found.joint}'
            if found.only_a:
                only_in_a.append(f'{topic}: {found.only_a} values, {name}')
            if found.only_b:
                only_in_b.append(f'{other}: {found.only_b} values, {name}')
            if len(found.time):
                time, left, right = found.time, found.left, found.right
                place = topic, found.field, found.joint
                rows.append(_difference(*place, time, left - right, tolerance))
                curves[place] = time, left, right
                overlap = max(overlap, float(time[-1] - time[0]))
    if not rows:
        raise ValueError(
            f'{a.path} and {b.path} have no joint with values at common times: joints are '
            f'{listed(first[0].names)} and {listed(first[1].names)}, lag {lag:.6g} s'
        )
    spans = [float(states.time[-1] - states.time[0]) for states in first]
    edges = abs(lag) + 2 * max(float(np.median(np.diff(states.time))) for states in first)
    uncovered = max(0.0, max(spans) - overlap - edges)
    return Comparison(
        lag,
        shift,
        overlap,
        tolerance,
        tuple(rows),
        tuple(only_in_a),
        tuple(only_in_b),
        unordered,
        uncovered,
        curves,
    )


def _pairs(a: LogArrays, b: LogArrays) -> tuple[list[tuple[str, str]], tuple[str, ...]]:
    """Return the topics to compare, and those whose stamps do not increase."""
    of_a, of_b = ([t for t in log if log.topics[t] == JOINT_STATE] for log in (a, b))
    both = [topic for topic in of_a if topic in of_b]
    without_times = [t for t in both if not (_increases(a[t]) and _increases(b[t]))]
    unordered = tuple(topic for topic in without_times if not _equal(a[topic], b[topic]))
    common = [(topic, topic) for topic in both if topic not in without_times]
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


def _equal(a: TopicArrays, b: TopicArrays) -> bool:
    """Return whether two topics have the same messages, but for their stamps."""
    return (
        a.names == b.names
        and len(a) == len(b)
        and all(np.array_equal(a[item], b[item], equal_nan=True) for item in JOINT_FIELDS)
    )


def _without_partner(
    log: LogArrays, other: LogArrays, pairs: Sequence[tuple[str, str]], side: int
) -> list[str]:
    found = []
    if len(pairs) > 1 or pairs[0][0] == pairs[0][1]:
        states = (topic for topic in log if log.topics[topic] == JOINT_STATE)
        found += [topic for topic in states if len(log[topic]) and topic not in other]
    for pair in pairs:
        joints = set(other[pair[1 - side]].names)
        found += [f'{pair[side]}: {name}' for name in log[pair[side]].names if name not in joints]
    return found


def _shift(a: TopicArrays, b: TopicArrays) -> float:
    """Return the difference of the starts, or 0 where the stamps of both logs overlap."""
    common = min(a.time[-1], b.time[-1]) - max(a.time[0], b.time[0])
    return 0.0 if common > 0 else float(b.time[0] - a.time[0])


def _estimated_lag(a: TopicArrays, b: TopicArrays, shift: float = 0.0) -> float:
    """
    Return the lag of b [s]: a at a time t resembles b at t + shift + lag the most.

    It is 0 where nothing moves, and where both logs are equal without one.
    """
    joints = [name for name in a.names if name in b.names]
    one, other = (_by_name(log, 'position', joints) for log in (a, b))
    moving = [k for k in range(len(joints)) if _moves(one[:, k]) and _moves(other[:, k])]
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


def _moves(values: Array) -> bool:
    known = values[np.isfinite(values)]
    return len(known) > 1 and bool(np.ptp(known) > 0)


def _on_grid(grid: Array, time: Array, values: Array) -> Array:
    """Return values on a grid, NaN outside their times and in gaps between them."""
    known = np.isfinite(values)
    time, values = time[known], values[known]
    found: Array = np.interp(grid, time, values, np.nan, np.nan)
    after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
    longest = GAP * max(float(np.median(np.diff(time))), float(grid[1] - grid[0]))
    found[time[after] - time[after - 1] > longest] = np.nan
    return found


def _by_name(states: TopicArrays, item: str, joints: Sequence[str]) -> Array:
    columns = [states.names.index(name) for name in joints]
    values: Array = states[item][:, columns]
    return values


class _Aligned(NamedTuple):
    """Values of both logs, (N,), at the times of either, and values that only one of them has."""

    field: str
    joint: str
    time: Array
    left: Array
    right: Array
    only_a: int
    only_b: int


def _aligned(
    a: TopicArrays, b: TopicArrays, offset: float, fields: Sequence[str]
) -> Iterator[_Aligned]:
    """Yield each field of each joint, at the times of a and of b where both have values."""
    own, others = a.time, b.time - offset
    begin, end = max(own[0], others[0]), min(own[-1], others[-1])
    inside, inside_other = (own >= begin) & (own <= end), (others >= begin) & (others <= end)
    for item in fields:
        for joint in (name for name in a.names if name in b.names):
            one, other = (_by_name(log, item, [joint])[:, 0] for log in (a, b))
            known, seen = np.isfinite(one), np.isfinite(other)
            if not known.any() or not seen.any():
                only_a, only_b = int(known.sum()), int(seen.sum())
                if only_a or only_b:
                    nothing = np.empty(0)
                    yield _Aligned(item, joint, nothing, nothing, nothing, only_a, only_b)
                continue
            # A value of one log next to a lost one of the other has no partner.
            lost, missed = inside & ~known, inside_other & ~seen
            time = np.union1d(own[inside & known], others[inside_other & seen])
            time = time[~np.isin(time, own[lost]) & ~np.isin(time, others[missed])]
            left = np.interp(time, own[known], one[known], np.nan, np.nan)
            right = np.interp(time, others[seen], other[seen], np.nan, np.nan)
            common = np.isfinite(left) & np.isfinite(right)
            yield _Aligned(
                item,
                joint,
                time[common],
                left[common],
                right[common],
                only_a=int(missed.sum()),
                only_b=int(lost.sum()),
            )


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
