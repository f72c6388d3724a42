# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories of joints: the arm samples one in each cycle, and the sample is a command.

Points are as joint_trajectory_controller of ros2_control takes them. Between positions the target
moves linearly, with velocities by a cubic, with accelerations too by a quintic; efforts are
linear, and are fed forward. From the state at its start the arm moves to the first point,
continuous joints by half a turn at most, and it holds the last point until another command.
Positions are targets of the servos, so these need gains; efforts alone need none.

A sample is a command like any other: delay, drop-out, limits and reflexes act on it, and the
watchdog rests. After a pause it continues where it was, also with a followed clock. In lockstep
the arm waits for no answer before the last point. The next command or trajectory, a reset, a jump,
a deactivation and a reflex end a trajectory; joints that the command does not name hold the last
target.
Source: ros2_controllers 6.9.0, joint_trajectory_controller/doc/trajectory.rst.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfd_ros.arm.arm import Arm
from pfd_ros.arm.commands import LARGEST_POSITION, check_reach, command, end
from pfd_ros.arm.events import Change, RefusedError
from pfd_ros.arm.state import EFFORT
from pfd_ros.messages.cdr import NANOSECONDS
from pfd_ros.messages.values import decode_trajectory
from pfd_ros.text import cut, listed

TURN = 2.0 * np.pi
# Farther than any joint goes between two points, rad or m: accelerations are not bounded.
FARTHEST = 100 * LARGEST_POSITION
# A start farther ahead is on another clock, ns.
FAR_AHEAD_NS = 3600 * NANOSECONDS


class Plan(NamedTuple):
    """A trajectory: knots, and between two of them a polynomial of the time since the first.

    Attributes
    ----------
    joints
        Places in the model, (k,).
    times_ns
        Simulated times of the N knots, increasing.
    position
        Coefficients (N, 6, k) from the constant on, of the last knot alone the constant, or None.
    effort
        The same, (N, 2, k), or None.
    """

    joints: NDArray[Any]
    times_ns: NDArray[np.int64]
    position: NDArray[Any] | None
    effort: NDArray[Any] | None

    @property
    def end_ns(self) -> int:
        """The time of the last point."""
        return int(self.times_ns[-1])

    def reach(self) -> NDArray[Any]:
        """Return a bound of the positions at all times (k,); NaN or inf where one overflows."""
        if self.position is None:
            return np.zeros(len(self.joints))
        h = np.append(np.diff(self.times_ns), 0)[:, None, None] / NANOSECONDS
        sizes: NDArray[Any] = np.abs(self.position) * h ** np.arange(6)[:, None]
        farthest: NDArray[Any] = sizes.sum(axis=1).max(axis=0)
        return farthest

    def at(
        self, now_ns: int
    ) -> tuple[NDArray[Any] | None, NDArray[Any] | None, NDArray[Any] | None]:
        """Return efforts, positions and velocities at a time, (k,), N m, rad, rad/s or with m."""
        knot = max(int(np.searchsorted(self.times_ns, now_ns, 'right')) - 1, 0)
        t = (now_ns - int(self.times_ns[knot])) / NANOSECONDS
        effort = position = velocity = None
        if self.effort is not None:
            effort = self.effort[knot, 0] + t * self.effort[knot, 1]
        if self.position is not None:
            c = self.position[knot]
            position, velocity = c[5], np.zeros_like(c[5])
            for k in range(4, -1, -1):
                velocity = position + t * velocity
                position = c[k] + t * position
        return effort, position, velocity


def rule(arm: Arm, data: bytes) -> Change:
    """Check a trajectory."""
    found, state = decode_trajectory(data), arm.state
    names, times, values = found.names, np.array(found.times_ns, np.int64), found.values
    joints = _places(arm, names, times, values)
    if state.first.follows_clock and state.until_ns is None:
        raise RefusedError(
            'refused', 'no tick of the clock yet: its start is at no time of the arm'
        )
    start, now = found.stamp_ns or arm.stamp_ns, arm.stamp_ns
    if start < state.reset_ns or start + times[-1] < now:
        raise RefusedError('stale', f'it ends before {now} ns, or is from before a reset')
    if start > now + FAR_AHEAD_NS:
        raise RefusedError('future', f'stamp {start} ns, the arm is at {now} ns: another clock')
    if state.tripped:
        raise RefusedError('refused', state.tripped)
    # From the state that the joints have now.
    first = np.vstack([state.rows[state.now][:2, joints], state.newest[EFFORT, joints]])
    endless = [arm.robot.joint_types[k] == 'continuous' for k in joints]
    with np.errstate(all='ignore'):  # what overflows is refused
        plan = plan_of(joints, start + times, dict(values), now, first, endless)
        reach = plan.reach()
    if plan.effort is not None and not np.isfinite(plan.effort).all():
        raise RefusedError('refused', 'the efforts overflow between two points')
    for k in np.flatnonzero(~(reach <= FARTHEST)):
        text = f'joint {cut(names[k])!r} would go farther than {FARTHEST:g} between two points'
        raise RefusedError('refused', f'{text}: accelerations are too large for their times')
    return _follow, (plan,)


