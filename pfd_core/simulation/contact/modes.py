# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Modes of the joints: which slide, which stick, and within which bounds.

    H x = c + lambda,   lower <= lambda <= upper where x = 0

is the problem of sticking (x the accelerations, c = tau - bias) and of an impact (x the velocities
after it, c = H qd). Both are the optimality conditions of a strictly convex function, x'Hx/2 - c'x
plus convex terms of single joints, so the solution exists and is unique.

A joint is at rest exactly if its velocity is 0.0. Then static friction, a stop or both may hold
it: it is a candidate. A primal active set starts with all candidates sticking and changes one
joint at a time (`pivot`):

    released joints whose x has the wrong sign     the first one on the line from the last feasible
                                                   x sticks again
    otherwise                                      the sticking joint whose lambda exceeds its
                                                   bounds most is released

Each change with a nonzero step strictly decreases the objective, and a joint that sticks again
after a zero step is not released again, so no active set repeats. The solution for a set is the
forward dynamics of a scene with brakes; lambda is inverse dynamics minus the load. Neither needs
the inertia matrix itself.

Nocedal and Wright, Numerical Optimization, 2nd ed., 16.5 (active sets).

One register holds one number; flags are 1 or 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math

import numpy as np

from pfd_core.dynamics.interface import input_list, program_with_outputs
from pfd_core.dynamics.numbers import Numbers
from pfd_core.machine.lanes import absolute, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model import Plant

# Maximum number of pivots per joint. Random matrices of condition 1e8 need less than four.
PIVOTS = 4


def record_watch(plant: Plant) -> Program:
    """
    Return the program of `watch`, (1,): whether a joint may be at rest or at a stop.

    Inputs are q and qd. If it is 0, the programs for such joints are skipped.
    """
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    q, qd = (input_list(recorder, name, n) for name in ('q', 'qd'))
    margins = [*inside_stops(plant, q)]
    margins += [qd[i] * qd[i] for i in rough_joints(plant)]
    return program_with_outputs(recorder, watch=[negated(smallest(margins))])


def record_directions(n: int) -> Program:
    """Return the program of `direction`, (n,), the signs of the velocities qd."""
    recorder = Recorder(1, 'sequential')
    qd = input_list(recorder, 'qd', n)
    return program_with_outputs(
        recorder, direction=[where(v, 1.0, where(-v, -1.0, 0.0)) for v in qd]
    )


def record_modes(plant: Plant, sticks: bool) -> Program:
    """
    Return the program of the modes in which an integration begins.

    Inputs are q, qd and unbraked, 0 for a braked joint. Outputs, (n,): moving, 0 for a braked or
    sticking joint; candidate; lower and upper, the bounds of a candidate's lambda; last and
    barred, zeros, for `record_pivot`. Output, (1,): busy, whether any joint is a candidate. With
    `sticks` there is an input of this name, flags of the joints that are not released in this
    step.
    """
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    q, qd, unbraked = (input_list(recorder, name, n) for name in ('q', 'qd', 'unbraked'))
    zero = recorder.constant(0.0)
    numbers = Numbers(recorder, plant)
    bound = [zero] * n
    if plant.static_friction is not None:
        bound = [numbers('static_friction', i) for i in range(n)]
    at_lower, at_upper = at_stops(plant, q)
    resting = [negated(absolute(v)) for v in qd]
    bounded = [either(sign_of(bound[i]), either(at_lower[i], at_upper[i])) for i in range(n)]
    candidate = [both(unbraked[i], both(resting[i], bounded[i])) for i in range(n)]
    lower = [where(at_upper[i], -math.inf, -bound[i]) for i in range(n)]
    upper = [where(at_lower[i], math.inf, bound[i]) for i in range(n)]
    if sticks:
        stuck = input_list(recorder, 'sticks', n)
        lower = [where(flag, -math.inf, x) for flag, x in zip(stuck, lower, strict=True)]
        upper = [where(flag, math.inf, x) for flag, x in zip(stuck, upper, strict=True)]
    return program_with_outputs(
        recorder,
        moving=[where(candidate[i], 0.0, unbraked[i]) for i in range(n)],
        candidate=candidate,
        lower=lower,
        upper=upper,
        last=[zero] * n,
        barred=[zero] * n,
        busy=[any_of(candidate)],
    )


