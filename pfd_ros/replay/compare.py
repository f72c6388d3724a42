# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Differences between the JointStates of two logs, of simulated or real arms, joint by joint.

Joints are matched by name, topics of two recordings of ours by role. Both series of a joint are
interpolated linearly at the times of either; two series with the same times are compared value by
value. Simulated clocks have no lag; of others it is estimated from the positions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from itertools import product
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.events import INPUTS
from pfd_ros.messages.joints import JOINT_FIELDS
from pfd_ros.messages.types import CLOCK, JOINT_STATE
from pfd_ros.recording.arrays import LogArrays
from pfd_ros.recording.topic_arrays import TopicArrays
from pfd_ros.text import listed

Array = NDArray[Any]
# Part of the shorter log that two logs overlap at least at any lag.
OVERLAP = 0.5
# Intervals between samples, as multiples of the median one, that are gaps.
GAP = 5.0
# Samples of the grid: an hour at 250 Hz.
GRID = 1_000_000
# Correlation of positions below which an estimated lag means nothing.
WEAK = 0.5
# Times [s], values of a and of b, (N,), by topic, field and joint.
Curve = tuple[Array, Array, Array]
Curves = dict[tuple[str, str, str], Curve]


@dataclass(frozen=True)
class Difference:
    """The difference a - b of one joint in one field of a topic, in the field's unit.

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
    """Two logs compared; times in s."""

    # Time that was added to the first log's to get the second's, beyond `shift`.
    lag: float
    # Of the positions at an estimated lag; None where the lag is known or nothing moves.
    correlation: float | None
    # Difference of the starts where the clocks have nothing in common, else 0.
    shift: float
    # What was compared, and what only the longer log covers, beyond the lag.
    overlap: float
    uncovered: float
    tolerance: float
    differences: tuple[Difference, ...]
    # Missing in the other log: topics; joints, fields of a joint and values after their topic.
    only_in_a: tuple[str, ...]
    only_in_b: tuple[str, ...]
    # Whether each log was closed properly, rather than cut off.
    complete: tuple[bool, bool]
    # Both logs at the compared times.
    curves: Curves = field(repr=False, compare=False)

    @property
    def within(self) -> bool:
        """Whether all of both logs was compared, and no difference exceeds the tolerance."""
        missing = self.only_in_a or self.only_in_b or self.uncovered
        return not missing and all(item.first_at is None for item in self.differences)


class Track(NamedTuple):
    """A joint in one topic: times [s], which do not decrease, and values by field, (k,)."""

    time: Array
    values: dict[str, Array]


def track(states: TopicArrays, joint: str, time: Array) -> Track:
    """Return a joint of a topic whose messages have these times [s], (N,)."""
    rows, column = states.rows(joint), states.names.index(joint)
    return Track(time[rows], {item: states[item][rows, column] for item in JOINT_FIELDS})


def compare(
    a: LogArrays,
    b: LogArrays,
    *,
    tolerance: float = 0.0,
    topics: tuple[str, str] | None = None,
    lag: float | None = None,
) -> Comparison:
    """Compare the JointStates of two logs.

    `tolerance` is the largest allowed difference, in the unit of each field, and `topics` has one
    topic of each log; default all topics of JointStates that both have, by role or name, or the
    only one of each. `lag` is added to times of a to get times of b [s]; default 0 for two
    recordings of ours and two logs with a /clock, else estimated from the positions of the topic
    with most of them, after a shift if the times do not overlap. ValueError if there is nothing to
    compare: no topic, joint or common time, or no clear lag.
    """
    if not 0 <= tolerance < math.inf:
        raise ValueError(f'tolerance must be 0 or more and finite, got {tolerance}')
    if lag is not None and not math.isfinite(lag):
        raise ValueError(f'lag must be finite, got {lag}')
    pairs = [topics] if topics else _pairs(a, b)
    for log, topic in zip((a, b), topics or (), strict=False):
        log.required(topic, JOINT_STATE)
    # The tracks of both logs by pair of topics and joint.
    joints = {pair: _joints(a[pair[0]], b[pair[1]]) for pair in pairs}
    if a.roles and b.roles and not topics:
        # Commands that both arms refused may name the same joints.
        outputs = [pair for pair in pairs if a.roles[pair[0]] not in INPUTS]
        if outputs and not any(joints[pair] for pair in outputs):
            raise ValueError(_no_joint(a, b, outputs[0]))
    fullest = max(joints.values(), key=_positions)
    shift, correlation, spans = 0.0, None, [_span(fullest, side) for side in (0, 1)]
    if lag is None:
        lag = 0.0
        if min(span[1] for span in spans) <= max(span[0] for span in spans):
            shift = spans[1][0] - spans[0][0]
        if not all(log.roles or CLOCK in log.topics.values() for log in (a, b)):
            moved = [(x, y._replace(time=y.time - shift)) for x, y in fullest.values()]
            lag, correlation = estimated_lag(moved)
    if correlation is not None and correlation < WEAK:
        raise ValueError(
            f'no clear lag between {a.path} and {b.path}: at {lag:.6g} s the positions have a '
            f'correlation of {correlation:.2f}, expected at least {WEAK}: state it, as in --lag 0'
        )
    curves: Curves = {}
    only = _without_partner(a, b, pairs, 0), _without_partner(b, a, pairs, 1)
    for pair, item in product(joints, JOINT_FIELDS):
        for name, (x, y) in joints[pair].items():
            curve, missing = aligned(x, y._replace(time=y.time - shift - lag), item)
            for texts, topic, count in zip(only, pair, missing, strict=True):
                if count:
                    texts.append(f'{topic}: {count} values, {item} of {name}')
            if len(curve[0]):
                curves[pair[0], item, name] = curve
    if not curves:
        raise ValueError(f'{_no_joint(a, b, pairs[0])}, lag {lag:.6g} s')
    overlap = max(float(np.ptp(time)) for time, _, _ in curves.values())
    periods = [
        np.diff(x.time) for both in [*fullest.values()][:1] for x in both if len(x.time) > 1
    ]
    edges = abs(lag) + 2 * max((float(np.median(period)) for period in periods), default=0.0)
    return Comparison(
        lag,
        correlation,
        shift,
        overlap,
        max(0.0, max(end - begin for begin, end in spans) - overlap - edges),
        tolerance,
        tuple(difference(place, curve, tolerance) for place, curve in curves.items()),
        tuple(only[0]),
        tuple(only[1]),
        (a.complete, b.complete),
        curves,
    )


def _no_joint(a: LogArrays, b: LogArrays, pair: tuple[str, str]) -> str:
    one, two = a[pair[0]], b[pair[1]]
    counts = f' ({one.unreadable} and {two.unreadable} messages cannot be read)'
    unread = counts if one.unreadable or two.unreadable else ''
    return (
        f'{a.path} and {b.path} have no joint with values at common times: joints are '
        f'{listed(one.names)} and {listed(two.names)}{unread}'
    )


def _pairs(a: LogArrays, b: LogArrays) -> list[tuple[str, str]]:
    """Return the topics to compare: of two recordings of ours by role, else by name."""
    of_a, of_b = (_topics(log, by_role=bool(a.roles and b.roles)) for log in (a, b))
    common = [(of_a[key], of_b[key]) for key in of_a if key in of_b]
    if not common and len(of_a) == len(of_b) == 1:
        common = list(zip(of_a.values(), of_b.values(), strict=True))
    if not common:
        raise ValueError(
            f'no topic of {JOINT_STATE} in both, name one of each: {a.path} has '
            f'{listed(list(of_a.values()))}, {b.path} {listed(list(of_b.values()))}'
        )
    return common


def _topics(log: LogArrays, *, by_role: bool) -> dict[str, str]:
    """Return the topics of JointStates with messages by role or name."""
    found = [t for t in log if log.topics[t] == JOINT_STATE and len(log.received_ns[t])]
    return {log.roles.get(topic, topic) if by_role else topic: topic for topic in found}


def _without_partner(
    log: LogArrays, other: LogArrays, pairs: Sequence[tuple[str, str]], side: int
) -> list[str]:
    """Return the topics, unless some were named or have other names, and joints of one log."""
    taken = {pair[side] for pair in pairs}
    by_role = bool(log.roles and other.roles)
    every = len(pairs) > 1 or by_role or pairs[0][0] == pairs[0][1]
    found = [t for t in _topics(log, by_role=by_role).values() if every and t not in taken]
    for pair in pairs:
        states, others = log[pair[side]], other[pair[1 - side]]
        if states.unreadable > others.unreadable:
            found.append(f'{pair[side]}: {states.unreadable} messages that cannot be read')
        found += [f'{pair[side]}: {name}' for name in states.names if name not in others.names]
    return found


def _joints(a: TopicArrays, b: TopicArrays) -> dict[str, tuple[Track, Track]]:
    """Return the joints of both topics; their times are stamps, unless these decrease."""
    found = {}
    for name in (name for name in a.names if name in b.names):
        both = track(a, name, a.time), track(b, name, b.time)
        if any((np.diff(x.time) < 0).any() for x in both):
            both = track(a, name, a.simulated_time), track(b, name, b.simulated_time)
        found[name] = both
    return found


def _positions(joints: dict[str, tuple[Track, Track]]) -> int:
    return sum(int(np.isfinite(x.values['position']).sum()) for x, _ in joints.values())


def _span(joints: dict[str, tuple[Track, Track]], side: int) -> tuple[float, float]:
    ends = [both[side].time[[0, -1]] for both in joints.values() if len(both[side].time)]
    return (float(np.min(ends)), float(np.max(ends))) if ends else (0.0, 0.0)


def aligned(a: Track, b: Track, item: str) -> tuple[Curve, tuple[int, int]]:
    """Return a field of a joint in both logs, and how many values only a and only b has."""
    own, one, others, two = a.time, a.values[item], b.time, b.values[item]
    finite, seen = np.isfinite(one), np.isfinite(two)
    if len(own) == len(others) and np.array_equal(own, others):
        both = finite & seen
        missing = int((finite & ~seen).sum()), int((seen & ~finite).sum())
        return (own[both], one[both], two[both]), missing
    if not finite.any() or not seen.any():
        return (own[:0],) * 3, (int(finite.sum()), int(seen.sum()))
    begin, end = max(own[0], others[0]), min(own[-1], others[-1])
    # A value of one log next to a lost one of the other has no partner.
    lost, missed = (
        time[(time >= begin) & (time <= end) & ~there]
        for time, there in ((own, finite), (others, seen))
    )
    left, right = known(own, one), known(others, two)
    time = np.union1d(left[0], right[0])
    time = time[(time >= begin) & (time <= end) & ~np.isin(time, lost) & ~np.isin(time, missed)]
    x, y = np.interp(time, *left, np.nan, np.nan), np.interp(time, *right, np.nan, np.nan)
    common = np.isfinite(x) & np.isfinite(y)
    return (time[common], x[common], y[common]), (len(missed), len(lost))


def estimated_lag(joints: Sequence[tuple[Track, Track]]) -> tuple[float, float | None]:
    """Return the lag of the second log [s], and the correlation of all moving joints at this lag.

    The first log at a time t resembles the second at t + lag the most. The lag is 0 where nothing
    moves, and where both logs are equal without one; the correlation is None where nothing moves.
    Positions are compared on a grid at the coarser of the two rates, for all shifts at once by
    FFT, sum (a - b)^2 = sum a^2 + sum b^2 - 2 sum a b, each over the overlap, and the best shift
    is refined by a parabola through its neighbours.
    """
    pairs = [[known(x.time, x.values['position']) for x in both] for both in joints]
    moving = [x for x in pairs if all(len(y) > 1 and np.ptp(y) > 0 for _, y in x)]
    if not moving:
        return 0.0, None
    begin = min(time[0] for both in moving for time, _ in both)
    end = max(time[-1] for both in moving for time, _ in both)
    step = max(float(np.median(np.diff(time))) for both in moving for time, _ in both)
    step = max(step, (end - begin) / GRID)
    grid = np.arange(begin, end + step, step)
    total, count, norm = np.zeros(2 * len(grid) - 1), np.zeros(2 * len(grid) - 1), 0.0
    for one, two in moving:
        x, y = _on_grid(grid, *one), _on_grid(grid, *two)
        there, seen = np.isfinite(x), np.isfinite(y)
        middle = float(np.mean(x[there]))
        x, y = np.where(there, x - middle, 0.0), np.where(seen, y - middle, 0.0)
        total = total + _sums(x**2, seen) + _sums(there, y**2) - 2 * _sums(x, y)
        count = count + _sums(there, seen)
        norm += float(np.sum(x**2) + np.sum(y**2))
    enough = count >= OVERLAP * np.max(count)
    mean = np.where(enough, np.maximum(total, 0.0) / np.maximum(count, 1.0), np.inf)
    best = int(np.argmin(mean))
    zero = len(grid) - 1  # of the lags from -(len - 1) to len - 1
    # Below the rounding of the FFT differences are none.
    rounding = 1e-12 * norm / np.max(count)
    if mean[zero] <= mean[best] + rounding:
        best = zero
    vertex = 0.0
    if mean[best] > rounding and 0 < best < len(mean) - 1:
        left, low, right = mean[best - 1 : best + 2]
        curvature = left - 2 * low + right
        if np.isfinite(curvature) and curvature > rounding:
            vertex = 0.5 * (left - right) / curvature
    lag = float((best - zero + vertex) * step)
    return lag, _correlation(moving, grid, lag)


def known(time: Array, values: Array) -> tuple[Array, Array]:
    """Return finite values at increasing times; of several at one time the last."""
    finite = np.isfinite(values)
    time, values = time[finite], values[finite]
    last = np.append(np.diff(time) > 0, True)[: len(time)]
    return time[last], values[last]


def _correlation(
    moving: Sequence[Sequence[tuple[Array, Array]]], grid: Array, lag: float
) -> float:
    """Return the correlation of all joints, each from its mean, at a lag."""
    sums = np.zeros(3)
    for one, two in moving:
        x, y = _on_grid(grid, *one), _on_grid(grid + lag, *two)
        both = np.isfinite(x) & np.isfinite(y)
        if both.any():
            x, y = x[both] - np.mean(x[both]), y[both] - np.mean(y[both])
            sums += [np.sum(x * y), np.sum(x * x), np.sum(y * y)]
    return float(sums[0] / math.sqrt(sums[1] * sums[2])) if sums[1] * sums[2] > 0 else 0.0


def _sums(x: Array, y: Array) -> Array:
    """Return sum_t x(t) y(t + k) for all k from -(N - 1) to N - 1, by FFT."""
    n = len(x)
    size = 1 << (2 * n - 1).bit_length()
    found = np.fft.irfft(np.conj(np.fft.rfft(x, size)) * np.fft.rfft(y, size), size)
    return np.concatenate([found[size - n + 1 :], found[:n]])


def _on_grid(grid: Array, time: Array, values: Array) -> Array:
    """Return values on a grid, NaN outside their times and in gaps between them."""
    found: Array = np.interp(grid, time, values, np.nan, np.nan)
    after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
    longest = GAP * max(float(np.median(np.diff(time))), float(grid[1] - grid[0]))
    found[time[after] - time[after - 1] > longest] = np.nan
    return found


def difference(place: tuple[str, str, str], curve: Curve, tolerance: float) -> Difference:
    """Return the difference of a curve at a topic, field and joint."""
    time, left, right = curve
    with np.errstate(over='ignore'):  # of a simulation that diverges
        sizes = np.nan_to_num(np.abs(left - right))
        rms = float(np.nan_to_num(np.sqrt(np.mean(sizes**2))))
    worst, beyond = int(np.argmax(sizes)), np.flatnonzero(sizes > tolerance)
    first = float(time[beyond[0]]) if len(beyond) else None
    return Difference(*place, rms, float(sizes[worst]), float(time[worst]), first)


def as_json(found: Comparison) -> dict[str, Any]:
    """Return a comparison without its curves, ready for JSON."""
    values = {name: value for name, value in vars(found).items() if name != 'curves'}
    differences = [asdict(item) for item in found.differences]
    return {'within': found.within, **values, 'differences': differences}


def lines(found: Comparison) -> Iterator[str]:
    """Yield a comparison as lines."""
    shift = f', after a shift of {found.shift:.6f} s between their starts' if found.shift else ''
    if found.correlation is not None:
        shift += f', estimated with a correlation of {found.correlation:.3f}'
    yield f'lag of B {found.lag * 1e3:.3f} ms{shift}; {found.overlap:.3f} s compared'
    for name, complete in zip('AB', found.complete, strict=True):
        if not complete:
            yield f'cut off: {name} was not closed; compared up to the cut'
    for name, missing in (('A', found.only_in_a), ('B', found.only_in_b)):
        yield from (f'only in {name}: {item}' for item in missing)
    if found.uncovered:
        yield f'not compared: {found.uncovered:.3f} s, which only one of the logs covers'
    width = max(len(item.joint) for item in found.differences)
    topic = ''
    for item in found.differences:
        if item.topic != topic:
            topic = item.topic
            yield topic
        where = 'equal' if item.largest == 0 else f'within {found.tolerance:g}'
        if item.first_at is not None:
            where = f'first beyond {found.tolerance:g} at {item.first_at:.6f} s'
        yield (
            f'  {item.field:9}{item.joint:{width}}  rms {item.rms:.3e}  largest '
            f'{item.largest:.3e} at {item.largest_at:.6f} s  {where}'
        )
