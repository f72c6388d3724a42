# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The motion of an arm under a controller: arrays, measures, and assertions about them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

import pfd_core as pfd
from pfd_ros.messages.joints import JOINT_FIELDS, unit_of
from pfd_ros.motion import metrics
from pfd_ros.motion.metrics import Array
from pfd_ros.motion.symptoms import Samples, diagnosis, text_of
from pfd_ros.text import one_line

# One joint by name, several, or all.
Joints: TypeAlias = str | Sequence[str] | None
# Values in each row (N, k), one row for all (k,), or a function of the time [s] that returns one.
Reference: TypeAlias = ArrayLike | Callable[[float], ArrayLike]
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
    unit: str

    def __str__(self) -> str:
        return (
            f'{self.kind} of joint {self.joint!r} is {self.value:.6g} {self.unit} at '
            f't = {self.time:.6g} s, expected within its limit {self.bound:.6g} {self.unit}'
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


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A run: in row k the state that the controller was given, and the effort that followed.

    Units are rad, rad/s and N m, or m, m/s and N. `metrics` defines the measures by formulas.

    Attributes
    ----------
    time
        Stamps of the states (N,), s of simulated time, above zero, since zero means no time in
        ROS. It continues from run to run.
    q, qd
        Positions and velocities of `joint_states`, (N, n).
    tau
        Efforts of the next state, (N, n): what acted, with all limits of the arm.
    names
        Joints of the columns, in published order.
    robot, limits
        The robot, and the limits of its model.
    compute_time
        Wall time that the controller took for a command (N,), s; NaN for states without command.
        Of a callback: the call alone. Over topics: from the publication of the state or the clock
        tick to the publication of the command that followed.
    period
        The control period, s of simulated time: the median time between two commands.
    commanded
        Whether each joint was commanded at all (n,); the others stay braked.
    notes
        Why the run may differ another time; empty: it has the same bits each time. Timers that
        are not on the ticks, and controllers that have stopped commanding, are named, too.
    stopped
        Of a log that was run again: why the simulation failed, at the end of the motion, or ''.
    """

    time: Array
    q: Array
    qd: Array
    tau: Array
    names: tuple[str, ...]
    limits: Limits = field(repr=False)
    robot: pfd.Robot | None = field(default=None, repr=False)
    compute_time: Array = field(default_factory=lambda: np.empty(0), repr=False)
    period: float = math.nan
    commanded: Sequence[bool] = field(default=(), repr=False)
    notes: list[str] = field(default_factory=list)
    stopped: str = ''

    def index(self, joint: str) -> int:
        """Return the column of a joint."""
        if joint not in self.names:
            raise ValueError(f'joint is {joint!r}, expected one of {list(self.names)}')
        return self.names.index(joint)

    def tip(self) -> Array:
        """Return the positions of the tip in the base frame, (N, 3) in m."""
        if self.robot is None:
            raise ValueError('the motion has no robot')
        order = [self.names.index(name) for name in self.robot.joint_names]
        poses: Array = pfd.compile_kernel(self.robot, quantity='tip_pose')(self.q[:, order])
        return poses[:, :3, 3]

    def settling_time(self, target: ArrayLike, within: float) -> Array:
        """Return the settling time of each joint (n,), s from the first row; inf if none.

        `target` is where the joints should rest, (n,) or one number for all, and `within` the
        largest distance from there, rad or m.
        """
        _check_bounds(within=within)
        columns = zip(self.q.T, self._per_joint('target', target), strict=True)
        return np.array([metrics.settling_time(self.time, q, r, within) for q, r in columns])

    def overshoot(self, target: ArrayLike) -> Array:
        """Return the overshoot of each joint (n,) as a share of its step; NaN where it has none.

        `target` is (n,) or one number for all, rad or m. A joint has no step whose target is its
        first position.
        """
        columns = zip(self.q.T, self._per_joint('target', target), strict=True)
        return np.array([metrics.overshoot(q, r) for q, r in columns])

    def torque_rate(self) -> Array:
        """Return the largest rate of change of the effort of each joint (n,), N m/s or N/s."""
        return np.array([metrics.rates(self.time, tau).max(initial=0.0) for tau in self.tau.T])

    def computation_time(self) -> ComputationTime:
        """Return median, 99th percentile and maximum of `compute_time`; ValueError without one."""
        measured = self.compute_time[np.isfinite(self.compute_time)]
        if not len(measured):
            raise ValueError('compute_time is empty: nothing was measured')
        median, p99, longest = np.percentile(measured, (50, 99, 100)).tolist()
        return ComputationTime(median, p99, longest, self.period)

    def limits_hit(self) -> list[LimitHit]:
        """Return the first sample at or beyond each limit, in the order of time; NaN hits none."""
        hits = [
            LimitHit(joint, kind, float(self.time[k]), value, bound, self._unit(kind, j))
            for j, joint in enumerate(self.names)
            for k, kind, value, bound in self._samples(j).hits
        ]
        return sorted(hits, key=lambda hit: hit.time)

    def _samples(self, j: int, target: float | Array | None = None) -> Samples:
        lower, upper, speed, effort = (float(limit[j]) for limit in self.limits)
        bounds = (lower, upper), (-speed, speed), (-effort, effort)
        return Samples(
            *(self.time, self.q[:, j], self.qd[:, j], self.tau[:, j]),
            target=target,
            limits=dict(zip(JOINT_FIELDS, bounds, strict=True)),
            units={item: self._unit(item, j) for item in JOINT_FIELDS},
            period=self.period,
        )

    def _unit(self, item: str, j: int) -> str:
        return unit_of(item, self.robot, self.names[j : j + 1])

    def symptoms(self, target: Reference | None = None, joint: Joints = None) -> list[str]:
        """Return a diagnosis of each joint, one line each, as in failed assertions.

        `target` is a position as for settling_time, or a reference as for assert_tracks.
        pfd_ros.motion.symptoms defines the measures.
        """
        goals = None if target is None else self._rows('target', target, len(self.names))
        if goals is not None and (goals == goals[0]).all():
            goals = goals[:1]
        lines = []
        for j in self._columns(joint):
            goal = None if goals is None else goals[0 if len(goals) == 1 else ..., j]
            commanded = bool(self.commanded[j]) if len(self.commanded) else True
            found = diagnosis(self._samples(j, goal), commanded=commanded)
            lines.append(f'{self.names[j]}: {text_of(found)}')
        return lines

    def _fail(
        self,
        text: str,
        k: int,
        joints: Sequence[int] = (),
        goals: Array | None = None,
        within: float = math.inf,
    ) -> AssertionError:
        """Return the error of an assertion that fails in row k, with a diagnosis of some joints.

        For the page, it has the time, the goals (N, n), and the distance from them.
        """
        lines = self.symptoms(goals, [self.names[j] for j in joints]) if joints else []
        error = AssertionError('\n  '.join([text, *lines]))
        reference = None if goals is None else (self.names, self.time, goals, within)
        # No subclass: pytest would print its full name in front of the text.
        error.__dict__['motion'] = float(self.time[k]), reference
        return error

    def assert_settles(
        self, target: ArrayLike, *, within: float, by: float, joint: Joints = None
    ) -> None:
        """Assert that joints stay `within` rad or m of their target from `by` s on.

        `by` counts from the first row; `target` is as for settling_time.
        """
        __tracebackhide__ = True
        goals = np.broadcast_to(self._per_joint('target', target), self.q.shape)
        self._check_errors(np.abs(self.q - goals), goals, joint, within, math.inf, ('by', by))

    def assert_tracks(
        self,
        reference: Reference,
        *,
        within: float = math.inf,
        rms: float = math.inf,
        after: float = 0.0,
        joint: Joints = None,
    ) -> None:
        """Assert that joints follow a reference.

        `reference` has the positions (N, n) at the times of the motion, or is a function of the
        time [s] that returns (n,). `within` bounds the error of each joint in any row, and `rms`
        its root mean square, rad or m. Errors before `after` s from the first row do not count.
        """
        __tracebackhide__ = True
        goals = self._rows('reference', reference, len(self.names))
        self._check_errors(np.abs(self.q - goals), goals, joint, within, rms, ('after', after))

    def assert_tip_tracks(
        self,
        reference: Reference,
        *,
        within: float = math.inf,
        rms: float = math.inf,
        after: float = 0.0,
    ) -> None:
        """Assert that the tip follows a reference: its positions (N, 3), one, or a function.

        `within` and `rms` bound the distance in m; `after` is as for assert_tracks. With one
        position, it asserts that the tip stays there.
        """
        __tracebackhide__ = True
        errors = np.linalg.norm(self.tip() - self._rows('reference', reference, 3), axis=1)
        self._check_errors(errors[:, np.newaxis], None, None, within, rms, ('after', after))

    def _check_errors(
        self,
        errors: Array,
        goals: Array | None,
        joint: Joints,
        within: float,
        rms: float,
        after: tuple[str, float],
    ) -> None:
        """Check distances (N, n) from goals, or (N, 1) of the tip; `after` is named."""
        __tracebackhide__ = True
        _check_bounds(within=within, rms=rms, **dict([after]))
        if within == rms == math.inf:
            raise ValueError('expected within=..., rms=... or both')
        late = self.time - self.time[0] >= after[1]
        if not late.any():
            raise ValueError(
                f'{after[0]} is {after[1]:.6g} s, expected at most the '
                f'{self.time[-1] - self.time[0]:.6g} s of the trajectory'
            )
        first = int(np.argmax(late))
        columns = [0] if goals is None else self._columns(joint)
        means = np.sqrt(np.mean(errors[first:] ** 2, axis=0))
        bad = ~((errors[first:] <= within).all(axis=0) & (means <= rms))
        # The one that is at fault may be any of them.
        joints = [] if goals is None else [j for j in columns if bad[j]]
        for j in columns:
            name = 'the tip' if goals is None else f'joint {self.names[j]!r}'
            unit = 'm' if goals is None else self._unit('position', j)
            column = errors[first:, j]
            if not (column <= within).all():
                k = first + int(np.argmax(~(column <= within)))
                target = '' if goals is None else f' {goals[k, j]:.6g} {unit}'
                raise self._fail(
                    f'{name} is {errors[k, j]:.6g} {unit} from its target{target} at '
                    f't = {self.time[k]:.6g} s, expected within {within:.6g} {unit} from '
                    f't = {self.time[first]:.6g} s on',
                    *(k, joints, goals, within),
                )
            if not means[j] <= rms:
                k = first + int(np.argmax(column))
                raise self._fail(
                    f'the error of {name} has an rms of {means[j]:.6g} {unit}, expected at most '
                    f'{rms:.6g} {unit}; the largest is {errors[k, j]:.6g} {unit} at '
                    f't = {self.time[k]:.6g} s',
                    *(k, joints, goals, rms),
                )

    def assert_overshoot_below(
        self, bound: float, target: ArrayLike, *, joint: Joints = None
    ) -> None:
        """Assert that joints go beyond their target by less than `bound` of their step.

        A joint without a step is an error: name the joints with a step.
        """
        __tracebackhide__ = True
        _check_bounds(bound=bound)
        goals, shares = self._per_joint('target', target), self.overshoot(target)
        for j in self._columns(joint):
            if self.q[0, j] == goals[j]:
                raise ValueError(
                    f'joint {self.names[j]!r} starts at its target {goals[j]:.6g} and has no '
                    'overshoot; name the joints that make a step: joint=...'
                )
            beyond = (self.q[:, j] - goals[j]) * np.sign(goals[j] - self.q[0, j])
            k = int(np.argmax(beyond))
            if not shares[j] < bound:
                unit = self._unit('position', j)
                raise self._fail(
                    f'joint {self.names[j]!r} is at {self.q[k, j]:.6g} {unit} at '
                    f't = {self.time[k]:.6g} s, {100 * shares[j]:.4g} % of its step beyond the '
                    f'target {goals[j]:.6g} {unit}, expected below {100 * bound:.4g} %',
                    *(k, [j], np.broadcast_to(goals, self.q.shape)),
                )

    def assert_torque_rate_below(self, bound: ArrayLike, *, joint: Joints = None) -> None:
        """Assert that efforts change by less than `bound`, (n,) or one number, N m/s or N/s."""
        __tracebackhide__ = True
        bounds = self._per_joint('bound', bound)
        for j in self._columns(joint):
            self._check_known('effort', j)
            found = metrics.rates(self.time, self.tau[:, j])
            if len(found) and not found.max() < bounds[j]:
                k, unit = int(np.argmax(found)), self._unit('effort', j)
                rate = f'{unit}/s' if ' or ' not in unit else f'({unit})/s'
                raise self._fail(
                    f'effort of joint {self.names[j]!r} changes by {found[k]:.6g} {rate} at '
                    f't = {self.time[k + 1]:.6g} s, from {self.tau[k, j]:.6g} {unit} to '
                    f'{self.tau[k + 1, j]:.6g} {unit}, expected below {bounds[j]:.6g} {rate}',
                    *(k + 1, [j]),
                )

    def assert_computes_within(self, seconds: float, *, quantile: float = 0.99) -> None:
        """Assert that a share `quantile` of the commands takes at most `seconds` of wall time.

        The simulated arm waits for its controller; a real one does not. A busy machine makes all
        times longer: leave a margin.
        """
        __tracebackhide__ = True
        if not 0.0 <= quantile <= 1.0:
            raise ValueError(f'quantile is {quantile!r}, expected 0 to 1')
        _check_bounds(seconds=seconds)
        told, found = self.computation_time(), float(np.nanquantile(self.compute_time, quantile))
        if not found <= seconds:
            k = int(np.nanargmax(self.compute_time))
            raise self._fail(
                f'the controller takes {1e3 * found:.4g} ms for a command (quantile '
                f'{quantile:g}), expected at most {1e3 * seconds:.4g} ms; {told}; longest at '
                f't = {self.time[k]:.6g} s',
                k,
            )

    def assert_no_limit_hit(self, kind: str | None = None, *, joint: Joints = None) -> None:
        """Assert that no position, velocity or effort reaches a limit of the robot's model.

        `kind` chooses one of the three.
        """
        __tracebackhide__ = True
        if kind not in (None, *JOINT_FIELDS):
            raise ValueError(f'kind is {kind!r}, expected one of {list(JOINT_FIELDS)}')
        if kind is not None:
            for j in self._columns(joint):
                self._check_known(kind, j)
        chosen = {self.names[j] for j in self._columns(joint)}
        hits = [x for x in self.limits_hit() if x.joint in chosen and kind in (None, x.kind)]
        if hits:
            shown = hits[:MOST_LISTED]
            text = '; '.join([*map(str, shown), *['...'] * (len(hits) > MOST_LISTED)])
            if hits[0].kind == 'position' and hits[0].time == self.time[0]:
                text += '; the motion begins there: initial_positions or set_state changes it'
            joints = sorted({self.index(hit.joint) for hit in shown})
            raise self._fail(text, int(np.searchsorted(self.time, hits[0].time)), joints)

    def _columns(self, joint: Joints) -> list[int]:
        if joint is None:
            return list(range(len(self.names)))
        if not len(joint):
            raise ValueError(f'joint is {joint!r}, expected a joint or several')
        return [self.index(name) for name in ([joint] if isinstance(joint, str) else joint)]

    def _check_known(self, kind: str, j: int) -> None:
        """Raise ValueError if a motion, of a log, has no number of a kind for a joint."""
        values = dict(zip(JOINT_FIELDS, (self.q, self.qd, self.tau), strict=True))[kind]
        if np.isnan(values[:, j]).all():
            raise ValueError(f'the motion has no {kind} of joint {self.names[j]!r}')

    def _per_joint(self, name: str, value: ArrayLike) -> Array:
        """Return a number for each joint (n,), none of them NaN; one number means all."""
        shape = (len(self.names),)
        text = f'one number or {shape}, one for each of {list(self.names)}, and none NaN'
        return np.broadcast_to(
            checked_numbers(name, value, ((), shape), text, lambda x: ~np.isnan(x)), shape
        )

    def _rows(self, name: str, value: Reference, columns: int) -> Array:
        """Return finite values in each row, (N, columns)."""
        rows = [value(t) for t in self.time.tolist()] if callable(value) else value
        shape = len(self.time), columns
        text = f'finite numbers in {shape}, ({columns},) or a function of the time that '
        text += 'returns them'
        return np.broadcast_to(checked_numbers(name, rows, ((), (columns,), shape), text), shape)


def checked_numbers(
    name: str,
    value: Any,
    shapes: Collection[tuple[int, ...]],
    expected: str,
    valid: Callable[[Array], Any] = np.isfinite,
) -> Array:
    """Return numbers that have one of some shapes and are valid; ValueError for anything else."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of unequal lengths
        array = np.asarray(value, object)
    if array.dtype.kind not in 'iuf' or array.shape not in shapes or not np.all(valid(array)):
        shape = f' of shape {array.shape}' if array.ndim else ''
        raise ValueError(f'{name} is {one_line(repr(value), 100)}{shape}, expected {expected}')
    return array.astype(np.float64, copy=False)


def _check_bounds(**bounds: float) -> None:
    """Raise ValueError for a bound of an assertion that is not a number or is negative."""
    for name, value in bounds.items():
        checked_numbers(name, value, ((),), 'one number, 0 or above', lambda x: x >= 0.0)