def record_pivot(n: int) -> Program:
    """
    Return the program of one change of the active set.

    Inputs, (n,): x, the solution for the set, torque = H x + bias, load = c + bias, and the
    outputs of `record_modes` and `record_directions`. Outputs are the changed ones of these.
    """
    recorder = Recorder(1, 'sequential')
    rows = ('x', 'torque', 'load', 'candidate', 'lower', 'upper')
    x, torque, load, candidate, lower, upper = (input_list(recorder, r, n) for r in rows)
    moving, direction, last, barred = (
        input_list(recorder, name, n) for name in ('moving', 'direction', 'last', 'barred')
    )
    (busy,) = input_list(recorder, 'busy', 1)
    zero, one = recorder.constant(0.0), recorder.constant(1.0)

    # The fraction of the step to x at which the first released joint comes to zero.
    wrong = [both(both(candidate[i], moving[i]), negated(direction[i] * x[i])) for i in range(n)]
    ways = [last[i] - x[i] for i in range(n)]
    shares = [where(absolute(ways[i]), last[i] / ways[i], 0.0) for i in range(n)]
    parts = [where(wrong[i], shares[i], 2.0) for i in range(n)]
    part = smallest(parts)
    blocked = sign_of(2.0 - part)
    held_again = list(map(both, first_equal(parts, part), [blocked] * n))
    halfway = [where(held_again[i], 0.0, last[i] + part * (x[i] - last[i])) for i in range(n)]

    # The sticking joint whose lambda exceeds its bounds most.
    lam = [t - c for t, c in zip(torque, load, strict=True)]
    above = [lam[i] - upper[i] for i in range(n)]
    below = [lower[i] - lam[i] for i in range(n)]
    waits = [both(both(candidate[i], negated(moving[i])), negated(barred[i])) for i in range(n)]
    excess = [
        where(waits[i], where(above[i] - below[i], above[i], below[i]), 0.0) for i in range(n)
    ]
    largest = _extreme(excess, lambda a, b: where(a - b, a, b))
    goes_on = either(blocked, sign_of(largest))
    released = list(map(both, first_equal(excess, largest), [sign_of(largest)] * n))

    def chosen(old: Lanes, blocked_value: Lanes, other: Lanes) -> Lanes:
        result: Lanes = where(busy, where(blocked, blocked_value, other), old)
        return result

    sign = [where(above[i], -1.0, 1.0) for i in range(n)]
    again = [where(held_again[i], 0.0, moving[i]) for i in range(n)]
    more = [where(released[i], 1.0, moving[i]) for i in range(n)]
    sent = [where(released[i], sign[i], direction[i]) for i in range(n)]
    stuck = [
        where(held_again[i], where(absolute(last[i]), barred[i], one), barred[i]) for i in range(n)
    ]
    back = [where(held_again[i], 0.0, direction[i]) for i in range(n)]
    return program_with_outputs(
        recorder,
        moving=list(map(chosen, moving, again, more)),
        direction=list(map(chosen, direction, back, sent)),
        last=list(map(chosen, last, halfway, x)),
        barred=list(map(chosen, barred, stuck, barred)),
        busy=[where(busy, goes_on, zero)],
    )


def record_effort(plant: Plant) -> Program:
    """
    Return the program of `effort`, (n,): torques less the dry friction of sliding joints.

    Inputs are tau, direction s and qd. Friction is s F(qd), F(v) = Fc + (Fs - Fc)/(1 + (v/vs)^2)
    with the speed vs of Stribeck; F(0) = Fs bounds a sticking joint, too, so that a joint is
    released without a jump.
    """
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    tau, direction, qd = (input_list(recorder, name, n) for name in ('tau', 'direction', 'qd'))
    effort = list(tau)
    assert plant.friction_drop is not None
    numbers = Numbers(recorder, plant)
    for i in range(n):
        friction = numbers('friction', i)
        # A drop that varies, NaN, is not zero.
        if plant.friction_drop[i] != 0 and plant.stribeck_rate is not None:
            u = qd[i] * numbers.known('stribeck_rate', i)
            friction = friction + numbers.known('friction_drop', i) / (1.0 + u * u)
        effort[i] = tau[i] - direction[i] * friction
    return program_with_outputs(recorder, effort=effort)


