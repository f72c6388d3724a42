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

One register holds one number; flags are 1 or 0.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from pfd_core.dynamics.numbers import Numbers
from pfd_core.forking import cached_property
from pfd_core.kernels.simulate import UNFINISHED
from pfd_core.machine.lanes import absolute, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model.plant import Plant, has_drives
from pfd_core.simulation.flags import any_of, both, either, largest, negated, sign_of

Row = list[Lanes]
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
    """
    Friction and stops of a plant, in a number format.

    Attributes
    ----------
    plant : Plant
        Robot and scene.
    dtype : {'float64', 'float32'}
        Number format.
    short : float
        The part of a segment that a Taylor step to an event may be: shorter hops are not resolved.
    jumps : bool
        Whether torques may jump within a segment.

    """

    plant: Plant
    dtype: str
    short: float = SHORT
    jumps: bool = False

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

    def resting_torques(self, recorder: Recorder, name: str) -> Row:
        """Return an array as the motor torques of joints at rest: `load` takes nothing there."""
        # Only friction that depends on them needs the array.
        return (
            read(recorder, self.n, name)[0] if self.loaded else [recorder.constant(0.0)] * self.n
        )

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


def read(recorder: Recorder, n: int, *names: str) -> list[Row]:
    """Return some inputs of n numbers."""
    return [recorder.input_list(name, n) for name in names]


def single(recorder: Recorder, *names: str) -> Row:
    """Return some inputs of one number."""
    return [recorder.input_list(name, 1)[0] for name in names]


def record_load(law: Law, damped: bool) -> Program:
    """Return the program of y, (n,), from torques tau of the motors, qd and direction."""
    recorder = Recorder(1, 'sequential')
    tau, qd, direction = read(recorder, law.n, 'tau', 'qd', 'direction')
    return recorder.program(y=law.load(tau, qd, direction, damped))


def record_watch(law: Law) -> Program:
    """
    Return the program of `watch`, (1,): whether a joint may be at rest or at a stop.

    If it is 0, the programs for such joints are skipped.
    """
    recorder = Recorder(1, 'sequential')
    q, qd = read(recorder, law.n, 'q', 'qd')
    flags = [negated(qd[i] * qd[i]) for i in law.rough]
    flags += [negated(s * (q[i] - x)) for i, stops in enumerate(law.stops) for s, x in stops]
    return recorder.program(watch=[any_of(flags)])


def record_directions(n: int) -> Program:
    """Return the program of `direction`, (n,), the signs of the velocities qd."""
    recorder = Recorder(1, 'sequential')
    (qd,) = read(recorder, n, 'qd')
    direction = [where(v, 1.0, where(-v, -1.0, 0.0)) for v in qd]
    return recorder.program(direction=direction)


def record_modes(law: Law) -> Program:
    """
    Return the program of the modes in which a segment begins, for the box problem.

    Inputs are q, qd, unbraked, 0 for a braked joint, and sticks, flags of the joints that are not
    released in this step; and, if friction depends on load, y.begin, outputs of `load`. Outputs,
    (n,): moving, 0 for a braked or resting joint; candidate, joints that may rest; lower and
    upper, the bounds of a candidate's lambda; last and barred, zeros. Output, (1,): busy, whether
    any joint is a candidate.
    """
    recorder, n = Recorder(1, 'sequential'), law.n
    q, qd, unbraked, sticks = read(recorder, n, 'q', 'qd', 'unbraked', 'sticks')
    zero = recorder.constant(0.0)
    bound = [law.bound(i, t) for i, t in enumerate(law.resting_torques(recorder, 'y.begin'))]
    low, high = law.at_stops(q)
    candidate = []
    for i, v in enumerate(qd):
        # A motor without torque, whose friction is zero, may have one in a moment.
        rough = recorder.constant(1.0) if law.share(i) else sign_of(bound[i])
        holds = either(rough, either(low[i], high[i]))
        candidate.append(both(unbraked[i], both(negated(absolute(v)), holds)))
    below, above = (list(map(either, sticks, side)) for side in (high, low))
    return recorder.program(
        moving=[where(flag, 0.0, free) for flag, free in zip(candidate, unbraked, strict=True)],
        candidate=candidate,
        lower=[where(flag, -math.inf, -f) for flag, f in zip(below, bound, strict=True)],
        upper=[where(flag, math.inf, f) for flag, f in zip(above, bound, strict=True)],
        last=[zero] * n,
        barred=[zero] * n,
        busy=[any_of(candidate)],
    )


def record_held(n: int) -> Program:
    """Return the program of `held`, (1,), whether a joint is held, and `slides`, if none is."""
    recorder = Recorder(1, 'sequential')
    moving, unbraked = read(recorder, n, 'moving', 'unbraked')
    held = any_of(list(map(rests, unbraked, moving)))
    return recorder.program(held=[held], slides=[negated(held)])


def record_chosen(n: int) -> Program:
    """Return the program of y, (n,): x for an arm with the flag `on`, (1,), else as before."""
    recorder = Recorder(1, 'sequential')
    (y, x), (on,) = read(recorder, n, 'y', 'x'), single(recorder, 'on')
    return recorder.program(y=[where(on, b, a) for a, b in zip(y, x, strict=True)])


