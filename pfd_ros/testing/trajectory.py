# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The motion of an arm under a controller: arrays, measures, and assertions about them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pfd_ros.testing import metrics
from pfd_ros.testing.metrics import Array

# One joint by name, several, or all.
Joints: TypeAlias = str | Sequence[str] | None
# More limits are not listed in the text of a failed assertion.
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


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A run: in row k the state that the controller was given, and its answer.

    Units are rad, rad/s and N m, or m, m/s and N. `metrics` defines the measures by formulas.

    Attributes
    ----------
    time
        Stamps of the states (N,), s of simulated time: above zero, as zero is no time to ROS. It
        goes on from run to run.
    q, qd
        Positions and velocities as `joint_states` tells them, (N, n).
    tau
        The efforts that the controller commanded then, (N, n). After a run over topics, where a
        controller may command otherwise: the efforts that the next state told.
    names
        Joints of the columns, in published order.
    limits
        Those of the robot's model.
    """

    time: Array
    q: Array
    qd: Array
    tau: Array
    names: tuple[str, ...]
    limits: Limits = field(repr=False)

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

    def limits_hit(self) -> list[LimitHit]:
        """Return the first sample at or beyond each limit, in the order of time."""
        return sorted(self._hits(), key=lambda hit: hit.time)

    def _hits(self) -> Iterator[LimitHit]:
        lower, upper, velocity, effort = self.limits
        for kind, values, least, most in (
            ('position', self.q, lower, upper),
            ('velocity', self.qd, -velocity, velocity),
            ('effort', self.tau, -effort, effort),
        ):
            for j, joint in enumerate(self.names):
                k = metrics.first_beyond(values[:, j], least[j], most[j])
                if k is not None:
                    value = float(values[k, j])
                    bound = float(least[j] if value <= least[j] else most[j])
                    yield LimitHit(joint, kind, float(self.time[k]), value, bound)

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
        for j in self._columns(joint):
            error = np.where(late, np.abs(self.q[:, j] - goals[j]), 0.0)
            k = int(np.argmax(~(error <= within)))
            if not error[k] <= within:
                raise AssertionError(
                    f'joint {self.names[j]!r} is {error[k]:.6g} from its target {goals[j]:.6g} at '
                    f't = {self.time[k]:.6g} s, expected within {within:.6g} from '
                    f't = {self.time[0] + by:.6g} s on'
                )

    def assert_overshoot_below(
        self, bound: float, target: ArrayLike, *, joint: Joints = None
    ) -> None:
        """Assert that joints go beyond their target by less than `bound` of their step.

        A joint without a step is an error: name those that have one.
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
                raise AssertionError(
                    f'joint {self.names[j]!r} is at {self.q[k, j]:.6g} at '
                    f't = {self.time[k]:.6g} s, {100 * shares[j]:.4g} % of its step beyond the '
                    f'target {goals[j]:.6g}, expected below {100 * bound:.4g} %'
                )

    def assert_torque_rate_below(self, bound: ArrayLike, *, joint: Joints = None) -> None:
        """Assert that efforts change by less than `bound`, (n,) or one number, N m/s or N/s."""
        __tracebackhide__ = True
        bounds = self._per_joint('bound', bound)
        for j in self._columns(joint):
            found = metrics.rates(self.time, self.tau[:, j])
            if len(found) and not found.max() < bounds[j]:
                k = int(np.argmax(found))
                raise AssertionError(
                    f'effort of joint {self.names[j]!r} changes by {found[k]:.6g} per second at '
                    f't = {self.time[k + 1]:.6g} s, from {self.tau[k, j]:.6g} to '
                    f'{self.tau[k + 1, j]:.6g}, expected below {bounds[j]:.6g} per second'
                )

    def assert_no_limit_hit(self) -> None:
        """Assert that no position, velocity or effort reaches a limit of the robot's model."""
        __tracebackhide__ = True
        hits = self.limits_hit()
        shown = '; '.join(str(hit) for hit in hits[:MOST_LISTED])
        if hits:
            raise AssertionError(f'{shown}{"; ..." if len(hits) > MOST_LISTED else ""}')

    def _columns(self, joint: Joints) -> list[int]:
        if joint is None:
            return list(range(len(self.names)))
        return [self.index(name) for name in ([joint] if isinstance(joint, str) else joint)]

    def _per_joint(self, name: str, value: ArrayLike) -> Array:
        """Return a number for each joint (n,); one number stands for all."""
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

    def __init__(self, count: int, joints: int) -> None:
        self.count = 0
        self.time = np.empty(count)
        self.q, self.qd, self.tau = (np.empty((count, joints)) for _ in range(3))

    def trajectory(self, names: tuple[str, ...], limits: Limits) -> Trajectory:
        """Return the rows so far."""
        rows = slice(self.count)
        time, q, qd, tau = (np.array(x[rows]) for x in (self.time, self.q, self.qd, self.tau))
        return Trajectory(time, q, qd, tau, names, limits)
