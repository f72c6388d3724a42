# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The motion of an arm under a controller: arrays, measures, and assertions about them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pfd_ros.motion import metrics
from pfd_ros.motion.metrics import Array
from pfd_ros.motion.symptoms import symptoms

# One joint by name, several, or all.
Joints: TypeAlias = str | Sequence[str] | None
# Attribute of a failed assertion: its time [s].
MOMENT = 'motion_time'
# More limits are not listed in a failed assertion.
MOST_LISTED = 5


class Limits(NamedTuple):
    """Limits of the robot's model, each (n,) in published order; infinite where it has none."""

    position_lower: Array
    position_upper: Array
    velocity: Array
    effort: Array


class LimitHit(NamedTuple):
    """The first sample at or beyond a limit; kind 'position', 'velocity' or 'effort'."""

    joint: str
    kind: str
    time: float
    value: float
    bound: float

    def __str__(self) -> str:
        return (
            f'{self.kind} of joint {self.joint!r} is {self.value:.6g} at t = {self.time:.6g} s, '
            f'expected within its limit {self.bound:.6g}'
        )


class ComputationTime(NamedTuple):
    """Wall time that a controller takes for a command, s, and its control period, s.

    `motion.compute_time` states what it includes; `p99` is the 99th percentile.
    """

    median: float
    p99: float
    longest: float
    period: float

    def __str__(self) -> str:
        told = (
            f'{name} {1e3 * seconds:.3g} ms ({100 * seconds / self.period:.3g} %)'
            for name, seconds in zip(self._fields, self[:3], strict=False)
        )
        return f'{", ".join(told)} of the control period of {1e3 * self.period:.4g} ms'