def rests(unbraked: Lanes, moving: Lanes) -> Lanes:
    """Return whether friction or a stop holds a joint."""
    return both(unbraked, negated(moving))


def _stop_of(margin: Margin, q: Lanes, direction: Lanes) -> tuple[Lanes, Lanes]:
    """Return the sign of the margin of a stop, and where it is: at q for a joint beyond it."""
    side, stop = (q.recorder.constant(x) for x in margin.stops[0])
    if len(margin.stops) > 1:
        side, stop = (where(direction, b, a) for a, b in zip(*margin.stops, strict=True))
    return side, where(side * (q - stop), stop, q)


class _Segment:
    """The inputs of margins at a time of a segment, and the margins."""

    def __init__(self, law: Law) -> None:
        self.law, self.recorder, n = law, Recorder(1, 'sequential'), law.n
        self.q0, self.q, self.v = read(self.recorder, n, 'q', 'q.end', 'qd.end')
        self.direction, self.moving, self.unbraked, self.sticks = read(
            self.recorder, n, 'direction', 'moving', 'unbraked', 'sticks'
        )
        (self.torque,) = read(self.recorder, n, 'lambda')
        self.y = law.resting_torques(self.recorder, 'y.end')
        self.sides = law.at_stops(self.q0)

    def resting(self, i: int) -> Lanes:
        """Return whether a joint rests."""
        return rests(self.unbraked[i], self.moving[i])

    def reversal(self, i: int) -> tuple[Lanes, Lanes]:
        """Return whether the reversal of a joint has a part in the segment, and its margin."""
        direction = self.direction[i]
        return both(self.moving[i], absolute(direction)), direction * self.v[i]

    def release(self, i: int, slack: Lanes) -> tuple[Lanes, Lanes]:
        """Return the same of its release, by what lambda may exceed its bounds."""
        low, high, torque = self.sides[0][i], self.sides[1][i], self.torque[i]
        bounded = either(self.sticks[i], both(low, high))
        toward = where(low, -torque, where(high, torque, absolute(torque)))
        on = both(self.resting(i), negated(bounded))
        return on, (self.law.bound(i, self.y[i]) + slack) - toward

    def stop(self, margin: Margin, q: Lanes) -> tuple[Lanes, Lanes]:
        """Return the sign of the margin of a stop, and the margin of a joint at q."""
        i = margin.joint
        side, stop = _stop_of(margin, self.q0[i], self.direction[i])
        return side, side * (q - stop)


def record_detect(law: Law) -> Program:
    """
    Return the program of `seek` and `event`, (1,): whether a segment has an event in it.

    Inputs are qd, rest, r, `loose`, whether a joint is released, and those of `record_margins`.
    Output `turns`, (n,), flags joints without friction that have turned and may have been beyond
    their stop: where the tangents of the margin at the beginning and the end meet, it is below
    zero; or they began beyond it, on their way back, and must not go further from where they turn.
    """
    segment, n = _Segment(law), law.n
    recorder = segment.recorder
    (v0,), (r, rest, loose) = read(recorder, n, 'qd'), single(recorder, 'r', 'rest', 'loose')
    turns = [recorder.constant(0.0)] * n
    flags = [loose]
    for margin in law.margins:
        i = margin.joint
        if not margin.stops:
            on, value = segment.reversal(i)
            if i in law.rough:
                flags.append(both(on, sign_of(-value)))
            continue
        on, (s, value) = segment.moving[i], segment.stop(margin, segment.q[i])
        flags.append(both(on, sign_of(-value)))
        if i not in law.rough:
            _, begin = segment.stop(margin, segment.q0[i])
            falls, rises = s * v0[i], s * segment.v[i]
            meet = begin * (falls - rises) + falls * ((value - begin) - rises * r)
            dips = both(both(sign_of(-falls), sign_of(rises)), sign_of(meet))
            ((_, place),) = margin.stops
            back = both(sign_of(s * (place - segment.q0[i])), sign_of(falls))
            turns[i] = turns[i] + both(on, either(dips, both(back, sign_of(-rises))))
    seek = both(rest, any_of([*flags, *(turns[i] for i in range(n) if law.stops[i])]))
    return recorder.program(seek=[seek], event=[seek], turns=turns)


def record_loose(law: Law) -> Program:
    """
    Return the program of `loose`, (1,): whether a joint is released in a segment.

    Inputs are those of `record_margins` at the end of the whole segment. Output `slack`, (1,), is
    what lambda may exceed its bounds by, from the torques there: those at the beginning, of motors
    with a lag, may all be zero.
    """
    segment = _Segment(law)
    (y,) = read(segment.recorder, law.n, 'y.end')
    greatest = largest([absolute(x) for x in (*segment.torque, *y)])
    slack = greatest * (law.eps * SLACK[law.dtype])
    releases = [segment.release(x.joint, slack) for x in law.margins if not x.stops]
    loose = any_of([both(on, sign_of(-value)) for on, value in releases])
    return segment.recorder.program(loose=[loose], slack=[slack])


