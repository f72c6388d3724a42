# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
One box problem for joints at rest and for impacts at joint stops.

    H x = c + lambda,   lower <= lambda <= upper where x = 0

For joints at rest x are the accelerations, c = y - bias; for an impact x are the velocities after
it, c = H qd. Both are the optimality conditions of a strictly convex function, x'Hx/2 - c'x plus
convex terms of single joints, so the solution exists and is unique.

A primal active set starts with all candidates at rest and changes one joint at a time (`pivot`):

    released joints whose x has the wrong sign     the first one on the line from the last feasible
                                                   x rests again
    otherwise                                      the resting joint whose lambda exceeds its
                                                   bounds most is released

Each change with a nonzero step strictly decreases the objective, and a joint that rests again
after a zero step is not released again, so no active set repeats (Nocedal and Wright, Numerical
Optimization, 2nd ed., 16.5).

In an impact velocities jump, positions stay:

    compression   v0: H v0 = H qd + p, p the impulses of the stops, 0 <= p where v0 = 0
    restitution   v = v0 + alpha H^-1 E p,  E = diag(restitution)
    alpha         min(1, sqrt(p' H^-1 p / (E p)' H^-1 E p))
    again         where a joint still moves into its stop: compression of v, E = 0
    settling      a joint that would bounce below LEAST_HEIGHT takes e = 0, and all again from v0

