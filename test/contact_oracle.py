# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Event-driven motion of an arm under dry friction and stops, by another method than the simulation.

    smooth motion    Pinocchio's dynamics, SciPy's DOP853 to rounding
    events           bisection on its output of seventh order, also of a function's minimum
    held joints, impacts    every combination of modes is tried; the one that violates least is it

The laws are those of docs/decisions/0016-friction-and-stops.md; nothing else is shared with the
simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from oracle import Oracle
from scipy.integrate import DOP853
from zoo import Array, random_chain

import pfd_core as pfd

# Height of the lowest bounce, as the decision states it.
LEAST_HEIGHT = 1e-12
# Tolerances of DOP853: some roundings.
RELATIVE, ABSOLUTE = 1e-13, 1e-14
# Places of a step at which signs are looked at, and trips of the bisection between two.
PLACES, HALVINGS = 6, 60
# Longest step [s], so that events come one by one between two places.
LONGEST = 2e-3
# Motions with more events are not followed.
MOST_EVENTS = 3000


@dataclass(frozen=True)
class Event:
    """A function of the state that is above zero until an event; its derivative if known."""

    kind: str
    joint: int
    function: Callable[[Array], float]
    slope: Callable[[Array], float] | None = None


class TooManyEventsError(RuntimeError):
    """A motion with more than MOST_EVENTS."""


@dataclass(frozen=True)
class Case:
    """An arm with constant torques: limits are (n, 2), all others (n,), damping also a number."""

    robot: pfd.Robot
    armature: Array
    friction: Array
    limits: Array
    restitution: Array
    tau: Array
    damping: Array | float = 0.0


