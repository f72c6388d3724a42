# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Dry friction, joint stops and rest: the torques of a segment of a step, and the events that end it.

    friction    sign(qd) F(qd, tau), F(v, tau) = Fc + mu |tau| + (Fs - Fc) / (1 + (v / vs)^2), tau
                the torque of the motor
    rest        a joint whose velocity is 0.0 is held while |lambda| <= F(0, tau)
    stop        pushes a joint that is at it; a joint that begins beyond its stop may come back and
                must not go further

Which joints begin to move, and impacts, are in pfd_core.simulation.box.

A segment of a step has fixed modes: each joint moves, with a direction of its friction, or rests.
Margins are numbers that stay at or above zero in these modes. The segment ends at the first event:

    reversal    s qd             of a joint that moves in direction s
    release     F -+ lambda      of a joint that rests, on the nearer side that no stop bounds
    stop        +-(q - q_stop)   of a joint that moves, of both its stops

The bounds of rest are those of the motor's torque, which may change within a segment. Friction by
the reaction of the joint, mu |lambda|, is refused: what moves would solve no convex problem, and
may have no solution or several (Painleve). mu |tau| is known before it is decided what moves.

A joint moves or rests, so the first two share a place. One with friction reaches the stop behind
it only after a reversal, so its stops share one, too. A joint without friction that turns, perhaps
beyond its stop, has a reversal: the search for an event then begins where it has turned. At the
event the velocity is 0.0, or the position the stop, exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from pfd_core.dynamics.numbers import Numbers
from pfd_core.forking import cached_property
from pfd_core.kernels.simulate import UNFINISHED
from pfd_core.machine.lanes import absolute, where
from pfd_core.machine.recorder import Lanes
from pfd_core.model.plant import Plant, has_drives
from pfd_core.simulation.flags import (
    Inputs,
    Outputs,
    Row,
    any_of,
    both,
    either,
    largest,
    negated,
    sign_of,
)

Stop = tuple[float, float]  # the sign of the position in the margin, and the position
# A joint is released where lambda exceeds its bound by so many roundings of the largest torque:
# the modes that follow then release it, too.
SLACK = {'float64': 2.0**12, 'float32': 2.0**5}
# Default of Law.short, for steps of a fixed size.
SHORT = 2.0**-16
# Height of the lowest bounce [rad or m]. It is a few thousand roundings of a position of order
# one, and no sensor of a joint resolves it. What is left of the bounces under the acceleration a
# takes less than 2 sqrt(2 LEAST_HEIGHT / a) / (1 - e): 0.03 ms at e = 0.97 under gravity.
LEAST_HEIGHT = 1e-12


def has_contact(plant: Plant) -> bool:
    """Return whether a plant has dry friction or joint stops."""
    return not plant.effects.keys().isdisjoint(('friction', 'load_friction', 'joint_limits'))


@dataclass(frozen=True)
class Margin:
    """A number that stays at or above zero until an event."""

    joint: int
    stops: tuple[Stop, ...] = ()  # none for reversal or release; of two the one in its direction