def record_margins(law: Law) -> Program:
    """
    Return the program of margins and their slopes at a time of the segment.

    Inputs are q, the beginning; q.end, qd.end and qdd.end, the state; lambda of joints at rest;
    direction, moving, unbraked, sticks, turns; and (1,) loose and slack. Outputs, one of each
    margin: g; d, its slope in time, 0 for a release; and noise, what rounding makes of it. A
    margin that has no part in the segment is 1, as are all releases unless one is `loose`.
    """
    segment, n = _Segment(law), law.n
    recorder = segment.recorder
    a, turns = read(recorder, n, 'qdd.end', 'turns')
    loose, slack = single(recorder, 'loose', 'slack')
    g, d, noise = [], [], []
    for margin in law.margins:
        i = margin.joint
        if margin.stops:
            on, (side, value) = segment.moving[i], segment.stop(margin, segment.q[i])
            slope, rough = side * segment.v[i], absolute(segment.q[i]) * law.eps
        else:
            resting, reversal, release = (
                segment.resting(i),
                segment.reversal(i),
                segment.release(i, slack),
            )
            if i not in law.rough:
                reversal = both(reversal[0], turns[i]), reversal[1]
            release = both(loose, release[0]), release[1]
            on, value = (where(resting, b, a) for a, b in zip(reversal, release, strict=True))
            slope = where(resting, 0.0, segment.direction[i] * a[i])
            rough = where(resting, slack * 0.5, 0.0)
        g.append(where(on, value, 1.0))
        d.append(where(on, slope, 0.0))
        noise.append(where(on, rough, 0.0))
    return recorder.program(g=g, d=d, noise=noise)


def record_snap(law: Law, compensated: bool) -> Program:
    """
    Return the program of the state at an event.

    A Taylor step of length delta, in which the search ended; then a velocity of zero, or the
    position of the stop, exactly, for the margins flagged in `fired`. Inputs are the beginning, q
    and qd; q.end, qd.end, qdd.end and r; moving, direction, sticks; and (1,) event, delta, and
    span, the length of the segment. Outputs are the changed ones, with sums of positions also dq
    and `stopped`. A joint that was at rest and is back at once has been released by rounding
    alone: it sticks for the rest of the step. One that returns to its stop sooner than a search
    resolves is at rest there, as is one that falls from below LEAST_HEIGHT, where friction or
    another joint's event has cut its hop: two joints that throw each other off their stops would
    do so for ever.
    """
    recorder, n = Recorder(1, 'sequential'), law.n
    q0, v0, q, v, a, sticks = read(recorder, n, 'q', 'qd', 'q.end', 'qd.end', 'qdd.end', 'sticks')
    moving, direction = read(recorder, n, 'moving', 'direction')
    (fired,) = read(recorder, len(law.margins), 'fired')
    event, delta, r, span = single(recorder, 'event', 'delta', 'r', 'span')
    at_once = negated((r + delta) - span * law.short)
    way = [where(event, delta * (y + (0.5 * delta) * z), 0.0) for y, z in zip(v, a, strict=True)]
    q = [x + y for x, y in zip(q, way, strict=True)]
    v = [where(event, y + delta * z, y) for y, z in zip(v, a, strict=True)]
    stopped = [recorder.constant(0.0)] * n
    for margin, flag in zip(law.margins, fired, strict=True):
        i = margin.joint
        happens, still = both(both(event, flag), moving[i]), negated(absolute(v0[i]))
        if margin.stops:
            _, stop = _stop_of(margin, q0[i], direction[i])
            away = absolute(q0[i] - stop)
            low = sign_of((2.0 * LEAST_HEIGHT) * absolute(a[i]) - v[i] * v[i])
            returns, hops = negated(away), both(negated(away - LEAST_HEIGHT), low)
            q[i], still = where(happens, stop, q[i]), both(still, returns)
            v[i] = where(both(both(happens, at_once), either(returns, hops)), 0.0, v[i])
            stopped[i] = either(stopped[i], happens)
        else:
            v[i] = where(happens, 0.0, v[i])
        sticks[i] = where(both(happens, still), 1.0, sticks[i])
    outputs = {'q.end': q, 'qd.end': v, 'sticks': sticks, 'r': [where(event, r + delta, r)]}
    if compensated:
        (dq,) = read(recorder, n, 'dq')
        outputs |= {'dq': [x + y for x, y in zip(dq, way, strict=True)], 'stopped': stopped}
    return recorder.program(**outputs)


def record_unfinished(n: int) -> Program:
    """
    Return the program of a step that had too many events; inputs are qd, unfinished and rest.

    Outputs are qd, NaN, and unfinished, 1, for an arm whose step is incomplete.
    """
    recorder = Recorder(1, 'sequential')
    qd, unfinished = read(recorder, n, 'qd', UNFINISHED)
    (rest,) = single(recorder, 'rest')
    return recorder.program(
        qd=[where(rest, math.nan, v) for v in qd],
        unfinished=[where(rest, 1.0, flag) for flag in unfinished],
    )
