# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Events within an adaptive step, located on its dense output.

    look      the state at a part of the step, and the margin of reversals and stops
    excess    the margin of joints at rest: the distance of the holding torque from its bound
    turn      where a joint comes closest to its stop between two looks
    strike    the state at the event: velocity 0.0, or position the stop, exactly
    stick     joints that their friction or stop does not release
    calm      joints that leave their stop for less than LEAST_FLIGHT

A margin is above zero before the event and below zero after it. The units of margins differ; only
their signs matter. A joint at rest is released where the holding torque reaches its bound. So the
motion between events is smooth, and events are as accurate as the steps. The native code searches
for the first change of sign (pfd_core.kernels.adaptive).

All programs have as inputs the state at the beginning of the step, and there the outputs of
record_modes and record_directions of pfd_core.simulation.dry. One register holds one
number; flags are 1 or 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from pfd_core.dynamics.interface import input_list, program_with_outputs
from pfd_core.machine.lanes import absolute, where
from pfd_core.machine.program import Program
from pfd_core.machine.recorder import Lanes, Recorder
from pfd_core.model import Plant
from pfd_core.simulation.dry import Law
from pfd_core.simulation.flags import any_of, both, either, negated, sign_of, smallest

# Rows of the dense output.
ROWS = 7
# Height below which a joint does not leave its stop, by the velocity and acceleration there
# [rad or m]. Impacts of several joints in turn may throw each off its stop again and again, with
# velocities that reach zero in a finite time; at this height they are below 1e-12 rad/s or m/s.
LEAST_FLIGHT = 1e-26
# Roundings of a joint's torque over the largest torque, with a margin.
ROUNDING = 2.0**-42


def dense_event_programs(plant: Plant) -> dict[str, Program]:
    """Return the programs of events of a plant with dry friction or joint stops, by name."""
    programs = {
        'look': _look(plant),
        'excess': _excess(plant),
        'strike': _strike(plant),
        'stick': _stick(plant),
    }
    if plant.joint_limits is not None:
        programs |= {'turn': _turn(plant), 'calm': _calm(plant)}
    return programs


@dataclass(frozen=True)
class _Stop:
    """A stop of a joint. A joint that begins beyond its stop must not move further."""

    joint: int
    sign: float  # of the position in the margin
    position: Lanes
    begin: Lanes  # position of the joint at the beginning of the step

    def margin(self, dq: Sequence[Lanes]) -> Lanes:
        """Return the margin after a change of position, exact for a joint that began at it."""
        result: Lanes = self.sign * ((self.begin - self.position) + dq[self.joint])
        return result


def _stops(plant: Plant, q: Sequence[Lanes]) -> list[_Stop]:
    """Return the stops, for positions at the beginning of a step."""
    stops = []
    for i, (lower, upper) in enumerate([] if plant.joint_limits is None else plant.joint_limits):
        if math.isfinite(lower):
            stop = where(q[i] - float(lower), float(lower), q[i])
            stops.append(_Stop(i, 1.0, stop, q[i]))
        if math.isfinite(upper):
            stop = where(float(upper) - q[i], float(upper), q[i])
            stops.append(_Stop(i, -1.0, stop, q[i]))
    return stops


def _reversal(direction: Lanes, velocity: Lanes) -> Lanes:
    """Return the margin of a joint's reversal; 1 for a joint that does not slide."""
    result: Lanes = where(absolute(direction), direction * velocity, 1.0)
    return result


def _look(plant: Plant) -> Program:
    """
    Return the program of the state at the part `theta` of a step, and of `margin`, (1,).

    The state is q.at = q + dq.at and qd.at.

    Further inputs are the rows of the dense output. `held`, (1,), says whether a joint rests.
    """
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    q, qd, direction, moving, unbraked = (
        input_list(recorder, name, n) for name in ('q', 'qd', 'direction', 'moving', 'unbraked')
    )
    (theta,) = input_list(recorder, 'theta', 1)
    rest = 1.0 - theta
    changes = []
    for part in ('q', 'qd'):
        rows = [input_list(recorder, f'dense{k}.{part}', n) for k in range(ROWS)]
        rise = [recorder.constant(0.0)] * n
        for k in reversed(range(ROWS)):
            factor = theta if k % 2 == 0 else rest
            rise = [factor * (x + row) for x, row in zip(rise, rows[k], strict=True)]
        changes.append(rise)
    dq, dqd = changes
    q_at, qd_at = [q[i] + dq[i] for i in range(n)], [qd[i] + dqd[i] for i in range(n)]
    margins = [_reversal(direction[i], qd_at[i]) for i in Law(plant, 'float64').rough]
    margins += [where(moving[s.joint], s.margin(dq), 1.0) for s in _stops(plant, q)]
    held = [both(unbraked[i], negated(moving[i])) for i in range(n)]
    return program_with_outputs(
        recorder,
        **{'dq.at': dq, 'q.at': q_at, 'qd.at': qd_at},
        margin=[smallest(margins)],
        held=[any_of(held)],
    )