def record_drive(plant: Plant) -> Program:
    """Return the program of `drive`, (n,): torques tau minus the damping D qd."""
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    tau, qd = (input_list(recorder, name, n) for name in ('tau', 'qd'))
    numbers = Numbers(recorder, plant)
    drive = [tau[i] - qd[i] * numbers.known('viscosity', i) for i in range(n)]
    return program_with_outputs(recorder, drive=drive)


def rough_joints(plant: Plant) -> list[int]:
    """Return the joints that friction can hold at rest, even if they slide without friction."""
    if plant.static_friction is None:
        return []
    joints: list[int] = np.flatnonzero(plant.static_friction).tolist()
    return joints


def at_stops(plant: Plant, q: Sequence[Lanes]) -> tuple[list[Lanes], list[Lanes]]:
    """Return flags of the joints at or beyond their lower, and their upper, stops."""
    zero = q[0].recorder.constant(0.0)
    lower, upper = [zero] * len(q), [zero] * len(q)
    if plant.joint_limits is not None:
        for i, (first, last) in enumerate(plant.joint_limits.tolist()):
            if math.isfinite(first):
                lower[i] = negated(q[i] - first)
            if math.isfinite(last):
                upper[i] = negated(last - q[i])
    return lower, upper


def inside_stops(plant: Plant, q: Sequence[Lanes]) -> list[Lanes]:
    """Return numbers that are all above zero if every joint is between its stops."""
    if plant.joint_limits is None:
        return []
    margins = []
    for x, (lower, upper) in zip(q, plant.joint_limits.tolist(), strict=True):
        # At most one of the two distances is negative.
        distances = [x - lower] * math.isfinite(lower) + [upper - x] * math.isfinite(upper)
        margins += [math.prod(distances[1:], start=distances[0])] if distances else []
    return margins


def into_stops(plant: Plant, q: Sequence[Lanes], qd: Sequence[Lanes]) -> list[Lanes]:
    """Return flags of the joints that are at a stop and move into it."""
    lower, upper = at_stops(plant, q)
    return [
        either(both(a, sign_of(-v)), both(b, sign_of(v)))
        for a, b, v in zip(lower, upper, qd, strict=True)
    ]


# Flags: 1 or 0.


def sign_of(x: Lanes) -> Lanes:
    """Return whether a number is above zero."""
    result: Lanes = where(x, 1.0, 0.0)
    return result


def both(a: Lanes, b: Lanes) -> Lanes:
    """Return whether two flags are set."""
    result: Lanes = where(a, b, 0.0)
    return result


def either(a: Lanes, b: Lanes) -> Lanes:
    """Return whether one of two flags is set."""
    result: Lanes = where(a, a, b)
    return result


def negated(a: Lanes) -> Lanes:
    """Return whether a flag is not set, or a number not above zero."""
    result: Lanes = where(a, 0.0, 1.0)
    return result


def any_of(flags: Sequence[Lanes]) -> Lanes:
    """Return whether any flag is set."""
    total = flags[0]
    for flag in flags[1:]:
        total = either(total, flag)
    return total


def first_equal(values: Sequence[Lanes], value: Lanes) -> list[Lanes]:
    """Return the flag of the first of some numbers that equals a number."""
    taken = value.recorder.constant(0.0)
    flags = []
    for x in values:
        equal = where(absolute(x - value), 0.0, 1.0)
        flags.append(where(taken, 0.0, equal))
        taken = either(taken, flags[-1])
    return flags


def smallest(values: Sequence[Lanes]) -> Lanes:
    """Return the smallest of some numbers."""
    return _extreme(values, lambda a, b: where(a - b, b, a))


def _extreme(values: Sequence[Lanes], better: Callable[[Lanes, Lanes], Lanes]) -> Lanes:
    best = values[0]
    for value in values[1:]:
        best = better(best, value)
    return best