class Motion:
    """
    The motion of a case from a state; `events` are the times of its events.

    `ambiguous` is set where an impact happens while another joint is off its stop by less than
    LEAST_HEIGHT. Impacts at one time and impacts one after the other end differently, and which of
    them it is depends on a distance that the law of the decision does not resolve.
    """

    def __init__(self, case: Case, q: Array, v: Array) -> None:
        self.case, self.oracle = case, Oracle(case.robot, case.armature)
        self.n, self.t = len(q), 0.0
        self.events: list[float] = []
        self.ambiguous = False
        self.q, self.v = q.copy(), v.copy()
        self._begin()

    def advance(self, until: float) -> None:
        """Move on to a time."""
        while self.t < until:
            self._leg(until)

    def _bias(self, q: Array, v: Array) -> Array:
        return self.oracle.tau(q, v, np.zeros(self.n)) + self.case.damping * v

    def _at_stops(self) -> tuple[Array, Array]:
        lower, upper = self.case.limits.T
        return self.q <= lower, self.q >= upper

    def _begin(self) -> None:
        """Do the impacts of a state, and find its modes."""
        lower, upper = self._at_stops()
        if ((lower & (self.v < 0)) | (upper & (self.v > 0))).any():
            gaps = np.abs(self.q[:, np.newaxis] - self.case.limits)
            self.ambiguous |= bool(((gaps > 0) & (gaps < LEAST_HEIGHT)).any())
            self._impact(lower, upper)
        self.sign, self.moving, _ = self._modes(self.v)

    def _modes(self, v: Array) -> tuple[Array, Array, Array]:
        """Return directions of friction, flags of moving joints, and accelerations."""
        lower, upper = self._at_stops()
        friction = self.case.friction
        low, high = np.where(upper, -np.inf, -friction), np.where(lower, np.inf, friction)
        candidates = np.flatnonzero((v == 0) & ((friction > 0) | lower | upper))
        sign = np.sign(v)
        H, load = self.oracle.H(self.q), self.case.tau - self._bias(self.q, v) - sign * friction
        best = np.inf
        for ways in product((0, 1, -1), repeat=len(candidates)):
            way = np.ones(self.n)
            way[candidates] = ways
            c = load.copy()
            released = candidates[way[candidates] != 0]
            bound = np.where(way > 0, low, high)[released]
            if not np.isfinite(bound).all():
                continue
            c[released] += bound
            free = np.flatnonzero(way)
            a = np.zeros(self.n)
            a[free] = np.linalg.solve(H[np.ix_(free, free)], c[free])
            reaction = H @ a - load
            held = candidates[way[candidates] == 0]
            excess = np.maximum(low - reaction, reaction - high)[held]
            wrong = -(way * a)[released]
            violation = max(excess.max(initial=0.0), wrong.max(initial=0.0))
            if violation < best:
                best = violation
                found = np.where(released_flags(way, candidates, self.n), way, sign), way != 0, a
        return found

    def _impact(self, lower: Array, upper: Array) -> None:
        H = self.oracle.H(self.q)
        inverse = np.linalg.inv(H)
        before = self.v
        after, p = self._compression(H, before, lower, upper)
        restitution = self.case.restitution.copy()
        while True:
            thrown = restitution * p
            gained = thrown @ inverse @ thrown
            alpha = min(1.0, np.sqrt(p @ inverse @ p / gained)) if gained else 0.0
            v = after + alpha * (inverse @ thrown)
            if ((lower & (v < 0)) | (upper & (v > 0))).any():
                v, _ = self._compression(H, v, lower, upper)
            _, _, a = self._modes(v)
            ends = (thrown != 0) & (v * a < 0) & (v * v < 2 * LEAST_HEIGHT * abs(a))
            if not ends.any():
                break
            restitution[ends] = 0.0
        self.v = v

    def _compression(
        self, H: Array, before: Array, lower: Array, upper: Array
    ) -> tuple[Array, Array]:
        candidates = np.flatnonzero(lower | upper)
        push = np.where(lower, 1.0, -1.0)
        best, found = np.inf, (before, before)
        for stopped in product((True, False), repeat=len(candidates)):
            held = candidates[list(stopped)]
            free = np.setdiff1d(np.arange(self.n), held)
            v = np.zeros(self.n)
            v[free] = np.linalg.solve(H[np.ix_(free, free)], (H @ before)[free])
            p = np.zeros(self.n)
            p[held] = (H @ (v - before))[held]
            violation = max(
                (-push * p)[held].max(initial=0.0),
                (-push * v)[np.setdiff1d(candidates, held)].max(initial=0.0),
            )
            if violation < best:
                best, found = violation, (v, p)
        return found

    def _leg(self, until: float) -> None:
        """Move on to the next event, or to a time."""
        moving, n = np.flatnonzero(self.moving), self.n
        drag = np.where(self.moving, self.sign * self.case.friction, 0.0)

        def accelerations(q: Array, v: Array) -> Array:
            a = np.zeros(n)
            H = self.oracle.H(q)
            load = (self.case.tau - self._bias(q, v) - drag)[moving]
            a[moving] = np.linalg.solve(H[np.ix_(moving, moving)], load)
            return a

        def rate(_: float, y: Array) -> Array:
            return np.concatenate([y[n:], accelerations(y[:n], y[n:])])

        solver = DOP853(
            rate,
            self.t,
            np.concatenate([self.q, self.v]),
            until,
            rtol=RELATIVE,
            atol=ABSOLUTE,
            max_step=LONGEST,
        )
        events = list(self._events(accelerations))
        while solver.status == 'running':
            solver.step()
            place = first_event(events, solver.dense_output(), solver.t_old, solver.t)
            if place:
                self._cut(*place)
                return
        self.t, self.q, self.v = until, solver.y[:n].copy(), solver.y[n:].copy()

    def _events(self, accelerations: Callable[[Array, Array], Array]) -> Iterator[Event]:
        """Yield the events that may end a leg."""
        n, case, sign = self.n, self.case, self.sign
        lower, upper = self._at_stops()
        for i in range(n):
            if self.moving[i]:
                first, last = case.limits[i]
                if case.friction[i]:
                    yield Event(
                        *('reverses', i, lambda y, i=i: sign[i] * y[n + i]),
                        lambda y, i=i: sign[i] * accelerations(y[:n], y[n:])[i],
                    )
                yield Event('lower', i, lambda y, i=i, x=first: y[i] - x, lambda y, i=i: y[n + i])
                yield Event('upper', i, lambda y, i=i, x=last: x - y[i], lambda y, i=i: -y[n + i])
        held = np.flatnonzero(~self.moving)
        low = np.where(upper, -np.inf, -case.friction)
        high = np.where(lower, np.inf, case.friction)

        def margin(y: Array) -> float:
            a = accelerations(y[:n], y[n:])
            reaction = self.oracle.tau(y[:n], y[n:], a) + case.damping * y[n:] - case.tau
            return float(np.minimum(reaction - low, high - reaction)[held].min())

        if len(held):
            yield Event('breaks away', -1, margin)

    def _cut(self, t: float, kind: str, i: int, y: Array) -> None:
        self.events.append(t)
        if len(self.events) > MOST_EVENTS:
            raise TooManyEventsError
        self.t, self.q, self.v = t, y[: self.n].copy(), y[self.n :].copy()
        if kind == 'reverses':
            self.v[i] = 0.0
        elif kind in ('lower', 'upper'):
            self.q[i] = self.case.limits[i, int(kind == 'upper')]
        self._begin()