@dataclass(frozen=True, eq=False)
class Law:
    """Friction and stops of a plant, in a number format."""

    plant: Plant
    dtype: str
    # The part of a segment that a Taylor step to an event may be: shorter hops are not resolved.
    short: float = SHORT
    jumps: bool = False  # whether torques may jump within a segment

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.plant.robot.n

    @property
    def eps(self) -> float:
        """Distance of one from the next number of the format."""
        return float(np.finfo(self.dtype).eps)

    @property
    def drives(self) -> bool:
        """Whether motors give other torques than the commanded ones."""
        return has_drives(self.plant)

    @cached_property
    def stops(self) -> list[list[Stop]]:
        """For each joint its stops, the lower one first."""
        limits = self.plant.joint_limits
        bounds = np.full((self.n, 2), [-np.inf, np.inf]) if limits is None else limits
        return [
            [(s, float(x)) for s, x in zip((1.0, -1.0), row, strict=True) if math.isfinite(x)]
            for row in bounds
        ]

    @cached_property
    def rough(self) -> list[int]:
        """Joints that friction can hold at rest, even if they slide without friction."""
        sizes = [self.plant.effects.get(x) for x in ('static_friction', 'load_friction')]
        given = [x for x in sizes if x is not None]
        return [i for i in range(self.n) if any(x[i] != 0 for x in given)]

    @property
    def loaded(self) -> bool:
        """Whether friction depends on the torques of the motors."""
        return self.plant.load_friction is not None

    def share(self, i: int) -> float:
        """Return the share of the motor's torque that friction of a joint takes."""
        shares = self.plant.load_friction
        return 0.0 if shares is None else float(shares[i])

    @cached_property
    def margins(self) -> list[Margin]:
        """All margins, known when programs are recorded, so that each has a fixed place."""
        found = []
        for i, stops in enumerate(self.stops):
            if i in self.rough or stops:
                groups = [stops] if i in self.rough and stops else [[stop] for stop in stops]
                found += [Margin(i), *(Margin(i, tuple(group)) for group in groups)]
        return found

    def size(self, i: int, v: Lanes, tau: Lanes) -> Lanes:
        """Return the friction of a joint that slides at a velocity, under a motor's torque."""
        numbers, plant = Numbers(v.recorder, self.plant), self.plant
        size = self._with_load(i, 'friction', tau)
        # A drop that varies among arms is NaN here, so it counts as not zero.
        if plant.stribeck_rate is not None and plant.friction_drop[i] != 0:  # type: ignore[index]
            u = v * numbers.known('stribeck_rate', i)
            size = size + numbers.known('friction_drop', i) / (1.0 + u * u)
        return size

    def bound(self, i: int, tau: Lanes) -> Lanes:
        """Return the largest friction of a joint at rest, under a motor's torque."""
        return self._with_load(i, 'static_friction', tau)

    def bounds(self, at: Inputs, name: str) -> Row:
        """Return the largest friction of all joints at rest, under an array of torques."""
        # Only friction that depends on them needs the array.
        zeros = [at.recorder.constant(0.0)] * self.n
        torques = getattr(at, name) if self.loaded else zeros
        return [self.bound(i, tau) for i, tau in enumerate(torques)]

    def _with_load(self, i: int, field: str, tau: Lanes) -> Lanes:
        size, share = tau.recorder.constant(0.0), self.share(i)
        if field in self.plant.effects:
            size = Numbers(tau.recorder, self.plant)(field, i)
        return size + share * absolute(tau) if share else size

    def load(self, tau: Row, qd: Row, direction: Row, damped: bool) -> Row:
        """Return torques of the motors less friction of sliding joints, then less damping."""
        y = list(tau)
        for i in self.rough:
            y[i] = tau[i] - direction[i] * self.size(i, qd[i], tau[i])
        if self.plant.viscosity is None or not damped:
            return y
        numbers = Numbers(tau[0].recorder, self.plant)
        return [
            t - v * numbers.known('viscosity', i)
            for i, (t, v) in enumerate(zip(y, qd, strict=True))
        ]

    def at_stops(self, q: Row) -> tuple[Row, Row]:
        """Return flags of the joints at or beyond their lower, and their upper, stops."""
        zero = q[0].recorder.constant(0.0)
        lower, upper = [zero] * self.n, [zero] * self.n
        for i, stops in enumerate(self.stops):
            for s, x in stops:
                (lower if s > 0 else upper)[i] = negated(s * (q[i] - x))
        return lower, upper

    def into_stops(self, q: Row, qd: Row) -> Row:
        """Return flags of the joints that are at a stop and move into it."""
        return [
            either(both(a, sign_of(-v)), both(b, sign_of(v)))
            for a, b, v in zip(*self.at_stops(q), qd, strict=True)
        ]


def load(law: Law, damped: bool, at: Inputs) -> Outputs:
    """Return y from the torques tau of motors; see Law.load."""
    return {'y': law.load(at.tau, at.qd, at.direction, damped)}


def watch(law: Law, at: Inputs) -> Outputs:
    """
    Return `watch`: whether a joint may be at rest or at a stop.

    If it is 0, the programs for such joints are skipped.
    """
    flags = [negated(at.qd[i] * at.qd[i]) for i in law.rough]
    flags += [negated(s * (at.q[i] - x)) for i, stops in enumerate(law.stops) for s, x in stops]
    return {'watch': any_of(flags)}


def directions(at: Inputs) -> Outputs:
    """Return `direction`, the signs of the velocities."""
    return {'direction': [where(v, 1.0, where(-v, -1.0, 0.0)) for v in at.qd]}


def modes(law: Law, at: Inputs) -> Outputs:
    """
    Return the modes in which a segment begins, for the box problem.

    `unbraked` is 0 for a braked joint, and `sticks` flags joints that are not released in this
    step. Outputs are moving, 0 for a braked or resting joint; candidate, joints that may rest;
    lower and upper, the bounds of a candidate's lambda; last and barred, zeros; and busy, whether
    any joint is a candidate.
    """
    unbraked, bound = at.unbraked, law.bounds(at, 'y_begin')
    low, high = law.at_stops(at.q)
    candidate = []
    for i, v in enumerate(at.qd):
        # A motor without torque, whose friction is zero, may have one in a moment.
        rough = v.recorder.constant(1.0) if law.share(i) else sign_of(bound[i])
        holds = either(rough, either(low[i], high[i]))
        candidate.append(both(unbraked[i], both(negated(absolute(v)), holds)))
    below, above = (list(map(either, at.sticks, side)) for side in (high, low))
    return {
        'moving': [where(flag, 0.0, free) for flag, free in zip(candidate, unbraked, strict=True)],
        'candidate': candidate,
        'lower': [where(flag, -math.inf, -f) for flag, f in zip(below, bound, strict=True)],
        'upper': [where(flag, math.inf, f) for flag, f in zip(above, bound, strict=True)],
        'last': [0.0] * law.n,
        'barred': [0.0] * law.n,
        'busy': any_of(candidate),
    }