def _excess(plant: Plant) -> Program:
    """
    Return the program of `margin`, (1,), with the bounds of the joints at rest.

    Inputs are margin; torque = H x + bias, which the motion needs; load, the torque of the motors;
    and `sticks`, flags of joints that nothing releases. A joint is released where the bound is
    exceeded by more than the rounding of the largest torque, so that the modes at that time
    release it, too.
    """
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    q, moving, unbraked, sticks, torque, load = (
        input_list(recorder, name, n)
        for name in ('q', 'moving', 'unbraked', 'sticks', 'torque', 'load')
    )
    (margin,) = input_list(recorder, 'margin', 1)
    friction = np.zeros(n) if plant.static_friction is None else plant.static_friction
    at_lower, at_upper = Law(plant, 'float64').at_stops(q)
    margins = [margin]
    slack = ROUNDING * -smallest([-absolute(x) for x in (*torque, *load)])
    for i, bound in enumerate(friction.tolist()):
        lam = torque[i] - load[i]
        above = where(at_lower[i], 1.0, bound - lam)
        below = where(at_upper[i], 1.0, lam + bound)
        held = both(both(unbraked[i], negated(moving[i])), negated(sticks[i]))
        margins.append(where(held, slack + smallest([above, below]), 1.0))
    return program_with_outputs(recorder, margin=[smallest(margins)])


def _turn(plant: Plant) -> Program:
    """
    Return the program of `theta.turn`, (1,): where a joint turns in front of its stop.

    Inputs are q, moving, the state at `theta.before` as dq.before and qd.before, the state at
    `theta`, and h. Between the two times a joint moves on the cubic through both states. If
    several joints turn, the joint closest to its stop counts; if none turns, the output is theta.
    """
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    q, moving, dq0, qd0, dq1, qd1 = (
        input_list(recorder, name, n)
        for name in ('q', 'moving', 'dq.before', 'qd.before', 'dq.at', 'qd.at')
    )
    h, begin, end = (input_list(recorder, name, 1)[0] for name in ('h', 'theta.before', 'theta'))
    size = h * (end - begin)
    closest, turn = recorder.constant(math.inf), end
    for stop in _stops(plant, q):
        i = stop.joint
        w0, w1 = (size * (stop.sign * v[i]) for v in (qd0, qd1))
        turns = both(moving[i], both(sign_of(-w0), sign_of(w1)))
        s = w0 / (w0 - w1)
        d0, d1 = stop.margin(dq0), stop.margin(dq1)
        rise = d1 - d0
        cubic = d0 + s * (w0 + s * ((3.0 * rise - 2.0 * w0 - w1) + s * (w0 + w1 - 2.0 * rise)))
        better = both(turns, sign_of(closest - cubic))
        closest = where(better, cubic, closest)
        turn = where(better, begin + s * (end - begin), turn)
    return program_with_outputs(recorder, **{'theta.turn': [turn]})


def _strike(plant: Plant) -> Program:
    """Return the program of q and qd at an event: the state at `theta`, with the event exact."""
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    q, direction, moving, dq, q_at, qd_at = (
        input_list(recorder, name, n)
        for name in ('q', 'direction', 'moving', 'dq.at', 'q.at', 'qd.at')
    )
    q_end, qd_end = list(q_at), list(qd_at)
    for i in Law(plant, 'float64').rough:
        qd_end[i] = where(_reversal(direction[i], qd_at[i]), qd_at[i], 0.0)
    for stop in _stops(plant, q):
        i = stop.joint
        passed = both(moving[i], negated(stop.margin(dq)))
        q_end[i] = where(passed, stop.position, q_end[i])
    return program_with_outputs(recorder, q=q_end, qd=qd_end)


def _stick(plant: Plant) -> Program:
    """
    Return the program of `sticks`, (n,): joints that leave rest at once in a wrong direction.

    Inputs are the state soon after the beginning, dq.at and qd.at, and sticks. `stuck`, (1,),
    flags a new one. Only rounding can move a joint in a wrong direction.
    """
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    q, qd, direction, moving, sticks, dq, qd_at = (
        input_list(recorder, name, n)
        for name in ('q', 'qd', 'direction', 'moving', 'sticks', 'dq.at', 'qd.at')
    )
    zero = recorder.constant(0.0)
    wrong = [zero] * n
    for i in Law(plant, 'float64').rough:
        wrong[i] = sign_of(-_reversal(direction[i], qd_at[i]))
    for stop in _stops(plant, q):
        i = stop.joint
        wrong[i] = either(wrong[i], sign_of(-stop.margin(dq)))
    new = [
        both(both(moving[i], negated(absolute(qd[i]))), both(wrong[i], negated(sticks[i])))
        for i in range(n)
    ]
    return program_with_outputs(
        recorder,
        sticks=[either(sticks[i], new[i]) for i in range(n)],
        stuck=[any_of(new)],
    )


def _calm(plant: Plant) -> Program:
    """
    Return the program of qd with joints at rest that leave their stop below LEAST_FLIGHT.

    `calmed`, (1,), flags such a joint.
    """
    n = plant.robot.n
    recorder = Recorder(1, 'sequential')
    q, qd, a = (input_list(recorder, name, n) for name in ('q', 'qd', 'qdd'))
    at_lower, at_upper = Law(plant, 'float64').at_stops(q)
    low = [
        both(
            sign_of(-(qd[i] * a[i])), sign_of((2 * LEAST_FLIGHT) * absolute(a[i]) - qd[i] * qd[i])
        )
        for i in range(n)
    ]
    calm = [both(low[i], either(at_lower[i], at_upper[i])) for i in range(n)]
    return program_with_outputs(
        recorder,
        qd=[where(calm[i], 0.0, qd[i]) for i in range(n)],
        calmed=[any_of(calm)],
    )