def failure(text: str, time: float) -> AssertionError:
    """Return the error of a failed assertion, with the time in the motion at which it fails."""
    error = AssertionError(text)
    # No subclass: pytest would print its full name in front of the text.
    error.__dict__[MOMENT] = float(time)
    return error


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A run: in row k the state that the controller was given, and its answer.

    Units are rad, rad/s and N m, or m, m/s and N. `metrics` defines the measures by formulas.

    Attributes
    ----------
    time
        Stamps of the states (N,), s of simulated time, above zero, since zero means no time in
        ROS. It continues from run to run.
    q, qd
        Positions and velocities of `joint_states`, (N, n).
    tau
        Commanded efforts, (N, n). After a run over topics: the efforts in the next state.
    names
        Joints of the columns, in published order.
    limits
        Limits of the robot's model.
    compute_time
        Wall time that the controller took for each command (N,), s. Of a callback: the call alone.
        Over topics: from the publication of the state to the reception of the command, which
        includes the transport of both messages and the executor. Of an arm in another process
        with nodes: from one state to the next, which includes the step of the arm too.
        Empty if nothing was measured.
    period
        The control period, s of simulated time.
    """

    time: Array
    q: Array
    qd: Array
    tau: Array
    names: tuple[str, ...]
    limits: Limits = field(repr=False)
    compute_time: Array = field(default_factory=lambda: np.empty(0), repr=False)
    period: float = math.nan

    def index(self, joint: str) -> int:
        """Return the column of a joint."""
        if joint not in self.names:
            raise ValueError(f'joint is {joint!r}, expected one of {list(self.names)}')
        return self.names.index(joint)

    def settling_time(self, target: ArrayLike, within: float) -> Array:
        """Return the settling time of each joint (n,), s from the first row; inf if none.

        Parameters
        ----------
        target
            Where the joints should rest, (n,) or one number for all, rad or m.
        within
            Largest distance from there, rad or m.
        """
        goals = self._per_joint('target', target)
        columns = zip(self.q.T, goals, strict=True)
        return np.array([metrics.settling_time(self.time, q, r, within) for q, r in columns])

    def overshoot(self, target: ArrayLike) -> Array:
        """Return the overshoot of each joint (n,) as a share of its step; NaN where it has none.

        `target` is (n,) or one number for all, rad or m. A joint has no step whose target is its
        first position.
        """
        goals = self._per_joint('target', target)
        return np.array([metrics.overshoot(q, r) for q, r in zip(self.q.T, goals, strict=True)])

    def torque_rate(self) -> Array:
        """Return the largest rate of change of the effort of each joint (n,), N m/s or N/s."""
        if len(self.time) < 2:
            return np.zeros(len(self.names))
        return np.array([metrics.rates(self.time, tau).max() for tau in self.tau.T])

    def computation_time(self) -> ComputationTime:
        """Return median, 99th percentile and maximum of `compute_time`; ValueError without one."""
        if not len(self.compute_time):
            raise ValueError('compute_time is empty: nothing was measured')
        median, p99, longest = np.percentile(self.compute_time, (50, 99, 100)).tolist()
        return ComputationTime(median, p99, longest, self.period)

    def limits_hit(self) -> list[LimitHit]:
        """Return the first sample at or beyond each limit, in the order of time."""
        return sorted(self._hits(), key=lambda hit: hit.time)

    def _hits(self) -> Iterator[LimitHit]:
        for j, joint in enumerate(self.names):
            for kind, values, least, most in self._bounds(j):
                k = metrics.first_beyond(values, least, most)
                if k is not None:
                    value = float(values[k])
                    bound = least if value <= least else most
                    yield LimitHit(joint, kind, float(self.time[k]), value, bound)

    def _bounds(self, j: int) -> list[tuple[str, Array, float, float]]:
        """Return the name of each limit of a joint, the bounded values, and the bounds."""
        lower, upper, velocity, effort = (float(limit[j]) for limit in self.limits)
        return [
            ('position', self.q[:, j], lower, upper),
            ('velocity', self.qd[:, j], -velocity, velocity),
            ('effort', self.tau[:, j], -effort, effort),
        ]

    def symptoms(self, target: ArrayLike | None = None, joint: Joints = None) -> list[str]:
        """Return a diagnosis of each joint, one line each, as in failed assertions.

        Oscillation with frequency and growth, divergence, or a steady offset from the target; the
        share of the time at the torque limit; the first sample beyond a limit. `target` is as for
        settling_time. pfd_ros.motion.symptoms defines the measures.
        """
        goals = None if target is None else self._per_joint('target', target)
        return [
            f'{self.names[j]}: '
            + symptoms(
                self.time,
                self.q[:, j],
                self.qd[:, j],
                self.tau[:, j],
                target=None if goals is None else float(goals[j]),
                limits=self._bounds(j),
                period=self.period,
            )
            for j in self._columns(joint)
        ]

    def _diagnosis(self, target: ArrayLike | None, columns: Sequence[int]) -> str:
        """Return the symptoms of some joints, for a failed assertion."""
        lines = self.symptoms(target, [self.names[j] for j in columns])
        return ''.join(f'\n  {line}' for line in lines)

    def assert_settles(
        self, target: ArrayLike, *, within: float, by: float, joint: Joints = None
    ) -> None:
        """Assert that joints stay `within` rad or m of their target from `by` s on.

        `by` counts from the first row; `target` is as for settling_time.
        """
        __tracebackhide__ = True
        goals = self._per_joint('target', target)
        late = self.time - self.time[0] >= by
        if not late.any():
            raise ValueError(
                f'by is {by:.6g} s, expected at most the {self.time[-1] - self.time[0]:.6g} s '
                'of the trajectory'
            )
        errors = np.where(late[:, np.newaxis], np.abs(self.q - goals), 0.0)
        outside = [j for j in self._columns(joint) if not (errors[:, j] <= within).all()]
        if outside:
            j = outside[0]
            k = int(np.argmax(~(errors[:, j] <= within)))
            raise failure(
                f'joint {self.names[j]!r} is {errors[k, j]:.6g} from its target {goals[j]:.6g} at '
                f't = {self.time[k]:.6g} s, expected within {within:.6g} from '
                f't = {self.time[0] + by:.6g} s on{self._diagnosis(target, outside)}',
                self.time[k],
            )

    def assert_overshoot_below(
        self, bound: float, target: ArrayLike, *, joint: Joints = None
    ) -> None:
        """Assert that joints go beyond their target by less than `bound` of their step.

        A joint without a step is an error: name the joints with a step.
        """
        __tracebackhide__ = True
        goals, shares = self._per_joint('target', target), self.overshoot(target)
        for j in self._columns(joint):
            if np.isnan(shares[j]):
                raise ValueError(
                    f'joint {self.names[j]!r} starts at its target {goals[j]:.6g} and has no '
                    'overshoot; name the joints that make a step: joint=...'
                )
            k = int(np.argmax((self.q[:, j] - goals[j]) / (goals[j] - self.q[0, j])))
            if not shares[j] < bound:
                raise failure(
                    f'joint {self.names[j]!r} is at {self.q[k, j]:.6g} at '
                    f't = {self.time[k]:.6g} s, {100 * shares[j]:.4g} % of its step beyond the '
                    f'target {goals[j]:.6g}, expected below {100 * bound:.4g} %'
                    f'{self._diagnosis(target, [j])}',
                    self.time[k],
                )

    def assert_torque_rate_below(self, bound: ArrayLike, *, joint: Joints = None) -> None:
        """Assert that efforts change by less than `bound`, (n,) or one number, N m/s or N/s."""
        __tracebackhide__ = True
        bounds = self._per_joint('bound', bound)
        for j in self._columns(joint):
            found = metrics.rates(self.time, self.tau[:, j])
            if len(found) and not found.max() < bounds[j]:
                k = int(np.argmax(found))
                raise failure(
                    f'effort of joint {self.names[j]!r} changes by {found[k]:.6g} per second at '
                    f't = {self.time[k + 1]:.6g} s, from {self.tau[k, j]:.6g} to '
                    f'{self.tau[k + 1, j]:.6g}, expected below {bounds[j]:.6g} per second'
                    f'{self._diagnosis(None, [j])}',
                    self.time[k + 1],
                )

    def assert_computes_within(self, seconds: float, *, quantile: float = 0.99) -> None:
        """Assert that a share `quantile` of the commands takes at most `seconds` of wall time.

        The simulated arm waits for its controller; a real one does not. A busy machine makes all
        times longer: leave a margin.
        """
        __tracebackhide__ = True
        if not 0.0 <= quantile <= 1.0:
            raise ValueError(f'quantile is {quantile!r}, expected 0 to 1')
        told, found = self.computation_time(), float(np.quantile(self.compute_time, quantile))
        if not found <= seconds:
            k = int(np.argmax(self.compute_time))
            raise failure(
                f'the controller takes {1e3 * found:.4g} ms for a command (quantile '
                f'{quantile:g}), expected at most {1e3 * seconds:.4g} ms; {told}; longest at '
                f't = {self.time[k]:.6g} s',
                self.time[k],
            )

    def assert_no_limit_hit(self) -> None:
        """Assert that no position, velocity or effort reaches a limit of the robot's model."""
        __tracebackhide__ = True
        hits = self.limits_hit()
        shown = '; '.join(str(hit) for hit in hits[:MOST_LISTED])
        if hits:
            joints = sorted({self.index(hit.joint) for hit in hits[:MOST_LISTED]})
            more = '; ...' if len(hits) > MOST_LISTED else ''
            raise failure(f'{shown}{more}{self._diagnosis(None, joints)}', hits[0].time)

    def _columns(self, joint: Joints) -> list[int]:
        if joint is None:
            return list(range(len(self.names)))
        return [self.index(name) for name in ([joint] if isinstance(joint, str) else joint)]

    def _per_joint(self, name: str, value: ArrayLike) -> Array:
        """Return a number for each joint (n,); one number means all."""
        array = np.asarray(value, np.float64)
        count = len(self.names)
        if array.shape not in ((), (count,)):
            raise ValueError(
                f'{name} has shape {array.shape}, expected one number or ({count},), '
                f'one for each of {list(self.names)}'
            )
        return np.broadcast_to(array, (count,))


class Rows:
    """The rows of a trajectory while it grows."""

    def __init__(self, count: int, joints: int, period: float) -> None:
        self.count, self.period = 0, period
        self.time, self.compute_time = np.empty(count), np.empty(count)
        self.q, self.qd, self.tau = (np.empty((count, joints)) for _ in range(3))

    @property
    def size(self) -> int:
        """Bytes of all rows."""
        return sum(x.nbytes for x in (self.time, self.compute_time, self.q, self.qd, self.tau))

    def trajectory(self, names: tuple[str, ...], limits: Limits) -> Trajectory:
        """Return the rows so far."""
        rows = slice(self.count)
        time, q, qd, tau, spent = (
            np.array(x[rows]) for x in (self.time, self.q, self.qd, self.tau, self.compute_time)
        )
        return Trajectory(time, q, qd, tau, names, limits, spent, self.period)
