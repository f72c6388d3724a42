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
"""

from __future__ import annotations

import math

import numpy as np

from pfd_core.dynamics.numbers import Numbers
from pfd_core.machine.lanes import absolute, sqrt, where
from pfd_core.machine.recorder import Lanes
from pfd_core.simulation.dry import LEAST_HEIGHT, Law
from pfd_core.simulation.flags import (
    Inputs,
    Outputs,
    Row,
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


def wrong(at: Inputs) -> Outputs:
    """
    Return what is wrong with an active set.

    x is the solution for the set, torque = H x + bias, load = c + bias; the others are outputs of
    dry.modes and dry.directions. Outputs are `wrong`, released joints whose x has the wrong sign;
    `excess`, by how much lambda is beyond a bound, and `side`, the direction to which this bound
    releases the joint; and `busy`, whether there are any.
    """
    (busy,) = at.single('busy')
    signs, excess, side = [], [], []
    for i, flag in enumerate(at.candidate):
        signs.append(both(both(flag, at.moving[i]), negated(at.direction[i] * at.x[i])))
        waits = both(both(flag, negated(at.moving[i])), negated(at.barred[i]))
        lam = at.torque[i] - at.load[i]
        above, below = lam - at.upper[i], at.lower[i] - lam
        excess.append(where(waits, where(above - below, above, below), 0.0))
        side.append(where(above, -1.0, 1.0))
    found = both(busy, any_of([*signs, *map(sign_of, excess)]))
    return {'wrong': signs, 'excess': excess, 'side': side, 'busy': found}


def pivot(at: Inputs) -> Outputs:
    """Return an active set after one change, from the outputs of `wrong`."""
    (busy,) = at.single('busy')
    x, last, moving, direction, barred = at.x, at.last, at.moving, at.direction, at.barred
    # The fraction of the step to x at which the first released joint comes to zero.
    ways = [a - b for a, b in zip(last, x, strict=True)]
    shares = [where(absolute(way), a / way, 0.0) for a, way in zip(last, ways, strict=True)]
    parts = [where(flag, share, 2.0) for flag, share in zip(at.wrong, shares, strict=True)]
    part = smallest(parts)
    blocked = sign_of(2.0 - part)
    # The joint at rest whose lambda exceeds its bounds most.
    most = largest(at.excess)
    changed: dict[str, Row] = {'moving': [], 'direction': [], 'last': [], 'barred': []}
    held_again, released = first_equal(parts, part), first_equal(at.excess, most)
    for i, (first, worst) in enumerate(zip(held_again, released, strict=True)):
        again, freed = both(first, blocked), both(worst, sign_of(most))
        stuck = where(absolute(last[i]), barred[i], 1.0)
        halfway = where(again, 0.0, last[i] + part * (x[i] - last[i]))
        # Where a released joint blocks the step, and elsewhere.
        rows = {
            'moving': (moving[i], where(again, 0.0, moving[i]), where(freed, 1.0, moving[i])),
            'direction': (
                *(direction[i], where(again, 0.0, direction[i])),
                where(freed, at.side[i], direction[i]),
            ),
            'last': (last[i], halfway, x[i]),
            'barred': (barred[i], where(again, stuck, barred[i]), barred[i]),
        }
        for name, (old, at_block, other) in rows.items():
            changed[name].append(where(busy, where(blocked, at_block, other), old))
    return changed | {'busy': where(busy, either(blocked, sign_of(most)), 0.0)}


def hits(law: Law, at: Inputs) -> Outputs:
    """
    Return `hits`, whether any joint moves into its stop, and q, with these joints on their stops.

    Only joints that have passed them by rounding are moved. An arm with a complete step waits for
    the next one, independent of other arms.
    """
    (rest,), q = at.single('rest'), at.q
    into = [both(rest, flag) for flag in law.into_stops(q, at.qd)]
    on_stops = list(q)
    for i, stops in enumerate(law.stops):
        for _, stop in stops:
            rounding = float(np.spacing(np.dtype(law.dtype).type(abs(stop))))
            near = max(LEAST_HEIGHT, ROUNDINGS * rounding)
            touches = both(into[i], sign_of(near - absolute(q[i] - stop)))
            on_stops[i] = where(touches, stop, on_stops[i])
    return {'q': on_stops, 'hits': any_of(into)}


def compression(law: Law, at: Inputs) -> Outputs:
    """Return the outputs of dry.modes, and directions, at the beginning of a compression."""
    unbraked, (lower, upper) = at.unbraked, law.at_stops(at.q)
    candidate = [
        both(free, either(a, b)) for free, a, b in zip(unbraked, lower, upper, strict=True)
    ]
    zeros = [0.0] * law.n
    return {
        'direction': zeros,
        'moving': [where(flag, 0.0, free) for flag, free in zip(candidate, unbraked, strict=True)],
        'candidate': candidate,
        'lower': [where(flag, -math.inf, 0.0) for flag in upper],
        'upper': [where(flag, math.inf, 0.0) for flag in lower],
        'last': zeros,
        'barred': zeros,
        'busy': at.single('hits'),
    }


def impulses(law: Law, at: Inputs) -> Outputs:
    """
    Return `thrown`, E p, and `impulse`, p, after a compression: torque = H v0, load = H qd.

    Without any hits p is 0.
    """
    (hits,), numbers, p = at.single('hits'), Numbers(at.recorder, law.plant), []
    for i, flag in enumerate(at.candidate):
        stopped = both(hits, where(flag, where(at.moving[i], 0.0, 1.0), 0.0))
        p.append(where(stopped, at.torque[i] - at.load[i], 0.0))
    thrown = [x * numbers.known('restitution', i) for i, x in enumerate(p)]
    return {'impulse': p, 'thrown': thrown}


def restitution(law: Law, at: Inputs) -> Outputs:
    """
    Return the velocities after a restitution, qd: those before the impact without a hit.

    x is v0, returned = H^-1 E p. Output `still` says whether a joint still moves into its stop.
    """
    (hits,), x, before = at.single('hits'), at.x, at.before
    lost = _product(at.impulse, [a - b for a, b in zip(x, before, strict=True)])
    gained = _product(at.thrown, at.returned)
    # Both are above zero but for rounding.
    alpha = where(lost, where(gained - lost, sqrt(lost / gained), 1.0), 0.0)
    after = [
        where(hits, v + alpha * back, old)
        for v, back, old in zip(x, at.returned, before, strict=True)
    ]
    still = list(map(both, at.unbraked, law.into_stops(at.q, after)))
    # An arm whose step ended at a stop has its impact in the next one, whatever its neighbours do.
    return {'qd': after, 'still': both(hits, any_of(still))}


def _product(a: Row, b: Row) -> Lanes:
    first, *others = (x * y for x, y in zip(a, b, strict=True))
    result: Lanes = sum(others, first)
    return result


def settling(at: Inputs) -> Outputs:
    """
    Return `thrown` without the joints whose bounce is below LEAST_HEIGHT.

    qd and qdd are those after the restitution. Output `again` says whether there was such a joint.
    """
    settles = []
    for v, a, impulse in zip(at.qd, at.qdd, at.thrown, strict=True):
        returns = both(sign_of(absolute(impulse)), sign_of(-(v * a)))
        low = sign_of((2.0 * LEAST_HEIGHT) * absolute(a) - v * v)
        settles.append(both(returns, low))
    kept = [where(flag, 0.0, p) for flag, p in zip(settles, at.thrown, strict=True)]
    return {'thrown': kept, 'again': any_of(settles)}