The candidates of a compression are the joints at stops, those at rest there, too: a stop only
pushes, and another joint's impact may throw a joint off it. Dry friction, whose torque is bounded,
has no impulse. After it v0' p = 0: the kinetic energy falls by p' H^-1 p / 2 and rises again by
alpha^2 (E p)' H^-1 E p / 2: bounded by alpha, an impact never adds energy, whatever the
coefficients (Poisson's law alone does). Braked joints are excluded: H is the matrix of the others.

A joint that bounces with e < 1 comes to rest after infinitely many bounces in a finite time. A
bounce with the velocity v and the acceleration a into the stop has the height v^2 / (2 |a|). Below
LEAST_HEIGHT it does not happen: the joint ends the impact at its stop, at rest, where the stop
holds it from then on.

One register holds one number; flags are 1 or 0.
"""

from __future__ import annotations

import math

import numpy as np

from pfd_core.dynamics.numbers import Numbers
from pfd_core.machine.lanes import absolute, sqrt, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.simulation.dry import LEAST_HEIGHT, Law, read, single
from pfd_core.simulation.flags import (
    any_of,
    both,
    either,
    first_equal,
    largest,
    negated,
    sign_of,
    smallest,
)

# Maximum number of pivots per joint. Random matrices of condition 1e8 need less than four.
PIVOTS = 4
# A joint is put onto its stop where it has passed it by rounding alone: by so many roundings of
# the stop's position, or LEAST_HEIGHT.
ROUNDINGS = 4


class _ActiveSet:
    """The inputs of a change of the active set, and the joints that may have one."""

    def __init__(self, n: int) -> None:
        recorder = self.recorder = Recorder(1, 'sequential')
        rows = ('x', 'torque', 'load', 'candidate', 'lower', 'upper')
        self.x, torque, load, candidate, lower, upper = read(recorder, n, *rows)
        names = ('moving', 'direction', 'barred')
        self.moving, self.direction, self.barred = read(recorder, n, *names)
        (self.busy,) = single(recorder, 'busy')
        # Released joints whose x has the wrong sign.
        self.wrong = [
            both(both(candidate[i], self.moving[i]), negated(self.direction[i] * self.x[i]))
            for i in range(n)
        ]
        # By how much the lambda of each joint at rest is above its bounds, and below.
        lam = [t - c for t, c in zip(torque, load, strict=True)]
        self.waits = [
            both(both(candidate[i], negated(self.moving[i])), negated(self.barred[i]))
            for i in range(n)
        ]
        self.above = [lam[i] - upper[i] for i in range(n)]
        self.below = [lower[i] - lam[i] for i in range(n)]


def record_wrong(n: int) -> Program:
    """Return the program of `busy`, (1,): whether `pivot` has a change; inputs are the same."""
    now = _ActiveSet(n)
    outside = [
        both(waits, either(sign_of(above), sign_of(below)))
        for waits, above, below in zip(now.waits, now.above, now.below, strict=True)
    ]
    return now.recorder.program(busy=[both(now.busy, any_of([*now.wrong, *outside]))])


def record_pivot(n: int) -> Program:
    """
    Return the program of one change of the active set.

    Inputs, (n,): x, the solution for the set, torque = H x + bias, load = c + bias, and the
    outputs of dry.record_modes and dry.record_directions. Outputs are the changed ones of these.
    """
    now = _ActiveSet(n)
    recorder, x, moving, direction, barred = (
        now.recorder,
        now.x,
        now.moving,
        now.direction,
        now.barred,
    )
    (last,) = read(recorder, n, 'last')
    zero, one = recorder.constant(0.0), recorder.constant(1.0)

    # The fraction of the step to x at which the first released joint comes to zero.
    ways = [last[i] - x[i] for i in range(n)]
    shares = [where(absolute(ways[i]), last[i] / ways[i], 0.0) for i in range(n)]
    parts = [where(now.wrong[i], shares[i], 2.0) for i in range(n)]
    part = smallest(parts)
    blocked = sign_of(2.0 - part)
    held_again = list(map(both, first_equal(parts, part), [blocked] * n))
    halfway = [where(held_again[i], 0.0, last[i] + part * (x[i] - last[i])) for i in range(n)]

    # The sticking joint whose lambda exceeds its bounds most.
    excess = [
        where(waits, where(above - below, above, below), 0.0)
        for waits, above, below in zip(now.waits, now.above, now.below, strict=True)
    ]
    most = largest(excess)
    goes_on = either(blocked, sign_of(most))
    released = list(map(both, first_equal(excess, most), [sign_of(most)] * n))

    def chosen(old: Lanes, blocked_value: Lanes, other: Lanes) -> Lanes:
        result: Lanes = where(now.busy, where(blocked, blocked_value, other), old)
        return result

    sign = [where(above, -1.0, 1.0) for above in now.above]
    again = [where(held_again[i], 0.0, moving[i]) for i in range(n)]
    more = [where(released[i], 1.0, moving[i]) for i in range(n)]
    sent = [where(released[i], sign[i], direction[i]) for i in range(n)]
    stuck = [
        where(held_again[i], where(absolute(last[i]), barred[i], one), barred[i]) for i in range(n)
    ]
    back = [where(held_again[i], 0.0, direction[i]) for i in range(n)]
    return recorder.program(
        moving=list(map(chosen, moving, again, more)),
        direction=list(map(chosen, direction, back, sent)),
        last=list(map(chosen, last, halfway, x)),
        barred=list(map(chosen, barred, stuck, barred)),
        busy=[where(now.busy, goes_on, zero)],
    )


def record_hits(law: Law) -> Program:
    """
    Return the program of `hits`, (1,): whether any joint moves into its stop.

    An arm with a complete step waits for the next one, independent of other arms. Output q,
    (n,), has joints on their stops that have passed them by rounding.
    """
    n = law.n
    recorder = Recorder(1, 'sequential')
    (q, qd), (rest,) = read(recorder, n, 'q', 'qd'), single(recorder, 'rest')
    into = [both(rest, flag) for flag in law.into_stops(q, qd)]
    on_stops = list(q)
    for i, stops in enumerate(law.stops):
        for _, stop in stops:
            rounding = float(np.spacing(np.dtype(law.dtype).type(abs(stop))))
            near = max(LEAST_HEIGHT, ROUNDINGS * rounding)
            touches = both(into[i], sign_of(near - absolute(q[i] - stop)))
            on_stops[i] = where(touches, stop, on_stops[i])
    return recorder.program(q=on_stops, hits=[any_of(into)])


def record_compression(law: Law) -> Program:
    """
    Return the program of the beginning of a compression.

    Inputs are q, unbraked and, (1,), hits. Outputs are as of dry.record_modes.
    """
    n = law.n
    recorder = Recorder(1, 'sequential')
    (q, unbraked), (hits,) = read(recorder, n, 'q', 'unbraked'), single(recorder, 'hits')
    zeros = [recorder.constant(0.0)] * n
    at_lower, at_upper = law.at_stops(q)
    candidate = [both(unbraked[i], either(at_lower[i], at_upper[i])) for i in range(n)]
    return recorder.program(
        direction=zeros,
        moving=[where(candidate[i], 0.0, unbraked[i]) for i in range(n)],
        candidate=candidate,
        lower=[where(at_upper[i], -math.inf, 0.0) for i in range(n)],
        upper=[where(at_lower[i], math.inf, 0.0) for i in range(n)],
        last=zeros,
        barred=zeros,
        busy=[hits],
    )


def record_impulses(law: Law) -> Program:
    """
    Return the program of `thrown`, E p, and `impulse`, p, (n,), after a compression.

    Inputs are torque = H v0, load = H qd, candidate, moving and, (1,), hits: without any, p is 0.
    """
    n = law.n
    recorder = Recorder(1, 'sequential')
    torque, load, candidate, moving = read(recorder, n, 'torque', 'load', 'candidate', 'moving')
    (hits,) = single(recorder, 'hits')
    stopped = [both(hits, where(candidate[i], where(moving[i], 0.0, 1.0), 0.0)) for i in range(n)]
    p = [where(stopped[i], torque[i] - load[i], 0.0) for i in range(n)]
    numbers = Numbers(recorder, law.plant)
    thrown = [p[i] * numbers.known('restitution', i) for i in range(n)]
    return recorder.program(impulse=p, thrown=thrown)


def record_restitution(law: Law) -> Program:
    """
    Return the program of the velocities after a restitution.

    Inputs are q, `before`, the velocities before the impact, x = v0, impulse, thrown,
    returned = H^-1 E p, unbraked and, (1,), hits. Outputs are qd, as before without a hit, and
    `still`, (1,): whether a joint still moves into its stop.
    """
    n = law.n
    recorder = Recorder(1, 'sequential')
    names = ('q', 'before', 'x', 'impulse', 'thrown', 'returned', 'unbraked')
    q, qd, v0, p, thrown, returned, unbraked = read(recorder, n, *names)
    (hits,) = single(recorder, 'hits')
    lost = sum((p[i] * (v0[i] - qd[i]) for i in range(1, n)), p[0] * (v0[0] - qd[0]))
    gained = sum((thrown[i] * returned[i] for i in range(1, n)), thrown[0] * returned[0])
    # Both are above zero but for rounding.
    alpha = where(lost, where(gained - lost, sqrt(lost / gained), 1.0), 0.0)
    after = [where(hits, v0[i] + alpha * returned[i], qd[i]) for i in range(n)]
    still = [both(unbraked[i], flag) for i, flag in enumerate(law.into_stops(q, after))]
    # An arm whose step ended at a stop has its impact in the next one, whatever its neighbours do.
    return recorder.program(qd=after, still=[both(hits, any_of(still))])


def record_settling(n: int) -> Program:
    """
    Return the program of `thrown` without the joints whose bounce is below LEAST_HEIGHT.

    Inputs are thrown, and qd and qdd after the restitution. Output `again`, (1,), says whether
    there was such a joint.
    """
    recorder = Recorder(1, 'sequential')
    qd, qdd, thrown = read(recorder, n, 'qd', 'qdd', 'thrown')
    settles = []
    for v, a, impulse in zip(qd, qdd, thrown, strict=True):
        returns = both(sign_of(absolute(impulse)), sign_of(-(v * a)))
        low = sign_of((2.0 * LEAST_HEIGHT) * absolute(a) - v * v)
        settles.append(both(returns, low))
    return recorder.program(
        thrown=[where(flag, 0.0, p) for flag, p in zip(settles, thrown, strict=True)],
        again=[any_of(settles)],
    )