def released_flags(way: Array, candidates: Array, n: int) -> Array:
    """Return flags of the candidates: their direction is that of their release, or none."""
    flags = np.zeros(n, bool)
    flags[candidates] = True
    return flags


def first_event(
    events: list[Event], output: Callable[[float], Array], begin: float, end: float
) -> tuple[float, str, int, Array] | None:
    """Return time, kind, joint and state of the first event of a step, None without one."""
    times = np.linspace(begin, end, PLACES + 1).tolist()
    states = [output(t) for t in times]
    best = None
    for event in events:
        for k in range(PLACES):
            right = times[k + 1]
            if event.function(states[k + 1]) >= 0:
                # Below zero at its minimum, a function comes back above zero.
                slope = event.slope
                if slope is None or not slope(states[k]) < 0 < slope(states[k + 1]):
                    continue
                right = bisected(lambda y, f=slope: -f(y), output, times[k], right)
                if event.function(output(right)) >= 0:
                    continue
            right = bisected(event.function, output, times[k], right)
            if best is None or right < best[0]:
                best = (right, event.kind, event.joint, output(right))
            break
    return best


def bisected(
    function: Callable[[Array], float], output: Callable[[float], Array], left: float, right: float
) -> float:
    """Return a time at which a function falls below zero; it is below zero at `right`."""
    for _ in range(HALVINGS):
        middle = (left + right) / 2
        if function(output(middle)) < 0:
            right = middle
        else:
            left = middle
    return right


def random_case(rng: np.random.Generator) -> tuple[Case, pfd.Scene]:
    """Return an arm of two to six joints; tau is that of gravity at zero, and more."""
    n = int(rng.integers(2, 7))
    robot = random_chain(rng, n, 0.2)
    armature = rng.uniform(0.1, 1.0, n)
    friction = rng.uniform(0, 3, n) * (rng.random(n) < 0.6)
    gap = 10 ** rng.uniform(-2, 0, n)
    limits = rng.uniform(-0.5, 0.5, n)[:, np.newaxis] + gap[:, np.newaxis] * [-0.5, 0.5]
    restitution = np.where(rng.random(n) < 0.3, rng.integers(0, 2, n), rng.uniform(0, 1, n))
    case = Case(robot, armature, friction, limits, restitution, rng.normal(0, 10, n))
    scene = pfd.Scene(
        armature=armature, friction=friction, joint_limits=limits, restitution=restitution
    )
    return case, scene


def random_start(rng: np.random.Generator, case: Case) -> tuple[Array, Array]:
    """Return positions between the stops, some at them, and velocities, some zero."""
    lower, upper = case.limits.T
    where, n = rng.random(len(lower)), len(lower)
    q = rng.uniform(lower, upper)
    q = np.where(where < 0.1, lower, np.where(where > 0.9, upper, q))
    return q, rng.normal(0, 3, n) * (rng.random(n) < 0.7)