def held(at: Inputs) -> Outputs:
    """Return `held`, whether a joint is held, and `slides`, if none is."""
    found = any_of(list(map(rests, at.unbraked, at.moving)))
    return {'held': found, 'slides': negated(found)}


def chosen(at: Inputs) -> Outputs:
    """Return y: x for an arm with the flag `on`, else as before."""
    (on,) = at.single('on')
    return {'y': [where(on, b, a) for a, b in zip(at.y, at.x, strict=True)]}


def rests(unbraked: Lanes, moving: Lanes) -> Lanes:
    """Return whether friction or a stop holds a joint."""
    return both(unbraked, negated(moving))


def _stop_of(margin: Margin, q: Lanes, direction: Lanes) -> tuple[Lanes, Lanes]:
    """Return the sign of the margin of a stop, and where it is: at q for a joint beyond it."""
    side, stop = (q.recorder.constant(x) for x in margin.stops[0])
    if len(margin.stops) > 1:
        side, stop = (where(direction, b, a) for a, b in zip(*margin.stops, strict=True))
    return side, where(side * (q - stop), stop, q)


def _reversal(direction: Lanes, moving: Lanes, v: Lanes) -> tuple[Lanes, Lanes]:
    """Return whether the reversal of a joint has a part in the segment, and its margin."""
    return both(moving, absolute(direction)), direction * v


def _release(law: Law, i: int, at: Inputs, slack: Lanes) -> tuple[Lanes, Lanes]:
    """Return whether the release of a joint has a part in the segment, and its margin."""
    (low, high), torque = (side[i] for side in law.at_stops(at.q)), at.torque[i]
    bounded = either(at.sticks[i], both(low, high))
    toward = where(low, -torque, where(high, torque, absolute(torque)))
    on = both(rests(at.unbraked[i], at.moving[i]), negated(bounded))
    return on, (law.bounds(at, 'y_end')[i] + slack) - toward


def _stop(margin: Margin, begin: Lanes, direction: Lanes, q: Lanes) -> tuple[Lanes, Lanes]:
    """Return the sign of the margin of a stop, and the margin of a joint at q."""
    side, stop = _stop_of(margin, begin, direction)
    return side, side * (q - stop)


def detect(law: Law, at: Inputs) -> Outputs:
    """
    Return `seek` and `event`: whether a segment has an event in it.

    `loose` says whether a joint is released. Output `turns` flags joints without friction that
    have turned and may have been beyond their stop: where the tangents of the margin at the
    beginning and the end meet, it is below zero; or they began beyond it, on their way back, and
    must not go further from where they turn.
    """
    r, rest, loose = at.single('r', 'rest', 'loose')
    q, direction, moving = at.q, at.direction, at.moving
    turns: list[Lanes | float] = [0.0] * law.n
    flags = [loose]
    for margin in law.margins:
        i = margin.joint
        v0, v = at.qd[i], at.qd_end[i]
        if not margin.stops:
            on, value = _reversal(direction[i], moving[i], v)
            if i in law.rough:
                flags.append(both(on, sign_of(-value)))
            continue
        s, value = _stop(margin, q[i], direction[i], at.q_end[i])
        flags.append(both(moving[i], sign_of(-value)))
        if i not in law.rough:
            _, begin = _stop(margin, q[i], direction[i], q[i])
            falls, rises = s * v0, s * v
            meet = begin * (falls - rises) + falls * ((value - begin) - rises * r)
            dips = both(both(sign_of(-falls), sign_of(rises)), sign_of(meet))
            ((_, place),) = margin.stops
            back = both(sign_of(s * (place - q[i])), sign_of(falls))
            turns[i] = turns[i] + both(moving[i], either(dips, both(back, sign_of(-rises))))
    flags += [x for x in turns if isinstance(x, Lanes)]
    seek = both(rest, any_of(flags))
    return {'seek': seek, 'event': seek, 'turns': turns}