def _places(
    arm: Arm, names: Sequence[str], times: NDArray[np.int64], values: Mapping[str, NDArray[Any]]
) -> NDArray[Any]:
    """Check the points of a trajectory, and return the places of its joints in the arm."""
    if not names:
        raise RefusedError('no_names', 'no joint names')
    if len(set(names)) < len(names):
        raise RefusedError('duplicate_names', 'a joint is named twice')
    strange = [name for name in names if name not in arm.place]
    if strange:
        raise RefusedError('unknown_names', f'no moving joints of the arm: {listed(strange)}')
    if not len(times) or times[0] < 0 or (np.diff(times) <= 0).any():
        raise ValueError('the times of the points do not increase from 0 on, or there is no point')
    for kind, array in values.items():
        wrong = np.argwhere(~np.isfinite(array))
        if len(wrong):
            point, k = wrong[0]
            text = f'{kind} of joint {cut(names[k])!r} at point {point} is {array[point, k]}'
            raise RefusedError('not_finite', text)
    if not {'positions', 'effort'} & values.keys():
        raise RefusedError('no_effort', 'the points have neither positions nor efforts')
    for kind, base in (('velocities', 'positions'), ('accelerations', 'velocities')):
        if kind in values and base not in values:
            raise RefusedError('no_effort', f'{kind} without {base}')
    joints = np.array([arm.place[name] for name in names])
    position, velocity = (values.get(x, np.zeros(0)) for x in ('positions', 'velocities'))
    check_reach(position, velocity)
    if len(velocity) and velocity[-1].any():
        raise RefusedError('refused', 'a velocity of the last point is not zero')
    idle = [x for x, k in zip(names, joints, strict=True) if not arm.actuators.p[k] > 0.0]
    if len(position) and idle:
        raise RefusedError('no_effort', f'no servo gain for the positions of {listed(idle)}')
    return joints


def _follow(arm: Arm, plan: Plan) -> None:
    end(arm.state)
    arm.state.trajectory = plan


def plan_of(
    joints: NDArray[Any],
    times: NDArray[np.int64],
    values: dict[str, NDArray[Any]],
    now: int,
    start: NDArray[Any],
    endless: Sequence[bool],
) -> Plan:
    """Return the plan of points (N, k) at times [ns].

    `start` has positions, velocities and efforts (3, k) of now; endless joints take the short way.
    """
    if 'positions' in values:
        turns = np.round((start[0] - values['positions'][0]) / TURN)
        near = values['positions'] + TURN * np.where(endless, turns, 0.0)
        values = values | {'positions': near}
    if now < times[0]:
        times = np.append(now, times)
        first = {
            'positions': start[0],
            'velocities': start[1],
            'accelerations': np.zeros(len(joints)),
            'effort': start[2],
        }
        values = {kind: np.vstack([first[kind], array]) for kind, array in values.items()}
    h = np.append(np.diff(times), NANOSECONDS)[:, np.newaxis] / NANOSECONDS
    plan = Plan(joints, times, None, None)
    if 'positions' in values:
        plan = plan._replace(position=_splines(h, values))
    if 'effort' in values:
        effort = values['effort']
        slope = np.diff(effort, axis=0, append=effort[-1:]) / h
        plan = plan._replace(effort=np.stack([effort, slope], axis=1))
    return plan


def _splines(h: NDArray[Any], values: dict[str, NDArray[Any]]) -> NDArray[Any]:
    """Return the coefficients (N, 6, k) from each of N knots to the next, `h` (N, 1) s later."""
    q = values['positions']
    found = np.zeros((len(q), 6, q.shape[1]))
    found[:, 0] = q
    # To the next knot; after the last one the target is at rest.
    move = np.diff(q, axis=0, append=q[-1:])
    if 'velocities' not in values:
        found[:, 1] = move / h
        return found
    v = values['velocities']
    # What is left of move, velocity and acceleration at the next knot, as functions of t / h.
    v1 = np.append(v[1:], v[-1:], axis=0)
    found[:, 1] = v
    left, turn = move - h * v, h * (v1 - v)
    if 'accelerations' not in values:
        found[:, 2], found[:, 3] = (3 * left - turn) / (h * h), (turn - 2 * left) / (h * h * h)
        found[-1, 1:] = 0.0
        return found
    a = values['accelerations']
    a1 = np.append(a[1:], a[-1:], axis=0)
    found[:, 2] = a / 2
    left, turn, bend = left - h * h * a / 2, turn - h * h * a, h * h * (a1 - a)
    cube = h * h * h
    found[:, 3] = (10 * left - 4 * turn + bend / 2) / cube
    found[:, 4] = (7 * turn - 15 * left - bend) / (cube * h)
    found[:, 5] = (6 * left - 3 * turn + bend / 2) / (cube * h * h)
    found[-1, 1:] = 0.0
    return found


def advance(arm: Arm) -> None:
    """Command the sample of a trajectory for the coming cycle."""
    plan = arm.state.trajectory
    effort, position, velocity = plan.at(arm.stamp_ns)
    if velocity is not None:
        velocity = np.where(arm.actuators.d[plan.joints] > 0.0, velocity, np.nan)
    # A command ends a trajectory, but not its own.
    arm.state.trajectory = None
    command(arm, plan.joints, effort, position, velocity)
    arm.state.trajectory = plan
