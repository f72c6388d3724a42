# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Events: the end of a segment, and the segment cut at the earliest event in it.

The modes of the joints are fixed over a segment, whose length is the rest of the step. If a
sliding joint reverses in it, or a joint passes its stop, the segment is cut at the earliest such
event, found on the polynomials of pfd_core.simulation.contact.schemes. At the event the velocity
is 0.0, or the position the stop, exactly. A step has as many segments as it has events, up to
MOST_SEGMENTS. Beyond that the step fails: the velocities become NaN, and the row `unfinished` of
the state is set.

A joint that turns within a segment may have been beyond its stop: the polynomial's minimum
decides. A joint that begins at rest or at its stop has a root at t = 0, which is divided out.

One register holds one number; flags are 1 or 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

from pfd_core.dynamics.interface import input_list, program_with_outputs
from pfd_core.machine.iteration import iterate
from pfd_core.machine.lanes import absolute, sqrt, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model import Plant
from pfd_core.simulation.contact.modes import (
    any_of,
    at_stops,
    both,
    either,
    inside_stops,
    negated,
    rough_joints,
    sign_of,
    smallest,
)
from pfd_core.simulation.contact.schemes import Cubic, Scheme

# Largest number of segments in a step. A joint that bounces to the least height
# (pfd_core.simulation.contact.impacts) under 800 rad/s^2 without loss has this many in 1 ms.
MOST_SEGMENTS = 10_000
# Iterations of Newton's method in a bracket; bisection alone would need 53.
ROOT_ITERATIONS = 60
# Tolerance of the time of an event, as a fraction of a segment: a few units of rounding.
ROOT_TOLERANCE = {'float64': 2.0**-51, 'float32': 2.0**-22}


def record_end(plant: Plant, scheme: Scheme) -> Program:
    """
    Return the program of the end of a segment.

    Inputs are q, qd, the stages, direction and, (1,), rest. Outputs are q.end = q + dq, dq,
    qd.end, stopped, zeros, and, (1,), rest.end = 0 and `event`: whether a joint may have reversed
    or passed its stop. A joint with stops that turns may have.
    """
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    q = input_list(recorder, 'q', n)
    dq, qd_end = scheme.end(recorder, n)
    q_end = [x + d for x, d in zip(q, dq, strict=True)]
    zero = recorder.constant(0.0)
    events = _events(plant, recorder, q)
    reversals = [event for event in events if event.stop is None]
    margins = [event.at(q_end, qd_end) for event in reversals] + inside_stops(plant, q_end)
    turning = {event.joint for event in events} - {event.joint for event in reversals}
    qd = input_list(recorder, 'qd', n)
    margins += [qd[i] * qd_end[i] for i in sorted(turning)]
    return program_with_outputs(
        recorder,
        **{'q.end': q_end, 'qd.end': qd_end, 'rest.end': [zero]},
        dq=dq,
        stopped=[zero] * n,
        event=[sign_of(-smallest(margins))],
    )