def loose(law: Law, at: Inputs) -> Outputs:
    """
    Return `loose`: whether a joint is released in a segment, by lambda at its end, `torque`.

    Output `slack` is what lambda may exceed its bounds by, from the torques there: those at the
    beginning, of motors with a lag, may all be zero.
    """
    greatest = largest([absolute(x) for x in (*at.torque, *at.y_end)])
    slack = greatest * (law.eps * SLACK[law.dtype])
    releases = [_release(law, x.joint, at, slack) for x in law.margins if not x.stops]
    flags = [both(on, sign_of(-value)) for on, value in releases]
    return {'loose': any_of(flags), 'slack': slack}


def margins(law: Law, at: Inputs) -> Outputs:
    """
    Return margins and their slopes at a time of a segment that begins at q; `torque` is lambda.

    Outputs, one of each margin: g; d, its slope in time, 0 for a release; and noise, what rounding
    makes of it. A margin that has no part in the segment is 1, as are all releases unless one is
    `loose`.
    """
    loose, slack = at.single('loose', 'slack')
    q, direction, moving = at.q, at.direction, at.moving
    g, d, noise = [], [], []
    for margin in law.margins:
        i = margin.joint
        if margin.stops:
            on, (side, value) = moving[i], _stop(margin, q[i], direction[i], at.q_end[i])
            slope, rough = side * at.qd_end[i], absolute(at.q_end[i]) * law.eps
        else:
            resting = rests(at.unbraked[i], moving[i])
            turned, reversal = _reversal(direction[i], moving[i], at.qd_end[i])
            if i not in law.rough:
                turned = both(turned, at.turns[i])
            freed, release = _release(law, i, at, slack)
            on = where(resting, both(loose, freed), turned)
            value = where(resting, release, reversal)
            slope = where(resting, 0.0, direction[i] * at.qdd_end[i])
            rough = where(resting, slack * 0.5, 0.0)
        g.append(where(on, value, 1.0))
        d.append(where(on, slope, 0.0))
        noise.append(where(on, rough, 0.0))
    return {'g': g, 'd': d, 'noise': noise}


def snap(law: Law, compensated: bool, at: Inputs) -> Outputs:
    """
    Return the state at an event.

    A Taylor step of length delta, in which the search ended; then a velocity of zero, or the
    position of the stop, exactly, for the margins flagged in `fired`. `span` is the length of the
    segment. Outputs are the changed ones of the inputs, with sums of positions also dq and
    `stopped`. A joint that was at rest and is back at once has been released by rounding alone: it
    sticks for the rest of the step. One that returns to its stop sooner than a search resolves is
    at rest there, as is one that falls from below LEAST_HEIGHT, where friction or another joint's
    event has cut its hop: two joints that throw each other off their stops would do so for ever.
    """
    event, delta, r, span = at.single('event', 'delta', 'r', 'span')
    q, moving = at.q, at.moving
    at_once = negated((r + delta) - span * law.short)
    states = list(zip(at.qd_end, at.qdd_end, strict=True))
    way = [where(event, delta * (y + (0.5 * delta) * z), 0.0) for y, z in states]
    x = [a + b for a, b in zip(at.q_end, way, strict=True)]
    v = [where(event, y + delta * z, y) for y, z in states]
    sticks, stopped = list(at.sticks), [at.recorder.constant(0.0)] * law.n
    for margin, flag in zip(law.margins, at.fired, strict=True):
        i = margin.joint
        happens, still = both(both(event, flag), moving[i]), negated(absolute(at.qd[i]))
        if margin.stops:
            _, stop = _stop_of(margin, q[i], at.direction[i])
            away = absolute(q[i] - stop)
            low = sign_of((2.0 * LEAST_HEIGHT) * absolute(at.qdd_end[i]) - v[i] * v[i])
            returns, hops = negated(away), both(negated(away - LEAST_HEIGHT), low)
            x[i], still = where(happens, stop, x[i]), both(still, returns)
            v[i] = where(both(both(happens, at_once), either(returns, hops)), 0.0, v[i])
            stopped[i] = either(stopped[i], happens)
        else:
            v[i] = where(happens, 0.0, v[i])
        sticks[i] = where(both(happens, still), 1.0, sticks[i])
    outputs = {'q.end': x, 'qd.end': v, 'sticks': sticks, 'r': [where(event, r + delta, r)]}
    if compensated:
        outputs |= {'dq': [a + b for a, b in zip(at.dq, way, strict=True)], 'stopped': stopped}
    return outputs


def unfinished(at: Inputs) -> Outputs:
    """Return qd, NaN, and unfinished, 1, for an arm whose step had too many events."""
    (rest,) = at.single('rest')
    return {
        'qd': [where(rest, math.nan, v) for v in at.qd],
        UNFINISHED: [where(rest, 1.0, flag) for flag in at.unfinished],
    }