def record_cut(plant: Plant, scheme: Scheme, dtype: str) -> Program:
    """
    Return the program that cuts a segment at its earliest event.

    Inputs are the inputs and results of `record_end`. Outputs are the results for the shorter
    segment, and `stopped`, flags of the joints that have reached their stop. With `scheme.sticks`
    there are flags `sticks`: a segment in which a joint reverses that was at rest, or passes a
    stop at which it was at rest, is repeated with that joint sticking.
    """
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    q = input_list(recorder, 'q', n)
    (r,) = input_list(recorder, 'rest', 1)
    q_end, qd_end, dq = (input_list(recorder, name, n) for name in ('q.end', 'qd.end', 'dq'))
    position, velocity = scheme.output(recorder, n, list(map(either, *at_stops(plant, q))))
    events = _events(plant, recorder, q)
    qd = input_list(recorder, 'qd', n)
    at_rest = [negated(absolute(v)) for v in qd]
    passed, ends, functions, at_once = [], [], [], []
    for e in events:
        c = e.polynomial(position, velocity)
        beyond = sign_of(-e.at(q_end, qd_end))
        if e.stop is None:
            passed.append(beyond)
            ends.append(recorder.constant(1.0))
        else:
            turn, lowest = _minimum(c)
            inner = both(turn, sign_of(-_value(c, lowest)))
            passed.append(either(beyond, inner))
            ends.append(where(inner, lowest, 1.0))
        # At rest at its stop, a joint has a double root.
        functions.append(_deflated(_deflated(c)))
        at_once.append(both(passed[-1], both(at_rest[e.joint], negated(absolute(c[0])))))
    event = any_of(passed)
    roots = _roots(functions, passed, ends, ROOT_TOLERANCE[dtype])
    times = [where(flag, root, 2.0) for flag, root in zip(passed, roots, strict=True)]
    if scheme.sticks:
        times = [where(flag, 0.0, time) for flag, time in zip(at_once, times, strict=True)]
    t = smallest(times)
    first = [both(flag, negated(time - t)) for flag, time in zip(passed, times, strict=True)]

    cut_q = [_value(position[i], t) for i in range(n)]
    cut_qd = [_value(velocity[i], t) for i in range(n)]
    cut_dq = [_change(c, t) for c in position]
    stopped = [recorder.constant(0.0)] * n
    for flag, e in zip(first, events, strict=True):
        i = e.joint
        if e.stop is None:
            cut_qd[i] = where(flag, 0.0, cut_qd[i])
        else:
            cut_q[i] = where(flag, e.stop, cut_q[i])
            stopped[i] = either(stopped[i], flag)
    sticking: dict[str, list[Lanes]] = {}
    if scheme.sticks:
        sticking['sticks'] = input_list(recorder, 'sticks', n)
        for flag, e in zip(map(both, first, at_once), events, strict=True):
            sticking['sticks'][e.joint] = either(sticking['sticks'][e.joint], flag)
    return program_with_outputs(
        recorder,
        **sticking,
        **{
            'q.end': [where(event, cut_q[i], q_end[i]) for i in range(n)],
            'qd.end': [where(event, cut_qd[i], qd_end[i]) for i in range(n)],
            'rest.end': [where(event, r * (1.0 - t), 0.0)],
        },
        dq=[where(event, cut_dq[i], dq[i]) for i in range(n)],
        stopped=stopped,
    )


def record_commit(n: int, compensated: bool, lagging: bool) -> Program:
    """
    Return the program of the state after a segment; a finished step keeps its own.

    Inputs and outputs are q, qd, rest and the further rows of the state. With q_low the position
    is the sum q + q_low + dq, whose rounding error is kept (pfd_core.simulation.rows), except for
    joints flagged in `stopped`.
    """
    recorder = Recorder(1, 'sequential')

    def read(name: str) -> list[Lanes]:
        return input_list(recorder, name, n)

    old = {'q': read('q'), 'qd': read('qd'), 'rest': input_list(recorder, 'rest', 1)}
    new = {'q': read('q.end'), 'qd': read('qd.end')}
    new['rest'] = input_list(recorder, 'rest.end', 1)
    if compensated:
        old['q_low'], dq, stopped = read('q_low'), read('dq'), read('stopped')
        low: list[Lanes] = []
        for i, q in enumerate(old['q']):
            y = dq[i] + old['q_low'][i]
            q_end = q + y
            added = q_end - q
            error = (q - (q_end - added)) + (y - added)
            new['q'][i] = where(stopped[i], new['q'][i], q_end)
            low.append(where(stopped[i], 0.0, error))
        new['q_low'] = low
    if lagging:
        old['tau_motor'], new['tau_motor'] = read('tau_motor'), read('motor.end')
    (rest,) = old['rest']
    return program_with_outputs(
        recorder,
        **{
            name: [where(rest, end, own) for end, own in zip(new[name], row, strict=True)]
            for name, row in old.items()
        },
    )


def record_unfinished(n: int) -> Program:
    """
    Return the program of a step that had too many events; inputs are qd, unfinished and rest.

    Outputs are qd, NaN, and unfinished, 1, for an arm whose step is incomplete.
    """
    recorder = Recorder(1, 'sequential')
    qd, unfinished = (input_list(recorder, name, n) for name in ('qd', 'unfinished'))
    (rest,) = input_list(recorder, 'rest', 1)
    return program_with_outputs(
        recorder,
        qd=[where(rest, math.nan, v) for v in qd],
        unfinished=[where(rest, 1.0, flag) for flag in unfinished],
    )


@dataclass(frozen=True)
class _Event:
    """A function of a joint's position or velocity that is below zero after the event."""

    joint: int
    sign: Lanes  # of the position's or velocity's part in the function
    stop: Lanes | None  # the position that a joint must not pass; None for a reversal

    def at(self, q: Sequence[Lanes], qd: Sequence[Lanes]) -> Lanes:
        """Return the function of a state."""
        way = qd[self.joint] if self.stop is None else q[self.joint] - self.stop
        result: Lanes = self.sign * way
        return result

    def polynomial(self, position: Sequence[Cubic], velocity: Sequence[Cubic]) -> Cubic:
        """Return the coefficients of the function over a segment, from the constant one on."""
        row = list((velocity if self.stop is None else position)[self.joint])
        if self.stop is not None:
            row[0] = row[0] - self.stop
        return [self.sign * c for c in row]


def _events(plant: Plant, recorder: Recorder, q: Sequence[Lanes]) -> list[_Event]:
    """Return the events that joints may have: reversals under friction, and stops passed."""
    one = recorder.constant(1.0)
    events = []
    if plant.friction is not None:
        direction = input_list(recorder, 'direction', len(q))
        events = [_Event(i, direction[i], None) for i in rough_joints(plant)]
    for i, (lower, upper) in enumerate([] if plant.joint_limits is None else plant.joint_limits):
        # A joint beyond its stop must not move further.
        if math.isfinite(lower):
            events.append(_Event(i, one, where(q[i] - float(lower), float(lower), q[i])))
        if math.isfinite(upper):
            events.append(_Event(i, -one, where(float(upper) - q[i], float(upper), q[i])))
    return events


def _deflated(c: Cubic) -> Cubic:
    """Return a polynomial without its root at 0, if it has one there."""
    shifted = [*c[1:], c[0] * 0.0]
    return [where(absolute(c[0]), own, other) for own, other in zip(c, shifted, strict=True)]


def _minimum(c: Cubic) -> tuple[Lanes, Lanes]:
    """Return whether a polynomial falls at 0 and rises at 1, and the argument of its minimum."""
    rises = c[1] + (2.0 * c[2] + 3.0 * c[3])
    root = sqrt(c[2] * c[2] - 3.0 * (c[1] * c[3]))
    return both(sign_of(-c[1]), sign_of(rises)), -c[1] / (c[2] + root)


def _value(c: Cubic, t: Lanes) -> Lanes:
    result: Lanes = c[0] + _change(c, t)
    return result


def _change(c: Cubic, t: Lanes) -> Lanes:
    result: Lanes = t * (c[1] + t * (c[2] + t * c[3]))
    return result


def _roots(
    functions: Sequence[Cubic],
    passed: Sequence[Lanes],
    ends: Sequence[Lanes],
    tolerance: float,
) -> list[Lanes]:
    """
    Return a root in [0, end] of each function that is below zero at its end, as `passed` says.

    Newton's method; where it leaves the bracket, the middle of the bracket.
    """
    count = len(functions)
    zero, one = (passed[0].recorder.constant(x) for x in (0.0, 1.0))

    def iteration(*state: Lanes) -> tuple[tuple[Lanes, ...], Lanes]:
        following: list[Lanes] = []
        furthest = zero
        for k, c in enumerate(functions):
            left, right, x = state[3 * k : 3 * k + 3]
            f = _value(c, x)
            slope = c[1] + x * (2.0 * c[2] + x * (3.0 * c[3]))
            left, right = where(-f, left, x), where(-f, x, right)
            newton = x - f / slope
            outside = either(sign_of(left - newton), sign_of(newton - right))
            better = where(outside, 0.5 * (left + right), newton)
            new = where(absolute(f), better, x)
            way = where(passed[k], absolute(new - x), zero)
            furthest = where(way - furthest, way, furthest)
            following += [left, right, new]
        return tuple(following), furthest

    start = tuple(x for end in ends for x in (zero, end, end))
    state, _ = iterate(iteration, start, one, ROOT_ITERATIONS, one * tolerance)
    return [state[3 * k + 2] for k in range(count)]
